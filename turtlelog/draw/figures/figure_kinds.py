"""The figures by name: their panels, the data that they need from runs, and what a run lacks."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib.util import find_spec
from typing import Any, Final, Literal, get_args

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from turtlelog.charts import curves, plane_scene
from turtlelog.charts.plotted_curves import Scale, group_states, has_own
from turtlelog.charts.time_plots import TIME_PLOTS
from turtlelog.display import NamedValues, fit_line
from turtlelog.draw.figures import theory_figures, time_panels
from turtlelog.draw.figures.explanation_figures import (
    draw_attribution,
    draw_luck,
    explain_for_figure,
    measure_luck_for_figure,
)
from turtlelog.draw.figures.gain_figure import draw_gains
from turtlelog.draw.figures.plane_panels import draw_plane, has_one_plane
from turtlelog.draw.figures.robot_figures import draw_rates, lacks_commands
from turtlelog.draw.figures.strip_figure import draw_strips
from turtlelog.plants import find_plant
from turtlelog.run import Run

SAMPLES: Final = "the controller's samples"
POSES: Final = "poses"
GOAL: Final = "a goal"
PYTHON_CONTROL: Final = "python-control"
_GAIN: Final = "the law's gain"
_PROPORTIONAL: Final = "a proportional loop"

_ROW_HEIGHT: Final = 0.25  # height of a row of two panels, as a share of their total width

_LOOPS: Final[Mapping[str, str]] = {
    "heading": "a loop of the heading",
    "along_track": "a loop along the track",
    "distance": "a loop of the distance",
}
"""Loop that a panel shows, by its controlled signal."""

DrawFigure = Callable[[Figure, Sequence[Run]], None]

Arrange = Callable[[Figure, Sequence[Run], Sequence[time_panels.Draw]], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Panel:
    """One panel of a figure.

    A run with unknown loops is assumed to have the loop of a usual panel.
    """

    name: str  # content, in a word or two
    needs: str  # data that a run must contain
    draw: time_panels.Draw  # function that draws the panel for several runs
    plot: str = ""  # name of the plot over time that the panel shows; empty for another panel
    loop: str = ""  # signal that a loop of the run must control; empty: any
    is_usual: bool = True  # whether the panel is reported as missing if no run has data for it

    def find_lacks(self, runs: Sequence[Run]) -> tuple[str, ...]:
        """Return the data that each run lacks for the panel; empty if nothing is missing."""
        is_of_some = any(
            (self.is_usual and not run.declaration.loops)
            or (self.loop == "heading" and run.path is not None)
            or curves.list_loops(run, self.loop)
            for run in runs
        )
        if self.loop and not is_of_some:
            return (_LOOPS[self.loop],) * len(runs)
        return find_lacks(runs, self.needs)


@dataclass(frozen=True, slots=True, kw_only=True)
class FigureKind:
    """One figure."""

    title: str  # content, for captions
    paper: str = ""  # the corresponding figure of the paper; empty if the paper has none
    height: float = 0.62  # height divided by width, with all usual panels of the figure
    needs: str = "poses"  # data that at least one run must contain; panels have further needs
    draw: DrawFigure | None = None  # draws the figure for several runs, if it has no panels
    panels: tuple[Panel, ...] = ()  # panels; those without data in any run are left out
    list_more: Callable[[Sequence[Run]], tuple[Panel, ...]] = lambda _: ()  # panels of the laws
    is_usual: bool = True  # whether the figure is reported as missing if no run has data for it
    is_extra: bool = False  # whether the figure is drawn only if requested by name
    is_wide: Callable[[Sequence[Run]], bool] = lambda _: False  # whether panels are side by side
    is_timeless: bool = False  # whether no time window cuts it: no time axis, and no driven path
    content: Literal["", "metric", "metrics", "formula"] = ""  # what a user may name for it
    prepare: Callable[..., Mapping[str, Any]] | None = None  # keywords of `draw`, from the runs,
    # `metric` and `work`, which may take seconds
    arrange: Arrange = time_panels.draw_stack  # function that places the panels

    def find_lack(self, runs: Sequence[Run]) -> str | None:
        """Return the data that the figure lacks; None if it can be drawn. Theory needs no runs."""
        if not runs:
            return (find_lack_of_gain(()) or None) if self.needs in OF_THEORY else "a recording"
        if self.draw is not None:
            lacks = find_lacks(runs, self.needs)
            return lacks[0] if all(lacks) else None
        if self.choose_panels(runs):
            return None
        lack = "" if self.is_usual else find_lacks(runs, self.needs)[0]
        return lack or self.panels[0].find_lacks(runs)[0]

    def choose_panels(self, runs: Sequence[Run]) -> tuple[Panel, ...]:
        """Return the panels for which a run has data."""
        found = tuple(panel for panel in self.panels if not all(panel.find_lacks(runs)))
        return (*found, *self.list_more(runs))

    def find_height(self, runs: Sequence[Run]) -> float:
        """Return height divided by width: smaller for fewer panels, larger with a plane."""
        if self.draw is draw_plane and has_one_plane(runs):
            return 1.0
        if self.arrange is time_panels.draw_overview:
            panels = self.choose_panels(runs)
            if curves.lack_samples(runs):
                return 0.31 + 0.08 * len(panels)
            return _ROW_HEIGHT * (len(panels) + time_panels.count_plane_rows(panels)) / 2.0
        kept, usual = len(self.choose_panels(runs)), sum(panel.is_usual for panel in self.panels)
        return self.height * (1.0 + kept) / (1.0 + usual)

    def draw_on(self, figure: Figure, runs: Sequence[Run]) -> None:
        """Draw the figure for several runs; ShowError if a pose is too far away for axes."""
        plane_scene.require_near(runs)
        if self.draw is not None:
            self.draw(figure, runs)
        else:
            self.arrange(figure, runs, [panel.draw for panel in self.choose_panels(runs)])

    def __repr__(self) -> str:
        return fit_line(f"<FigureKind: {self.title}>")


def has_states(run: Run) -> bool:
    """Return whether a run has states of its law that are not always 0."""
    return run.samples.states is not None and bool(run.samples.states.any())


def find_lack_of_gain(runs: Sequence[Run]) -> str:
    """Return what theory's figures lack: python-control, or a gain."""
    if find_spec("control") is None:
        return PYTHON_CONTROL
    if theory_figures.find_gains(runs):
        return ""
    loops = [loop for run in runs for loop in run.declaration.loops]
    has_others = any(loop.gain and not loop.is_proportional for loop in loops)
    return _PROPORTIONAL if has_others else _GAIN


