"""Which figures are drawn by default, and what they leave out of runs that lack data."""

import sys
from dataclasses import replace
from pathlib import Path

import pytest

import turtlelog as tl
from tests.draw.figures.paper_runs import keep_poses, simulate
from turtlelog.draw import list_left_out
from turtlelog.draw.figures.figure_kinds import list_usual_figures
from turtlelog.errors import ShowError
from turtlelog.scenario import get_preset

GAINS = (1, 2, 4, 10)
THEORY = ["plant", "step-responses", "root-locus"]

RUNS = [simulate(kp) for kp in GAINS]

HELD = ["heading", "position", "turn-rate", "speed", "plane", "panel"]


def test_without_runs_there_is_theory() -> None:
    assert [name for name, kind in tl.draw.FIGURES.items() if not kind.find_lack([])] == THEORY


@pytest.mark.thorough
def test_of_poses_and_applied_commands_that_is_drawn_and_nothing_else(tmp_path: Path) -> None:
    written = tl.write_figures([keep_poses(simulate(4))], tmp_path, formats=["svg"])
    assert [path.stem for path in written] == HELD
    assert list_left_out([keep_poses(simulate(4))]) == (
        "left out plant, step-responses, root-locus, heading-error, world-velocity, error-log,"
        " wanted-speed, table1.tex: needs the controller's samples",
        "left out position-error: needs a goal",
    )


def test_of_poses_alone_no_command_is_drawn(tmp_path: Path) -> None:
    run = keep_poses(simulate(4))
    run = replace(run, poses=replace(run.poses, speed_m_s=None, turn_rate_rad_s=None))
    written = tl.write_figures([run], tmp_path, formats=["svg"])
    assert [path.stem for path in written] == ["heading", "position", "plane", "panel"]
    assert "left out turn-rate, panel (turn rate): needs turn rate commands" in (
        list_left_out([run])
    )


def test_of_a_whole_run_nothing_is_left_out() -> None:
    assert list_left_out(RUNS) == list_left_out([simulate(10)]) == ()


def test_what_some_runs_lack_is_named_with_them() -> None:
    bag = replace(keep_poses(simulate(4)), name="bag")
    lines = list_left_out([bag, simulate(1)], ["heading-error", "plane", "speed"])
    assert lines == ("left bag out of heading-error: needs the controller's samples",)
    bags = [replace(bag, name=f"bag{number}") for number in range(5)]
    (line,) = list_left_out([*bags, simulate(1)], ["heading-error"])
    assert line.startswith("left bag0, bag1, bag2 and 2 more out of heading-error: ")


def test_without_python_control_figures_of_theory_are_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "control", None)
    run = tl.simulate_run(get_preset("paper-kp10"))
    theory = "plant, step-responses, root-locus"
    assert f"left out {theory}: needs python-control" in list_left_out([run])
    with pytest.raises(ShowError, match="figure plant needs python-control"):
        tl.write_figures([], tmp_path)
    assert tl.draw.draw_figure("heading", [run]).axes


def test_they_come_only_where_they_are_asked_for() -> None:
    asked = {"attribution", "gains", "luck", "rates", "strips", "violation"}
    assert asked <= {*tl.draw.FIGURES}
    assert not asked & {*list_usual_figures()}
