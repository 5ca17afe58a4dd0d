"""The data that figures need from runs, by name, and what a run lacks."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from types import MappingProxyType
from typing import Final, get_args

from turtlelog import theory
from turtlelog.charts import curves
from turtlelog.charts.plotted_curves import has_own
from turtlelog.charts.time_plots import TIME_PLOTS
from turtlelog.draw.figures.robot_figures import lacks_commands
from turtlelog.draw.figures.theory_figures import find_gains
from turtlelog.measure import model_run_loops
from turtlelog.plants import find_plant
from turtlelog.run import Run


@dataclass(frozen=True, slots=True, kw_only=True)
class Lack:
    """Data that a figure needs and a run lacks."""

    words: str  # the data, for a sentence that ends with `needs ...`
    is_of_motion: bool = False  # whether a recording without samples may contain the data


FindLack = Callable[[Run], Lack | None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Need:
    """Data that a figure or a panel needs from a run."""

    find_lack: FindLack  # returns what a run lacks; None if nothing is missing
    is_of_theory: bool = False  # whether theory provides the data without a run

    def find_lacks(self, runs: Sequence[Run]) -> tuple[Lack | None, ...]:
        """Return what each run lacks; None if nothing is missing."""
        return tuple(map(self.find_lack, runs))


RECORDING: Final = Lack(words="a recording")
SAMPLES: Final = Lack(words="the controller's samples")
POSES: Final = Lack(words="poses", is_of_motion=True)
GOAL: Final = Lack(words="a goal", is_of_motion=True)
GAIN: Final = Lack(words="the law's gain")
_PYTHON_CONTROL: Final = Lack(words="python-control")
_PROPORTIONAL: Final = Lack(words="a proportional loop")

LOOP_LACKS: Final[Mapping[str, Lack]] = MappingProxyType(
    {
        "heading": Lack(words="a loop of the heading"),
        "along_track": Lack(words="a loop along the track"),
        "distance": Lack(words="a loop of the distance"),
    }
)
"""What runs lack without a loop that controls a signal."""


def has_states(run: Run) -> bool:
    """Return whether a run has states of its law that are not always 0."""
    return run.samples.states is not None and bool(run.samples.states.any())


def find_lack_of_library() -> Lack | None:
    """Return python-control, which the figures of theory need, if it is not installed."""
    return _PYTHON_CONTROL if find_spec("control") is None else None


def _find_lack_of_gain(run: Run) -> Lack | None:
    """Return what theory's figures lack: python-control, or a gain."""
    if lack := find_lack_of_library():
        return lack
    if find_gains([run]):
        return None
    loops = run.declaration.loops
    has_others = any(loop.gain and not loop.is_proportional for loop in loops)
    return _PROPORTIONAL if has_others else GAIN


def _find_lack_of_theory(run: Run) -> Lack | None:
    """Return why theory has no loop of a run; None if it has one."""
    models = model_run_loops(run)
    if not models:
        return Lack(words="a law that declares a loop")
    if theory.list_known(models):
        return None
    return Lack(words=f"a loop that theory knows ({models[0].reason})")


def _find_lack_of_locus(run: Run) -> Lack | None:
    """Return what a root locus lacks of an ideal or a sampled loop, or why theory has no model."""
    lack = _find_lack_of_gain(run)
    is_integrator = find_plant(run).dynamics == "integrator"
    if lack == _PYTHON_CONTROL or (lack is None and is_integrator):
        return lack
    unknown = _find_lack_of_theory(run)
    return unknown if lack in (None, _PROPORTIONAL) or unknown is None else lack


def _is_gain_known(run: Run) -> bool:
    return any((loop.read_gain(run.parameters) or 0.0) > 0.0 for loop in run.declaration.loops)


def _require(lack: Lack, has: Callable[[Run], bool], *, first: FindLack | None = None) -> FindLack:
    """Return a function that finds a lack unless a run has the data; `first` finds another one."""
    return lambda run: (first and first(run)) or (None if has(run) else lack)


def _require_curve(lack: Lack, signal: str, *, first: FindLack | None = None) -> FindLack:
    return _require(
        lack,
        lambda run: len(run.samples) > 0 and curves.read_curve(run, signal) is not None,
        first=first,
    )


_LACK_POSES: Final = _require(POSES, lambda run: len(run.poses) > 0)
_LACK_SAMPLES: Final = _require(SAMPLES, lambda run: len(run.samples) > 0)
_LACK_PATH: Final = _require(
    Lack(words="a path that its law tracks"), lambda run: run.path is not None
)
_UNWANTED: Final = Lack(words="what the law wanted before clipping")

NEEDS: Final[Mapping[str, Need]] = MappingProxyType(
    {
        "theory": Need(find_lack=_find_lack_of_theory),
        "gain": Need(find_lack=_find_lack_of_gain, is_of_theory=True),
        "locus": Need(find_lack=_find_lack_of_locus, is_of_theory=True),
        "integrator": Need(
            find_lack=_require(
                Lack(words="a plant that is 1/s"),
                lambda run: find_plant(run).dynamics == "integrator",
                first=_find_lack_of_gain,
            ),
            is_of_theory=True,
        ),
        "known_gain": Need(find_lack=_require(GAIN, _is_gain_known)),
        "commands": Need(
            find_lack=_require(
                Lack(words="commands"), lambda run: not lacks_commands(run), first=_LACK_POSES
            )
        ),
        "samples": Need(find_lack=_LACK_SAMPLES),
        "poses": Need(find_lack=_LACK_POSES),
        "goal": Need(
            find_lack=_require(GOAL, lambda run: run.goal_xy_m is not None, first=_LACK_POSES)
        ),
        "heading_error": Need(
            find_lack=_require_curve(
                Lack(words="a heading to aim at"), "heading_error", first=_LACK_SAMPLES
            )
        ),
        "track": Need(
            find_lack=_require(
                GOAL,
                lambda run: run.goal_line is not None or run.path is not None,
                first=_LACK_SAMPLES,
            )
        ),
        "along_error": Need(
            find_lack=_require(
                Lack(words="a path with a speed"),
                lambda run: curves.read_along_error(run) is not None,
                first=_LACK_PATH,
            )
        ),
        "path": Need(find_lack=_LACK_PATH),
        "states": Need(
            find_lack=_require(Lack(words="states of its law that are not always 0"), has_states)
        ),
        "world_velocity": Need(
            find_lack=_require_curve(
                Lack(words="gain times error"), "world_velocity_x", first=_LACK_SAMPLES
            )
        ),
        **{
            command: Need(
                find_lack=_require(
                    Lack(words=f"{command.replace('_', ' ')} commands", is_of_motion=True),
                    partial(has_own, plot=TIME_PLOTS[command]),
                )
            )
            for command in get_args(curves.Command)
        },
        **{
            f"wanted_{command}": Need(find_lack=_require_curve(_UNWANTED, f"wanted_{command}"))
            for command in get_args(curves.Command)
        },
    }
)
"""What plots and figures may need, by name."""
