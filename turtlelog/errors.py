"""One root of all errors, and one child per stage.

A message is one line: the place as the user typed it, what is wrong, and what to type.
"""

import re
from collections.abc import Iterable, Sequence
from types import MappingProxyType
from typing import Any, Final

from turtlelog.escapes import cut_text, escape_controls, hide_secrets

_LONGEST: Final = 4000
"""Largest number of characters in a message: a name in a message may have megabytes."""

_QUOTED: Final = 60
"""Largest number of characters of a name that a message repeats."""

_TIE: Final = 0.15
"""Largest difference in similarity to the nearest name with which another name is also suggested
[1]."""

_LISTED: Final = 14
"""Largest number of names in a message; more are replaced by `...`."""


class TurtlelogError(Exception):
    """Root of every error that turtlelog raises deliberately."""

    def __str__(self) -> str:
        """Return the message in one line."""
        return format_line(super().__str__())


def format_line(text: str) -> str:
    """Return text in one line for a terminal; no name can break, control or flood the line.

    URLs do not show their secrets.
    """
    shown = hide_secrets(cut_text(text, 2 * _LONGEST))
    if len(text) > _LONGEST:
        shown = f"{shown[:_LONGEST]}... ({len(text) - _LONGEST:,} letters more)"
    return escape_controls(shown)


def describe_error(err: BaseException) -> str:
    """Return an error of another library in one line, with its kind."""
    try:
        text = " ".join(str(err).split())
    except Exception:  # what an error says is its own code
        text = ""
    return f"{type(err).__name__}: {text}".removesuffix(": ")


def release_frames(err: TurtlelogError) -> TurtlelogError:
    """Return an error that is kept for later, without the columns that its traceback holds."""
    err.__cause__ = err.__context__ = None
    return err.with_traceback(None)


def make_portable(err: Exception) -> Exception:
    """Return an error that another process can raise: the error itself, or its line.

    If the constructor of an error takes other arguments than the error keeps, the error can be
    pickled but not unpickled.
    """
    import pickle

    try:
        pickle.loads(pickle.dumps(err))
    except Exception:
        return RuntimeError(describe_error(err))
    return err


_SYNONYMS: Final = MappingProxyType(
    {
        "analyse": "explain", "analyze": "explain", "why": "explain", "diff": "compare",
        "draw": "plot", "figure": "plot", "graph": "plot", "map": "plot", "export": "convert",
        "import": "convert", "recover": "convert", "repair": "convert", "measure": "metrics",
        "stats": "metrics", "open": "view", "rerun": "view", "show": "view", "optimise": "tune",
        "optimize": "tune", "simulate": "run", "start": "run", "test": "check", "verify": "check",
        "validate": "check", "describe": "info", "inspect": "info", "vary": "sweep",
        "velocity": "speed", "vel": "speed", "v": "speed", "omega": "turn_rate", "w": "turn_rate",
        "yaw_rate": "turn_rate", "angular_velocity": "turn_rate", "linear_velocity": "speed",
        "theta": "heading", "yaw": "heading", "orientation": "heading", "angle": "heading",
        "cte": "cross_track", "lateral_error": "cross_track", "deadtime": "dead_time",
        "latency": "delay", "delay_s": "transport_delay_s", "trajectory": "plane",
        "mechanisms": "causes", "mechanism": "causes", "effects": "causes", "keys": "laws",
    }
)  # fmt: skip
"""Other words for commands, signals, keys and figures."""


def find_near(name: str, known: Iterable[str], *, most: int = 3) -> list[str]:
    """Return the known names nearest to an unknown name: by letters, by meaning, by a part."""
    import difflib  # Only mistakes pay for it.

    listed = list(known)
    place, dot, last = name.rpartition(".")
    meant = f"{place}{dot}{_SYNONYMS.get(last, last)}"
    if meant in listed:
        return [meant]
    if not dot and (named := [one for one in listed if one.endswith(f".{meant}")]):
        return named[:most]
    for word in dict.fromkeys([name, meant]):
        if near := difflib.get_close_matches(word, listed, n=most):
            ratios = [difflib.SequenceMatcher(a=word, b=one).ratio() for one in near]
            return [
                one for one, ratio in zip(near, ratios, strict=True) if ratio > ratios[0] - _TIE
            ]
    if not last:
        return []
    ends: dict[str, str] = {}
    for one in listed:
        ends.setdefault(one.rpartition(".")[2], one)
    near = [ends[end] for end in difflib.get_close_matches(last, ends, n=most)]
    return near or [one for one in listed if last in re.split(r"[._-]", one)][:most]


