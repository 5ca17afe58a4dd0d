"""A run in Rerun's viewer as a widget of a notebook."""

from pathlib import Path
from tempfile import TemporaryDirectory

from rerun.notebook import Viewer

from turtlelog.draw.rerun.run_scene import write_run_rrd
from turtlelog.errors import ShowError
from turtlelog.run import Run


def build_run_widget(run: Run, size: tuple[int, int]) -> Viewer:
    """Return a widget of this width and height [pixels] that holds all of a run.

    The page gets the recording in one message. Rerun's own way is a message for each part: of
    hundreds at once a browser without a graphics card shows nothing.

    Raises:
        ShowError: Where the environment switches Rerun off.
    """
    with TemporaryDirectory(prefix="turtlelog-") as folder:
        file = Path(folder, "run.rrd")
        try:
            write_run_rrd(run, file, size=size)
        except ShowError as err:
            raise ShowError(str(err).replace(str(file), run.name)) from err
        data = file.read_bytes()
    width, height = size
    viewer = Viewer(width=width, height=height, use_global_recording=False)
    viewer._viewer.send_rrd(data)
    return viewer
