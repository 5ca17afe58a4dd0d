"""What differs between a run and a reference, signal by signal."""

from dataclasses import dataclass

import numpy as np

from turtlelog.angles import wrap_angle
from turtlelog.compare.clock import find_overlap_ns, resample_signal
from turtlelog.measure import SIGNALS, Metric, Signal, measure_run, read_signal
from turtlelog.run import Run


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalDifference:
    """How far one signal is from the reference's.

    Attributes:
        signal: Its name.
        unit: Of `largest`.
        largest: Largest magnitude of the difference on the common clock.
        at_s: First time at which it is that large, from the first sample [s].
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
    """One run beside a reference, aligned at the first sample.

    Attributes:
        name: The run's name.
        overlap_s: Length of the stretch that both cover [s].
        signals: For every signal that both hold.
        metrics: For every metric.
    """

    name: str
    overlap_s: float
    signals: tuple[SignalDifference, ...]
    metrics: tuple[MetricDifference, ...]


def compare_runs(reference: Run, run: Run) -> Comparison:
    """Return what differs between a run and a reference, from their first samples on.

    Raises:
        CompareError: Where the runs do not overlap.
    """
    start_ns, end_ns = find_overlap_ns((reference, run))
    pairs = [(read_signal(reference, name), read_signal(run, name)) for name in SIGNALS]
    metrics, reference_metrics = measure_run(run), measure_run(reference)
    return Comparison(
        name=run.name,
        overlap_s=(end_ns - start_ns) / 1e9,
        signals=tuple(
            _compare_signals((theirs, reference.start_ns), (ours, run.start_ns), start_ns, end_ns)
            for theirs, ours in pairs
            if theirs is not None and ours is not None
        ),
        metrics=tuple(
            MetricDifference(metric=metric, reference=reference_metrics[name])
            for name, metric in metrics.items()
        ),
    )


def _compare_signals(
    reference: tuple[Signal, int], run: tuple[Signal, int], start_ns: int, end_ns: int
) -> SignalDifference:
    grid_ns = np.union1d(*(signal.time_ns - zero_ns for signal, zero_ns in (reference, run)))
    grid_ns = grid_ns[(grid_ns >= start_ns) & (grid_ns <= end_ns)]
    difference = resample_signal(*run, grid_ns) - resample_signal(*reference, grid_ns)
    if run[0].kind.compared_as == "angle":
        difference = wrap_angle(difference)
    if run[0].kind.compared_as == "label":
        difference = np.sign(difference)
    difference = np.abs(difference)
    row = int(difference.argmax())
    return SignalDifference(
        signal=run[0].name,
        unit=run[0].kind.unit,
        largest=float(difference[row]),
        at_s=float(grid_ns[row] / 1e9),
    )
