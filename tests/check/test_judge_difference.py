import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import turtlelog as tl
from tests.compare.runs import change_rows, make_run
from turtlelog.check import judge_replay
from turtlelog.replay.differences import Pairing, compare_pairing

KP4 = tl.simulate_run(tl.load_scenario("paper-kp4"))
KP1 = tl.simulate_run(tl.load_scenario("paper-kp1"))
OWN = ["x", "y", "heading", "speed", "turn_rate", "wanted_speed", "wanted_turn_rate"]
HELD = [name for name in tl.SIGNALS if not name.startswith(("sensed_", "shaped_", "measured_"))]
"""Without a sensor and without shaping."""
DERIVED = {
    "x": ["error_x", "distance", "along_track", "cross_track"],
    "y": ["error_y", "distance", "along_track", "cross_track"],
    "heading": ["heading_error"],
}


def hold_signals_to(limit: float) -> tl.Tolerances:
    labels = [name for name, kind in tl.SIGNALS.items() if kind.compared_as == "label"]
    return tl.Tolerances(
        signals={
            name: tl.Tolerance(abs=0.0 if name in labels else limit, reason="test") for name in HELD
        }
    )


def list_failed(run: tl.Run, limit: float, alignment: str = "first_sample") -> set[str]:
    results = tl.check.match_run(run, KP4, hold_signals_to(limit), alignment=alignment)
    assert {result.check for result in results} == {f"signals.{name}" for name in HELD}
    failed = {result.check for result in results if result.verdict == "FAIL"}
    return {name.removeprefix("signals.") for name in failed}


@pytest.mark.everyday("sample-x", "first_sample-heading", "recorded-wanted_speed")
@pytest.mark.parametrize("signal", OWN)
@pytest.mark.parametrize("alignment", ["first_sample", "recorded", "sample"])
@given(row=st.integers(6, 680), by=st.floats(1.0001e-3, 0.1), sign=st.sampled_from([-1, 1]))
@settings(max_examples=15, deadline=None)
def test_a_change_above_its_tolerance_is_found_in_every_signal(
    signal: str, alignment: str, row: int, by: float, sign: int
) -> None:
    failed = list_failed(change_rows(KP4, signal, [row], sign * by), 1e-3, alignment)
    was_read = row in KP4.samples.pose_sequence or alignment != "sample" or signal not in DERIVED
    assert (signal in failed) == was_read
    assert failed <= {signal, *DERIVED.get(signal, [])}


@pytest.mark.parametrize("signal", OWN)
@given(row=st.integers(6, 680), by=st.floats(-0.999e-3, 0.999e-3))
@settings(max_examples=15, deadline=None)
def test_a_change_below_its_tolerance_is_not_reported(signal: str, row: int, by: float) -> None:
    assert list_failed(change_rows(KP4, signal, [row], by), 1e-3) == set()


@pytest.mark.parametrize("alignment", ["first_sample", "recorded", "sample"])
@given(row=st.integers(1, 680))
@settings(max_examples=20, deadline=None)
def test_every_changed_phase_is_found_also_within_a_burst(alignment: str, row: int) -> None:
    phase = KP4.samples.phase[row]
    assert "phase" in list_failed(
        change_rows(KP4, "phase", [row], 2 - 2 * phase or -2), 1, alignment
    )


def test_the_margin_and_the_first_time_outside_are_told() -> None:
    run = change_rows(change_rows(KP4, "x", [105], 0.002), "x", [205], -0.005)
    tolerances = tl.Tolerances(signals={"x": tl.Tolerance(abs=0.001)})
    (result,) = tl.check.match_run(run, KP4, tolerances)
    assert result.first_violation_s == pytest.approx(100 * 0.016)
    assert result.value_s == pytest.approx(200 * 0.016)
    assert result.margin == pytest.approx(-0.004)


@pytest.mark.parametrize("lacks", ["reference", "run"])
def test_a_signal_that_is_not_there_fails(lacks: str) -> None:
    samples = dataclasses.replace(KP4.samples, wanted_speed_m_s=None)
    poor = dataclasses.replace(KP4, samples=samples, name="poor")
    tolerances = tl.Tolerances(signals={"wanted_speed": tl.Tolerance(abs=1e6)})
    reference, run = (poor, KP4) if lacks == "reference" else (KP4, poor)
    (result,) = tl.check.match_run(run, reference, tolerances)
    assert (result.verdict, result.is_decided) == ("FAIL", False)
    assert result.reason == "poor does not hold it"


