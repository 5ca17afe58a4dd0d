"""Of a law that is not the sequential proportional one nothing is claimed."""

import re
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import turtlelog as tl
from tests.explain.loop_family import count_true, make_loop_logs
from tests.strange_law import KIND, simulate_strange
from turtlelog.errors import ExplainError, ScenarioError
from turtlelog.explain import (
    Certainty,
    Identification,
    attribute_run,
    find_causes,
    identify_run,
    require_causes,
    simulate_without,
    write_sentences,
)
from turtlelog.explain.scenario_from_log import LAW_KEYS, find_dead_times
from turtlelog.measure import DeadTime, measure_run
from turtlelog.run import Run
from turtlelog.run.loops import Declaration
from turtlelog.scenario import build_scenario, get_preset, nest_parameters, override_scenario
from turtlelog.simulate import simulate_run

OTHERS = "tests/explain/other_laws.py"
PID = f"{OTHERS}:SequentialPid"
WEAVING = f"{OTHERS}:Weaving"
TURN_AND_DRIVE = "examples/turn_and_drive.py:TurnAndDrive"

READING = """
from turtlelog.laws import SequentialP


class Law(SequentialP):
    pass
"""


def simulate_law(kind: str, **parameters: Any) -> Run:
    loop = {"loop.transport_delay_ticks": parameters.pop("transport_delay_ticks", 0)}
    own = {f"law.{key}": value for key, value in parameters.items()}
    values = {"law.kind": kind, **own, **loop}
    return simulate_run(build_scenario(nest_parameters(values), trust_law=True))


def forget(run: Run) -> Run:
    """Return a run that does not name its law."""
    return replace(run, parameters={}, scenario_is_complete=False)


def forget_scenario(run: Run) -> Run:
    """Return a run that names its law, and not its whole scenario."""
    return replace(run, scenario_is_complete=False)


def list_claims(found: Identification) -> list[str]:
    keys = [key for key in LAW_KEYS if key.startswith("law.")]
    return [key for key in keys if found.findings[key].certainty is not Certainty.UNKNOWN]


@pytest.mark.everyday("little I-named", "turn and drive-unnamed", "PID-unnamed")
@pytest.mark.parametrize("forgotten", [False, True], ids=["named", "unnamed"])
@pytest.mark.parametrize(
    ("kind", "parameters"),
    [
        (TURN_AND_DRIVE, {}),
        (PID, {"ki": 0.2, "kd": 0.1}),
        (PID, {"ki": 0.0, "kd": 0.002}),
        (PID, {"ki": 0.001, "kd": 0.0}),
    ],
    ids=["turn and drive", "PID", "little D", "little I"],
)
def test_nothing_is_claimed_of_another_law(
    kind: str, parameters: dict[str, float], *, forgotten: bool
) -> None:
    """That nothing is found shows when the whole search is done."""
    run = simulate_law(kind, **parameters)
    found = identify_run(forget(run) if forgotten else run)
    assert list_claims(found) == []
    assert found.notes


def test_another_law_leaves_the_dead_times_standing_by_loop() -> None:
    found = identify_run(simulate_law(TURN_AND_DRIVE))
    assert found.findings["dead_time.align"].value == 0
    assert found.findings["dead_time.approach"].value == 0
    assert "dead_time.translate" not in found.findings
    assert found.scenario is None


def test_without_loops_dead_times_are_told_by_phase() -> None:
    run = simulate_law(TURN_AND_DRIVE, transport_delay_ticks=3)
    bare = replace(run, declaration=Declaration(phases={"run": ()}))
    assert identify_run(bare).findings["dead_time.run"].value == 3
    still = replace(bare, samples=replace(run.samples, turn_rate_rad_s=0.0 * run.samples.speed_m_s))
    found = find_dead_times(still)["run"]
    assert isinstance(found, DeadTime)  # that of the speed
    assert found.ticks == 3


@pytest.mark.thorough
def test_the_delay_of_another_law_is_named() -> None:
    run = simulate_law(TURN_AND_DRIVE, kp_angular=12.0, transport_delay_ticks=6)
    found = attribute_run(run, metric="run.turn_rate_total_variation", trust_law=True)
    assert (found.as_logged, found.without_all) == pytest.approx((6.435, 1.034), abs=1e-3)
    assert found.as_logged == found.resimulated
    assert [share.cause for share in found.contributions] == ["delay"]
    text = " ".join(write_sentences(found))
    assert "changes it: delay +5.4 rad/s. Without delay it would be 1.034 rad/s." in text
    assert "kp" not in text.lower()
    assert "tolerance" not in text


