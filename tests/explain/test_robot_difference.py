"""Why two robots' logs differ: parts of known truth, what is not explained, and what is refused."""

import math
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from tests.explain.robot_pairs import METRICS, draw_robot_pair
from turtlelog.explain import ExplainedDifference, explain_difference
from turtlelog.explain.answers import Change
from turtlelog.explain.difference_report import choose_told, name_change
from turtlelog.measure import measure_run
from turtlelog.run import Run
from turtlelog.run.angles import wrap_angle
from turtlelog.run.columns import take_rows

METRIC = METRICS["dead time"]


@cache
def explain(part: str, *, has_same_commands: bool = True) -> ExplainedDifference:
    pair = draw_robot_pair(part, 3, has_same_commands=has_same_commands)
    return explain_difference(pair.first, pair.second, metric=METRICS[part])


def name_told(found: ExplainedDifference) -> list[str]:
    return [one.name for one in choose_told(found)]


@pytest.mark.everyday("dead time", "limits")
@pytest.mark.parametrize("part", ["dead time", "gain", "limits"])
def test_the_part_that_differs_is_named_and_no_other(part: str) -> None:
    """Takes some 2 s: two robots are identified, and driven with 32 draws of their parameters."""
    found = explain(part)
    assert name_told(found) == [f"{part} turning"]
    assert f"the robot's {part} turning (" in found.sentences[0]


def test_contributions_and_what_is_not_explained_add_up() -> None:
    found = explain("dead time", has_same_commands=False)
    assert found.difference == pytest.approx(
        (found.second.as_logged or 0.0) - (found.first.as_logged or 0.0)
    )
    parts = [one.contribution or 0.0 for one in found.contributions]
    assert found.unexplained is not None
    assert math.fsum([*parts, found.unexplained]) == pytest.approx(found.difference, abs=1e-9)
    assert abs(found.unexplained) < abs(found.difference or 0.0) / 3.0
    for one in found.contributions:
        assert one.low is not None
        assert one.high is not None
        assert one.low <= (one.contribution or 0.0) <= one.high


def test_other_commands_are_a_part_and_may_answer_the_robot() -> None:
    found = explain("dead time", has_same_commands=False)
    assert {"commands", "dead time turning"} <= {*name_told(found)}
    assert any("they may answer the robot" in text for text in found.sentences)


def test_swapped_logs_have_the_opposite_difference() -> None:
    pair = draw_robot_pair("gain", 3, has_same_commands=True)
    swapped = explain_difference(pair.second, pair.first, metric=METRICS["gain"])
    one, other = (
        next(part for part in found.contributions if part.name == "gain turning")
        for found in (explain("gain"), swapped)
    )
    assert one.contribution == pytest.approx(-(other.contribution or 0.0), rel=0.05)


@pytest.mark.everyday("3")
@pytest.mark.parametrize("seed", [3, 4, 5])
def test_noise_alone_names_no_cause(seed: int) -> None:
    """Takes some 2 s: two robots are identified, and driven with 32 draws of their parameters."""
    pair = draw_robot_pair("noise", seed, has_same_commands=True)
    found = explain_difference(pair.first, pair.second, metric=METRIC)
    assert name_told(found) == []
    assert "no cause is certain" in found.sentences[0] or found.withheld


@pytest.mark.parametrize(
    ("part", "idle"), [("dead time", ("turn_rate.dead_time_s",)), ("noise", ())]
)
def test_what_the_intervals_of_two_robots_allow_is_not_called_different(
    part: str, idle: tuple[str, ...]
) -> None:
    pair = draw_robot_pair(part, 3, has_same_commands=True)
    often = take_rows(pair.second.commands, np.repeat(np.arange(len(pair.second.commands)), 2)[:-1])
    time_ns = often.time_ns.copy()
    time_ns[1::2] += np.diff(often.time_ns[::2]) // 2  # repeated halfway to the next
    second = replace(pair.second, commands=replace(often, time_ns=time_ns))
    found = explain_difference(pair.first, second, metric="run.largest_gap")
    assert name_told(found) == ["commands"]
    assert found.idle == idle


