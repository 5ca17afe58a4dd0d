"""The signal that violated a check, with its allowed band."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.charts.curve_marks import SignalSearch, ViolatedSignal, ViolationMoment
from turtlelog.charts.curves import Curve
from turtlelog.check.decisive_band import BandReader, find_scale, list_leaves, names_signals
from turtlelog.check.formula import check_run
from turtlelog.check.formula_trace import FormulaTrace, find_span, find_window, read_signals
from turtlelog.check.result import CheckResult, JudgedMetric, JudgedSignal, Verdict
from turtlelog.check.spec import Check
from turtlelog.compare.signal_comparison import trace_tube
from turtlelog.expressions import Call, Comparison, Name
from turtlelog.measure import MIRRORED, find_signal, list_metrics, list_signals, measure_run
from turtlelog.run import Run

Values = NDArray[np.float64]

_SAME: Final = 1e-9
"""Relative difference up to which a metric equals a signal's value at its time."""

_NO_BAND: Final = "what is compared is no band around a signal"


def find_violated_signal(run: Run, result: CheckResult) -> SignalSearch:
    """Return the signal that violated a check, or the reason why no signal did.

    For a formula with several comparisons, this is the signal of the deciding comparison. A metric
    belongs to a signal if the signal has the metric's value at the metric's time.
    """
    if result.verdict is not Verdict.FAIL:
        return SignalSearch(reason="the check was not violated")
    return find_judged_signal(run, result)


def find_judged_signal(run: Run, result: CheckResult) -> SignalSearch:
    """Return the signal that a check limits to a band, or the reason why there is no such signal.

    If the check passes, no row is outside the band; the worst row is the nearest to the limit.
    """
    if result.verdict is Verdict.SKIPPED or not result.is_decided:
        return SignalSearch(reason=f"undecided: {result.reason}")
    found = _find_signal(run, result)
    if found.signal is None or result.verdict is Verdict.FAIL:
        return found
    signal = found.signal
    return SignalSearch(signal=replace(signal, outside=np.zeros_like(signal.outside)))


def _find_signal(run: Run, result: CheckResult) -> SignalSearch:
    match result.judged:
        case None:
            return SignalSearch(reason=f"{result.check} is held to no band of a signal")
        case JudgedSignal():
            return _find_in_tube(run, result, result.judged)
        case JudgedMetric():
            return _find_of_metric(run, result, result.judged)
    return _find_of_formula(run, result, result.judged)


def _find_of_formula(run: Run, result: CheckResult, check: Check) -> SignalSearch:
    metric = _read_metric_bound(run, check, result) if check.kind == "expect" else None
    if metric is not None:
        return _find_of_metric(run, result, metric)
    if result.verdict is Verdict.FAIL and result.first_violation_s is None:
        return SignalSearch(reason="it is violated at no single moment")
    return _find_over_time(run, result, check)


def _find_in_tube(run: Run, result: CheckResult, judged: JudgedSignal) -> SignalSearch:
    tube = trace_tube(
        judged.reference, run, judged.name, judged.tolerance, alignment=judged.alignment
    )
    outside = None if tube is None else tube.excess > 0.0
    if tube is None or outside is None or not outside.any():
        return SignalSearch(reason=f"{judged.name} is no number with a distance")
    kind = list_signals(run.declaration)[judged.name]
    unit, factor = find_scale(kind.unit)
    curve = Curve(
        start_ns=run.start_ns,
        time_ns=tube.time_ns,
        values=tube.values * factor,
        holds=kind.resampling == "hold",
    )
    rows = _Rows(curve=curve, outside=outside)
    worst = int(np.where(outside, tube.excess, -np.inf).argmax())
    return rows.show(
        result,
        worst=rows.tell(worst),
        name=judged.name,
        unit=unit,
        low=tube.low * factor,
        high=tube.high * factor,
        reference=tube.reference * factor,
    )


def _read_metric_bound(run: Run, check: Check, result: CheckResult) -> JudgedMetric | None:
    """Return the only metric that a check bounds by a number; None for any other check."""
    root = check.formula.root
    if not isinstance(root, Comparison) or len(root.operators) > 1 or result.limit is None:
        return None
    for node, operator in zip(
        root.operands, (root.operators[0], MIRRORED[root.operators[0]]), strict=True
    ):
        bare = node.arguments[0] if isinstance(node, Call) and node.function == "abs" else node
        if isinstance(bare, Name) and bare.name in list_metrics(run.declaration):
            metric = measure_run(run, only=(bare.name,))[bare.name]
            return JudgedMetric(metric=metric, operator=operator, limit=result.limit)
    return None


