"""The signal that violated a check, and the band in which the check requires it to stay."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.charts.curve_marks import ViolatedSignal, ViolationMoment
from turtlelog.charts.curves import Curve
from turtlelog.check.formula_trace import (
    FormulaTrace,
    Signals,
    find_span,
    find_window,
    list_names,
    read_signals,
)
from turtlelog.check.judge_formula import check_run
from turtlelog.check.result import CheckResult, JudgedMetric, JudgedSignal, Verdict
from turtlelog.check.robustness import (
    Compared,
    Place,
    list_compared,
    split_comparison,
    walk_formula,
)
from turtlelog.check.spec import Check, find_formula_unit
from turtlelog.compare.common_clock import merge_times
from turtlelog.compare.difference import trace_tube
from turtlelog.expressions import (
    Call,
    Comparison,
    Expression,
    Kind,
    Name,
    Node,
    evaluate_node,
    format_expression,
)
from turtlelog.measure import (
    MIRRORED,
    SignalKind,
    find_signal,
    list_metrics,
    list_signals,
    measure_run,
)
from turtlelog.measure.reductions import Values
from turtlelog.run import Run

_SAME: Final = 1e-9
"""Relative difference up to which a metric equals a signal's value at its time."""

_NO_BAND: Final = "what is compared is no band around a signal"


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalSearch:
    """The violated signal of a check, or the reason why no signal is found."""

    signal: ViolatedSignal | None = None  # None if the violation has no signal, or no time
    reason: str = ""  # reason why there is no signal; empty if there is a signal


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
    outside = np.zeros_like(found.signal.outside)
    return SignalSearch(signal=replace(found.signal, outside=outside))


def _find_signal(run: Run, result: CheckResult) -> SignalSearch:
    judged = result.judged
    if judged is None:
        return SignalSearch(reason=f"{result.check} is held to no band of a signal")
    if isinstance(judged, JudgedSignal):
        return _find_in_tube(run, result, judged)
    if isinstance(judged, JudgedMetric):
        return _find_of_metric(run, result, judged)
    if (metric := _read_metric_bound(run, judged, result)) is not None:
        return _find_of_metric(run, result, metric)
    if result.verdict is Verdict.FAIL and result.first_violation_s is None:
        return SignalSearch(reason="it is violated at no single moment")
    return _find_over_time(run, result, judged)


def _find_in_tube(run: Run, result: CheckResult, judged: JudgedSignal) -> SignalSearch:
    tube = trace_tube(
        judged.reference, run, judged.name, judged.tolerance, alignment=judged.alignment
    )
    if tube is None or not (tube.excess > 0.0).any():
        return SignalSearch(reason=f"{judged.name} is no number with a distance")
    outside = tube.excess > 0.0
    kind = list_signals(run.declaration)[judged.name]
    unit, factor = find_scale(kind.unit)
    rows = _Rows(curve=_build_curve(run, kind, tube.time_ns, tube.values), outside=outside)
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


def _build_curve(run: Run, kind: SignalKind, time_ns: NDArray[np.int64], values: Values) -> Curve:
    shown, is_held = values * find_scale(kind.unit)[1], kind.resampling == "hold"
    return Curve(start_ns=run.start_ns, time_ns=time_ns, values=shown, holds=is_held)


def _read_metric_bound(run: Run, check: Check, result: CheckResult) -> JudgedMetric | None:
    """Return the only metric that a check bounds by a number; None for any other check."""
    root = check.formula.root
    if check.kind != "expect" or not isinstance(root, Comparison) or result.limit is None:
        return None
    if len(root.operators) > 1:
        return None
    asked = root.operators[0]
    for node, operator in zip(root.operands, (asked, MIRRORED[asked]), strict=True):
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
        curve = _build_curve(run, signal.kind, signal.time_ns, signal.values)
        row = int(np.abs(curve.time_s - at_s).argmin())
        if math.isclose(abs(float(curve.values[row])), abs(value), rel_tol=_SAME, abs_tol=_SAME):
            return name, curve, row
    return None


