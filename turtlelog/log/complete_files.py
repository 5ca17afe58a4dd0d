"""Files that are either complete or not there."""

import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from turtlelog.errors import LogError
from turtlelog.log.live_lock import is_live


@contextmanager
def replace_when_complete(path: str | Path) -> Iterator[Path]:
    """Yield a temporary name beside `path` to write to; it is renamed when the block ends well.

    Where the block fails the temporary file is removed, and a file that was there stays. A file
    that is replaced keeps its permissions, and its owner where the system allows it. A link stays,
    and the file that it leads to is replaced or made. The temporary name ends in `.part`, so
    nothing that looks for `*.mcap` finds it; a writer that guesses its format from the name must be
    told.

    Raises:
        LogError: In one line, where the place cannot be written, or holds a recording in progress.
    """
    path = Path(path)
    # Renaming over a device would replace the device.
    if path.exists() and not path.is_file():
        kind = "folder" if path.is_dir() else "device"
        raise LogError(f"{path}: expected the name of a file to write, found a {kind}")
    _refuse_live(path)
    target = Path(os.path.realpath(path))
    if target.is_symlink():
        raise LogError(f"{path}: expected the name of a file to write, found a link to itself")
    temporary = target.with_name(f".turtlelog-{secrets.token_hex(6)}.part")
    try:
        # Made at once, so that a place that cannot be written fails before any work is done.
        temporary.touch(exist_ok=False)
        # What only its owner may read is not shown to others on the way, either.
        _copy_rights(target, temporary, extra=stat.S_IRUSR | stat.S_IWUSR)
        yield temporary
        _refuse_live(path)  # it may have begun meanwhile
        _copy_rights(target, temporary)
        temporary.replace(target)
    except OSError as err:
        raise LogError(
            f"{path}: expected a place that can be written, found: {err.strerror or err}"
        ) from err
    finally:
        temporary.unlink(missing_ok=True)


def _copy_rights(source: Path, target: Path, *, extra: int = 0) -> None:
    """Give a file the owner and the permissions of another, if that is there."""
    try:
        found = source.stat()
    except FileNotFoundError:
        return
    if hasattr(os, "chown"):
        with suppress(PermissionError):
            os.chown(target, found.st_uid, found.st_gid)
    with suppress(PermissionError):  # a disk without permissions of its own
        target.chmod(stat.S_IMODE(found.st_mode) | extra)


def _refuse_live(path: Path) -> None:
    if is_live(path):
        raise LogError(
            f"{path}: expected a file that may be replaced, found a live recording of it"
        )
