"""Where the legends of a run's plots stand: on the right away from where its curves end."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from turtlelog.draw.rerun.content import Content, find_corners
from turtlelog.draw.rerun.layout import build_run_layout
from turtlelog.draw.rerun.plots import Series
from turtlelog.draw.rerun.run_scene import build_single
from turtlelog.scenario import get_preset
from turtlelog.simulate import simulate_run

TIMES_NS = np.arange(3)
CONTENT = build_single(simulate_run(get_preset("paper-kp4"))).describe({})


def make_series(plot: str, values: Any) -> Series:
    column: NDArray[np.float64] = np.array(values)[:, np.newaxis]
    return Series(entity=plot, labels=("",), time_ns=TIMES_NS, values=column)


def list_views(part: Any) -> Iterator[Any]:
    for child in getattr(part, "contents", []) or []:
        if hasattr(child, "class_identifier"):
            yield child
        else:
            yield from list_views(child)


def read_corners(content: Content) -> dict[str, str]:
    """Return the corner of each plot's legend by the plot's title."""
    found = {}
    for view in list_views(build_run_layout(content).root_container):
        legend = view.properties.get("PlotLegend")
        if legend is not None and legend.corner is not None:
            corner = legend.corner.as_arrow_array().to_pylist()[0]
            found[view.name] = {1: "LeftTop", 2: "RightTop", 3: "LeftBottom", 4: "RightBottom"}[
                corner
            ]
    return found


def test_legends_stand_where_the_run_of_the_paper_leaves_room() -> None:
    corners = read_corners(CONTENT)
    assert corners["Heading [deg]"] == "RightBottom"
    assert corners["Turn rate [rad/s]"] == "RightTop"
    assert corners["Cross-track [m]"] == "RightBottom"


@pytest.mark.parametrize(("level", "corner"), [(0.39, "LeftTop"), (0.41, "LeftBottom")])
def test_a_legend_takes_two_fifths_of_the_height(level: float, corner: str) -> None:
    values = np.array([0.7, level, level, level, level, 0.05, 0.95, 0.05, 0.95, 0.05])
    curve = Series(entity="x", labels=("x",), time_ns=np.arange(10), values=values[:, np.newaxis])
    assert find_corners([curve], {"x": (0.0, 1.0)}) == {"x": corner}