def _find_over_time(run: Run, result: CheckResult, check: Check) -> SignalSearch:
    formula, names = check.formula, check.formula.names
    window_ns = find_span(run, names) if check.phase is None else find_window(run, check.phase)
    if window_ns is None:
        return SignalSearch(reason=f"the run has no phase {check.phase}")
    found = check_run(run, formula, window_ns=window_ns)
    leaves = (
        leaf
        for leaf in list_compared(formula.root)
        for link in split_comparison(leaf.node)
        if format_expression(link) == found.decided_by
    )
    leaf = next(leaves, None)
    signals = read_signals(run, names)
    if leaf is None or not _names_signals(leaf.node, signals):
        of_metric = any(name in list_metrics(run.declaration) for name in names)
        hint = "; a metric is one value, to be asked for without always" if of_metric else ""
        return SignalSearch(reason=f"{found.decided_by or formula.text} names no signal{hint}")
    trace = FormulaTrace.open(signals, formula, window_ns=window_ns)
    band = _BandReader(run, formula, leaf, signals).read(found.decided_by)
    if band is None:
        return SignalSearch(reason=f"{found.decided_by}: {_NO_BAND}")
    outside = _find_failing(leaf.place, formula, trace, band.curve.time_ns) & band.is_beyond
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
        time_s, value = float(self.curve.time_s[row]), float(self.curve.values[row])
        return ViolationMoment(time_s=time_s, value=value)


_TURNED: Final = {"<": ">=", "<=": ">", ">": "<=", ">=": "<", "==": "!=", "!=": "=="}
"""Required operator, by the operator of a comparison that must be false."""