def _find_of_metric(run: Run, result: CheckResult, judged: JudgedMetric) -> SignalSearch:
    """Return the signal to which a metric's value belongs, with an upper limit on its magnitude."""
    metric = judged.metric
    if judged.operator not in {"<", "<="}:
        return SignalSearch(reason=f"{metric.id} is a metric: no signal stays below its limit")
    at_s = metric.at_s
    if at_s is None and metric.id.startswith("final."):
        at_s = (run.end_ns - run.start_ns) / 1e9
    kind = list_metrics(run.declaration).get(metric.id)
    found = None if at_s is None else _find_carrier(run, result.names, metric.value, at_s)
    if found is None or at_s is None:
        return SignalSearch(reason=f"{metric.id} is a metric and no signal's value at a moment")
    name, curve, row = found
    unit, factor = find_scale(list_signals(run.declaration)[name].unit)
    limit = judged.limit * (1.0 if metric.unit == "deg" else factor)
    magnitude = np.abs(curve.values)
    outside = np.arange(len(magnitude)) == row
    first_s = at_s if result.first_violation_s is None else result.first_violation_s
    is_over_time = kind is not None and kind.grows
    if is_over_time:
        outside |= (magnitude > limit) & (curve.time_s >= first_s)
    rows = _Rows(curve=curve, outside=outside)
    ends = np.full(len(magnitude), limit)
    return rows.show(
        result,
        worst=rows.tell(row),
        name=name,
        unit=unit,
        low=-ends if (curve.values < 0.0).any() else None,
        high=ends,
        metric="" if is_over_time else metric.id,
    )


def _find_carrier(
    run: Run, names: Sequence[str], value: float | None, at_s: float
) -> tuple[str, Curve, int] | None:
    """Return the signal whose magnitude at a time equals a value, with the row; headings in deg."""
    for name in names:
        signal = find_signal(run, name)
        if signal is None or signal.kind.compared_as == "label" or value is None:
            continue
        factor = find_scale(signal.kind.unit)[1]
        curve = Curve(
            start_ns=run.start_ns,
            time_ns=signal.time_ns,
            values=signal.values * factor,
            holds=signal.kind.resampling == "hold",
        )
        row = int(np.abs(curve.time_s - at_s).argmin())
        if math.isclose(abs(float(curve.values[row])), abs(value), rel_tol=_SAME, abs_tol=_SAME):
            return name, curve, row
    return None


def _find_over_time(run: Run, result: CheckResult, check: Check) -> SignalSearch:
    """Return the signal of the comparison that decides a formula."""
    formula, names = check.formula, check.formula.names
    window_ns = find_span(run, names) if check.phase is None else find_window(run, check.phase)
    if window_ns is None:
        return SignalSearch(reason=f"the run has no phase {check.phase}")
    found = check_run(run, formula, window_ns=window_ns)
    leaf = next(
        (one for one in list_leaves(formula.root) if found.decided_by in one.list_links()), None
    )
    signals = read_signals(run, names)
    if leaf is None or not names_signals(leaf.node, signals):
        of_metric = any(name in list_metrics(run.declaration) for name in names)
        hint = "; a metric is one value, to be asked for without always" if of_metric else ""
        return SignalSearch(reason=f"{found.decided_by or formula.text} names no signal{hint}")
    trace = FormulaTrace.open(signals, formula, window_ns=window_ns)
    band = BandReader(run, formula, leaf, signals).read(found.decided_by)
    if band is None:
        return SignalSearch(reason=f"{found.decided_by}: {_NO_BAND}")
    outside = leaf.find_failing(formula, trace, band.curve.time_ns) & band.is_beyond
    first_s = 0.0 if result.first_violation_s is None else result.first_violation_s
    rows = _Rows(curve=band.curve, outside=outside)
    worst = rows.find(first_s if result.value_s is None else result.value_s)
    furthest = float(np.max(band.excess[outside], initial=-np.inf))
    is_nearest = bool(outside.any()) and float(band.excess[worst]) < furthest - _SAME * furthest
    first = ViolationMoment(time_s=first_s, value=float(band.curve.values[rows.find(first_s)]))
    return rows.show(
        result,
        first=first,
        worst=rows.tell(worst),
        worst_word="nearest" if is_nearest else "worst",
        name=band.name,
        unit=band.unit,
        low=band.low,
        high=band.high,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Rows:
    """Rows of a curve, and which of them are outside a band."""

    curve: Curve
    outside: NDArray[np.bool_]

    def show(
        self, result: CheckResult, *, first: ViolationMoment | None = None, **more: Any
    ) -> SignalSearch:
        """Return the signal of these rows; by default, the first row outside is the first."""
        signal = ViolatedSignal(
            curve=self.curve,
            outside=self.outside,
            first=first or self.tell(int(self.outside.argmax())),
            check=result.check,
            expected=result.expected,
            **more,
        )
        return SignalSearch(signal=signal)

    def find(self, time_s: float) -> int:
        """Return the row that is valid at a time; of rows with equal times, the last."""
        time_ns = self.curve.start_ns + round(time_s * 1e9)
        return max(int(np.searchsorted(self.curve.time_ns, time_ns, side="right")) - 1, 0)

    def tell(self, row: int) -> ViolationMoment:
        return ViolationMoment(
            time_s=float(self.curve.time_s[row]), value=float(self.curve.values[row])
        )
