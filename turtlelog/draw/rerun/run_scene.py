"""One run as a Rerun recording; also one that opens at the violation of a check."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from textwrap import shorten
from typing import Any, Final, NamedTuple

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.components import AbsoluteTimeRange

from turtlelog.charts import palette
from turtlelog.charts.curve_marks import ViolatedSignal
from turtlelog.charts.curves import Curve, Values, select_curve_rows
from turtlelog.charts.plane_scene import move_near
from turtlelog.charts.time_plots import TIMELINE
from turtlelog.display import cut_name
from turtlelog.draw.rerun import entities, plane, plots, recording_stream, turtles
from turtlelog.draw.rerun.content import Content, describe_content, find_corners, name_legends
from turtlelog.draw.rerun.entities import join_path
from turtlelog.draw.rerun.layout import (
    LEGEND_TITLE,
    build_run_layout,
    build_violation_layout,
    is_small,
    view_curves,
)
from turtlelog.draw.rerun.recording_stream import RunStream
from turtlelog.draw.rerun.turtles import Look
from turtlelog.draw.written_tables import document_run
from turtlelog.escapes import escape_markdown, fence_markdown
from turtlelog.log.ros2.bag_surroundings import Surroundings
from turtlelog.measure import Metric, measure_run
from turtlelog.run import Event, Run, require_run

_RUN: Final = "the run"
_EVENT_LINES: Final = f"{entities.LINES}/event"  # entity of event lines, below that of a plot


def write_run_rrd(
    run: Run,
    path: str | Path,
    *,
    documents: Mapping[str, str] | None = None,
    size: tuple[int, int] | None = None,
    surroundings: Surroundings | None = None,
) -> None:
    """Write a recording of one run with its layout. Time zero is the first sample.

    Args:
        run: Run to show.
        path: The .rrd file. An existing file is replaced when the new one is complete.
        documents: Markdown texts by title, shown as tabs. Default: those of `document_run`.
        size: Size of the window [pixels], if known. In a small window, legends, phases and
            documents are left out, so that curves have room.
        surroundings: Scans and map, drawn below the robot's path.

    Raises:
        ShowError: If the file cannot be written.
    """
    require_run(run)
    scene = build_run_scene(run, documents, size, surroundings)
    with recording_stream.open_recording(
        path, name=run.name, layout=build_run_layout(scene.content)
    ) as stream:
        scene.draw(stream)


class RunScene(NamedTuple):
    """A run with the content of its recording, and its documents by title."""

    single: "Single"
    content: Content
    documents: Mapping[str, str]

    def draw(self, stream: rr.RecordingStream) -> None:
        """Draw everything."""
        draw_single(stream, self.single, self.content)
        recording_stream.draw_documents(stream, self.documents)


def build_run_scene(
    run: Run,
    documents: Mapping[str, str] | None = None,
    size: tuple[int, int] | None = None,
    surroundings: Surroundings | None = None,
) -> RunScene:
    """Return the drawn content of a run; further arguments are as in `write_run_rrd`."""
    single = replace(build_single(run), surroundings=surroundings)
    if documents is None:
        documents = document_run(run, metrics=single.metrics)
    documents = recording_stream.add_thinning(documents, [run])
    content = replace(single.describe(documents), is_small=is_small(size))
    if surroundings is not None:
        plane_bounds = plane.widen_plane(content.plane, surroundings, single.shift_m)
        content = replace(content, plane=plane_bounds)
    return RunScene(single, content, documents)


@dataclass(frozen=True, slots=True, kw_only=True)
class Single:
    """A measured run with everything that is drawn."""

    run: Run  # the run. Far coordinates are relative to its start
    origin: str  # text on this offset
    metrics: Mapping[str, Metric]  # metrics of the run by id
    series: tuple[plots.Series, ...]  # curves of the run and of theory
    references: tuple[plots.LevelLines, ...]  # level lines
    marks: tuple[plots.Mark, ...]  # metrics that can be marked on a curve
    names: Mapping[str, str]  # names of the main curve of each plot
    legends: frozenset[str]  # plots that have a legend
    by_speed: plane.SpeedTrace | None  # path in colours of its speed; None if nothing moves
    ideal: turtles.Ghost | None = None  # the ideal loop; None if theory does not know its poses
    shift_m: Values = field(default_factory=lambda: np.zeros(2))  # added to positions [m], (2,)
    surroundings: Surroundings | None = None  # scans and map of the robot; None if unknown

    def list_lined(self) -> list[str]:
        """Return the plots with event lines, if the run has events."""
        return [*self.names] if plane.list_placed(self.run) else []

    def describe(self, documents: Mapping[str, str]) -> Content:
        """Return the content of the recording."""
        content = describe_content([self.run], [""], [self.series], self.references, documents)
        return replace(
            content,
            corners=find_corners(self.series, content.ranges),
            legends=self.legends,
            origin=self.origin,
            series=(
                *content.series,
                *dict.fromkeys(join_path(mark.entity) for mark in self.marks),
                *(join_path(plot, _EVENT_LINES) for plot in self.list_lined()),
            ),
            arrows=turtles.name_arrows(self.run),
            ghosts=() if self.ideal is None else (self.ideal.prefix,),
            highest_speed_m_s=None if self.by_speed is None else self.by_speed.highest_m_s,
        )


def build_single(run: Run) -> Single:
    """Return a measured run with its curves and marks, named for short legends."""
    metrics, first_m = measure_run(run), run.poses.xy_m[0]
    (run,), origin = move_near([run])
    measured = plots.list_series(run)
    named = name_legends(
        (*measured, *plots.list_responses(run, metrics)),
        plots.list_references([run]),
        plots.list_marks(run, measured, metrics),
    )
    return Single(
        run=run,
        origin=origin,
        metrics=metrics,
        series=named.series,
        references=named.references,
        marks=named.marks,
        names=named.names,
        legends=named.shown,
        by_speed=plane.build_speed_trace(run),
        ideal=turtles.build_ideal_ghost(run),
        shift_m=run.poses.xy_m[0] - first_m,
    )


def draw_single(stream: rr.RecordingStream, single: Single, content: Content) -> None:
    """Draw the run with everything except its documents."""
    run, timelines = single.run, recording_stream.build_run_timelines(single.run)
    recording_stream.send_run_properties(stream, run, single.metrics)
    plane.draw_world(stream, [run])
    if single.surroundings is not None:
        plane.draw_surroundings(stream, single.surroundings, timelines, single.shift_m)
    run_stream = RunStream(stream, "", timelines)
    turtles.draw_trail(run_stream, run, Look(color=palette.MAIN))
    plane.draw_reference_path(run_stream, run)
    plane.draw_sensed(run_stream, run)
    if single.by_speed is not None:
        single.by_speed.draw(run_stream)
    turtles.draw_turtle(run_stream, run.poses, Look(color=palette.MAIN), content.plane.half_size_m)
    if single.ideal is not None:
        turtles.draw_ghost(stream, single.ideal, timelines, content.plane.half_size_m)
        rows = [(_RUN, palette.MAIN), (single.ideal.name, single.ideal.look.color)]
        turtles.draw_key(stream, rows, content.plane, [run])
    turtles.draw_reference_pose(run_stream, run, content.plane.half_size_m)
    turtles.draw_arrows(run_stream, run)
    if content.goal is not None:
        plane.draw_close_up(stream, content.goal, run, [""], [palette.MAIN])
    if content.worst is not None:
        plane.draw_worst_place(stream, content.worst, palette.MAIN)
    plots.draw_phases(run_stream, run)
    if run.events:
        _draw_events(run_stream, single, content)
    plots.draw_references(stream, single.references, recording_stream.read_span([run], [timelines]))
    for curves in single.series:
        plots.draw_series(run_stream, curves)
    plots.draw_marks(run_stream, single.marks)


def _draw_events(run_stream: RunStream, single: Single, content: Content) -> None:
    """Draw the events at the turtle's places, across the plots, and as a log."""
    run, largest = single.run, content.find_largest_shown()
    plane.draw_event_places(run_stream, run)
    times_ns = sorted({event.time_ns for event in plane.list_placed(run)})
    for plot in single.list_lined():
        name, entity = single.names[plot], f"{plot}/{_EVENT_LINES}"
        plots.draw_lines(run_stream, entity, name, palette.MAIN, times_ns, largest=largest)
    plots.list_events(run_stream, run)


