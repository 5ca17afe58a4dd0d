"""What is said of two robots' logs beside the contributions: values of parts, and the method."""

from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from turtlelog.display import join_words
from turtlelog.explain.attribution import is_clear
from turtlelog.explain.explained_difference import ROBOT
from turtlelog.explain.robot_parts import COMMANDS
from turtlelog.identify.axis_motion import AXES, NAMES, UNITS

if TYPE_CHECKING:
    from turtlelog.explain.explained_difference import Change, ExplainedDifference, Side

_MS: Final = ("dead_time_s", "lag_s")
"""Values that are shown in milliseconds."""

_AFTER: Final = MappingProxyType({"gain": "", "reverse_gain": " backwards", "rate_limit": "/s"})
"""What is written after a value, in place of the unit of the axis or behind it."""


def is_robot_part(one: "Change") -> bool:
    """Return whether a group is a part of an identified robot's axis."""
    return one.keys[0].partition(".")[0] in AXES


def describe_robot_part(one: "Change") -> str:
    """Return a part with its values in both logs: `dead time turning (70 -> 110 ms)`."""
    for key, before, after in zip(one.keys, one.first, one.second, strict=False):
        if before != after and not isinstance(before or after, str):
            return f"{one.name} ({_format_pair(key, before, after)})"
    return one.name


def _format_pair(key: str, before: Any, after: Any) -> str:
    axis, _, name = key.partition(".")
    of_axis = UNITS["speed" if axis == "speed" else "turn_rate"]
    factor, unit = (1e3, " ms") if name in _MS else (1.0, f" {of_axis}")
    unit = _AFTER[name] if name.endswith("gain") else unit + _AFTER.get(name, "")
    shown = ["none" if one is None else f"{factor * one:.3g}" for one in (before, after)]
    if after is None:
        return f"{shown[0]}{unit} -> none"
    return f"{' -> '.join(shown)}{unit}"


def write_robot_basis(found: "ExplainedDifference") -> list[str]:
    """Return what the contributions of two robots' parts rest on; empty for simulated runs."""
    sides = [side for side in (found.first, found.second) if side.basis == ROBOT]
    said = [f"{side.name}: {side.note}." for side in sides if side.note]
    said += [_write_unknown(side) for side in sides if side.unknown]
    if not sides or not found.contributions:
        return said
    answers = any(
        one.name == COMMANDS and is_clear(one.contribution or 0.0, one.standard_error)
        for one in found.contributions
    )
    return [
        *(["Why the commands differ is not in the logs: they may answer the robot."] * answers),
        "Each robot's model is driven with the recorded commands. Intervals are 95 %, from"
        f" {found.seeds} draws of the identified parameters and the noise.",
        *said,
    ]


def _write_unknown(side: "Side") -> str:
    names = join_words([NAMES[axis] for axis in AXES if axis in side.unknown])
    return f"{side.name} has no commands of the {names}, so the other robot's is taken for it."
