"""What figures need of runs, and what runs lack of it, in words."""

from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from types import MappingProxyType
from typing import Final

from turtlelog.charts.shared_curves import Command, read_applied, read_command, read_curve
from turtlelog.charts.tracked_path import read_along_error
from turtlelog.draw.figures.figure_curves import find_gains
from turtlelog.draw.figures.rates_figure import lacks_commands
from turtlelog.draw.figures.sampled_loops import find_lack_of_theory
from turtlelog.plants import LAGGED, find_plant
from turtlelog.run import Run

SAMPLES: Final = "the controller's samples"
GOAL: Final = "a goal"
PYTHON_CONTROL: Final = "python-control"
_STATES: Final = "states of its law that are not always 0"


def _lack_command(run: Run, command: Command, *, is_alone: bool) -> str:
    """Say whether there is something to draw: among several runs no applied rates are."""
    found = read_command(run, command) or read_curve(run, f"measured_{command}")
    found = found or (read_applied(run, command) if is_alone else None)
    return "" if found else f"{command.replace('_', ' ')} commands"


def _lack(words: str, *, is_held: bool) -> str:
    return "" if is_held else words


def _lack_samples(run: Run, words: str, *, is_held: bool) -> str:
    """Say what is missing of what rests on samples, without which there is nothing."""
    return _lack(words, is_held=is_held) if len(run.samples) else SAMPLES


def has_states(run: Run) -> bool:
    """Whether it holds states of its law that are not always 0."""
    return run.samples.states is not None and bool(run.samples.states.any())


def _has_gain(run: Run) -> bool:
    gains = [loop.read_gain(run.parameters) for loop in run.declaration.loops]
    return any(gain is not None and gain > 0.0 for gain in gains)


def find_lack_of_gain(runs: Sequence[Run]) -> str:
    """Say what theory lacks: python-control, which computes it, or a gain."""
    if find_spec("control") is None:
        return PYTHON_CONTROL
    if find_gains(runs):
        return ""
    loops = [loop for run in runs for loop in run.declaration.loops]
    has_others = any(loop.gain and not loop.is_proportional for loop in loops)
    return _PROPORTIONAL if has_others else "the law's gain"


def _find_lack_of_locus(run: Run) -> str:
    """Say what a root locus lacks: of the ideal loop or of a sampled one, each is enough.

    Of a loop that is not proportional it is why theory does not know it.
    """
    lack = find_lack_of_gain([run])
    if lack == PYTHON_CONTROL:
        return lack
    unknown = find_lack_of_theory([run])
    return unknown if lack == _PROPORTIONAL or not unknown else lack


_PROPORTIONAL: Final = "a proportional loop"

OF_THEORY: Final = ("gain", "integrator", "locus")
"""Needs that are met without a run."""

_LACKS: Final[Mapping[str, Callable[[Run, bool], str]]] = MappingProxyType(
    {
        "theory": lambda run, _: find_lack_of_theory([run]),
        "gain": lambda run, _: find_lack_of_gain([run]),
        "locus": lambda run, _: _find_lack_of_locus(run),
        "integrator": lambda run, _: (
            find_lack_of_gain([run])
            or _lack("a plant that is 1/s", is_held=find_plant(run).name != LAGGED)
        ),
        "known_gain": lambda run, _: _lack("the law's gain", is_held=_has_gain(run)),
        "commands": lambda run, _: _lack("commands", is_held=not lacks_commands(run)),
        "samples": lambda run, _: _lack(SAMPLES, is_held=len(run.samples) > 0),
        "poses": lambda run, _: _lack("poses", is_held=len(run.poses) > 0),
        "goal": lambda run, _: _lack(GOAL, is_held=run.goal_xy_m is not None),
        "heading_error": lambda run, _: _lack_samples(
            run, "a heading to aim at", is_held=read_curve(run, "heading_error") is not None
        ),
        "track": lambda run, _: _lack_samples(
            run, GOAL, is_held=run.goal_line is not None or run.path is not None
        ),
        "along_error": lambda run, _: (
            _lack("a path that its law tracks", is_held=run.path is not None)
            or _lack("a path with a speed", is_held=read_along_error(run) is not None)
        ),
        "path": lambda run, _: _lack("a path that its law tracks", is_held=run.path is not None),
        "states": lambda run, _: _lack(_STATES, is_held=has_states(run)),
        "world_velocity": lambda run, _: _lack_samples(
            run, "gain times error", is_held=read_curve(run, "world_velocity_x") is not None
        ),
        "speed": lambda run, a: _lack_command(run, "speed", is_alone=a),
        "turn_rate": lambda run, a: _lack_command(run, "turn_rate", is_alone=a),
        "wanted": lambda run, _: _lack(
            "what the law wanted before clipping",
            is_held=len(run.samples) > 0 and run.samples.wanted_speed_m_s is not None,
        ),
    }
)
"""What a panel may need: from a run, which may be alone, to what it lacks, empty where nothing."""


def find_lacks(runs: Sequence[Run], need: str) -> tuple[str, ...]:
    """Return what each run lacks of what a figure needs, empty where nothing."""
    return tuple(_LACKS[need](run, len(runs) == 1) for run in runs)
