"""Handling of Ctrl-C and termination signals."""

import signal
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType
from typing import Any, Final

Handler = Callable[[int, FrameType | None], object]


def _find_signals(*names: str) -> tuple[signal.Signals, ...]:
    """Return the signals with these names that exist, because Windows lacks some."""
    return tuple(getattr(signal, name) for name in names if hasattr(signal, name))


_KEYBOARD: Final = _find_signals("SIGINT", "SIGQUIT")
_REQUESTS: Final = _find_signals("SIGTERM", "SIGHUP")
_STOPS: Final = (*_KEYBOARD, *_REQUESTS)


@dataclass(slots=True)
class StopRequest:
    """A request to end the program.

    Attributes:
        signal_number: Number of the signal; None if no signal has arrived.
    """

    signal_number: int | None = None


@contextmanager
def catch_stop() -> Iterator[StopRequest]:
    """Record SIGINT, SIGTERM, SIGHUP and SIGQUIT instead of ending; a second signal interrupts.

    The block checks the yielded request at suitable times. If SIGTERM or SIGHUP was ignored before,
    as under `nohup`, it stays ignored. SIGINT and SIGQUIT are handled in any case, because a shell
    ignores them for every background job of a script. Outside the main thread, where Python
    delivers no signals, nothing changes.
    """
    request = StopRequest()

    def note(number: int, _frame: FrameType | None) -> None:
        if request.signal_number is not None:
            raise KeyboardInterrupt
        request.signal_number = number

    ignored = [number for number in _REQUESTS if signal.getsignal(number) == signal.SIG_IGN]
    with _handle(note, [number for number in _STOPS if number not in ignored]):
        yield request


@contextmanager
def hold_stop() -> Iterator[None]:
    """Delay the signals of `catch_stop` until the block ends."""
    held: list[int] = []
    try:
        with _handle(lambda number, _frame: held.append(number), _STOPS):
            yield
    finally:
        for number in dict.fromkeys(held):
            signal.raise_signal(number)


@contextmanager
def exit_on_terminate() -> Iterator[None]:
    """Make SIGTERM, SIGHUP and SIGQUIT raise an exception in the block, so that files are finished.

    Ctrl-C raises an exception by default. Existing settings by `nohup` or a handler stay. On
    Windows, only a console sends SIGTERM; ending a task kills the process.
    """

    def leave(number: int, _frame: FrameType | None) -> None:
        sys.exit(128 + number)

    with _handle(leave, _find_defaults((*_REQUESTS, *_KEYBOARD))):
        yield


@contextmanager
def interrupt_on_quit() -> Iterator[None]:
    """Make SIGQUIT act like Ctrl-C if the default action of SIGQUIT is set."""
    with _handle(signal.default_int_handler, _find_defaults(_find_signals("SIGQUIT"))):
        yield


def _find_defaults(numbers: Iterable[signal.Signals]) -> list[signal.Signals]:
    return [number for number in numbers if signal.getsignal(number) == signal.SIG_DFL]


@contextmanager
def _handle(handler: Handler, numbers: Iterable[signal.Signals]) -> Iterator[None]:
    """Set a handler during the block, only in the main thread, because Python allows no other."""
    before = {}
    try:
        if threading.current_thread() is threading.main_thread():
            for number in numbers:
                before[number] = signal.getsignal(number)
                if before[number] is not None:  # None: set outside Python
                    signal.signal(number, handler)
        yield
    finally:
        try:
            _restore(before)
        except BaseException:  # restored handlers may raise an error before the others are restored
            _restore(before)
            raise


def _restore(before: Mapping[signal.Signals, Any]) -> None:
    for number, previous in before.items():
        if previous is not None:
            signal.signal(number, previous)
