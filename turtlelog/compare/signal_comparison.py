"""Signals of a run and a reference on a common clock: deviations and tolerances."""

import dataclasses
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.compare import tube
from turtlelog.compare.tube import Grid, GridValues, Tolerance
from turtlelog.errors import CompareError, find_near, join_names, suggest_names
from turtlelog.measure import SIGNALS, Signal, find_signal, list_signal_units, list_signals
from turtlelog.replay.differences import Difference, SignalDifference as SignalDifference
from turtlelog.run import Run
from turtlelog.run.loops import NAME_PATTERN

Times = NDArray[np.int64]

ALIGNMENTS: Final = ("first_sample", "phase:NAME", "recorded", "sample")
"""Ways to align runs; NAME stands for a phase of their law."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _TimeClock:
    """Nanoseconds from time zero of each run; `span` has the first and last compared ones."""

    runs: tuple[Run, Run]
    zeros_ns: tuple[int, int]
    span: tuple[int, int]
    tells_time: bool = True
    """Whether the units of the clock are nanoseconds, so that tolerances in time apply."""

    def place_signal(self, signal: Signal, run: Run) -> Signal:
        """Return the signal of one of the two runs, with its rows on this clock."""
        zero_ns = self.zeros_ns[0 if run is self.runs[0] else 1]
        return _smooth(dataclasses.replace(signal, time_ns=signal.time_ns - zero_ns))

    def read_ns(self, unit: int) -> int:
        """Return the time of a unit of this clock [ns]."""
        return unit


@dataclass(frozen=True, slots=True, kw_only=True)
class _SampleClock:
    """Numbers of samples; poses are those that samples read, times those of the reference."""

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


CommonClock = _TimeClock | _SampleClock
"""The clock on which two runs are compared."""


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


_OF_TRACK: Final = frozenset({"along_track", "cross_track"})
"""Signals that refer to the path of a law, or else to the line from start to goal."""


def compare_signals(
    reference: Run,
    run: Run,
    tolerances: Mapping[str, Tolerance],
    *,
    alignment: str = "first_sample",
) -> dict[str, SignalDifference]:
    """Return the deviations of signals from the reference, each with its tolerance.

    Args:
        reference: Run from which differences are taken.
        run: Other run.
        tolerances: Tolerances by signal name; a signal that a run lacks is left out.
        alignment: Alignment, as in `compare_runs`.

    Raises:
        CompareError: If `compare_runs` raises it.
    """
    return compare_aligned_signals(
        reference, run, align_runs(reference, run, alignment), tolerances
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SignalTube:
    """A signal of a run and its tolerance band around a reference, on the compared rows.

    Attributes:
        time_ns: Time in the run, not decreasing.
        values: Values of the run, in the signal's unit.
        reference: Reference value with which each row is compared.
        low, high: Ends of the band.
        excess: Distance beyond the tolerance; zero or negative within the tolerance.
    """

    time_ns: NDArray[np.int64]
    values: NDArray[np.float64]
    reference: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    excess: NDArray[np.float64]


def trace_tube(
    reference: Run, run: Run, name: str, tolerance: Tolerance, *, alignment: str = "first_sample"
) -> SignalTube | None:
    """Return a numeric signal compared with the reference's; None if no comparison is possible.

    Angles of the reference are shifted by full turns to within half a turn of the run's angles.
    """
    pair = _read_signals(name, reference, run)
    if pair[0] is None or pair[1] is None or pair[0].kind.compared_as == "label":
        return None
    clock = align_runs(reference, run, alignment)
    theirs, ours = clock.place_signal(pair[0], reference), clock.place_signal(pair[1], run)
    grid = tube.lay_grid(theirs.time_ns, ours.time_ns, _find_span((theirs, ours), clock))
    if not len(grid.at):
        return None
    rows = tube.read_rows(ours, grid)
    half_width = round(tolerance.time_s * 1e9) if clock.tells_time else 0
    nearest = tube.find_deciding_values(theirs, rows, tolerance, half_width=half_width)
    turns = np.zeros(len(nearest))
    if theirs.kind.compared_as == "angle":
        turns = 2.0 * np.pi * np.round((rows.values - nearest) / (2.0 * np.pi))
    limit = tube.find_limit(theirs, nearest, tolerance)
    low, high = nearest, nearest
    if half_width:
        # What comes nearest to something far beyond is the outermost value of its window.
        kind = dataclasses.replace(theirs.kind, compared_as="number")
        number = dataclasses.replace(theirs, kind=kind)
        low, high = (
            tube.find_deciding_values(
                number,
                GridValues(grid=grid, values=np.full(len(nearest), beyond)),
                tolerance,
                half_width=half_width,
            )
            for beyond in (-_BEYOND, _BEYOND)
        )
    to_run_ns = find_zero_ns(run, alignment)
    return SignalTube(
        time_ns=np.array([clock.read_ns(int(unit)) for unit in grid.at], np.int64) + to_run_ns,
        values=rows.values,
        reference=nearest + turns,
        low=low - tube.find_limit(theirs, low, tolerance) + turns,
        high=high + tube.find_limit(theirs, high, tolerance) + turns,
        excess=tube.measure_distance(theirs, rows.values, nearest) - limit,
    )


_BEYOND: Final = 1e12
"""A distance larger than any signal, in its unit."""


def explain_lack(name: str, reference: Run, run: Run) -> str:
    """Return why a signal cannot be compared: a run or its law does not have it."""
    known = list(list_signal_units([reference.declaration, run.declaration]))
    if name not in known:
        near = find_near(name, known, most=2)
        states = ", ".join(found for found in known if found not in SIGNALS) or "none"
        hint = f"; did you mean {join_names(near)}?" if near else ""
        return f"neither a signal nor a state of these laws (they have {states}){hint}"
    if name in _OF_TRACK and not share_track(reference, run):
        return "the laws do not track one path"
    sides = zip((reference, run), _read_signals(name, reference, run), strict=True)
    lacking = [who for who, held in sides if held is None]
    if not lacking:
        return "there is no segment in which both were commanded"
    reason = f"{' and '.join(who.name for who in lacking)} does not hold it"
    lawless = [who for who in lacking if name not in list_signals(who.declaration)]
    if not lawless:
        return reason
    states = ", ".join(lawless[0].declaration.states) or "none"
    return f"{reason}: no state of its law (it has {states})"


def compare_aligned_signals(
    reference: Run, run: Run, clock: CommonClock, tolerances: Mapping[str, Tolerance]
) -> dict[str, SignalDifference]:
    """Return the differences of signals, as `compare_signals` does, for runs on a common clock."""
    found: dict[str, SignalDifference] = {}
    grids: dict[str, Grid] = {}
    phases = _join_phases(reference, run)
    is_shared = share_track(reference, run)
    for name, tolerance in tolerances.items():
        if name in _OF_TRACK and not is_shared:
            continue
        theirs, ours = _read_signals(name, reference, run)
        if theirs is None or ours is None:
            continue
        placed = clock.place_signal(theirs, reference), clock.place_signal(ours, run)
        source = f"{theirs.kind.source} {ours.kind.source}"
        if source not in grids:
            span = _find_span(placed, clock)
            grids[source] = tube.lay_grid(placed[0].time_ns, placed[1].time_ns, span)
        if not len(grids[source].at):
            continue
        rows = tube.read_rows(placed[1], grids[source])
        found[name] = _measure_rows(placed[0], rows, tolerance, clock, phases)
    return found


def _find_span(placed: tuple[Signal, Signal], clock: CommonClock) -> tuple[int, int]:
    """Return the compared segment of two signals; for commands, it begins when both have one."""
    start, end = clock.span
    firsts = [int(one.time_ns[0]) for one in placed if one.kind.source == "command"]
    return max([start, *firsts]), end


def share_track(reference: Run, run: Run) -> bool:
    """Return whether along-track and cross-track have the same meaning in both runs.

    Both laws track the same path, at any speed, or no path: then each run has its own line.
    """
    paths = [
        None if who.path is None else dataclasses.replace(who.path, speed_m_s=None)
        for who in (reference, run)
    ]
    return paths[0] == paths[1]


def _measure_rows(
    reference: Signal,
    rows: GridValues,
    tolerance: Tolerance,
    clock: CommonClock,
    phases: list[str],
) -> SignalDifference:
    """Return the deviation of a run's rows from the reference's signal, both on one clock."""
    half_width = round(tolerance.time_s * 1e9) if clock.tells_time else 0
    nearest = tube.find_deciding_values(reference, rows, tolerance, half_width=half_width)
    off = tube.measure_distance(reference, rows.values, nearest)
    limit = tube.find_limit(reference, nearest, tolerance)
    outside = off > limit
    least = int((off - limit).argmax())
    if not outside[least] and outside.any():
        least = int(outside.argmax())

    def read_row(row: int) -> Difference:
        values = float(nearest[row]), float(rows.values[row])
        is_label = reference.kind.compared_as == "label"
        sides = [phases[int(value)] if is_label else value for value in values]
        return Difference(
            signal=reference.name,
            time_ns=clock.read_ns(int(rows.grid.at[row])),
            recorded=sides[0],
            replayed=sides[1],
        )

    return SignalDifference(
        signal=reference.name,
        unit=reference.kind.unit,
        rows=len(off),
        differing=int(outside.sum()),
        largest=float(off[least]),
        limit=float(limit[least]),
        largest_difference=read_row(least) if off[least] else None,
        first_difference=read_row(int(outside.argmax())) if outside.any() else None,
    )


def _join_phases(reference: Run, run: Run) -> list[str]:
    """Return the phases of both laws, by which both runs are numbered."""
    return list(dict.fromkeys([*reference.phase_names, *run.phase_names]))


def _read_signals(name: str, reference: Run, run: Run) -> tuple[Signal | None, Signal | None]:
    """Return a signal of both runs, None for a run without it; phases have common numbers."""
    theirs, ours = (
        find_signal(who, name) if name in list_signals(who.declaration) else None
        for who in (reference, run)
    )
    if theirs is None or ours is None or ours.kind.compared_as != "label":
        return theirs, ours
    names = _join_phases(reference, run)
    numbers = np.array([names.index(phase) for phase in run.phase_names], dtype=np.float64)
    return theirs, dataclasses.replace(ours, values=numbers[ours.values.astype(np.int64)])