def _find_lack_of_locus(run: Run) -> str:
    """Return what a root locus lacks of an ideal or a sampled loop, or why theory has no model."""
    lack = find_lack_of_gain([run])
    if lack == PYTHON_CONTROL or (not lack and find_plant(run).dynamics == "integrator"):
        return lack
    unknown = theory_figures.find_lack_of_theory(run)
    return unknown if lack in ("", _PROPORTIONAL) or not unknown else lack


OF_THEORY: Final = ("gain", "integrator", "locus")  # data that theory provides without a run


def _has(words: str, has: Callable[[Run], bool], *, first: str = "") -> Callable[[Run], str]:
    """Return a function from a run to these words if it lacks the data, after those of a need."""
    return lambda run: (first and _LACKS[first](run)) or ("" if has(run) else words)


def _reads(signal: str) -> Callable[[Run], bool]:
    return lambda run: len(run.samples) > 0 and curves.read_curve(run, signal) is not None


_LACKS: Final[Mapping[str, Callable[[Run], str]]] = {
    "theory": theory_figures.find_lack_of_theory,
    "gain": lambda run: find_lack_of_gain([run]),
    "locus": _find_lack_of_locus,
    "integrator": _has(
        "a plant that is 1/s", lambda run: find_plant(run).dynamics == "integrator", first="gain"
    ),
    "known_gain": _has(
        _GAIN,
        lambda run: any(
            (loop.read_gain(run.parameters) or 0.0) > 0.0 for loop in run.declaration.loops
        ),
    ),
    "commands": _has("commands", lambda run: not lacks_commands(run), first="poses"),
    "samples": _has(SAMPLES, lambda run: len(run.samples) > 0),
    "poses": _has(POSES, lambda run: len(run.poses) > 0),
    "goal": _has(GOAL, lambda run: run.goal_xy_m is not None, first="poses"),
    "heading_error": _has("a heading to aim at", _reads("heading_error"), first="samples"),
    "track": _has(
        GOAL, lambda run: run.goal_line is not None or run.path is not None, first="samples"
    ),
    "along_error": _has(
        "a path with a speed", lambda run: curves.read_along_error(run) is not None, first="path"
    ),
    "path": _has("a path that its law tracks", lambda run: run.path is not None),
    "states": _has("states of its law that are not always 0", has_states),
    "world_velocity": _has("gain times error", _reads("world_velocity_x"), first="samples"),
    **{
        command: _has(
            f"{command.replace('_', ' ')} commands", partial(has_own, plot=TIME_PLOTS[command])
        )
        for command in get_args(curves.Command)
    },
    **{
        f"wanted_{command}": _has(
            "what the law wanted before clipping", _reads(f"wanted_{command}")
        )
        for command in get_args(curves.Command)
    },
}
"""Functions from a run to the data that it lacks, by need; empty if nothing is missing."""


