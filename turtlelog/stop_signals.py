"""Signals that ask a process to stop: recorded, delayed, or turned into an exception."""

import signal
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from types import FrameType
from typing import Any, Final

from turtlelog.processes import find_signals

_KEYBOARD: Final = find_signals("SIGINT", "SIGQUIT")
_REQUESTS: Final = find_signals("SIGTERM", "SIGHUP")
_STOPS: Final = (*_KEYBOARD, *_REQUESTS)


@contextmanager
def catch_stop() -> Iterator[list[int]]:
    """Record SIGINT, SIGTERM, SIGHUP and SIGQUIT instead of ending; a second signal interrupts.

    The block checks the yielded list of signals at suitable times. If SIGTERM or SIGHUP was ignored
    before, as under `nohup`, it stays ignored. SIGINT and SIGQUIT are handled in any case, because
    a shell ignores them for every background job of a script. Outside the main thread, where Python
    delivers no signals, nothing changes.
    """
    caught: list[int] = []

    def note(number: int, _frame: FrameType | None) -> None:
        if caught:
            raise KeyboardInterrupt
        caught.append(number)

    ignored = [number for number in _REQUESTS if signal.getsignal(number) == signal.SIG_IGN]
    with _handle_signals(note, [number for number in _STOPS if number not in ignored]):
        yield caught


@contextmanager
def hold_stop() -> Iterator[None]:
    """Delay the signals of `catch_stop` until the block ends."""
    held: list[int] = []
    try:
        with _handle_signals(lambda number, _frame: held.append(number), _STOPS):
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
    signals = _find_defaults((*_REQUESTS, *_KEYBOARD))
    with _handle_signals(lambda number, _frame: sys.exit(128 + number), signals):
        yield


@contextmanager
def interrupt_on_quit() -> Iterator[None]:
    """Make SIGQUIT act like Ctrl-C if the default action of SIGQUIT is set."""
    with _handle_signals(signal.default_int_handler, _find_defaults(find_signals("SIGQUIT"))):
        yield


def _find_defaults(numbers: Iterable[signal.Signals]) -> list[signal.Signals]:
    return [number for number in numbers if signal.getsignal(number) == signal.SIG_DFL]


@contextmanager
def _handle_signals(
    handler: Callable[[int, FrameType | None], object], numbers: Iterable[signal.Signals]
) -> Iterator[None]:
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
            _restore_handlers(before)
        except BaseException:  # restored handlers may raise an error before the others are restored
            _restore_handlers(before)
            raise


def _restore_handlers(before: Mapping[signal.Signals, Any]) -> None:
    for number, previous in before.items():
        if previous is not None:
            signal.signal(number, previous)
