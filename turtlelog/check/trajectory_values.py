"""Errors beside a reference trajectory, as values that checks name: `ate.position.rmse`."""

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
from turtlelog.measure.metric import Status
from turtlelog.run import Run, Trajectory, build_planar_trajectory

_KINDS: Final = ("ate", "rpe")
_QUANTITIES: Final = MappingProxyType(
    {"position": ("m", 1.0), "rotation": ("deg", math.degrees(1))}
)
_STATISTICS: Final = ("rmse", "mean", "median", "std", "min", "max")

TRAJECTORY_VALUES: Final[Mapping[str, tuple[str, str, str]]] = MappingProxyType(
    {".".join(parts): parts for parts in product(_KINDS, _QUANTITIES, _STATISTICS)}
)
"""Error, quantity and statistic by the names that checks use."""


def find_trajectory_unit(name: str) -> str:
    """Return the unit of a value of a trajectory."""
    return _QUANTITIES[TRAJECTORY_VALUES[name][1]][0]


@dataclass(frozen=True, slots=True, kw_only=True)
class TrajectoryJudge:
    """Measures the errors of recordings beside one reference.

    Attributes:
        reference: What is taken as true.
        settings: How both are compared.
        choice: What is read of third-party files.
        reads_files: Whether recordings are called as their files, whose poses in space are read.
    """

    reference: Trajectory
    settings: TrajectorySettings
    choice: ReadChoice
    reads_files: bool

    def measure(self, run: Run, names: Iterable[str], file: str) -> dict[str, Metric]:
        """Return values of a recording; one that cannot be compared has the reason.

        Args:
            run: Its poses in the plane.
            names: Of `TRAJECTORY_VALUES`.
            file: What it is called.
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
            assert statistics is not None  # of each kind the settings have a length
            values[name] = _build(name, float(getattr(statistics, statistic)), "")
        return values

    def _read(self, run: Run, file: str) -> Trajectory:
        found = (
            read_trajectory(file, self.choice) if self.reads_files else build_planar_trajectory(run)
        )
        return replace(found, name=file)


def _build(name: str, value: float | None, reason: str) -> Metric:
    unit, factor = _QUANTITIES[TRAJECTORY_VALUES[name][1]]
    status = Status.UNDETERMINED if value is None else Status.OK
    shown = None if value is None else factor * value
    return Metric(id=name, value=shown, unit=unit, status=status, reason=reason)
