"""Loops of different laws that are alike stand beside each other in tables."""

import pytest

import turtlelog as tl
from tests.draw.laws import simulate_law, simulate_tracker
from turtlelog.compare.table import group_ids, group_loops, order_ids
from turtlelog.laws import SequentialP
from turtlelog.run.loops import ControlLoop, Declaration

ROTATE = ControlLoop(name="rotate", signal="heading", command="turn_rate", reference="goal_bearing")
TRANSLATE = ControlLoop(
    name="translate", signal="along_track", command="speed", reference="goal_distance"
)
ALIGN = ControlLoop(name="align", signal="heading", command="turn_rate", reference="bearing_now")
APPROACH = ControlLoop(name="approach", signal="distance", command="speed", reference="zero")
FOLLOW = ControlLoop(name="follow", signal="heading", command="turn_rate", reference="recorded")
REORIENT = ControlLoop(
    name="reorient", signal="heading", command="turn_rate", reference="goal_heading"
)
CROSS = ControlLoop(name="cross", signal="cross_track", command="turn_rate", reference="zero")


def declare(*loops: ControlLoop) -> Declaration:
    return Declaration(loops=loops, phases={"one": tuple(loop.name for loop in loops)})


def group(*declarations: Declaration) -> tuple[tuple[str, ...], ...]:
    names = dict.fromkeys(loop.name for law in declarations for loop in law.loops)
    return group_loops(names, declarations)


def test_loops_of_the_same_by_the_same_command_are_alike() -> None:
    found = group(declare(ROTATE, TRANSLATE), declare(APPROACH, ALIGN))
    assert found == (("rotate", "align"), ("translate", "approach"))


@pytest.mark.parametrize("other", [FOLLOW, CROSS], ids=["follows", "another signal"])
def test_others_are_not(other: ControlLoop) -> None:
    assert group(declare(ROTATE), declare(other)) == (("rotate",), (other.name,))


def test_loops_of_one_law_stay_apart_but_follow_each_other() -> None:
    found = group(declare(ROTATE, TRANSLATE, REORIENT), declare(ALIGN))
    assert found == (("rotate", "align"), ("reorient",), ("translate",))


def test_loops_of_laws_that_are_not_known_stay_as_they_come() -> None:
    assert group_loops(["b", "a"], []) == (("b",), ("a",))


def test_ids_of_like_loops_take_turns_and_the_whole_run_comes_last() -> None:
    ids = ["rotate.overshoot", "rotate.iae", "run.duration", "align.overshoot", "align.iae"]
    declarations = [declare(ROTATE), declare(ALIGN)]
    turns = ("rotate.overshoot", "align.overshoot", "rotate.iae", "align.iae")
    assert group_ids(ids, declarations) == (turns, ("run.duration",))
    assert order_ids(ids) == (*ids[:2], *ids[3:], "run.duration")


def test_a_table_of_several_laws_has_like_loops_in_one_group() -> None:
    ours = tl.simulate_run(tl.load_scenario("textbook"))
    table = tl.compare.tabulate_metrics([ours, simulate_law("example")], only=["*.rise_time"])
    loops = [str(row[0]).partition(".")[0] for row in table.rows]
    assert loops == ["rotate", "align", "translate", "approach"]
    assert table.breaks == (2,)
    measured = tl.measure_run(ours)
    assert table.rows[0][2:] == (measured["rotate.rise_time"].value, None)
    titles = [
        column.title
        for column in tl.compare.tabulate_whole_runs([ours, simulate_law("example")]).columns
    ]
    assert [title for title in titles if title.startswith("ts")] == [
        *("ts rotate", "ts align", "ts translate", "ts approach"),
    ]


def test_a_run_without_a_goal_is_not_the_best_at_reaching_one() -> None:
    runs = [tl.simulate_run(tl.load_scenario("textbook")), simulate_tracker("kanayama")]
    summaries = [tl.summarise_run(run) for run in runs]
    table = tl.tabulate_runs(summaries)
    column = [column.title for column in table.columns].index("final.heading_error")
    assert [row[column] is None for row in table.rows] == [False, True]
    assert not [place for place in table.marks if place[1] == column]
    asked = tl.tabulate_runs(summaries, only=["final.heading_error"])
    assert None not in [row[-1] for row in asked.rows]


def test_the_declared_loops_of_the_built_in_law_are_two_kinds() -> None:
    law = SequentialP.declare(SequentialP.Parameters(), None, None)
    assert group(law) == (("rotate",), ("translate",))
