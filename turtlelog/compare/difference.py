"""What differs between a run and a reference, signal by signal and metric by metric."""

import dataclasses
import difflib
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.compare.alignment import CommonClock, align_runs, find_zero_ns
from turtlelog.compare.table import Cell, Column, Table
from turtlelog.compare.tube import (
    Grid,
    GridValues,
    Tolerance,
    find_limit,
    find_nearest,
    lay_grid,
    measure_distance,
    read_rows,
)
from turtlelog.differences import Difference, SignalDifference as SignalDifference
from turtlelog.display import format_html, show_angle
from turtlelog.escapes import escape_controls
from turtlelog.measure import (
    SIGNALS,
    Metric,
    Signal,
    list_metrics,
    list_signal_units,
    list_signals,
    measure_run,
    miss_metric,
    read_signal,
)
from turtlelog.measure.path import compute_path_distances
from turtlelog.measure.step_response import compute_rms
from turtlelog.run import Run

_OF_TRACK: Final = frozenset({"along_track", "cross_track"})
"""Signals that belong to the path that a law tracks, or else to the line from start to goal."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MetricDifference:
    """One metric beside the reference's."""

    metric: Metric
    reference: Metric

    @property
    def differs_in_unit(self) -> bool:
        """Whether loops of one name control what has another unit."""
        has_values = self.metric.value is not None and self.reference.value is not None
        return has_values and self.metric.unit != self.reference.unit


@dataclass(frozen=True, slots=True, kw_only=True)
class RunComparison:
    """One run beside a reference.

    Attributes:
        name: The run's name.
        alignment: How the two were brought together, one of `ALIGNMENTS`.
        overlap_from_s: Where the stretch that is compared begins on the common clock [s].
        overlap_s: Length of that stretch [s].
        signals: For every signal that both hold.
        metrics: For every metric of either law, but those that differ in their unit.
        notes: What the reader should know of the alignment.
    """

    name: str
    alignment: str
    overlap_from_s: float
    overlap_s: float
    signals: tuple[SignalDifference, ...]
    metrics: tuple[MetricDifference, ...]
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        differing = sum(bool(found.differing) for found in self.signals)
        of = f"{differing} of {len(self.signals)} signals differ over {self.overlap_s:.1f} s"
        return escape_controls(f"<RunComparison of {self.name}: {of}>")

    def _repr_html_(self) -> str:
        heads = ("signal", "unit", "largest difference", "at [s]")
        rows = [
            (found.signal, *show_angle(found.largest, found.unit)[::-1], found.at_s)
            for found in self.signals
        ]
        return format_html(rows, heads=heads, title=repr(self))


def compare_runs(reference: Run, run: Run, *, alignment: str = "first_sample") -> RunComparison:
    """Return what differs between a run and a reference.

    Args:
        reference: The run that differences are taken from.
        run: The other.
        alignment: `first_sample`: time zero is each run's first sample; `phase:NAME`: the start of
            a phase, what stands before is not compared; `recorded`: times as recorded; `sample`:
            samples are compared by their number, each with the pose that it read.

    Raises:
        CompareError: Where there is no such alignment, or the runs do not overlap.
    """
    (comparison,) = iter_comparisons(reference, (run,), alignment=alignment)
    return comparison


def iter_comparisons(
    reference: Run, runs: Iterable[Run], *, alignment: str = "first_sample"
) -> Iterator[RunComparison]:
    """Yield a comparison for every run, as `compare_runs`; none is kept once it is yielded.

    Raises:
        CompareError: As `compare_runs`.
    """
    metrics = measure_run(reference)
    for run in runs:
        yield compare_measured(reference, metrics, run, alignment=alignment)


