"""The figures by name: content, required data, and drawing function of each."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType
from typing import Final

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from turtlelog.charts.curves import list_loops, read_curve, require_near
from turtlelog.charts.plotted_curves import Scale, group_states
from turtlelog.charts.robot_curves import lack_samples
from turtlelog.charts.time_plots import TIME_PLOTS
from turtlelog.charts.tracked_path import read_along_error
from turtlelog.display import NamedValues, fit_line
from turtlelog.draw.figures.attribution_figure import draw_attribution
from turtlelog.draw.figures.figure_curves import draw_plant_responses, draw_step_responses
from turtlelog.draw.figures.gain_figure import draw_gains
from turtlelog.draw.figures.luck_figure import draw_luck
from turtlelog.draw.figures.needs import OF_THEORY, find_lack_of_gain, find_lacks, has_states
from turtlelog.draw.figures.plane_panels import draw_plane, has_one_plane
from turtlelog.draw.figures.rates_figure import draw_rates
from turtlelog.draw.figures.sampled_loops import draw_bode, draw_nyquist, draw_root_locus, draw_step
from turtlelog.draw.figures.strip_figure import draw_strips
from turtlelog.draw.figures.time_panels import (
    Draw,
    count_plane_rows,
    draw_overview,
    draw_stack,
    draw_states,
    draw_time_plot,
)
from turtlelog.draw.figures.violation_figure import draw_violation
from turtlelog.run import Run

DrawFigure = Callable[[Figure, Sequence[Run]], None]
Arrange = Callable[[Figure, Sequence[Run], Sequence[Draw]], None]

MOST_STATES: Final = 12
"""Largest number of state panels in a figure; with more, it would be higher than any page."""

_ROW_HEIGHT: Final = 0.25
"""Height of a row of two panels, as a share of their total width."""

_LOOPS: Final[Mapping[str, str]] = {
    "heading": "a loop of the heading",
    "along_track": "a loop along the track",
    "distance": "a loop of the distance",
}
"""Loop that a panel shows, by its controlled signal."""


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
    paper: str
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


def list_usual_figures() -> tuple[str, ...]:
    """Return the names of the figures that are drawn by default."""
    return tuple(name for name, kind in FIGURES.items() if not kind.is_extra)


def _panel(name: str, scale: Scale | None = None, *, is_usual: bool | None = None) -> Panel:
    """Return the panel of a plot over time."""
    plot = TIME_PLOTS[name]
    return Panel(
        name=plot.title,
        needs=plot.needs,
        draw=partial(draw_time_plot, name=name, scale=scale),
        plot=name,
        loop=plot.loop,
        is_usual=plot.is_usual if is_usual is None else is_usual,
    )


def _panels(figure: str) -> tuple[Panel, ...]:
    """Return the panels of a figure, which are the plots that list this figure."""
    return tuple(_panel(name) for name, plot in TIME_PLOTS.items() if plot.figure == figure)


def _track() -> Panel:
    """Return the panel of the along-track position, or of the error if all runs have a path."""
    return replace(_panel("along_track", is_usual=True), draw=_draw_track)


def _draw_track(axes: Axes, runs: Sequence[Run]) -> None:
    follows = all(read_along_error(run) is not None for run in runs)
    draw_time_plot(axes, runs, name="along_track_error" if follows else "along_track")


def list_state_panels(
    runs: Sequence[Run], *, of_commands: bool = False, most: int = MOST_STATES
) -> tuple[Panel, ...]:
    """Return panels for nonzero states: for a single run, one panel per group.

    Args:
        runs: Runs to draw.
        of_commands: Whether to include only states that belong to a command.
        most: Largest number of panels.
    """
    found = [run for run in runs if has_states(run)]
    panels = []
    for group in group_states(*(run.declaration for run in found)):
        acting = tuple(name for name in group.names if not _is_idle(name, found))
        if not acting or (of_commands and group.command is None):
            continue
        names: list[tuple[str, ...]] = [(name,) for name in acting]
        if len(runs) == 1:
            curves = [read_curve(runs[0], name) for name in acting]
            columns = [curve.values for curve in curves if curve is not None]
            names = [acting] if group.can_share(acting, columns) else names
        for shown in names:
            label = shown[0] if len(shown) == 1 else group.label[0].lower() + group.label[1:]
            draw = partial(draw_states, names=shown, label=label)
            panels.append(Panel(name=label, needs="states", draw=draw, is_usual=False))
    return tuple(panels[:most])


def _is_idle(name: str, runs: Sequence[Run]) -> bool:
    """Return whether a state is always 0 in every run that has it."""
    curves = [read_curve(run, name) for run in runs if name in run.declaration.states]
    return not any(curve.values.any() for curve in curves if curve is not None)


_NAMED: Final[Mapping[str, FigureKind]] = MappingProxyType(
    {
        "plant": FigureKind(
            title="Impulse, step and ramp response of the plant 1/s",
            paper="2",
            draw=draw_plant_responses,
            height=0.36,
            needs="integrator",
        ),
        "step-responses": FigureKind(
            title="Step responses of the ideal closed loop, with 4 tau",
            paper="4",
            draw=draw_step_responses,
            needs="gain",
        ),
        "root-locus": FigureKind(
            title="Poles of the ideal and of the sampled closed loops as Kp rises",
            paper="5",
            draw=draw_root_locus,
            height=0.55,
            needs="locus",
        ),
        "heading": FigureKind(
            title="Heading, the goal bearing and the ideal response",
            paper="9-16",
            panels=_panels("heading"),
        ),
        "along-track": FigureKind(
            title="Way along the track, or distance, the goal and the ideal response",
            paper="",
            panels=(_track(), _panel("distance")),
            needs="track",
            is_usual=False,
            is_extra=True,
        ),
        "position": FigureKind(
            title="Position, the goal and the ideal response",
            paper="9-16",
            panels=_panels("position"),
            height=0.95,
        ),
        "heading-error": FigureKind(
            title="Heading error and the ideal response",
            paper="9-16",
            panels=_panels("heading-error"),
        ),
        "position-error": FigureKind(
            title="Position error and the ideal response",
            paper="9-16",
            panels=_panels("position-error"),
            height=0.95,
        ),
        "turn-rate": FigureKind(
            title="Turn rate, its limits",
            paper="9-16",
            panels=_panels("turn-rate"),
        ),
        "speed": FigureKind(
            title="Speed, its limits",
            paper="14",
            panels=_panels("speed"),
        ),
        "wanted-speed": FigureKind(
            title="Speed that the law wanted, before clipping",
            paper="14",
            panels=_panels("wanted-speed"),
        ),
        "world-velocity": FigureKind(
            title="Gain times error in the world frame, before projection and clipping",
            paper="9-16",
            panels=_panels("world-velocity"),
            height=0.95,
        ),
        "error-log": FigureKind(
            title="Magnitude of the errors on a logarithmic scale, the ideal decay, the tolerances",
            paper="",
            panels=(
                _panel("heading_error", "log"),
                replace(_panel("distance", "log", is_usual=True), loop=""),
            ),
            height=0.95,
        ),
        "path-error": FigureKind(
            title="Errors along the path, behind its reference, and across it",
            paper="",
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
            paper="",
            list_more=lambda runs: list_state_panels(runs),
            height=0.32,
            needs="states",
            is_usual=False,
        ),
        "bode": FigureKind(
            title="Frequency response of the open sampled loops, with their margins",
            paper="",
            draw=draw_bode,
            height=0.62,
            needs="theory",
            is_usual=False,
            is_extra=True,
        ),
        "nyquist": FigureKind(
            title="Open sampled loops in the complex plane, with their margins",
            paper="",
            draw=draw_nyquist,
            height=0.62,
            needs="theory",
            is_usual=False,
            is_extra=True,
        ),
        "step": FigureKind(
            title="Step responses of the sampled loops, without limits",
            paper="",
            draw=draw_step,
            height=0.42,
            needs="theory",
            is_usual=False,
            is_extra=True,
        ),
        "attribution": FigureKind(
            title="What caused a metric of one run: the contributions, the run and its ghost",
            paper="",
            draw=draw_attribution,
            needs="samples",
            is_usual=False,
            is_extra=True,
        ),
        "luck": FigureKind(
            title="What a metric of one run would be from other starts within one sample's turn",
            paper="",
            draw=draw_luck,
            needs="samples",
            is_usual=False,
            is_extra=True,
        ),
        "gains": FigureKind(
            title="Metrics against the gain, with theory's limits of overshoot and stability",
            paper="",
            draw=draw_gains,
            needs="known_gain",
            is_usual=False,
            is_extra=True,
        ),
        "strips": FigureKind(
            title="Metrics of many runs by gain, or by what else differs: points, and boxes",
            paper="",
            draw=draw_strips,
            is_usual=False,
            is_extra=True,
        ),
        "rates": FigureKind(
            title="Commands against measured rates, with the identified model",
            paper="",
            draw=draw_rates,
            needs="commands",
            is_usual=False,
            is_extra=True,
        ),
        "violation": FigureKind(
            title="The signal that a check holds to a band, and where it leaves it",
            paper="",
            draw=draw_violation,
            is_usual=False,
            is_extra=True,
        ),
        "plane": FigureKind(
            title="Paths in the plane, and how each run ends",
            paper="17",
            draw=draw_plane,
            height=0.53,
            needs="poses",
        ),
        "panel": FigureKind(
            title="Path, errors and commands, as far as recorded",
            paper="",
            panels=(
                _panel("heading"),
                _track(),
                _panel("distance"),
                _panel("heading_error", "log"),
                _panel("cross_track"),
                _panel("turn_rate"),
                _panel("speed"),
            ),
            list_more=lambda runs: (
                list_state_panels(runs, of_commands=True) if len(runs) == 1 else ()
            ),
            arrange=draw_overview,
        ),
    },
)


def _list_figures() -> dict[str, FigureKind]:
    """Return the figures above, and one figure for each plot over time that they do not contain."""
    others = {
        plot.figure: FigureKind(
            title=plot.title.capitalize(),
            paper="",
            panels=_panels(plot.figure),
            is_usual=False,
            is_extra=True,
        )
        for plot in TIME_PLOTS.values()
        if plot.figure and plot.figure not in _NAMED
    }
    return {**_NAMED, **others}


FIGURES: Final[Mapping[str, FigureKind]] = NamedValues("figure", _list_figures())
"""Every figure by name."""
