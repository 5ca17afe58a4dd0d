"""A run alone: what scenes of one run share."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import rerun as rr

from turtlelog.measure import Metric, measure_run
from turtlelog.run import Run
from turtlelog.show import palette
from turtlelog.show.rerun import drawing, entities, plane
from turtlelog.show.rerun.content import Content, describe_content, find_largest
from turtlelog.show.rerun.corners import choose_corners
from turtlelog.show.rerun.entities import join_path
from turtlelog.show.rerun.goal import draw_close_up
from turtlelog.show.rerun.layout import RUN_LEGENDS
from turtlelog.show.rerun.marks import Mark, draw_lines, draw_marks, list_marks
from turtlelog.show.rerun.plots import list_references, list_series
from turtlelog.show.rerun.properties import send_run_properties
from turtlelog.show.rerun.responses import list_responses
from turtlelog.show.rerun.run_stream import RunStream
from turtlelog.show.rerun.series import Reference, Series
from turtlelog.show.rerun.timelines import build_run_clock, read_span
from turtlelog.show.rerun.world import draw_surroundings

_EVENT_LINES: Final = f"{entities.LINES}/event"


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
    """

    run: Run
    metrics: Mapping[str, Metric]
    series: tuple[Series, ...]
    references: tuple[Reference, ...]
    marks: tuple[Mark, ...]
    by_speed: plane.SpeedTrace | None

    def describe(self, documents: Mapping[str, str]) -> Content:
        """Return what a recording of it holds."""
        content = describe_content([self.run], [""], [self.series], self.references, documents)
        return replace(
            content,
            corners=choose_corners(self.series, self.marks, content.ranges, RUN_LEGENDS),
            series=(*content.series, *dict.fromkeys(join_path(mark.entity) for mark in self.marks)),
            lines=(join_path(_EVENT_LINES),) if self.run.events else (),
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
    )


def draw_single(stream: rr.RecordingStream, single: Single, content: Content) -> None:
    """Draw the run with all that surrounds it, but for its documents."""
    run, clock = single.run, build_run_clock(single.run)
    send_run_properties(stream, run, single.metrics)
    draw_surroundings(stream, [run])
    run_stream = RunStream(stream, "", clock)
    plane.draw_trace_by_phase(run_stream, run)
    plane.draw_reference_path(run_stream, run)
    if single.by_speed is not None:
        plane.draw_speed_trace(run_stream, single.by_speed)
    plane.draw_turtle(run_stream, run, palette.MAIN, content.plane.half_size_m)
    plane.draw_reference_pose(run_stream, run, content.plane.half_size_m)
    plane.draw_arrows(run_stream, run)
    if content.goal is not None:
        draw_close_up(stream, content.goal, run, [""], [palette.MAIN])
    drawing.draw_phases(run_stream, run)
    if run.events:
        _draw_events(run_stream, run, find_largest(content))
    drawing.draw_references(stream, single.references, read_span([run], [clock]))
    for curves in single.series:
        drawing.draw_series(run_stream, curves)
    draw_marks(run_stream, single.marks)


def _draw_events(run_stream: RunStream, run: Run, largest: float) -> None:
    """Draw the events where the turtle was, across the plots, and as a log."""
    plane.draw_event_places(run_stream, run)
    times_ns = sorted({event.time_ns for event in run.events})
    draw_lines(run_stream, _EVENT_LINES, "event", palette.EVENT, times_ns, largest=largest)
    drawing.draw_events(run_stream, run)
