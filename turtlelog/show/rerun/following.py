"""A recording in a viewer while somebody else is writing it."""

import time
from contextlib import ExitStack
from pathlib import Path
from typing import Final

from turtlelog.errors import ShowError
from turtlelog.log import RecordingTail
from turtlelog.run import Run
from turtlelog.show.rerun.connection import require_viewer
from turtlelog.show.rerun.live_scene import LiveScene, connect_scene
from turtlelog.show.rerun.live_viewer import open_window
from turtlelog.show.rerun.viewer import require_recordings

_POLL_S: Final = 0.1
_QUIET_S: Final = 3.0
"""A file that nobody writes, and that has not grown for so long, will not grow any more."""

_ADVICE: Final = (
    "`turtlelog view FILE --partial --snapshot X.png` makes a picture of what is there so far"
)


def follow_recording(path: str | Path, url: str | None = None) -> Run:
    """Show a recording that grows until it is finished, and return its run.

    Each chunk is read once, as soon as it stands in the file. A file that ends without its end,
    since its recorder was killed, is shown up to there.

    Args:
        path: A recording by turtlelog; one that is finished is shown as it is.
        url: A viewer that runs, as `rerun+http://127.0.0.1:9876/proxy`; otherwise one is opened,
            and when the recording has ended, the call waits until its window is closed.

    Raises:
        LogError: Where the file is no recording by turtlelog, or holds no pose when it ends.
        ShowError: Where there is no such file, no window can be opened, or the viewer at the
            address goes away.
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
            with connect_scene(url) as scene:
                run = _show_growth(tail, scene)
        except ConnectionError as err:
            if viewer is None or not viewer.has_ended:
                raise ShowError(f"viewer: expected it to stay, found: {err}") from err
            return tail.read_last_run()
        if viewer is not None:
            viewer.wait()
    return run


def _show_growth(tail: RecordingTail, scene: LiveScene) -> Run:
    """Draw what comes until there is nothing more to come."""
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
