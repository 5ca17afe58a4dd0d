"""A metric's first violation is where a run that had ended there would have violated it, too."""

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

import turtlelog as tl
from tests.check.recordings import simulate
from tests.check.test_mutations import build
from turtlelog.check import check_runs, parse_spec, result, spec
from turtlelog.check.result import find_metric_violation
from turtlelog.measure import list_metrics
from turtlelog.run import slice_run, take_rows

RUN = simulate("paper-kp10")
METRICS = tl.measure_run(RUN)
KINDS = list_metrics(RUN.declaration)


def find(name: str, limit: float, operator: str = "<=") -> float | None:
    return find_metric_violation(RUN, METRICS[name], operator, limit)


def test_cross_track_is_violated_where_the_signal_first_is() -> None:
    signal = tl.read_signal(RUN, "cross_track")
    assert signal is not None
    row = int((np.abs(signal.values) > 0.05).argmax())
    assert find("run.cross_track_max", 0.05) == (signal.time_ns[row] - RUN.start_ns) / 1e9


@pytest.mark.parametrize(
    "name", ["rotate.overshoot", "run.path_length", "rotate.iae", "translate.total_variation"]
)
def test_a_run_cut_before_the_first_violation_passes(name: str) -> None:
    value = METRICS[name].value
    assert value is not None
    failed_s = find(name, value / 2)
    assert failed_s is not None
    at_ns = RUN.start_ns + round(failed_s * 1e9)
    cuts = [slice_run(RUN, end_ns=end_ns) for end_ns in (at_ns - 1, at_ns)]
    before, there = (replace(cut, stop_reason=RUN.stop_reason) for cut in cuts)
    values = [tl.measure_run(run, only=[name])[name].value for run in (before, there)]
    assert values[1] is not None
    assert values[1] > value / 2
    assert values[0] is None or values[0] <= value / 2


def test_a_log_of_commands_alone_violates_a_growing_metric_at_a_command() -> None:
    alone = replace(
        RUN,
        poses=take_rows(RUN.poses, slice(0)),
        samples=take_rows(RUN.samples, slice(0)),
        absent=("poses", "samples", "stop_reason"),
    )
    text = 'format = 1\n[checks.it]\nexpect = "run.speed_effort <= 0.01"'
    (found,) = check_runs(parse_spec(text), [("a.mcap", alone)])
    time_s = (alone.commands.time_ns - alone.start_ns) / 1e9
    held_s = np.diff(time_s, append=time_s[-1])
    effort = np.concatenate([[0.0], np.cumsum(held_s * alone.commands.speed_m_s**2)[:-1]])
    assert found.first_violation_s == time_s[(effort > 0.01).argmax()]


@pytest.mark.parametrize(("rest", "has_moment"), [("", True), (" and run.path_length >= 0", False)])
def test_a_bound_on_one_metric_has_a_moment_and_one_on_two_has_none(
    rest: str,
    has_moment: bool,  # noqa: FBT001
) -> None:
    value = METRICS["rotate.overshoot"].value
    assert value is not None
    table = {"expect": f"rotate.overshoot <= {value / 2!r}{rest}"}
    (result,) = check_runs(parse_spec({"checks": {"it": table}}), [("a.mcap", RUN)])
    assert result.verdict == "FAIL"
    moment = find("rotate.overshoot", value / 2)
    assert moment is not None
    assert result.first_violation_s == (moment if has_moment else None)


def measure_parts(change: str) -> list[Mapping[str, tl.Metric]]:
    """Measure a run as if it had ended at each of some times after its first sample."""
    run = build(change)
    ends_ns = np.linspace(run.start_ns, run.end_ns, 25, dtype=np.int64)[1:]
    parts = [slice_run(run, end_ns=int(end_ns)) for end_ns in ends_ns]
    return [tl.measure_run(replace(part, stop_reason=run.stop_reason)) for part in parts]


@pytest.mark.everyday("slow loop", "lost pose")
@pytest.mark.parametrize("change", ["gain", "lag", "wrong direction", "slow loop", "lost pose"])
def test_what_grows_never_falls_while_a_run_goes_on(change: str) -> None:
    parts = measure_parts(change)
    for name, kind in KINDS.items():
        if not kind.grows:
            continue
        values = [part[name].value for part in parts]
        known = [value for value in values if value is not None]
        assert all(after >= before - 1e-12 for before, after in pairwise(known)), name
        assert None not in values[len(values) - len(known) :], name


