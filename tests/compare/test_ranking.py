"""When a run may be called the best: the same task, and what was varied is named first."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

import turtlelog as tl
from turtlelog.compare import Ranking, RunSummary, judge_runs
from turtlelog.compare.run_selection import get_parameter
from turtlelog.errors import CompareError

PAPER = tl.simulate_run(tl.load_scenario("paper-kp4"))
REACH_M = 0.001 * float(np.hypot(2.0 - 5.5444446, 10.0 - 5.5444446)) + 0.001
"""Resolution of positions: heading tolerance times distance plus position tolerance."""


def summarise(run: tl.Run) -> RunSummary:
    return tl.summarise_run(run, metrics=tl.measure_run(run, only=["run.duration", "final.*"]))


def change(name: str = "other", **changes: Any) -> tl.Run:
    """Return the run with other parameters, its rows as they are."""
    keys = {key.replace("__", "."): value for key, value in changes.items()}
    return dataclasses.replace(PAPER, name=name, parameters={**PAPER.parameters, **keys})


def move(x_m: float = 0.0, heading_rad: float = 0.0) -> tl.Run:
    """Return the run from another start."""
    poses = PAPER.poses
    xy_m, heading = poses.xy_m.copy(), poses.heading_rad.copy()
    xy_m[: PAPER.samples.pose_sequence[0] + 1, 0] += x_m
    heading[: PAPER.samples.pose_sequence[0] + 1] += heading_rad
    return dataclasses.replace(
        PAPER, name="other", poses=dataclasses.replace(poses, xy_m=xy_m, heading_rad=heading)
    )


def judge(*runs: tl.Run, varied: Sequence[str] = ()) -> Ranking:
    return judge_runs([summarise(run) for run in (PAPER, *runs)], varied=varied)


@pytest.mark.parametrize(
    ("changes", "condition", "first_line"),
    [
        ({"limits__speed_m_s": 0.5}, "limits", "limits differ"),
        ({"plant__kind": "lagged", "plant__period_s": 0.01}, "plant", "plant differs"),
        ({"disturbance__speed_m_s": 0.1}, "plant", "plant differs"),
        ({"path__kind": "line", "path__points": [[0, 0], [1, 1]]}, "path", "path differs"),
    ],
)
def test_runs_under_other_conditions_are_not_ranked(
    changes: dict[str, Any], condition: str, first_line: str
) -> None:
    other = change(**changes)
    ranking = judge(other)
    assert {found.condition for found in ranking.differences} == {condition}
    table = tl.tabulate_runs([summarise(PAPER), summarise(other)])
    assert table.title == f"2 runs: {first_line}, so nothing is called best"
    assert not table.marks
    assert tl.compare.mark_metric([summarise(PAPER), summarise(other)], "run.duration") == {}


@pytest.mark.parametrize(("share", "is_fair"), [(0.95, True), (1.05, False)])
def test_starts_and_goals_may_differ_by_the_resolution(share: float, *, is_fair: bool) -> None:
    assert judge(move(x_m=share * REACH_M)).is_fair == is_fair
    assert judge(move(heading_rad=share * 0.001)).is_fair == is_fair
    goal = dataclasses.replace(PAPER, goal_xy_m=(2.0 - share * REACH_M, 10.0))
    assert judge(goal).is_fair == is_fair


@pytest.mark.parametrize(("share", "is_fair"), [(0.95, True), (1.05, False)])
def test_starts_are_held_against_each_other_and_not_against_the_first(
    share: float, *, is_fair: bool
) -> None:
    half_m = 0.5 * share * REACH_M
    assert judge(move(x_m=half_m), move(x_m=-half_m)).is_fair == is_fair


def test_a_heading_is_held_against_others_around_half_a_turn() -> None:
    start = float(PAPER.poses.heading_rad[0])
    near = [move(heading_rad=np.pi - 1e-4 - start), move(heading_rad=-np.pi + 1e-4 - start)]
    assert judge_runs([summarise(run) for run in near]).is_fair


@pytest.mark.parametrize(
    ("x_m", "heading_rad", "is_fair"),
    [(0.019, 0.0, True), (0.021, 0.0, False), (0.0, 0.019, True), (0.0, 0.021, False)],
)
def test_without_tolerances_starts_may_differ_by_the_band(
    x_m: float, heading_rad: float, *, is_fair: bool
) -> None:
    start = PAPER.poses.xy_m[0]
    goal = (float(start[0]) + 1.0, float(start[1]))
    runs = [
        dataclasses.replace(run, parameters={}, scenario_is_complete=False, goal_xy_m=goal)
        for run in (move(-1e-9), move(x_m - 1e-9, heading_rad))
    ]
    assert judge_runs([summarise(run) for run in runs]).is_fair == is_fair


def test_gains_are_varied_on_purpose_and_named_first() -> None:
    other = change(law__kp_linear=2.0, law__pause_ticks=0)
    ranking = judge(other)
    assert (ranking.is_fair, ranking.varied) == (True, ("law.kp_linear",))
    pair = [summarise(PAPER), summarise(other)]
    title = (
        "2 runs, Kp drive = 4, 2 (law.pause_ticks differs too, so not every difference is due to"
        " Kp drive)"
    )
    assert tl.tabulate_runs(pair).title == title
    first, _ = tl.compare.order_parameters(pair, ranking)
    assert [*first][:2] == ["law.kp_linear", "law.pause_ticks"]


def test_three_keys_that_differ_are_named_first_and_the_others_below() -> None:
    other = change(
        law__heading_tolerance_rad=0.2,
        law__pause_ticks=0,
        law__position_tolerance_m=0.2,
        loop__start_backlog=9,
    )
    table = tl.tabulate_runs([summarise(PAPER), summarise(other)], differing=0)
    named = "law.heading_tolerance_rad, law.position_tolerance_m, law.pause_ticks and 1 more"
    assert f"({named} differ)" in table.title
    assert "More parameters that differ: loop.start_backlog." in table.notes


def test_differing_conditions_come_before_other_parameters() -> None:
    other = change(loop__start_backlog=1, law__pause_ticks=0, limits__speed_m_s=0.5)
    titles = [one.title for one in tl.tabulate_runs([summarise(PAPER), summarise(other)]).columns]
    assert titles[:4] == ["run", "Kp", "limits.speed_m_s", "law.pause_ticks"]


@pytest.mark.parametrize("varied", ["limits.speed_m_s", "limits"])
def test_what_is_said_to_be_on_purpose_forbids_nothing(varied: str) -> None:
    other = change(limits__speed_m_s=0.5)
    ranking = judge(other, varied=[varied])
    assert ranking.is_fair
    title = tl.tabulate_runs([summarise(PAPER), summarise(other)], ranking=ranking).title
    assert title == "2 runs, limits.speed_m_s = 1, 0.5"
    assert not judge(other, varied=["limits.turn_rate_rad_s"]).is_fair
    assert not judge(other, varied=["plant"]).is_fair
    with pytest.raises(
        CompareError, match=r'varied: no key "limits\.sped"; did you mean limits\.speed_m_s'
    ):
        judge(other, varied=["limits.sped"])


def test_a_goal_that_is_not_known_forbids_a_ranking() -> None:
    ranking = judge(dataclasses.replace(PAPER, name="other", goal_xy_m=None))
    assert ranking.describe() == "goal is not known of every run, so nothing is called best"
    (note,) = ranking.list_notes(["a", "b"])
    gives = "turtlelog convert FILE --goal X,Y -o NEW.mcap gives it"  # --goal is refused for a
    assert note == f"goal: (2, 10) m of a, not known of b. {gives}."


@pytest.mark.parametrize(("is_closed", "is_fair"), [(True, True), (False, False)])
def test_a_polygon_that_says_it_is_closed_is_the_same_path(
    *, is_closed: bool, is_fair: bool
) -> None:
    square = tl.scenario.get_preset("track-square")
    said = tl.override_scenario(square, {"path.closed": is_closed, "max_duration_s": 1.0})
    run, other = (
        tl.simulate_run(one)
        for one in (tl.override_scenario(square, {"max_duration_s": 1.0}), said)
    )
    assert judge_runs([summarise(run), summarise(other)]).is_fair == is_fair


def test_goals_of_which_none_is_known_are_given_at_once() -> None:
    bare = dataclasses.replace(PAPER, goal_xy_m=None)
    ranking = judge_runs([summarise(bare), summarise(bare)])
    (note,) = ranking.list_notes(["a", "b"])
    assert note == "goal: not known of a and b. --goal X,Y gives it."


BARE = dataclasses.replace(PAPER, parameters={}, scenario_is_complete=False)


def test_limits_that_are_known_of_no_run_are_named_and_forbid_nothing() -> None:
    ranking = judge_runs([summarise(BARE), summarise(dataclasses.replace(BARE, name="other"))])
    assert (ranking.is_fair, [*ranking.unknown]) == (True, ["path", "plant", "limits"])
    assert ranking.list_notes(["a", "b"]) == [
        "Not known of a and b: path, plant and limits. The ranking takes them for equal."
    ]


def test_limits_that_are_known_of_some_runs_alone_forbid_a_ranking() -> None:
    ranking = judge(dataclasses.replace(BARE, name="other"))
    unknown = "path, plant and limits are not known of every run, so nothing is called best"
    assert (ranking.describe(), ranking.unknown) == (unknown, {})
    assert ranking.list_notes(["a", "b"])[1:] == [
        "plant: turtlesim of a, not known of b.",
        "limits: speed_m_s = 1, turn_rate_rad_s = 1 of a, not known of b.",
    ]


def test_the_first_line_says_which_run_is_best() -> None:
    pair = [summarise(tl.read_recording(f"recordings/paper/kp{gain}.mcap")) for gain in (1, 2)]
    title = (
        "2 runs, Kp = 1, 2 (loop.start_backlog differs too, so not every difference is due to Kp):"
        " paper-kp2 is best at"
    )
    assert tl.tabulate_runs(pair, only=["run.duration"]).title == f"{title} run.duration"
    both = ["run.duration", "final.position_error"]
    assert tl.tabulate_runs(pair, only=both).title == f"{title} every metric shown"


def test_a_report_ranks_as_the_table_does() -> None:
    from turtlelog.draw.report_sections import conclude_runs

    runs = [PAPER, change(limits__speed_m_s=0.5)]
    metrics = [tl.measure_run(run, only=["final.*"]) for run in runs]
    assert conclude_runs(runs, ["a", "b"], metrics)[0] == (
        "2 runs: limits differ, so nothing is called best."
    )


def test_a_path_of_many_points_is_told_by_its_ends() -> None:
    points = [[float(one), 0.5 * one] for one in range(60)]
    first, other = (
        change(name, path__kind="waypoints", path__points=points[:count])
        for name, count in (("first", 60), ("other", 50))
    )
    (told,) = judge_runs([summarise(first), summarise(other)]).list_notes(["first", "other"])
    long, short = "60 values, (0, 0) to (59, 29.5)", "50 values, (0, 0) to (49, 24.5)"
    assert told == f"path.points: {long} of first, {short} of other."
    assert get_parameter(summarise(other), "path.points") == short
