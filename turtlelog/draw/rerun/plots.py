"""Plots over time of a run: curves, level lines, marks, vertical lines, phases and events."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from turtlelog.charts import palette, plotted_curves
from turtlelog.charts.curve_marks import MarkShape, list_characteristics
from turtlelog.charts.curves import Level, LoopStep, Values, find_steps
from turtlelog.charts.plotted_curves import CurveKind, PlottedCurve, TimePlot
from turtlelog.charts.time_plots import find_marked, find_plot
from turtlelog.draw.rerun import entities
from turtlelog.draw.rerun.entities import join_path
from turtlelog.draw.rerun.recording_stream import RunStream, Times, build_index
from turtlelog.measure import Metric
from turtlelog.run import Run
from turtlelog.run.loops import DONE, PAUSE
from turtlelog.theory import compute_sampled_step_response

LINE_WIDTH: Final = 1.5
_THIN_WIDTH: Final = 1.25

_WIDTHS: Final[Mapping[CurveKind, float]] = {
    "measured": _THIN_WIDTH,
    "applied": _THIN_WIDTH,
    "shaped": _THIN_WIDTH,
    "ideal": 1.0,
    "aim": 1.0,
    "sensed": 0.75,
    "dropped_out": 2.5,
    "outlier": 4.0,
}
"""Widths of lines and sizes of points [points]. The run's own curve has `LINE_WIDTH`."""

_COMPARED: Final[frozenset[CurveKind]] = frozenset({"run", "measured", "outlier"})
"""Kinds of curves in a view of several runs, without theory, which would cover other curves."""

_COMMANDED_WIDTH: Final = 3.0
"""Width of commands, so that commands are visible on the noise of measured rates [points]."""

Marker = Literal["circle", "cross", "diamond", "up", "down"]

