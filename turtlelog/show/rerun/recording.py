"""One recording in one .rrd file: strict, without wall-clock time, complete or not there at all."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb

from turtlelog.errors import ShowError
from turtlelog.show.files import replace_file
from turtlelog.show.rerun.entities import APPLICATION_ID


@contextmanager
def open_recording(
    path: str | Path, *, name: str, layout: rrb.Blueprint
) -> Iterator[rr.RecordingStream]:
    """Yield a stream into a file that takes its name when it is complete.

    Raises:
        ShowError: Where the file cannot be written.
    """
    path = Path(path)
    with replace_file(path) as part_path, strict_mode():
        # The properties that Rerun would send hold the wall-clock time.
        with rr.RecordingStream(APPLICATION_ID, send_properties=False) as stream:
            stream.set_log_time_enabled(False)
            _save(stream, part_path, path, layout)
            stream.send_recording_name(name)
            yield stream
        stream.disconnect()
        if not part_path.stat().st_size:
            raise ShowError(f"{path}: expected Rerun to write the file, found none")


def _save(stream: rr.RecordingStream, part_path: Path, path: Path, layout: rrb.Blueprint) -> None:
    if not rr.is_enabled(stream):
        found = f"found RERUN={os.environ.get('RERUN', '')!r} in the environment"
        raise ShowError(f"{path}: expected Rerun to be switched on, {found}")
    try:
        stream.save(part_path, default_blueprint=layout)
    except Exception as err:
        raise ShowError(f"{path}: expected a file that can be written: {err}") from err


@contextmanager
def strict_mode() -> Iterator[None]:
    """Make errors raise for a while: without it Rerun warns and drops the data."""
    before = rr.strict_mode()
    rr.set_strict_mode(True)
    try:
        yield
    finally:
        rr.set_strict_mode(before)
