"""One run in a viewer while it grows: the scene of a finished run, drawn again with what is new."""

import os
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Final

import rerun as rr
import rerun.blueprint as rrb

from turtlelog.errors import ShowError
from turtlelog.run import Run
from turtlelog.show.documents import describe_run
from turtlelog.show.rerun import drawing, entities, palette
from turtlelog.show.rerun.content import Content, describe_content
from turtlelog.show.rerun.entities import APPLICATION_ID, TIMELINE
from turtlelog.show.rerun.growing_stream import GrowingStream
from turtlelog.show.rerun.layout import build_run_layout
from turtlelog.show.rerun.properties import collect_run_properties
from turtlelog.show.rerun.recording import strict_mode
from turtlelog.show.rerun.series import Reference, Series, list_references, list_series
from turtlelog.show.rerun.surroundings import Bounds, draw_surroundings

_FLUSH_S: Final = 5.0
_DISCONNECT_S: Final = 1.0
_HEADROOM: Final = 1.25


class LiveScene:
    """A run in a viewer, with the entities, rows and layout of its file.

    What is known only at the end (metrics, the close-up of the goal) comes with it.
    """

    def __init__(self, stream: GrowingStream) -> None:
        self._stream = stream
        self._shown: object = None
        self._plane = Bounds(center_xy_m=(0.0, 0.0), half_size_m=1.0)

    def update(self, run: Run) -> None:
        """Send what is new of a run that grows; nothing while it is too short to be seen.

        Raises:
            ConnectionError: Where the viewer takes no more.
        """
        if len(run.poses) > 1:
            self._draw(run, is_last=False)

    def finish(self, run: Run) -> None:
        """Send the rest of a run that has come to its end, and what is known only now.

        Raises:
            ConnectionError: Where the viewer takes no more.
        """
        self._draw(run, is_last=True)

    def _draw(self, run: Run, *, is_last: bool) -> None:
        stream = self._stream
        stream.begin_round(len(run.poses), is_last=is_last)
        series, references = list_series(run), list_references([run])
        with strict_mode():
            shown = tuple(curves.entity for curves in series), is_last
            if self._shown != shown:
                self._shown = shown
                self._arrange(run, series, references, is_last=is_last)
            drawing.draw_motion(stream, "", run, palette.MAIN, plane=self._plane)
            if stream.is_due:
                drawing.draw_references(stream, references, [run])
            for curves in series:
                drawing.draw_series(stream, "", curves, run.start_ns)
            _flush(stream)

    def _arrange(
        self,
        run: Run,
        series: Sequence[Series],
        references: Sequence[Reference],
        *,
        is_last: bool,
    ) -> None:
        """Send what all of the run shares, and a layout whose cursor goes with the run."""
        documents = describe_run(run) if is_last else {}
        content = describe_content([run], [""], [series], references, documents)
        self._plane = content.plane
        layout = build_run_layout(content if is_last else _open_up(content, references))
        layout.time_panel = rrb.TimePanel(
            state="collapsed", timeline=TIMELINE, play_state="following"
        )
        self._stream.send_recording_name(run.name)
        self._stream.send_property("run", collect_run_properties(run))
        self._stream.send_blueprint(layout)
        draw_surroundings(self._stream, [run])
        drawing.draw_documents(self._stream, documents)


@contextmanager
def connect_scene(url: str) -> Iterator[LiveScene]:
    """Yield a scene in the viewer at an address, as `rerun+http://127.0.0.1:9876/proxy`.

    Raises:
        ShowError: Where the address is none, or Rerun is switched off.
    """
    stream = GrowingStream(APPLICATION_ID)
    if not rr.is_enabled(stream):
        found = f"found RERUN={os.environ.get('RERUN', '')!r} in the environment"
        raise ShowError(f"viewer: expected Rerun to be switched on, {found}")
    stream.set_log_time_enabled(False)
    try:
        stream.connect_grpc(url)
    except Exception as err:
        raise ShowError(f"{url}: expected the address of a viewer: {err}") from err
    try:
        yield LiveScene(stream)
    finally:
        _disconnect(stream)


def _open_up(content: Content, references: Sequence[Reference]) -> Content:
    """Return the content of a run that goes on: events may come, and nothing is a close-up yet."""
    limits = {
        reference.plot: _HEADROOM * max(reference.levels)
        for reference in references
        if reference.plot in content.ranges
    }
    ranges = {
        plot: (content.ranges[plot][0], max(content.ranges[plot][1], limit))
        for plot, limit in limits.items()
        if plot != entities.HEADING_ERROR
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


def _disconnect(stream: rr.RecordingStream) -> None:
    """End the connection, but wait for no viewer that hangs: Rerun would, and let nobody interrupt.

    The thread that waits in our place keeps the stream, which would wait where it is dropped.
    """
    thread = threading.Thread(target=stream.disconnect, name="disconnect", daemon=True)
    thread.start()
    thread.join(_DISCONNECT_S)
    if thread.is_alive():
        rr.unregister_shutdown()