@pytest.mark.parametrize(
    ("metric", "name", "told"),
    [
        ("final.position_error", "goal", "the goal adds 0.5"),
        ("run.cross_track_max", "goal and path", "the goal and path add 0.2"),
    ],
)
def test_a_goal_and_a_path_are_named_only_if_the_metric_depends_on_them(
    metric: str, name: str, told: str
) -> None:
    """Takes some 2 s: two robots are identified, and driven with 32 draws of their parameters."""
    run = draw_robot_pair("noise", 3, has_same_commands=True).first
    paths: list[dict[str, Any]] = [
        {"path.kind": "waypoints", "path.points": ((0.0, aside_m), (2.0, aside_m))}
        for aside_m in (0.1, 0.3)
    ]
    logs = [
        replace(run, goal_xy_m=goal_xy_m, parameters=path)
        for goal_xy_m, path in zip([(1.0, 0.0), (1.5, 0.0)], paths, strict=True)
    ]
    found = explain_difference(*logs, metric=metric)
    assert name_told(found) == [name]
    assert told in found.sentences[0]


@pytest.mark.parametrize(
    ("after", "told"), [(1.01, "1 -> 1.01"), (1.003, "1 -> 1.003"), (1.0 + 1e-5, "1 -> 1.00001")]
)
def test_two_values_have_the_digits_that_tell_them_apart(after: float, told: str) -> None:
    change = Change(name="gain driving", keys=("speed.gain",), first=(1.0,), second=(after,))
    assert name_change(change) == f"the robot's gain driving ({told})"


def test_equal_logs_do_not_differ() -> None:
    run = draw_robot_pair("noise", 3, has_same_commands=True).first
    found = explain_difference(run, run, metric=METRIC)
    assert (found.difference, found.contributions) == (0.0, ())


def test_a_robot_that_no_model_fits_names_no_cause() -> None:
    """A robot that slips: its motion stops for seconds though commands go on."""
    pair = draw_robot_pair("noise", 3, has_same_commands=True)
    poses = pair.second.poses
    turned = np.unwrap(poses.heading_rad)
    half = len(turned) // 2
    slipped = np.concatenate([turned[:half], turned[half] + 0.2 * (turned[half:] - turned[half])])
    second = replace(pair.second, poses=replace(poses, heading_rad=np.angle(np.exp(1j * slipped))))
    found = explain_difference(pair.first, second, metric=METRIC)
    assert found.contributions == ()
    assert "cannot be identified" in (found.withheld or "")


@pytest.mark.parametrize(("share", "is_named"), [(0.30, True), (0.42, False)])
def test_above_a_third_unexplained_no_cause_is_named(share: float, *, is_named: bool) -> None:
    """Takes some 2 s: the log of the second robot gets a difference that no part makes."""
    pair = draw_robot_pair("gain", 3, has_same_commands=True)
    found = explain_difference(pair.first, pair.second, metric=METRIC)
    explained = math.fsum(one.contribution or 0.0 for one in found.contributions)
    wanted = (found.first.as_logged or 0.0) + explained / (1.0 - share)
    low_rad, high_rad = 0.0, 0.1
    for _ in range(30):
        middle_rad = (low_rad + high_rad) / 2.0
        value = measure_run(swing(pair.second, middle_rad), only=[METRIC])[METRIC].value or 0.0
        low_rad, high_rad = (middle_rad, high_rad) if value < wanted else (low_rad, middle_rad)
    judged = explain_difference(pair.first, swing(pair.second, low_rad), metric=METRIC)
    assert judged.difference == pytest.approx(explained / (1.0 - share), rel=1e-3)
    assert bool(name_told(judged)) == is_named
    left = abs(judged.unexplained or 0.0) / abs(judged.difference or 1.0)
    assert left == pytest.approx(share, abs=0.08)
    assert (left <= 1.0 / 3.0) == is_named


def swing(run: Run, by_rad: float) -> Run:
    """Return a log whose heading swings every half second, as no command asks for."""
    time_s = (run.poses.time_ns - run.poses.time_ns[0]) / 1e9
    heading = wrap_angle(run.poses.heading_rad + by_rad * np.sin(4.0 * np.pi * time_s))
    return replace(run, poses=replace(run.poses, heading_rad=heading))


def test_without_commands_no_robot_is_identified() -> None:
    pair = draw_robot_pair("gain", 3, has_same_commands=True)
    silent = drop_commands(pair.second)
    found = explain_difference(pair.first, silent, metric="run.total_turning")
    assert found.contributions == ()
    assert "no commands are recorded" in (found.withheld or "")


def drop_commands(run: Run) -> Run:
    return replace(run, commands=take_rows(run.commands, slice(0, 0)))