def describe_unknown(kind: str, name: str, known: Iterable[str], *, place: str = "") -> str:
    """Return an error line for an unknown name, with the nearest known names or with all.

    Args:
        kind: Kind of thing that the name should denote: `metric`, `preset or file`.
        name: Name as given.
        known: All known names.
        place: Command that lists the known names.
    """
    listed, name = list(known), str(name)
    near = find_near(name, listed)
    help_ = f" did you mean {join_names(near)}?" if near else f" there are {join_names(listed)}"
    text = f"no {kind} {quote_name(name)};{help_ if near or not place else ''}".removesuffix(";")
    if not place:
        return text
    return f"{text} List: {place}" if near else f"{text}; list: {place}"


def quote_name(name: str) -> str:
    """Return a name in quotes; a long name is cut."""
    return f'"{name if len(name) <= _QUOTED else f"{name[:_QUOTED]}..."}"'


def join_names(names: Sequence[str]) -> str:
    """Return names as a list with `or` before the last name. A long list shows only the first."""
    if len(names) > _LISTED:
        return f"{', '.join(names[:_LISTED])}, ..."
    *others, last = names or ["none"]
    return f"{', '.join(others)} or {last}" if others else last


def suggest_names(name: str, known: Iterable[str]) -> str:
    """Return the known names nearest to an unknown name, or the first known names."""
    listed = list(known)
    return join_names(find_near(name, listed) or listed)


class ExpressionError(TurtlelogError):
    """An expression that does not parse, or contains an unknown name.

    Attributes:
        column: Column in the text of the expression, from 1; None if the error has no place.
    """

    def __init__(self, message: str, *, column: int | None = None) -> None:
        super().__init__(message)
        self.column = column


class LibraryError(TurtlelogError):
    """A library is needed that is not installed, for example in a slim installation."""


class LibraryImportError(LibraryError, ImportError):
    """A library that cannot be imported, or a name that needs such a library."""


class LibraryAttributeError(LibraryError, AttributeError):
    """A public name that needs a library which is not installed."""


class ProcessError(TurtlelogError):
    """A process that ends before its work is done."""


class RemoteError(TurtlelogError):
    """A URL whose file is missing, not available, or cut off during the transfer."""


class FrameError(TurtlelogError):
    """Arrays that are not vectors."""


class PathError(TurtlelogError, ValueError):
    """Points and sizes that do not form a path. The line begins with the key."""


class RunError(TurtlelogError):
    """Columns that do not form a run."""


class LawError(TurtlelogError):
    """A control law that cannot be found, loaded or trusted."""


class ParameterError(LawError, ValueError):
    """A parameter of a law that contradicts other parameters. The line begins with the key."""


class ScenarioError(TurtlelogError):
    """A scenario with a wrong key or value.

    Attributes:
        unknown_key: Dotted key that its table does not have; empty for any other error.
        advice: The nearest known keys, or all, as text; empty for any other error.
    """

    def __init__(self, *message: object, unknown_key: str = "", advice: str = "") -> None:
        super().__init__(*message)
        self.unknown_key, self.advice = unknown_key, advice


class SimulationError(TurtlelogError):
    """A simulation that cannot continue.

    Attributes:
        run: The `Run` up to the error; None if the run had no sample.
    """

    run: Any = None


class TheoryError(TurtlelogError):
    """A question that the theory of the ideal loop cannot answer.

    Attributes:
        quantity: Name of the quantity that is out of its range; None if the error has no quantity.
        problem: What is wrong with the quantity; without a quantity, the message.
        value: The refused value of the quantity; None if a computed number was refused.
        must: What that value must be, as in `greater than 0`; empty without such a value.
    """

    def __init__(
        self, problem: str, *, quantity: str | None = None, value: Any = None, must: str = ""
    ) -> None:
        super().__init__(problem if quantity is None else f"{quantity}: {problem}")
        self.quantity = quantity
        self.problem = problem
        self.value = value
        self.must = must


class LogError(TurtlelogError):
    """A file that cannot be read, written or imported."""


class ReplayError(TurtlelogError):
    """A run that cannot be driven again."""


class MeasureError(TurtlelogError):
    """An unknown metric or signal."""


class IdentifyError(TurtlelogError):
    """Runs from which no robot can be identified."""


class CompareError(TurtlelogError):
    """Runs that cannot be compared."""


class ExplainError(TurtlelogError):
    """A run from which nothing can be identified."""


class SweepError(TurtlelogError):
    """A sweep that cannot be planned or continued."""


class TuneError(TurtlelogError):
    """An invalid tuning request, or a search in which no candidate has a value."""


class ShowError(TurtlelogError):
    """A picture, table or viewer that cannot be created."""


class CheckError(TurtlelogError):
    """A specification or formula that cannot be checked."""


class PartialLogError(CheckError, AssertionError):
    """An incomplete recording that the caller did not allow."""


class UndecidedError(CheckError, AssertionError):
    """A truth value was requested that is unknown: neither the formula nor its negation passes."""


class MissingValueError(UndecidedError):
    """A metric that has no value was used as a number."""


class UsageError(TurtlelogError):
    """Options of a command that exclude each other, or an argument that is not a path."""
