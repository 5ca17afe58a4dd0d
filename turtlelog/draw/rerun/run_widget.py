"""A run in Rerun's viewer as a widget of a notebook."""

import rerun as rr
from rerun.notebook import Viewer

from turtlelog.draw.rerun.entities import APPLICATION_ID
from turtlelog.draw.rerun.layout import build_run_layout
from turtlelog.draw.rerun.rrd_file import require_enabled, strict_mode
from turtlelog.draw.rerun.run_scene import build_run_scene
from turtlelog.run import Run


def build_run_widget(run: Run, size: tuple[int, int]) -> Viewer:
    """Return a widget of this width and height [pixels] that holds all of a run.

    Raises:
        ShowError: Where the environment switches Rerun off.
    """
    scene = build_run_scene(run, size=size)
    with strict_mode():
        # The properties that Rerun would send hold the wall-clock time.
        stream = rr.RecordingStream(APPLICATION_ID, send_properties=False)
        require_enabled(stream, run.name)
        stream.set_log_time_enabled(False)
        width, height = size
        layout = build_run_layout(scene.content)
        viewer = Viewer(width=width, height=height, recording=stream, blueprint=layout)
        stream.send_recording_name(run.name)
        scene.draw(stream)
        stream.flush()
    return viewer
