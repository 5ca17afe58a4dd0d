"""Time limit for one answer of a law, by the clock, even if a step never returns.

A step beyond its limit is ended by an exception in the thread of the law. Code may continue
nevertheless, because it catches everything or waits in C. Such code is left in its thread, which
ends with the process at the latest. Only C code that never releases the interpreter's lock can
block a run.
"""

import contextvars
import operator
import sys
import threading
import time
import weakref
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import partial
from itertools import islice
from math import inf
from numbers import Real
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, Final, Generic, TypeVar

from turtlelog.display import format_number
from turtlelog.errors import SimulationError

if TYPE_CHECKING:
    from turtlelog.simulate.plain_loop import PlainLoop

STEP_BUDGET_S: Final = 10.0
"""Default time limit for one answer of a user law [s]: far longer than a robot waits, and short for
a user whose law never returns."""

TIMED_BELOW_S: Final = 1.0
"""Budget below which each step runs and is timed in its own thread, which doubles the time of the
loop [s]. From this budget on, the whole loop runs in a thread and is checked occasionally."""

_LOOKS: Final = 20
"""Number of checks per budget whether the step has returned: a step may last a twentieth longer."""

_PIECE_S: Final = 0.02
"""Duration of the loop between two batches of ticks [s], so that progress bars move and Ctrl-C
acts."""

_AT_ONCE: Final = 256
"""Largest number of ticks in a batch: smaller batches cost calls, larger ones do not fit a
cache."""

_PATIENCE_S: Final = 1.0
"""Additional wait after the budget [s]. If the step returns in this time, the error contains its
duration."""

_AGAIN_S: Final = 0.05  # time between attempts to end a step [s]: a law may catch the exception
_ATTEMPTS: Final = 10  # number of attempts to end a step before the run continues without it
_LONGEST_S: Final = 3600.0  # longest single wait [s]: a queue refuses waits of years

_DEBUGGERS: Final = frozenset({"bdb", "pdb", "pydevd", "_pydevd_bundle", "debugpy"})

Step = Callable[..., Any]
_Result = TypeVar("_Result")
_Item = TypeVar("_Item")

_Answer = tuple[_Result | None, BaseException | None, float]
"""Result or exception of a call, and its duration [s]."""


class StepBudgetError(SimulationError):
    """A law that exceeded its computing time."""


class StepEnded(SystemExit):
    """Exception that ends a step which does not return. A SystemExit ends a thread silently."""


def require_budget(budget_s: float) -> None:
    """Raise a SimulationError for a budget that is not above 0, or is infinite."""
    if not (isinstance(budget_s, Real) and 0.0 < budget_s < inf):
        raise SimulationError(f"step_budget_s: expected a time above 0 s, found {budget_s!r:.60}")


def describe_excess(budget_s: float, took_s: float, *, has_returned: bool = True) -> str:
    """Return a sentence on the duration of a step, or on its time so far [s]."""
    took = f"{format_number(took_s * 1e3)} ms"
    more = "" if has_returned else "more than "
    return f"took {more}{took} of a budget of {format_number(budget_s * 1e3)} ms"


def advise_budget(budget_s: float) -> str:
    """Return how to set a longer budget."""
    longer_s = 6.0 * budget_s
    option = f"--step-budget-ms {format_number(longer_s * 1e3)}"
    return f"a slow law needs more: {option}, in Python step_budget_s={format_number(longer_s)}"


