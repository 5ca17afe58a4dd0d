"""Names of laws that are objects of this Python session, and the defaults of laws of a few lines.

A scenario contains the name of a law. A law of this session gets the name `session:NAME`, by which
this process and its forks find the law. Other processes get the law with their work
(`WorkWithLaws`). A recording contains the law's source as text, which is never run.
"""

import copy
import inspect
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import cache, partial
from secrets import token_hex
from threading import Lock
from typing import Any, Final, Generic, TypeVar

from turtlelog.errors import LawError, describe_error
from turtlelog.laws.base import Goal, Law, LawPart, Pose, find_part
from turtlelog.laws.loading import LAWS
from turtlelog.libraries import load_library
from turtlelog.run.paths import Path

T = TypeVar("T")
R = TypeVar("R")

_SESSION: Final = "session:"  # beginning of the kind of a law of a session

_GIVEN: Final[dict[str, Any]] = {}
_GIVING: Final = Lock()


def name_given_law(law: Any) -> str:
    """Return the kind of a law: the built-in kind, `module:NAME` if importable, or `session:NAME`.

    Args:
        law: A class, a function of `(time_ns, pose, goal)`, a `LawPart`, or an object with `step`;
            of a part with its parameters, the part.

    Raises:
        LawError: If `law` is none of these.
    """
    law = find_part(law) or law
    if isinstance(law, LawPart) and LAWS.get(law.name) is law:
        return law.name
    is_named = isinstance(law, type | LawPart) or inspect.isfunction(law)
    if not is_named and not callable(getattr(law, "step", None)):
        expected = "a class, a function of (time_ns, pose, goal), or an object with step"
        raise LawError(f"law: expected {expected}, found {law!r:.60}")
    is_part = isinstance(law, LawPart)
    name = law.name if is_part else str(getattr(law, "__name__", type(law).__name__))
    name = name if is_part or name.isidentifier() else "law"  # a lambda
    module = getattr(law.step if is_part else law, "__module__", None)
    loaded = sys.modules.get(module or "")
    is_main = (
        module in {None, "__main__", "__mp_main__"} or getattr(loaded, "__spec__", None) is None
    )
    if is_named and not is_main and getattr(loaded, name, None) is law:  # others can import it
        return f"{module}:{name}"
    with _GIVING:
        known = [kind for kind, one in _GIVEN.items() if one is law]
        if known:
            return known[0]
        number, kind = 1, f"{_SESSION}{name}"
        while kind in _GIVEN:
            number += 1
            kind = f"{_SESSION}{name}-{number}"
        _GIVEN[kind] = law
        return kind


def is_given(kind: object) -> bool:
    """Return whether a kind names a law of a session, which spawned processes do not have."""
    return isinstance(kind, str) and kind.startswith(_SESSION)


def find_given_law(kind: str) -> Any:
    """Return a law of this session; raise a LawError for a law of another session."""
    if kind not in _GIVEN:
        raise LawError(
            f"{kind} is a law of another Python session; write it to a file and name that:"
            " path.py:NAME"
        )
    law = _GIVEN[kind]
    is_named = isinstance(law, type | LawPart) or inspect.isfunction(law)
    return law if is_named else _complete_object(law)


def read_law_source(kind: str) -> str | None:
    """Return the source text of a law of this session; None if unknown or another session's law."""
    law: Any = _GIVEN.get(kind)
    is_named = isinstance(law, type) or inspect.isfunction(law)
    found = law.step if isinstance(law, LawPart) else law if is_named else type(law)
    try:
        return inspect.getsource(found)
    except (OSError, TypeError):  # typed into a console that keeps no text, or unknown
        return None


_OWN: Final = token_hex(8)
"""Name of this session. Forked processes have the laws and the name of the session."""

_LENT: Final[dict[str, tuple[bytes, int]]] = {}
"""Laws of other sessions by kind, in packed form, with the number of tasks that use each."""


class WorkWithLaws(Generic[T, R]):
    """A function for other processes, together with the laws of this session that it needs.

    Attributes:
        work: Function of one item, which can be pickled.
    """

    def __init__(self, work: Callable[[T], R], kinds: Iterable[str]) -> None:
        """Pack the laws.

        Raises:
            LawError: If a law cannot be packed.
            LibraryError: If cloudpickle is not installed.
        """
        self.work, self._session = work, _OWN
        self._packed = {kind: _pack(kind) for kind in kinds if is_given(kind)}

    def __call__(self, item: T) -> R:
        """Return the result of the work for an item.

        Raises:
            LawError: If a law cannot be unpacked, or this process uses another law of the same
                name.
        """
        with ExitStack() as stack:
            if self._session != _OWN:
                for kind, packed in self._packed.items():
                    stack.enter_context(_borrow(kind, packed))
            return self.work(item)


