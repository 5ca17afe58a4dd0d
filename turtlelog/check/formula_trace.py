"""The data of a formula check: signals over a window, and knowledge of the time after the end."""

import enum
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from turtlelog.check.piecewise_constant import Steps, make_steps
from turtlelog.check.vocabulary import find_kind
from turtlelog.errors import CheckError
from turtlelog.expressions import Expression, Name, describe_unknown_name, fail_at, iterate_nodes
from turtlelog.log.recording.head import LOSS_NOTES, NO_LOSS
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
    notes = [run.notes[name] for name in LOSS_NOTES if name in run.notes]
    if not all(note.startswith(NO_LOSS) and ";" not in note for note in notes):
        return RunEnding.LOST
    if run.is_complete:
        return RunEnding.SETTLED
    # A log of a controller could show that it had finished; a bag of other topics could not.
    could_tell = len(run.samples) or "stop_reason" not in run.absent
    return RunEnding.CUT if could_tell else RunEnding.UNDECLARED


def find_loss(run: Run) -> str | None:
    """Return the data that a recording has lost; None if the recording is complete."""
    for name in LOSS_NOTES:
        if name in run.notes:
            return f"the recording is not complete: {run.notes[name]}"
    return None


def find_window(run: Run, phase: str | None) -> tuple[int, int] | None:
    """Return the first segment of a phase with its pause [ns]; None if the phase never occurs."""
    if phase is None:
        return run.start_ns, run.end_ns
    spans = run.find_phase_spans()
    for index, span in enumerate(spans):
        if span.phase != phase:
            continue
        after = spans[index + 1 : index + 2]
        is_paused = bool(after) and after[0].phase == PAUSE
        return span.start_ns, after[0].end_ns if is_paused else span.end_ns
    return None


def find_span(run: Run, names: Sequence[str]) -> tuple[int, int]:
    """Return the time span in which a formula over these names is judged on a whole run [ns].

    The span starts at time zero. In a run without samples, commands have no value before the first
    publication. Formulas with commands are judged from the first command on; formulas with commands
    alone are judged on all commands.
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
    """The signals and constants of one formula, over one segment of time.

    Attributes:
        start_ns: First time [ns].
        end_ns: Last time [ns].
        names: Names in order of first use.
        signals: Signals as functions of time.
        constants: Constant values; None for no value.
        ending: Knowledge of the signals after end_ns.
    """

    start_ns: int
    end_ns: int
    names: tuple[str, ...]
    signals: Mapping[str, Steps]
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
        """Return the trace for the names of a formula.

        Raises:
            ExpressionError: If a name is unknown; the message has the column and the nearest names.
            CheckError: If a signal is invalid, or has no value at the first time.
        """
        check_names(expression, signals)
        named = {name: signals[name] for name in expression.names}
        columns = {name: found for name, found in named.items() if isinstance(found, tuple)}
        for name, column in columns.items():
            _check_column(name, column)
        start_ns, end_ns = window_ns or _find_window(columns)
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
        return {name: self._read_value(name, time_ns) for name in self.names}

    def _read_value(self, name: str, time_ns: int) -> Any:
        if name in self.constants:
            return self.constants[name]
        steps = self.signals[name]
        value = steps.values[steps.find_piece(time_ns)].item()
        return None if isinstance(value, float) and math.isnan(value) else value


def check_names(expression: Expression, known: Mapping[str, object]) -> None:
    """Raise an error for unknown names.

    Raises:
        ExpressionError: If a name is unknown; the message has the column and the nearest names.
    """
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


def _find_window(columns: Mapping[str, Column]) -> tuple[int, int]:
    if not columns:
        return 0, 0
    start_ns = max(int(time_ns[0]) for time_ns, _ in columns.values())
    return start_ns, max(start_ns, *(int(time_ns[-1]) for time_ns, _ in columns.values()))


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
