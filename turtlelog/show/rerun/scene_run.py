"""One run as a Rerun recording."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import rerun as rr

from turtlelog.measure import Metric, measure_run
from turtlelog.run import Run
from turtlelog.show.documents import describe_run
from turtlelog.show.rerun import drawing, entities, palette, plane
from turtlelog.show.rerun.clock import build_run_clock, read_span
from turtlelog.show.rerun.content import Content, describe_content, find_largest
from turtlelog.show.rerun.entities import join_path
from turtlelog.show.rerun.layout import build_run_layout
from turtlelog.show.rerun.marks import Mark, draw_lines, draw_marks, list_marks
from turtlelog.show.rerun.properties import send_run_properties
from turtlelog.show.rerun.recording import open_recording
from turtlelog.show.rerun.responses import list_responses
from turtlelog.show.rerun.run_stream import RunStream, describe_thinning
from turtlelog.show.rerun.series import Reference, Series
from turtlelog.show.rerun.signals import list_references, list_series
from turtlelog.show.rerun.surroundings import draw_surroundings

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
    scene = compose_scene(run, documents)
    with open_recording(path, name=run.name, layout=build_run_layout(scene.content)) as stream:
        draw_scene(stream, scene)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RunScene:
    """All that is drawn of one run.

    Attributes:
        run: Whose it is.
        metrics: Of the run, by id.
        documents: Markdown texts by title.
        series: Curves, theory's among them.
        references: Level lines.
        marks: Metrics on the curves.
        by_speed: The path in colours of its speed, None where nothing moves.
        content: What the layout must know of these.
    """

    run: Run
    metrics: Mapping[str, Metric]
    documents: Mapping[str, str]
    series: tuple[Series, ...]
    references: tuple[Reference, ...]
    marks: tuple[Mark, ...]
    by_speed: plane.SpeedTrace | None
    content: Content


def compose_scene(run: Run, documents: Mapping[str, str] | None = None) -> RunScene:
    """Return the scene of a run that has come to its end; arguments as `write_run_rrd`."""
    metrics = measure_run(run)
    measured, references = list_series(run), list_references([run])
    series = (*measured, *list_responses(run, metrics))
    marks, by_speed = tuple(list_marks(run, measured, metrics)), plane.build_speed_trace(run)
    if documents is None:
        documents = describe_run(run, metrics=metrics, drawn=describe_thinning([run]))
    content = describe_content([run], [""], [series], references, documents)
    content = replace(
        content,
        series=(*content.series, *dict.fromkeys(join_path(mark.entity) for mark in marks)),
        lines=(join_path(_EVENT_LINES),) if run.events else (),
        highest_speed_m_s=None if by_speed is None else by_speed.highest_m_s,
    )
    return RunScene(
        run=run,
        metrics=metrics,
        documents=documents,
        series=series,
        references=references,
        marks=marks,
        by_speed=by_speed,
        content=content,
    )


def draw_scene(stream: rr.RecordingStream, scene: RunScene) -> None:
    """Send all of a scene but its layout."""
    run, clock = scene.run, build_run_clock(scene.run)
    send_run_properties(stream, run, scene.metrics)
    draw_surroundings(stream, [run])
    run_stream = RunStream(stream, "", clock)
    plane.draw_trace_by_phase(run_stream, run)
    if scene.by_speed is not None:
        plane.draw_speed_trace(run_stream, scene.by_speed)
    plane.draw_turtle(run_stream, run, palette.MAIN, scene.content.plane.half_size_m)
    plane.draw_arrows(run_stream, run)
    drawing.draw_phases(run_stream, run)
    _draw_events(run_stream, run, find_largest(scene.content))
    drawing.draw_references(stream, scene.references, read_span([run], [clock]))
    for curves in scene.series:
        drawing.draw_series(run_stream, curves)
    draw_marks(run_stream, scene.marks)
    drawing.draw_documents(stream, scene.documents)


def _draw_events(run_stream: RunStream, run: Run, largest: float) -> None:
    """Draw the events where the turtle was, across the plots, and as a log."""
    if not run.events:
        return
    plane.draw_event_places(run_stream, run)
    times_ns = sorted({event.time_ns for event in run.events})
    draw_lines(run_stream, _EVENT_LINES, "event", palette.EVENT, times_ns, largest=largest)
    drawing.draw_events(run_stream, run)
