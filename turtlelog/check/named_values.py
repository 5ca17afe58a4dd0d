"""Values other than metrics in checks: of an identified robot, and relative to a reference path."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import product
from types import MappingProxyType
from typing import Final

from turtlelog.compare import TrajectorySettings, compare_trajectories
from turtlelog.errors import CompareError, LogError
from turtlelog.log import ReadChoice, read_trajectory
from turtlelog.measure import Metric
from turtlelog.measure.metric import NO_POSES, Status
from turtlelog.run import Run, Trajectory, build_planar_trajectory

_ROBOT_AXES: Final = ("speed", "turn_rate")

_ROBOT_FIELDS: Final = MappingProxyType(
    {
        "gain": ("gain", "1"),
        "dead_time": ("dead_time_s", "s"),
        "time_constant": ("lag_s", "s"),
        "total_delay": ("total_delay_s", "s"),
    }
)

_INTERVAL_ENDS: Final = MappingProxyType({"": "value", ".low": "low", ".high": "high"})


ROBOT_VALUES: Final[Mapping[str, tuple[str, str, str]]] = MappingProxyType(
    {
        f"robot.{axis}.{name}{end}": (axis, name, end)
        for axis, name, end in product(_ROBOT_AXES, _ROBOT_FIELDS, _INTERVAL_ENDS)
    }
)
"""Axis, parameter and end of its 95 % interval, by the names in checks."""

_ERROR_KINDS: Final = ("ate", "rpe")


_ERROR_QUANTITIES: Final = MappingProxyType(
    {"position": ("m", 1.0), "rotation": ("deg", math.degrees(1))}
)

_STATISTICS: Final = ("rmse", "mean", "median", "std", "min", "max")


TRAJECTORY_VALUES: Final[Mapping[str, tuple[str, str, str]]] = MappingProxyType(
    {".".join(parts): parts for parts in product(_ERROR_KINDS, _ERROR_QUANTITIES, _STATISTICS)}
)
"""Error, quantity and statistic, by the names in checks."""


def find_robot_unit(name: str) -> str:
    """Return the unit of a robot value."""
    return _ROBOT_FIELDS[ROBOT_VALUES[name][1]][1]


def measure_robot(run: Run, names: Iterable[str]) -> dict[str, Metric]:
    """Return values of the robot in a run, or the reason for each value that is not identified.

    Args:
        run: Run with commands and motion.
        names: Names from `ROBOT_VALUES`.
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
        estimate = getattr(of_axis, _ROBOT_FIELDS[parameter][0])
        value = None if estimate is None else getattr(estimate, _INTERVAL_ENDS[end])
        reason = "" if value is not None else of_axis.reason or "the model has no such parameter"
        status = Status.UNDETERMINED if value is None else Status.OK
        found[name] = Metric(id=name, value=value, unit=unit, status=status, reason=reason)
    return found


def find_trajectory_unit(name: str) -> str:
    """Return the unit of a trajectory value."""
    return _ERROR_QUANTITIES[TRAJECTORY_VALUES[name][1]][0]


@dataclass(frozen=True, slots=True, kw_only=True)
class TrajectoryJudge:
    """Measurement of the errors of recordings relative to one reference.

    Attributes:
        reference: Trajectory that counts as true.
        settings: Settings of the comparison.
        choice: Settings for reading third-party files.
        reads_files: Whether recordings are named by their files, from which poses in space are
            read.
    """

    reference: Trajectory
    settings: TrajectorySettings
    choice: ReadChoice
    reads_files: bool

    def measure(self, run: Run, names: Iterable[str], file: str) -> dict[str, Metric]:
        """Return the values of a recording, or the reason for each value that cannot be computed.

        Args:
            run: Run with poses in the plane.
            names: Names from `TRAJECTORY_VALUES`.
            file: Name of the recording.
        """
        names = [*names]
        try:
            found = compare_trajectories(self.reference, self._read(run, file), self.settings)
        except (CompareError, LogError) as err:
            return {name: _build(name, None, str(err)) for name in names}
        values = {}
        for name in names:
            kind, quantity, statistic = TRAJECTORY_VALUES[name]
            statistics = found.find_error(kind, quantity)
            assert statistics is not None  # the settings have a length for each kind
            values[name] = _build(name, float(getattr(statistics, statistic)), "")
        return values

    def _read(self, run: Run, file: str) -> Trajectory:
        found = (
            read_trajectory(file, self.choice) if self.reads_files else build_planar_trajectory(run)
        )
        return replace(found, name=file)


def _build(name: str, value: float | None, reason: str) -> Metric:
    unit, factor = _ERROR_QUANTITIES[TRAJECTORY_VALUES[name][1]]
    status = Status.UNDETERMINED if value is None else Status.OK
    shown = None if value is None else factor * value
    return Metric(id=name, value=shown, unit=unit, status=status, reason=reason)
