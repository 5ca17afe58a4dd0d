"""The search for recordings below folders: which files and folders are recordings; their order."""

import hashlib
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from turtlelog.display import split_numbers
from turtlelog.errors import LogError
from turtlelog.files.urls import RemotePath, is_url
from turtlelog.log.engine.opening import BAG_SUFFIXES
from turtlelog.log.exported_tables import list_table_files
from turtlelog.log.file_access import open_file
from turtlelog.log.file_info import METADATA_FILE
from turtlelog.log.ros2.bag_files import list_bag_files

ENDINGS: Final = (*BAG_SUFFIXES, ".bag", ".csv", ".json", ".parquet", ".tsv", ".tum")
"""Suffixes of recordings. A .txt file, mostly prose, is read only if it is named."""

_BAG_MARK: Final = b"rosbag2_bagfile_information"
_TABLE_MARK: Final = b"turtlelog.kind"
_MOST_FOOTER: Final = 2**24
"""Largest footer of a Parquet file that is read [bytes]; tables of all metrics have 0.1 MB."""

_HEAD_BYTES: Final = 4096
"""Number of bytes of metadata.yaml that are read; the first key marks a bag."""

_TABLE_HEADS: Final = (b"run,Kp [", b"file,run,", b"verdict,file,check,")
"""Beginnings of the CSV tables of `demo`, `compare`, `metrics` and `check`."""


@dataclass(frozen=True, slots=True)
class FoundRecording:
    """A recording to read, with its size and time when it was found.

    The label is relative to the given folder; for several folders or a file given by name, the name
    as given.
    """

    path: str  # path of the file or folder
    label: str  # name in tables, with slashes; invalid Unicode is escaped
    size: int  # size of the file, or of all files in the bag's folder [bytes]; -1 if unknown
    mtime_ns: int  # time of the last change, or for a folder of its newest file [ns]; -1 if unknown


def find_recordings(
    paths: Sequence[str | Path], *, without: Iterable[str | Path] = ()
) -> list[FoundRecording]:
    """Return the given recordings and those below the given folders, each path once.

    Names are sorted in each folder, with numbers in names sorted by value. Names that begin with a
    dot and `__pycache__` are left out. A bag's folder is one recording, and so is a folder of
    exported tables. A link to a folder outside the given folders is followed; no folder is walked
    twice. A folder that cannot be listed counts as a recording that cannot be read.

    Args:
        paths: Files, bags and folders.
        without: Files to leave out, such as the table to be written.

    Raises:
        LogError: If a folder contains no recording, or a path is a URL, for which no time shows
            whether it has changed.
    """
    walk = _Walk(paths, without)
    is_one = len({os.path.realpath(path) for path in paths}) == 1
    found: dict[str, FoundRecording] = {}
    labels: set[str] = set()
    for path in paths:
        if isinstance(path, RemotePath) or is_url(str(path)):
            raise LogError(f"{path}: expected a file or folder on a disk, found a URL")
    for path in map(Path, paths):
        count = 0
        for one in walk.list_below(path):
            count += 1
            place = str(one.absolute())
            if place not in found:
                label = told = _label(one, path if is_one else None)
                number = 1
                while label in labels:  # names of invalid Unicode may be escaped to the same text
                    number, label = number + 1, f"{told} ({number + 1})"
                labels.add(label)
                size, mtime_ns = stat_recording(one)
                found[place] = FoundRecording(str(one), label, size, mtime_ns)
        if not count:
            raise LogError(f"{path}: no recordings in this folder")
    return list(found.values())


