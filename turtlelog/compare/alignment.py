"""A common clock for two runs: time zero of each, and the segment that both cover."""

import dataclasses
import re
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import CompareError, suggest_names
from turtlelog.measure import Signal
from turtlelog.run import Run
from turtlelog.run.loops import NAME_PATTERN

Times = NDArray[np.int64]

ALIGNMENTS: Final = ("first_sample", "phase:NAME", "recorded", "sample")
"""Ways to align runs; NAME stands for a phase of their law."""


class CommonClock(Protocol):
    """The clock on which two runs are compared."""

    @property
    def tells_time(self) -> bool:
        """Whether the units of the clock are nanoseconds, so that tolerances in time apply."""

    @property
    def span(self) -> tuple[int, int]:
        """First and last compared time in the units of the clock, both included."""

    def place_signal(self, signal: Signal, run: Run) -> Signal:
        """Return the signal of one of the two runs, with its rows on this clock."""

    def read_ns(self, unit: int) -> int:
        """Return the time of a unit of this clock [ns]."""


def could_be_alignment(text: str) -> bool:
    """Return whether a text is an alignment, possibly with a phase of any law."""
    phase = text.removeprefix("phase:")
    return text in ALIGNMENTS or (phase != text and re.fullmatch(NAME_PATTERN, phase) is not None)


def align_runs(reference: Run, run: Run, alignment: str) -> CommonClock:
    """Return the clock of one of `ALIGNMENTS` for two runs; a phase belongs to one of their laws.

    Raises:
        CompareError: If there is no such alignment, the alignment needs data that a run lacks, or
            the runs do not overlap.
    """
    for one in (reference, run):
        if not len(one.poses):
            raise CompareError(f"{one.name}: the recording holds no poses, which are compared")
    phases = dict.fromkeys([*reference.phase_names, *run.phase_names])
    known = ["first_sample", *(f"phase:{phase}" for phase in phases), "recorded", "sample"]
    if alignment not in known:
        expected = suggest_names(alignment, known)
        raise CompareError(f"alignment: expected {expected}, found {alignment!r}")
    if alignment == "sample":
        return _align_by_number(reference, run)
    if alignment == "recorded":
        starts_ns = [reference.start_ns, run.start_ns]
        return _align_by_time((reference, run), (0, 0), max(starts_ns))
    zeros_ns = (_find_phase_ns(reference, alignment), _find_phase_ns(run, alignment))
    # What stands before is not compared: before the first sample nothing was controlled yet.
    return _align_by_time((reference, run), zeros_ns, 0)


@dataclass(frozen=True, slots=True, kw_only=True)
class _TimeClock:
    """Nanoseconds from time zero of each run."""

    runs: tuple[Run, Run]
    zeros_ns: tuple[int, int]
    span: tuple[int, int]
    tells_time: bool = True

    def place_signal(self, signal: Signal, run: Run) -> Signal:
        zero_ns = self.zeros_ns[0 if run is self.runs[0] else 1]
        return _smooth(dataclasses.replace(signal, time_ns=signal.time_ns - zero_ns))

    def read_ns(self, unit: int) -> int:
        return unit


@dataclass(frozen=True, slots=True, kw_only=True)
class _SampleClock:
    """Numbers of samples.

    Poses are those that the samples read; times are those of the reference.
    """

    time_ns: Times
    tells_time: bool = False

    @property
    def span(self) -> tuple[int, int]:
        return 0, len(self.time_ns) - 1

    def place_signal(self, signal: Signal, run: Run) -> Signal:
        rows = np.arange(len(self.time_ns))
        read = rows
        if signal.kind.source != "sample":
            # Of what was sensed as well, for what a sample read did not drop out.
            read_ns = run.poses.time_ns[run.samples.pose_sequence[rows]]
            read = np.searchsorted(signal.time_ns, read_ns)
        placed = dataclasses.replace(signal, time_ns=rows, values=signal.values[read])
        return _smooth(placed)

    def read_ns(self, unit: int) -> int:
        return int(self.time_ns[unit])


def _smooth(signal: Signal) -> Signal:
    """Remove the jumps of an angle at full turns, so that it can be interpolated."""
    if signal.kind.compared_as != "angle":
        return signal
    return dataclasses.replace(signal, values=np.unwrap(signal.values))


def _align_by_time(
    runs: tuple[Run, Run], zeros_ns: tuple[int, int], earliest_ns: int
) -> CommonClock:
    placed = tuple(zip(runs, zeros_ns, strict=True))
    start_ns = max(earliest_ns, *(int(run.poses.time_ns[0]) - zero for run, zero in placed))
    end_ns = min(run.end_ns - zero for run, zero in placed)
    if end_ns <= start_ns:
        names = " and ".join(run.name for run, _ in placed)
        raise CompareError(f"{names}: expected runs that overlap, found {_describe_spans(placed)}")
    return _TimeClock(runs=runs, zeros_ns=zeros_ns, span=(start_ns, end_ns))


def _describe_spans(placed: tuple[tuple[Run, int], ...]) -> str:
    spans = (
        f"{(int(run.poses.time_ns[0]) - zero) / 1e9:.2f} to {(run.end_ns - zero) / 1e9:.2f} s"
        for run, zero in placed
    )
    return " and ".join(spans)


def _align_by_number(reference: Run, run: Run) -> CommonClock:
    for found in (reference, run):
        if not len(found.samples):
            raise CompareError(f"{found.name}: no samples to align by number")
    count = min(len(reference.samples), len(run.samples))
    return _SampleClock(time_ns=reference.samples.time_ns[:count] - reference.start_ns)


def find_zero_ns(run: Run, alignment: str) -> int:
    """Return time zero of an alignment in a run [ns]; by sample number, the first sample."""
    if alignment == "recorded":
        return 0
    return run.start_ns if alignment == "sample" else _find_phase_ns(run, alignment)


def _find_phase_ns(run: Run, alignment: str) -> int:
    phase = alignment.removeprefix("phase:")
    if phase == "first_sample":
        return run.start_ns
    for span in run.find_phase_spans():
        if span.phase == phase:
            return span.start_ns
    found = ", ".join(dict.fromkeys(span.phase for span in run.find_phase_spans())) or "none"
    raise CompareError(f"{run.name}: expected a phase {phase} to align at, found {found}")
