import dataclasses

import numpy as np
import pytest
from hypothesis import given, strategies as st

import turtlelog as tl
from tests.compare.runs import make_run
from tests.effects_cases import build_case
from turtlelog.display import parse_utc
from turtlelog.errors import CompareError

KP4 = tl.simulate_run(tl.load_scenario("paper-kp4"))
KP1 = tl.simulate_run(tl.load_scenario("paper-kp1"))
HELD = {name for name in tl.SIGNALS if not name.startswith(("sensed_", "shaped_", "measured_"))}
"""Without a sensor and without shaping."""


def shift_poses(run: tl.Run, row: int, by_m: float) -> tl.Run:
    xy_m = run.poses.xy_m.copy()
    xy_m[row, 0] += by_m
    return dataclasses.replace(run, poses=dataclasses.replace(run.poses, xy_m=xy_m))


def test_a_run_does_not_differ_from_itself() -> None:
    comparison = tl.compare_runs(KP4, KP4)
    assert {found.largest for found in comparison.signals} == {0.0}
    assert {found.signal for found in comparison.signals} == HELD


@pytest.mark.parametrize("alignment", ["first_sample", "recorded", "sample", "phase:rotate"])
def test_what_is_sensed_and_shaped_is_compared_where_both_hold_it(alignment: str) -> None:
    noisy, again = (
        tl.simulate_run(build_case("noise", "dropout", "low_pass", max_duration_s=1.0, seed=seed))
        for seed in (1, 2)
    )
    own = tl.compare_runs(noisy, noisy, alignment=alignment)
    held = [name for name in tl.SIGNALS if not name.startswith("measured_")]
    assert {found.signal: found.largest for found in own.signals} == dict.fromkeys(held, 0.0)
    other = {found.signal: found for found in tl.compare_runs(noisy, again).signals}
    # Noise of 0.01 m in both: of some hundred differences the largest is two to five times as far.
    assert 0.02 < other["sensed_x"].largest < 0.1
    assert other["shaped_turn_rate"].largest > 0.0
    plain = tl.compare_runs(noisy, KP4, alignment=alignment)
    assert {found.signal for found in plain.signals} == HELD


@given(row=st.integers(10, 600), by_m=st.floats(1e-6, 1.0))
def test_a_change_of_one_pose_is_found_where_it_was_made(row: int, by_m: float) -> None:
    """Hypothesis changes a pose in each of 100 runs."""
    comparison = tl.compare_runs(KP4, shift_poses(KP4, row, by_m))
    found = next(found for found in comparison.signals if found.signal == "x")
    assert found.largest == pytest.approx(by_m, rel=1e-6)
    assert found.at_s == pytest.approx((row - 5) * 0.016)


def test_runs_with_other_backlogs_are_aligned_at_their_first_samples() -> None:
    scenario = tl.load_scenario("textbook")
    late = tl.override_scenario(scenario, {"loop.start_backlog": 3, "loop.pose_queue": 1})
    found = tl.compare_runs(tl.simulate_run(scenario), tl.simulate_run(late)).signals
    assert {difference.signal: difference.largest for difference in found}["heading"] == 0.0


def test_the_overlap_ends_with_the_shorter_run() -> None:
    comparison = tl.compare_runs(KP4, tl.simulate_run(tl.load_scenario("paper-kp1")))
    assert comparison.overlap_s == pytest.approx(11.184)


@pytest.mark.parametrize(("last_s", "at_s"), [(2.0, 2.0), (2.001, None)])
def test_the_row_with_which_the_overlap_ends_is_the_last_compared(
    last_s: float, at_s: float | None
) -> None:
    reference, run = (
        make_run(time_s=(0.0, end_s), sample_time_s=(0.0, end_s), speed_m_s=(0.5, speed_m_s))
        for end_s, speed_m_s in ((2.0, 0.5), (last_s, 0.75))
    )
    found = {signal.signal: signal for signal in tl.compare_runs(reference, run).signals}
    assert (found["speed"].at_s, found["speed"].largest) == (at_s, 0.25 if at_s else 0.0)