_RADIUS: Final = 6.0  # [points], as are the other sizes
_POINT_SIZE: Final = 6.0
_MARKERS: Final = {"first": "circle", "worst": "diamond", "high": "up", "low": "down"}

_SIGNS: Final[Mapping[str, str]] = {"high": "▲", "low": "▼"}
"""Symbols of limits in the legend, because a plot has no text next to its lines."""

_NAMES_OUTSIDE: Final[Mapping[str, str]] = {"worst": "outside", "nearest": "not within"}

_MARK_AT: Final = 0.03
"""Share of a limit at which its mark is; at the start, the plot's edge would cut it."""

_ABOVE_TRACES: Final = 26.0  # lines have 20

_STROKES: Final = 700
"""Number of vertical strokes that fill the band: every other pixel of a window of 1400 pixels."""


_FILL_ALPHA: Final = 64
"""Opacity of strokes, of 255: with one or two overlaps, curves stay brighter than the band."""

_LONGEST_TITLE: Final = 110
"""Longest title [letters of 6.5 pixels]: in a window 1200 pixels wide, there are 850."""

_LONGEST_NAME: Final = 28  # longest name in the plane [letters]: about half of its width


def write_violation_rrd(
    run: Run,
    path: str | Path,
    *,
    at_s: float,
    title: str,
    message: str,
    violated: ViolatedSignal | None = None,
) -> None:
    """Write a recording of one run that opens at a time and marks this time.

    The violated signal is at the top with its band, and is red outside the band. The first and the
    worst violation have labels with value and time. The cursor is at the first violation in every
    plot. The plane has a mark at the turtle's position, and the list of events has a line.

    Args:
        run: Run to show.
        path: The .rrd file. An existing file is replaced when the new one is complete.
        at_s: Time of the violation, from the first sample [s].
        title: A few words, shown next to the mark if there is no signal.
        message: Full message, as printed.
        violated: Violated signal; None if the violation belongs to no signal.

    Raises:
        ShowError: If the file cannot be written.
    """
    at_ns = run.start_ns + round(at_s * 1e9)
    event = Event(time_ns=at_ns, kind="violation", text=f"Violation: {title}")
    events = sorted((*run.events, event), key=lambda found: found.time_ns)
    run = replace(run, events=tuple(events))
    single = build_single(run)
    documents = {"Violation": fence_markdown(message), **document_run(run, metrics=single.metrics)}
    documents = {**recording_stream.add_thinning(documents, [run])}
    if violated is not None:
        documents[LEGEND_TITLE] = _write_legend(violated)
    content = single.describe(documents)
    if violated is None:
        layout = build_run_layout(content)
    else:
        layout = build_violation_layout(content, _view_signal(violated))
    # A layout cannot set the cursor, and a paused cursor is at the start: a loop of no length.
    moment = AbsoluteTimeRange(min=at_ns - run.start_ns, max=at_ns - run.start_ns)
    layout.time_panel = rrb.TimePanel(
        state="collapsed",
        timeline=TIMELINE,
        play_state="playing",
        loop_mode="selection",
        time_selection=moment,
    )
    with recording_stream.open_recording(
        path, name=f"{run.name}: {title}", layout=layout
    ) as stream:
        draw_single(stream, single, content)
        recording_stream.draw_documents(stream, documents)
        row = max(int(run.poses.time_ns.searchsorted(at_ns, side="right")) - 1, 0)
        # If there is a signal, its title names the check.
        word = cut_name(title, _LONGEST_NAME) if violated is None else "first violated"
        place_m, color = run.poses.xy_m[row : row + 1], palette.VIOLATION
        plane.log_points(stream, entities.VIOLATION, place_m, [color], _RADIUS, labels=[word])
        if violated is not None:
            run_stream = RunStream(stream, "", recording_stream.build_run_timelines(run))
            _draw_signal(run_stream, violated)
            _draw_stretch(stream, run, violated)


