"""Rerun's viewer as a widget of a notebook, with a finished run or a growing one."""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from rerun.notebook import Viewer

from turtlelog.draw.rerun.entities import APPLICATION_ID
from turtlelog.draw.rerun.growing_scene import GrowingStream
from turtlelog.draw.rerun.rrd_file import require_enabled
from turtlelog.draw.rerun.run_scene import write_run_rrd
from turtlelog.errors import ShowError
from turtlelog.libraries import load_library
from turtlelog.run import Run

WIDGET_SIZE: Final = (960, 640)
"""Width and height that fit a cell of JupyterLab on a small screen [pixels]."""

_READY_S: Final = 30.0
"""Time for the page to load the viewer, compressed 17 MB, at 5 Mbit/s [s]. The data for a page that
takes longer are kept and shown later."""


def build_run_widget(run: Run, size: tuple[int, int]) -> Viewer:
    """Return a notebook widget of this width and height [pixels] with the recording of a run.

    The page gets the recording in one message. Rerun itself would send one message per part; a
    browser without a graphics card often shows nothing after hundreds of messages.

    Raises:
        ShowError: If the environment disables Rerun.
    """
    with TemporaryDirectory(prefix="turtlelog-") as folder:
        file = Path(folder, "run.rrd")
        try:
            write_run_rrd(run, file, size=size)
        except ShowError as err:
            raise ShowError(str(err).replace(str(file), run.name)) from err
        data = file.read_bytes()
    viewer = _build_viewer(size)
    viewer._viewer.send_rrd(data)
    return viewer


class WidgetStream(GrowingStream):
    """Stream of a growing run into a widget below the present cell, one message per round."""

    def __init__(self, size: tuple[int, int]) -> None:
        """Show a widget of this width and height [pixels], and wait until its page is ready.

        Raises:
            ShowError: If this is no notebook, or the environment disables Rerun.
            LibraryError: If the extra `notebook` is not installed.
        """
        super().__init__(APPLICATION_ID)
        require_enabled(self, "widget")
        self.set_log_time_enabled(False)
        load_library("rerun_notebook")
        _require_notebook()
        self._memory, self._viewer = self.memory_recording(), _build_viewer(size)
        _show_page(self._viewer)

    def flush(self, *, timeout_sec: float = 0.0) -> None:  # noqa: ARG002
        """Send what was drawn since the last time. The page never delays this."""
        self._viewer._viewer.send_rrd(self._memory.drain_as_bytes())


def _build_viewer(size: tuple[int, int]) -> Viewer:
    width, height = size
    return Viewer(width=width, height=height, use_global_recording=False)


def _show_page(viewer: Viewer) -> None:
    """Show a widget and wait until its page sends a message that it can receive data.

    From version 7.4 on, ipykernel passes the message to the thread that used the widget last, but
    this thread is waiting here. Without a last user, the message stays in the thread in which
    JupyterLab handles messages of widgets.
    """
    vars(viewer._viewer.comm).pop("_reply_subshell_id", None)
    viewer.display()
    viewer._viewer.block_until_ready(_READY_S)


def _require_notebook() -> None:
    from IPython import get_ipython  # with the extra only

    if not hasattr(get_ipython(), "kernel"):
        raise ShowError(
            "LiveViewer: there is no notebook here that could show a widget; give the address of a"
            " viewer, for example rerun+http://127.0.0.1:9876/proxy"
        )
