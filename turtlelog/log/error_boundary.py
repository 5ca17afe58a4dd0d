"""Conversion of library errors to one line with the file's name, and errors for damaged files."""

import stat
from collections.abc import Iterator
from contextlib import contextmanager
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


@contextmanager
def name_file(path: str | Path, *, expected: str) -> Iterator[None]:
    """Convert errors during reading into a one-line LogError with the file's name.

    For damaged files, libraries raise many kinds of errors: struct.error, KeyError, MemoryError,
    OverflowError, UnicodeDecodeError, RecursionError and their own. Errors that no file content can
    cause are defects of turtlelog and are not converted.
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


def open_file(path: str | Path) -> BinaryIO:
    """Open a file for reading. Pipes, which may block, and devices, which may not end, are refused.

    Raises:
        LogError: If the path is a pipe, a device or a Git LFS pointer.
        OSError: If the file cannot be read.
    """
    path = make_path(path)
    found = path.stat()
    if not (stat.S_ISREG(found.st_mode) or stat.S_ISDIR(found.st_mode)):
        kind = "pipe" if stat.S_ISFIFO(found.st_mode) else "device"
        raise LogError(f"expected a file, found a {kind}")
    stream = path.file.open() if isinstance(path, RemotePath) else path.open("rb")
    if found.st_size < _POINTER_BYTES:
        _refuse_pointer(stream)
    return stream


def _refuse_pointer(stream: BinaryIO) -> None:
    """Refuse and close a Git LFS pointer. The position in other files does not change."""
    start = stream.read(len(LFS_POINTER))
    if start == LFS_POINTER:
        stream.close()
        raise LogError("this is a Git LFS pointer, not the file: git lfs pull")
    stream.seek(0)