def _view_signal(violated: ViolatedSignal) -> rrb.View:
    part = violated.find_range()
    shown = violated.describe_moment(violated.worst, violated.worst_word)
    outside = violated.describe_outside(violated.worst)
    shown = f"{shown}, {outside} outside" if outside else shown
    title = f"{violated.title}{', close up' if part.note else ''}: {shown}"
    title = f"{title}; violates {violated.expected or violated.check}"
    title = shorten(title, _LONGEST_TITLE, placeholder="...")
    contents = [f"{join_path(entities.VIOLATED)}/**"]
    return view_curves(title, contents, (part.low, part.high), rrb.PlotLegend(visible=False))


def _write_legend(violated: ViolatedSignal) -> str:
    """Return the legend as Markdown, with a line for each mark and each curve."""
    outside, word = violated.describe_outside(violated.worst), violated.worst_word
    worst = violated.describe_moment(violated.worst, word)
    limits = violated.describe_limits()
    lines = [
        f"◆ {worst}, {outside} outside" if outside else f"◆ {worst}",
        f"● {violated.describe_moment(violated.first, 'first violated')}",
        *(f"{sign} {limits[side]}" for side, sign in _SIGNS.items() if side in limits),
        "grey: allowed",
        f"blue: {violated.name}",
        f"red: {_NAMES_OUTSIDE[word]}",
    ]
    return "  \n".join(map(escape_markdown, lines))


