"""One run in a viewer while it grows: the scene of a finished run, drawn again with what is new."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Final

import rerun as rr
import rerun.blueprint as rrb

from turtlelog.errors import ShowError
from turtlelog.run import Run
from turtlelog.show import palette
from turtlelog.show.documents import describe_run
from turtlelog.show.rerun import drawing, entities, plane
from turtlelog.show.rerun.content import Content, describe_content
from turtlelog.show.rerun.entities import APPLICATION_ID, TIMELINE
from turtlelog.show.rerun.growing_stream import GrowingStream
from turtlelog.show.rerun.layout import build_run_layout
from turtlelog.show.rerun.plots import list_references, list_series
from turtlelog.show.rerun.recording import (
    abandon_stream,
    require_enabled,
    strict_mode,
)
from turtlelog.show.rerun.run_scene import build_single, draw_single
from turtlelog.show.rerun.run_stream import RunStream, add_thinning
from turtlelog.show.rerun.series import Reference
from turtlelog.show.rerun.timelines import build_run_clock, read_span
from turtlelog.show.rerun.world import draw_surroundings

_FLUSH_S: Final = 5.0
_HEADROOM: Final = 1.25


class LiveScene:
    """A run in a viewer, with the entities, rows and layout of its file.

    What is known only at the end (metrics and their marks, theory, close-ups) comes with it.
    """

    def __init__(self, stream: GrowingStream) -> None:
        self._stream = stream
        self._shown: list[str] = []
        self._half_size_m = 0.0

    def update(self, run: Run) -> None:
        """Send what is new of a run that grows; nothing while it is too short to be seen.

        Raises:
            ConnectionError: Where the viewer takes no more.
        """
        if len(run.poses) > 1:
            with strict_mode():
                self._draw(run)

    def finish(self, run: Run) -> None:
        """Send the rest of a run that has come to its end, and what is known only now.

        Raises:
            ConnectionError: Where the viewer takes no more.
        """
        single = build_single(run)
        documents = add_thinning(describe_run(run, metrics=single.metrics), [run])
        content = single.describe(documents)
        with strict_mode():
            self._stream.begin_round(len(run.poses), is_last=True)
            self._arrange(run, content)
            draw_single(self._stream, single, content)
            drawing.draw_documents(self._stream, documents)
            _flush(self._stream)

    def _draw(self, run: Run) -> None:
        stream, clock = self._stream, build_run_clock(run)
        series, references = list_series(run), list_references([run])
        run_stream = RunStream(stream, "", clock)
        stream.begin_round(len(run.poses))
        shown = [curves.entity for curves in series]
        if self._shown != shown:
            content = describe_content([run], [""], [series], references, ())
            self._shown, self._half_size_m = shown, content.plane.half_size_m
            self._arrange(run, _open_up(content, references))
            draw_surroundings(stream, [run])
        if stream.is_due:
            plane.draw_trace_by_phase(run_stream, run)
            plane.draw_reference_path(run_stream, run)
            drawing.draw_references(stream, references, read_span([run], [clock]))
        plane.draw_turtle(run_stream, run, palette.MAIN, self._half_size_m)
        plane.draw_reference_pose(run_stream, run, self._half_size_m)
        plane.draw_arrows(run_stream, run)
        drawing.draw_phases(run_stream, run)
        if run.events:
            plane.draw_event_places(run_stream, run)
            drawing.draw_events(run_stream, run)
        for curves in series:
            drawing.draw_series(run_stream, curves)
        _flush(stream)

    def _arrange(self, run: Run, content: Content) -> None:
        """Send the name, and a layout whose cursor goes with the run."""
        layout = build_run_layout(content)
        layout.time_panel = rrb.TimePanel(
            state="collapsed", timeline=TIMELINE, play_state="following"
        )
        self._stream.send_recording_name(run.name)
        self._stream.send_blueprint(layout)


@contextmanager
def connect_scene(url: str) -> Iterator[LiveScene]:
    """Yield a scene in the viewer at an address, as `rerun+http://127.0.0.1:9876/proxy`.

    Raises:
        ShowError: Where the address is none, or Rerun is switched off.
    """
    stream = GrowingStream(APPLICATION_ID)
    require_enabled(stream, "viewer")
    stream.set_log_time_enabled(False)
    try:
        stream.connect_grpc(url)
    except Exception as err:
        raise ShowError(f"{url}: expected the address of a viewer: {err}") from err
    try:
        yield LiveScene(stream)
    finally:
        abandon_stream(stream)


def _open_up(content: Content, references: Sequence[Reference]) -> Content:
    """Return the content of a run that goes on: events may come, and nothing is a close-up yet."""
    limits = {
        reference.plot: _HEADROOM * max(reference.levels)
        for reference in references
        if reference.plot in {entities.SPEED, entities.TURN_RATE}
    }
    ranges = {
        plot: (content.ranges[plot][0], max(content.ranges[plot][1], limit))
        for plot, limit in limits.items()
    }
    return replace(content, ranges=ranges, goal=None, has_events=True)


def _flush(stream: rr.RecordingStream) -> None:
    try:
        stream.flush(timeout_sec=_FLUSH_S)
    except Exception as err:
        hangs = "timed out" in str(err)
        raise ConnectionError(
            f"no answer for {_FLUSH_S:g} s" if hangs else "the connection has ended"
        ) from err
