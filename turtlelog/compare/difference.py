"""Differences between a run and a reference: signals, metrics, and the path."""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from turtlelog.compare.signal_comparison import (
    CommonClock,
    align_runs,
    compare_aligned_signals,
    share_track,
)
from turtlelog.compare.table import Cell, Column, Table
from turtlelog.compare.tube import Tolerance, lay_grid, read_rows
from turtlelog.display import fit_line, format_html, format_notebook, show_angle
from turtlelog.measure import (
    SIGNALS,
    Metric,
    find_signal,
    list_metrics,
    list_signal_units,
    measure_run,
    miss_metric,
)
from turtlelog.measure.references import compute_path_distances
from turtlelog.measure.step_response import compute_rms
from turtlelog.replay.differences import SignalDifference
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
    clock = align_runs(reference, run, alignment)
    start_ns, end_ns = map(clock.read_ns, clock.span)
    names = list_signal_units([reference.declaration, run.declaration])
    signals = compare_aligned_signals(reference, run, clock, dict.fromkeys(names, Tolerance()))
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
    """Return every metric of either law. A loop that one law does not declare has `no_phase`."""
    declarations = reference[0].declaration, run.declaration
    theirs, ours = reference[1], measure_run(run)
    return tuple(
        MetricDifference(
            metric=ours[name] if name in ours else miss_metric(declarations[1], name),
            reference=theirs[name] if name in theirs else miss_metric(declarations[0], name),
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


def _list_notes(reference: Run, run: Run, clock: CommonClock) -> Iterator[str]:
    if not share_track(reference, run):
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
    clock = align_runs(reference, run, alignment)
    columns = []
    for name in ("x", "y"):
        theirs, ours = (find_signal(who, name) for who in (reference, run))
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
    return PathDeviation(
        largest_m=float(beside.max()),
        largest_at_s=float(at_s[beside.argmax()]),
        rms_m=compute_rms(step_s, beside, None),
        largest_apart_m=float(apart.max()),
        largest_apart_at_s=float(at_s[apart.argmax()]),
        rms_apart_m=compute_rms(step_s, apart, None),
    )
