"""Samples packed as they come, and put into columns."""

from struct import Struct
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.loops import Declaration
from turtlelog.run import SampleColumns
from turtlelog.simulate.law_driver import Sample

_SAMPLE_ROW: Final = Struct("<4q11d")
_WHOLE: Final = 4
_NAN: Final = float("nan")


class SampleRows:
    """Packs the samples of a law, 8 bytes a value, whole numbers first."""

    __slots__ = ("_declaration", "_extra", "_pack", "_packed")

    def __init__(self, declaration: Declaration) -> None:
        """Make room for the states and the reference that a law declares."""
        self._declaration = declaration
        self._pack = _SAMPLE_ROW.pack
        extra = len(declaration.states) + 3 * declaration.has_reference
        self._extra = Struct(f"<{extra}d") if extra else None
        self._packed = bytearray()

    def __len__(self) -> int:
        return len(self._packed) // self._row_size

    @property
    def _row_size(self) -> int:
        return _SAMPLE_ROW.size + (self._extra.size if self._extra else 0)

    def add(self, sample: Sample) -> None:
        """Take the next sample."""
        decision = sample.decision
        # In the order of `Sample.row`, without a tuple on the way: this runs with every sample.
        self._packed += self._pack(
            sample.time_ns,
            sample.sequence,
            sample.pose_sequence,
            sample.phase,
            decision.bearing_rad,
            decision.heading_error_rad,
            decision.error_x_m,
            decision.error_y_m,
            sample.distance_m,
            decision.speed_m_s,
            decision.turn_rate_rad_s,
            sample.speed_m_s,
            sample.turn_rate_rad_s,
            decision.world_v_x_m_s,
            decision.world_v_y_m_s,
        )
        if self._extra is not None:
            self._packed += self._extra.pack(*_list_extra_values(sample, self._declaration))

    def build_columns(self) -> SampleColumns:
        """Return the columns of all samples so far."""
        declaration = self._declaration
        integers, values = _split_rows(self._packed, self._row_size, integers=_WHOLE)
        time_ns, sequence, pose_sequence, phase = integers
        bearing, heading_error, error_x, error_y, distance, *commands = values[:9]
        world, extra = values[9:11], values[11:]
        wanted_speed, wanted_turn_rate, speed, turn_rate = commands
        states = extra[: len(declaration.states)]
        reference = extra[len(declaration.states) :]
        return SampleColumns(
            time_ns=time_ns,
            sequence=sequence,
            pose_sequence=pose_sequence,
            phase=phase,
            bearing_rad=_if_whole(bearing),
            heading_error_rad=_if_whole(heading_error),
            error_xy_m=_if_whole(np.column_stack([error_x, error_y])),
            distance_m=_if_whole(distance),
            wanted_speed_m_s=wanted_speed,
            wanted_turn_rate_rad_s=wanted_turn_rate,
            speed_m_s=speed,
            turn_rate_rad_s=turn_rate,
            world_velocity_m_s=None if np.isnan(world).all() else np.column_stack([*world]),
            states=np.column_stack(list(states)) if declaration.states else None,
            reference_xy_m=np.column_stack(list(reference[:2])) if len(reference) else None,
            reference_heading_rad=reference[2] if len(reference) else None,
        )


def _list_extra_values(sample: Sample, declaration: Declaration) -> tuple[float, ...]:
    """Return the states of a sample, and its reference pose where the law declares one."""
    states, reference = sample.decision.states, sample.decision.reference
    if not declaration.has_reference:
        return states
    if reference is None:
        return (*states, _NAN, _NAN, _NAN)
    return (*states, reference.x_m, reference.y_m, reference.heading_rad)


def split_rows(
    packed: bytearray, row: Struct, *, integers: int
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the first columns as integers, the others as floats, each shape (columns, rows)."""
    return _split_rows(packed, row.size, integers=integers)


def _split_rows(
    packed: bytearray, size: int, *, integers: int
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    words = np.frombuffer(packed, dtype="<i8").reshape(-1, size // 8).T
    return words[:integers].copy(), words[integers:].copy().view("<f8")


def _if_whole(values: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Return a column, None where a row holds no number: without a goal there are no errors."""
    return None if np.isnan(values).any() else values
