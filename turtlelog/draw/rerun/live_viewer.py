"""Growing runs in a viewer or a notebook: a running loop, or a recording that grows."""

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread
from typing import Any, Final

import rerun as rr
import rerun.blueprint as rrb
from rerun.notebook import Viewer

from turtlelog.charts import palette
from turtlelog.charts.plotted_curves import HEADROOM
from turtlelog.charts.time_plots import TIMELINE
from turtlelog.draw.rerun import entities, plane, plots, recording_stream, turtles
from turtlelog.draw.rerun.content import Content, describe_content, name_legends
from turtlelog.draw.rerun.entities import APPLICATION_ID, join_path
from turtlelog.draw.rerun.layout import build_run_layout, is_small
from turtlelog.draw.rerun.recording_stream import RunStream
from turtlelog.draw.rerun.run_scene import build_run_scene
from turtlelog.draw.rerun.viewer import open_window, require_recordings, require_viewer
from turtlelog.errors import ShowError
from turtlelog.libraries import load_library
from turtlelog.log import RecordingTail
from turtlelog.run import Run
from turtlelog.scenario import Scenario
from turtlelog.simulate import RunCollector, Tick

_BATCH_S: Final = 0.05
"""Shortest time between two batches for a separate viewer [s]: 20 pictures per second."""

_WIDGET_BATCH_S: Final = 0.2
"""Shortest time between two batches for a notebook [s]. A browser without a graphics card takes two
to four batches per second; each batch takes equally long, however short it is."""

_SHARE: Final = 5
"""Shortest time between two batches, as a multiple of the last batch's processor time."""

_LAST_S: Final = 8.0  # time that the end of a run waits for a viewer that does not answer [s]

_POLL_S: Final = 0.1
_QUIET_S: Final = 3.0  # time without growth after which a file without a writer counts as final [s]

_ADVICE: Final = (
    "`turtlelog view FILE --partial --snapshot X.png` makes a picture of what is there so far"
)

WIDGET_SIZE: Final = (960, 640)
"""Width and height that fit a cell of JupyterLab on a small screen [pixels]."""

_FLUSH_S: Final = 5.0

_GROWTH = 64
"""Growth of rows (1/64) from which whole data are sent again: in total a small multiple."""

_WHOLE = (
    *map(join_path, (entities.PATH, entities.REFERENCE_PATH, entities.REFERENCE)),
    *map(join_path, (entities.SENSED_PLACES, entities.DROPPED_PLACES, entities.EVENT_PLACES)),
)
_UNSETTLED = join_path(entities.PHASE)
"""Entity whose last row shows how the run ended."""


class GrowingStream(rr.RecordingStream):
    """Stream that sends only new data of every entity.

    The functions that draw a finished run also draw a growing run with this stream. Rows and static
    data that were already sent are left out. The path, the places of events and the level lines
    become longer during the run, so the complete lines are sent again in rounds that are due.
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
        held = entity_path == _UNSETTLED and not self._is_last
        start, end = max(self._sent.get(entity_path, 0) - first, 0), count - held
        if start < end:
            self._sent[entity_path] = first + end

            def cut(columns: list[Any]) -> list[Any]:
                arrays = (column.as_arrow_array().slice(start, end - start) for column in columns)
                return [*map(_Part, columns, arrays)]

            super().send_columns(entity_path, cut(index), cut(values), strict=strict)

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
        """Send a growing run's new data; ConnectionError if the viewer accepts no more."""
        if len(run.poses) > 1:
            with recording_stream.strict_mode():
                self._draw(run)

    def finish(self, run: Run) -> None:
        """Send a finished run with what is known only then; ConnectionError as in `update`."""
        scene = build_run_scene(run, size=self._size)
        with recording_stream.strict_mode():
            self._stream.begin_round(len(run.poses), is_last=True)
            self._arrange(run, scene.content)
            scene.draw(self._stream)
            _flush(self._stream)

    def _draw(self, run: Run) -> None:
        stream, timelines = self._stream, recording_stream.build_run_timelines(run)
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
            plane.draw_world(stream, [run])
        if stream.is_due:
            turtles.draw_growing_path(run_stream, run)
            plane.draw_reference_path(run_stream, run)
            plane.draw_sensed(run_stream, run)
            span = recording_stream.read_span([run], [timelines])
            plots.draw_references(stream, references, span)
        look = turtles.Look(color=palette.MAIN)
        turtles.draw_turtle(run_stream, run.poses, look, self._half_size_m)
        turtles.draw_reference_pose(run_stream, run, self._half_size_m)
        turtles.draw_arrows(run_stream, run)
        plots.draw_phases(run_stream, run)
        if run.events:
            plane.draw_event_places(run_stream, run)
            plots.list_events(run_stream, run)
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
        told = f"no answer for {_FLUSH_S:g} s" if hangs else "the connection has ended"
        raise ConnectionError(told) from err


