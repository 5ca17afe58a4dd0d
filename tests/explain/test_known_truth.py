"""What `explain` says of logs whose truth is known. Fixed seeds; fresh ones in benchmarks/."""

import math
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from tests.explain.families import make_family
from tests.explain.scoring import judge, list_truth, score
from tests.explain.truth import Log, Truth, make_log
from turtlelog.explain import Certainty, Identification, identify_run
from turtlelog.explain.scenario_from_log.law_identification import (
    PHASES,
    identify_rotation,
    identify_translation,
)
from turtlelog.explain.scenario_from_log.trace import mark_breaks, trace_run
from turtlelog.run import Run

FAR = (2.0, 10.0)


def identify(log: Log) -> Identification:
    return identify_run(log.to_run())


@pytest.mark.everyday("sensed 1e-4-1", "quantum-1")
@pytest.mark.parametrize(
    ("family", "amount"),
    [
        *[("clean", 4), ("cut", 4), ("cut delay", 3), ("depths", 2), ("period", 2), ("second", 2)],
        *[("stops", 3), ("rows", 3), ("gap", 2), ("jump", 1), ("laws", 4), ("sensed 1e-4", 1)],
        *[("logged 1e-2, cut", 1), ("quantum", 1), ("quantum in the log", 1)],
    ],
)
def test_nothing_is_exact_that_is_not_true(family: str, amount: int) -> None:
    """Each family is identified several times: seconds for those with most unknowns."""
    total: Counter[tuple[str, str]] = Counter()
    for log in make_family(family, 20, amount):
        total += score(log, identify(log))
    wrong = {key: said for key, said in total if said in {"exact false", "bounded false"}}
    assert wrong == {}
    assert sum(said == "exact true" for _, said in total) >= 2


@pytest.mark.thorough
@pytest.mark.parametrize(
    "family", ["logged 1e-4", "logged 1e-2", "misread 1e-5", "misread 1e-4", "misread 1e-3"]
)
def test_an_interval_of_a_gain_holds_the_truth_in_95_of_100_logs(family: str) -> None:
    """A share of 95 % shows in many logs: 80 fits a family."""
    said: Counter[str] = Counter()
    for log in make_family(family, 21, 40):
        trace, truth = mark_breaks(trace_run(log.to_run(), PHASES)), list_truth(log)
        for found in (identify_rotation(trace)[0], identify_translation(trace)[0]):
            for key in found.keys() & {"law.kp_angular", "law.kp_linear"}:
                said[judge(found[key], truth[key])] += 1
    fitted = said["fitted true"] + said["fitted false"]
    assert fitted > 66
    assert 0.9 <= said["fitted true"] / fitted <= 0.995


@pytest.mark.everyday("0.0001")
@pytest.mark.parametrize("noise", [1e-4, 1e-2])
def test_noise_in_what_is_read_leaves_gains_exact_and_fits_the_loop(noise: float) -> None:
    """With large noise the search tries all backlogs and pauses."""
    log = make_log(Truth(noise=noise, seed=3))
    found = identify(log).findings
    gains = found["law.kp_angular"], found["law.kp_linear"]
    assert [(gain.value, gain.certainty) for gain in gains] == [(4.0, Certainty.EXACT)] * 2
    loop = [found[key] for key in ("loop.start_backlog", "law.pause_ticks", "dead_time.translate")]
    assert [(finding.value, finding.certainty) for finding in loop] == [
        (6, Certainty.FITTED), (34, Certainty.FITTED), (6, Certainty.FITTED)]  # fmt: skip
    assert found["loop.command_queue"].certainty is not Certainty.EXACT
    assert found["start.x_m"].interval is not None


@pytest.mark.thorough
def test_a_second_run_without_a_reset_is_found_between_the_floats() -> None:
    start = (4.123456789012, 6.543210987654, 0.7)
    log = make_log(Truth(start=start, goal=FAR))
    found = identify(log)
    loop = found.findings["loop.start_backlog"], found.findings["law.pause_ticks"]
    assert [(value.value, value.certainty) for value in loop] == [
        (6, Certainty.EXACT), (34, Certainty.EXACT)]  # fmt: skip
    x = found.findings["start.x_m"]
    assert x.interval is not None
    assert x.interval[0] <= start[0] <= x.interval[1]
    assert x.interval[1] - x.interval[0] < 1e-8
    assert found.resimulation is not None
    assert found.resimulation.is_exact
    assert found.build_scenario().start.precision == "float64"


def test_a_run_past_the_usual_timeout_is_reproduced_to_its_end() -> None:
    log = make_log(Truth(kp_linear=0.12, timeout_s=math.inf, cut_s=45.0))
    found = identify(log)
    timeout = found.findings["law.timeout_s"]
    assert (timeout.value, timeout.assumed) == (None, math.inf)
    assert "more than the usual 30" in timeout.evidence
    assert found.findings["stop_reason"].value == "cut"
    assert found.resimulation is not None
    assert (found.resimulation.is_exact, found.resimulation.samples) == (True, len(log.rows))


