"""One run as a Rerun recording, finished or growing."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from turtlelog.charts import palette
from turtlelog.charts.curves import Values
from turtlelog.charts.plane_scene import move_near
from turtlelog.charts.plotted_curves import HEADROOM, TIMELINE
from turtlelog.draw.documents import document_run
from turtlelog.draw.rerun import entities, plane, plots, rrd_file, world
from turtlelog.draw.rerun.content import Content, describe_content, find_corners, find_largest_shown
from turtlelog.draw.rerun.entities import join_path
from turtlelog.draw.rerun.ghosts import Ghost, build_ideal_ghost, draw_ghost, draw_key
from turtlelog.draw.rerun.layout import build_run_layout, is_small
from turtlelog.draw.rerun.marks import (
    Mark,
    draw_lines,
    draw_marks,
    draw_phases,
    list_events,
    list_marks,
    list_responses,
    name_legends,
)
from turtlelog.draw.rerun.plane import Look, draw_trail, draw_turtle
from turtlelog.draw.rerun.timelines import (
    RunStream,
    add_thinning,
    build_run_timelines,
    read_span,
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
    with rrd_file.open_recording(
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
        rrd_file.draw_documents(stream, self.documents)


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
        plane_bounds = world.widen_plane(content.plane, surroundings, single.shift_m)
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
    marks: tuple[Mark, ...]  # metrics that can be marked on a curve
    names: Mapping[str, str]  # names of the main curve of each plot
    legends: frozenset[str]  # plots that have a legend
    by_speed: plane.SpeedTrace | None  # path in colours of its speed; None if nothing moves
    ideal: Ghost | None = None  # the ideal loop; None if theory does not know its poses
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
            arrows=plane.name_arrows(self.run),
            ghosts=() if self.ideal is None else (self.ideal.prefix,),
            highest_speed_m_s=None if self.by_speed is None else self.by_speed.highest_m_s,
        )


def build_single(run: Run) -> Single:
    """Return a measured run with its curves and marks, named for short legends."""
    metrics, first_m = measure_run(run), run.poses.xy_m[0]
    (run,), origin = move_near([run])
    measured = plots.list_series(run)
    named = name_legends(
        (*measured, *list_responses(run, metrics)),
        plots.list_references([run]),
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
    rrd_file.send_run_properties(stream, run, single.metrics)
    world.draw_world(stream, [run])
    if single.surroundings is not None:
        world.draw_surroundings(stream, single.surroundings, timelines, single.shift_m)
    run_stream = RunStream(stream, "", timelines)
    draw_trail(run_stream, run, Look(color=palette.MAIN))
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
        world.draw_close_up(stream, content.goal, run, [""], [palette.MAIN])
    if content.worst is not None:
        world.draw_worst_place(stream, content.worst, palette.MAIN)
    draw_phases(run_stream, run)
    if run.events:
        _draw_events(run_stream, single, content)
    plots.draw_references(stream, single.references, read_span([run], [timelines]))
    for curves in single.series:
        plots.draw_series(run_stream, curves)
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


_FLUSH_S: Final = 5.0

_GROWTH = 64
"""Growth of the rows, by 1/64, after which data that are sent as a whole are sent again. The total
stays a small multiple of the rows."""

_WHOLE = (
    join_path(entities.PATH),
    join_path(entities.REFERENCE_PATH),
    join_path(entities.SENSED_PLACES),
    join_path(entities.DROPPED_PLACES),
    join_path(entities.EVENT_PLACES),
    join_path(entities.REFERENCE),
)
_UNSETTLED = frozenset({join_path(entities.PHASE)})
"""Entities whose last row shows how the run ended."""


class GrowingStream(rr.RecordingStream):
    """Stream that sends only new data of every entity.

    The functions that draw a finished run also draw a growing run with this stream. Rows and static
    data that were already sent are left out. The path, the places of events and the level lines
    become longer during the run, so the complete lines are sent again.

    Attributes:
        is_due: Whether the growing static data are sent in this round.
    """

    def __init__(self, application_id: str) -> None:
        super().__init__(application_id, send_properties=False)
        self._sent: dict[str, int] = {}
        self._seen: dict[str, int] = {}
        self._logged: set[str] = set()
        self._rows = 0
        self.is_due, self._is_last = True, False

    def begin_round(self, rows: int, *, is_last: bool = False) -> None:
        """Start a new round of drawing a run that has this number of rows.

        In the last round, all changeable data are sent.
        """
        self._seen.clear()
        self._is_last = is_last
        self.is_due = is_last or rows > self._rows + self._rows // _GROWTH
        if self.is_due:
            self._rows = rows

    def log(self, entity_path: str | list[object], entity: Any, *more: Any, **options: Any) -> None:
        """Store static data if they are new or due."""
        name = str(entity_path)
        if name not in self._logged or self._is_last or self._is_whole_due(name):
            self._logged.add(name)
            super().log(entity_path, entity, *more, **options)

    def send_columns(
        self,
        entity_path: str,
        indexes: Iterable[Any],
        columns: Iterable[Any],
        *,
        strict: bool | None = None,
    ) -> None:
        """Send the rows that have not been sent before."""
        index, values = list(indexes), list(columns)
        count = len(index[0].as_arrow_array())
        if entity_path.startswith(_WHOLE):
            if self._is_whole_due(entity_path) or entity_path not in self._sent:
                self._sent[entity_path] = count
                super().send_columns(entity_path, index, values, strict=strict)
            return
        first = self._seen.get(entity_path, 0)
        self._seen[entity_path] = first + count
        sent = self._sent.get(entity_path, 0)
        held = 1 if entity_path in _UNSETTLED and not self._is_last else 0
        start, end = max(sent - first, 0), count - held
        if start < end:
            self._sent[entity_path] = first + end
            parts: list[Any] = [
                _Part(column, column.as_arrow_array().slice(start, end - start))
                for column in (*index, *values)
            ]
            super().send_columns(
                entity_path, parts[: len(index)], parts[len(index) :], strict=strict
            )

    def _is_whole_due(self, name: str) -> bool:
        return self.is_due and name.startswith(_WHOLE)


class LiveScene:
    """A run in a viewer, with the entities, rows and layout of its file.

    Metrics, marks, theory and close-ups are known only at the end, and are sent then.
    """

    def __init__(self, stream: GrowingStream, size: tuple[int, int] | None = None) -> None:
        """Store a stream; `size` is the size of the window [pixels], if known."""
        self._stream, self._size = stream, size
        self._shown: list[str] = []
        self._half_size_m = 0.0

    def update(self, run: Run) -> None:
        """Send the new data of a growing run; nothing while the run is too short to be visible.

        Raises:
            ConnectionError: If the viewer accepts no more data.
        """
        if len(run.poses) > 1:
            with rrd_file.strict_mode():
                self._draw(run)

    def finish(self, run: Run) -> None:
        """Send the rest of a finished run, including the data known only at the end.

        Raises:
            ConnectionError: If the viewer accepts no more data.
        """
        scene = build_run_scene(run, size=self._size)
        with rrd_file.strict_mode():
            self._stream.begin_round(len(run.poses), is_last=True)
            self._arrange(run, scene.content)
            scene.draw(self._stream)
            _flush(self._stream)

    def _draw(self, run: Run) -> None:
        stream, timelines = self._stream, build_run_timelines(run)
        # Theory is drawn at the end, when the segment of each loop is known.
        listed = [one for one in plots.list_series(run) if not one.entity.endswith("/ideal")]
        named = name_legends(listed, plots.list_references([run]))
        series, references = named.series, named.references
        run_stream = RunStream(stream, "", timelines)
        stream.begin_round(len(run.poses))
        shown = [curves.entity for curves in series]
        if self._shown != shown:
            content = describe_content([run], [""], [series], references, ())
            content = replace(content, is_small=is_small(self._size))
            self._shown, self._half_size_m = shown, content.plane.half_size_m
            self._arrange(run, _open_up(content, references))
            world.draw_world(stream, [run])
        if stream.is_due:
            plane.draw_growing_path(run_stream, run)
            plane.draw_reference_path(run_stream, run)
            plane.draw_sensed(run_stream, run)
            plots.draw_references(stream, references, read_span([run], [timelines]))
        draw_turtle(run_stream, run.poses, Look(color=palette.MAIN), self._half_size_m)
        plane.draw_reference_pose(run_stream, run, self._half_size_m)
        plane.draw_arrows(run_stream, run)
        draw_phases(run_stream, run)
        if run.events:
            plane.draw_event_places(run_stream, run)
            list_events(run_stream, run)
        for curves in series:
            plots.draw_series(run_stream, curves)
        _flush(stream)

    def _arrange(self, run: Run, content: Content) -> None:
        """Send the name, and a layout whose cursor follows the run."""
        layout = build_run_layout(content)
        layout.time_panel = rrb.TimePanel(
            state="collapsed", timeline=TIMELINE, play_state="following"
        )
        self._stream.send_recording_name(run.name)
        self._stream.send_blueprint(layout)


@dataclass(frozen=True, slots=True)
class _Part:
    """Rows of a column in the form that Rerun requires."""

    column: Any
    array: Any

    def timeline_name(self) -> str:
        return str(self.column.timeline_name())

    def component_descriptor(self) -> Any:
        return self.column.component_descriptor()

    def as_arrow_array(self) -> Any:
        return self.array


def _open_up(content: Content, references: Sequence[plots.LevelLines]) -> Content:
    """Return the content of a growing run: events may follow, and there is no close-up yet."""
    limits = {
        reference.plot: HEADROOM * max(level.value for level in reference.levels)
        for reference in references
        if any(level.kind == "limit" for level in reference.levels)
    }
    ranges = {
        plot: (content.ranges[plot][0], max(content.ranges[plot][1], limit))
        for plot, limit in limits.items()
    }
    return replace(content, ranges=ranges, goal=None, worst=None, idle=frozenset(), has_events=True)


def _flush(stream: rr.RecordingStream) -> None:
    try:
        stream.flush(timeout_sec=_FLUSH_S)
    except Exception as err:
        hangs = "timed out" in str(err)
        raise ConnectionError(
            f"no answer for {_FLUSH_S:g} s" if hangs else "the connection has ended"
        ) from err