class LiveViewer:
    """Sink that shows the ticks of a running loop, in batches, in a notebook or another viewer.

    The viewer is a sink for `run_live`. The sink only collects the ticks, and a thread draws them.
    A viewer that is slow, hangs or disappears does not delay the loop; afterwards, `lost` gives the
    reason.

    Attributes:
        lost: Reason why the viewer does not show the complete run, in one clause; empty if it does.
    """

    def __init__(
        self,
        scenario: Scenario,
        url: str | None = None,
        *,
        size: tuple[int, int] = WIDGET_SIZE,
    ) -> None:
        """Show an empty widget below the present cell, or start to connect to a viewer.

        Args:
            scenario: Scenario that runs.
            url: Address of the viewer, as `rerun+http://127.0.0.1:9876/proxy`. Default: a widget of
                the notebook (extra `notebook`).
            size: Width and height of the widget [pixels].

        Raises:
            ShowError: If no viewer answers at the address, or there is no notebook.
            LibraryError: If the extra `notebook` is not installed.
        """
        if url is None:
            scene, self._batch_s = _keep_scene(WidgetStream(size), size), _WIDGET_BATCH_S
        else:
            require_viewer(url)
            scene, self._batch_s = _connect_scene(url), _BATCH_S
        self.lost = ""
        self._collector = RunCollector(scenario)
        self._ticks: SimpleQueue[Tick | None] = SimpleQueue()
        self._thread = Thread(target=self._show, args=(scene,), name="viewer", daemon=True)
        self._thread.start()

    def receive(self, tick: Tick) -> None:
        """Collect a tick."""
        if not self.lost:
            self._ticks.put(tick)

    def close(self, notes: Mapping[str, str]) -> None:  # noqa: ARG002
        """Wait until everything is shown. A viewer that hangs is abandoned."""
        self._ticks.put(None)
        self._thread.join(_LAST_S)
        if self._thread.is_alive():
            self.lost = self.lost or f"no answer for {_LAST_S:g} s"

    def _show(self, opened: AbstractContextManager[LiveScene]) -> None:
        try:
            with opened as scene:
                self._draw(scene)
        except Exception as err:
            self.lost = " ".join(str(err).split()) or type(err).__name__

    def _draw(self, scene: LiveScene) -> None:
        is_over, wait_s = False, self._batch_s
        while not is_over:
            is_over = self._take(time.monotonic() + wait_s)
            if not self._collector.has_samples:
                continue
            start_s = time.thread_time()
            run = self._collector.build_run()
            if is_over:
                scene.finish(run)
            else:
                scene.update(run)
            wait_s = max(self._batch_s, _SHARE * (time.thread_time() - start_s))

    def _take(self, until_s: float) -> bool:
        """Collect ticks until a time, and return whether all ticks have arrived."""
        ticks: list[Tick] = []
        while (left_s := until_s - time.monotonic()) > 0.0:
            try:
                tick = self._ticks.get(timeout=left_s)
            except Empty:
                break
            if tick is None:
                self._collector.take(ticks)
                return True
            ticks.append(tick)
        self._collector.take(ticks)
        return False