class _Walk:
    def __init__(self, paths: Sequence[str | Path], without: Iterable[str | Path]) -> None:
        self._roots = [os.path.realpath(path) for path in paths]
        self._without = {os.path.realpath(path) for path in without}
        self._seen: set[str] = set()

    def list_below(self, root: Path) -> Iterator[Path]:
        """Yield the paths of recordings below a path; for a file or bag, its own path."""
        self._seen.clear()
        # An explicit stack, because folders may be nested deeper than Python's calls.
        waiting = [root]
        while waiting:
            path = waiting.pop()
            if not _is_folder(path):
                yield path
            elif self._enter(path, is_root=path == root):
                if is_one_recording(path):
                    yield path
                    continue
                try:
                    inside = sorted(
                        path.iterdir(),
                        key=lambda one: (split_numbers(one.name), one.name),
                        reverse=True,
                    )
                except OSError:
                    yield path
                else:
                    waiting += filter(self._counts, inside)

    def _enter(self, path: Path, *, is_root: bool) -> bool:
        """Return whether to walk a folder, which must not have been walked under another name."""
        real = os.path.realpath(path)
        if real in self._seen:
            return False
        is_link = path.is_symlink() and not is_root
        if is_link and any(f"{real}{os.sep}".startswith(f"{root}{os.sep}") for root in self._roots):
            return False
        self._seen.add(real)
        return True

    def _counts(self, path: Path) -> bool:
        if path.name.startswith(".") or path.name == "__pycache__":
            return False
        if _is_folder(path):
            return True
        name = path.name.lower()
        if not name.endswith(ENDINGS) or os.path.realpath(path) in self._without:
            return False
        try:
            if name.endswith(".csv"):
                return not _read_start(path).startswith(_TABLE_HEADS)
            return not (name.endswith(".parquet") and _is_result_table(path))
        except (OSError, LogError):  # its reader reports the error
            return True


def _is_folder(path: Path) -> bool:
    try:
        return path.is_dir()
    except OSError:  # in a folder that can be listed but not entered
        return False


def _is_result_table(path: Path) -> bool:
    with open_file(path) as stream:  # the mark is in the footer of the Parquet file
        stream.seek(-8, os.SEEK_END)
        length = min(int.from_bytes(stream.read(4), "little"), _MOST_FOOTER)
        stream.seek(-8 - length, os.SEEK_END)
        return _TABLE_MARK in stream.read(_MOST_FOOTER)


def is_one_recording(path: Path) -> bool:
    """Return whether a path is a file, a bag's folder, or a folder with the tables of one run."""
    if not _is_folder(path):
        return True
    place = path / METADATA_FILE
    try:
        files = [one for one in path.iterdir() if one.name.lower().endswith(BAG_SUFFIXES)]
        # A truncated, empty or missing metadata file is beside the files that it describes.
        if place.is_file() and (files or _BAG_MARK in _read_start(place)):
            return True
        if len(files) > 1 and list_bag_files(path):
            return True
        return bool(list_table_files(path))
    except (OSError, LogError):
        return False


def _read_start(path: Path) -> bytes:
    """Return the first bytes of a file; empty for a Git LFS pointer."""
    try:
        with open_file(path) as stream:
            return stream.read(_HEAD_BYTES)
    except LogError:
        return b""


def _label(path: Path, root: Path | None) -> str:
    told = path if root in {None, path} else path.relative_to(root or path)
    return told.as_posix().encode("utf-8", "backslashreplace").decode()


def stat_recording(path: Path) -> tuple[int, int]:
    """Return size and time of the last change of a file or bag; -1 for unknown values."""
    try:
        found = [one.stat() for one in list_contents(path)]
    except OSError:
        return -1, -1
    if not found:
        return -1, -1
    return sum(one.st_size for one in found), max(one.st_mtime_ns for one in found)


def list_contents(path: Path) -> list[Path]:
    """Return the file itself, or the files in a bag's folder; OSError if it cannot be listed."""
    return sorted(filter(Path.is_file, path.iterdir())) if path.is_dir() else [path]


def hash_recording(path: Path) -> str:
    """Return the SHA-256 of a file, or of the names and contents of a bag's files.

    OSError if a file cannot be read, LogError for a pipe or a device.
    """
    files, whole = list_contents(path), hashlib.sha256()
    if files == [path]:
        with open_file(path) as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()  # type: ignore[arg-type]
    for file in files:
        whole.update(f"{file.name!r} {hash_recording(file)}\n".encode())
    return whole.hexdigest()
