"""Files that are either complete or not there."""

import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from turtlelog.errors import LogError
from turtlelog.log.live_lock import is_live


@contextmanager
def replace_when_complete(path: str | Path) -> Iterator[Path]:
    """Yield a temporary name beside `path` to write to; it is renamed when the block ends well.

    Where the block fails the temporary file is removed, and a file that was there stays. The
    temporary name ends in `.part`, so nothing that looks for `*.mcap` finds it; a writer that
    guesses its format from the name must be told.

    Raises:
        LogError: In one line, where the place cannot be written, or holds a recording in progress.
    """
    path = Path(path)
    # Renaming over a device would replace the device.
    if path.exists() and not path.is_file():
        kind = "folder" if path.is_dir() else "device"
        raise LogError(f"{path}: expected the name of a file to write, found a {kind}")
    _refuse_live(path)
    temporary = path.with_name(f".turtlelog-{secrets.token_hex(6)}.part")
    try:
        # Made at once, so that a place that cannot be written fails before any work is done.
        temporary.touch(exist_ok=False)
        yield temporary
        _refuse_live(path)  # it may have begun meanwhile
        temporary.replace(path)
    except OSError as err:
        raise LogError(
            f"{path}: expected a place that can be written, found: {err.strerror or err}"
        ) from err
    finally:
        temporary.unlink(missing_ok=True)


def _refuse_live(path: Path) -> None:
    if is_live(path):
        raise LogError(
            f"{path}: expected a file that may be replaced, found a live recording of it"
        )