def test_metrics_stand_beside_the_references() -> None:
    comparison = tl.compare_runs(KP4, tl.simulate_run(tl.load_scenario("paper-kp1")))
    durations = {found.metric.id: found for found in comparison.metrics}["run.duration"]
    assert (durations.metric.value, durations.reference.value) == (20.528, 11.184)


def test_signals_that_one_run_lacks_are_left_out() -> None:
    samples = dataclasses.replace(KP4.samples, wanted_speed_m_s=None)
    comparison = tl.compare_runs(KP4, dataclasses.replace(KP4, samples=samples))
    assert "wanted_speed" not in {found.signal for found in comparison.signals}


def test_runs_without_overlap_are_refused() -> None:
    scenario = tl.override_scenario(tl.load_scenario("textbook"), {"max_duration_s": 0.001})
    with pytest.raises(CompareError, match=r"paper-kp4 and textbook: expected runs that overlap"):
        tl.compare_runs(KP4, tl.simulate_run(scenario))


def test_headings_across_the_seam_differ_by_the_short_way() -> None:
    starts = (3.1415, -3.1415)
    base = tl.load_scenario("textbook")
    one, other = (
        tl.simulate_run(tl.override_scenario(base, {"start.heading_rad": start}))
        for start in starts
    )
    largest = {found.signal: found.largest for found in tl.compare_runs(one, other).signals}
    assert largest["heading"] < 0.02
    assert largest["heading_error"] < 0.02


def test_phases_differ_or_they_do_not() -> None:
    comparison = tl.compare_runs(KP4, tl.simulate_run(tl.load_scenario("paper-kp1")))
    found = next(found for found in comparison.signals if found.signal == "phase")
    assert found.largest == 1.0


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


@pytest.mark.parametrize(
    ("alignment", "message"),
    [
        (
            "phase:done",
            "paper-kp4: expected a phase done to align at, found rotate, pause, translate",
        ),
        ("phase:translat", "alignment: expected phase:translate, found 'phase:translat'"),
        ("", "alignment: expected first_sample, .* or .*, found ''"),
    ],
)
def test_what_cannot_be_aligned_is_told(alignment: str, message: str) -> None:
    with pytest.raises(CompareError, match=message):
        tl.compare_runs(KP4, KP1, alignment=alignment)


def test_runs_without_samples_have_no_numbers_to_align_by() -> None:
    with pytest.raises(CompareError, match="bag: no samples to align by number"):
        tl.compare_runs(KP4, make_run(name="bag"), alignment="sample")


def test_recorded_times_that_do_not_overlap_are_refused() -> None:
    runs = [make_run(time_s=(start, start + 1.0), name=f"at-{start}") for start in (0, 5)]
    with pytest.raises(CompareError, match=r"found 0.00 to 1.00 s and 5.00 to 6.00 s"):
        tl.compare_runs(*runs, alignment="recorded")


def test_samples_that_numbers_leave_out_are_noted() -> None:
    notes = tl.compare_runs(KP4, KP1, alignment="sample").notes
    assert notes == ("681 samples are compared by number: paper-kp4 has 681, paper-kp1 1265.",)


@pytest.mark.parametrize(
    ("source", "begin", "lost_s"),
    [
        ("rosbag2: a", "2024-01-01T00:00:00.000000000Z", 0.16),
        ("rosbag2: a", "2024-01-02T00:00:00.000000000Z", 0.0),
        ("rosbag2: b", "2024-01-01T00:00:00.000000000Z", 0.0),
    ],
)
def test_runs_of_one_bag_have_one_clock(source: str, begin: str, lost_s: float) -> None:
    later = "2024-01-01T00:00:00.160000000Z"
    origins = [tl.run.Origin(began_ns=parse_utc(one)) for one in (begin, later)]
    first = dataclasses.replace(KP4, source="rosbag2: a", origin=origins[0])
    other = dataclasses.replace(KP4, source=source, origin=origins[1])
    alone, found = (
        tl.compare_runs(*runs, alignment="recorded") for runs in ((KP4, KP4), (first, other))
    )
    assert alone.overlap_s - found.overlap_s == pytest.approx(lost_s, abs=1e-9)
