"""The content that a report draws, and the figures of Bokeh for it."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.charts.curves import choose_rows
from turtlelog.charts.palette import Color
from turtlelog.charts.plotted_curves import CurveKind
from turtlelog.libraries import load_library
from turtlelog.run import Run

MOST_POINTS: Final = 2000
"""Largest number of points of a curve: more than a screen has columns, so that omitted points are
invisible before a zoom."""


_FAR: Final = 1e3
"""Magnitude from which 32-bit numbers lose a tenth of a millimetre or millisecond, so that 64 bits
are used."""

RING: Final = "#8a8a8a"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Drawn:
    """A run or ghost with its drawing style.

    Attributes:
        run: Data of the run.
        name: Name in the legend.
        color: Colour in every plot.
        is_ghost: Whether it is a what-if.
        is_plotted: Whether the plots over time also show this run.
    """

    run: Run
    name: str
    color: Color
    is_ghost: bool = False
    is_plotted: bool = True


def _make_crosshair() -> Any:
    models = load_library("bokeh.models")
    return models.Span(dimension="height", line_color=RING, line_alpha=0.5)


@dataclass(slots=True, kw_only=True)
class Plots:
    """The plots of a page.

    Attributes:
        roots: Figures by the id of their place.
        config: Ids of models for the script, by their role.
        thinned: Number of curves drawn with fewer points than were recorded.
        points: Largest number of points of a curve.
        kinds: Kinds of curves in the page.
        crosshair: Line at the time under the mouse, in all plots over time.
        alternatives: Description of each figure in words, by its place.
    """

    roots: dict[str, Any] = field(default_factory=dict)
    config: dict[str, Any] = field(default_factory=dict)
    thinned: int = 0
    points: int = MOST_POINTS
    kinds: set[CurveKind] = field(default_factory=set)
    crosshair: Any = field(default_factory=_make_crosshair)
    alternatives: dict[str, str] = field(default_factory=dict)


def thin(plots: Plots, columns: Sequence[NDArray[Any]], kept: NDArray[Any]) -> list[NDArray[Any]]:
    """Return columns with the rows that give the same drawing, in the smallest suitable type."""
    rows = choose_rows(kept, plots.points)
    plots.thinned += rows is not None
    found = [np.asarray(column if rows is None else column[rows]) for column in columns]
    return [store(column) for column in found]


def store(values: NDArray[Any]) -> NDArray[Any]:
    """Return values in the smallest suitable type."""
    largest = np.abs(values[np.isfinite(values)]).max(initial=0.0)
    return np.asarray(values, dtype=np.float32 if largest < _FAR else np.float64)


def make_figure(plots: Plots, place: str, title: str, **options: Any) -> Any:
    """Return a new figure at a place of the page."""
    plotting = load_library("bokeh.plotting")
    figure = plotting.figure(
        title=title,
        tools="pan,box_zoom,wheel_zoom,reset,save",
        active_drag="box_zoom" if "x_range" in options else "pan",
        sizing_mode="stretch_width",
        styles={"background-color": "var(--ground)"},
        **options,
    )
    figure.toolbar.logo = None
    figure.toolbar.autohide = True
    # A tenth of a millimetre is written in full, not as a power of ten.
    figure.yaxis.formatter.power_limit_low = -4
    figure.title.text_font_size = "14px"
    plots.roots[place] = figure
    plots.alternatives[place] = title
    plots.config["figures"].append(figure.id)
    return figure
