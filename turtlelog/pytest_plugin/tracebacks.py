"""Tracebacks that end in the user's test: what turtlelog refuses is said by its one line."""

from pathlib import Path
from types import TracebackType

from turtlelog.errors import LawError, SimulationError, TurtlelogError

_PACKAGE = Path(__file__).parents[1]


def end_at_test(error: BaseException) -> None:
    """Cut the traceback of an error that turtlelog raised on purpose where turtlelog begins.

    pytest reads tracebacks anew, so this is the one place where frames can be left out.
    """
    if not isinstance(error, TurtlelogError):
        return
    last, frame = None, error.__traceback__
    while frame is not None and not _is_own(frame):
        last, frame = frame, frame.tb_next
    if last is not None:
        last.tb_next = None
    if not isinstance(error, LawError | SimulationError):  # these show what a user's law did
        error.__cause__, error.__suppress_context__ = None, True


def _is_own(frame: TracebackType) -> bool:
    return Path(frame.tb_frame.f_code.co_filename).is_relative_to(_PACKAGE)
