"""Which states of a law are shown together: by the command that they belong to."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.charts.palette import FEW
from turtlelog.run.loops import COMMAND_WORDS, ControlLoop, Declaration

_MOST_APART: Final = 3
"""More views beside each other would each be narrower than a legend."""

_LARGEST_RATIO: Final = 20.0
"""Curves whose largest magnitudes differ by more share no plot: the smaller would take less than a
twentieth of its height, and read as zero."""

_MOST_TOGETHER: Final = len(FEW)
"""More curves in one plot would share hues."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StateGroup:
    """States that belong together.

    Attributes:
        title: What they are, as `State lyapunov`, `States of the turn rate`.
        names: As the law declares them.
        units: Of each, as the law declares it; empty where it does not.
        command: To which command they belong, None of states that belong to none.
    """

    title: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    command: str | None = None

    @property
    def label(self) -> str:
        """Title and unit, where all have one."""
        return _add_unit(self.title, self.units[0] if len({*self.units}) == 1 else "")

    def label_state(self, name: str) -> str:
        """Return a state with its unit."""
        return _add_unit(name, self.units[self.names.index(name)])

    def can_share(self, names: Sequence[str], columns: Sequence[NDArray[np.float64]]) -> bool:
        """Whether some of them can share a plot, by their units and by their values."""
        units = {self.units[self.names.index(name)] for name in names}
        return len(units) <= 1 and are_comparable(columns)


def group_states(*declarations: Declaration) -> tuple[StateGroup, ...]:
    """Return the states of laws in groups: of the turn rate, of the speed, then all others.

    A state belongs to the loops whose names are among its words (`integral_rotate`), or whose
    gains end in its last word (`integral_angular` beside `law.kp_angular`); where those have one
    command, it is of that command. Others have a view each while there are few views.
    """
    of_command: dict[str, dict[str, None]] = {command: {} for command in COMMAND_WORDS}
    others: dict[str, None] = {}
    for declaration in declarations:
        for name in declaration.states:
            commands = {loop.command for loop in declaration.loops if _belongs(name, loop)}
            of_one = of_command[commands.pop()] if len(commands) == 1 else others
            of_one[name] = None

    def group(title: str, names: Iterable[str], command: str | None = None) -> StateGroup:
        units = tuple(find_state_unit(name, declarations) for name in names)
        return StateGroup(title=title, names=tuple(names), units=units, command=command)

    found = [
        group(f"States of the {COMMAND_WORDS[command]}", names, command)
        for command, names in of_command.items()
        if names
    ]
    if len(found) + len(others) > _MOST_APART and len(others) > 1:
        return (*found, group("States", others))
    return (*found, *(group(f"State {name}", [name]) for name in others))


def find_state_unit(name: str, declarations: Iterable[Declaration]) -> str:
    """Return the unit of a state, empty where no law declares one or two laws differ."""
    units = {one.state_units.get(name, "") for one in declarations if name in one.states}
    return units.pop() if len(units) == 1 else ""


def are_comparable(columns: Sequence[NDArray[np.float64]]) -> bool:
    """Whether curves can share a plot: few, and none would look like zero beside another."""
    if len(columns) > _MOST_TOGETHER:
        return False
    known = [np.abs(values[np.isfinite(values)]).max(initial=0.0) for values in columns]
    largest = [float(value) for value in known if value > 0.0]
    return not largest or max(largest) <= _LARGEST_RATIO * min(largest)


def _add_unit(title: str, unit: str) -> str:
    return f"{title} [{unit}]" if unit else title


def _belongs(state: str, loop: ControlLoop) -> bool:
    words = state.split("_")
    if loop.name.lower() in words:
        return True
    keys = (loop.gain, loop.integral_gain, loop.derivative_gain)
    gains = [key.rpartition(".")[2].split("_") for key in keys if key is not None]
    return any(len(gain) > 1 and gain[-1] == words[-1] for gain in gains)
