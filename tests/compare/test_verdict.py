import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import turtlelog as tl
from tests.compare.runs import change_rows, make_run
from turtlelog.errors import CompareError

KP4 = tl.simulate_run(tl.load_scenario("paper-kp4"))
KP1 = tl.simulate_run(tl.load_scenario("paper-kp1"))
OWN = ["x", "y", "heading", "speed", "turn_rate", "wanted_speed", "wanted_turn_rate"]
DERIVED = {
    "x": ["error_x", "distance", "along_track", "cross_track"],
    "y": ["error_y", "distance", "along_track", "cross_track"],
    "heading": ["heading_error"],
}


def hold_signals_to(limit: float) -> tl.Tolerances:
    labels = [name for name, kind in tl.SIGNALS.items() if kind.compared_as == "label"]
    return tl.Tolerances(
        signals={
            name: tl.Tolerance(abs=0.0 if name in labels else limit, reason="test")
            for name in tl.SIGNALS
        }
    )


def list_failed(run: tl.Run, limit: float, alignment: str = "first_sample") -> set[str]:
    comparison = tl.compare_runs(KP4, run, alignment=alignment, tolerances=hold_signals_to(limit))
    assert {finding.name for finding in comparison.findings} == set(tl.SIGNALS)
    return {finding.name for finding in comparison.findings if not finding.within}


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
    (finding,) = tl.compare_runs(KP4, run, tolerances=tolerances).findings
    assert finding.first_outside_s == pytest.approx(100 * 0.016)
    assert finding.at_s == pytest.approx(200 * 0.016)
    assert finding.margin == pytest.approx(-0.004)


@pytest.mark.parametrize("lacks", ["reference", "run"])
def test_a_signal_that_is_not_there_fails(lacks: str) -> None:
    samples = dataclasses.replace(KP4.samples, wanted_speed_m_s=None)
    poor = dataclasses.replace(KP4, samples=samples, name="poor")
    tolerances = tl.Tolerances(signals={"wanted_speed": tl.Tolerance(abs=1e6)})
    runs = (poor, KP4) if lacks == "reference" else (KP4, poor)
    comparison = tl.compare_runs(*runs, tolerances=tolerances)
    assert comparison.verdict == "fail"
    assert comparison.findings[0].reason == "poor does not hold it"


def judge_metric(reference: tl.Run, run: tl.Run, name: str, **limits: float) -> tl.Finding:
    tolerances = tl.Tolerances(metrics={name: tl.Tolerance(reason="", **limits)})
    return tl.compare_runs(reference, run, tolerances=tolerances).findings[0]


def test_a_metric_fails_only_in_its_bad_direction() -> None:
    longer = judge_metric(KP4, KP1, "run.duration", abs=1.0)
    assert (longer.within, longer.value, longer.reference) == (False, 20.528, 11.184)
    assert longer.margin == pytest.approx(1.0 - (20.528 - 11.184))
    shorter = judge_metric(KP1, KP4, "run.duration", abs=1.0)
    assert shorter.within
    assert shorter.margin == pytest.approx(1.0 + (20.528 - 11.184))


def test_the_larger_of_both_limits_of_a_metric_holds() -> None:
    assert judge_metric(KP4, KP1, "run.duration", abs=0.1, rel=0.9).within
    assert not judge_metric(KP4, KP1, "run.duration", abs=0.1, rel=0.8).within


@pytest.mark.parametrize(("better", "judged"), [("higher", [True, False]), (None, [False] * 2)])
def test_a_metric_of_another_direction_is_judged_by_that(
    better: str | None, judged: list[bool], monkeypatch: pytest.MonkeyPatch
) -> None:
    from turtlelog.compare import verdict

    kind = dataclasses.replace(tl.METRICS["run.duration"], better=better)  # type: ignore[arg-type]
    monkeypatch.setattr(verdict, "find_metric_kind", lambda _: kind)
    pairs = [(KP4, KP1), (KP1, KP4)]
    assert [judge_metric(*pair, "run.duration", abs=1.0).within for pair in pairs] == judged


def cut(max_duration_s: float) -> tl.Run:
    scenario = tl.load_scenario("paper-kp4")
    return tl.simulate_run(tl.override_scenario(scenario, {"max_duration_s": max_duration_s}))


def test_a_metric_of_another_status_fails_with_the_reason() -> None:
    for runs in ((KP4, cut(1.5)), (cut(1.5), KP4)):
        finding = judge_metric(*runs, "translate.duration", abs=1e6)
        assert not finding.within
        assert "no_phase (the run has no phase translate)" in finding.reason


