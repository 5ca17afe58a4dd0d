"""Rerun's native viewer, as a child process that ends with its block."""

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from typing import IO, Final

from turtlelog.errors import ShowError

_LOCAL: Final = ("--bind", "127.0.0.1")
_PATIENCE_S: Final = 5.0


class ViewerProcess:
    """A viewer that was started, and what it has said on stderr."""

    def __init__(self, process: "subprocess.Popen[bytes]", messages: IO[bytes]) -> None:
        self._process, self._messages = process, messages

    @property
    def process_id(self) -> int:
        """The number by which the system knows it."""
        return self._process.pid

    @property
    def has_ended(self) -> bool:
        """Whether the process is gone."""
        return self._process.poll() is not None

    def wait(self) -> int:
        """Wait for its end and return its exit code."""
        return self._process.wait()

    def read_error(self) -> str:
        """Return what it said about a failure, in one line without places in its source."""
        self._messages.seek(0)
        lines = self._messages.read().decode(errors="replace").splitlines()
        errors = [line for line in lines if re.search(r"^Error:|panicked at", line)]
        if not errors:
            return f"exit code {self._process.poll()}"
        return re.sub(
            r"^(Error: |thread '.*' panicked at )|(os error )?at \S+\.rs:\d+: ", "", errors[0]
        )

    def end(self) -> None:
        """End the process if it has not ended."""
        if self.has_ended:
            return
        self._process.terminate()
        try:
            self._process.wait(_PATIENCE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def find_viewer() -> Path:
    """Return the viewer's binary; the `rerun` script would put a process of its own in between.

    Raises:
        ShowError: Where there is none.
    """
    name = "rerun.exe" if sys.platform == "win32" else "rerun"
    package = find_spec("rerun_cli")
    binary = Path(package.origin).with_name(name) if package and package.origin else Path(name)
    if not binary.is_file():
        raise ShowError(f"{binary}: expected the viewer that comes with rerun-sdk, found none")
    return binary


def open_viewer(paths: Sequence[str | Path]) -> None:
    """Open recordings in a window and wait until it is closed.

    Raises:
        ShowError: Where a file is missing, or no window can be opened.
    """
    require_recordings(paths)
    with start_viewer(["--port", "auto", *(str(path) for path in paths)]) as viewer:
        if viewer.wait():
            raise ShowError(
                f"viewer: expected a window until it is closed, found: {viewer.read_error()};"
                " without a display `turtlelog view FILE --snapshot X.png` makes a picture,"
                " `--save X.rrd` a file to open elsewhere"
            )


@contextmanager
def start_viewer(options: Sequence[str]) -> Iterator[ViewerProcess]:
    """Start a viewer that listens on this machine only, and end it on the way out."""
    # The viewer leaves a folder behind in the temporary one: give it its own.
    with TemporaryFile() as messages, TemporaryDirectory(prefix="turtlelog-") as folder:
        process = subprocess.Popen(
            [*_find_guard(), find_viewer(), *_LOCAL, *options],
            env={**os.environ, "TMPDIR": folder, "TEMP": folder, "TMP": folder},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=messages,
        )
        viewer = ViewerProcess(process, messages)
        try:
            yield viewer
        finally:
            viewer.end()


def _find_guard() -> list[str]:
    """Return what ends a viewer whose parent was killed; only Linux knows how to."""
    guard = shutil.which("setpriv") if sys.platform == "linux" else None
    return [] if guard is None else [guard, "--pdeathsig", "TERM"]


def require_recordings(paths: Sequence[str | Path]) -> None:
    """Raise ShowError where there is no path, or no file at one."""
    if not paths:
        raise ShowError("viewer: expected at least one recording to open, found none")
    for path in paths:
        if not Path(path).is_file():
            raise ShowError(f"{path}: expected a recording, found no such file")