def follow_recording(path: str | Path, url: str | None = None) -> Run:
    """Show a growing recording until it is finished, and return the run.

    Each chunk is read once, as soon as it is complete in the file. If the recorder was killed, the
    existing part of the file is shown.

    Args:
        path: A recording by turtlelog. A finished recording is shown directly.
        url: Address of a running viewer, as `rerun+http://127.0.0.1:9876/proxy`. By default, a
            viewer is opened, and after the end of the recording the call waits until its window is
            closed.

    Raises:
        LogError: If the file is not a recording by turtlelog, or contains no pose at its end.
        ShowError: If there is no such file, no window can be opened, or the viewer at the address
            goes away.
    """
    require_recordings([path])
    with ExitStack() as closing:
        tail = closing.enter_context(RecordingTail(path))
        viewer = None
        if url is None:
            viewer, url = closing.enter_context(open_window(_ADVICE))
        else:
            require_viewer(url)
        try:
            with _connect_scene(url) as scene:
                run = _show_growth(tail, scene)
        except ConnectionError as err:
            if viewer is None or not viewer.has_ended:
                raise ShowError(f"viewer: expected it to stay, found: {err}") from err
            return tail.read_last_run()
        if viewer is not None:
            viewer.wait()
    return run


def _show_growth(tail: RecordingTail, scene: LiveScene) -> Run:
    grown_s = time.monotonic()
    while not tail.is_finished:
        run = tail.read_run()
        if run is not None:
            scene.update(run)
            grown_s = time.monotonic()
        elif time.monotonic() - grown_s > _QUIET_S and not tail.is_live:
            break
        time.sleep(0.0 if tail.is_finished else _POLL_S)
    run = tail.read_last_run()
    scene.finish(run)
    return run


@contextmanager
def _connect_scene(url: str) -> Iterator[LiveScene]:
    """Yield a scene in the viewer at an address, as in follow_recording."""
    stream = GrowingStream(APPLICATION_ID)
    recording_stream.require_enabled(stream, "viewer")
    stream.set_log_time_enabled(False)
    try:
        stream.connect_grpc(url)
    except Exception as err:
        raise ShowError(f"{url}: expected the address of a viewer: {err}") from err
    with _keep_scene(stream) as scene:
        yield scene


@contextmanager
def _keep_scene(stream: GrowingStream, size: tuple[int, int] | None = None) -> Iterator[LiveScene]:
    """Yield the scene of a stream. The stream ends with the block."""
    try:
        yield LiveScene(stream, size)
    finally:
        recording_stream.abandon_stream(stream)


_READY_S: Final = 30.0
"""Time for the page to load the viewer, 17 MB at 5 Mbit/s [s]; later data are kept and shown."""


class WidgetStream(GrowingStream):
    """Stream of a growing run into a widget below the present cell, one message per round."""

    def __init__(self, size: tuple[int, int]) -> None:
        """Show a widget of this width and height [pixels], and wait until its page is ready.

        Raises:
            ShowError: If this is no notebook, or the environment disables Rerun.
            LibraryError: If the extra `notebook` is not installed.
        """
        super().__init__(APPLICATION_ID)
        recording_stream.require_enabled(self, "widget")
        self.set_log_time_enabled(False)
        load_library("rerun_notebook")
        from IPython import get_ipython  # with the extra only

        if not hasattr(get_ipython(), "kernel"):
            raise ShowError(
                "LiveViewer: there is no notebook here that could show a widget; give the address"
                " of a viewer, for example rerun+http://127.0.0.1:9876/proxy"
            )
        self._memory, self._viewer = self.memory_recording(), build_viewer(size)
        # From version 7.4 on, ipykernel passes the page's message that it is ready to the thread
        # that used the widget last, but this thread is waiting here. Without a last user, it stays
        # in the thread in which JupyterLab handles messages of widgets.
        vars(self._viewer._viewer.comm).pop("_reply_subshell_id", None)
        self._viewer.display()
        self._viewer._viewer.block_until_ready(_READY_S)

    def flush(self, *, timeout_sec: float = 0.0) -> None:  # noqa: ARG002
        """Send what was drawn since the last time. The page never delays this."""
        self._viewer._viewer.send_rrd(self._memory.drain_as_bytes())


def build_viewer(size: tuple[int, int]) -> Viewer:
    """Return an empty widget of this width and height [pixels]."""
    return Viewer(width=size[0], height=size[1], use_global_recording=False)
