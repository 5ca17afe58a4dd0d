"""How long a law may compute for one answer, by the clock; also of one that never returns."""

import contextvars
import threading
import time
import weakref
from collections.abc import Callable
from contextlib import suppress
from math import inf
from queue import Empty, SimpleQueue
from typing import Final

from turtlelog.display import format_number
from turtlelog.errors import SimulationError
from turtlelog.laws import Decision, Pose

STEP_BUDGET: Final = "step_budget"
"""Stop reason of a run whose law computed for longer than it may."""

_PATIENCE_S: Final = 1.0
"""Wait beyond the budget [s]: for a step that returns within it, the error states its time."""

_AGAIN_S: Final = 0.05
"""Between two attempts to end a step that does not return [s]: a law may catch what ends it."""

_LONGEST_S: Final = 3600.0
"""One wait of a longer budget [s]: a queue refuses waits beyond some years."""

Step = Callable[[int, Pose], Decision]
_Answer = tuple[Decision | None, BaseException | None, float]


class StepBudgetError(SimulationError):
    """A law that computed for longer than it may."""


class _Ended(SystemExit):
    """What ends a step that does not return. Threads end with a SystemExit without a word."""


class StepBudget:
    """A law's `step` that computes in a thread of its own, for a limited time.

    The exception that ends a step is raised in that thread alone, so it hits nothing but the law. A
    step that goes on nevertheless, as it catches everything or waits in C code, does not delay the
    run. Only C code that never releases the interpreter's lock does.
    """

    def __init__(self, step: Step, budget_s: float) -> None:
        """Take a law's `step` and how long it may compute [s]; only the step itself is measured.

        Raises:
            SimulationError: Where that is no time above 0.
        """
        if not 0.0 < budget_s < inf:
            raise SimulationError(f"step_budget_s: expected a time above 0 s, found {budget_s}")
        self._step, self._budget_s = step, budget_s
        self._questions: SimpleQueue[tuple[int, Pose] | None] = SimpleQueue()
        self._answers: SimpleQueue[_Answer] = SimpleQueue()
        self._start_s: list[float] = []
        self._thread: threading.Thread | None = None

    def __call__(self, time_ns: int, pose: Pose) -> Decision:
        """Return the law's decision, or raise what the law raises.

        Raises:
            StepBudgetError: Where it took longer; the text goes on after the number of the sample.
        """
        thread = self._thread or self._begin()
        self._start_s.clear()
        self._questions.put((time_ns, pose))
        try:
            decision, error, took_s = self._wait()
        except BaseException:
            self._questions.put(None)
            threading.Thread(target=_end, args=(thread,), name="step end", daemon=True).start()
            raise
        if took_s > self._budget_s:
            raise StepBudgetError(f"took {self._describe(took_s)}") from error
        if error is not None:
            raise error
        return decision  # type: ignore[return-value]

    def _begin(self) -> threading.Thread:
        # With the context of the caller: numpy's handling of errors and the like are as there.
        run_step = contextvars.copy_context().run
        channels = self._questions, self._answers, self._start_s
        arguments = (run_step, self._step, *channels)
        self._thread = threading.Thread(target=_work, args=arguments, name="step", daemon=True)
        self._thread.start()
        weakref.finalize(self, self._questions.put, None)
        return self._thread

    def _wait(self) -> _Answer:
        """Return the answer; of a step that is late, wait a while longer to know its time."""
        took_s, most_s = 0.0, self._budget_s + _PATIENCE_S
        while took_s < most_s:
            try:
                return self._answers.get(timeout=min(most_s - took_s, _LONGEST_S))
            except Empty:
                began_s = self._start_s[0] if self._start_s else time.perf_counter()
                took_s = time.perf_counter() - began_s
        raise StepBudgetError(f"took more than {self._describe(most_s)}")

    def _describe(self, took_s: float) -> str:
        took, budget = format_number(took_s * 1e3), format_number(self._budget_s * 1e3)
        return f"{took} ms of a budget of {budget} ms"


def _work(
    run_step: Callable[[Step, int, Pose], Decision],
    step: Step,
    questions: SimpleQueue[tuple[int, Pose] | None],
    answers: SimpleQueue[_Answer],
    start_s: list[float],
) -> None:
    """Answer one question after the other, with the time that each took [s]."""
    with suppress(_Ended):  # it may come when the step has just returned
        while (question := questions.get()) is not None:
            decision, error = None, None
            began_s = time.perf_counter()
            start_s.append(began_s)
            try:
                decision = run_step(step, *question)
            except BaseException as err:
                error = err
            answers.put((decision, error, time.perf_counter() - began_s))


def _end(thread: threading.Thread) -> None:
    """Raise an exception in a thread until it ends: code that catches all may catch some."""
    import ctypes  # Only steps that do not return pay for it.

    ended = ctypes.py_object(_Ended)
    while thread.is_alive():
        ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread.ident or 0), ended)
        thread.join(_AGAIN_S)
