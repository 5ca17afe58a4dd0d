"""Differences between a run and a reference: signals, metrics, and the path."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog import measure
from turtlelog.compare import common_clock
from turtlelog.compare.common_clock import CommonClock, Grid, Tolerance
from turtlelog.compare.table import Cell, Column, Table
from turtlelog.display import fit_line, format_html, format_notebook, show_angle
from turtlelog.errors import find_near, join_names
from turtlelog.measure import SIGNALS, Metric, Signal, find_signal, measure_run
from turtlelog.measure.reductions import Values
from turtlelog.measure.references import compute_path_distances
from turtlelog.measure.step_response import compute_rms
from turtlelog.replay.differences import Difference, SignalDifference as SignalDifference
from turtlelog.run import Run, require_run


@dataclass(frozen=True, slots=True, kw_only=True)
class MetricDifference:
    """A metric of a run, and the same metric of the reference."""

    metric: Metric
    reference: Metric

    @property
    def differs_in_unit(self) -> bool:
        """Whether loops of the same name control signals with different units."""
        has_values = self.metric.value is not None and self.reference.value is not None
        return has_values and self.metric.unit != self.reference.unit


@dataclass(frozen=True, slots=True, kw_only=True)
class RunComparison:
    """A run compared with a reference.

    Attributes:
        name: Name of the run.
        alignment: Alignment of the two runs, one of `ALIGNMENTS`.
        overlap_from_s: Start of the compared segment on the common clock [s].
        overlap_s: Duration of that segment [s].
        signals: Differences of every signal that both runs contain.
        metrics: Differences of all metrics of either law, except those with different units.
        notes: Notes on the alignment for the reader.
    """

    name: str
    alignment: str
    overlap_from_s: float
    overlap_s: float
    signals: tuple[SignalDifference, ...]
    metrics: tuple[MetricDifference, ...]
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return fit_line(f"<RunComparison of {self.name}: {self._describe()}>")

    def _describe(self) -> str:
        differing = sum(bool(found.differing) for found in self.signals)
        return f"{differing} of {len(self.signals)} signals differ over {self.overlap_s:.1f} s"

    def _repr_html_(self) -> str:
        heads = ("signal", "unit", "largest difference", "at [s]")
        rows = [
            (found.signal, *show_angle(found.largest, found.unit)[::-1], found.at_s)
            for found in self.signals
        ]
        return format_notebook(f"{self.name}: {self._describe()}", format_html(rows, heads=heads))


def compare_runs(reference: Run, run: Run, *, alignment: str = "first_sample") -> RunComparison:
    """Return the differences between a run and a reference.

    Args:
        reference: Run from which differences are taken.
        run: Other run.
        alignment: `first_sample`: time zero is each run's first sample. `phase:NAME`: time zero is
            the start of a phase, and earlier rows are not compared. `recorded`: times as recorded.
            `sample`: samples are compared by number, each with the pose that it read.

    Raises:
        CompareError: If there is no such alignment, or the runs do not overlap.
    """
    require_run(reference, "reference")
    require_run(run)
    return compare_measured(reference, measure_run(reference), run, alignment=alignment)


def compare_measured(
    reference: Run, metrics: Mapping[str, Metric], run: Run, *, alignment: str
) -> RunComparison:
    """Return the comparison of two runs, as `compare_runs` does, with known reference metrics."""
    clock = common_clock.align_runs(reference, run, alignment)
    start_ns, end_ns = map(clock.read_ns, clock.span)
    laws = reference.declaration, run.declaration
    tolerances = dict.fromkeys(measure.list_signal_units(laws), Tolerance())
    signals = compare_aligned_signals(reference, run, clock, tolerances)
    ours = measure_run(run)
    pairs = [
        MetricDifference(
            metric=ours[name] if name in ours else measure.miss_metric(laws[1], name),
            reference=metrics[name] if name in metrics else measure.miss_metric(laws[0], name),
        )
        for name in measure.list_metrics(*laws)
    ]
    return RunComparison(
        name=run.name,
        alignment=alignment,
        overlap_from_s=start_ns / 1e9,
        overlap_s=end_ns / 1e9 - start_ns / 1e9,
        signals=tuple(signals.values()),
        metrics=tuple(pair for pair in pairs if not pair.differs_in_unit),
        notes=tuple(_list_notes(reference, run, clock, pairs)),
    )


def compare_metrics(reference: Run, run: Run, ids: Collection[str]) -> list[MetricDifference]:
    """Return the metrics of a run and a reference; metrics of undeclared loops have no value."""
    measured = [measure_run(found, only=ids) if ids else {} for found in (reference, run)]
    return [MetricDifference(metric=measured[1][name], reference=measured[0][name]) for name in ids]


def tabulate_differences(
    comparisons: Sequence[RunComparison], *, names: Sequence[str], reference: str
) -> Table:
    """Return a table of the largest difference of every signal from the reference, with its time.

    `names` are the column titles, one for each comparison.
    """
    found = [{signal.signal: signal for signal in run.signals} for run in comparisons]
    columns = [Column(title="signal"), Column(title="unit")]
    for name in names:
        columns += [Column(title=name), Column(title="at", unit="s", digits=2, joined=True)]
    rows = []
    units = {name: signal.unit for signals in found for name, signal in signals.items()}
    for name in sorted(units, key=lambda name: (name not in SIGNALS, [*SIGNALS, name].index(name))):
        cells: list[Cell] = []
        for signals in found:
            known = signals.get(name)
            shown = None if known is None else show_angle(known.largest, known.unit)[0]
            cells += [shown, known.at_s] if known else [None, None]
        rows.append((name, show_angle(0.0, units[name])[1], *cells))
    used = dict.fromkeys(one.alignment for one in comparisons)
    starts = {one: f"from the start of {one.removeprefix('phase:')} on" for one in used}
    alignments = [_ALIGNMENT_WORDS.get(one, start) for one, start in starts.items()]
    return Table(
        title=f"Largest differences from {reference}, {', '.join(alignments)}",
        columns=tuple(columns),
        rows=tuple(rows),
        notes=_list_overlaps(comparisons, names),
    )


_ALIGNMENT_WORDS: Final = {
    "first_sample": "from the first samples on",
    "recorded": "by recorded time",
    "sample": "sample by sample",
}


def _list_notes(
    reference: Run, run: Run, clock: CommonClock, pairs: Sequence[MetricDifference]
) -> Iterator[str]:
    if not _share_track(reference, run):
        yield "Along-track and cross-track are not compared: the laws do not track one path."
    counts = [len(found.samples) for found in (reference, run)]
    if not clock.tells_time and counts[0] != counts[1]:
        has = f"{reference.name} has {counts[0]}, {run.name} {counts[1]}"
        yield f"{clock.span[1] + 1} samples are compared by number: {has}."
    apart = [pair for pair in pairs if pair.differs_in_unit]
    for loop in dict.fromkeys(pair.metric.id.rpartition(".")[0] for pair in apart):
        other = f"The loop {loop} controls another signal in the reference"
        yield f"{other}: metrics of other units are not compared."


def _list_overlaps(comparisons: Sequence[RunComparison], names: Sequence[str]) -> tuple[str, ...]:
    """Return the segments in which runs were compared, with equal segments in one sentence."""
    stretches: dict[str, list[str]] = {}
    for name, found in zip(names, comparisons, strict=True):
        end_s = found.overlap_from_s + found.overlap_s
        stretches.setdefault(f"{found.overlap_from_s:.2f} to {end_s:.2f} s", []).append(name)
    compared = "; ".join(f"{', '.join(runs)}: {stretch}" for stretch, runs in stretches.items())
    notes = dict.fromkeys(note for found in comparisons for note in found.notes)
    return f"Compared over {compared}.", *notes


_MOST_POINTS: Final = 20_000
"""Largest number of points of a path for distances: more points take minutes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PathDeviation:
    """Deviation of a run from a reference's path and position, over the segment that both cover.

    Attributes:
        largest_m: Largest distance from the nearest point of the reference's path [m].
        largest_at_s: Time of that distance on the common clock [s].
        rms_m: Root of the mean square over time of that distance [m].
        largest_apart_m: Largest distance from the reference's position at the same time [m].
        largest_apart_at_s: Time of that distance on the common clock [s].
        rms_apart_m: Root of the mean square over time of that distance [m].
    """

    largest_m: float
    largest_at_s: float
    rms_m: float
    largest_apart_m: float
    largest_apart_at_s: float
    rms_apart_m: float