def compare_measured(
    reference: Run, metrics: Mapping[str, Metric], run: Run, *, alignment: str
) -> RunComparison:
    """Return what `compare_runs` does, with a reference of which all metrics are known."""
    clock = align_runs(reference, run, alignment)
    start_ns, end_ns = map(clock.read_ns, clock.span)
    names = list_signal_units([reference.declaration, run.declaration])
    signals = _compare_signals(reference, run, clock, dict.fromkeys(names, Tolerance()))
    pairs = _pair_metrics((reference, metrics), run)
    return RunComparison(
        name=run.name,
        alignment=alignment,
        overlap_from_s=start_ns / 1e9,
        overlap_s=end_ns / 1e9 - start_ns / 1e9,
        signals=tuple(signals.values()),
        metrics=tuple(pair for pair in pairs if not pair.differs_in_unit),
        notes=(*_list_notes(reference, run, clock), *_list_apart(pairs)),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class PathError:
    """How far a run is from where a reference was, over the stretch that both cover.

    Attributes:
        largest_m: Largest distance from the nearest point of the reference's path [m].
        largest_at_s: When, on the common clock [s].
        rms_m: Root of the mean square over time of that distance [m].
        largest_apart_m: Largest distance from where the reference was at the same time [m].
        largest_apart_at_s: When [s].
        rms_apart_m: Root of the mean square over time of that distance [m].
    """

    largest_m: float
    largest_at_s: float
    rms_m: float
    largest_apart_m: float
    largest_apart_at_s: float
    rms_apart_m: float


def measure_path_error(reference: Run, run: Run, *, alignment: str = "first_sample") -> PathError:
    """Return how far a run is from a reference's path, and from the reference at equal times.

    Args:
        reference: The line through its poses is the path; of more than 20,000 every n-th.
        run: The other.
        alignment: As in `compare_runs`.

    Raises:
        CompareError: As `compare_runs`.
    """
    clock = align_runs(reference, run, alignment)
    columns = []
    for name in ("x", "y"):
        theirs, ours = (read_signal(who, name) for who in (reference, run))
        assert theirs is not None
        assert ours is not None
        placed = clock.place_signal(theirs, reference), clock.place_signal(ours, run)
        grid = lay_grid(placed[0].time_ns, placed[1].time_ns, clock.span)
        columns.append([read_rows(one, grid).values for one in placed])
    theirs_m, ours_m = (np.column_stack(pair) for pair in zip(*columns, strict=True))
    at_s = np.array([clock.read_ns(int(unit)) for unit in grid.at]) / 1e9
    path_m = reference.poses.xy_m[:: -(-len(reference.poses) // _MOST_POINTS)]
    path_m = np.concatenate([path_m, reference.poses.xy_m[-1:]])
    beside = compute_path_distances(ours_m, path_m)
    apart = np.hypot(*(ours_m - theirs_m).T)
    step_s = np.diff(at_s)
    return PathError(
        largest_m=float(beside.max()),
        largest_at_s=float(at_s[beside.argmax()]),
        rms_m=compute_rms(step_s, beside),
        largest_apart_m=float(apart.max()),
        largest_apart_at_s=float(at_s[apart.argmax()]),
        rms_apart_m=compute_rms(step_s, apart),
    )


_MOST_POINTS: Final = 20_000
"""Points of a path that distances are taken from: more take minutes."""


def compare_signals(
    reference: Run,
    run: Run,
    tolerances: Mapping[str, Tolerance],
    *,
    alignment: str = "first_sample",
) -> dict[str, SignalDifference]:
    """Return how far signals are from the reference's, each with what it may be apart.

    Args:
        reference: The run that differences are taken from.
        run: The other.
        tolerances: By the name of the signal; one that a run does not hold is left out.
        alignment: As in `compare_runs`.

    Raises:
        CompareError: As `compare_runs`.
    """
    return _compare_signals(reference, run, align_runs(reference, run, alignment), tolerances)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SignalTube:
    """A signal of a run and where it may be beside a reference, on the rows that are compared.

    Attributes:
        time_ns: In the run's own time [ns], shape (n,), not decreasing.
        values: The run's, in the signal's unit, shape (n,).
        reference: The value of the reference that each row is held to, shape (n,).
        low: Lower end of what passes, shape (n,).
        high: Upper end, shape (n,).
        excess: How much further from the reference than allowed, shape (n,); not positive inside.
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
    """Return a signal of numbers beside the reference's; None where they are not compared.

    Angles of the reference are those within half a turn of the run's.

    Args:
        reference: The run that differences are taken from.
        run: The other.
        name: Of the signal.
        tolerance: How far it may be off.
        alignment: As in `compare_runs`.

    Raises:
        CompareError: As `compare_runs`.
    """
    pair = _read_signals(name, reference, run)
    if pair[0] is None or pair[1] is None or pair[0].kind.compared_as == "label":
        return None
    clock = align_runs(reference, run, alignment)
    theirs, ours = clock.place_signal(pair[0], reference), clock.place_signal(pair[1], run)
    grid = lay_grid(theirs.time_ns, ours.time_ns, _find_span((theirs, ours), clock))
    if not len(grid.at):
        return None
    rows = read_rows(ours, grid)
    half_width = round(tolerance.time_s * 1e9) if clock.tells_time else 0
    nearest = find_nearest(theirs, rows, tolerance, half_width=half_width)
    turns = np.zeros(len(nearest))
    if theirs.kind.compared_as == "angle":
        turns = 2.0 * np.pi * np.round((rows.values - nearest) / (2.0 * np.pi))
    limit = find_limit(theirs, nearest, tolerance)
    low, high = nearest, nearest
    if half_width:
        # What comes nearest to something far beyond is the outermost value of its window.
        kind = dataclasses.replace(theirs.kind, compared_as="number")
        number = dataclasses.replace(theirs, kind=kind)
        low, high = (
            find_nearest(
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
        low=low - find_limit(theirs, low, tolerance) + turns,
        high=high + find_limit(theirs, high, tolerance) + turns,
        excess=measure_distance(theirs, rows.values, nearest) - limit,
    )


_BEYOND: Final = 1e12
"""Further than any signal reaches, in its unit."""


def compare_metrics(reference: Run, run: Run, ids: Collection[str]) -> list[MetricDifference]:
    """Return metrics of a run beside a reference's; of a loop that is not declared: no value."""
    measured = [measure_run(found, only=ids) if ids else {} for found in (reference, run)]
    return [MetricDifference(metric=measured[1][name], reference=measured[0][name]) for name in ids]


def explain_lack(name: str, reference: Run, run: Run) -> str:
    """Return why a signal cannot be compared: a run does not hold it, or its law has none such."""
    known = list(list_signal_units([reference.declaration, run.declaration]))
    if name not in known:
        near = difflib.get_close_matches(name, known, n=2)
        states = ", ".join(found for found in known if found not in SIGNALS) or "none"
        hint = f"; the nearest are {', '.join(near)}" if near else ""
        return f"neither a signal nor a state of these laws (they have {states}){hint}"
    if name in _OF_TRACK and not _share_track(reference, run):
        return "the laws do not track one path"
    sides = zip((reference, run), _read_signals(name, reference, run), strict=True)
    lacking = [who for who, held in sides if held is None]
    if not lacking:
        return "there is no stretch in which both were commanded"
    reason = f"{' and '.join(who.name for who in lacking)} does not hold it"
    lawless = [who for who in lacking if name not in list_signals(who.declaration)]
    if not lawless:
        return reason
    states = ", ".join(lawless[0].declaration.states) or "none"
    return f"{reason}: no state of its law (it has {states})"


def tabulate_differences(
    comparisons: Sequence[RunComparison], *, names: Sequence[str], reference: str
) -> Table:
    """Return the largest difference of every signal from the reference, and when it is reached.

    `names` heads the columns, one for each comparison.
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
    alignments = dict.fromkeys(_describe_alignment(found.alignment) for found in comparisons)
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


def _pair_metrics(
    reference: tuple[Run, Mapping[str, Metric]], run: Run
) -> tuple[MetricDifference, ...]:
    """Return every metric of either law; of a loop that one does not declare: `no_phase`."""
    declarations = reference[0].declaration, run.declaration
    theirs, ours = reference[1], measure_run(run)
    return tuple(
        MetricDifference(
            metric=ours.get(name) or miss_metric(declarations[1], name),
            reference=theirs.get(name) or miss_metric(declarations[0], name),
        )
        for name in list_metrics(*declarations)
    )


def _list_apart(pairs: Iterable[MetricDifference]) -> Iterator[str]:
    apart = [pair for pair in pairs if pair.differs_in_unit]
    for loop in dict.fromkeys(pair.metric.id.rpartition(".")[0] for pair in apart):
        yield (
            f"The loop {loop} controls another signal in the reference: metrics of other units"
            " are not compared."
        )


def _compare_signals(
    reference: Run, run: Run, clock: CommonClock, tolerances: Mapping[str, Tolerance]
) -> dict[str, SignalDifference]:
    found: dict[str, SignalDifference] = {}
    grids: dict[str, Grid] = {}
    phases = _join_phases(reference, run)
    share_track = _share_track(reference, run)
    for name, tolerance in tolerances.items():
        if name in _OF_TRACK and not share_track:
            continue
        theirs, ours = _read_signals(name, reference, run)
        if theirs is None or ours is None:
            continue
        placed = clock.place_signal(theirs, reference), clock.place_signal(ours, run)
        source = f"{theirs.kind.source} {ours.kind.source}"
        if source not in grids:
            span = _find_span(placed, clock)
            grids[source] = lay_grid(placed[0].time_ns, placed[1].time_ns, span)
        if not len(grids[source].at):
            continue
        rows = read_rows(placed[1], grids[source])
        found[name] = _measure_rows(placed[0], rows, tolerance, clock, phases)
    return found


def _find_span(placed: tuple[Signal, Signal], clock: CommonClock) -> tuple[int, int]:
    """Return where two signals are compared: commands only from the first that both published."""
    start, end = clock.span
    firsts = [int(one.time_ns[0]) for one in placed if one.kind.source == "command"]
    return max([start, *firsts]), end


def _share_track(reference: Run, run: Run) -> bool:
    """Return whether along-track and cross-track mean the same in both runs.

    That is where both laws track one path, by whatever time, or none: then each run has its line
    from start to goal.
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
    """Return how far a run's rows are from the reference's signal, both on the clock."""
    half_width = round(tolerance.time_s * 1e9) if clock.tells_time else 0
    nearest = find_nearest(reference, rows, tolerance, half_width=half_width)
    off = measure_distance(reference, rows.values, nearest)
    limit = find_limit(reference, nearest, tolerance)
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
    """Return the phases of both laws, by which those of both are numbered."""
    return list(dict.fromkeys([*reference.phase_names, *run.phase_names]))


def _read_signals(name: str, reference: Run, run: Run) -> tuple[Signal | None, Signal | None]:
    """Return a signal of both, None of one that does not hold it; phases by one numbering."""
    theirs, ours = (
        read_signal(who, name) if name in list_signals(who.declaration) else None
        for who in (reference, run)
    )
    if theirs is None or ours is None or ours.kind.compared_as != "label":
        return theirs, ours
    names = _join_phases(reference, run)
    numbers = np.array([names.index(phase) for phase in run.phase_names], dtype=np.float64)
    return theirs, dataclasses.replace(ours, values=numbers[ours.values.astype(np.int64)])


def _list_notes(reference: Run, run: Run, clock: CommonClock) -> Iterator[str]:
    if not _share_track(reference, run):
        yield "Along-track and cross-track are not compared: the laws do not track one path."
    if clock.tells_time:
        return
    counts = [len(found.samples) for found in (reference, run)]
    if counts[0] != counts[1]:
        yield (
            f"{clock.span[1] + 1} samples are compared by number: {reference.name} has"
            f" {counts[0]}, {run.name} {counts[1]}."
        )


def _describe_alignment(alignment: str) -> str:
    """Return an alignment in words: `from the start of translate on`."""
    phase = alignment.removeprefix("phase:")
    return _ALIGNMENT_WORDS.get(alignment, f"from the start of {phase} on")


def _list_overlaps(comparisons: Sequence[RunComparison], names: Sequence[str]) -> tuple[str, ...]:
    """Return over which stretch the runs were compared, where that is the same in one sentence."""
    stretches: dict[str, list[str]] = {}
    for name, found in zip(names, comparisons, strict=True):
        end_s = found.overlap_from_s + found.overlap_s
        stretches.setdefault(f"{found.overlap_from_s:.2f} to {end_s:.2f} s", []).append(name)
    compared = "; ".join(f"{', '.join(runs)}: {stretch}" for stretch, runs in stretches.items())
    notes = dict.fromkeys(note for found in comparisons for note in found.notes)
    return f"Compared over {compared}.", *notes
