"""Files and folders that appear only when complete; detection of live recordings."""

import os
import stat
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import UnsupportedOperation
from pathlib import Path
from typing import BinaryIO

from turtlelog.errors import LogError
from turtlelog.files.urls import RemotePath, make_path
from turtlelog.log.error_boundary import name_file


@contextmanager
def replace_when_complete(path: str | Path) -> Iterator[Path]:
    """Yield a temporary file name next to `path`; the file is renamed when the block succeeds.

    If the block fails, the temporary file is removed and an existing file stays. A replaced file
    keeps its permissions and, if the system allows it, its owner. If `path` is a symbolic link, the
    link stays, and its target is replaced or created. The temporary name ends in `.part`, so it
    does not match `*.mcap`. Writers that guess the format from the name need the format explicitly.

    Raises:
        LogError: If the path cannot be written, or contains a recording in progress; one line.
    """
    path = make_path(path)
    if isinstance(path, RemotePath):
        with _put_when_complete(path) as temporary:
            yield temporary
        return
    # Renaming a file to the name of a device would replace the device.
    if path.exists() and not path.is_file():
        kind = "folder" if path.is_dir() else "device"
        raise LogError(f"{path}: expected the name of a file to write, found a {kind}")
    _refuse_live(path)
    target = Path(os.path.realpath(path))
    if target.is_symlink():
        raise LogError(f"{path}: expected the name of a file to write, found a link to itself")
    temporary = _name_beside(target)
    try:
        # Created at once: if the place is not writable, the error comes before any work is done.
        temporary.touch(exist_ok=False)
        # A file that only its owner may read stays private while it is written.
        _copy_rights(target, temporary, extra=stat.S_IRUSR | stat.S_IWUSR)
        yield temporary
        _refuse_live(path)  # a recording may have begun meanwhile
        _copy_rights(target, temporary)
        temporary.replace(target)
    except OSError as err:
        raise LogError(f"{path}: cannot be written: {err.strerror or err}") from err
    finally:
        temporary.unlink(missing_ok=True)


def _name_beside(target: Path) -> Path:
    return target.with_name(f".turtlelog-{os.urandom(6).hex()}.part")


def remove_leftovers(folder: Path) -> None:
    """Remove the temporary files of killed processes from a folder.

    Use this only if no other process writes to the folder, because that process would lose its
    temporary files.
    """
    for leftover in folder.glob(".turtlelog-" + "[0-9a-f]" * 12 + ".part"):
        with suppress(OSError):  # a folder, or a file that is being renamed
            leftover.unlink()


@contextmanager
def _put_when_complete(path: RemotePath) -> Iterator[Path]:
    """Yield a local temporary name; at the end the file is uploaded to the URL."""
    import tempfile  # only writing needs these

    with name_file(path, expected="a place that can be written"):
        from turtlelog.files.requests import require_writable

        require_writable(path.url)
    try:
        with tempfile.TemporaryDirectory(prefix="turtlelog-") as folder:
            temporary = Path(folder) / f"{path.name}.part"
            temporary.touch()
            yield temporary
            with name_file(path, expected="a place that can be written"):
                path.put(temporary)
    except OSError as err:
        raise LogError(
            f"{path}: expected room for it in {tempfile.gettempdir()}, found: {err.strerror or err}"
        ) from err


def _copy_rights(source: Path, target: Path, *, extra: int = 0) -> None:
    """Copy owner and permissions of another file, if it exists."""
    try:
        found = source.stat()
    except FileNotFoundError:
        return
    if hasattr(os, "chown"):
        with suppress(PermissionError):
            os.chown(target, found.st_uid, found.st_gid)
    with suppress(PermissionError):  # a disk without permissions
        target.chmod(stat.S_IMODE(found.st_mode) | extra)


def _refuse_live(path: Path) -> None:
    if is_live(path):
        raise LogError(
            f"{path}: expected a file that may be replaced, found a live recording of it"
        )


@contextmanager
def create_folder(path: str | Path) -> Iterator[Path]:
    """Yield a temporary folder next to `path` for writing; it is renamed when the block succeeds.

    An existing folder is refused, as by `ros2 bag`, because it may contain other files. An empty
    folder is accepted.

    Raises:
        LogError: If the folder is not empty or cannot be written; one line.
    """
    path = make_path(path)
    is_empty = path.is_dir() and not any(path.iterdir())
    if (path.exists() or path.is_symlink()) and not is_empty:
        kind = "a folder with files" if path.is_dir() else "a file"
        raise LogError(f"{path}: expected the name of a new folder, found {kind}")
    import shutil

    # "." and "run/.." get a name only as absolute paths.
    target = path.resolve()
    temporary = _name_beside(target)
    try:
        temporary.mkdir()
        yield temporary
        if is_empty:
            target.rmdir()
        temporary.rename(target)
    except OSError as err:
        raise LogError(f"{path}: cannot be written: {err.strerror or err}") from err
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


if sys.platform == "win32":
    # On this system nobody can replace an open file.
    def mark_live(stream: BinaryIO) -> None:
        """Do nothing."""

    def is_live(path: Path) -> bool:  # noqa: ARG001
        """Return False, because the system itself refuses to replace an open file."""
        return False

else:
    import fcntl

    def mark_live(stream: BinaryIO) -> None:
        """Lock a file while it is open, so that `is_live` detects it, if the system can lock files.

        Readers are not affected; only programs that test the lock see it.
        """
        try:
            fcntl.flock(stream.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
        except (UnsupportedOperation, OSError):
            return  # no file, or a file system without locks

    def is_live(path: Path) -> bool:
        """Return whether a process is recording to the file with this name; False without one."""
        try:
            with path.open("rb") as stream:
                fcntl.flock(stream.fileno(), fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        except OSError:
            return False
        return False
