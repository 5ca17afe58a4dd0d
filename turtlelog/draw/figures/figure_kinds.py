"""The figures by name: their panels, and which of them runs have data for."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final, Literal

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from turtlelog.charts import curves, plane_scene
from turtlelog.charts.plotted_curves import Scale, group_states
from turtlelog.charts.time_plots import TIME_PLOTS
from turtlelog.display import NamedValues, fit_line
from turtlelog.draw.figures import plane_panels, theory_figures, time_panels
from turtlelog.draw.figures.explanation_figures import (
    draw_attribution,
    draw_luck,
    explain_for_figure,
    measure_luck_for_figure,
)
from turtlelog.draw.figures.figure_needs import (
    LOOP_LACKS,
    NEEDS,
    RECORDING,
    Lack,
    Need,
    find_lack_of_library,
    has_states,
)
from turtlelog.draw.figures.gain_figure import draw_gains
from turtlelog.draw.figures.plane_panels import draw_plane, has_one_plane
from turtlelog.draw.figures.robot_figures import draw_rates
from turtlelog.draw.figures.strip_figure import draw_strips
from turtlelog.run import Run

_ROW_HEIGHT: Final = 0.25  # height of a row of two panels, as a share of their total width

DrawFigure = Callable[[Figure, Sequence[Run]], None]

Arrange = Callable[[Figure, Sequence[Run], Sequence[plane_panels.Draw]], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Panel:
    """One panel of a figure.

    A run with unknown loops is assumed to have the loop of a usual panel.
    """

    name: str  # content, in a word or two
    needs: Need  # data that a run must contain
    draw: plane_panels.Draw  # function that draws the panel for several runs
    plot: str = ""  # name of the plot over time that the panel shows; empty for another panel
    loop: str = ""  # signal that a loop of the run must control; empty: any
    is_usual: bool = True  # whether the panel is reported as missing if no run has data for it

    def find_lacks(self, runs: Sequence[Run]) -> tuple[Lack | None, ...]:
        """Return the data that each run lacks for the panel; None if nothing is missing."""
        is_of_some = any(
            (self.is_usual and not run.declaration.loops)
            or (self.loop == "heading" and run.path is not None)
            or curves.list_loops(run, self.loop)
            for run in runs
        )
        if self.loop and not is_of_some:
            return (LOOP_LACKS[self.loop],) * len(runs)
        return self.needs.find_lacks(runs)


@dataclass(frozen=True, slots=True, kw_only=True)
class FigureKind:
    """One figure."""

    title: str  # content, for captions
    paper: str = ""  # the corresponding figure of the paper; empty if the paper has none
    height: float = 0.62  # height divided by width, with all usual panels of the figure
    needs: Need = NEEDS["poses"]  # data that one run must contain; panels need more
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
    arrange: Arrange = plane_panels.draw_stack  # function that places the panels

    def find_lack(self, runs: Sequence[Run]) -> str | None:
        """Return the data that the figure lacks; None if it can be drawn. Theory needs no runs."""
        lack = self._find_lack(runs)
        return None if lack is None else lack.words

    def _find_lack(self, runs: Sequence[Run]) -> Lack | None:
        if not runs:
            return find_lack_of_library() if self.needs.is_of_theory else RECORDING
        if self.draw is not None:
            lacks = self.needs.find_lacks(runs)
            return lacks[0] if all(lacks) else None
        if self.choose_panels(runs):
            return None
        lack = None if self.is_usual else self.needs.find_lack(runs[0])
        return lack or self.panels[0].find_lacks(runs)[0]

    def choose_panels(self, runs: Sequence[Run]) -> tuple[Panel, ...]:
        """Return the panels for which a run has data."""
        found = tuple(panel for panel in self.panels if not all(panel.find_lacks(runs)))
        return (*found, *self.list_more(runs))

    def find_height(self, runs: Sequence[Run]) -> float:
        """Return height divided by width: smaller for fewer panels, larger with a plane."""
        if self.draw is draw_plane and has_one_plane(runs):
            return 1.0
        if self.arrange is plane_panels.draw_overview:
            panels = self.choose_panels(runs)
            if curves.lack_samples(runs):
                return 0.31 + 0.08 * len(panels)
            return _ROW_HEIGHT * (len(panels) + plane_panels.count_plane_rows(panels)) / 2.0
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


MOST_STATES: Final = 12  # state panels in a figure; with more, it would be higher than any page


def list_usual_figures() -> tuple[str, ...]:
    """Return the names of the figures that are drawn by default."""
    return tuple(name for name, kind in FIGURES.items() if not kind.is_extra)


def _panel(name: str, scale: Scale | None = None, *, is_usual: bool | None = None) -> Panel:
    plot = TIME_PLOTS[name]
    return Panel(
        name=plot.title,
        needs=NEEDS[plot.needs],
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
            panels.append(Panel(name=label, needs=NEEDS["states"], draw=draw, is_usual=False))
    return tuple(panels[:most])


def _show(figure: str, title: str, paper: str = "9-16", height: float = 0.62) -> FigureKind:
    return FigureKind(title=title, paper=paper, panels=_panels(figure), height=height)


def _ask(
    title: str,
    draw: DrawFigure,
    needs: Need = NEEDS["poses"],
    *,
    is_wide: bool = True,
    **facts: Any,
) -> FigureKind:
    """Return a figure that is drawn only if requested by name."""
    facts["is_wide"] = lambda _: is_wide
    return FigureKind(title=title, draw=draw, needs=needs, is_usual=False, is_extra=True, **facts)


_SAMPLED: Final[dict[str, Any]] = {"needs": NEEDS["theory"], "is_timeless": True}
_METRICS: Final[dict[str, Any]] = {"content": "metrics", "is_timeless": True, "is_wide": False}

_NAMED: Final[Mapping[str, FigureKind]] = {
    "plant": FigureKind(
        title="Impulse, step and ramp response of the plant 1/s",
        paper="2",
        draw=theory_figures.draw_plant_responses,
        height=0.36,
        needs=NEEDS["integrator"],
        is_wide=lambda _: True,
        is_timeless=True,
    ),
    "step-responses": FigureKind(
        title="Step responses of the ideal closed loop, with 4 tau",
        paper="4",
        draw=theory_figures.draw_step_responses,
        needs=NEEDS["gain"],
        is_timeless=True,
    ),
    "root-locus": FigureKind(
        title="Poles of the ideal and of the sampled closed loops as Kp rises",
        paper="5",
        draw=theory_figures.draw_root_locus,
        height=0.55,
        needs=NEEDS["locus"],
        is_wide=bool,  # one panel if it shows theory alone
        is_timeless=True,
    ),
    "heading": _show("heading", "Heading, the goal bearing and the ideal response"),
    "along-track": FigureKind(
        title="Way along the track, or distance, the goal and the ideal response",
        panels=(_TRACK, _panel("distance")),
        needs=NEEDS["track"],
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
            replace(_panel("cross_track", is_usual=False), needs=NEEDS["path"]),
        ),
        height=0.32,
        needs=NEEDS["path"],
        is_usual=False,
    ),
    "states": FigureKind(
        title="States of the law",
        list_more=lambda runs: list_state_panels(runs),
        height=0.32,
        needs=NEEDS["states"],
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
        NEEDS["samples"],
        content="metric",
        prepare=lambda runs, **asked: {"explained": explain_for_figure(runs, **asked)},
    ),
    "luck": _ask(
        "What a metric of one run would be from other starts within one sample's turn",
        draw_luck,
        NEEDS["samples"],
        is_timeless=True,
        content="metric",
        prepare=lambda runs, **asked: {"luck": measure_luck_for_figure(runs, **asked)},
    ),
    "gains": _ask(
        "Metrics against the gain, with theory's limits of overshoot and stability",
        draw_gains,
        NEEDS["known_gain"],
        **_METRICS,
    ),
    "strips": _ask(
        "Metrics of many runs by gain, or by what else differs: points, and boxes",
        draw_strips,
        **_METRICS,
    ),
    "rates": _ask(
        "Commands against measured rates, with the model if one is identified",
        draw_rates,
        NEEDS["commands"],
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
        arrange=plane_panels.draw_overview,
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
