"""First difference of two runs of the same settings, and what it shows of the cause."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from turtlelog.replay.differences import (
    Difference,
    Pairing,
    compare_pairing,
    find_earliest,
)
from turtlelog.replay.run_pairs import (
    compare_ends,
    count_missing_samples,
    count_recorded_rows,
    find_count_difference,
    has_ticks,
    pair_by_sample,
    pair_by_tick,
)
from turtlelog.run import Run

Part = Literal["start", "robot", "sensor", "controller", "timing", "end"]

_TIMES: Final = ("sample_time", "pose_read", "command_time")
_POSES: Final = ("x", "y", "heading", "applied_speed", "applied_turn_rate")
_ENDS: Final = ("stop", "samples", "poses", "commands")


@dataclass(frozen=True, slots=True, kw_only=True)
class Departure:
    """The earliest difference of two runs.

    Attributes:
        part: Part that differs first. `start`: the first pose. `robot`: it moves otherwise after
            equal commands. `sensor`: the pose as sensed. `controller`: it answers an equal pose
            otherwise. `timing`: the time of a sample or command. `end`: one run is longer.
        signal: Name of the signal that differs.
        unit: Unit of the values; empty for a name or a count.
        time_s: Time of the difference from the first pose [s].
        first: The value of the first run; None if it has none there.
        second: The value of the second run.
        samples: Samples before it, which are equal in both runs.
    """

    part: Part
    signal: str
    unit: str
    time_s: float
    first: float | str | None
    second: float | str | None
    samples: int


def find_departure(first: Run, second: Run) -> Departure | None:
    """Return where two runs depart; None if all that both contain is equal.

    Poses are compared tick by tick if both runs contain all ticks, otherwise those that samples
    read are.
    """
    signals = [compare_pairing(one, tolerance=0.0) for one in _pair(first, second)]
    others = [*_compare_counts(first, second), compare_ends(first, second.stop_reason)]
    found = find_earliest([*(one.first_difference for one in signals), *others])
    if found is None:
        return None
    units = {one.signal: one.unit for one in signals}
    return Departure(
        part=_name_part(found, first),
        signal=found.signal,
        unit=units.get(found.signal, ""),
        time_s=float(found.time_ns - first.poses.time_ns[0]) / 1e9,
        first=found.recorded,
        second=found.replayed,
        samples=int(np.searchsorted(first.samples.time_ns, found.time_ns)),
    )


def _pair(first: Run, second: Run) -> Iterator[Pairing]:
    """Yield the signals row by row: causes before what follows from them at one time."""
    if count_missing_samples(second.samples):  # rows are matched by the number of their sample
        return
    by_tick = has_ticks(first) and has_ticks(second)
    pairings = (pair_by_tick if by_tick else pair_by_sample)(first, second)
    yield from (one for one in pairings if len(one.time_ns))


def _compare_counts(first: Run, second: Run) -> Iterator[Difference | None]:
    by_tick = has_ticks(first) and has_ticks(second)
    for name, count in count_recorded_rows(first, second, by_tick=by_tick).items():
        found = find_count_difference(first, name, count)
        if found is not None:
            end_ns = min(first.end_ns, second.end_ns)
            yield Difference(
                signal=name, time_ns=end_ns, recorded=found.recorded, replayed=found.replayed
            )


def _name_part(found: Difference, first: Run) -> Part:
    signal = found.signal
    if signal in _ENDS:
        return "end"
    if signal in _TIMES:
        return "timing"
    if signal.startswith("sensed_"):
        return "sensor"
    if signal in _POSES:
        return "start" if found.time_ns <= first.poses.time_ns[0] else "robot"
    return "controller"
