"""A figure and its panels, the data that they need from runs, and what a run lacks."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Final

from matplotlib.figure import Figure

from turtlelog.charts.curves import (
    Command,
    lack_samples,
    list_loops,
    read_along_error,
    read_curve,
    require_near,
)
from turtlelog.charts.plotted_curves import has_own
from turtlelog.charts.time_plots import TIME_PLOTS
from turtlelog.display import fit_line
from turtlelog.draw.figures.figure_curves import find_gains
from turtlelog.draw.figures.plane_panels import draw_plane, has_one_plane
from turtlelog.draw.figures.rates_figure import lacks_commands
from turtlelog.draw.figures.sampled_loops import find_lack_of_theory
from turtlelog.draw.figures.time_panels import Draw, count_plane_rows, draw_overview, draw_stack
from turtlelog.plants import LAGGED, find_plant
from turtlelog.run import Run

SAMPLES: Final = "the controller's samples"
POSES: Final = "poses"
GOAL: Final = "a goal"
PYTHON_CONTROL: Final = "python-control"


_ROW_HEIGHT: Final = 0.25
"""Height of a row of two panels, as a share of their total width."""

_LOOPS: Final[Mapping[str, str]] = {
    "heading": "a loop of the heading",
    "along_track": "a loop along the track",
    "distance": "a loop of the distance",
}
"""Loop that a panel shows, by its controlled signal."""


DrawFigure = Callable[[Figure, Sequence[Run]], None]
Arrange = Callable[[Figure, Sequence[Run], Sequence[Draw]], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Panel:
    """One panel of a figure.

    Attributes:
        name: Content, in a word or two.
        needs: Data that a run must contain.
        draw: Function that draws the panel for several runs.
        loop: Signal that a loop of the run must control; empty: any. For a usual panel, a run with
            unknown loops is assumed to have such a loop.
        is_usual: Whether the panel is reported as missing if no run has data for it.
        plot: Name of the plot over time that the panel shows; empty for another panel.
    """

    name: str
    needs: str
    draw: Draw
    plot: str = ""
    loop: str = ""
    is_usual: bool = True

    def find_lacks(self, runs: Sequence[Run]) -> tuple[str, ...]:
        """Return the data that each run lacks for the panel; empty if nothing is missing."""
        if self.loop and not any(self._is_of(run) for run in runs):
            return (_LOOPS[self.loop],) * len(runs)
        return find_lacks(runs, self.needs)

    def _is_of(self, run: Run) -> bool:
        is_unknown = self.is_usual and not run.declaration.loops
        follows = self.loop == "heading" and run.path is not None
        return is_unknown or follows or bool(list_loops(run, self.loop))


@dataclass(frozen=True, slots=True, kw_only=True)
class FigureKind:
    """One figure.

    Attributes:
        title: Content, for captions.
        paper: The corresponding figure of the paper; empty if the paper has none.
        height: Height divided by width, with all usual panels of the figure.
        needs: Data that at least one run must contain; panels have further needs.
        draw: Function that draws the figure for several runs, if it has no panels.
        panels: Panels; those without data in any run are left out.
        list_more: Function that returns further panels, which depend on the declarations of laws.
        is_usual: Whether the figure is reported as missing if no run has data for it.
        is_extra: Whether the figure is drawn only if requested by name.
        arrange: Function that places the panels.
    """

    title: str
    paper: str = ""
    height: float = 0.62
    needs: str = "poses"
    draw: DrawFigure | None = None
    panels: tuple[Panel, ...] = ()
    list_more: Callable[[Sequence[Run]], tuple[Panel, ...]] = lambda _: ()
    is_usual: bool = True
    is_extra: bool = False
    arrange: Arrange = draw_stack

    def find_lack(self, runs: Sequence[Run]) -> str | None:
        """Return the data that the figure lacks; None if it can be drawn. Theory needs no runs."""
        if not runs:
            return (find_lack_of_gain(()) or None) if self.needs in OF_THEORY else "a recording"
        if self.draw is not None:
            lacks = find_lacks(runs, self.needs)
            return lacks[0] if all(lacks) else None
        if self.choose_panels(runs):
            return None
        return (
            self.panels[0].find_lacks(runs)[0] if self.is_usual else find_lacks(runs, self.needs)[0]
        )

    def choose_panels(self, runs: Sequence[Run]) -> tuple[Panel, ...]:
        """Return the panels for which a run has data."""
        found = tuple(panel for panel in self.panels if not all(panel.find_lacks(runs)))
        return (*found, *self.list_more(runs))

    def find_height(self, runs: Sequence[Run]) -> float:
        """Return height divided by width: smaller for fewer panels, larger with a plane."""
        if self.draw is draw_plane and has_one_plane(runs):
            return 1.0
        if self.arrange is draw_overview:
            panels = self.choose_panels(runs)
            if lack_samples(runs):
                return 0.31 + 0.08 * len(panels)
            return _ROW_HEIGHT * (len(panels) + count_plane_rows(panels)) / 2.0
        kept, usual = len(self.choose_panels(runs)), sum(panel.is_usual for panel in self.panels)
        return self.height * (1.0 + kept) / (1.0 + usual)

    def draw_on(self, figure: Figure, runs: Sequence[Run]) -> None:
        """Draw the figure for several runs.

        Raises:
            ShowError: If a pose is too far away for the limits of axes.
        """
        require_near(runs)
        if self.draw is not None:
            self.draw(figure, runs)
        else:
            self.arrange(figure, runs, [panel.draw for panel in self.choose_panels(runs)])

    def __repr__(self) -> str:
        return fit_line(f"<FigureKind: {self.title}>")


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
    return _PROPORTIONAL if has_others else _GAIN


def _find_lack_of_locus(run: Run) -> str:
    """Return the data that a root locus lacks. An ideal or a sampled loop is sufficient.

    For a loop that is not proportional, the result is the reason why theory has no model.
    """
    lack = find_lack_of_gain([run])
    if lack == PYTHON_CONTROL:
        return lack
    unknown = find_lack_of_theory([run])
    return unknown if lack == _PROPORTIONAL or not unknown else lack


_GAIN: Final = "the law's gain"
_PROPORTIONAL: Final = "a proportional loop"

OF_THEORY: Final = ("gain", "integrator", "locus")
"""Data that theory provides without a run."""


def _has(words: str, has: Callable[[Run], bool], *, first: str = "") -> Callable[[Run], str]:
    """Return a function from a run to these words if it lacks the data, after those of a need."""
    return lambda run: (first and _LACKS[first](run)) or ("" if has(run) else words)


def _has_curve(words: str, signal: str) -> Callable[[Run], str]:
    return _has(words, lambda run: read_curve(run, signal) is not None, first="samples")


def _has_command(command: Command) -> Callable[[Run], str]:
    words = f"{command.replace('_', ' ')} commands"
    return _has(words, lambda run: has_own(run, TIME_PLOTS[command]))


def _has_wanted(command: Command) -> Callable[[Run], str]:
    signal = f"wanted_{command}"
    return _has(
        "what the law wanted before clipping",
        lambda run: len(run.samples) > 0 and read_curve(run, signal) is not None,
    )


_LACKS: Final[Mapping[str, Callable[[Run], str]]] = {
    "theory": lambda run: find_lack_of_theory([run]),
    "gain": lambda run: find_lack_of_gain([run]),
    "locus": _find_lack_of_locus,
    "integrator": _has(
        "a plant that is 1/s", lambda run: find_plant(run).name != LAGGED, first="gain"
    ),
    "known_gain": _has(_GAIN, _has_gain),
    "commands": _has("commands", lambda run: not lacks_commands(run), first="poses"),
    "samples": _has(SAMPLES, lambda run: len(run.samples) > 0),
    "poses": _has(POSES, lambda run: len(run.poses) > 0),
    "goal": _has(GOAL, lambda run: run.goal_xy_m is not None, first="poses"),
    "heading_error": _has_curve("a heading to aim at", "heading_error"),
    "track": _has(
        GOAL, lambda run: run.goal_line is not None or run.path is not None, first="samples"
    ),
    "along_error": _has(
        "a path with a speed", lambda run: read_along_error(run) is not None, first="path"
    ),
    "path": _has("a path that its law tracks", lambda run: run.path is not None),
    "states": _has("states of its law that are not always 0", has_states),
    "world_velocity": _has_curve("gain times error", "world_velocity_x"),
    "speed": _has_command("speed"),
    "turn_rate": _has_command("turn_rate"),
    "wanted_speed": _has_wanted("speed"),
    "wanted_turn_rate": _has_wanted("turn_rate"),
}
"""Functions from a run to the data that it lacks, by need; empty if nothing is missing."""


def find_lacks(runs: Sequence[Run], need: str) -> tuple[str, ...]:
    """Return the data that each run lacks for a figure; empty if nothing is missing."""
    return tuple(_LACKS[need](run) for run in runs)