@pytest.mark.thorough
@pytest.mark.parametrize(
    "name",
    [
        *("rotate.rms_error", "rotate.saturated_share", "rotate.final_error"),
        *("translate.steady_state_error", "translate.saturated_time_share", "translate.rms_error"),
        *("final.position_error", "run.sample_jitter", "run.sample_rate", "run.straightness"),
    ],
)
def test_what_may_fall_again_is_not_said_to_grow(name: str) -> None:
    assert not KINDS[name].grows
    values = [part[name].value for part in measure_parts("gain")]
    known = [value for value in values if value is not None]
    assert any(after < before for before, after in pairwise(known))


def test_what_is_waited_for_is_late_when_its_time_is_over() -> None:
    assert find("rotate.settling_time", 2.0) == 2.0
    spans = RUN.find_phase_spans()
    start_s = (spans[-1].start_ns - RUN.start_ns) / 1e9
    assert find("translate.settling_time", 3.0) == start_s + 3.0


def test_what_is_taken_at_the_end_is_violated_there() -> None:
    assert find("final.position_error", 0.02) == (RUN.end_ns - RUN.start_ns) / 1e9


def test_what_is_taken_15_s_after_the_first_sample_is_violated_there() -> None:
    run = simulate("paper-kp1")
    name = "final.position_error_at_15s"
    assert find_metric_violation(run, tl.measure_run(run)[name], "<=", 0.01) == 15.0
    assert (run.end_ns - run.start_ns) / 1e9 > 20.0


def test_what_belongs_to_the_whole_run_is_violated_at_no_moment() -> None:
    assert find("run.straightness", 1.0) is None


def test_a_share_belongs_to_its_moment_or_to_none() -> None:
    assert find("translate.saturated_share", 0.1) == METRICS["translate.saturated_share"].at_s


def test_a_cut_run_keeps_what_belongs_together() -> None:
    cut = slice_run(RUN, start_ns=2_000_000_000, end_ns=5_000_000_000)
    read_ns = cut.poses.time_ns[cut.samples.pose_sequence]
    assert 2_000_000_000 <= read_ns.min() <= read_ns.max() <= 5_000_000_000
    whole_m = RUN.poses.xy_m[np.isin(RUN.poses.time_ns, cut.poses.time_ns)]
    np.testing.assert_array_equal(cut.poses.xy_m, whole_m)
    assert cut.commands.time_ns.min() >= 2_000_000_000


def test_a_run_whose_end_is_cut_off_does_not_say_why_it_ended() -> None:
    assert slice_run(RUN, end_ns=RUN.end_ns - 1).stop_reason is None
    assert slice_run(RUN, start_ns=2_000_000_000).stop_reason == "standstill"


@pytest.mark.parametrize(
    ("text", "first_s"),
    [
        ("final.position_error <= 0.05", 12.608),
        ("rotate.overshoot <= 0.5", 2.288),
        ("rotate.overshoot <= 0.5 and speed <= 2", 0.0),
    ],
)
def test_what_holds_of_a_metric_is_violated_at_its_moment(text: str, first_s: float) -> None:
    spec = parse_spec({"checks": {"asked": {"holds": text}}})
    (result,) = check_runs(spec, [("kp10", RUN)])
    assert result.first_violation_s == pytest.approx(first_s, abs=1e-3)


def test_many_bounds_on_one_metric_measure_each_part_of_a_run_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ends_ns: list[int] = []

    def count(run: tl.Run, *words: Any, **options: Any) -> Mapping[str, tl.Metric]:
        ends_ns.append(run.end_ns)
        return tl.measure_run(run, *words, **options)

    for module in (result, spec):
        monkeypatch.setattr(module, "measure_run", count)
    checks = {str(n): {"expect": f"run.path_length < {n / 10}"} for n in range(40)}
    results = [*check_runs(parse_spec({"checks": checks}), [("a.mcap", RUN)])]
    assert all(found.first_violation_s is not None for found in results)
    assert len(ends_ns) == len({*ends_ns})