def _pack(kind: str) -> bytes:
    pickler = load_library("cloudpickle")
    try:
        packed: bytes = pickler.dumps(_GIVEN[kind])
    except Exception as err:
        raise LawError(
            f"{kind} cannot be sent to other processes: {describe_error(err)}; write it to a file"
            " and name that: path.py:NAME"
        ) from err
    return packed


@contextmanager
def _borrow(kind: str, packed: bytes) -> Iterator[None]:
    """Let this process find a law of another session during a task."""
    with _GIVING:
        known, users = _LENT.get(kind, (b"", 0))
        if (kind in _GIVEN and kind not in _LENT) or (users and known != packed):
            raise LawError(f"{kind}: this worker uses a law of that name of another session")
        if known != packed:
            _GIVEN[kind] = _unpack(kind, packed)
        _LENT[kind] = packed, users + 1
    try:
        yield
    finally:
        with _GIVING:
            known, users = _LENT[kind]
            _LENT[kind] = known, users - 1


def _unpack(kind: str, packed: bytes) -> Any:
    try:
        return load_library("cloudpickle").loads(packed)
    except Exception as err:
        raise LawError(f"{kind} cannot be loaded in a worker: {describe_error(err)}") from err


@cache
def _complete_object(law: Any) -> type[Any]:
    """Return a class of laws; each instance drives one run with its own copy of the object."""

    class Given:
        Parameters = NoParameters

        def __init__(self, parameters: object) -> None:
            del parameters
            self._law = copy.deepcopy(law)
            if hasattr(law, "take_limits"):
                self.take_limits = self._law.take_limits

        def reset(self, start: Pose, goal: Goal | None, path: Path | None) -> None:
            if hasattr(self._law, "reset"):
                self._law.reset(start, goal, path)

        def step(self, time_ns: int, pose: Pose) -> Any:
            return self._law.step(time_ns, pose)

    for name, member in _list_members(law).items():
        setattr(Given, name, member)
    _take_name(Given, type(law))
    return Given


def _list_members(law: Any) -> dict[str, Any]:
    """Return what an object declares about itself, by name."""

    def ask(name: str, parameters: object, *others: Any) -> Any:
        return getattr(law, name)(getattr(law, "parameters", parameters), *others)

    names = [name for name in ("declare", "list_unused") if hasattr(law, name)]
    members: dict[str, Any] = {name: staticmethod(partial(ask, name)) for name in names}
    if hasattr(law, "causes"):
        members["causes"] = law.causes
    if getattr(law, "counts_samples", None) == ():  # no scenario scales what an object counts
        members["counts_samples"] = ()
    return members


@dataclass(frozen=True)
class NoParameters:
    """A law without parameters."""


Answer = Callable[[int, Pose, Goal | None], Any]
"""A law as a function of the clock [ns], a pose and the goal: it returns speed [m/s] and turn rate
[rad/s], or a Decision."""


@cache
def complete_short_law(found: Any) -> type[Law]:
    """Return a function or a class with `step`, completed by parameters, `__init__`, `reset`."""
    if inspect.isfunction(found):
        return _complete_function(found)
    if all(hasattr(found, name) for name in ("Parameters", "reset")):
        return found  # type: ignore[no-any-return]
    return _complete_class(found)


def _complete_function(function: Answer) -> type[Law]:
    class Function:
        Parameters = NoParameters

        def __init__(self, parameters: object) -> None:
            del parameters

        def reset(self, start: Pose, goal: Goal | None, path: Path | None) -> None:
            del start, path
            self._goal = goal

        def step(self, time_ns: int, pose: Pose) -> Any:
            return function(time_ns, pose, self._goal)

    _take_name(Function, function)
    Function.__doc__ = function.__doc__
    return Function  # type: ignore[return-value]


def _complete_class(law: type[Any]) -> type[Law]:
    takes_parameters = hasattr(law, "Parameters")

    class Completed(law):  # type: ignore[misc]
        Parameters = getattr(law, "Parameters", NoParameters)

        def __init__(self, parameters: object) -> None:
            if takes_parameters:
                super().__init__(parameters)
            else:
                super().__init__()

        def reset(self, start: Pose, goal: Goal | None, path: Path | None) -> None:
            if hasattr(law, "reset"):
                super().reset(start, goal, path)

    _take_name(Completed, law)
    return Completed


def _take_name(made: type[Any], found: Any) -> None:
    """Give a completed law the name of the original, so that errors show this name."""
    made.__name__, made.__qualname__ = found.__name__, found.__qualname__
    made.__module__ = found.__module__