@pytest.mark.everyday("changes1-settled-law.settled_for_s-2.0")
@pytest.mark.parametrize(
    ("changes", "reason", "key", "value"),
    [
        ({"timeout_s": 8.0}, "timeout", "law.timeout_s", 8.0),
        ({"settled_for_s": 2.0, "standstill_below": 1e-9}, "settled", "law.settled_for_s", 2.0),
        ({"standstill_samples": 20}, "standstill", "law.standstill_samples", 20),
    ],
)
def test_another_stop_rule_is_not_told_as_the_usual_one(
    changes: dict[str, float], reason: str, key: str, value: float
) -> None:
    log = make_log(replace(Truth(), **changes))  # type: ignore[arg-type]
    assert log.reason == reason
    found = identify(log).findings
    assert judge(found["stop_reason"], reason) != "exact false"
    stop = found["stop_reason"]
    assert reason in stop.candidates or (stop.value is None and reason in stop.evidence)
    assert (found[key].value, found[key].assumed) == (None, pytest.approx(value, rel=0.02))


@pytest.mark.thorough
def test_a_jump_is_named_and_the_loop_fitted_over_what_is_clean() -> None:
    """A jump leaves the whole search to a fit over the rest."""
    log = make_log(Truth(teleports={320: (6.0, 6.5, 2.4)}))
    found = identify(log)
    assert found.notes[0].startswith("the pose jumps by 1.57 m")
    assert "reproduces the first" in found.notes[1]
    loop = [found.findings[key] for key in ("loop.start_backlog", "law.pause_ticks")]
    assert [(value.value, value.certainty) for value in loop] == [
        (6, Certainty.FITTED), (34, Certainty.FITTED)]  # fmt: skip


def test_a_missing_row_is_named_and_everything_else_exact() -> None:
    log = make_log(Truth())
    found = identify(log.drop([298]))
    assert found.notes == ("1 sample is missing after 5.055 s, for 0.033 s",)
    assert found.findings["loop.start_backlog"].certainty is Certainty.EXACT
    assert found.resimulation is not None
    assert found.resimulation.is_exact is True


@pytest.mark.thorough
def test_a_late_callback_is_no_missing_row() -> None:
    log = make_log(Truth())
    late = [list(row) for row in log.rows]
    for row in range(150, 153):
        # Three callbacks come together, 40 ms late; every pose was answered.
        late[row][0] = late[152][0] + 0.0002 * (row - 152)
    found = identify(replace(log, rows=[tuple(row) for row in late]))
    assert not any("missing" in note for note in found.notes)
    assert found.findings["loop.start_backlog"].certainty is Certainty.EXACT


def test_five_equal_commands_of_the_start_backlog_are_no_limit() -> None:
    log = make_log(Truth(kp_angular=0.27, log_noise=1e-3, cut_s=6.0))
    limit = identify(log).findings["limits.turn_rate_rad_s"]
    assert (limit.value, limit.assumed) == (None, math.inf)


@pytest.mark.parametrize("law", ["pid", "cubic"])
def test_of_another_law_nothing_is_claimed(law: str) -> None:
    found = identify(make_log(Truth(law=law)))
    claims = {key: finding for key, finding in found.findings.items() if key.startswith("l")}
    assert {finding.value for finding in claims.values()} == {None}
    assert "not proportional" in found.notes[0]


@pytest.mark.thorough
def test_the_command_held_in_a_short_pause_is_not_made_up() -> None:
    held = identify(make_log(Truth(pause=2))).findings["pause.held_turn_rate_rad_s"]
    assert held.value is None
    assert "the queue is not empty" in held.evidence
    long = identify(make_log(Truth())).findings["pause.held_turn_rate_rad_s"]
    assert (long.value, long.certainty) == (make_log(Truth()).held, Certainty.EXACT)


def recorded(truth: Truth) -> Run:
    return make_log(truth).to_recording()


def test_a_recording_with_a_pose_per_tick_is_exact_as_well() -> None:
    log = make_log(Truth(delay=2, pause=10))
    found = identify_run(log.to_recording())
    wrong = [key for key, said in score(log, found) if said == "exact false"]
    assert wrong == []
    assert found.findings["loop.transport_delay_ticks"].value == 2


def test_noise_of_a_pose_per_tick_claims_no_bits() -> None:
    rng = np.random.default_rng(1)
    run = recorded(Truth())
    noisy = replace(run.poses, xy_m=run.poses.xy_m + rng.normal(0.0, 1e-2, run.poses.xy_m.shape))
    found = identify_run(replace(run, poses=noisy)).findings
    assert found["loop.pose_precision"].value is None
    assert found["start.x_m"].certainty is not Certainty.EXACT