def find_lacks(runs: Sequence[Run], need: str) -> tuple[str, ...]:
    """Return the data that each run lacks for a figure; empty if nothing is missing."""
    return tuple(_LACKS[need](run) for run in runs)


MOST_STATES: Final = 12  # state panels in a figure; with more, it would be higher than any page


def list_usual_figures() -> tuple[str, ...]:
    """Return the names of the figures that are drawn by default."""
    return tuple(name for name, kind in FIGURES.items() if not kind.is_extra)


def _panel(name: str, scale: Scale | None = None, *, is_usual: bool | None = None) -> Panel:
    plot = TIME_PLOTS[name]
    return Panel(
        name=plot.title,
        needs=plot.needs,
        draw=partial(time_panels.draw_time_plot, name=name, scale=scale),
        plot=name,
        loop=plot.loop,
        is_usual=plot.is_usual if is_usual is None else is_usual,
    )


def _panels(figure: str) -> tuple[Panel, ...]:
    return tuple(_panel(name) for name, plot in TIME_PLOTS.items() if plot.figure == figure)


def _draw_track(axes: Axes, runs: Sequence[Run]) -> None:
    """Draw the along-track position, or the error if all runs have a path."""
    follows = all(curves.read_along_error(run) is not None for run in runs)
    time_panels.draw_time_plot(axes, runs, name="along_track_error" if follows else "along_track")


_TRACK: Final = replace(_panel("along_track", is_usual=True), draw=_draw_track)


def list_state_panels(
    runs: Sequence[Run], *, of_commands: bool = False, most: int = MOST_STATES
) -> tuple[Panel, ...]:
    """Return at most `most` panels for nonzero states, or of commands; of one run by group."""
    found = [run for run in runs if has_states(run)]
    panels = []
    for group in group_states(*(run.declaration for run in found)):
        columns = {
            name: [
                curve.values
                for run in found
                if name in run.declaration.states
                and (curve := curves.read_curve(run, name)) is not None
            ]
            for name in group.names
        }
        acting = tuple(name for name in columns if any(one.any() for one in columns[name]))
        if not acting or (of_commands and group.command is None):
            continue
        names: list[tuple[str, ...]] = [(name,) for name in acting]
        if len(runs) == 1 and group.can_share(acting, [columns[name][0] for name in acting]):
            names = [acting]
        for shown in names:
            label = shown[0] if len(shown) == 1 else group.label[0].lower() + group.label[1:]
            draw = partial(time_panels.draw_states, names=shown, label=label)
            panels.append(Panel(name=label, needs="states", draw=draw, is_usual=False))
    return tuple(panels[:most])


def _show(figure: str, title: str, paper: str = "9-16", height: float = 0.62) -> FigureKind:
    return FigureKind(title=title, paper=paper, panels=_panels(figure), height=height)


def _ask(
    title: str, draw: DrawFigure, needs: str = "poses", *, is_wide: bool = True, **facts: Any
) -> FigureKind:
    """Return a figure that is drawn only if requested by name."""
    facts["is_wide"] = lambda _: is_wide
    return FigureKind(title=title, draw=draw, needs=needs, is_usual=False, is_extra=True, **facts)


_SAMPLED: Final[dict[str, Any]] = {"needs": "theory", "is_timeless": True}
_METRICS: Final[dict[str, Any]] = {"content": "metrics", "is_timeless": True, "is_wide": False}