_MARKERS: Final[Mapping[CurveKind, Marker]] = {
    "sensed": "circle",
    "dropped_out": "cross",
    "outlier": "cross",
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Series:
    """Curves that share their times and plot.

    The first part of the entity path names the plot; for a state of a law, the first two parts.
    """

    entity: str  # entity path below the run's prefix
    labels: tuple[str, ...]  # legend, one per curve
    colors: tuple[palette.Color, ...] = (palette.MAIN,)  # colour of each curve
    time_ns: NDArray[np.int64]  # the run's own time [ns], shape (n,), not decreasing
    values: Values  # one column per curve, shape (n, curves); NaN where nothing is drawn
    width: float = LINE_WIDTH  # width of the lines [points]
    holds: bool = False  # whether a value is held until the next one instead of interpolated
    is_main: bool = True  # whether the curves are the run's own motion
    is_measured: bool = True  # whether they are measured, so that the plot's range includes them
    marker: Marker | None = None  # shape of points; None: lines

    @property
    def plot(self) -> str:
        """Plot of the curves. Each state of a law has its own plot."""
        parts = self.entity.split("/")
        return "/".join(parts[: 1 + (parts[0] == entities.STATE)])


@dataclass(frozen=True, slots=True, kw_only=True)
class LevelLines:
    """Level lines across a plot."""

    plot: str  # entity of the plot
    levels: tuple[Level, ...]  # levels in the plot's unit, increasing
    name: str = ""  # common name in a legend; empty: each level has its own name
    color: palette.Color = palette.IDEAL  # colour of the lines


def list_series(run: Run, kinds: frozenset[CurveKind] | None = None) -> tuple[Series, ...]:
    """Return the curves with data, of some or all kinds. A single row gives no curve."""
    groups = entities.GROUPS.items()
    states = [group.names for group in plotted_curves.group_states(run.declaration)]
    found = [
        *(series for name, plots in groups for series in _list_group(run, name, plots, kinds)),
        *(series for names in states for series in _list_states(run, names)),
    ]
    return tuple(
        curves
        for curves in found
        if len(curves.time_ns) > 1 or curves.entity.endswith(f"/{entities.OUTLIERS}")
    )


def list_compared_series(run: Run, name: str, color: palette.Color) -> tuple[Series, ...]:
    """Return the curves for a comparison, with the run's name and colour.

    Positions are included only if no track is known.
    """
    main = list_series(run, _COMPARED)
    has_track = any(series.entity == entities.ALONG_TRACK for series in main)
    measured = {series.plot for series in main if series.entity.endswith(f"/{entities.MEASURED}")}
    found = []
    for series in main:
        if has_track and series.entity == entities.POSITION:
            continue
        is_beside = series.plot in measured and not series.entity.endswith(entities.MEASURED)
        labels: tuple[str, ...] = (f"{name} {series.labels[0]}" if is_beside else name,)
        if len(series.labels) > 1:
            labels = tuple(f"{labels[0]} {label}" for label in series.labels)
        colors, width = (color,) * len(labels), _THIN_WIDTH if is_beside else LINE_WIDTH
        found.append(replace(series, labels=labels, colors=colors, width=width))
    return tuple(found)


def list_references(runs: Sequence[Run]) -> tuple[LevelLines, ...]:
    """Return references of loops, goals, limits and zeros of errors; each once per plot."""
    found = []
    for name, plots in entities.GROUPS.items():
        shown = [run for run in runs if any(plotted_curves.has_own(run, plot) for plot in plots)]
        levels = [level for plot in plots for level in plotted_curves.list_plot_levels(shown, plot)]
        levels = sorted({*levels}, key=lambda level: (level.value, level.label))
        found.append((name, levels))
        if plots[0].is_log:
            kept = plotted_curves.list_plot_levels(shown, plots[0], "log")
            logs = [replace(one, value=float(np.log10(one.value))) for one in kept if one.value]
            found.append((entities.name_logarithm(name), logs))
    return tuple(LevelLines(plot=name, levels=tuple(levels)) for name, levels in found if levels)


def draw_series(run_stream: RunStream, series: Series) -> None:
    """Draw curves into their plot."""
    names, colors = series.labels, palette.pack_colors(series.colors)
    style: rr.AsComponents
    if series.marker is not None:
        sizes, markers = [series.width] * len(names), [series.marker] * len(names)
        style = rr.SeriesPoints(names=names, colors=colors, markers=markers, marker_sizes=sizes)
    else:
        style = rr.SeriesLines(
            names=names,
            colors=colors,
            widths=[series.width] * len(names),
            interpolation_mode="StepAfter" if series.holds else "Linear",
            aggregation_policy="MinMax",
        )
    run_stream.log(series.entity, style)
    run_stream.send(
        series.entity,
        series.time_ns,
        series.values,
        lambda values: rr.Scalars.columns(scalars=values),
    )


def draw_references(
    stream: rr.RecordingStream, references: Sequence[LevelLines], span: Mapping[str, Times]
) -> None:
    """Draw level lines across plots, over a span of every timeline."""
    index = build_index(span)
    for reference in references:
        part = "limits" if reference.color != palette.IDEAL else ""
        entity = join_path(entities.REFERENCE, reference.plot, part)
        count = len(reference.levels)
        style = rr.SeriesLines(
            names=[reference.name or level.label for level in reference.levels],
            colors=palette.pack_colors([reference.color] * count),
            widths=[1.0] * count,
        )
        stream.log(entity, style, static=True)
        columns = rr.Scalars.columns(
            scalars=np.tile([level.value for level in reference.levels], (2, 1))
        )
        stream.send_columns(entity, index, columns)


def _list_group(
    run: Run,
    name: str,
    plots: Sequence[TimePlot],
    kinds: frozenset[CurveKind] | None = None,
) -> Iterator[Series]:
    """Yield the curves of plots with a common entity, such as x and y, for each kind."""
    if kinds is not None and not plots[0].is_compared:
        return
    listed = [plotted_curves.list_plotted(run, plot, kinds) for plot in plots]
    for column in zip(*(_split(curves) for curves in listed), strict=False):
        first = column[0]
        alike = [one for one in column if len(one.curve.time_ns) == len(first.curve.time_ns)]
        colors = (palette.MAIN, palette.tint(palette.MAIN))[: len(alike)]
        series = Series(
            entity="/".join(part for part in (name, _name_part(first)) if part),
            labels=tuple(one.label for one in alike),
            colors=tuple(
                palette.choose_curve_color(first.kind, color, is_alone=True) for color in colors
            ),
            time_ns=first.curve.time_ns,
            values=np.column_stack([one.curve.values for one in alike]),
            width=_COMMANDED_WIDTH
            if first.kind == "run" and plots[0].command is not None
            else _WIDTHS.get(first.kind, LINE_WIDTH),
            holds=first.curve.holds,
            is_main=first.kind in ("run", "measured"),
            is_measured=first.kind in plotted_curves.OWN,
            marker=_MARKERS.get(first.kind),
        )
        yield series
        if plots[0].is_log and first.kind not in plotted_curves.POINTS:
            # In a logarithm of magnitudes, exponential curves are straight.
            sizes = np.abs(series.values)
            logs = np.log10(sizes, out=np.full_like(sizes, np.nan), where=sizes > 0.0)
            entity = entities.name_logarithm(name) + series.entity.removeprefix(name)
            yield replace(series, entity=entity, values=logs)


def _split(curves: Sequence[PlottedCurve]) -> list[PlottedCurve]:
    """Return curves with numbers in their names, if several share a legend entry."""
    seen: dict[str, int] = {}
    found = []
    for one in curves:
        number = seen[one.entry.name] = seen.get(one.entry.name, 0) + 1
        name = one.entry.name if number == 1 else f"{one.entry.name}/{number}"
        found.append(replace(one, entry=replace(one.entry, name=name)))
    return found


def _name_part(found: PlottedCurve) -> str:
    """Return the last part of an entity: later names are on top, and commands above the run."""
    if found.kind == "measured":
        return entities.MEASURED
    if found.kind == "outlier":
        return f"{entities.MEASURED}/{entities.OUTLIERS}"
    return found.entry.name


def _list_states(run: Run, names: Sequence[str]) -> Iterator[Series]:
    colors = palette.choose_run_colors(len(names))
    for name, color in zip(names, colors, strict=True):
        for series in _list_group(run, f"{entities.STATE}/{name}", [find_plot(name, [run])]):
            yield replace(series, colors=(color,))


Shape = Literal["Circle", "Square", "Cross"]

_SHAPES: Final[Mapping[MarkShape, Shape]] = {"disc": "Circle", "square": "Square", "cross": "Cross"}
"""Mark shapes of the viewer."""

_MINOR: Final = frozenset({"rise_time", "time_to_goal"})
"""Metrics that neighbouring metrics bound: a rise ends before the curve settles."""

_MARK_SIZE: Final = 4.0  # [points]
_DECADES: Final = 10.0 ** -np.arange(8.0)
_MOST_SAMPLES: Final = 1_000_000
_MOST_DEAD_SAMPLES: Final = 1000


@dataclass(frozen=True, slots=True, kw_only=True)
class Mark:
    """A metric at its point of a curve."""

    plot: str  # plot of the curve
    label: str  # legend text with the value. The name of the curve in a plot contains this text
    sign: str  # shape as a letter, because a legend shows only a dot
    shape: Shape  # Rerun's name of a marker
    time_ns: int  # time in the run's own time [ns]
    level: float  # value in the unit of the curve
    is_minor: bool = False  # whether a full legend may leave it out

    @property
    def entity(self) -> str:
        """Entity path of all marks of the plot, below the run's prefix."""
        return f"{self.plot}/{entities.MARKS}"


def list_marks(
    run: Run, series: Sequence[Series], metrics: Mapping[str, Metric]
) -> tuple[Mark, ...]:
    """Return the metrics that can be marked on a drawn curve."""
    curves = {curve.entity: curve for curve in series}
    marks = []
    for found in list_characteristics(run, metrics):
        name, entry = find_marked(found.signal) or ("", None)
        curve = curves.get("" if entry is None else _join(entities.name_plot(name), entry.name))
        if found.shape is None or curve is None or found.level is None:
            continue
        if found.kind == "dead_time":
            continue  # dead times have a bar of their own
        marks.append(
            Mark(
                plot=curve.plot,
                label=found.text,
                sign=found.sign,
                shape=_SHAPES[found.shape],
                time_ns=run.start_ns + round(found.marked_s * 1e9),
                level=found.level,
                is_minor=found.kind in _MINOR,
            )
        )
    return tuple(marks)


def _join(*parts: str) -> str:
    return "/".join(filter(None, parts))


def draw_marks(run_stream: RunStream, marks: Sequence[Mark]) -> None:
    """Draw each metric as a point whose name in the legend contains the value."""
    for entity in dict.fromkeys(mark.entity for mark in marks):
        found = [mark for mark in marks if mark.entity == entity]
        style = rr.SeriesPoints(
            names=[mark.label for mark in found],
            colors=palette.pack_colors([palette.MAIN] * len(found)),
            markers=[mark.shape for mark in found],
            marker_sizes=[_MARK_SIZE] * len(found),
        )
        run_stream.log(entity, style)
        # One row per mark; the others are NaN in it.
        levels = np.full((len(found), len(found)), np.nan)
        np.fill_diagonal(levels, [mark.level for mark in found])
        times_ns = [mark.time_ns for mark in found]
        run_stream.send_few(entity, times_ns, rr.Scalars.columns(scalars=levels))


def draw_lines(
    run_stream: RunStream,
    entity: str,
    label: str,
    color: palette.Color,
    times_ns: Sequence[int],
    *,
    largest: float,
) -> None:
    """Draw vertical lines at times [ns] up to the `largest` value, for plots with a fixed range."""
    style = rr.SeriesLines(
        names=[label],
        colors=palette.pack_colors([color]),
        widths=[1.0],
        aggregation_policy="Off",
    )
    run_stream.log(entity, style)
    # The viewer cannot draw a line thousands of plot heights long: the line has powers of ten as
    # points.
    steps = largest * _DECADES
    line = [*-steps, *steps[::-1], np.nan]
    levels = np.tile(line, len(times_ns))
    run_stream.send_few(entity, np.repeat(times_ns, len(line)), rr.Scalars.columns(scalars=levels))


def list_responses(run: Run, metrics: Mapping[str, Metric]) -> tuple[Series, ...]:
    """Return the response of each loop with the measured dead time, without limits.

    A loop has no response if its reference moves, theory does not know the loop, or its gain or
    dead time is unknown.
    """
    found: list[Series] = []
    for signal in dict.fromkeys(loop.signal for loop in run.declaration.loops):
        for number, step in enumerate(find_steps(run, signal)):
            if step.end_ns > step.start_ns:
                of = step.loop.name if number else ""
                dead_time = metrics.get(f"{step.loop.name}.dead_time")
                found += _compute_sampled(step, of, run, dead_time)
    return tuple(found)


def draw_phases(run_stream: RunStream, run: Run) -> None:
    """Draw the phases as a bar, which ends in `done` unless the run was cut off."""
    spans = run.find_phase_spans()
    if not spans:
        return
    style = rr.StateConfiguration(
        values=list(run.phase_names),
        # The pause is too short for its name; the view's title explains its colour.
        labels=[" " if name == PAUSE else name for name in run.phase_names],
        colors=palette.pack_colors(palette.choose_phase_colors(run.phase_names)),
    )
    prefix = entities.locate_phases(run_stream.prefix)
    phases = RunStream(run_stream.stream, prefix, run_stream.timelines)
    phases.log("", style)
    last = DONE if run.is_complete else ""
    columns = rr.StateChange.columns(state=[*(span.phase for span in spans), last])
    starts_ns = [*(span.start_ns for span in spans), run.end_ns]
    phases.send_few("", starts_ns, columns)


def list_events(run_stream: RunStream, run: Run, speaker: str = "") -> None:
    """List the events as a text log, each after a given speaker's name."""
    if not run.events:
        return
    columns = rr.TextLog.columns(
        text=[f"{speaker}: {event.text}" if speaker else event.text for event in run.events],
        level=["INFO" if event.kind == "stop" else "WARN" for event in run.events],
    )
    run_stream.send_few(entities.EVENTS, [event.time_ns for event in run.events], columns)


def _compute_sampled(
    step: LoopStep, of: str, run: Run, dead_time: Metric | None
) -> Iterator[Series]:
    steps_ns = np.diff(run.samples.time_ns)
    if dead_time is None or dead_time.value is None or not (steps_ns > 0).any():
        return
    period_s = float(np.median(steps_ns[steps_ns > 0])) / 1e9
    delay = round(dead_time.value / period_s)
    count = int((step.end_ns - step.start_ns) / 1e9 / period_s) + 1
    # Without a dead time it would be drawn over the ideal response.
    if count > _MOST_SAMPLES or not 0 < delay <= _MOST_DEAD_SAMPLES:
        return
    values = compute_sampled_step_response(
        step.kp,
        count,
        period_s=period_s,
        dead_time_ticks=delay,
        initial=step.initial,
        reference=step.reference,
    )
    label = f"+ {dead_time.value * 1e3:.3g} ms dead time"
    time_s = np.arange(count) * period_s
    yield Series(
        entity=_join(entities.name_plot(step.loop.signal), entities.SAMPLED, of),
        labels=(f"{label}, {of}" if of else label,),
        colors=(palette.IDEAL,),
        time_ns=step.start_ns + np.rint(time_s * 1e9).astype(np.int64),
        values=values[:, np.newaxis],
        width=1.0,
        is_main=False,
        is_measured=False,
    )