@pytest.mark.thorough
def test_the_causes_of_a_law_take_part() -> None:
    run = simulate_strange(loop__transport_delay_ticks=6)
    found = attribute_run(run, metric="run.duration", trust_law=True)
    assert found.causes == ("delay", "hesitation")
    assert (*found.effects[:2], found.effects[-1]) == ("queue", "delay", "hesitation")
    shares = {share.cause: share for share in found.contributions}
    assert shares["hesitation"].meaning == "no stop between the phases"
    alone = measure_run(simulate_strange(loop__transport_delay_ticks=6, law__hesitates_ticks=0))
    assert shares["hesitation"].alone == alone["run.duration"].value
    assert found.resolution.reason == "one sample period"


@pytest.mark.parametrize("trust_law", [False, True], ids=["read", "simulated again"])
def test_the_end_of_the_time_is_told_as_recorded(*, trust_law: bool) -> None:
    run = simulate_strange(max_duration_s=8.3, limits__turn_rate_rad_s=0.05)
    found = identify_run(run, trust_law=trust_law).findings["stop_reason"]
    assert (found.value, found.certainty) == ("max_duration", Certainty.EXACT)
    assert found.evidence == "as recorded: no rule of the law had ended the run"


def test_a_metric_of_a_loop_that_the_law_does_not_declare_is_refused_at_once() -> None:
    run = simulate_strange()
    expected = 'no metric "rotate.settling_time"; did you mean b.settling_time'
    with pytest.raises(ExplainError, match=re.escape(expected)):
        require_causes(run, "rotate.settling_time", None)
    with pytest.raises(ExplainError, match=re.escape('no metric "c.iae"; did you mean b.iae')):
        attribute_run(run, metric="c.iae", trust_law=True)


def test_ticks_that_seconds_add_to_are_told_as_recorded() -> None:
    changes = {"loop.transport_delay_s": 0.1, "max_duration_s": 4.0}
    found = identify_run(simulate_run(override_scenario(get_preset("posture"), changes))).findings
    delay = found["loop.transport_delay_ticks"]
    assert (delay.value, delay.certainty, delay.evidence) == (
        0,
        Certainty.RECORDED,
        "and 0.1 s more",
    )


@pytest.mark.parametrize("preset", ["posture", "textbook"])
def test_a_timer_answers_no_number_of_ticks(preset: str) -> None:
    changes = {"loop.trigger": "timer", "loop.period_s": 0.19, "max_duration_s": 4.0}
    found = identify_run(simulate_run(override_scenario(get_preset(preset), changes))).findings
    period = found["loop.period_ticks"]
    assert (period.value, period.assumed) == (None, 1)
    assert period.evidence == "a timer asks for answers, every 0.19 s as recorded"


@pytest.mark.thorough
def test_an_ending_names_the_phase_of_another_law() -> None:
    run = simulate_strange(max_duration_s=8.3, limits__turn_rate_rad_s=0.05)
    (share,) = (
        one
        for one in attribute_run(run, metric="run.duration", trust_law=True).others
        if one.cause == "saturation"
    )
    assert share.ending == "phase one ends within 8.3 s"


def test_what_a_trusted_law_reproduces_tells_the_loop() -> None:
    run = simulate_strange(loop__start_backlog=4, loop__queue_policy="one-per-tick")
    found = identify_run(run, trust_law=True)
    assert (found.law, found.is_recorded) == (KIND, True)
    assert found.notes[-1] == f"the recorded scenario reproduces all {len(run.samples)} samples"
    assert found.resimulation is not None
    assert found.resimulation.is_exact
    values = {"loop.start_backlog": 4, "loop.queue_policy": "one-per-tick", "dead_time.a": 3,
              "dead_time.b": 6, "stop_reason": "arrived"}  # fmt: skip
    for key, value in values.items():
        assert (found.findings[key].value, found.findings[key].certainty) == (value, "exact")
    assert list_claims(found) == []
    assert found.tried["loop.queue_policy"] == ("newest", "one-per-tick")


@pytest.mark.thorough
def test_an_untrusted_law_is_not_run(tmp_path: Path) -> None:
    mark = tmp_path / "mark"
    law = tmp_path / "law.py"
    law.write_text(f"import pathlib\npathlib.Path({str(mark)!r}).touch()\n{READING}")
    run = simulate_law(f"{law}:Law")
    mark.unlink()
    law.write_text(law.read_text() + "\n")  # edited: it would be loaded again
    found = identify_run(run)
    assert found.scenario is None
    assert "is not tested, as the code of its law is not trusted" in found.notes[-1]
    with pytest.raises(ScenarioError, match="--trust-law"):
        attribute_run(run)
    assert not mark.exists()
    assert attribute_run(run, trust_law=True).resimulated is not None
    assert mark.exists()


