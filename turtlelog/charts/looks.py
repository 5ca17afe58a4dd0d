"""The meaning of each colour, dash and marker in all pictures.

A run has a colour, and in print also a marker. A loop of its law has a dash. The kind of any other
curve determines its colour and dash.
"""

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Final, Literal

from turtlelog.charts import palette
from turtlelog.charts.palette import Color
from turtlelog.charts.plotted_curves import CurveKind

Dash = Literal["solid", "dashed", "dotted", "dash-dot"]
Marker = Literal["up", "diamond", "down", "plus", "star", "left", "right"]

_FIXED: Final[Mapping[CurveKind, Color]] = MappingProxyType(
    {
        "applied": palette.MEASURED,
        "shaped": palette.SHAPED,
        "ideal": palette.IDEAL,
        "aim": palette.IDEAL,
        "sensed": palette.SENSED,
        "dropped_out": palette.DROPPED_OUT,
    }
)
"""Kinds of curves whose colour is the same for every run."""

_DASHES: Final[Mapping[CurveKind, Dash]] = MappingProxyType(
    {"ideal": "dotted", "aim": "dash-dot", "shaped": "dash-dot"}
)
"""Dashes of all kinds of curves except the run's own."""

LIMIT_DASH: Final[Dash] = "dashed"
"""Dash of limits and tolerances; references are solid."""

SUPPOSED_DASH: Final[Dash] = "dashed"
"""Dash of curves that did not happen: a run without some effects, the output of a model."""

LOOP_DASHES: Final[tuple[Dash, ...]] = ("solid", "dashed", "dash-dot", "dotted")
"""Dashes of a law's loops in declared order. With more loops, the dashes repeat."""

RUN_MARKERS: Final[tuple[Marker, ...]] = ("up", "diamond", "down", "plus", "star", "left", "right")
"""Markers of runs with distinct hues, for pictures without colour: triangles up, down, left and
right, and others. Discs, squares and crosses mark places and values."""


def choose_curve_color(kind: CurveKind, run: Color, *, is_alone: bool) -> Color:
    """Return the colour of a curve.

    Args:
        kind: Kind of the curve.
        run: Colour of the curve's run.
        is_alone: Whether the picture has no other run. Among several runs, measured values have the
            colour of their run.
    """
    if kind in ("measured", "outlier"):
        return palette.MEASURED if is_alone else run
    if kind == "beside":
        return palette.tint(run)
    if kind == "applied" and not is_alone:
        return run
    return _FIXED.get(kind, run)


def choose_dash(kind: CurveKind) -> Dash:
    """Return the dash of a curve of a run, which depends on the kind of the curve."""
    return _DASHES.get(kind, "solid")


_FEW_TURTLES: Final = 4
"""Largest number of turtles of full size; more are smaller."""

_SMALLEST_TURTLE: Final = 0.3
"""Smallest size of a turtle as a share of the full size: a shell of 4 pixels, as large as the
dot."""


def choose_turtle_size(turtles: int) -> float:
    """Return the size of each turtle in a group. Many turtles cover as much area as a few."""
    return max(min(1.0, math.sqrt(_FEW_TURTLES / max(turtles, 1))), _SMALLEST_TURTLE)


def choose_markers(count: int) -> tuple[Marker, ...]:
    """Return markers that distinguish several runs. A single run, and very many runs, have none."""
    return RUN_MARKERS[:count] if 1 < count <= len(RUN_MARKERS) else ()
