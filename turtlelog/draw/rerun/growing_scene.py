"""A growing run in a viewer: the functions for a finished run, which send only the new data."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import rerun as rr
import rerun.blueprint as rrb

from turtlelog.charts import palette
from turtlelog.charts.time_axes import HEADROOM, TIMELINE
from turtlelog.draw.rerun import entities, plane
from turtlelog.draw.rerun.content import Content, describe_content
from turtlelog.draw.rerun.entities import join_path
from turtlelog.draw.rerun.layout import build_run_layout, is_small
from turtlelog.draw.rerun.legends import name_legends
from turtlelog.draw.rerun.marks import draw_phases, list_events
from turtlelog.draw.rerun.plane import Look, draw_turtle
from turtlelog.draw.rerun.plots import (
    LevelLines,
    draw_references,
    draw_series,
    list_references,
    list_series,
)
from turtlelog.draw.rerun.rrd_file import strict_mode
from turtlelog.draw.rerun.run_scene import build_run_scene
from turtlelog.draw.rerun.timelines import RunStream, build_run_timelines, read_span
from turtlelog.draw.rerun.world import draw_world
from turtlelog.run import Run

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
        """Start a new round of drawing.

        Args:
            rows: Present number of rows of the run.
            is_last: Whether this is the final round, in which all changeable data are sent.
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
            parts: list[Any] = [_cut(column, start, end) for column in (*index, *values)]
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
            with strict_mode():
                self._draw(run)

    def finish(self, run: Run) -> None:
        """Send the rest of a finished run, including the data known only at the end.

        Raises:
            ConnectionError: If the viewer accepts no more data.
        """
        scene = build_run_scene(run, size=self._size)
        with strict_mode():
            self._stream.begin_round(len(run.poses), is_last=True)
            self._arrange(run, scene.content)
            scene.draw(self._stream)
            _flush(self._stream)

    def _draw(self, run: Run) -> None:
        stream, timelines = self._stream, build_run_timelines(run)
        # Theory is drawn at the end, when the segment of each loop is known.
        listed = [one for one in list_series(run) if not one.entity.endswith("/ideal")]
        named = name_legends(listed, list_references([run]))
        series, references = named.series, named.references
        run_stream = RunStream(stream, "", timelines)
        stream.begin_round(len(run.poses))
        shown = [curves.entity for curves in series]
        if self._shown != shown:
            content = describe_content([run], [""], [series], references, ())
            content = replace(content, is_small=is_small(self._size))
            self._shown, self._half_size_m = shown, content.plane.half_size_m
            self._arrange(run, _open_up(content, references))
            draw_world(stream, [run])
        if stream.is_due:
            plane.draw_driven(run_stream, run, is_growing=True)
            plane.draw_reference_path(run_stream, run)
            plane.draw_sensed(run_stream, run)
            draw_references(stream, references, read_span([run], [timelines]))
        draw_turtle(run_stream, run.poses, Look(color=palette.MAIN), self._half_size_m)
        plane.draw_reference_pose(run_stream, run, self._half_size_m)
        plane.draw_arrows(run_stream, run)
        draw_phases(run_stream, run)
        if run.events:
            plane.draw_event_places(run_stream, run)
            list_events(run_stream, run)
        for curves in series:
            draw_series(run_stream, curves)
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


def _open_up(content: Content, references: Sequence[LevelLines]) -> Content:
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


def _cut(column: Any, start: int, end: int) -> _Part:
    return _Part(column, column.as_arrow_array().slice(start, end - start))
