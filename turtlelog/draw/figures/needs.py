"""Data that figures need from runs, and descriptions of missing data."""

from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from types import MappingProxyType
from typing import Final

from turtlelog.charts.curves import Command, read_curve
from turtlelog.charts.plotted_curves import has_own
from turtlelog.charts.time_plots import TIME_PLOTS
from turtlelog.charts.tracked_path import read_along_error
from turtlelog.draw.figures.figure_curves import find_gains
from turtlelog.draw.figures.rates_figure import lacks_commands
from turtlelog.draw.figures.sampled_loops import find_lack_of_theory
from turtlelog.plants import LAGGED, find_plant
from turtlelog.run import Run

SAMPLES: Final = "the controller's samples"
POSES: Final = "poses"
GOAL: Final = "a goal"
PYTHON_CONTROL: Final = "python-control"
_STATES: Final = "states of its law that are not always 0"


def _lack_command(run: Run, command: Command) -> str:
    """Return why an axis cannot be drawn: there is no command, or no motion for it."""
    found = has_own(run, TIME_PLOTS[command])
    return "" if found else f"{command.replace('_', ' ')} commands"


def _lack_wanted(run: Run, command: Command) -> str:
    is_held = len(run.samples) > 0 and read_curve(run, f"wanted_{command}") is not None
    return _lack("what the law wanted before clipping", is_held=is_held)


def _lack(words: str, *, is_held: bool) -> str:
    return "" if is_held else words


def _lack_samples(run: Run, words: str, *, is_held: bool) -> str:
    """Return the missing data for figures that need samples."""
    return _lack(words, is_held=is_held) if len(run.samples) else SAMPLES


def has_states(run: Run) -> bool:
    """Return whether a run has states of its law that are not always 0."""
    return run.samples.states is not None and bool(run.samples.states.any())


def _has_gain(run: Run) -> bool:
    gains = [loop.read_gain(run.parameters) for loop in run.declaration.loops]
    return any(gain is not None and gain > 0.0 for gain in gains)


def find_lack_of_gain(runs: Sequence[Run]) -> str:
    """Return what theory's figures lack: python-control, or a gain."""
    if find_spec("control") is None:
        return PYTHON_CONTROL
    if find_gains(runs):
        return ""
    loops = [loop for run in runs for loop in run.declaration.loops]
    has_others = any(loop.gain and not loop.is_proportional for loop in loops)
    return _PROPORTIONAL if has_others else "the law's gain"


def _find_lack_of_locus(run: Run) -> str:
    """Return the data that a root locus lacks. An ideal or a sampled loop is sufficient.

    For a loop that is not proportional, the result is the reason why theory has no model.
    """
    lack = find_lack_of_gain([run])
    if lack == PYTHON_CONTROL:
        return lack
    unknown = find_lack_of_theory([run])
    return unknown if lack == _PROPORTIONAL or not unknown else lack


_PROPORTIONAL: Final = "a proportional loop"

OF_THEORY: Final = ("gain", "integrator", "locus")
"""Data that theory provides without a run."""

_LACKS: Final[Mapping[str, Callable[[Run], str]]] = MappingProxyType(
    {
        "theory": lambda run: find_lack_of_theory([run]),
        "gain": lambda run: find_lack_of_gain([run]),
        "locus": lambda run: _find_lack_of_locus(run),
        "integrator": lambda run: (
            find_lack_of_gain([run])
            or _lack("a plant that is 1/s", is_held=find_plant(run).name != LAGGED)
        ),
        "known_gain": lambda run: _lack("the law's gain", is_held=_has_gain(run)),
        "commands": lambda run: (
            _lack(POSES, is_held=len(run.poses) > 0)
            or _lack("commands", is_held=not lacks_commands(run))
        ),
        "samples": lambda run: _lack(SAMPLES, is_held=len(run.samples) > 0),
        "poses": lambda run: _lack(POSES, is_held=len(run.poses) > 0),
        "goal": lambda run: (
            _lack(POSES, is_held=len(run.poses) > 0)
            or _lack(GOAL, is_held=run.goal_xy_m is not None)
        ),
        "heading_error": lambda run: _lack_samples(
            run, "a heading to aim at", is_held=read_curve(run, "heading_error") is not None
        ),
        "track": lambda run: _lack_samples(
            run, GOAL, is_held=run.goal_line is not None or run.path is not None
        ),
        "along_error": lambda run: (
            _lack("a path that its law tracks", is_held=run.path is not None)
            or _lack("a path with a speed", is_held=read_along_error(run) is not None)
        ),
        "path": lambda run: _lack("a path that its law tracks", is_held=run.path is not None),
        "states": lambda run: _lack(_STATES, is_held=has_states(run)),
        "world_velocity": lambda run: _lack_samples(
            run, "gain times error", is_held=read_curve(run, "world_velocity_x") is not None
        ),
        "speed": lambda run: _lack_command(run, "speed"),
        "turn_rate": lambda run: _lack_command(run, "turn_rate"),
        "wanted_speed": lambda run: _lack_wanted(run, "speed"),
        "wanted_turn_rate": lambda run: _lack_wanted(run, "turn_rate"),
    }
)
"""Functions from a run to the data that it lacks, by need; empty if nothing is missing."""


def find_lacks(runs: Sequence[Run], need: str) -> tuple[str, ...]:
    """Return the data that each run lacks for a figure; empty if nothing is missing."""
    return tuple(_LACKS[need](run) for run in runs)
