"""Comparisons as Rerun recordings: several runs in the same views, or a robot and its model."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from turtlelog.charts import many_runs, palette
from turtlelog.charts.close_up import name_ends
from turtlelog.charts.curves import Values
from turtlelog.charts.many_runs import has_grey_paths
from turtlelog.charts.plane_scene import move_near
from turtlelog.charts.time_plots import TIME_PLOTS, label_error
from turtlelog.compare import ErrorBand, RobotComparison, name_runs, order_by_gain
from turtlelog.compare.robot_comparison import SHOWN_UNITS
from turtlelog.draw.rerun import entities, layout, pictures, plane, plots, recording_stream, turtles
from turtlelog.draw.rerun.content import (
    Content,
    describe_content,
    find_corners,
    find_heading_close_up,
    find_ranges,
)
from turtlelog.draw.rerun.entities import RUNS, join_path
from turtlelog.draw.rerun.recording_stream import RunStream, Timelines, open_recording
from turtlelog.draw.rerun.turtles import Look
from turtlelog.draw.written_tables import document_runs
from turtlelog.errors import ShowError
from turtlelog.identify import AxisTraces, RobotModel, trace_axis
from turtlelog.measure import measure_run
from turtlelog.run import Run, list_runs

_THIN_WIDTH: Final = 1.0
_OF_MANY: Final = Look(color=palette.PATH_OF_MANY, width=0.75)
"""Style of the paths of very many runs; only their ends have colours."""
_MOST_EXTREMES: Final = 3  # runs that are named in the plane; more names would hide the paths

_EXTREME_SHARE: Final = 0.2
"""Smallest distance of a name from goal and names, in half a plane; nearer, it covers others."""


def write_comparison_rrd(
    runs: Run | Iterable[Run],
    path: str | Path,
    *,
    documents: Mapping[str, str] | None = None,
    size: tuple[int, int] | None = None,
) -> None:
    """Write one recording of several runs. Time zero is the first sample of each run.

    On the timeline of a later phase, such as `translate_time`, time zero is the start of that
    phase.

    Args:
        runs: Runs, at least one; each has one colour in every view, in the order of
            `order_by_gain`.
        path: The .rrd file. An existing file is replaced when the new one is complete.
        documents: Markdown texts by title, shown as tabs. Default: those of `document_runs`.
        size: Size of the window [pixels], as in `write_run_rrd`.

    Raises:
        ShowError: If there is no run, or the file cannot be written.
    """
    runs = list_runs(runs)
    if not runs:
        raise ShowError(f"{path}: a comparison needs at least one run")
    runs = order_by_gain(runs)
    metrics = [measure_run(run) for run in runs]
    if documents is None:
        documents = document_runs(runs, metrics=metrics)
    documents = recording_stream.add_thinning(documents, runs)
    groups = many_runs.group_equal(runs)
    near, origin = move_near(runs)
    overlay = _build_overlay([near[first] for first, *_ in groups], _name_groups(runs, groups))
    equal = [name for name, group in zip(overlay.names, groups, strict=True) if len(group) > 1]
    content = replace(
        overlay.describe(documents),
        is_small=layout.is_small(size),
        equal="; ".join(equal),
        origin=origin,
    )
    views, names = layout.build_comparison_layout(content), overlay.names
    brief = f"{names[0]} to {names[-1]}, {len(names)} runs"
    name = ", ".join(names) if len(names) <= 4 else brief
    with open_recording(path, name=name, layout=views) as stream:
        drawn = {number: place for place, group in enumerate(groups) for number in group}
        prefixes = [overlay.prefixes[drawn[number]] for number in range(len(runs))]
        recording_stream.send_comparison_properties(
            stream, runs, name_runs(runs), prefixes, metrics
        )
        _draw_overlay(stream, overlay, content)
        recording_stream.draw_documents(stream, documents)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Overlay:
    """Several runs with names and colours. All sequences have the same order."""

    runs: tuple[Run, ...]  # at least one
    names: tuple[str, ...]  # different names of the runs
    prefixes: tuple[str, ...]  # entity prefixes
    colors: tuple[palette.Color, ...]  # colours of the runs in every view
    timelines: tuple[Timelines, ...]  # aligned at the first samples
    series: tuple[tuple[plots.Series, ...], ...]  # curves of each run
    references: tuple[plots.LevelLines, ...]  # common level lines
    restless: frozenset[int] = frozenset()  # runs among many that never come to rest
    scale: many_runs.GainScale | None = None  # the only number in which many runs differ

    def describe(self, documents: Mapping[str, str]) -> Content:
        """Return the content of the recording."""
        content = describe_content(
            self.runs, self.prefixes, self.series, self.references, documents, names=self.names
        )
        if content.legend_names:
            brief = many_runs.cut_names(self.name_briefly())
            content = replace(content, legend_names=brief)
        calm = [number for number in range(len(self.runs)) if number not in self.restless]
        if (scale := self.scale) is not None:
            span = f"{min(scale.values):g} to {max(scale.values):g}"
            title = f"{len(scale.values)} runs, coloured by {scale.word}: {span}"
            content = replace(content, scale_title=title, scale_span=f"{scale.word} {span}")
        if not self.restless:
            return content
        settled = [self.runs[number] for number in calm]
        ranges = {
            **content.ranges,
            **find_ranges([self.series[number] for number in calm], self.references),
            **find_heading_close_up(settled),
        }
        lasting = max(run.end_ns - run.start_ns for run in settled) / 1e9
        longest = max(run.end_ns - run.start_ns for run in self.runs) / 1e9
        return replace(
            content,
            ranges=ranges,
            end_s=lasting if lasting < longest else None,
            length_s=longest,
            restless=many_runs.join_run_names(sorted(self.restless), self.names, self.scale),
            notes={**content.notes, **self._name_beyond(ranges)},
        )

    def _name_beyond(self, ranges: Mapping[str, tuple[float, float]]) -> dict[str, str]:
        """Return the restless runs that exceed the range of each plot that shows them."""
        found: dict[str, list[int]] = {}
        for number in sorted(self.restless):
            for series in self.series[number]:
                low, high = ranges.get(series.plot, (-np.inf, np.inf))
                values = series.values[np.isfinite(series.values)]
                if ((values < low) | (values > high)).any():
                    found.setdefault(series.plot, []).append(number)
        return {
            plot: f"{many_runs.join_run_names(numbers, self.names, self.scale)} beyond"
            for plot, numbers in found.items()
        }

    def name_briefly(self) -> tuple[str, ...]:
        """Return short names of the runs."""
        if self.scale is None or len({*self.scale.values}) < len(self.runs):
            return many_runs.cut_alike(self.names)
        return tuple(map(self.scale.name_run, range(len(self.runs))))


def _name_groups(runs: Sequence[Run], groups: Sequence[Sequence[int]]) -> list[str]:
    """Return a name for each group of equal runs. One run of a group is drawn with all names."""
    names = name_runs(runs)
    firsts = [runs[first] for first, *_ in groups]
    brief = many_runs.shorten_run_names(firsts, [names[first] for first, *_ in groups])
    told = []
    for name, group in zip(brief, groups, strict=True):
        same = [names[number] for number in group]
        if len(group) == 1:
            told.append(name)
        elif name not in same:
            told.append(f"{name} ({len(group)} equal runs)")
        elif len(group) == 2:
            told.append(f"{same[0]} and {same[1]} are equal")
        else:
            told.append(f"{name} and {len(group) - 1} more are equal")
    return told


def _build_overlay(runs: Sequence[Run], names: Sequence[str]) -> _Overlay:
    # Without spaces, which look like escapes.
    parts = [entities.name_part(name) for name in names]
    if len({*parts}) < len(parts):
        parts = [rr.escape_entity_path_part(name) for name in names]
    colors = many_runs.choose_colors_by_value(runs)
    restless = many_runs.find_restless(runs) if len(runs) > many_runs.MANY else frozenset()
    # The legend of the along-track plot has no room for more names than those of the runs.
    references = [
        found for found in plots.list_references(runs) if found.plot != entities.ALONG_TRACK
    ]
    return _Overlay(
        runs=tuple(runs),
        names=tuple(names),
        prefixes=tuple(join_path(RUNS, part) for part in parts),
        colors=colors,
        timelines=tuple(recording_stream.build_compared_timelines(run) for run in runs),
        series=tuple(
            _list_series(run, names[number], colors[number], is_restless=number in restless)
            if len(runs) > many_runs.MANY
            else plots.list_compared_series(run, names[number], colors[number])
            for number, run in enumerate(runs)
        ),
        references=tuple(references),
        restless=restless,
        scale=many_runs.find_color_scale(runs),
    )


def _list_series(
    run: Run, name: str, color: palette.Color, *, is_restless: bool
) -> tuple[plots.Series, ...]:
    """Return the curves of a run among many, without oscillating commands, which hide others."""
    found = plots.list_compared_series(run, name, color)
    if is_restless:
        found = tuple(series for series in found if series.plot not in entities.RESTLESS)
        color = palette.dim(color)
    return tuple(
        replace(series, colors=(color,) * len(series.colors), width=min(series.width, _THIN_WIDTH))
        for series in found
    )


def _draw_overlay(stream: rr.RecordingStream, overlay: _Overlay, content: Content) -> None:
    plane.draw_world(stream, overlay.runs)
    span = recording_stream.read_span(overlay.runs, overlay.timelines)
    plots.draw_references(stream, overlay.references, span)
    if overlay.scale is not None:
        pictures.draw_scale(stream, overlay.scale, overlay.colors)
    elif content.legend_names:
        pictures.draw_legend(stream, content.legend_names, overlay.colors)
    if len(overlay.runs) > many_runs.MANY:
        _show_ends(stream, overlay, content)
    for number, run in enumerate(overlay.runs):
        run_stream = RunStream(stream, overlay.prefixes[number], overlay.timelines[number])
        look = Look(
            color=overlay.colors[number], size=palette.choose_turtle_size(len(overlay.runs))
        )
        way = _OF_MANY if has_grey_paths(overlay.runs) else look
        turtles.draw_trail(run_stream, run, way, segments=turtles.count_segments(len(overlay.runs)))
        plane.draw_reference_path(run_stream, run)
        turtles.draw_turtle(run_stream, run.poses, look, content.plane.half_size_m)
        plots.draw_phases(run_stream, run)
        plots.list_events(run_stream, run, overlay.names[number])
        for curves in overlay.series[number]:
            plots.draw_series(run_stream, curves)
    if content.goal is not None:
        plane.draw_close_up(
            stream,
            name_ends(content.goal, overlay.name_briefly()),
            overlay.runs[0],
            overlay.prefixes,
            overlay.colors,
            lettering=plane.SMALL_LETTERING if content.is_small else plane.LETTERING,
        )
    if content.worst is not None:
        plane.draw_worst_place(stream, content.worst, overlay.colors[content.worst.run])


def _show_ends(stream: rr.RecordingStream, overlay: _Overlay, content: Content) -> None:
    """Name the runs that end furthest from the goal at their ends; of very many, show all ends."""
    if has_grey_paths(overlay.runs):
        plane.draw_ends(stream, overlay.runs, overlay.colors)
    if content.goal is None:
        return
    misses = [(_miss(run), number) for number, run in enumerate(overlay.runs)]
    least_m, furthest = _EXTREME_SHARE * content.plane.half_size_m, list[int]()
    for miss_m, number in sorted(misses, reverse=True):
        place = overlay.runs[number].poses.xy_m[-1]
        ways = [place - overlay.runs[other].poses.xy_m[-1] for other in furthest]
        if miss_m > least_m and all(np.hypot(*way) > least_m for way in ways):
            furthest.append(number)
    furthest = furthest[:_MOST_EXTREMES]
    if not furthest:
        return
    places = [overlay.runs[number].poses.xy_m[-1] for number in furthest]
    brief = overlay.name_briefly()
    names = [brief[number] for number in furthest]
    plane.log_words(
        stream, entities.EXTREMES, places, names, [overlay.colors[number] for number in furthest]
    )


def _miss(run: Run) -> float:
    return 0.0 if run.goal_xy_m is None else float(np.hypot(*(run.poses.xy_m[-1] - run.goal_xy_m)))


_TIMELINE: Final = "robot_time"
_RESIDUAL: Final = "residual"

_CURVES: Final[tuple[tuple[str, palette.Color, float], ...]] = (
    ("commanded", palette.REFERENCE, 1.5),
    ("measured", palette.MEASURED, 1.0),
    ("modelled", palette.MODEL, 2.5),
    (_RESIDUAL, palette.ERROR, 1.0),
)
"""Curves of each axis, in order, with widths [points]; noise must not hide the model."""


def write_robot_rrd(model: RobotModel, run: Run, path: str | Path) -> None:
    """Write a recording of the axes that a model knows, for a run.

    Args:
        model: Result of `turtlelog.identify_robot`.
        run: Run whose motion is shown: an identified run, or another run.
        path: The .rrd file. An existing file is replaced when the new one is complete.

    Raises:
        ShowError: If no axis is known, or the file cannot be written.
    """
    traces = [trace_axis(axis, run) for axis in model.axes if axis.is_known]
    if not traces:
        reasons = "; ".join(axis.reason for axis in model.axes)
        raise ShowError(f"{path}: no axis was identified: {reasons}")
    views = [view for found in traces for view in _list_views(found)]
    shares = [2.0, 1.0] * len(traces)
    linked = layout.link_views(rrb.Vertical(*views, row_shares=shares))
    with open_recording(path, name=f"{run.name}, identified", layout=linked) as stream:
        for found in traces:
            _draw_axis(stream, found)


def _list_views(found: AxisTraces) -> list[rrb.View]:
    """Return a view of the rates of an axis, and a view of the model's residuals."""
    title = TIME_PLOTS[found.axis].label
    rates = [f"/{found.axis}/{name}" for name, _, _ in _CURVES if name != _RESIDUAL]
    low, high = float(np.nanmin(found.commanded)), float(np.nanmax(found.commanded))
    command = plots.Series(
        entity="command",
        labels=(title,),
        time_ns=np.rint(found.time_s * 1e9).astype(np.int64),
        values=found.commanded[:, np.newaxis],
    )
    limits = (low, high if high > low else low + 1.0)
    corner = find_corners([command], {command.plot: limits})[command.plot]
    legend, hidden = rrb.PlotLegend(rrb.Corner2D[corner]), rrb.PlotLegend(visible=False)
    residual = [f"/{found.axis}/{_RESIDUAL}"]
    return [
        layout.view_curves(title, rates, None, legend),
        layout.view_curves(f"residual: {title}", residual, None, hidden),
    ]