@pytest.mark.thorough
def test_without_its_law_the_settings_that_move_the_plant_are_fitted() -> None:
    run = simulate_law(TURN_AND_DRIVE, transport_delay_ticks=6)
    findings = identify_run(run).findings
    delay = findings["loop.transport_delay_ticks"]
    assert (delay.value, delay.certainty) == (6, "fitted")
    assert "the plant driven with the log's commands; as likely is any delay" in delay.evidence
    assert findings["loop.pose_queue"].value is None
    assert findings["stop_reason"].value is None


@pytest.mark.parametrize(("off", "reproduces"), [(9e-10, True), (1.1e-9, False)])
def test_a_recorded_scenario_must_reproduce_every_sample(off: float, *, reproduces: bool) -> None:
    run = simulate_strange()
    speed = run.samples.speed_m_s.copy()
    speed[300] += off
    changed = replace(run, samples=replace(run.samples, speed_m_s=speed))
    found = identify_run(changed, trust_law=True)
    assert (found.scenario is not None) == reproduces
    if reproduces:
        return
    assert found.notes[-1].startswith(
        "the recorded scenario reproduces the first 300 samples and departs at "
    )
    with pytest.raises(ExplainError, match=r"departs at .* nothing is claimed of the law"):
        attribute_run(changed, trust_law=True)


def test_a_run_that_was_cut_is_simulated_as_far_as_it_goes() -> None:
    run = replace(simulate_strange(max_duration_s=5.0), stop_reason="interrupted")
    run = replace(run, parameters={**run.parameters, "max_duration_s": 60.0})
    found = identify_run(run, trust_law=True)
    assert found.build_scenario().max_duration_s == 4.992
    assert found.findings["stop_reason"].evidence == "the run was cut"


@pytest.mark.thorough
def test_sampling_is_not_offered_where_a_law_does_not_say_what_counts_samples() -> None:
    run = simulate_law(f"{OTHERS}:Silent", gain_a=4.0)
    found = attribute_run(run, trust_law=True)
    assert "sampling" not in {share.cause for share in found.others}
    assert write_sentences(found)[-1] == (
        f"Sampling is not removed, because the law {OTHERS}:Silent does not say which of its"
        " parameters count samples (counts_samples)."
    )
    with pytest.raises(ExplainError, match="sampling is not removed"):
        attribute_run(run, causes=["sampling"], trust_law=True)
    with pytest.raises(ExplainError, match='no cause "luck"; list: turtlelog list causes'):
        attribute_run(run, causes=["luck"], trust_law=True)


def test_parameters_that_count_samples_last_as_long_on_a_finer_clock() -> None:
    values = {"law.kind": f"{OTHERS}:Counting", "law.samples": 50}
    scenario = override_scenario(get_preset("textbook"), values)
    coarse, fine = simulate_run(scenario), simulate_without(scenario, ["sampling"])
    assert (len(coarse.samples), len(fine.samples)) == (50, 400)
    assert fine.parameters["law.samples"] == 50


def test_two_causes_of_one_name_are_refused() -> None:
    scenario = override_scenario(get_preset("textbook"), {"law.kind": f"{OTHERS}:Clashing"})
    with pytest.raises(ExplainError, match=r"expected a name that no other cause has.*'delay'"):
        find_causes(scenario)


@pytest.mark.thorough
def test_the_recorded_scenario_of_the_sequential_law_stands_where_none_is_found() -> None:
    """That none is found shows when the whole search is done, twice."""
    values = {"loop.transport_delay_ticks": 45, "law.kp_linear": 0.5, "law.kp_angular": 0.5}
    run = simulate_run(override_scenario(get_preset("textbook"), values))
    found = identify_run(run)
    assert found.is_recorded
    assert found.notes[0].startswith("the recorded scenario reproduces all ")
    shares = attribute_run(run, metric="rotate.overshoot", identified=found).contributions
    assert [share.cause for share in shares] == ["delay"]
    assert identify_run(forget_scenario(run)).is_recorded is False


@pytest.mark.parametrize(("limit", "clipped"), [(0.967, True), (0.968, False)])
def test_a_limit_is_known_where_a_law_wanted_more(limit: float, *, clipped: bool) -> None:
    run = simulate_strange(limits__speed_m_s=limit, law__gain_b=0.17)
    finding = identify_run(run).findings["limits.speed_m_s"]  # 0.9679 m/s was wanted
    assert finding.value == (limit if clipped else None)


UNUSUAL = {"start_backlog": 10, "pose_queue": 2, "command_queue": 4, "transport_delay_ticks": 5}


def simulate_loop(kind: str, **loop: Any) -> Run:
    values = {"law.kind": kind, **{key.replace("__", "."): value for key, value in loop.items()}}
    return simulate_run(build_scenario(nest_parameters(values), trust_law=True))


