"""What each colour means in every picture: one for a run, others for what stands beside it."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from turtlelog.charts import palette
from turtlelog.charts.palette import Color
from turtlelog.charts.plotted_curves import CurveKind

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
"""Kinds whose colour is the same of every run."""


def choose_curve_color(kind: CurveKind, run: Color, *, is_alone: bool) -> Color:
    """Return the colour of a curve.

    Args:
        kind: What it is.
        run: Colour of its run.
        is_alone: Whether no other run is in the picture; among several what a robot measured has
            the colour of its run.
    """
    if kind in ("measured", "outlier"):
        return palette.MEASURED if is_alone else run
    if kind == "beside":
        return palette.tint(run)
    if kind == "applied" and not is_alone:
        return run
    return _FIXED.get(kind, run)
