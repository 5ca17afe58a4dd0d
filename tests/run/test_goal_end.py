"""How a run ended at its goal."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import turtlelog as tl
from turtlelog.run.stop_reasons import find_goal_end

RUN = tl.simulate_run(tl.load_scenario("paper-kp1"))
"""A run that ends by itself within its tolerances."""

ALLOWED_M = 0.001 * float(np.hypot(2.0 - 5.5444446, 10.0 - 5.5444446)) + 0.001
"""Heading tolerance times the distance from start to goal, plus the position tolerance [m]."""


def end_at(error_m: float, **changes: Any) -> tl.Run:
    """Return the run at rest at a distance beside the goal [m]."""
    xy_m = RUN.poses.xy_m.copy()
    assert RUN.goal_xy_m is not None
    xy_m[-2:] = (RUN.goal_xy_m[0] + error_m, RUN.goal_xy_m[1])
    return replace(RUN, poses=replace(RUN.poses, xy_m=xy_m), **changes)


@pytest.mark.parametrize(
    ("factor", "reason", "verdict"),
    [
        (0.999, "standstill", "reached"),
        (1.001, "standstill", "missed"),
        (1.001, "timeout", "missed"),
        (1.001, "max_duration", "missed"),
        (1.41, "within_tolerance", "reached"),
        (1.42, "within_tolerance", "missed"),
        (1.001, "arrived", "ended"),
        (1.001, None, "ended"),
    ],
)
def test_tolerances_and_stop_reason_decide(factor: float, reason: str | None, verdict: str) -> None:
    end = find_goal_end(end_at(factor * ALLOWED_M, stop_reason=reason))
    assert end is not None
    assert end.verdict == verdict
    assert end.allowed_m == pytest.approx(ALLOWED_M, rel=1e-6)
    assert end.error_m == pytest.approx(factor * ALLOWED_M, rel=1e-6)


@pytest.mark.parametrize(
    ("reason", "speed_m_s", "verdict"),
    [
        ("max_duration", 0.0056, "reached"),
        ("max_duration", 0.0058, "ended"),
        (None, 0.0058, "ended"),
        ("standstill", 1.0, "reached"),
    ],
)
def test_a_robot_that_a_limit_stops_on_its_way_through_the_goal_has_not_arrived(
    reason: str | None, speed_m_s: float, verdict: str
) -> None:
    run = end_at(0.001, stop_reason=reason)
    xy_m = run.poses.xy_m.copy()
    xy_m[-2, 1] -= 0.016 * speed_m_s  # one step before, of 16 ms
    end = find_goal_end(replace(run, poses=replace(run.poses, xy_m=xy_m)))
    assert end is not None
    assert end.allowed_m - end.error_m == pytest.approx(0.00569, abs=1e-5)
    assert end.verdict == verdict


@pytest.mark.parametrize(("share", "verdict"), [(0.0199, "reached"), (0.0201, "allowed")])
def test_a_wide_tolerance_moves_no_goal(share: float, verdict: str) -> None:
    """The position tolerance of 1 mm counts along both axes."""
    distance_m = float(np.hypot(2.0 - 5.5444446, 10.0 - 5.5444446))
    wide = {**RUN.parameters, "law.heading_tolerance_rad": 0.1}
    error_m = share * distance_m + 0.001 * 2.0**0.5
    end = find_goal_end(end_at(error_m, stop_reason="standstill", parameters=wide))
    assert end is not None
    assert (end.verdict, end.is_away) == (verdict, verdict == "allowed")
    if end.is_away:
        told = "ended 0.116 m from the goal (its tolerances allow 0.57 m) after 20.5 s"
        assert end.describe() == told


def test_a_law_without_tolerances_does_not_judge_by_itself() -> None:
    end = find_goal_end(end_at(6.2, stop_reason="within_tolerance", parameters={}))
    assert end is not None
    assert end.describe() == "ended 6.2 m from the goal after 20.5 s"


def test_the_sentence_names_what_the_tolerances_allow() -> None:
    end = find_goal_end(end_at(0.1, stop_reason="standstill"))
    assert end is not None
    assert end.describe() == "missed the goal by 0.1 m (allowed: 0.00669 m) after 20.5 s"
    small = find_goal_end(end_at(0.008, stop_reason="standstill"))
    assert small is not None
    assert small.describe() == "missed the goal by 8 mm (allowed: 6.69 mm) after 20.5 s"


@pytest.mark.parametrize(
    ("left_m", "short_m", "place"),
    [
        (0.1, 0.0009, "0.1 m left of the line from start to goal."),
        (-0.1, 0.0011, "0.1 m right of the line from start to goal and 1.1 mm short of the goal."),
        (0.0011, -0.1, "1.1 mm left of the line from start to goal and 0.1 m beyond the goal."),
        (0.0009, -0.1, "0.1 m beyond the goal."),
    ],
)
def test_the_place_of_the_end_is_across_and_along_the_line(
    left_m: float, short_m: float, place: str
) -> None:
    assert RUN.goal_xy_m is not None
    start_x_m, start_y_m = RUN.poses.xy_m[0].tolist()
    bearing_rad = np.arctan2(RUN.goal_xy_m[1] - start_y_m, RUN.goal_xy_m[0] - start_x_m)
    cos, sin = np.cos(bearing_rad), np.sin(bearing_rad)
    xy_m = RUN.poses.xy_m.copy()
    xy_m[-1] = RUN.goal_xy_m - short_m * np.array([cos, sin]) + left_m * np.array([-sin, cos])
    end = find_goal_end(replace(RUN, poses=replace(RUN.poses, xy_m=xy_m)))
    assert end is not None
    assert end.describe_place() == f"The end is {place}"


def test_a_run_without_tolerances_did_not_miss() -> None:
    for reason in ("max_duration", "standstill"):
        end = find_goal_end(end_at(1e-6, stop_reason=reason, parameters={}))
        assert end is not None
        assert end.describe() == "ended 0.001 mm from the goal after 20.5 s"


def test_a_law_that_reads_noisy_poses_does_not_judge_by_itself() -> None:
    run = end_at(1.1 * ALLOWED_M, stop_reason="within_tolerance")
    assert getattr(find_goal_end(run), "verdict", None) == "reached"
    run = replace(run, poses=replace(run.poses, sensed_xy_m=run.poses.xy_m.copy()))
    end = find_goal_end(run)
    assert end is not None
    assert end.verdict == "missed"


def test_a_law_that_reads_late_poses_passes_its_goal() -> None:
    changes = {"goal.x_m": 10.0, "goal.y_m": 5.55, "sensing.delay_s": 0.5}
    run = tl.simulate_run(tl.override_scenario(tl.load_scenario("lagged"), changes))
    end = find_goal_end(run)
    assert run.stop_reason == "within_tolerance"
    assert end is not None
    assert (end.verdict, round(end.error_m, 4)) == ("missed", 0.0382)


def test_without_a_goal_there_is_no_end_at_it() -> None:
    assert find_goal_end(replace(RUN, goal_xy_m=None)) is None
    free = replace(RUN.declaration, uses_goal=False)
    assert find_goal_end(replace(RUN, declaration=free)) is None


@pytest.mark.parametrize(("away_m", "has_line"), [(0.0009, False), (0.0011, True)])
def test_a_run_that_starts_at_its_goal_has_no_line_to_it(away_m: float, *, has_line: bool) -> None:
    """The tolerances allow 1 mm and a thousandth of the distance."""
    assert RUN.goal_xy_m is not None
    xy_m = RUN.poses.xy_m.copy()
    xy_m[0] = RUN.goal_xy_m + np.array([0.0, -away_m])
    xy_m[-1] = RUN.goal_xy_m + np.array([0.2, 0.0])
    run = replace(RUN, poses=replace(RUN.poses, xy_m=xy_m), stop_reason="timeout")
    end = find_goal_end(run)
    assert end is not None
    assert (end.verdict, bool(end.describe_place())) == ("missed", has_line)


@pytest.mark.parametrize(("off_rad", "is_reached"), [(0.00099, True), (0.00101, False)])
@pytest.mark.parametrize("way", [-1.0, 1.0])
def test_a_goal_with_a_heading_is_reached_in_this_heading(
    off_rad: float, way: float, *, is_reached: bool
) -> None:
    heading_rad = float(RUN.poses.heading_rad[-1]) + way * off_rad
    end = find_goal_end(
        replace(end_at(1e-4, stop_reason="max_duration"), goal_heading_rad=heading_rad)
    )
    assert end is not None
    assert (end.verdict == "reached") is is_reached
    told = "ended 0.1 mm from the goal and 0.0579 deg off its heading after 20.5 s"
    assert (end.describe() == told) is not is_reached


@pytest.mark.parametrize(
    ("error_m", "told"),
    [(8e-10, "ended at the goal after"), (2e-9, "ended 2e-06 mm from the goal")],
)
def test_a_distance_that_is_rounding_is_at_the_goal(error_m: float, told: str) -> None:
    parameters = {key: value for key, value in RUN.parameters.items() if "tolerance" not in key}
    end = find_goal_end(end_at(error_m, stop_reason=None, parameters=parameters))
    assert end is not None
    assert end.describe().startswith(told)


def test_the_line_begins_where_the_goal_was_given_as_that_of_the_metrics() -> None:
    poses = tl.run.PoseColumns(
        time_ns=np.arange(4) * 1_000_000_000,
        xy_m=np.array([[0.0, 0.0], [0.0, 2.0], [2.0, 2.0], [3.8, 2.1]]),
        heading_rad=np.array([1.57, 0.0, 0.0, 0.0]),
    )
    run = tl.Run(
        name="bag",
        source="bag",
        poses=poses,
        commands=tl.run.CommandColumns.build_empty(),
        samples=tl.run.SampleColumns.build_empty(),
        goal_xy_m=(4.0, 2.0),
        origin=tl.run.Origin(goal_given_ns=1_000_000_000),
    )
    end = find_goal_end(run)
    assert end is not None
    assert end.left_m == pytest.approx(tl.measure_run(run)["final.cross_track"].value)
    assert (end.left_m, end.short_m) == pytest.approx((0.1, 0.2))