@pytest.mark.everyday("trusted")
@pytest.mark.parametrize("trusts", [True, False], ids=["trusted", "not trusted"])
def test_unusual_queues_are_not_told_as_others(*, trusts: bool) -> None:
    loop = {f"loop__{key}": value for key, value in UNUSUAL.items()}
    run = simulate_loop(WEAVING, **loop, loop__queue_policy="newest")
    findings = identify_run(run, trust_law=trusts).findings
    for key in ("loop.start_backlog", "loop.transport_delay_ticks", "loop.pose_queue"):
        finding = findings[key]
        assert finding.value == UNUSUAL[key.removeprefix("loop.")]
        assert finding.certainty == ("exact" if trusts else "fitted")
    policy = findings["loop.queue_policy"]
    assert "newest" in (policy.candidates or (policy.value,))
    assert findings["loop.command_queue"].evidence == "a deeper queue gives the same run"


def test_recorded_settings_that_reproduce_a_law_with_naps_are_found() -> None:
    run = simulate_loop(WEAVING, law__nap_ticks=12, loop__queue_policy="one-per-tick")
    found = identify_run(run, trust_law=True)
    delay, policy = (
        found.findings[f"loop.{key}"] for key in ("transport_delay_ticks", "queue_policy")
    )
    assert (delay.value, delay.certainty) == (0, "exact")
    assert (policy.value, policy.certainty) == ("one-per-tick", "exact")
    assert found.findings["lost_commands"].value is not None
    dead_time = found.findings["dead_time.control"]
    assert dead_time.value is None
    assert dead_time.evidence.startswith("no single dead time explains the motion")


@pytest.mark.thorough
def test_of_a_law_that_is_not_deterministic_nothing_is_claimed() -> None:
    """The search tries every setting before it gives up."""
    found = identify_run(simulate_loop(f"{OTHERS}:Tiring"), trust_law=True)
    assert (found.scenario, found.resimulation) == (None, None)
    assert "its law is not deterministic" in found.notes[-1]


@pytest.mark.parametrize(("kind", "is_known"), [("Counting7", False), ("Restarting7", True)])
def test_a_law_that_counts_its_calls_is_not_deterministic(kind: str, *, is_known: bool) -> None:
    """All runs of 126 samples are alike, as the law has a period of seven calls."""
    values = {"law.kind": f"{OTHERS}:{kind}", "max_duration_s": 2.0}
    run = simulate_run(override_scenario(get_preset("textbook"), values))
    assert len(run.samples) == 126
    found = identify_run(run, trust_law=True)
    assert found.is_recorded is is_known
    assert ("its law is not deterministic" in found.notes[-1]) is not is_known


def test_where_the_first_samples_are_lost_the_start_backlog_is_open() -> None:
    run = simulate_strange(loop__start_backlog=3, loop__transport_delay_ticks=3)
    kept = {
        name: column[5:]
        for name, column in vars_of(run.samples).items()
        if isinstance(column, np.ndarray)
    }
    found = identify_run(replace(run, samples=replace(run.samples, **kept)), trust_law=True)
    backlog = found.findings["loop.start_backlog"]
    assert 3 in (backlog.candidates or (backlog.value,))


def vars_of(columns: Any) -> dict[str, Any]:
    return {field.name: getattr(columns, field.name) for field in fields(columns)}


@pytest.mark.thorough
def test_what_reproduces_to_rounding_is_not_said_to_be_bit_for_bit() -> None:
    """The search runs to its end."""
    run = simulate_loop(WEAVING)
    changed = replace(run, parameters={**run.parameters, "law.gain": 2.0 + 1e-12})
    assert (
        identify_run(changed, trust_law=True)
        .notes[-1]
        .endswith("samples to rounding, not bit for bit")
    )


@pytest.mark.thorough
@pytest.mark.everyday("other queues")
@pytest.mark.parametrize("is_usual", [True, False], ids=["usual queues", "other queues"])
def test_what_is_said_of_the_loops_of_other_laws_is_true(*, is_usual: bool) -> None:
    """Shares of what is found show in many logs: 12 for each of several laws."""
    said = count_true(make_loop_logs(5, 12, is_usual=is_usual))
    assert {key for key in said if key[1].endswith(" false")} == set()
    assert sum(count for (_, how), count in said.items() if how == "fitted true") > 26
    assert sum(count for (_, how), count in said.items() if how == "exact true") > 9


@pytest.mark.parametrize(
    ("preset", "metric"),
    [
        ("paper-kp10", "final.position_error"),
        ("posture", "final.position_error"),
        ("track-square", "cross.rms_error"),
        ("plant-step", "run.path_length"),
    ],
)
def test_what_matters_most_to_a_law_is_explained_where_no_metric_is_named(
    preset: str, metric: str
) -> None:
    declaration = tl.simulate.declare_scenario(tl.load_scenario(preset))
    assert tl.explain.choose_metric(declaration) == metric
