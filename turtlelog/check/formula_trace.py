"""The data of a formula check: signals over a window, and knowledge of the time after the end.

Signals are piecewise constant functions of time (`Steps`). A function holds each value from its
step to the next (it is right-continuous) and the last one forever. The operations below are exact
on such functions and return such functions. The reason: a sliding window meets a new value only
when one of its ends meets a step. Unknown values are NaN, and results that depend on them are
unknown. Times are integers, so that rounding moves no step.

Definitions of the window operators and of `until`: A. Donzé, T. Ferrère, O. Maler, "Efficient
Robust Monitoring for STL", CAV 2013; all windows are closed.
"""

import enum
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.check.spec import find_kind
from turtlelog.compare.common_clock import find_range_maxima, merge_times
from turtlelog.errors import CheckError
from turtlelog.expressions import (
    Expression,
    Name,
    Node,
    Temporal,
    Until,
    describe_unknown_name,
    fail_at,
    iterate_nodes,
)
from turtlelog.log.recording.head import LOSS_NOTES
from turtlelog.measure import COMMANDED, find_signal, list_signals, measure_run
from turtlelog.run import Run
from turtlelog.run.loops import PAUSE


class RunEnding(enum.Enum):
    """Knowledge of the time after the last row.

    The value is the reason why that time is unknown.
    """

    SETTLED = ""
    """The run or its phase ended by itself: the last values are held forever."""
    CUT = "the run had not ended"
    """The run reached `max_duration`, was interrupted, or has no stop reason."""
    LOST = "part of it is lost"
    """Rows may be missing, also at the end."""
    UNDECLARED = "it does not say whether the robot had stopped"
    """A third-party bag, in which windows without an end stop at the last row."""


def find_ending(run: Run) -> RunEnding:
    """Return the knowledge of the time after a run's last row."""
    if run.origin.lost == "rows":
        return RunEnding.LOST
    if run.is_complete:
        return RunEnding.SETTLED
    # A log of a controller could show that it had finished; a bag of other topics could not.
    could_tell = len(run.samples) or "stop_reason" not in run.absent
    return RunEnding.CUT if could_tell else RunEnding.UNDECLARED


def find_loss(run: Run) -> str | None:
    """Return the data that a recording has lost; None if the recording is complete."""
    if run.origin.lost == "nothing":
        return None
    told = [run.notes[name] for name in LOSS_NOTES if name in run.notes]
    return ": ".join(["the recording is not complete", *told[:1]])


def find_window(run: Run, phase: str) -> tuple[int, int] | None:
    """Return the first segment of a phase with its pause [ns]; None if the phase takes no time.

    It ends before the time of the next phase, whose first sample holds at this time. Therefore, a
    phase whose samples share that time never holds.
    """
    spans = run.find_phase_spans()
    for index, span in enumerate(spans):
        if span.phase != phase:
            continue
        after = spans[index + 1 : index + 2]
        is_paused = bool(after) and after[0].phase == PAUSE
        last = after[0] if is_paused else span
        end_ns = last.end_ns - (last is not spans[-1])
        if end_ns >= span.start_ns:
            return span.start_ns, end_ns
    return None


def find_span(run: Run, names: Sequence[str]) -> tuple[int, int]:
    """Return the time span in which a formula over these names is judged on a whole run [ns].

    It starts at time zero. In a run without samples, commands have no value before the first
    publication: formulas with commands are judged from then on, formulas with commands alone on all
    commands.
    """
    signals = [name for name in names if name in list_signals(run.declaration)]
    commanded = [name for name in signals if name in COMMANDED]
    if not commanded or len(run.samples) or not len(run.commands):
        return run.start_ns, run.end_ns
    first_ns = int(run.commands.time_ns[0])
    is_alone = len(commanded) == len(signals)
    return first_ns if is_alone else max(first_ns, run.start_ns), run.end_ns


