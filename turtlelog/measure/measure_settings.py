"""Settings of the metrics."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal, cast

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import MeasureError
from turtlelog.run.loops import Declaration

SETTLING_BAND: Final = 0.02
"""Default half-width of the settling band, as a fraction of the step."""

MOST_TICKS: Final = 1000
"""Largest dead time for which the delayed ideal loop is computed [ticks]."""

Target = float | Literal["reference", "last"]
"""Final value of a loop's step."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MeasureSettings:
    """Settings of the metrics. Values of a loop are in rad (heading) or m.

    Attributes:
        band: Half-width of the settling band, as a fraction of the step, > 0 and < 1.
        initial: Start value of the step of a loop: None for the first value of its segment, a
            number, or a number by loop (`{"translate": 0.0}`).
        final: Final value of the step: `reference` (as the law declares), `last` (the last value of
            the segment), a number, or one of these by loop.
        reference_path_xy_m: Path for cross-track errors, a line through points in the world frame
            [m], shape (n, 2), n >= 2; None for the line from start to goal.
        goal_tolerance_m: Distance from the goal within which the robot has arrived [m], > 0; None
            for `band` times the initial distance.
        dead_time_ticks: Dead time of the delayed ideal loop, in samples of its period, 0 to 1000;
            None for the dead time found in the recording.

    Raises:
        MeasureError: If a setting is wrong; one line with the setting, the valid values and the
            given one.
    """

    band: float = SETTLING_BAND
    initial: float | Mapping[str, float] | None = None
    final: Target | Mapping[str, Target] = "reference"
    reference_path_xy_m: NDArray[np.float64] | None = None
    dead_time_ticks: int | None = None
    goal_tolerance_m: float | None = None

    def __post_init__(self) -> None:
        _require_fraction(self.band)
        if self.goal_tolerance_m is not None:
            _require_positive("goal_tolerance_m", "metres", self.goal_tolerance_m)
        for value in _list_values(self.initial):
            if value is not None and not _is_number(value):
                raise MeasureError(f"initial: expected a number, found {value!r}")
        for value in _list_values(self.final):
            if value not in ("reference", "last") and not _is_number(value):
                raise MeasureError(
                    f"final: expected 'reference', 'last' or a number, found {value!r}"
                )
        ticks = self.dead_time_ticks
        if ticks is not None and not (isinstance(ticks, int) and 0 <= ticks <= MOST_TICKS):
            raise MeasureError(
                f"dead_time_ticks: expected a whole number from 0 to {MOST_TICKS}, found {ticks!r}"
            )
        if self.reference_path_xy_m is not None:
            path_xy_m = _require_path(self.reference_path_xy_m)
            object.__setattr__(self, "reference_path_xy_m", path_xy_m)

    def get_initial(self, loop: str) -> float | None:
        """Return the initial value of a loop's step; None for the first value of its segment."""
        return self.initial.get(loop) if isinstance(self.initial, Mapping) else self.initial

    def get_final(self, loop: str) -> Target:
        """Return the final value of the step of a loop."""
        if isinstance(self.final, Mapping):
            return self.final.get(loop, "reference")
        return self.final

    def require_loops(self, declaration: Declaration) -> None:
        """Raise an error if a value is given for a loop that the law does not declare.

        Raises:
            MeasureError: If there is such a loop; the message lists the declared loops.
        """
        known = [loop.name for loop in declaration.loops]
        for name, value in (("initial", self.initial), ("final", self.final)):
            for loop in value if isinstance(value, Mapping) else ():
                if loop not in known:
                    listed = " or ".join(known) or "no loop, for the run declares none"
                    raise MeasureError(f"{name}: expected a loop {listed}, found {loop!r}")


def _require_fraction(band: object) -> None:
    if not (_is_number(band) and 0.0 < cast("float", band) < 1.0):
        raise MeasureError(
            f"band: must be a fraction of the step from 0 to 1, as 0.02 for 2 %, not {band!r}"
        )


def _require_positive(name: str, what: str, value: object) -> None:
    if not (_is_number(value) and cast("float", value) > 0.0):
        raise MeasureError(f"{name}: expected {what} > 0, found {value!r}")


def _is_number(value: object) -> bool:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return is_number and math.isfinite(cast("float", value))


def _list_values(value: object) -> list[object]:
    return list(value.values()) if isinstance(value, Mapping) else [value]


def _require_path(path_xy_m: NDArray[np.float64]) -> NDArray[np.float64]:
    try:
        path = np.array(path_xy_m, dtype=np.float64)
    except (TypeError, ValueError) as err:
        raise MeasureError("reference_path_xy_m: expected points, found something else") from err
    if path.ndim != 2 or path.shape[1] != 2 or len(path) < 2:
        raise MeasureError(
            f"reference_path_xy_m: expected two points or more, shape (n, 2), found {path.shape}"
        )
    if not np.isfinite(path).all():
        row = int((~np.isfinite(path)).any(axis=1).argmax())
        raise MeasureError(f"reference_path_xy_m[{row}]: expected finite numbers, found others")
    path.flags.writeable = False
    return path
