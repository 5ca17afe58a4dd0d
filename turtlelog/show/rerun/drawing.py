"""What a run puts into a recording, entity by entity."""

from collections.abc import Mapping, Sequence

import numpy as np
import rerun as rr

from turtlelog.run import Phase, Run
from turtlelog.show.rerun import entities, palette
from turtlelog.show.rerun.entities import join_path
from turtlelog.show.rerun.recording import build_index
from turtlelog.show.rerun.series import Reference, Series
from turtlelog.show.rerun.surroundings import UPWARD, Bounds

_SHARE_BEYOND = 16
_REFERENCE_WIDTH = 1.0  # [points], as are the radii
_PATH_RADIUS = 1.0
_TURTLE_RADIUS = 5.0
_ARROW_SHARE = 0.19
_ARROW_RADIUS = 2.5


def find_time_span(runs: Sequence[Run]) -> tuple[int, int]:
    """Return first and last time on the common clock [ns], whose zero is each first sample."""
    tables = [
        (table.time_ns, run.start_ns)
        for run in runs
        for table in (run.poses, run.samples, run.commands)
        if len(table)
    ]
    starts = min(int(time_ns[0]) - zero_ns for time_ns, zero_ns in tables)
    return starts, max(int(time_ns[-1]) - zero_ns for time_ns, zero_ns in tables)


def draw_motion(
    stream: rr.RecordingStream,
    prefix: str,
    run: Run,
    color: palette.Color,
    *,
    plane: Bounds,
    speaker: str = "",
) -> None:
    """Draw all of a run but its curves: path, turtle, phases, events."""
    stream.log(join_path(prefix, entities.PLANE), UPWARD, static=True)
    draw_path(stream, prefix, run, color)
    draw_turtle(stream, prefix, run, color, plane.half_size_m * _ARROW_SHARE)
    if len(run.samples):
        draw_phases(stream, prefix, run)
    if run.events:
        draw_events(stream, prefix, run, speaker)


def draw_path(stream: rr.RecordingStream, prefix: str, run: Run, color: palette.Color) -> None:
    """Draw the whole path."""
    strip = rr.LineStrips2D(
        [run.poses.xy_m], radii=rr.Radius.ui_points(_PATH_RADIUS), colors=[color]
    )
    stream.log(join_path(prefix, entities.PATH), strip, static=True)


def draw_turtle(
    stream: rr.RecordingStream, prefix: str, run: Run, color: palette.Color, arrow_m: float
) -> None:
    """Draw the turtle where it is at the cursor, with an arrow along its heading."""
    turtle, arrow = join_path(prefix, entities.TURTLE), join_path(prefix, entities.ARROW)
    point = rr.Points2D([(0.0, 0.0)], radii=rr.Radius.ui_points(_TURTLE_RADIUS), colors=[color])
    stream.log(turtle, point, static=True)
    heading = rr.Arrows2D(
        vectors=[(arrow_m, 0.0)], radii=rr.Radius.ui_points(_ARROW_RADIUS), colors=[color]
    )
    stream.log(arrow, heading, static=True)
    half_rad = run.poses.heading_rad / 2.0
    zeros = np.zeros(len(half_rad))
    columns = rr.Transform3D.columns(
        translation=np.column_stack([run.poses.xy_m, zeros]),
        quaternion=np.column_stack([zeros, zeros, np.sin(half_rad), np.cos(half_rad)]),
    )
    stream.send_columns(turtle, build_index(run.poses.time_ns - run.start_ns), columns)


def draw_series(stream: rr.RecordingStream, prefix: str, series: Series, zero_ns: int) -> None:
    """Draw curves into their plot."""
    entity = join_path(prefix, series.entity)
    style = rr.SeriesLines(
        names=series.labels,
        colors=series.colors,
        widths=[series.width] * len(series.labels),
        interpolation_mode="StepAfter" if series.holds else "Linear",
        aggregation_policy="MinMax",
    )
    stream.log(entity, style, static=True)
    columns = rr.Scalars.columns(scalars=series.values)
    stream.send_columns(entity, build_index(series.time_ns - zero_ns), columns)


def draw_references(
    stream: rr.RecordingStream, references: Sequence[Reference], runs: Sequence[Run]
) -> None:
    """Draw level lines across plots, a little beyond the end: there the last phase shows."""
    start_ns, end_ns = find_time_span(runs)
    index = build_index(np.array([start_ns, end_ns + (end_ns - start_ns) // _SHARE_BEYOND]))
    for reference in references:
        entity = join_path(entities.REFERENCE, reference.plot)
        count = len(reference.levels)
        style = rr.SeriesLines(
            names=[reference.label] * count,
            colors=[palette.REFERENCE] * count,
            widths=[_REFERENCE_WIDTH] * count,
        )
        stream.log(entity, style, static=True)
        columns = rr.Scalars.columns(scalars=np.tile(reference.levels, (2, 1)))
        stream.send_columns(entity, index, columns)


def draw_phases(stream: rr.RecordingStream, prefix: str, run: Run) -> None:
    """Draw the phases as a bar that ends in `done`, or in nothing where the run was cut."""
    entity = join_path(prefix, entities.PHASE)
    spans = run.find_phase_spans()
    style = rr.StateConfiguration(
        values=[phase.label for phase in Phase],
        # The pause is too short for its name; the title of the view explains its colour.
        labels=[" " if phase is Phase.PAUSE else phase.label for phase in Phase],
        colors=[palette.PHASES[phase] for phase in Phase],
    )
    stream.log(entity, style, static=True)
    last = Phase.DONE.label if run.is_complete else ""
    starts_ns = np.array([*(span.start_ns for span in spans), run.end_ns])
    columns = rr.StateChange.columns(state=[*(span.phase.label for span in spans), last])
    stream.send_columns(entity, build_index(starts_ns - run.start_ns), columns)


def draw_events(stream: rr.RecordingStream, prefix: str, run: Run, speaker: str) -> None:
    """List the events as a text log, each after the speaker's name if there is one."""
    columns = rr.TextLog.columns(
        text=[f"{speaker}: {event.text}" if speaker else event.text for event in run.events],
        level=["INFO" if event.kind == "stop" else "WARN" for event in run.events],
    )
    times_ns = np.array([event.time_ns for event in run.events])
    index = build_index(times_ns - run.start_ns)
    stream.send_columns(join_path(prefix, entities.EVENTS), index, columns)


def draw_documents(stream: rr.RecordingStream, documents: Mapping[str, str]) -> None:
    """Store Markdown documents under their titles."""
    for title, text in documents.items():
        document = rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)
        stream.log(name_document(title), document, static=True)


def name_document(title: str) -> str:
    """Return the entity path of a document."""
    return join_path(entities.DOCUMENTS, rr.escape_entity_path_part(title))