def _draw_signal(run_stream: RunStream, violated: ViolatedSignal) -> None:
    """Draw band, limits, curve, the part outside, and the moments, from bottom to top."""
    curve, limits = violated.curve, violated.describe_limits()
    _fill_band(run_stream, violated)
    _draw(run_stream, "curve", curve, violated.name, width=2.0)
    for side, label in limits.items():
        ends = violated.low if side == "low" else violated.high
        assert ends is not None
        limit = replace(curve, values=ends)
        look: dict[str, Any] = {"colors": (palette.ALLOWED,), "width": 1.5}
        _draw(run_stream, f"limit_{side}", limit, label, **look)
        known = np.flatnonzero(np.isfinite(ends))
        if len(known):
            row = known[int(_MARK_AT * len(known)) :][:1]
            look = {"colors": (palette.GOAL,), "width": _POINT_SIZE, "marker": _MARKERS[side]}
            _draw(run_stream, f"points/limit_{side}", select_curve_rows(limit, row), label, **look)
    beyond = replace(curve, values=np.where(violated.outside, curve.values, np.nan))
    look = {"colors": (palette.VIOLATION,), "width": 4.0}
    _draw(run_stream, "outside", beyond, _NAMES_OUTSIDE[violated.worst_word], **look)
    for part, word, moment in (
        ("first", "first violated", violated.first),
        ("worst", violated.worst_word, violated.worst),
    ):
        time_ns = np.array([curve.start_ns + round(moment.time_s * 1e9)])
        point = replace(curve, time_ns=time_ns, values=np.array([moment.value]))
        look |= {"width": _POINT_SIZE, "marker": _MARKERS[part]}
        _draw(run_stream, f"points/{part}", point, violated.describe_moment(moment, word), **look)


def _draw(run_stream: RunStream, part: str, curve: Curve, label: str, **looks: Any) -> None:
    series = plots.Series(
        entity=f"{entities.VIOLATED}/{part}",
        labels=(label,),
        time_ns=curve.time_ns,
        values=curve.values[:, np.newaxis],
        holds=curve.holds,
        **looks,
    )
    plots.draw_series(run_stream, series)


def _fill_band(run_stream: RunStream, violated: ViolatedSignal) -> None:
    """Fill the band with vertical strokes; an unbounded band is filled up to the plot's edge."""
    time_ns = violated.curve.time_ns
    times_ns = np.linspace(time_ns[0], time_ns[-1], _STROKES).round().astype(np.int64)
    rows = np.searchsorted(time_ns, times_ns, side="right") - 1
    rows = np.clip(rows, 0, len(time_ns) - 1)
    part = violated.find_range()
    low, high = (
        np.full(len(rows), edge) if end is None else end[rows]
        for end, edge in ((violated.low, part.low), (violated.high, part.high))
    )
    strokes = np.column_stack([low, high, np.full(len(rows), np.nan)]).reshape(-1)
    style = rr.SeriesLines(
        names=["allowed"],
        colors=[(*palette.ALLOWED, _FILL_ALPHA)],
        widths=[3.0],
        aggregation_policy="Off",
    )
    entity = f"{entities.VIOLATED}/band"
    run_stream.log(entity, style)
    run_stream.send_few(entity, np.repeat(times_ns, 3), rr.Scalars.columns(scalars=strokes))


def _draw_stretch(stream: rr.RecordingStream, run: Run, violated: ViolatedSignal) -> None:
    """Draw the robot's path in red while the signal was outside its band."""
    if violated.worst_word != "worst":
        return
    rows = np.searchsorted(violated.curve.time_ns, run.poses.time_ns, side="right") - 1
    is_outside = violated.outside[np.maximum(rows, 0)] & (rows >= 0)
    starts = np.flatnonzero(np.diff(is_outside.astype(np.int8), prepend=0) == 1)
    ends = np.flatnonzero(np.diff(is_outside.astype(np.int8), append=0) == -1)
    strips = [run.poses.xy_m[a : b + 1] for a, b in zip(starts, ends, strict=True) if b > a]
    if strips:
        entity, look = entities.VIOLATED_STRETCH, {"draw_order": _ABOVE_TRACES}
        plane.log_strips(stream, entity, strips, [palette.VIOLATION], radius=2.5, **look)