_NAMED: Final[Mapping[str, FigureKind]] = {
    "plant": FigureKind(
        title="Impulse, step and ramp response of the plant 1/s",
        paper="2",
        draw=theory_figures.draw_plant_responses,
        height=0.36,
        needs="integrator",
        is_wide=lambda _: True,
        is_timeless=True,
    ),
    "step-responses": FigureKind(
        title="Step responses of the ideal closed loop, with 4 tau",
        paper="4",
        draw=theory_figures.draw_step_responses,
        needs="gain",
        is_timeless=True,
    ),
    "root-locus": FigureKind(
        title="Poles of the ideal and of the sampled closed loops as Kp rises",
        paper="5",
        draw=theory_figures.draw_root_locus,
        height=0.55,
        needs="locus",
        is_wide=bool,  # one panel if it shows theory alone
        is_timeless=True,
    ),
    "heading": _show("heading", "Heading, the goal bearing and the ideal response"),
    "along-track": FigureKind(
        title="Way along the track, or distance, the goal and the ideal response",
        panels=(_TRACK, _panel("distance")),
        needs="track",
        is_usual=False,
        is_extra=True,
    ),
    "position": _show("position", "Position, the goal and the ideal response", height=0.95),
    "heading-error": _show("heading-error", "Heading error and the ideal response"),
    "position-error": _show("position-error", "Position error and the ideal response", height=0.95),
    "turn-rate": _show("turn-rate", "Turn rate, its limits"),
    "speed": _show("speed", "Speed, its limits", "14"),
    "wanted-speed": _show("wanted-speed", "Speed that the law wanted, before clipping", "14"),
    "world-velocity": _show(
        "world-velocity",
        "Gain times error in the world frame, before projection and clipping",
        height=0.95,
    ),
    "error-log": FigureKind(
        title="Magnitude of the errors on a logarithmic scale, the ideal decay, the tolerances",
        panels=(
            _panel("heading_error", "log"),
            replace(_panel("distance", "log", is_usual=True), loop=""),
        ),
        height=0.95,
    ),
    "path-error": FigureKind(
        title="Errors along the path, behind its reference, and across it",
        panels=(
            *_panels("path-error"),
            replace(_panel("cross_track", is_usual=False), needs="path"),
        ),
        height=0.32,
        needs="path",
        is_usual=False,
    ),
    "states": FigureKind(
        title="States of the law",
        list_more=lambda runs: list_state_panels(runs),
        height=0.32,
        needs="states",
        is_usual=False,
    ),
    "bode": _ask(
        "Frequency response of the open sampled loops, with their margins",
        theory_figures.draw_bode,
        **_SAMPLED,
    ),
    "nyquist": _ask(
        "Open sampled loops in the complex plane, with their margins",
        theory_figures.draw_nyquist,
        **_SAMPLED,
    ),
    "step": _ask(
        "Step responses of the sampled loops, without limits",
        theory_figures.draw_step,
        height=0.42,
        **_SAMPLED,
    ),
    "attribution": _ask(
        "What caused a metric of one run: the contributions, the run and its ghost",
        draw_attribution,
        "samples",
        content="metric",
        prepare=lambda runs, **asked: {"explained": explain_for_figure(runs, **asked)},
    ),
    "luck": _ask(
        "What a metric of one run would be from other starts within one sample's turn",
        draw_luck,
        "samples",
        is_timeless=True,
        content="metric",
        prepare=lambda runs, **asked: {"luck": measure_luck_for_figure(runs, **asked)},
    ),
    "gains": _ask(
        "Metrics against the gain, with theory's limits of overshoot and stability",
        draw_gains,
        "known_gain",
        **_METRICS,
    ),
    "strips": _ask(
        "Metrics of many runs by gain, or by what else differs: points, and boxes",
        draw_strips,
        **_METRICS,
    ),
    "rates": _ask(
        "Commands against measured rates, with the identified model", draw_rates, "commands"
    ),
    "violation": _ask(
        "The signal that a check holds to a band, and where it leaves it",
        time_panels.draw_violation,
        content="formula",
    ),
    "plane": FigureKind(
        title="Paths in the plane, and how each run ends",
        paper="17",
        draw=draw_plane,
        height=0.53,
        is_wide=lambda runs: not has_one_plane(runs),
    ),
    "panel": FigureKind(
        title="Path, errors and commands, as far as recorded",
        panels=(
            *(_panel("heading"), _TRACK, _panel("distance"), _panel("heading_error", "log")),
            *map(_panel, ("cross_track", "turn_rate", "speed")),
        ),
        list_more=lambda runs: list_state_panels(runs, of_commands=True) if len(runs) == 1 else (),
        arrange=time_panels.draw_overview,
        is_wide=lambda _: True,
    ),
}

_OTHERS: Final = {
    plot.figure: FigureKind(
        title=plot.title.capitalize(), panels=_panels(plot.figure), is_usual=False, is_extra=True
    )
    for plot in TIME_PLOTS.values()
    if plot.figure and plot.figure not in _NAMED
}
"""A figure for each plot over time that the figures above do not contain."""

FIGURES: Final[Mapping[str, FigureKind]] = NamedValues("figure", {**_NAMED, **_OTHERS})
"""Every figure by name."""
