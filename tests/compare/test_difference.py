import dataclasses

import pytest
from hypothesis import given, strategies as st

import turtlelog as tl
from turtlelog.errors import CompareError

KP4 = tl.simulate_run(tl.load_scenario("paper-kp4"))


def shift_poses(run: tl.Run, row: int, by_m: float) -> tl.Run:
    xy_m = run.poses.xy_m.copy()
    xy_m[row, 0] += by_m
    return dataclasses.replace(run, poses=dataclasses.replace(run.poses, xy_m=xy_m))


def test_a_run_does_not_differ_from_itself() -> None:
    comparison = tl.compare_runs(KP4, KP4)
    assert {found.largest for found in comparison.signals} == {0.0}
    assert {found.signal for found in comparison.signals} == set(tl.SIGNALS)


@given(row=st.integers(10, 600), by_m=st.floats(1e-6, 1.0))
def test_a_change_of_one_pose_is_found_where_it_was_made(row: int, by_m: float) -> None:
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