def test_a_metric_that_neither_has_passes_and_says_so() -> None:
    finding = judge_metric(cut(1.5), cut(1.6), "translate.duration", abs=0.0)
    assert finding.within
    assert finding.reason.startswith("same status as the reference: no_phase")


def test_without_tolerances_there_is_no_verdict() -> None:
    assert tl.compare_runs(KP4, KP1).verdict is None
    comparison = tl.compare_runs(KP4, KP4, tolerances=hold_signals_to(0.0))
    assert comparison.verdict == "pass"


def test_runs_are_brought_together_at_the_start_of_a_phase() -> None:
    comparison = tl.compare_runs(KP4, KP1, alignment="phase:translate")
    largest = {found.signal: found.largest for found in comparison.signals}
    assert largest["phase"] == 0.0
    assert (comparison.overlap_from_s, comparison.alignment) == (0.0, "phase:translate")
    starts = [
        next(span.start_ns for span in run.find_phase_spans() if span.phase == "translate")
        for run in (KP4, KP1)
    ]
    ends = [run.end_ns - start for run, start in zip((KP4, KP1), starts, strict=True)]
    assert comparison.overlap_s == min(ends) / 1e9


def test_recorded_times_are_compared_as_they_are() -> None:
    time_s = np.arange(100) * 0.1
    early, late = (
        make_run(time_s=time_s + zero_s, x_m=time_s, sample_time_s=[zero_s], speed_m_s=[0.0])
        for zero_s in (0.0, 2.0)
    )
    comparison = tl.compare_runs(early, late, alignment="recorded")
    assert (comparison.overlap_from_s, comparison.overlap_s) == (2.0, 7.9)
    assert comparison.signals[0].largest == pytest.approx(2.0)
    assert tl.compare_runs(early, late).signals[0].largest == 0.0


def test_samples_are_compared_by_their_number_with_the_poses_that_they_read() -> None:
    late = dataclasses.replace(
        KP4, samples=dataclasses.replace(KP4.samples, time_ns=KP4.samples.time_ns + 5_000_000)
    )
    comparison = tl.compare_runs(KP4, late, alignment="sample")
    assert {found.largest for found in comparison.signals} == {0.0}


def test_what_sample_numbers_leave_out_is_noted() -> None:
    tolerances = tl.Tolerances(signals={"x": tl.Tolerance(abs=10.0, time_s=1.0)})
    notes = tl.compare_runs(KP4, KP1, alignment="sample", tolerances=tolerances).notes
    assert notes[0] == "681 samples are compared by number: paper-kp4 has 681, paper-kp1 1265."
    assert notes[1] == "Aligned by the number of samples, no tolerance in time applies."


@pytest.mark.parametrize(
    ("alignment", "message"),
    [
        (
            "phase:done",
            "paper-kp4: expected a phase done to align at, found rotate, pause, translate",
        ),
        ("phase:translat", "alignment: expected phase:translate, .* or .*, found 'phase:translat'"),
        ("", "alignment: expected first_sample, .* or .*, found ''"),
    ],
)
def test_what_cannot_be_aligned_is_told(alignment: str, message: str) -> None:
    with pytest.raises(CompareError, match=message):
        tl.compare_runs(KP4, KP1, alignment=alignment)


def test_runs_without_samples_have_no_numbers_to_align_by() -> None:
    with pytest.raises(CompareError, match="bag: expected samples to align by number, found none"):
        tl.compare_runs(KP4, make_run(name="bag"), alignment="sample")


def test_recorded_times_that_do_not_overlap_are_refused() -> None:
    runs = [make_run(time_s=(start, start + 1.0), name=f"at-{start}") for start in (0, 5)]
    with pytest.raises(CompareError, match=r"found 0.00 to 1.00 s and 5.00 to 6.00 s"):
        tl.compare_runs(*runs, alignment="recorded")


@pytest.mark.parametrize("alignment", ["first_sample", "recorded", "sample"])
def test_runs_of_one_sample_can_be_compared(alignment: str) -> None:
    run = make_run(sample_time_s=[0.0], speed_m_s=[0.5])
    other = make_run(sample_time_s=[0.0], speed_m_s=[0.25])
    tolerances = tl.Tolerances(signals={"speed": tl.Tolerance(abs=0.2, time_s=0.5)})
    comparison = tl.compare_runs(run, other, alignment=alignment, tolerances=tolerances)
    assert comparison.findings[0].margin == pytest.approx(-0.05)
