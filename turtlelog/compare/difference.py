"""What differs between a run and a reference, signal by signal, and whether that is tolerated."""

import dataclasses
import difflib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from turtlelog.compare.clock import Clock, align_runs
from turtlelog.compare.ids import list_names
from turtlelog.compare.tolerances import Tolerance, Tolerances
from turtlelog.compare.tube import Grid, Rows, find_nearest, lay_grid, measure_distance, read_rows
from turtlelog.compare.verdict import (
    Finding,
    judge_metric,
    judge_signal,
    leave_open,
    miss_signal,
)
from turtlelog.measure import (
    SIGNALS,
    Metric,
    Signal,
    list_metrics,
    list_signals,
    measure_run,
    miss_metric,
    read_signal,
)
from turtlelog.run import Run


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalDifference:
    """How far one signal is from the reference's.

    Attributes:
        signal: Its name.
        unit: Of `largest`.
        largest: Largest magnitude of the difference on the common clock.
        at_s: First time at which it is that large, on the common clock [s].
    """

    signal: str
    unit: str
    largest: float
    at_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class MetricDifference:
    """One metric beside the reference's."""

    metric: Metric
    reference: Metric


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """One run beside a reference.

    Attributes:
        name: The run's name.
        alignment: How the two were brought together, one of `ALIGNMENTS`.
        overlap_from_s: Where the stretch that is compared begins on the common clock [s].
        overlap_s: Length of that stretch [s].
        signals: For every signal that both hold.
        metrics: For every metric of either law, but those that differ in their unit.
        findings: For every tolerance given, signals before metrics.
        notes: What the reader should know of the alignment.
    """

    name: str
    alignment: str
    overlap_from_s: float
    overlap_s: float
    signals: tuple[SignalDifference, ...]
    metrics: tuple[MetricDifference, ...]
    findings: tuple[Finding, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def verdict(self) -> Literal["pass", "fail"] | None:
        """Whether every finding passes; None where no tolerances were given."""
        if not self.findings:
            return None
        return "pass" if all(finding.within for finding in self.findings) else "fail"


def compare_runs(
    reference: Run,
    run: Run,
    *,
    alignment: str = "first_sample",
    tolerances: Tolerances | None = None,
) -> Comparison:
    """Return what differs between a run and a reference, and whether it is tolerated.

    Args:
        reference: The run that differences are taken from.
        run: The other.
        alignment: `first_sample`: time zero is each run's first sample; `phase:NAME`: the start of
            a phase, what stands before is not compared; `recorded`: times as recorded; `sample`:
            samples are compared by their number, each with the pose that it read.
        tolerances: What to judge; None: nothing.

    Raises:
        CompareError: Where there is no such alignment, or the runs do not overlap.
    """
    (comparison,) = iter_comparisons(reference, (run,), alignment=alignment, tolerances=tolerances)
    return comparison


def iter_comparisons(
    reference: Run,
    runs: Iterable[Run],
    *,
    alignment: str = "first_sample",
    tolerances: Tolerances | None = None,
) -> Iterator[Comparison]:
    """Yield a comparison for every run, as `compare_runs`; none is kept once it is yielded.

    Raises:
        CompareError: As `compare_runs`.
    """
    metrics = measure_run(reference)
    tolerances = tolerances or Tolerances()
    for run in runs:
        clock = align_runs(reference, run, alignment)
        signals, found = _compare_signals(reference, run, clock, tolerances.signals)
        pairs = _pair_metrics((reference, metrics), run, tolerances.metrics)
        yield Comparison(
            name=run.name,
            alignment=alignment,
            overlap_from_s=clock.read_seconds(clock.span[0]),
            overlap_s=clock.read_seconds(clock.span[1]) - clock.read_seconds(clock.span[0]),
            signals=signals,
            metrics=tuple(pair for pair in pairs.values() if not _differ_in_unit(pair)),
            findings=(
                *found,
                *(
                    _judge_metric(pairs[name], tolerance, (reference, run))
                    for name, tolerance in tolerances.metrics.items()
                ),
            ),
            notes=(
                *_list_notes(reference, run, clock, tolerances),
                *_list_apart(pairs.values()),
            ),
        )


def _pair_metrics(
    reference: tuple[Run, Mapping[str, Metric]], run: Run, judged: Iterable[str]
) -> dict[str, MetricDifference]:
    """Return every metric of either law, and those that are judged; of no loop: `no_phase`."""
    declarations = reference[0].declaration, run.declaration
    theirs, ours = reference[1], measure_run(run)
    return {
        name: MetricDifference(
            metric=ours.get(name) or miss_metric(declarations[1], name),
            reference=theirs.get(name) or miss_metric(declarations[0], name),
        )
        for name in dict.fromkeys([*list_metrics(*declarations), *judged])
    }


def _judge_metric(pair: MetricDifference, tolerance: Tolerance, runs: tuple[Run, Run]) -> Finding:
    """Return the verdict on a metric; one of a loop that neither law declares does not pass."""
    if pair.metric.id in list_metrics(*(run.declaration for run in runs)):
        return judge_metric(pair.metric, pair.reference, tolerance)
    reason = f"{pair.metric.status.value} ({pair.metric.reason})"
    return leave_open(pair.metric, tolerance, reason)


def _differ_in_unit(pair: MetricDifference) -> bool:
    """Return whether loops of one name control what has another unit."""
    has_values = pair.metric.value is not None and pair.reference.value is not None
    return has_values and pair.metric.unit != pair.reference.unit


def _list_apart(pairs: Iterable[MetricDifference]) -> Iterator[str]:
    apart = [pair for pair in pairs if _differ_in_unit(pair)]
    for loop in dict.fromkeys(pair.metric.id.rpartition(".")[0] for pair in apart):
        yield (
            f"The loop {loop} controls another signal in the reference: metrics of other units"
            " are not compared."
        )


def _compare_signals(
    reference: Run, run: Run, clock: Clock, tolerances: Mapping[str, Tolerance]
) -> tuple[tuple[SignalDifference, ...], tuple[Finding, ...]]:
    differences, findings = [], {}
    grids: dict[str, Grid] = {}
    units = list_names([reference.declaration, run.declaration])
    for name in dict.fromkeys([*units, *tolerances]):
        theirs, ours = _read_signals(name, reference, run)
        if theirs is None or ours is None:
            if name in tolerances:
                lacking = [who for who, held in ((reference, theirs), (run, ours)) if held is None]
                reason = _explain_lack(name, lacking, known=list(units))
                findings[name] = miss_signal(name, units.get(name, ""), tolerances[name], reason)
            continue
        placed = clock.place_signal(theirs, reference), clock.place_signal(ours, run)
        times, source = (placed[0].time_ns, placed[1].time_ns), theirs.kind.source
        if source not in grids:
            grids[source] = lay_grid(*times, clock.span)
        rows = read_rows(placed[1], grids[source])
        differences.append(_find_largest(placed[0], rows, clock))
        if name in tolerances:
            found = judge_signal(placed[0], rows, tolerances[name], clock)
            findings[name] = _name_phases(found, reference, run)
    return tuple(differences), tuple(findings[name] for name in tolerances)


def _read_signals(name: str, reference: Run, run: Run) -> tuple[Signal | None, Signal | None]:
    """Return a signal of both, None of one that does not hold it; phases by one numbering."""
    theirs, ours = (
        read_signal(who, name) if name in list_signals(who.declaration) else None
        for who in (reference, run)
    )
    if theirs is None or ours is None or ours.kind.compared_as != "label":
        return theirs, ours
    names = list(dict.fromkeys([*reference.phase_names, *run.phase_names]))
    numbers = np.array([names.index(phase) for phase in run.phase_names], dtype=np.float64)
    return theirs, dataclasses.replace(ours, values=numbers[ours.values.astype(np.int64)])


def _name_phases(finding: Finding, reference: Run, run: Run) -> Finding:
    """Return a finding with the phases by name where the laws number theirs otherwise."""
    names = list(dict.fromkeys([*reference.phase_names, *run.phase_names]))
    sides = finding.value, finding.reference
    if finding.within or finding.name != "phase" or run.phase_names == reference.phase_names:
        return finding
    found, expected = (names[int(side or 0)] for side in sides)
    return dataclasses.replace(finding, reason=f"{found}, where the reference has {expected}")


def _explain_lack(name: str, lacking: list[Run], *, known: list[str]) -> str:
    """Return why a signal cannot be judged: a run does not hold it, or its law has no such name."""
    if name not in known:
        near = difflib.get_close_matches(name, known, n=2)
        states = ", ".join(found for found in known if found not in SIGNALS) or "none"
        hint = f"; the nearest are {', '.join(near)}" if near else ""
        return f"neither a signal nor a state of these laws (they have {states}){hint}"
    reason = f"{' and '.join(run.name for run in lacking)} does not hold it"
    lawless = [run for run in lacking if name not in list_signals(run.declaration)]
    if not lawless:
        return reason
    states = ", ".join(lawless[0].declaration.states) or "none"
    return f"{reason}: no state of its law (it has {states})"


def _find_largest(reference: Signal, rows: Rows, clock: Clock) -> SignalDifference:
    off = measure_distance(reference, rows.values, find_nearest(reference, rows, Tolerance()))
    row = int(off.argmax())
    return SignalDifference(
        signal=reference.name,
        unit=reference.kind.unit,
        largest=float(off[row]),
        at_s=clock.read_seconds(int(rows.grid.at[row])),
    )


def _list_notes(reference: Run, run: Run, clock: Clock, tolerances: Tolerances) -> Iterator[str]:
    if clock.tells_time:
        return
    counts = [len(found.samples) for found in (reference, run)]
    compared = clock.span[1] + 1
    if counts[0] != counts[1]:
        yield (
            f"{compared} samples are compared by number: {reference.name} has {counts[0]},"
            f" {run.name} {counts[1]}."
        )
    if any(tolerance.time_s for tolerance in tolerances.signals.values()):
        yield "Aligned by the number of samples, no tolerance in time applies."