def _find_failing(
    place: Place, formula: Expression, trace: FormulaTrace, time_ns: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Return the times at which the comparison is required and the formula fails."""
    first_ns = trace.start_ns + place.start_s * 1e9
    last_ns = min(trace.start_ns + place.end_s * 1e9, trace.end_ns)
    asked = (time_ns >= first_ns) & (time_ns <= last_ns)
    if place.body is None:
        return np.asarray(asked)
    margins = walk_formula(replace(formula, root=place.body), trace, exact=True).margins
    pieces = np.searchsorted(margins.time_ns, time_ns, side="right") - 1
    values = margins.values[np.maximum(pieces, 0)]
    return np.asarray(asked & ((values > 0.0) if place.is_body_denied else (values < 0.0)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Band:
    """A measured side as a curve, its limits, the rows beyond the limits, and their excess."""

    name: str
    unit: str
    curve: Curve
    low: Values | None
    high: Values | None
    excess: Values
    is_beyond: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Ends:
    """Ends of a band, None for no end, and whether an end is excluded."""

    low: Values | None = None
    high: Values | None = None
    is_strict: bool = False

    def narrow(self, other: "_Ends") -> "_Ends":
        """Return the intersection of both bands."""
        lows = [end for end in (self.low, other.low) if end is not None]
        highs = [end for end in (self.high, other.high) if end is not None]
        return _Ends(
            low=np.fmax.reduce(lows) if lows else None,
            high=np.fmin.reduce(highs) if highs else None,
            is_strict=self.is_strict or other.is_strict,
        )


class _BandReader:
    """Reader of a comparison's measured value and its limits, at the rows of the signals."""

    def __init__(self, run: Run, formula: Expression, leaf: Compared, signals: Signals) -> None:
        self._run, self._formula, self._leaf = run, formula, leaf
        named = {name: signals.get(name) for name in list_names(leaf.node)}
        columns = {name: found for name, found in named.items() if isinstance(found, tuple)}
        self._signals = columns
        times = [time_ns for time_ns, _ in columns.values()]
        is_one = all(np.array_equal(time_ns, times[0]) for time_ns in times[1:])
        time_ns = times[0] if is_one else merge_times(times)
        self._time_ns = time_ns[time_ns >= max(int(one[0]) for one in times)]
        self._values: dict[str, Any] = {name: signals.get(name) for name in formula.names}
        for name, (time_ns, values) in columns.items():
            rows = np.searchsorted(time_ns, self._time_ns, side="right") - 1
            self._values[name] = values[rows]

    def read(self, decided_by: str) -> _Band | None:
        """Return the band of the deciding comparison, with its other end, if any."""
        links = [*split_comparison(self._leaf.node)]
        decisive = next(link for link in links if format_expression(link) == decided_by)
        # The side that changes with time; the first side if both change.
        left, right = decisive.operands
        measured = left if _names_signals(left, self._signals) else right
        is_magnitude, bare = False, measured
        if isinstance(measured, Call) and measured.function == "abs":
            is_magnitude, bare = True, measured.arguments[0]
        shown = self._evaluate(bare)
        if shown is None:
            return None
        ends = self._find_ends(links, measured, is_magnitude=is_magnitude)
        if ends is None:
            return None
        for link in (part for node in self._leaf.place.beside for part in split_comparison(node)):
            names = [name for name in list_names(link) if name not in self._signals]
            if any(isinstance(self._values[name], tuple) for name in names):
                continue  # it uses other signals than the deciding comparison
            more = self._find_ends([link], measured, is_magnitude=is_magnitude)
            ends = ends if more is None else ends.narrow(more)
        low, high, excess = ends.low, ends.high, np.full(len(shown), -np.inf)
        excess = excess if high is None else np.fmax(excess, shown - high)
        excess = excess if low is None else np.fmax(excess, low - shown)
        unit, factor = find_scale(self._find_unit(measured))
        known, start_ns = list_signals(self._run.declaration), self._run.start_ns
        kinds = [known[name] for name in list_names(bare) if name in known]
        is_held = any(kind.resampling == "hold" for kind in kinds)  # in steps if any is held
        return _Band(
            name=format_expression(bare),
            unit=unit,
            curve=Curve(
                start_ns=start_ns, time_ns=self._time_ns, values=shown * factor, holds=is_held
            ),
            low=None if low is None else low * factor,
            high=None if high is None else high * factor,
            excess=excess * factor,
            is_beyond=excess >= 0.0 if ends.is_strict else excess > 0.0,
        )

    def _find_ends(
        self, links: Sequence[Comparison], measured: Node, *, is_magnitude: bool
    ) -> "_Ends | None":
        """Return the ends that comparisons require; None if a comparison requires anything else."""
        ends = _Ends()
        for link in links:
            if measured not in link.operands:
                continue
            left, right = link.operands
            operator: str = link.operators[0] if left == measured else MIRRORED[link.operators[0]]
            operator = _TURNED[operator] if self._leaf.place.is_denied else operator
            limit = self._evaluate(right if left == measured else left)
            is_high = operator in {"<", "<="}
            if limit is None or operator in {"==", "!="} or (is_magnitude and not is_high):
                return None
            high = limit if is_high else None
            low = (-limit if is_magnitude else None) if is_high else limit
            ends = ends.narrow(_Ends(low=low, high=high, is_strict=operator in {"<", ">"}))
        return ends

    def _evaluate(self, node: Node) -> Values | None:
        found = evaluate_node(self._formula, node, self._values)
        if found.kind is not Kind.NUMBER:
            return None
        return np.broadcast_to(np.asarray(found.data, np.float64), self._time_ns.shape).copy()

    def _find_unit(self, node: Node) -> str:
        """Return the unit of the measured value; for a sum, the common unit of its parts."""
        if isinstance(node, Call) and node.function == "deg":
            return "deg"
        if isinstance(node, Call) and node.function not in {"abs", "min", "max"}:
            return ""
        if isinstance(node, Name):
            return find_formula_unit(node.name, self._run.declaration) or ""
        operator = getattr(node, "operator", "")
        children = node.list_children()
        if operator in {"*", "/", "**"} or not children:
            return ""
        found = {self._find_unit(child) for child in children if list_names(child)}
        return found.pop() if len(found) == 1 else ""


def _names_signals(node: Node, signals: Mapping[str, Any]) -> bool:
    """Return whether any node below a node is a signal."""
    return any(isinstance(signals.get(name), tuple) for name in list_names(node))


def find_scale(unit: str) -> tuple[str, float]:
    """Return the unit in which a check's message shows values, and its conversion factor."""
    return ("deg", math.degrees(1.0)) if unit == "rad" else (unit, 1.0)
