"""Complete laws of few lines: a function, or a class without parameters or `reset`."""

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

from turtlelog.laws.base import Goal, Law, Pose
from turtlelog.run.paths import Path


@dataclass(frozen=True)
class NoParameters:
    """A law without parameters."""


Answer = Callable[[int, Pose, Goal | None], Any]
"""A law as a function of the clock [ns], a pose and the goal: it returns speed [m/s] and turn rate
[rad/s], or a Decision."""


@cache
def complete_law(found: Any) -> type[Law]:
    """Return a law with what it leaves out: parameters, `__init__`, `reset`.

    Args:
        found: A function of `(time_ns, pose, goal)`, or a class with `step`.
    """
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
    """Let errors call a completed law as its file does."""
    made.__name__, made.__qualname__ = found.__name__, found.__qualname__
    made.__module__ = found.__module__
