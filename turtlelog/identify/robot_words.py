"""How a robot follows its commands, in words: values with intervals, and what they come to."""

from collections.abc import Iterable
from typing import Final

from turtlelog.identify.axis_motion import NAMES
from turtlelog.identify.robot_model import AxisModel, Estimate

_WHOLE_MS: Final = 10.0
"""Width of an interval above which tenths of a millisecond tell nothing [ms]."""


def write_headline(axes: Iterable[AxisModel], name: str) -> str:
    """Return with what gain and how late each axis follows its commands.

    Args:
        axes: Axes of the robot.
        name: Name of the run from which it was identified.
    """
    axes = [*axes]
    said = [
        f"{NAMES[axis.axis]} {{}}{_write_gain(axis.gain)}total delay"
        f" {_write_delay(axis.total_delay_s)}"
        for axis in axes
        if axis.total_delay_s is not None
    ]
    unknown = [NAMES[axis.axis] for axis in axes if not axis.is_known]
    if not said:
        return f"{name}: no axis could be identified."
    rest = f" The {unknown[0]} could not be identified." if unknown else ""
    words = ", ".join(
        [said[0].format("follows its commands with "), *(one.format("with ") for one in said[1:])]
    )
    return f"{name}: {words}.{rest}"


def _write_gain(found: Estimate | None) -> str:
    return "" if found is None else f"gain {format_gain(found).partition(' ')[0]} and "


def _write_delay(found: Estimate) -> str:
    value, _, interval = format_delay(found).partition(" ")
    return f"{value} ms {interval}"


def format_gain(found: Estimate | None) -> str:
    """Return a gain with its interval; `-` for none."""
    return "-" if found is None else f"{found.value:.3f} ({found.low:.3f} to {found.high:.3f})"


def format_delay(found: Estimate | None) -> str:
    """Return a delay with its interval in ms; `-` for none."""
    if found is None:
        return "-"
    value, low, high = (1e3 * number for number in (found.value, found.low, found.high))
    digits = 0 if high - low > _WHOLE_MS else 1
    return f"{value:.{digits}f} ({low:.{digits}f} to {high:.{digits}f})"


def list_values(axis: AxisModel) -> tuple[str, str, str, str]:
    """Return the name of an axis, its gain, dead time and time constant, with intervals."""
    dead_time, lag = format_delay(axis.dead_time_s), format_delay(axis.lag_s)
    return NAMES[axis.axis], format_gain(axis.gain), dead_time, lag


HEADS: Final = ("axis", "gain [1]", "dead time [ms]", "time constant [ms]")
"""Titles of what `list_values` returns."""