def measure_path_error(
    reference: Run, run: Run, *, alignment: str = "first_sample"
) -> PathDeviation:
    """Return the deviation of a run from a reference's path, and from the reference at equal times.

    Args:
        reference: Run whose poses, joined by lines, are the path. Of more than 20,000 poses, every
            n-th is used.
        run: Other run.
        alignment: Alignment, as in `compare_runs`.

    Raises:
        CompareError: If `compare_runs` raises it.
    """
    clock = common_clock.align_runs(reference, run, alignment)
    columns = []
    for name in ("x", "y"):
        theirs, ours = (find_signal(who, name) for who in (reference, run))
        assert theirs is not None
        assert ours is not None
        placed = clock.place_signal(theirs, reference), clock.place_signal(ours, run)
        grid = common_clock.lay_grid(placed[0].time_ns, placed[1].time_ns, clock.span)
        columns.append([common_clock.read_rows(one, grid) for one in placed])
    theirs_m, ours_m = (np.column_stack(pair) for pair in zip(*columns, strict=True))
    at_s = np.array([clock.read_ns(int(unit)) for unit in grid.at]) / 1e9
    path_m = reference.poses.xy_m[:: -(-len(reference.poses) // _MOST_POINTS)]
    path_m = np.concatenate([path_m, reference.poses.xy_m[-1:]])
    beside = compute_path_distances(ours_m, path_m)
    apart = np.hypot(*(ours_m - theirs_m).T)
    step_s = np.diff(at_s)
    return PathDeviation(
        largest_m=float(beside.max()),
        largest_at_s=float(at_s[beside.argmax()]),
        rms_m=compute_rms(step_s, beside, None),
        largest_apart_m=float(apart.max()),
        largest_apart_at_s=float(at_s[apart.argmax()]),
        rms_apart_m=compute_rms(step_s, apart, None),
    )


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
    clock = common_clock.align_runs(reference, run, alignment)
    return compare_aligned_signals(reference, run, clock, tolerances)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SignalTube:
    """A signal of a run and its tolerance band around a reference, on the compared rows."""

    time_ns: NDArray[np.int64]  # time in the run, not decreasing
    values: Values  # values of the run, in the signal's unit
    reference: Values  # reference value with which each row is compared
    low: Values  # lower end of the band
    high: Values  # upper end of the band
    excess: Values  # distance beyond the tolerance; zero or negative within it


def trace_tube(
    reference: Run, run: Run, name: str, tolerance: Tolerance, *, alignment: str = "first_sample"
) -> SignalTube | None:
    """Return a numeric signal compared with the reference's; None if no comparison is possible.

    Angles of the reference are shifted by full turns to within half a turn of the run's angles.
    """
    pair = _read_signals(name, reference, run)
    if pair[0] is None or pair[1] is None or pair[0].kind.compared_as == "label":
        return None
    clock = common_clock.align_runs(reference, run, alignment)
    theirs, ours = clock.place_signal(pair[0], reference), clock.place_signal(pair[1], run)
    grid = common_clock.lay_grid(theirs.time_ns, ours.time_ns, _find_span((theirs, ours), clock))
    if not len(grid.at):
        return None
    values, nearest, off, limit = _compare_rows(theirs, ours, grid, tolerance, clock)
    turns = np.zeros(len(nearest))
    if theirs.kind.compared_as == "angle":
        turns = 2.0 * np.pi * np.round((values - nearest) / (2.0 * np.pi))
    low, high = nearest, nearest
    if half_width := _find_half_width(tolerance, clock):
        low, high = common_clock.find_window_range(theirs, grid, half_width)
    to_run_ns = common_clock.find_zero_ns(run, alignment, reference)
    return SignalTube(
        time_ns=np.array([clock.read_ns(int(unit)) for unit in grid.at], np.int64) + to_run_ns,
        values=values,
        reference=nearest + turns,
        low=low - common_clock.find_limit(theirs, low, tolerance) + turns,
        high=high + common_clock.find_limit(theirs, high, tolerance) + turns,
        excess=off - limit,
    )


def _find_half_width(tolerance: Tolerance, clock: CommonClock) -> int:
    return round(tolerance.time_s * 1e9) if clock.tells_time else 0


def _compare_rows(
    reference: Signal, run: Signal, grid: Grid, tolerance: Tolerance, clock: CommonClock
) -> tuple[Values, Values, Values, Values]:
    """Return a run's values, those of the reference that decide, their distances, and limits."""
    values, half_width = common_clock.read_rows(run, grid), _find_half_width(tolerance, clock)
    nearest = common_clock.find_deciding_values(reference, grid, values, tolerance, half_width)
    off = common_clock.measure_distance(reference, values, nearest)
    return values, nearest, off, common_clock.find_limit(reference, nearest, tolerance)


def explain_lack(name: str, reference: Run, run: Run) -> str:
    """Return why a signal cannot be compared: a run or its law does not have it."""
    known = list(measure.list_signal_units([reference.declaration, run.declaration]))
    if name not in known:
        near = find_near(name, known, most=2)
        states = ", ".join(found for found in known if found not in SIGNALS) or "none"
        hint = f"; did you mean {join_names(near)}?" if near else ""
        return f"neither a signal nor a state of these laws (they have {states}){hint}"
    if name in _OF_TRACK and not _share_track(reference, run):
        return "the laws do not track one path"
    sides = zip((reference, run), _read_signals(name, reference, run), strict=True)
    lacking = [who for who, held in sides if held is None]
    if not lacking:
        return "there is no segment in which both were commanded"
    reason = f"{' and '.join(who.name for who in lacking)} does not hold it"
    lawless = [who for who in lacking if name not in measure.list_signals(who.declaration)]
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
    phases = common_clock.join_phases(reference, run)
    is_shared = _share_track(reference, run)
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
            grids[source] = common_clock.lay_grid(placed[0].time_ns, placed[1].time_ns, span)
        if not len(grids[source].at):
            continue
        found[name] = _measure_rows(placed, grids[source], tolerance, clock, phases)
    return found


def _find_span(placed: tuple[Signal, Signal], clock: CommonClock) -> tuple[int, int]:
    """Return the compared segment of two signals; for commands, it begins when both have one."""
    start, end = clock.span
    firsts = [int(one.time_ns[0]) for one in placed if one.kind.source == "command"]
    return max([start, *firsts]), end


def _share_track(reference: Run, run: Run) -> bool:
    """Return whether along-track and cross-track have the same meaning in both runs.

    Both laws track the same path, at any speed, or no path: then each run has its own line.
    """
    ours, theirs = (one.path and replace(one.path, speed_m_s=None) for one in (run, reference))
    return ours == theirs


def _measure_rows(
    placed: tuple[Signal, Signal],
    grid: Grid,
    tolerance: Tolerance,
    clock: CommonClock,
    phases: list[str],
) -> SignalDifference:
    """Return the deviation of a run's rows from the reference's signal, both on one clock."""
    reference = placed[0]
    values, nearest, off, limit = _compare_rows(*placed, grid, tolerance, clock)
    outside, least = off > limit, int((off - limit).argmax())
    if not outside[least] and outside.any():
        least = int(outside.argmax())

    def read_row(row: int) -> Difference:
        is_label = reference.kind.compared_as == "label"
        numbers = float(nearest[row]), float(values[row])
        was, now = (phases[int(one)] if is_label else one for one in numbers)
        at_ns = clock.read_ns(int(grid.at[row]))
        return Difference(signal=reference.name, time_ns=at_ns, recorded=was, replayed=now)

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


def _read_signals(name: str, reference: Run, run: Run) -> tuple[Signal | None, Signal | None]:
    """Return a signal of both runs, None for a run without it; phases have common numbers."""
    theirs, ours = (
        find_signal(who, name) if name in measure.list_signals(who.declaration) else None
        for who in (reference, run)
    )
    if theirs is None or ours is None or ours.kind.compared_as != "label":
        return theirs, ours
    names = common_clock.join_phases(reference, run)
    numbers = np.array([names.index(phase) for phase in run.phase_names], dtype=np.float64)
    return theirs, replace(ours, values=numbers[ours.values.astype(np.int64)])
