"""Samples packed as they come, and put into columns."""

from struct import Struct
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.run import SampleColumns
from turtlelog.simulate.law_driver import Sample

_SAMPLE_ROW: Final = Struct("<4q11d")


def pack_sample(sample: Sample) -> bytes:
    """Return a sample as one row, 8 bytes a value, whole numbers first."""
    return _SAMPLE_ROW.pack(sample.time_ns, *sample.row)


def build_samples(packed: bytearray) -> SampleColumns:
    """Return the columns of packed samples."""
    integers, values = split_rows(packed, _SAMPLE_ROW, integers=4)
    time_ns, sequence, pose_sequence, phase = integers
    bearing, heading_error, error_x, error_y, distance, *commands, world_x, world_y = values
    wanted_speed, wanted_turn_rate, speed, turn_rate = commands
    return SampleColumns(
        time_ns=time_ns,
        sequence=sequence,
        pose_sequence=pose_sequence,
        phase=phase,
        bearing_rad=bearing,
        heading_error_rad=heading_error,
        error_xy_m=np.column_stack([error_x, error_y]),
        distance_m=distance,
        wanted_speed_m_s=wanted_speed,
        wanted_turn_rate_rad_s=wanted_turn_rate,
        speed_m_s=speed,
        turn_rate_rad_s=turn_rate,
        world_velocity_m_s=np.column_stack([world_x, world_y]),
    )


def split_rows(
    packed: bytearray, row: Struct, *, integers: int
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the first columns as integers, the others as floats, each shape (columns, rows)."""
    words = np.frombuffer(packed, dtype="<i8").reshape(-1, row.size // 8).T
    return words[:integers].copy(), words[integers:].copy().view("<f8")