class _Worker(Generic[_Result]):
    """A thread that calls a function on request.

    Attributes:
        start_s: Start of the present call, if any [s].
    """

    def __init__(self, call: Callable[..., _Result], name: str) -> None:
        self._questions: SimpleQueue[tuple[Any, ...] | None] = SimpleQueue()
        self._answers: SimpleQueue[_Answer[_Result]] = SimpleQueue()
        self.start_s: list[float] = []
        # With the caller's context, such as numpy's error handling.
        call = partial(contextvars.copy_context().run, call)
        channels = self._questions, self._answers, self.start_s
        self._thread = threading.Thread(
            target=_work, args=(call, *channels), name=name, daemon=True
        )
        self._thread.start()
        weakref.finalize(self, self._questions.put, None)

    def ask(self, *question: Any) -> None:
        """Request a call of the function."""
        self.start_s.clear()
        self._questions.put(question)

    def wait(self, most_s: float) -> _Answer[_Result]:
        """Return the answer of the function; raise Empty after the given time [s]."""
        return self._answers.get(timeout=min(most_s, _LONGEST_S))

    def wait_while(self, count: Callable[[], int], most_s: float) -> _Answer[_Result] | None:
        """Wait while a count changes within a given time [s]; return None if it stops changing."""
        seen, waited_s, look_s = -1, 0.0, most_s / _LOOKS
        while waited_s < most_s:
            began_s = time.perf_counter()
            with suppress(Empty):
                return self.wait(look_s)
            # The time of a stopped process does not count as computing time.
            waited_s += min(time.perf_counter() - began_s, 2.0 * look_s)
            before, seen = seen, count()
            if seen != before or self.is_debugged():
                waited_s = 0.0
        return None

    def interrupt(self) -> None:
        """Raise an exception in the thread."""
        import ctypes  # needed only for steps that do not return

        ended = ctypes.py_object(StepEnded)
        ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(self._thread.ident or 0), ended)

    def leave(self) -> None:
        """Abandon the thread; it ends as soon as possible."""
        self._questions.put(None)
        arguments = self._thread, self.interrupt
        threading.Thread(target=_end, args=arguments, name="step end", daemon=True).start()

    def end(self) -> None:
        """End the thread when it has nothing to do."""
        self._questions.put(None)

    def is_debugged(self) -> bool:
        """Return whether a debugger or profiler is active in the thread."""
        frame = sys._current_frames().get(self._thread.ident or 0)
        while frame is not None:
            if str(frame.f_globals.get("__name__")).partition(".")[0] in _DEBUGGERS:
                return True
            frame = frame.f_back
        return False


class StepBudget:
    """Caller of a law's `step` in its own thread, with a time limit.

    The run does not wait for a step that cannot be ended.
    """

    def __init__(self, step: Step, budget_s: float) -> None:
        """Store a law's `step` and its time limit [s]. Only the step itself is timed."""
        require_budget(budget_s)
        self._step, self._budget_s = step, budget_s
        self._worker: _Worker[Any] | None = None

    def __call__(self, *question: Any) -> Any:
        """Return the law's decision, or raise the law's exception.

        Raises:
            StepBudgetError: If the step took longer. The text continues after the number of the
                sample.
        """
        worker = self._worker = self._worker or _Worker(self._step, "step")
        worker.ask(*question)
        try:
            decision, error, took_s = self._wait(worker)
        except BaseException:
            worker.leave()
            raise
        if took_s > self._budget_s:
            raise StepBudgetError(describe_excess(self._budget_s, took_s)) from error
        if error is not None:
            raise error
        return decision

    def _wait(self, worker: _Worker[Any]) -> _Answer[Any]:
        """Return the answer. For a late step, wait a little longer to measure its duration."""
        took_s, most_s = 0.0, self._budget_s + _PATIENCE_S
        while took_s < most_s:
            try:
                return worker.wait(most_s - took_s)
            except Empty:
                began_s = worker.start_s[0] if worker.start_s else time.perf_counter()
                took_s = time.perf_counter() - began_s
        raise StepBudgetError(describe_excess(self._budget_s, most_s, has_returned=False))


def needs_watch(step_budget_s: float | None, *, is_built_in: bool) -> bool:
    """Return whether a loop with a user law computes in a `LimitedLoop`.

    Steps that are timed one by one do not need a `LimitedLoop`. A debugger or profiler of one
    thread would miss the work in another thread.
    """
    is_timed = step_budget_s is not None and step_budget_s < TIMED_BELOW_S
    return step_budget_s is not None and not (is_timed or is_built_in or _is_inspected())


