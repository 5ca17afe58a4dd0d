"""One run as a Rerun recording."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final

from turtlelog.measure import measure_run
from turtlelog.run import Run
from turtlelog.show.documents import describe_run
from turtlelog.show.rerun import drawing, entities, palette, plane
from turtlelog.show.rerun.clock import build_run_clock, read_span
from turtlelog.show.rerun.content import describe_content, find_largest
from turtlelog.show.rerun.entities import join_path
from turtlelog.show.rerun.layout import build_run_layout
from turtlelog.show.rerun.marks import draw_lines, draw_marks, list_marks
from turtlelog.show.rerun.properties import send_run_properties
from turtlelog.show.rerun.recording import open_recording
from turtlelog.show.rerun.responses import list_responses
from turtlelog.show.rerun.run_stream import RunStream, describe_thinning
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
    metrics, clock = measure_run(run), build_run_clock(run)
    measured, references = list_series(run), list_references([run])
    series = (*measured, *list_responses(run, metrics))
    marks, by_speed = list_marks(run, measured, metrics), plane.build_speed_trace(run)
    if documents is None:
        documents = describe_run(run, metrics=metrics, drawn=describe_thinning([run]))
    content = describe_content([run], [""], [series], references, documents)
    content = replace(
        content,
        series=(*content.series, *dict.fromkeys(join_path(mark.entity) for mark in marks)),
        lines=(join_path(_EVENT_LINES),) if run.events else (),
        highest_speed_m_s=None if by_speed is None else by_speed.highest_m_s,
    )
    with open_recording(path, name=run.name, layout=build_run_layout(content)) as stream:
        send_run_properties(stream, run, metrics)
        draw_surroundings(stream, [run])
        run_stream = RunStream(stream, "", clock)
        plane.draw_trace_by_phase(run_stream, run)
        if by_speed is not None:
            plane.draw_speed_trace(run_stream, by_speed)
        plane.draw_turtle(run_stream, run, palette.MAIN, content.plane.half_size_m)
        plane.draw_arrows(run_stream, run)
        drawing.draw_phases(run_stream, run)
        _draw_events(run_stream, run, find_largest(content))
        drawing.draw_references(stream, references, read_span([run], [clock]))
        for curves in series:
            drawing.draw_series(run_stream, curves)
        draw_marks(run_stream, marks)
        drawing.draw_documents(stream, documents)


def _draw_events(run_stream: RunStream, run: Run, largest: float) -> None:
    """Draw the events where the turtle was, across the plots, and as a log."""
    if not run.events:
        return
    plane.draw_event_places(run_stream, run)
    times_ns = sorted({event.time_ns for event in run.events})
    draw_lines(run_stream, _EVENT_LINES, "event", palette.EVENT, times_ns, largest=largest)
    drawing.draw_events(run_stream, run)
