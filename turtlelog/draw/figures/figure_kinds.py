"""The figures by name, and the data of runs that figures and tables do not show, with reasons."""

import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Final

from matplotlib.axes import Axes

from turtlelog.charts.close_up import ARRIVED_M, ON_PATH_M, format_length
from turtlelog.charts.curve_marks import Characteristic, list_characteristics
from turtlelog.charts.curves import lack_samples, read_along_error, read_curve
from turtlelog.charts.plane_scene import list_paths
from turtlelog.charts.plotted_curves import Scale, group_states
from turtlelog.charts.time_plots import TIME_PLOTS
from turtlelog.compare import order_by_gain, tabulate_table1
from turtlelog.display import NamedValues
from turtlelog.draw.figures import time_panels
from turtlelog.draw.figures.attribution_figure import draw_attribution
from turtlelog.draw.figures.figure_curves import draw_plant_responses, draw_step_responses
from turtlelog.draw.figures.gain_figure import draw_gains
from turtlelog.draw.figures.luck_figure import draw_luck
from turtlelog.draw.figures.marked_panels import has_marks
from turtlelog.draw.figures.needs import (
    GOAL,
    POSES,
    SAMPLES,
    DrawFigure,
    FigureKind,
    Panel,
    find_lacks,
    has_states,
)
from turtlelog.draw.figures.plane_panels import draw_plane, has_one_plane
from turtlelog.draw.figures.rates_figure import draw_rates
from turtlelog.draw.figures.run_styles import label_runs
from turtlelog.draw.figures.sampled_loops import draw_bode, draw_nyquist, draw_root_locus, draw_step
from turtlelog.draw.figures.strip_figure import draw_strips
from turtlelog.draw.figures.violation_figure import draw_violation
from turtlelog.measure import measure_run
from turtlelog.run import Run

MOST_STATES: Final = 12
"""Largest number of state panels in a figure; with more, it would be higher than any page."""


def list_usual_figures() -> tuple[str, ...]:
    """Return the names of the figures that are drawn by default."""
    return tuple(name for name, kind in FIGURES.items() if not kind.is_extra)


def _panel(name: str, scale: Scale | None = None, *, is_usual: bool | None = None) -> Panel:
    """Return the panel of a plot over time."""
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
    """Return the panels of a figure, which are the plots that list this figure."""
    return tuple(_panel(name) for name, plot in TIME_PLOTS.items() if plot.figure == figure)


def _track() -> Panel:
    """Return the panel of the along-track position, or of the error if all runs have a path."""
    return replace(_panel("along_track", is_usual=True), draw=_draw_track)


def _draw_track(axes: Axes, runs: Sequence[Run]) -> None:
    follows = all(read_along_error(run) is not None for run in runs)
    time_panels.draw_time_plot(axes, runs, name="along_track_error" if follows else "along_track")