Column = tuple[NDArray[np.int64], NDArray[Any]]
Signals = Mapping[str, Column | float | bool | str | None]
"""Signals and constants by name: times [ns] and values of a signal, or a constant; None for no
value."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FormulaTrace:
    """The signals and constants of one formula, from start_ns to end_ns.

    Attributes:
        names: Names in order of first use.
        constants: Constant values; None for no value.
        ending: Knowledge of the signals after end_ns.
    """

    start_ns: int
    end_ns: int
    names: tuple[str, ...]
    signals: Mapping[str, "Steps"]
    constants: Mapping[str, Any]
    ending: RunEnding = RunEnding.SETTLED

    @classmethod
    def open(
        cls,
        signals: Signals,
        expression: Expression,
        *,
        window_ns: tuple[int, int] | None = None,
        ending: RunEnding = RunEnding.SETTLED,
    ) -> "FormulaTrace":
        """Return the trace for the names of a formula; names and signals are checked."""
        check_names(expression, signals)
        named = {name: signals[name] for name in expression.names}
        columns = {name: found for name, found in named.items() if isinstance(found, tuple)}
        for name, column in columns.items():
            _check_column(name, column)
        times = [time_ns for time_ns, _ in columns.values()]
        first_ns = max((int(time_ns[0]) for time_ns in times), default=0)
        last_ns = max((int(time_ns[-1]) for time_ns in times), default=0)
        start_ns, end_ns = window_ns or (first_ns, max(first_ns, last_ns))
        if start_ns > end_ns:
            raise CheckError(f"trace: expected an end after its start, found {start_ns}, {end_ns}")
        for name, (time_ns, _) in columns.items():
            if time_ns[0] > start_ns:
                place = f"signal {name!r}: expected a value at {start_ns} ns"
                raise CheckError(f"{place}, found its first at {time_ns[0]} ns")
        return cls(
            start_ns=start_ns,
            end_ns=end_ns,
            names=expression.names,
            signals={
                name: make_steps(*column, start_ns=start_ns, end_ns=end_ns)
                for name, column in columns.items()
            },
            constants={name: found for name, found in named.items() if name not in columns},
            ending=ending,
        )

    def read_values(self, time_ns: int) -> dict[str, Any]:
        """Return the value of every name at a time: float, bool, str or None."""
        found = {**dict.fromkeys(self.names), **self.constants}
        for name, steps in self.signals.items():
            value = steps.values[steps.find_piece(time_ns)].item()
            found[name] = None if isinstance(value, float) and math.isnan(value) else value
        return found


def list_names(node: Node) -> list[str]:
    """Return the names below a node, as often as they occur."""
    return [part.name for part in iterate_nodes(node) if isinstance(part, Name)]


def check_names(expression: Expression, known: Mapping[str, object]) -> None:
    """Raise an error for an unknown name, with its column and the nearest names."""
    for node in iterate_nodes(expression.root):
        if isinstance(node, Name) and node.name not in known:
            fail_at(expression, node, describe_unknown_name(node.name, known))


def read_signals(run: Run, names: Sequence[str]) -> Signals:
    """Return the values of names in a run; unknown names are left out.

    Names are searched among the signals and states, the metrics and the parameters, in this order.
    A signal begins at the run's time zero at the latest. The phase is text. Missing signals, and
    metrics without a value, are None.
    """
    columns = list_signals(run.declaration)
    ids = [name for name in names if name not in columns and find_kind(run, name) is not None]
    metrics = measure_run(run, only=ids) if ids else {}
    found: dict[str, Any] = {}
    for name in names:
        if name in columns:
            found[name] = _read_column(run, name)
        elif name in metrics:
            found[name] = metrics[name].value
        elif name in run.parameters and not isinstance(run.parameters[name], list):
            found[name] = run.parameters[name]
    return found


def _read_column(run: Run, name: str) -> Column | None:
    signal = find_signal(run, name)
    if signal is None:
        return None
    if signal.kind.compared_as != "label":
        return signal.time_ns, signal.values
    labels = np.array(run.phase_names)
    return signal.time_ns, labels[signal.values.astype(np.int64)]


def _check_column(name: str, column: Column) -> None:
    place = f"signal {name!r}"
    time_ns, values = column
    if time_ns.dtype != np.int64:
        raise CheckError(f"{place}: expected times as int64 nanoseconds, found {time_ns.dtype}")
    if time_ns.ndim != 1 or time_ns.shape != values.shape:
        found = f"{time_ns.shape} and {values.shape}"
        raise CheckError(f"{place}: expected as many times as values in one row, found {found}")
    if not len(time_ns):
        raise CheckError(f"{place}: must not be empty")
    falls = time_ns[1:] < time_ns[:-1]
    if falls.any():
        row = int(falls.argmax()) + 1
        found = f"{time_ns[row]} after {time_ns[row - 1]} at row {row}"
        raise CheckError(f"{place}: expected times that do not decrease, found {found}")


Times = NDArray[np.int64]
Values = NDArray[Any]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Steps:
    """A function of time from its first step on.

    Attributes:
        time_ns: Times of the steps [ns], shape (n,), strictly increasing, n > 0.
        values: Value from each step to the next, shape (n,).
    """

    time_ns: Times
    values: Values

    def find_piece(self, time_ns: int) -> int:
        """Return the index of the value at a time; before the first step, of the first value."""
        return max(0, int(np.searchsorted(self.time_ns, time_ns, side="right")) - 1)

    def cut(self, start_ns: int, end_ns: int) -> "Steps":
        """Return the function from start to end [ns], with its first step moved to the start."""
        first, last = self.find_piece(start_ns), self.find_piece(end_ns)
        time_ns = np.maximum(self.time_ns[first : last + 1], start_ns)
        return Steps(time_ns=time_ns, values=self.values[first : last + 1])

    def end_with(self, value: float, *, from_ns: int) -> "Steps":
        """Return the function with a constant value from a time on [ns]."""
        if from_ns <= self.time_ns[0]:
            return Steps(time_ns=self.time_ns[:1], values=np.array([value]))
        after = int(np.searchsorted(self.time_ns, from_ns, side="left"))
        return Steps(
            time_ns=np.append(self.time_ns[:after], np.int64(from_ns)),
            values=np.append(self.values[:after], value),
        )


def make_steps(time_ns: Times, values: Values, *, start_ns: int, end_ns: int) -> Steps:
    """Return columns as a function from start_ns to end_ns; the last row at each time is used.

    The first of the times, which do not decrease, is not after start_ns.
    """
    first = int(np.searchsorted(time_ns, start_ns, side="right")) - 1
    after = int(np.searchsorted(time_ns, end_ns, side="right"))
    time_ns, values = time_ns[first:after], values[first:after]
    same = time_ns[1:] == time_ns[:-1]
    if same.any():
        last = np.append(~same, True)
        time_ns, values = time_ns[last], values[last]
    if time_ns[0] != start_ns:
        time_ns = np.concatenate(([start_ns], time_ns[1:]))
    return Steps(time_ns=time_ns, values=values)


def align_steps(functions: list[Steps]) -> tuple[Times, list[Values]]:
    """Return the steps of all functions in one list, and the values of each at them."""
    times = [function.time_ns for function in functions]
    if all(np.array_equal(time_ns, times[0]) for time_ns in times[1:]):
        return times[0], [function.values for function in functions]
    union = merge_times(times)
    pieces = [function.time_ns.searchsorted(union, side="right") - 1 for function in functions]
    return union, [one.values[piece] for one, piece in zip(functions, pieces, strict=True)]


def combine_steps(combine: Callable[[Values, Values], Values], functions: list[Steps]) -> Steps:
    """Return functions joined value by value, from left to right."""
    time_ns, values = align_steps(functions)
    joined = values[0]
    for other in values[1:]:
        joined = combine(joined, other)
    return Steps(time_ns=time_ns, values=joined)


def negate_steps(function: Steps) -> Steps:
    """Return a function with its sign changed."""
    return Steps(time_ns=function.time_ns, values=-function.values)


def slide_minimum(function: Steps, first_ns: int, last_ns: int | None) -> Steps:
    """Return at each time t the minimum on [t + first_ns, t + last_ns]; None: without end."""
    return negate_steps(slide_maximum(negate_steps(function), first_ns, last_ns))


def slide_maximum(function: Steps, first_ns: int, last_ns: int | None) -> Steps:
    """Return at each time t the maximum on [t + first_ns, t + last_ns]; None: without end."""
    changes = function.values[1:] != function.values[:-1]
    if 2 * np.count_nonzero(changes) <= len(changes):  # many steps change nothing
        kept = np.concatenate(([True], changes))
        function = Steps(time_ns=function.time_ns[kept], values=function.values[kept])
    span_ns = int(function.time_ns[-1] - function.time_ns[0])
    first_ns = min(first_ns, span_ns)  # beyond it only the last value follows
    if last_ns is None or last_ns >= span_ns:
        coming = np.maximum.accumulate(function.values[::-1])[::-1]
        return _shift(Steps(time_ns=function.time_ns, values=coming), first_ns)
    if first_ns == last_ns:
        return _shift(function, first_ns)
    return _slide_window(function, first_ns, last_ns)


def compute_until(left: Steps, right: Steps, first_ns: int, last_ns: int | None) -> Steps:
    """Return the maximum over t' in [t + first, t + last] of min(right(t'), left on [t, t']).

    By the identity of Donzé et al., two conditions must hold: right becomes true within the window;
    at every time up to the window's beginning, left holds until right holds.
    """
    time_ns, (held, coming) = align_steps([left, right])
    unbounded = Steps(time_ns=time_ns, values=_scan_until(held, coming))
    if first_ns:
        unbounded = slide_minimum(unbounded, 0, first_ns)
    if last_ns is None:
        return unbounded
    return combine_steps(np.minimum, [slide_maximum(right, first_ns, last_ns), unbounded])


def _shift(function: Steps, earlier_ns: int) -> Steps:
    """Return at each time t the value at t + earlier_ns."""
    if not earlier_ns:
        return function
    start_ns = function.time_ns[0]
    piece = function.find_piece(int(start_ns) + earlier_ns)
    time_ns = function.time_ns[piece:] - earlier_ns
    time_ns[0] = start_ns
    return Steps(time_ns=time_ns, values=function.values[piece:])


def _slide_window(function: Steps, first_ns: int, last_ns: int) -> Steps:
    times, start_ns = function.time_ns, int(function.time_ns[0])
    first, last = (function.find_piece(start_ns + edge_ns) for edge_ns in (first_ns, last_ns))
    # These columns take the most memory for long traces: each is freed after its use.
    leaving = len(times) - first - 1
    time_ns = np.concatenate(
        ([start_ns], times[first + 1 :] - first_ns, times[last + 1 :] - last_ns)
    )
    order = np.argsort(time_ns, kind="stable")  # merges sorted runs
    time_ns = time_ns[order]
    left = (order > 0) & (order <= leaving)
    del order
    firsts: Times = np.cumsum(left, dtype=np.int64)
    del left
    lasts = np.arange(last, last + len(firsts))
    lasts -= firsts
    firsts += first
    same = time_ns[1:] == time_ns[:-1]
    if same.any():
        kept = np.append(~same, True)
        time_ns = time_ns[kept]
        firsts = firsts[kept]
        lasts = lasts[kept]
    values = find_range_maxima(function.values, firsts, lasts)
    return Steps(time_ns=time_ns, values=values)


def _scan_until(held: Values, coming: Values) -> Values:
    """Return u[i] = min(held[i], max(coming[i], u[i + 1])), from the last to the first.

    Each step clamps the next value to [min(held, coming), held]. Because a composition of clamps is
    a clamp, blocks of the columns are scanned in parallel, then joined.
    """
    count = len(held)
    size = max(1, int(np.sqrt(count)))
    blocks = -(-count // size)
    low = _fold(np.minimum(held, coming), blocks, size, fill=-np.inf)
    high = _fold(held, blocks, size, fill=np.inf)
    for row in range(size - 2, -1, -1):
        own_low, own_high = low[row].copy(), high[row].copy()
        low[row] = np.minimum(own_high, np.maximum(own_low, low[row + 1]))
        high[row] = np.minimum(own_high, np.maximum(own_low, high[row + 1]))
    after = np.empty(blocks)
    after[-1] = -np.inf
    for block in range(blocks - 1, 0, -1):
        later = np.maximum(low[0, block], after[block])
        after[block - 1] = np.minimum(high[0, block], later)
    np.maximum(low, after, out=low)
    joined = np.minimum(high, low, out=low)
    del high
    return joined.T.reshape(-1)[:count]


def _fold(values: Values, blocks: int, size: int, *, fill: float) -> Values:
    """Return a column as parallel blocks, shape (size, blocks), padded at the end."""
    padded = np.full(blocks * size, fill)
    padded[: len(values)] = values
    return np.ascontiguousarray(padded.reshape(blocks, size).T)


_LONGEST_S: Final = 1e18
"""Time after the end of all traces [s]."""


def convert_window(node: Temporal | Until) -> tuple[int, int | None]:
    """Return the ends of a node's window [ns]; None if the window has no end."""
    last_ns = None if math.isinf(node.end_s) else _convert(node.end_s)
    return _convert(node.start_s), last_ns


def _convert(time_s: float) -> int:
    return round(min(time_s, _LONGEST_S) * 1e9)


def measure_reach(node: Node, *, is_cut: bool) -> float:
    """Return how far ahead a formula looks [s]; unless cut, an open window counts to its start."""
    children = node.list_children()
    below = max((measure_reach(child, is_cut=is_cut) for child in children), default=0.0)
    if not isinstance(node, Temporal | Until):
        return below
    return below + (node.start_s if math.isinf(node.end_s) and not is_cut else node.end_s)
