"""One run as a Rerun recording."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import rerun as rr

from turtlelog.charts import palette
from turtlelog.charts.plane_scene import move_near
from turtlelog.draw.documents import document_run
from turtlelog.draw.rerun import entities, plane
from turtlelog.draw.rerun.content import Content, describe_content, find_corners, find_largest_shown
from turtlelog.draw.rerun.entities import join_path
from turtlelog.draw.rerun.ghosts import Ghost, build_ideal_ghost, draw_ghost, draw_key
from turtlelog.draw.rerun.layout import build_run_layout, is_small
from turtlelog.draw.rerun.legends import name_legends
from turtlelog.draw.rerun.marks import (
    Mark,
    draw_lines,
    draw_marks,
    draw_phases,
    list_events,
    list_marks,
    list_responses,
)
from turtlelog.draw.rerun.plane import Look, draw_turtle
from turtlelog.draw.rerun.plots import (
    LevelLines,
    Series,
    draw_references,
    draw_series,
    list_references,
    list_series,
)
from turtlelog.draw.rerun.rrd_file import (
    draw_documents,
    open_recording,
    send_run_properties,
)
from turtlelog.draw.rerun.timelines import (
    RunStream,
    Values,
    add_thinning,
    build_run_timelines,
    read_span,
)
from turtlelog.draw.rerun.world import (
    draw_close_up,
    draw_surroundings,
    draw_world,
    draw_worst_place,
    widen_plane,
)
from turtlelog.log.ros2.bag_surroundings import Surroundings
from turtlelog.measure import Metric, measure_run
from turtlelog.run import Run, require_run

_RUN: Final = "the run"
_EVENT_LINES: Final = f"{entities.LINES}/event"
"""Entity of event lines, below that of a plot."""


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
    with open_recording(path, name=run.name, layout=build_run_layout(scene.content)) as stream:
        scene.draw(stream)


class RunScene(NamedTuple):
    """A run with the content of its recording, and its documents by title."""

    single: "Single"
    content: Content
    documents: Mapping[str, str]

    def draw(self, stream: rr.RecordingStream) -> None:
        """Draw everything."""
        draw_single(stream, self.single, self.content)
        draw_documents(stream, self.documents)


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
    documents = add_thinning(documents, [run])
    content = replace(single.describe(documents), is_small=is_small(size))
    if surroundings is not None:
        plane_bounds = widen_plane(content.plane, surroundings, single.shift_m)
        content = replace(content, plane=plane_bounds)
    return RunScene(single, content, documents)


@dataclass(frozen=True, slots=True, kw_only=True)
class Single:
    """A measured run with everything that is drawn.

    Attributes:
        run: The run. Far coordinates are relative to its start.
        origin: Text on this offset.
        metrics: Metrics of the run by id.
        series: Curves of the run and of theory.
        references: Level lines.
        marks: Metrics that can be marked on a curve.
        names: Names of the main curve of each plot.
        legends: Plots that have a legend.
        by_speed: Path in colours of its speed; None if nothing moves.
        ideal: The ideal loop; None if theory does not know its poses.
        shift_m: Offset added to the positions [m], shape (2,).
        surroundings: Scans and map of the robot; None if unknown.
    """

    run: Run
    origin: str
    metrics: Mapping[str, Metric]
    series: tuple[Series, ...]
    references: tuple[LevelLines, ...]
    marks: tuple[Mark, ...]
    names: Mapping[str, str]
    legends: frozenset[str]
    by_speed: plane.SpeedTrace | None
    ideal: Ghost | None = None
    shift_m: Values = field(default_factory=lambda: np.zeros(2))
    surroundings: Surroundings | None = None

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
            arrows=plane.name_arrows(self.run),
            ghosts=() if self.ideal is None else (self.ideal.prefix,),
            highest_speed_m_s=None if self.by_speed is None else self.by_speed.highest_m_s,
        )


def build_single(run: Run) -> Single:
    """Return a measured run with its curves and marks, named for short legends."""
    metrics, first_m = measure_run(run), run.poses.xy_m[0]
    (run,), origin = move_near([run])
    measured = list_series(run)
    named = name_legends(
        (*measured, *list_responses(run, metrics)),
        list_references([run]),
        list_marks(run, measured, metrics),
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
        ideal=build_ideal_ghost(run),
        shift_m=run.poses.xy_m[0] - first_m,
    )


def draw_single(stream: rr.RecordingStream, single: Single, content: Content) -> None:
    """Draw the run with everything except its documents."""
    run, timelines = single.run, build_run_timelines(single.run)
    send_run_properties(stream, run, single.metrics)
    draw_world(stream, [run])
    if single.surroundings is not None:
        draw_surroundings(stream, single.surroundings, timelines, single.shift_m)
    run_stream = RunStream(stream, "", timelines)
    plane.draw_driven(run_stream, run)
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
        _draw_events(run_stream, single, content)
    draw_references(stream, single.references, read_span([run], [timelines]))
    for curves in single.series:
        draw_series(run_stream, curves)
    draw_marks(run_stream, single.marks)


def _draw_events(run_stream: RunStream, single: Single, content: Content) -> None:
    """Draw the events at the turtle's places, across the plots, and as a log."""
    run, largest = single.run, find_largest_shown(content)
    plane.draw_event_places(run_stream, run)
    times_ns = sorted({event.time_ns for event in plane.list_placed(run)})
    for plot in single.list_lined():
        name, entity = single.names[plot], f"{plot}/{_EVENT_LINES}"
        draw_lines(run_stream, entity, name, palette.MAIN, times_ns, largest=largest)
    list_events(run_stream, run)