class LimitedLoop(Generic[_Item]):
    """A loop that runs in its own thread with a time limit for each step.

    The thread passes its items on in batches, so that it is as fast as without a budget.
    """

    def __init__(
        self,
        items: Iterator[_Item],
        loops: "Sequence[PlainLoop]",
        budget_s: float,
        *,
        law: str,
        one_by_one: bool,
    ) -> None:
        """Store the items that a loop makes, and a list of the loop once it has started.

        `budget_s` is the time limit for one answer of the law [s], `law` the kind of the law, and
        `one_by_one` whether to make each item only when it is requested.
        """
        self._items, self._loops, self._budget_s = items, loops, budget_s
        self._law, self._one_by_one = law, one_by_one
        self._made: deque[_Item] = deque()
        self._hands_out = self._is_late = False

    def iterate(self) -> Iterator[_Item]:
        """Yield the items, then raise StepBudgetError if a step takes longer than the budget."""
        worker, stdout = _Worker(self._advance, "loop"), sys.stdout
        is_over: bool | None = False
        error: BaseException | None = None
        while not (is_over or error):
            worker.ask()
            try:
                is_over, error, _ = self._wait(worker)
            except BaseException as err:
                worker.leave()
                sys.stdout = stdout  # prints of a law go to stderr while it computes
                if not isinstance(err, StepBudgetError):
                    raise
                error = err
            while self._made:
                yield self._made.popleft()
        worker.end()
        if self._is_late and not isinstance(error, StepBudgetError):
            error = StepBudgetError(self._describe())
        if error is not None:
            raise error

    def _advance(self) -> bool:
        """Make items until a batch is complete; return whether all items are made."""
        self._hands_out = self._one_by_one
        made = self._made
        for item in islice(self._items, _AT_ONCE):
            made.append(item)
            if self._hands_out:
                return False
        return len(made) < _AT_ONCE

    def _wait(self, worker: _Worker[bool]) -> _Answer[bool]:
        """Return the worker's answer, or raise an error for a late step that cannot be ended."""
        with suppress(Empty):
            return worker.wait(_PIECE_S)
        self._hands_out = True
        answer = worker.wait_while(
            lambda: self._loops[0].asked if self._loops else 0, self._budget_s
        )
        if answer is not None:
            return answer
        self._is_late = True
        for _ in range(_ATTEMPTS):
            worker.interrupt()
            with suppress(Empty):
                return worker.wait(_PATIENCE_S / _ATTEMPTS)
        raise StepBudgetError(self._describe())

    def _describe(self) -> str:
        what = describe_excess(self._budget_s, self._budget_s, has_returned=False)
        if self._loops:
            return self._loops[0].describe_late(what)
        return f"law {self._law} {what}, before its first sample; {advise_budget(self._budget_s)}"


class WatchedCode:
    """Thread that calls compiled code with a user law.

    Compiled code cannot be ended. If the code never returns, the thread lasts until the process
    ends.
    """

    def __init__(self, budget_s: float) -> None:
        """Store the time limit for one answer of the law [s]."""
        self._budget_s = budget_s
        self._worker: _Worker[Any] | None = None

    def call(self, code: Callable[[], Any], count: Callable[[], int]) -> None:
        """Call code that runs without Python's lock; `count` returns the number of answers so far.

        Raises:
            StepBudgetError: If an answer exceeds the budget by more than the grace period.
        """
        worker = self._worker or _Worker(operator.call, "compiled")
        self._worker = None  # if the wait ends without an answer
        worker.ask(code)
        most_s = self._budget_s + _PATIENCE_S
        answer = worker.wait_while(count, most_s)
        if answer is None:
            worker.end()
            raise StepBudgetError(describe_excess(self._budget_s, most_s, has_returned=False))
        self._worker = worker
        if answer[1] is not None:
            raise answer[1]


def _is_inspected() -> bool:
    """Return whether this thread is debugged or profiled."""
    debugger = getattr(sys.gettrace(), "__self__", None)
    return sys.getprofile() is not None or type(debugger).__module__.partition(".")[0] in _DEBUGGERS


def _work(
    call: Callable[..., _Result],
    questions: SimpleQueue[tuple[Any, ...] | None],
    answers: SimpleQueue[_Answer[_Result]],
    start_s: list[float],
) -> None:
    """Process one request after the other, with the duration of each [s]."""
    with suppress(StepEnded):  # the exception may come after the step has returned
        while (question := questions.get()) is not None:
            result, error = None, None
            began_s = time.perf_counter()
            start_s.append(began_s)
            try:
                result = call(*question)
            except BaseException as err:
                error = err
            answers.put((result, error, time.perf_counter() - began_s))


def _end(thread: threading.Thread, interrupt: Callable[[], None]) -> None:
    """Raise an exception in a thread until the thread ends, as code may catch some exceptions."""
    while thread.is_alive():
        interrupt()
        thread.join(_AGAIN_S)
