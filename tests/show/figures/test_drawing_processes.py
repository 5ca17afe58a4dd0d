"""Drawing in several processes: the same files, errors and order, and nothing left behind."""

import multiprocessing
import os
import sys
from pathlib import Path

import pytest

import turtlelog as tl
from tests.log.runs import simulate_preset
from turtlelog.errors import ShowError
from turtlelog.show.figures.drawing_processes import draw_in_processes

NAMES = [f"figure {number}" for number in range(7)]
FORKED = pytest.mark.skipif(sys.platform != "linux", reason="nothing is forked here")


def tell(name: str) -> list[bytes]:
    """Stand for drawing a figure: name it, and the process that does so."""
    return [name.encode(), str(os.getpid()).encode()]


@pytest.mark.parametrize("jobs", [1, 2, 3, 7, 20])
def test_figures_come_in_order_from_any_number_of_processes(jobs: int) -> None:
    drawn = list(draw_in_processes(tell, NAMES, jobs))
    assert [name.decode() for name, _ in drawn] == NAMES
    if sys.platform == "linux":
        assert len({process for _, process in drawn}) == min(jobs, len(NAMES))
    assert not multiprocessing.active_children()


@FORKED
@pytest.mark.parametrize(("names", "processes"), [(5, 1), (6, 2), (9, 3), (99, 4)])
def test_each_of_as_many_processes_as_cores_has_three_figures_to_draw(
    monkeypatch: pytest.MonkeyPatch, names: int, processes: int
) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: 4)
    drawn = list(draw_in_processes(tell, ["a"] * names, None))
    assert len({process for _, process in drawn}) == processes


def test_no_figure_needs_no_process() -> None:
    assert not list(draw_in_processes(tell, [], 3))


@pytest.mark.parametrize("platform", ["win32", "darwin"])
def test_elsewhere_all_is_drawn_in_one_process(
    monkeypatch: pytest.MonkeyPatch, platform: str
) -> None:
    monkeypatch.setattr(sys, "platform", platform)
    drawn = list(draw_in_processes(tell, NAMES, 4))
    assert {process for _, process in drawn} == {str(os.getpid()).encode()}


def test_an_error_in_another_process_is_raised_here_after_what_comes_before() -> None:
    def fail(name: str) -> list[bytes]:
        if name == NAMES[5]:
            raise ShowError(f"no {name}")
        return tell(name)

    drawing = draw_in_processes(fail, NAMES, 2)
    assert [next(drawing)[0].decode() for _ in range(5)] == NAMES[:5]
    with pytest.raises(ShowError, match="no figure 5"):
        next(drawing)
    assert not multiprocessing.active_children()


def test_what_a_process_that_dies_has_not_drawn_is_drawn_here() -> None:
    first = os.getpid()

    def die(name: str) -> list[bytes]:
        if os.getpid() != first:
            os._exit(9)
        return tell(name)

    assert [name.decode() for name, _ in draw_in_processes(die, NAMES, 3)] == NAMES


@FORKED
def test_who_stops_early_leaves_no_process_behind() -> None:
    drawing = draw_in_processes(tell, NAMES, 3)
    next(drawing)
    drawing.close()  # type: ignore[attr-defined]
    assert not multiprocessing.active_children()


def test_figures_are_the_same_bytes_from_one_process_and_from_several(tmp_path: Path) -> None:
    run, only = simulate_preset("paper-kp10"), ["heading", "plane", "speed", "turn-rate"]
    found = [
        [path.read_bytes() for path in tl.write_figures([run], folder, only=only, jobs=jobs)]
        for folder, jobs in ((tmp_path / "1", 1), (tmp_path / "2", 2))
    ]
    assert found[0] == found[1]
    assert len(found[0]) == len(only) * 3


def test_a_number_of_processes_below_one_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ShowError, match="jobs: expected at least 1 process, found 0"):
        tl.write_figures([], tmp_path, jobs=0)
