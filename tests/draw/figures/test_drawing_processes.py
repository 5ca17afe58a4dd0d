"""Drawing in several processes: the same files, errors and order, and nothing left behind."""

import multiprocessing
import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from threading import Event

import matplotlib
import pytest
from fontTools import subset

import turtlelog as tl
from tests.log.runs import simulate_preset
from turtlelog.draw.figures import page, writing
from turtlelog.errors import ProcessError, ShowError
from turtlelog.processes import CAN_FORK

Draw = Callable[[str], list[bytes]]
NAMES = [f"figure {number}" for number in range(7)]
FORKED = pytest.mark.skipif(not CAN_FORK, reason="nothing is forked here")


def tell(name: str) -> list[bytes]:
    """Stand for drawing a figure: name it, and the process that does so."""
    return [name.encode(), str(os.getpid()).encode()]


def draw(names: Sequence[str], jobs: int | None, work: Draw = tell) -> Iterator[tuple[str, str]]:
    """Yield the names of figures, and the processes that drew them."""
    for name, (told, process) in writing._draw_in_processes(work, names, jobs):
        assert told.decode() == name
        yield name, process.decode()


@pytest.mark.parametrize("jobs", [1, 2, 3, 7, 20])
def test_figures_come_in_order_from_any_number_of_processes(jobs: int) -> None:
    drawn = list(draw(NAMES, jobs))
    assert [name for name, _ in drawn] == NAMES
    if CAN_FORK:
        assert len({process for _, process in drawn}) == min(jobs, len(NAMES))
    assert not multiprocessing.active_children()


@FORKED
@pytest.mark.parametrize(("names", "processes"), [(5, 1), (6, 2), (9, 3), (99, 4)])
def test_each_of_as_many_processes_as_cores_has_three_figures_to_draw(
    monkeypatch: pytest.MonkeyPatch, names: int, processes: int
) -> None:
    monkeypatch.setattr(writing, "count_cores", lambda: 4)
    assert len({process for _, process in draw(["a"] * names, None)}) == processes


@pytest.mark.parametrize("jobs", [None, 3])
def test_no_figure_needs_no_process(jobs: int | None) -> None:
    assert not list(draw([], jobs))


def test_where_none_can_be_forked_one_process_draws_all(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writing, "CAN_FORK", False)
    assert {process for _, process in draw(NAMES, 4)} == {str(os.getpid())}


def test_an_error_in_another_process_is_raised_here_after_what_comes_before() -> None:
    def fail(name: str) -> list[bytes]:
        if name == NAMES[5]:
            raise ShowError(f"no {name}")
        return tell(name)

    drawing = draw(NAMES, 2, fail)
    assert [next(drawing)[0] for _ in range(5)] == NAMES[:5]
    with pytest.raises(ShowError, match="no figure 5"):
        next(drawing)
    assert not multiprocessing.active_children()


@FORKED
def test_a_process_that_dies_is_one_line_with_its_figures() -> None:
    with pytest.raises(ProcessError, match=r"figure \d, figure \d: expected a result"):
        list(draw(NAMES, 3, lambda _: os._exit(9)))
    assert not multiprocessing.active_children()


@FORKED
def test_who_stops_early_leaves_no_process_behind() -> None:
    drawing = writing._draw_in_processes(tell, NAMES, 3)
    next(drawing)
    drawing.close()  # type: ignore[attr-defined]
    assert not multiprocessing.active_children()


@pytest.mark.thorough
def test_figures_are_the_same_bytes_from_one_process_and_from_several(tmp_path: Path) -> None:
    """Figures are drawn as files, once here and once by processes that start."""
    run, only = simulate_preset("paper-kp10"), ["heading", "speed"]
    found = [
        [path.read_bytes() for path in tl.write_figures([run], folder, only=only, jobs=jobs)]
        for folder, jobs in ((tmp_path / "1", 1), (tmp_path / "2", 2))
    ]
    assert found[0] == found[1]
    assert len(found[0]) == len(only) * 3


@pytest.mark.thorough
def test_figures_are_the_same_bytes_from_several_threads() -> None:
    """Eight figures are drawn as PDF, twice."""
    run, only = simulate_preset("paper-kp10"), ["heading", "plane", "speed", "turn-rate"] * 2
    work = partial(writing._draw_files, runs=[run], formats=["pdf"], page=page.Page(), kinds=None)
    settings, load_font = dict(matplotlib.rcParams), subset.load_font
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(work, only))
    assert found == list(map(work, only))
    assert (dict(matplotlib.rcParams), subset.load_font) == (settings, load_font)


@FORKED
def test_a_process_that_is_forked_while_a_thread_draws_does_not_wait_for_it() -> None:
    def take_turn(name: str) -> list[bytes]:
        assert page._DRAWING.acquire(timeout=10.0)
        page._DRAWING.release()
        return tell(name)

    is_drawing = Event()

    def draw_slowly() -> None:
        with page.use_looks():
            is_drawing.set()
            time.sleep(0.2)

    with ThreadPoolExecutor(1) as pool:
        pool.submit(draw_slowly)
        is_drawing.wait()
        assert [name for name, _ in draw(NAMES, 2, take_turn)] == NAMES


def test_a_number_of_processes_below_one_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ShowError, match="jobs: expected at least 1 process, found 0"):
        tl.write_figures([], tmp_path, jobs=0)