def list_state_panels(
    runs: Sequence[Run], *, of_commands: bool = False, most: int = MOST_STATES
) -> tuple[Panel, ...]:
    """Return panels for nonzero states, at most `most`; for a single run, one panel per group.

    If `of_commands` is true, only states that belong to a command are included.
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
            draw = partial(time_panels.draw_states, names=shown, label=label)
            panels.append(Panel(name=label, needs="states", draw=draw, is_usual=False))
    return tuple(panels[:most])


def _is_idle(name: str, runs: Sequence[Run]) -> bool:
    """Return whether a state is always 0 in every run that has it."""
    curves = [read_curve(run, name) for run in runs if name in run.declaration.states]
    return not any(curve.values.any() for curve in curves if curve is not None)


def _show(figure: str, title: str, paper: str = "9-16", height: float = 0.62) -> FigureKind:
    """Return a figure of the paper that shows plots over time."""
    return FigureKind(title=title, paper=paper, panels=_panels(figure), height=height)


def _ask(title: str, draw: DrawFigure, needs: str = "poses", height: float = 0.62) -> FigureKind:
    """Return a figure that is drawn only if requested by name."""
    return FigureKind(
        title=title, draw=draw, needs=needs, height=height, is_usual=False, is_extra=True
    )


_NAMED: Final[Mapping[str, FigureKind]] = {
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
    "heading": _show("heading", "Heading, the goal bearing and the ideal response"),
    "along-track": FigureKind(
        title="Way along the track, or distance, the goal and the ideal response",
        panels=(_track(), _panel("distance")),
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
        "Frequency response of the open sampled loops, with their margins", draw_bode, "theory"
    ),
    "nyquist": _ask(
        "Open sampled loops in the complex plane, with their margins", draw_nyquist, "theory"
    ),
    "step": _ask(
        "Step responses of the sampled loops, without limits", draw_step, "theory", height=0.42
    ),
    "attribution": _ask(
        "What caused a metric of one run: the contributions, the run and its ghost",
        draw_attribution,
        "samples",
    ),
    "luck": _ask(
        "What a metric of one run would be from other starts within one sample's turn",
        draw_luck,
        "samples",
    ),
    "gains": _ask(
        "Metrics against the gain, with theory's limits of overshoot and stability",
        draw_gains,
        "known_gain",
    ),
    "strips": _ask(
        "Metrics of many runs by gain, or by what else differs: points, and boxes", draw_strips
    ),
    "rates": _ask(
        "Commands against measured rates, with the identified model", draw_rates, "commands"
    ),
    "violation": _ask(
        "The signal that a check holds to a band, and where it leaves it", draw_violation
    ),
    "plane": FigureKind(
        title="Paths in the plane, and how each run ends", paper="17", draw=draw_plane, height=0.53
    ),
    "panel": FigureKind(
        title="Path, errors and commands, as far as recorded",
        panels=(
            _panel("heading"),
            _track(),
            _panel("distance"),
            _panel("heading_error", "log"),
            _panel("cross_track"),
            _panel("turn_rate"),
            _panel("speed"),
        ),
        list_more=lambda runs: list_state_panels(runs, of_commands=True) if len(runs) == 1 else (),
        arrange=time_panels.draw_overview,
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


_MOST_NAMED: Final = 3
"""Largest number of runs that are named as missing from a figure; more runs are only counted."""

_ARRIVAL: Final = f"one goal, and a run that ends within {format_length(ARRIVED_M)} of it"

_OF_MOTION: Final = frozenset({POSES, GOAL, "speed commands", "turn rate commands"})
"""Data that a recording without samples may contain."""

_DEPARTURE: Final = f"one path, and a run that is more than {format_length(ON_PATH_M)} off it"


def list_left_out(runs: Sequence[Run], names: Iterable[str] | None = None) -> tuple[str, ...]:
    """Return what figures leave out of some runs and why, one line for each reason.

    Args:
        runs: Runs to draw, with the names of legends in these lines.
        names: Names of the requested figures. Default: all figures, and the tables.
    """
    runs = order_by_gain(runs)
    left_out: dict[tuple[str, tuple[int, ...]], list[str]] = {}
    shown = list_usual_figures() if names is None else tuple(dict.fromkeys(names))
    for name in shown:
        for part, lacks in _list_parts(name, runs):
            for words in dict.fromkeys(filter(None, lacks)):
                lacking = tuple(number for number, lack in enumerate(lacks) if lack == words)
                left_out.setdefault((words, lacking), []).append(part)
    if lack_samples(runs):
        left_out = _join_controller(left_out, has_tables=names is None)
    lines = [_describe(words, lacking, parts, runs) for (words, lacking), parts in left_out.items()]
    if names is None and not has_table1(runs) and not lack_samples(runs):
        needed = GOAL if any(len(run.samples) for run in runs) else SAMPLES
        lines.append(f"left out table1.tex: needs a gain or {needed}")
    return (*lines, *_tell_states(runs, shown), *_tell_close_up(runs, shown))


def list_unmarked(runs: Sequence[Run], names: Iterable[str]) -> tuple[str, ...]:
    """Return one line on the named figures whose curves have no characteristics, if any."""
    found = [list_characteristics(run, measure_run(run)) for run in runs]
    lacking = [name for name in names if not _is_marked(name, runs, found)]
    expected = "a curve with characteristics"
    return (f"left marks out of {', '.join(lacking)}: needs {expected}",) if lacking else ()


def _is_marked(name: str, runs: Sequence[Run], found: Sequence[Sequence[Characteristic]]) -> bool:
    """Return whether a panel over time in a figure has marks of a run."""
    kind = FIGURES[name]
    panels = kind.choose_panels(runs) if kind.draw is None else ()
    signals = [panel.plot for panel in panels if panel.plot]
    return any(has_marks(signal, marks) for signal in signals for marks in found)


def _tell_states(runs: Sequence[Run], shown: Sequence[str]) -> list[str]:
    states = list_state_panels(runs, most=sys.maxsize)
    if "states" not in shown or len(states) <= MOST_STATES:
        return []
    return [
        f"left out states (from {states[MOST_STATES].name} on):"
        f" expected at most {MOST_STATES} panels, found {len(states)}"
    ]


def _tell_close_up(runs: Sequence[Run], shown: Sequence[str]) -> list[str]:
    """Return why there is no close-up; empty for runs without samples and goal."""
    if "plane" not in shown or not has_one_plane(runs):
        return []
    if lack_samples(runs) and not any(run.goal_xy_m for run in runs):
        return []
    part, expected = ("how each run ends", _ARRIVAL)
    if list_paths(runs):
        part, expected = ("furthest off the path", _DEPARTURE)
    return [f"left out plane ({part}): needs {expected}"]


_Left = dict[tuple[str, tuple[int, ...]], list[str]]
"""Omitted figures and panels, by missing data and by the runs without these data."""


def _join_controller(left_out: _Left, *, has_tables: bool) -> _Left:
    """Return missing controller data as one line: a recording without samples has none."""
    of_motion: _Left = {}
    of_controller: list[str] = []
    for (words, lacking), parts in left_out.items():
        if words in _OF_MOTION:
            of_motion[words, lacking] = parts
        else:
            of_controller += [part for part in parts if not part.startswith("panel (")]
            everyone = lacking
    if not of_controller:
        return of_motion
    tables = ["table1.tex"] if has_tables else []
    return {(SAMPLES, everyone): [*of_controller, *tables], **of_motion}


def has_table1(runs: Sequence[Run]) -> bool:
    """Return whether Table 1 of these runs contains anything but their names."""
    return any(value is not None for row in tabulate_table1(runs).rows for value in row[1:])


def _list_parts(name: str, runs: Sequence[Run]) -> list[tuple[str, tuple[str, ...]]]:
    """Return a figure, or its panels if their needs differ, with the data that each run lacks."""
    kind = FIGURES[name]
    if kind.draw is not None:
        return [(name, find_lacks(runs, kind.needs))]
    chosen = kind.choose_panels(runs)
    if not kind.is_usual and not chosen:
        return []
    if not kind.panels:
        return [(name, find_lacks(runs, kind.needs))]
    parts = [panel for panel in kind.panels if panel.is_usual or panel in chosen]
    if not chosen or len({(panel.needs, panel.loop) for panel in parts}) == 1:
        return [(name, parts[0].find_lacks(runs))]
    return [(f"{name} ({panel.name})", panel.find_lacks(runs)) for panel in parts]


def _describe(words: str, lacking: Sequence[int], parts: Sequence[str], runs: Sequence[Run]) -> str:
    listed = ", ".join(parts)
    if len(lacking) == len(runs):
        return f"left out {listed}: needs {words}"
    labels = label_runs(runs)
    named = ", ".join(labels[number] for number in lacking[:_MOST_NAMED])
    more = f" and {len(lacking) - _MOST_NAMED} more" if len(lacking) > _MOST_NAMED else ""
    return f"left {named}{more} out of {listed}: needs {words}"
