import numpy as np
import rerun.blueprint as rrb
from numpy.typing import NDArray

from turtlelog.show.rerun.content import choose_corners
from turtlelog.show.rerun.marks import Mark
from turtlelog.show.rerun.plots import Series

TIMES_NS = np.arange(100)
RANGES = {"speed": (0.0, 1.0)}
USUAL = {"speed": rrb.Corner2D.RightTop}
FLAT = np.full(100, 0.5)


def choose(values: NDArray[np.float64], marks: tuple[Mark, ...] = ()) -> str:
    series = Series(
        entity="speed/commanded", labels=("",), time_ns=TIMES_NS, values=values[:, None]
    )
    return choose_corners([series], marks, RANGES, USUAL)["speed"].name


def make_mark(time_ns: int, level: float) -> Mark:
    return Mark(plot="speed", label="", unit="s", shape="Up", time_ns=time_ns, level=level)


def test_a_legend_stands_in_its_usual_corner_where_nothing_moves() -> None:
    assert choose(FLAT) == "RightTop"


def test_a_legend_avoids_what_moves() -> None:
    ringing = np.where(TIMES_NS > 70, 0.8 + 0.1 * np.sin(TIMES_NS), 0.5)
    assert choose(ringing) == "RightBottom"


def test_a_legend_hides_a_jump_rather_than_a_slope() -> None:
    fall = np.interp(TIMES_NS, [50, 99], [1.0, 0.0])
    jump_and_fall = np.where(TIMES_NS < 20, 0.1, fall)
    assert choose(jump_and_fall) in {"LeftBottom", "LeftTop"}


def test_a_legend_avoids_a_mark() -> None:
    assert choose(FLAT, (make_mark(95, 0.9),)) == "RightBottom"
    assert choose(FLAT, (make_mark(95, 0.9), make_mark(95, 0.1))) == "LeftBottom"


def test_gaps_and_plots_without_curves_do_no_harm() -> None:
    assert choose(np.full(100, np.nan)) == "RightTop"
    assert choose_corners([], (), RANGES, USUAL) == {}
