"""One run as a Rerun recording, also one that opens where something was violated."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.components import AbsoluteTimeRange

from turtlelog.escapes import fence_markdown
from turtlelog.measure import Metric, measure_run
from turtlelog.run import Event, Run
from turtlelog.show import palette
from turtlelog.show.documents import describe_run
from turtlelog.show.palette import Color
from turtlelog.show.rerun import entities, plane
from turtlelog.show.rerun.content import (
    Content,
    describe_content,
    find_corners,
    find_ends,
    find_largest,
)
from turtlelog.show.rerun.entities import TIMELINE, VIOLATION, join_path
from turtlelog.show.rerun.ghosts import Ghost, build_ideal_ghost, draw_ghost, draw_key
from turtlelog.show.rerun.layout import build_run_layout
from turtlelog.show.rerun.marks import (
    Mark,
    draw_events,
    draw_lines,
    draw_marks,
    draw_phases,
    list_marks,
    list_responses,
)
from turtlelog.show.rerun.plots import (
    LevelLines,
    Series,
    draw_references,
    draw_series,
    list_references,
    list_series,
)
from turtlelog.show.rerun.rrd_file import draw_documents, open_recording, send_run_properties
from turtlelog.show.rerun.timelines import RunStream, add_thinning, build_run_timelines, read_span
from turtlelog.show.rerun.turtles import Look, draw_turtle
from turtlelog.show.rerun.world import draw_close_up, draw_world, draw_worst_place

_RUN: Final = "the run"
_VIOLATION_RADIUS = 6.0
_VIOLATION_COLOR: Color = (214, 39, 40)
_EVENT_LINES: Final = f"{entities.LINES}/event"


def write_run_rrd(
    run: Run, path: str | Path, *, documents: Mapping[str, str] | None = None
) -> None:
    """Write a recording of one run with its layout; time zero is the first sample.

    Args:
        run: What to show.
        path: The .rrd file; replaced when the new one is complete.
        documents: Markdown texts by title, shown as tabs; `describe_run` where None.

    Raises:
        ShowError: Where the file cannot be written.
    """
    single = build_single(run)
    if documents is None:
        documents = describe_run(run, metrics=single.metrics)
    documents = add_thinning(documents, [run])
    content = single.describe(documents)
    with open_recording(path, name=run.name, layout=build_run_layout(content)) as stream:
        draw_single(stream, single, content)
        draw_documents(stream, documents)


def write_violation_rrd(
    run: Run, path: str | Path, *, at_s: float, title: str, message: str
) -> None:
    """Write a recording of one run that opens at a moment and marks it.

    The cursor stands there in every plot; the plane has a mark where the turtle was, the list of
    events a line, and the message is the first tab.

    Args:
        run: What to show.
        path: The .rrd file; replaced when the new one is complete.
        at_s: The moment, from the first sample [s].
        title: A few words, beside the mark.
        message: All there is to say, as it would be printed.

    Raises:
        ShowError: Where the file cannot be written.
    """
    at_ns = run.start_ns + round(at_s * 1e9)
    event = Event(time_ns=at_ns, kind="violation", text=f"Violation: {title}")
    events = sorted((*run.events, event), key=lambda found: found.time_ns)
    run = replace(run, events=tuple(events))
    single = build_single(run)
    documents = {"Violation": fence_markdown(message), **describe_run(run, metrics=single.metrics)}
    documents = {**add_thinning(documents, [run])}
    content = single.describe(documents)
    layout = build_run_layout(content)
    layout.time_panel = _stop_at(at_ns - run.start_ns)
    with open_recording(path, name=f"{run.name}: {title}", layout=layout) as stream:
        draw_single(stream, single, content)
        draw_documents(stream, documents)
        _draw_violation(stream, run, at_ns, title)


@dataclass(frozen=True, slots=True, kw_only=True)
class Single:
    """One run, measured, and all that is drawn of it.

    Attributes:
        run: The run.
        metrics: Its metrics by id.
        series: Its curves, and those of theory.
        references: Level lines.
        marks: Metrics that have a place on a curve.
        by_speed: Its path in colours of its speed, None where nothing moves.
        ideal: The ideal loop, None where theory does not know where it would be.
    """

    run: Run
    metrics: Mapping[str, Metric]
    series: tuple[Series, ...]
    references: tuple[LevelLines, ...]
    marks: tuple[Mark, ...]
    by_speed: plane.SpeedTrace | None
    ideal: Ghost | None = None

    def describe(self, documents: Mapping[str, str]) -> Content:
        """Return what a recording of it holds."""
        content = describe_content([self.run], [""], [self.series], self.references, documents)
        return replace(
            content,
            ends=find_ends(self.series, content.ranges),
            corners=find_corners(self.series, content.ranges) if self.run.goal_xy_m is None else {},
            series=(*content.series, *dict.fromkeys(join_path(mark.entity) for mark in self.marks)),
            lines=(join_path(_EVENT_LINES),) if plane.list_placed(self.run) else (),
            ghosts=() if self.ideal is None else (self.ideal.prefix,),
            highest_speed_m_s=None if self.by_speed is None else self.by_speed.highest_m_s,
        )


def build_single(run: Run) -> Single:
    """Return a run, measured, with its curves and marks."""
    metrics, measured = measure_run(run), list_series(run)
    return Single(
        run=run,
        metrics=metrics,
        series=(*measured, *list_responses(run, metrics)),
        references=list_references([run]),
        marks=list_marks(run, measured, metrics),
        by_speed=plane.build_speed_trace(run),
        ideal=build_ideal_ghost(run),
    )


def draw_single(stream: rr.RecordingStream, single: Single, content: Content) -> None:
    """Draw the run with all that surrounds it, but for its documents."""
    run, timelines = single.run, build_run_timelines(single.run)
    send_run_properties(stream, run, single.metrics)
    draw_world(stream, [run])
    run_stream = RunStream(stream, "", timelines)
    plane.draw_trace_by_phase(run_stream, run)
    plane.draw_reference_path(run_stream, run)
    plane.draw_sensed(run_stream, run)
    if single.by_speed is not None:
        plane.draw_speed_trace(run_stream, single.by_speed)
    draw_turtle(run_stream, run.poses, Look(color=palette.MAIN), content.plane.half_size_m)
    if single.ideal is not None:
        draw_ghost(stream, single.ideal, timelines, content.plane.half_size_m)
        rows = [(_RUN, palette.MAIN), (single.ideal.name, single.ideal.look.color)]
        draw_key(stream, rows, content.plane, [run])
    plane.draw_reference_pose(run_stream, run, content.plane.half_size_m)
    plane.draw_arrows(run_stream, run)
    if content.goal is not None:
        draw_close_up(stream, content.goal, run, [""], [palette.MAIN])
    if content.worst is not None:
        draw_worst_place(stream, content.worst, palette.MAIN)
    draw_phases(run_stream, run)
    if run.events:
        _draw_events(run_stream, run, find_largest(content))
    draw_references(stream, single.references, read_span([run], [timelines]))
    for curves in single.series:
        draw_series(run_stream, curves)
    draw_marks(run_stream, single.marks)


def _stop_at(at_ns: int) -> rrb.TimePanel:
    """Return a panel whose cursor stands at a time: it loops over a stretch of no length.

    A layout cannot name the cursor's place, and a paused one stands at the beginning.
    """
    return rrb.TimePanel(
        state="collapsed",
        timeline=TIMELINE,
        play_state="playing",
        loop_mode="selection",
        time_selection=AbsoluteTimeRange(min=at_ns, max=at_ns),
    )


def _draw_violation(stream: rr.RecordingStream, run: Run, at_ns: int, title: str) -> None:
    row = max(int(run.poses.time_ns.searchsorted(at_ns, side="right")) - 1, 0)
    mark = rr.Points2D(
        run.poses.xy_m[row : row + 1],
        radii=rr.Radius.ui_points(_VIOLATION_RADIUS),
        colors=[_VIOLATION_COLOR],
        labels=[title],
    )
    stream.log(join_path(VIOLATION), mark, static=True)


def _draw_events(run_stream: RunStream, run: Run, largest: float) -> None:
    """Draw the events where the turtle was, across the plots, and as a log."""
    plane.draw_event_places(run_stream, run)
    times_ns = sorted({event.time_ns for event in plane.list_placed(run)})
    draw_lines(run_stream, _EVENT_LINES, "event", palette.EVENT, times_ns, largest=largest)
    draw_events(run_stream, run)
