"""What Ctrl-C and a request to end may interrupt, and what not."""

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType
from typing import Final

_STOPS: Final = (signal.SIGINT, signal.SIGTERM)

Handler = Callable[[int, FrameType | None], object]


@dataclass(slots=True)
class StopRequest:
    """Whether somebody has asked the program to end.

    Attributes:
        signal_number: By which signal; None while nobody has.
    """

    signal_number: int | None = None


@contextmanager
def catch_stop() -> Iterator[StopRequest]:
    """Note SIGINT and SIGTERM instead of ending at once; a second one ends as before.

    The block asks the value it is given when it suits it. Outside the main thread, where Python
    delivers no signals, nothing is changed, and nothing noted.
    """
    request = StopRequest()

    def note(number: int, _frame: FrameType | None) -> None:
        if request.signal_number is not None:
            raise KeyboardInterrupt
        request.signal_number = number

    with _handle(note):
        yield request


@contextmanager
def hold_stop() -> Iterator[None]:
    """Let a block end before SIGINT and SIGTERM have the effect that they had outside it."""
    held: list[int] = []
    try:
        with _handle(lambda number, _frame: held.append(number)):
            yield
    finally:
        for number in dict.fromkeys(held):
            signal.raise_signal(number)


@contextmanager
def exit_on_terminate() -> Iterator[None]:
    """Make SIGTERM end the block as an exception does, so that files are finished on the way out.

    Ctrl-C does so anyway. On Windows only a console sends SIGTERM; ending a task kills it.
    """

    def leave(number: int, _frame: FrameType | None) -> None:
        sys.exit(128 + number)

    with _handle(leave, (signal.SIGTERM,)):
        yield


@contextmanager
def _handle(handler: Handler, numbers: tuple[signal.Signals, ...] = _STOPS) -> Iterator[None]:
    """Set a handler for a while; in the main thread only, since Python allows no other."""
    before = {}
    try:
        if threading.current_thread() is threading.main_thread():
            for number in numbers:
                before[number] = signal.getsignal(number)
                if before[number] is not None:  # None: set by somebody outside Python
                    signal.signal(number, handler)
        yield
    finally:
        for number, previous in before.items():
            if previous is not None:
                signal.signal(number, previous)
