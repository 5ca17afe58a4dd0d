"""One error root, one child per stage.

A message is one line: the place, what was expected, what was found.
"""

from collections.abc import Iterable
from typing import Any, Final

from turtlelog.escapes import cut_text, escape_controls, hide_secrets

_LONGEST: Final = 4000
"""Letters of one message: a name in it may have megabytes."""

_LISTED: Final = 14
"""Names in one message; of more, `...` stands for the rest."""


class TurtlelogError(Exception):
    """Root of every error that turtlelog raises on purpose."""

    def __str__(self) -> str:
        """Return the message in one line."""
        return format_line(super().__str__())


def format_line(text: str) -> str:
    """Return text in one line that names cannot break, steer or flood; URLs keep secrets."""
    shown = hide_secrets(cut_text(text, 2 * _LONGEST))
    if len(text) > _LONGEST:
        shown = f"{shown[:_LONGEST]}... ({len(text) - _LONGEST:,} letters more)"
    return escape_controls(shown)


def describe_error(err: BaseException) -> str:
    """Return an error of somebody else's in one line, with its kind."""
    try:
        text = " ".join(str(err).split())
    except Exception:  # what an error says is its own code
        text = ""
    return f"{type(err).__name__}: {text}".removesuffix(": ")


def make_portable(err: Exception) -> Exception:
    """Return an error that another process can raise: itself, or its line where it does not fit.

    An error whose constructor takes other arguments than it keeps can be packed, not unpacked.
    """
    import pickle

    try:
        pickle.loads(pickle.dumps(err))
    except Exception:
        return RuntimeError(describe_error(err))
    return err


def suggest_names(name: str, known: Iterable[str], *, most: int = 3) -> str:
    """Suggest known names for an unknown one: the nearest, else the first."""
    import difflib  # Only mistakes pay for it.

    listed = list(known)
    near = difflib.get_close_matches(name, listed, n=most)
    found = (
        near or [word for word in listed if name and word.startswith(name)] or listed or ["none"]
    )
    if len(found) > _LISTED:
        return f"{', '.join(found[:_LISTED])}, ..."
    *others, last = found
    return f"{', '.join(others)} or {last}" if others else last


class ExpressionError(TurtlelogError):
    """An expression that does not parse, or names what is not there.

    Attributes:
        column: Where in its text, counted from 1; None where no place is to blame.
    """

    def __init__(self, message: str, *, column: int | None = None) -> None:
        super().__init__(message)
        self.column = column


class LibraryError(TurtlelogError):
    """Something needs a library that is not installed, as a slim installation lacks some."""


class LibraryImportError(LibraryError, ImportError):
    """A library, or what needs it, that was to be imported."""


class LibraryAttributeError(LibraryError, AttributeError):
    """A public name that needs such a library."""


class ProcessError(TurtlelogError):
    """A process that ends before its work does."""


class RemoteError(TurtlelogError):
    """A URL whose file is not there, not to be had, or broken off on the way."""


class FrameError(TurtlelogError):
    """Arrays that are no vectors."""


class PathError(TurtlelogError, ValueError):
    """Points and sizes that make no path; the line begins with the key."""


class RunError(TurtlelogError):
    """Columns that do not make a run."""


class LawError(TurtlelogError):
    """A control law that cannot be found, loaded or trusted."""


class ParameterError(LawError, ValueError):
    """A parameter of a law that does not go with the others; the line begins with its key."""


class ScenarioError(TurtlelogError):
    """A scenario with a wrong key or value."""


class SimulationError(TurtlelogError):
    """A simulation that cannot go on.

    Attributes:
        run: The `Run` up to there, None where it had no sample.
    """

    run: Any = None


class TheoryError(TurtlelogError):
    """A question that the ideal loop has no answer to."""


class LogError(TurtlelogError):
    """A file that cannot be read, written or imported."""


class ReplayError(TurtlelogError):
    """A run that cannot be driven again."""


class MeasureError(TurtlelogError):
    """A metric or signal that is not known."""


class IdentifyError(TurtlelogError):
    """Runs of which no robot can be identified."""


class CompareError(TurtlelogError):
    """Runs that cannot be compared."""


class ExplainError(TurtlelogError):
    """A run from which nothing can be identified."""


class SweepError(TurtlelogError):
    """A sweep that cannot be planned, or not go on."""


class TuneError(TurtlelogError):
    """A scenario that cannot be tuned as was asked."""


class ShowError(TurtlelogError):
    """A picture, table or viewer that cannot be made."""


class CheckError(TurtlelogError):
    """A specification or formula that cannot be checked."""


class UsageError(TurtlelogError):
    """Options of a command that do not go together."""