def _draw_axis(stream: rr.RecordingStream, found: AxisTraces) -> None:
    for name, color, width in _CURVES:
        values = getattr(found, name)
        _draw_curve(stream, f"/{found.axis}", name, color, found.time_s, values, widths=[width])


def _draw_curve(
    stream: rr.RecordingStream,
    origin: str,
    name: str,
    color: palette.Color,
    time_s: Values,
    values: Values,
    **looks: Any,
) -> None:
    entity = f"{origin}/{name.replace(' ', '_')}"
    style = rr.SeriesLines(names=name, colors=palette.pack_colors([color]), **looks)
    stream.log(entity, style, static=True)
    time_ns = np.rint(time_s * 1e9).astype("timedelta64[ns]")
    index = [rr.TimeColumn(_TIMELINE, duration=time_ns)]
    stream.send_columns(entity, index, rr.Scalars.columns(scalars=values))


_PLANE: Final = "/plane"
_PATH_PIXELS: Final = 1.2


def write_prediction_rrd(found: RobotComparison, path: str | Path) -> None:
    """Write a recording of a recorded robot next to a simulated robot.

    Args:
        found: Result of `turtlelog.compare.compare_robot`.
        path: The .rrd file. An existing file is replaced when the new one is complete.

    Raises:
        ShowError: If the file cannot be written.
    """
    longest = [band for band in found.bands if band.horizon_s == found.bands[-1].horizon_s]
    errors = [
        rrb.TimeSeriesView(
            origin=f"/errors/{band.quantity}",
            name=f"{label_error(band.quantity)} after {band.horizon_s:g} s",
            axis_x=rrb.TimeAxis(link="LinkToGlobal"),
        )
        for band in longest
    ]
    rates = [view for traces in found.traces for view in _list_views(traces)[:1]]
    plane = rrb.Spatial2DView(
        origin=_PLANE,
        name="recorded path, and predictions that begin on it",
        background=palette.GROUND,
    )
    linked = layout.link_views(
        rrb.Horizontal(plane, rrb.Vertical(*errors, *rates), column_shares=[1.0, 1.2])
    )
    name = f"{found.name} beside {found.scenario}"
    with open_recording(path, name=name, layout=linked) as stream:
        _draw_plane(stream, found)
        for band in longest:
            _draw_errors(stream, band, found.start_s)
        for traces in found.traces:
            _draw_axis(stream, traces)


