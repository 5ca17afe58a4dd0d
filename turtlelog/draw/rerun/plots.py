"""The curves and level lines of a run, their plots, and their drawing."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from turtlelog.charts import palette, plotted_curves
from turtlelog.charts.curves import Level, Values
from turtlelog.charts.plotted_curves import CurveKind, PlottedCurve, TimePlot
from turtlelog.charts.time_plots import find_plot
from turtlelog.draw.rerun import entities
from turtlelog.draw.rerun.entities import join_path
from turtlelog.draw.rerun.recording_stream import RunStream, Times, build_index
from turtlelog.run import Run

_REFERENCE_WIDTH: Final = 1.0
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
            widths=[_REFERENCE_WIDTH] * count,
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
