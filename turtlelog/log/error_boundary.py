"""Where foreign errors become ours: one line that names the file. And the errors of damage."""

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
"""A file as large as this is no pointer, as the specification of Git LFS says [bytes]."""


class DamageError(LogError):
    """A file that is not what its writer wrote, or not all of it."""


class LimitError(DamageError):
    """A file that asks for more than one of its size may: what follows would be refused as well."""


class UnfinishedError(DamageError):
    """A file whose writer never came to its end, or whose end is cut off."""


@contextmanager
def name_file(path: str | Path, *, expected: str) -> Iterator[None]:
    """Turn whatever goes wrong while a file is read into one LogError line that names it.

    On damaged files the libraries raise nearly everything: struct.error, KeyError, MemoryError,
    OverflowError, UnicodeDecodeError, RecursionError and their own. What no bytes can cause is a
    defect of turtlelog, and stays what it is.
    """
    try:
        yield
    except _DEFECTS:
        raise
    except FileNotFoundError as err:
        from turtlelog.scenario import PRESETS  # only mistakes need them

        raise LogError(f"{path}: {describe_missing(path, PRESETS)}") from err
    except OSError as err:
        raise LogError(f"{path}: expected {expected}, found: {err.strerror or err}") from err
    except TurtlelogError as err:
        raise LogError(f"{path}: {err}") from err
    except Exception as err:
        raise LogError(f"{path}: expected {expected}, found {describe_error(err)}") from err


def open_file(path: str | Path) -> BinaryIO:
    """Open a file to read, but no pipe, which may block forever, and no device, which may not end.

    Raises:
        LogError: Where it is one of these, or what Git LFS leaves in the place of a file.
        OSError: Where it cannot be read.
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
    """Refuse a pointer of Git LFS, and close it; of other files nothing has been read."""
    start = stream.read(len(LFS_POINTER))
    if start == LFS_POINTER:
        stream.close()
        raise LogError("this is a Git LFS pointer, not the file: git lfs pull")
    stream.seek(0)