def _draw_plane(stream: rr.RecordingStream, found: RobotComparison) -> None:
    flip = np.array([1.0, -1.0])  # a 2D view has y downward
    pieces = [piece * flip for piece in found.predict_pieces()]
    # The recorded path is below, and visible on both sides.
    for name, strips, color, pixels in (
        ("recorded", [found.recorded.xy_m * flip], palette.MEASURED, 2.0 * _PATH_PIXELS),
        ("simulated", pieces, palette.MODEL, _PATH_PIXELS),
    ):
        looks: dict[str, Any] = {"draw_order": -pixels, "labels": [name], "show_labels": False}
        packed = palette.pack_colors([color])
        plane.log_strips(stream, f"{_PLANE}/{name}", strips, packed, pixels, **looks)
    starts, packed = [piece[0] for piece in pieces], palette.pack_colors([palette.MODEL])
    plane.log_points(stream, f"{_PLANE}/begins", starts, packed, 4.0 * _PATH_PIXELS)


def _draw_errors(stream: rr.RecordingStream, band: ErrorBand, start_s: float) -> None:
    _, factor = SHOWN_UNITS[band.quantity]
    curves: list[tuple[str, Values | None, palette.Color]] = [
        ("recorded", band.recorded, palette.MEASURED),
        ("least simulated", band.low, palette.REFERENCE),
        ("largest simulated", band.high, palette.REFERENCE),
    ]
    for name, values, color in curves:
        if values is not None:
            origin, time_s = f"/errors/{band.quantity}", band.time_s + start_s
            _draw_curve(stream, origin, name, color, time_s, factor * values)