def judge_metric(
    reference: tl.Run, run: tl.Run, name: str, **limits: float
) -> tl.check.CheckResult:
    tolerances = tl.Tolerances(metrics={name: tl.Tolerance(reason="", **limits)})
    (result,) = tl.check.match_run(run, reference, tolerances)
    return result


def test_a_metric_fails_only_in_its_bad_direction() -> None:
    longer = judge_metric(KP4, KP1, "run.duration", abs=1.0)
    assert (longer.verdict, longer.limit) == ("FAIL", 1.0)
    assert longer.reason == "20.528 s where the reference has 11.184 s"
    assert longer.margin == pytest.approx(1.0 - (20.528 - 11.184))
    shorter = judge_metric(KP1, KP4, "run.duration", abs=1.0)
    assert (shorter.verdict, shorter.reason) == ("PASS", "")
    assert shorter.margin == pytest.approx(1.0 + (20.528 - 11.184))


def test_the_larger_of_both_limits_of_a_metric_holds() -> None:
    assert judge_metric(KP4, KP1, "run.duration", abs=0.1, rel=0.9).verdict == "PASS"
    assert judge_metric(KP4, KP1, "run.duration", abs=0.1, rel=0.8).verdict == "FAIL"


@pytest.mark.parametrize(("better", "judged"), [("higher", ["PASS", "FAIL"]), (None, ["FAIL"] * 2)])
def test_a_metric_of_another_direction_is_judged_by_that(
    better: str | None, judged: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    kind = dataclasses.replace(tl.METRICS["run.duration"], better=better)  # type: ignore[arg-type]
    monkeypatch.setattr("turtlelog.measure.find_metric_kind", lambda _: kind)
    pairs = [(KP4, KP1), (KP1, KP4)]
    assert [judge_metric(*pair, "run.duration", abs=1.0).verdict for pair in pairs] == judged


def cut(max_duration_s: float) -> tl.Run:
    scenario = tl.load_scenario("paper-kp4")
    return tl.simulate_run(tl.override_scenario(scenario, {"max_duration_s": max_duration_s}))


def test_a_metric_of_another_status_fails_with_the_reason() -> None:
    for runs in ((KP4, cut(1.5)), (cut(1.5), KP4)):
        result = judge_metric(*runs, "translate.duration", abs=1e6)
        assert (result.verdict, result.is_decided) == ("FAIL", False)
        assert "no_phase (the run has no phase translate)" in result.reason


def test_a_metric_that_neither_has_says_so_and_passes_where_metrics_are_the_reference() -> None:
    name, reason = "translate.duration", "same status as the reference: no_phase"
    result = judge_metric(cut(1.5), cut(1.6), name, abs=0.0)
    assert (result.verdict, result.is_decided) == ("FAIL", False)
    assert result.reason.startswith(reason)
    metrics = {name: tl.measure_run(cut(1.5))[name]}
    (result,) = tl.check.match_run(cut(1.6), metrics)
    assert (result.verdict, result.is_decided) == ("PASS", True)
    assert result.reason.startswith(reason)


def test_a_run_is_as_it_is_with_no_tolerance_at_all() -> None:
    results = tl.check.match_run(KP4, KP4, hold_signals_to(0.0))
    assert tl.check.join_verdicts(results) == "PASS"
    assert {(result.value, result.limit) for result in results} == {(0.0, 0.0)}


def test_by_sample_numbers_no_tolerance_in_time_applies_and_the_result_says_so() -> None:
    tolerances = tl.Tolerances(signals={"x": tl.Tolerance(abs=10.0, time_s=1.0)})
    (result,) = tl.check.match_run(KP1, KP4, tolerances, alignment="sample")
    text = "within 10 m of the reference"
    assert result.expected == f"{text}, sample by sample: no tolerance in time applies"
    (result,) = tl.check.match_run(KP1, KP4, tolerances)
    assert result.expected == f"{text} within 1 s"


@pytest.mark.parametrize("alignment", ["first_sample", "recorded", "sample"])
def test_runs_of_one_sample_can_be_compared(alignment: str) -> None:
    reference = make_run(sample_time_s=[0.0], speed_m_s=[0.5])
    other = make_run(sample_time_s=[0.0], speed_m_s=[0.25])
    tolerances = tl.Tolerances(signals={"speed": tl.Tolerance(abs=0.2, time_s=0.5)})
    (result,) = tl.check.match_run(other, reference, tolerances, alignment=alignment)
    assert result.margin == pytest.approx(-0.05)


@pytest.mark.parametrize("alignment", ["first_sample", "phase:translate", "recorded", "sample"])
def test_times_count_from_the_first_sample_however_runs_are_aligned(alignment: str) -> None:
    row = int(np.flatnonzero(KP4.samples.phase == KP4.phase_names.index("translate"))[100])
    changed = change_rows(KP4, "speed", [row], 0.1)
    tolerances = tl.Tolerances(signals={"speed": tl.Tolerance(abs=0.01)})
    (result,) = tl.check.match_run(changed, KP4, tolerances, alignment=alignment)
    at_s = (KP4.samples.time_ns[row] - KP4.start_ns) / 1e9
    assert (result.first_violation_s, result.value_s) == (at_s, at_s)
    assert f"at {at_s:.3f} s" in result.reason


def test_a_label_that_differs_fails_whatever_the_tolerance() -> None:
    changed = change_rows(KP4, "phase", [300], -2)
    results = judge_replay(changed, tl.replay_law(changed, tolerance=5.0), file="a")
    (failed,) = [result for result in results if result.verdict == "FAIL"]
    assert (failed.check, failed.value, failed.limit, failed.margin) == ("law.phase", 1.0, 0.0, -1)
    assert failed.reason == "recorded rotate, the law answers translate"


def test_a_value_on_one_side_only_fails_without_a_distance() -> None:
    pairing = Pairing(
        signal="reference_x",
        unit="m",
        time_ns=KP4.samples.time_ns[:3],
        recorded=np.array([1.0, np.nan, 1.0]),
        replayed=np.array([1.0, 2.0, 1.05]),
    )
    signals = (compare_pairing(pairing, tolerance=0.1),)
    replayed = dataclasses.replace(tl.replay_law(KP4), signals=signals)
    (failed,) = judge_replay(KP4, replayed, file="a")
    assert (failed.verdict, failed.value, failed.margin) == ("FAIL", None, None)
    assert failed.reason == "recorded none, the law answers 2.0"


@pytest.mark.parametrize(("tolerance", "verdict"), [(0.0999, "FAIL"), (0.1001, "PASS")])
def test_the_tolerance_of_a_replay_is_its_limit(tolerance: float, verdict: str) -> None:
    changed = change_rows(KP4, "wanted_speed", [300], 0.1)
    results = judge_replay(changed, tl.replay_law(changed, tolerance=tolerance), file="a")
    found = {result.check: result for result in results}["law.wanted_speed"]
    assert (found.verdict, found.limit) == (verdict, tolerance)
    assert found.value == pytest.approx(0.1)
    assert tl.check.join_verdicts(results) == verdict


def test_a_difference_of_just_the_limit_passes_and_the_next_one_fails() -> None:
    values = [tl.measure_run(run)["run.duration"].value or 0.0 for run in (KP1, KP4)]
    loss = values[0] - values[1]
    less = float(np.nextafter(loss, 0.0))
    verdicts = [judge_metric(KP4, KP1, "run.duration", abs=limit).verdict for limit in (loss, less)]
    assert verdicts == ["PASS", "FAIL"]
    changed = change_rows(KP4, "speed", [300], 0.25)
    off = float(abs(changed.samples.speed_m_s - KP4.samples.speed_m_s).max())
    for limit, verdict in ((off, "PASS"), (float(np.nextafter(off, 0.0)), "FAIL")):
        tolerances = tl.Tolerances(signals={"speed": tl.Tolerance(abs=limit)})
        (result,) = tl.check.match_run(changed, KP4, tolerances)
        assert (result.verdict, result.value) == (verdict, off)
        assert result.first_violation_s == (None if verdict == "PASS" else result.value_s)


@pytest.mark.parametrize(("later_ns", "verdict"), [(1000, "PASS"), (1001, "FAIL")])
def test_runs_are_as_long_to_a_microsecond(later_ns: int, verdict: str) -> None:
    reference = make_run(sample_time_s=[0.0, 1.0], speed_m_s=[0.5, 0.5])
    time_ns = reference.poses.time_ns + np.array([0, later_ns])
    longer = dataclasses.replace(
        reference, poses=dataclasses.replace(reference.poses, time_ns=time_ns)
    )
    found = {result.check: result for result in tl.check.match_run(longer, reference)}["length"]
    assert (found.verdict, found.limit) == (verdict, 1e-6)


def test_one_tolerance_in_time_is_one_for_the_length_too() -> None:
    reference, longer = (make_run(time_s=(0.0, end_s)) for end_s in (1.0, 1.5))
    for time_s, verdict in ((0.49, "FAIL"), (0.5, "PASS")):
        tolerance = tl.Tolerance(abs=9.0, time_s=time_s)
        found = {
            result.check: result for result in tl.check.match_run(longer, reference, tolerance)
        }
        assert (found["length"].verdict, found["length"].value) == (verdict, 0.5)
