"""Access to files: their kinds by first bytes, errors of one line, files that appear complete."""

import os
import stat
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from io import UnsupportedOperation
from pathlib import Path
from typing import BinaryIO, Final

from turtlelog.errors import LogError, TurtlelogError, describe_error
from turtlelog.files.text_files import LFS_POINTER, describe_missing
from turtlelog.files.urls import RemotePath, make_path

_DEFECTS = (AssertionError, AttributeError, ImportError, NameError)

_POINTER_BYTES: Final = 1024
"""Size from which a file is not a pointer, by the specification of Git LFS [bytes]."""


class DamageError(LogError):
    """A damaged or incomplete file."""


class LimitError(DamageError):
    """A file that exceeds the limits for its size, so that the rest would be refused as well."""


class UnfinishedError(DamageError):
    """An unfinished or truncated file."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Loss:
    """A segment of a file that could not be read.

    Attributes:
        start: Offset of the first byte in the file.
        end: Offset after the last byte; equal to `start` if bytes are missing there.
        reason: Expected and found content, in one clause.
    """

    start: int
    end: int
    reason: str


@contextmanager
def name_file(path: str | Path, *, expected: str) -> Iterator[None]:
    """Convert errors during reading into a one-line LogError with the file's name.

    For damaged files, libraries raise many kinds of errors. Errors that no file content can cause
    are defects of turtlelog and are not converted.
    """
    try:
        yield
    except _DEFECTS:
        raise
    except FileNotFoundError as err:
        from turtlelog.scenario import PRESETS  # only errors need them

        raise LogError(f"{path}: {describe_missing(path, PRESETS)}") from err
    except OSError as err:
        raise LogError(f"{path}: expected {expected}, found: {err.strerror or err}") from err
    except TurtlelogError as err:
        raise LogError(f"{path}: {err}") from err
    except Exception as err:
        raise LogError(f"{path}: expected {expected}, found {describe_error(err)}") from err


@contextmanager
def name_place(place: str) -> Iterator[None]:
    """Put a place within a file before the text of a LogError."""
    try:
        yield
    except LogError as err:
        raise LogError(f"{place}: {err}") from err


def open_file(path: str | Path) -> BinaryIO:
    """Open a file for reading. Pipes, which may block, and devices, which may not end, are refused.

    Raises:
        LogError: If the path is a pipe, a device, a Git LFS pointer or a file of zero bytes.
        OSError: If the file cannot be read.
    """
    path = make_path(path)
    found = path.stat()
    if not (stat.S_ISREG(found.st_mode) or stat.S_ISDIR(found.st_mode)):
        kind = "pipe" if stat.S_ISFIFO(found.st_mode) else "device"
        raise LogError(f"expected a file, found a {kind}")
    stream = path.file.open() if isinstance(path, RemotePath) else path.open("rb")
    if found.st_size < _POINTER_BYTES:
        if stream.read(len(LFS_POINTER)) == LFS_POINTER:
            stream.close()
            raise LogError("this is a Git LFS pointer, not the file: git lfs pull")
        stream.seek(0)
    # Behind a URL all bytes would be fetched.
    if not isinstance(path, RemotePath) and _has_only_zeros(stream):
        stream.close()
        raise LogError("only zero bytes; copy the file again from its source")
    return stream


def decode_text(data: bytes) -> str:
    """Return the text of a table or log; spreadsheet programs write a byte order mark first.

    Names and comments may be in Latin-1 (°) above a last row in ASCII.
    """
    is_wide = data.startswith((b"\xff\xfe", b"\xfe\xff"))
    try:
        return data.decode("utf-16" if is_wide else "utf-8-sig")
    except UnicodeDecodeError as err:
        if is_wide:
            raise LogError("expected UTF-16 text, found a damaged file") from err
        _, _, last = data.rstrip().rpartition(b"\n")
        if last.isascii() and b"\0" not in data:
            return data.decode("latin-1")
        found = f"0x{err.object[err.start]:02x}"
        raise LogError(f"byte {err.start}: expected UTF-8 text, found {found}") from err


def _has_only_zeros(stream: BinaryIO) -> bool:
    """Return whether a file has bytes and all are 0, as after a power cut or a cut copy."""
    has_bytes, size = False, START_SIZE
    while block := stream.read(size):
        if block.count(0) != len(block):
            has_bytes = False
            break
        has_bytes, size = True, _BLOCK_BYTES
    stream.seek(0)
    return has_bytes


MCAP0_MAGIC: Final = b"\x89MCAP0\r\n"
"""Magic bytes at the start and end of a file; importing them from mcap.writer takes 20 ms."""

SQLITE_MAGIC: Final = b"SQLite format 3\0"
_RERUN: Final = b"RRF2"
_BAG_DESCRIPTION: Final = b"rosbag2_bagfile_"
_BYTE_ORDER_MARK: Final = b"\xef\xbb\xbf"
_LETTERS: Final = frozenset((*b"\t\n\r", *range(0x20, 0x7F)))
START_SIZE: Final = len(SQLITE_MAGIC)
"""Number of bytes at the start of a file that determine its kind."""

_BLOCK_BYTES: Final = 2**20

_OTHERS: Final = {
    b"\x89PNG": "a picture",
    b"%PDF": "a PDF",
    b"PK\x03\x04": "a ZIP archive, to be unpacked first",
    b"\x1f\x8b": "compressed by gzip, to be unpacked first",
}
"""Files that are often taken for logs, by their first bytes, with advice."""


def check_start(stream: BinaryIO) -> None:
    """Check the magic bytes at the start."""
    stream.seek(0)
    reason = find_wrong_start(stream.read(START_SIZE))
    if reason is not None:
        raise LogError(f"byte 0: {reason}")


def find_wrong_start(start: bytes) -> str | None:
    """Return why a file does not start like MCAP, with advice; None if it does start so."""
    if start.startswith(MCAP0_MAGIC):
        return None
    found = f"it begins with {name_start(start)}" if start else "it is empty"
    if start.startswith(SQLITE_MAGIC):
        found = "it is a bag in SQLite"
    elif start.startswith(_RERUN):
        found = "it is a Rerun recording, which turtlelog view shows"
    elif start.startswith(_BAG_DESCRIPTION):
        found = "it is the metadata.yaml of a bag: name the folder that it is in"
    elif kind := next((kind for magic, kind in _OTHERS.items() if start.startswith(magic)), None):
        found = f"it is {kind}"
    elif start and set(start.removeprefix(_BYTE_ORDER_MARK)) <= _LETTERS:
        found = "it is text; names of logs and tables end in .csv, .json, .tsv, .tum or .txt"
    return f"not an MCAP file: {found}"


def name_start(start: bytes) -> str:
    """Return the first bytes of a file for an error."""
    return f"0x{start[: len(MCAP0_MAGIC)].hex()}" if any(start) else "zero bytes"


def name_write_error(path: str | Path, err: Exception) -> LogError:
    """Return a write error with the file's name."""
    if isinstance(err, UnicodeEncodeError):
        return LogError(f"{path}: expected text, found characters that UTF-8 lacks: {err}")
    # An error of an unwritable file names the file already.
    text = str(err)
    return LogError(text if text.startswith(f"{path}: ") else f"{path}: {text}")


@contextmanager
def replace_when_complete(
    path: str | Path, *, raising: type[TurtlelogError] = LogError
) -> Iterator[Path]:
    """Yield a temporary file name next to `path`; the file is renamed when the block succeeds.

    If the block fails, the temporary file is removed and an existing file stays. A replaced file
    keeps its permissions and, if the system allows it, its owner. If `path` is a symbolic link, the
    link stays, and its target is replaced or created. The temporary name ends in `.part`, so it
    does not match `*.mcap`. Writers that guess the format from the name need the format explicitly.

    Args:
        path: File to write.
        raising: Class of the errors.

    Raises:
        LogError: If the path cannot be written, or contains a recording in progress; one line.
    """
    try:
        with _replace(make_path(path)) as temporary:
            yield temporary
    except LogError as err:
        if isinstance(err, raising):
            raise
        raise raising(str(err)) from err


@contextmanager
def _replace(path: Path) -> Iterator[Path]:
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
    """Remove temporary files of killed processes from a folder to which no other process writes."""
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
        """Lock a file while it is open, if the system can, so that `is_live` detects it."""
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


def create_file(path: Path) -> BinaryIO:
    """Create a new file and return it unbuffered."""
    return path.open("xb", buffering=0)
