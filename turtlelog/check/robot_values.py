"""What a robot is identified to be, as values that checks name: `robot.speed.dead_time.high`."""

from collections.abc import Iterable, Mapping
from itertools import product
from types import MappingProxyType
from typing import Final

from turtlelog.measure import Metric
from turtlelog.measure.metric import NO_POSES, Status
from turtlelog.run import Run

_AXES: Final = ("speed", "turn_rate")
_FIELDS: Final = MappingProxyType(
    {
        "gain": ("gain", "1"),
        "dead_time": ("dead_time_s", "s"),
        "time_constant": ("lag_s", "s"),
        "total_delay": ("total_delay_s", "s"),
    }
)
_ENDS: Final = MappingProxyType({"": "value", ".low": "low", ".high": "high"})

ROBOT_VALUES: Final[Mapping[str, tuple[str, str, str]]] = MappingProxyType(
    {
        f"robot.{axis}.{name}{end}": (axis, name, end)
        for axis, name, end in product(_AXES, _FIELDS, _ENDS)
    }
)
"""Axis, parameter and end of the interval of 95 % by the names that checks use."""


def find_robot_unit(name: str) -> str:
    """Return the unit of a value of a robot."""
    return _FIELDS[ROBOT_VALUES[name][1]][1]


def measure_robot(run: Run, names: Iterable[str]) -> dict[str, Metric]:
    """Return values of the robot that a run shows; one that is not identified has the reason.

    Args:
        run: With commands and motion.
        names: Of `ROBOT_VALUES`.
    """
    names = [*names]
    if not names:
        return {}
    if not len(run.poses):
        return {
            name: Metric(
                id=name,
                value=None,
                unit=find_robot_unit(name),
                status=NO_POSES.status,
                reason=NO_POSES.reason,
            )
            for name in names
        }
    from turtlelog.identify import identify_robot  # few checks need it

    model = identify_robot(run)
    found = {}
    for name in names:
        axis, parameter, end = ROBOT_VALUES[name]
        of_axis, unit = getattr(model, axis), find_robot_unit(name)
        estimate = getattr(of_axis, _FIELDS[parameter][0])
        value = None if estimate is None else getattr(estimate, _ENDS[end])
        reason = "" if value is not None else of_axis.reason or "the model has no such parameter"
        status = Status.UNDETERMINED if value is None else Status.OK
        found[name] = Metric(id=name, value=value, unit=unit, status=status, reason=reason)
    return found
