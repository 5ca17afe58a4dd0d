"""Opening of files by their first bytes: MCAP or SQLite, plain or compressed."""

import io
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Final

import zstandard

from turtlelog.errors import LogError
from turtlelog.files.urls import RemotePath, make_path
from turtlelog.log.engine.limits import FRAMES, UNPACKED_FILE, ZSTD_MAGIC, Allowance, measure_stored
from turtlelog.log.engine.source import Source
from turtlelog.log.engine.sqlite_source import SqliteSource, open_sqlite
from turtlelog.log.file_access import (
    MCAP0_MAGIC,
    SQLITE_MAGIC,
    START_SIZE,
    DamageError,
    find_wrong_start,
    name_file,
    name_start,
    open_file,
)

_ROS1_MAGIC: Final = b"#ROSBAG V"
_MAGICS: Final = (MCAP0_MAGIC, SQLITE_MAGIC, ZSTD_MAGIC, _ROS1_MAGIC)

BAG_SUFFIXES: Final = (".mcap", ".db3", ".mcap.zstd", ".db3.zstd")
"""Suffixes of rosbag2's files."""

_STEP: Final = 2**9  # bytes unpacked at a time; the result may have up to 16 MiB


def is_bag_file(path: Path) -> bool:
    """Return whether a file begins like an MCAP, SQLite or compressed file, or a ROS 1 bag."""
    with name_file(path, expected="a recording, a bag or a log"), open_file(path) as stream:
        return stream.read(START_SIZE).startswith(_MAGICS)


def require_one_storage(files: tuple[Path, ...]) -> None:
    """Refuse SQLite beside MCAP files, which no recorder writes, and a file with two names."""
    if len({".db3" in file.suffixes for file in files}) > 1:
        names = ", ".join(file.name for file in files)
        raise LogError(f"expected files of one storage, found MCAP beside SQLite: {names[:200]}")
    places: dict[tuple[int, int], Path] = {}
    for file in files if len(files) > 1 else ():
        found = file.stat()
        first = places.setdefault((found.st_dev, found.st_ino), file)
        if first is not file and found.st_ino:
            raise LogError(f"expected each file once, found {first.name} and {file.name} are one")


class NoMcapError(LogError):
    """Error of a SQLite file that shows no damage where MCAP is required."""


@contextmanager
def open_storage(path: str | Path) -> Iterator[BinaryIO | SqliteSource]:
    """Open a file for reading: an MCAP stream (with unchecked content) or a SQLite bag.

    A file that is compressed as a whole is unpacked into a temporary folder.

    Raises:
        LogError: If the file cannot be read, or for errors while it is open; one line with it.
    """
    path = make_path(path)
    expected = "a bag in SQLite" if ".db3" in path.suffixes else "an MCAP file"
    with name_file(path, expected=expected), _open_content(path) as (stream, place):
        if _read_head(stream) == SQLITE_MAGIC:
            stored_size = measure_stored(stream)
            stream.close()
            with open_sqlite(place, stored_size) as source:
                yield source
        else:
            _require_start(path, stream)
            yield stream


@contextmanager
def open_mcap(path: str | Path) -> Iterator[BinaryIO]:
    """Open a file that must not be SQLite. Errors do not contain the file's name yet."""
    with _open_content(make_path(path)) as (stream, _):
        if _read_head(stream) == SQLITE_MAGIC:
            raise NoMcapError("expected an MCAP file, found a bag in SQLite")
        _require_start(make_path(path), stream)
        yield stream


@contextmanager
def open_source(path: str | Path) -> Iterator[Source | SqliteSource]:
    """Open a file of messages, as `open_storage` does, for reading by topic."""
    with open_storage(path) as opened:
        yield opened if isinstance(opened, SqliteSource) else Source(opened)


def strip_suffixes(path: Path) -> str:
    """Return the name of a file without the suffixes that show its kind."""
    suffix = next((known for known in BAG_SUFFIXES if path.name.lower().endswith(known)), None)
    return path.name[: -len(suffix)] if suffix and len(suffix) < len(path.name) else path.stem


class _Unpacked(io.BufferedReader):
    """A file after unpacking, with its packed size [bytes], which sets the limits."""

    def __init__(self, place: Path, stored_size: int) -> None:
        super().__init__(io.FileIO(place))
        self.stored_size = stored_size


@dataclass(frozen=True, slots=True, kw_only=True)
class Damaged:
    """A file to recover.

    Attributes:
        place: Path of the unpacked file.
        bag: Tables of the bag, if the file is in SQLite.
        fault: Error of the file's compression.
        stored_size: Packed size [bytes].
    """

    place: Path
    stored_size: int
    bag: SqliteSource | None
    fault: str | None


@contextmanager
def open_damaged(path: Path) -> Iterator[Damaged]:
    """Open a file for recovery. Errors do not contain the file's name yet."""
    faults: list[str] = []
    with ExitStack() as closing:
        stream, place = closing.enter_context(_open_content(path, faults))
        bag, stored_size = None, measure_stored(stream)
        if _read_head(stream) == SQLITE_MAGIC:
            stream.close()
            bag = closing.enter_context(open_sqlite(place, stored_size, is_damaged=True))
        fault = next(iter(faults), None)
        yield Damaged(place=place, bag=bag, fault=fault, stored_size=stored_size)


@contextmanager
def open_place(found: Damaged) -> Iterator[BinaryIO]:
    """Open a file for recovery again, at the path of the unpacked file."""
    place, is_remote = found.place, isinstance(found.place, RemotePath)
    with open_file(place) if is_remote else _Unpacked(place, found.stored_size) as stream:
        yield stream


@contextmanager
def _open_content(path: Path, faults: list[str] | None = None) -> Iterator[tuple[BinaryIO, Path]]:
    """Open a file, unpacked; yield stream and path. `faults` takes errors of the compression."""
    with ExitStack() as closing:
        stream, place = closing.enter_context(open_file(path)), path
        head = _read_head(stream)
        if isinstance(path, RemotePath) and head == SQLITE_MAGIC:  # SQLite opens only local files
            path.file.require_copy()
            from shutil import copyfileobj

            place = closing.enter_context(_make_folder()) / "fetched"
            with place.open("wb") as copy:
                copyfileobj(stream, copy, 2**20)
            stream = closing.enter_context(place.open("rb"))
        if head.startswith(ZSTD_MAGIC):
            folder = closing.enter_context(_make_folder())
            place, stored_size = folder / "unpacked", measure_stored(stream)
            try:
                _unpack_file(stream, place)
            except DamageError as err:
                if faults is None or not place.stat().st_size:
                    raise
                faults.append(str(err))
            stream = closing.enter_context(_Unpacked(place, stored_size))
        head = _read_head(stream)
        if head.startswith(_ROS1_MAGIC):
            stored_size = measure_stored(stream)
            place = _copy_ros1(path, stream, stored_size, faults)
            stream = closing.enter_context(_Unpacked(place, stored_size))
        if not head and ".db3" in path.suffixes:
            raise LogError("expected a bag in SQLite, found an empty file")
        yield stream, place


@contextmanager
def _make_folder() -> Iterator[Path]:
    from tempfile import TemporaryDirectory  # few files need it

    with TemporaryDirectory(prefix="turtlelog-") as folder:
        yield Path(folder)


_COPIES: Final[dict[object, Path]] = {}
"""MCAP copies of ROS 1 bags, by the identity of the bag, because a command opens a file several
times."""

_MOST_COPIES: Final = 4


def _copy_ros1(path: Path, stream: BinaryIO, stored_size: int, faults: list[str] | None) -> Path:
    """Return the path of an MCAP file with a ROS 1 bag's messages, which exists until the exit."""
    import shutil  # few files need these
    import tempfile
    from multiprocessing.util import Finalize

    from turtlelog.log.ros1 import copy_ros1_bag

    known = None if isinstance(path, RemotePath) else path.stat()
    key = known and (str(path.resolve()), known.st_mtime_ns, known.st_size, known.st_ino)
    if key in _COPIES:
        return _COPIES[key]
    folder = Path(tempfile.mkdtemp(prefix="turtlelog-"))
    # Also at the end of worker processes, which atexit does not notice.
    Finalize(None, shutil.rmtree, (folder, True), exitpriority=0)
    copy = folder / "copied.mcap"
    copy_ros1_bag(stream, copy, stored_size, faults)
    if faults:  # a cut bag is no whole one for later readers
        return copy
    if len(_COPIES) == _MOST_COPIES:
        oldest = next(iter(_COPIES))
        shutil.rmtree(_COPIES.pop(oldest).parent, ignore_errors=True)
    if key is not None:
        _COPIES[key] = copy
    return copy


def _require_start(path: Path, stream: BinaryIO) -> None:
    """Refuse a file that has the suffix of a SQLite bag but another content."""
    head = _read_head(stream)
    if ".db3" in path.suffixes and find_wrong_start(head) is not None:
        raise LogError(f"byte 0: not a bag in SQLite: it begins with {name_start(head)}")


def _read_head(stream: BinaryIO) -> bytes:
    head = stream.read(START_SIZE)
    stream.seek(0)
    return head


def _unpack_file(stream: BinaryIO, place: Path) -> None:
    size = stream.seek(0, 2)
    stream.seek(0)
    allowance = Allowance(size)
    most = left = allowance.count_left(UNPACKED_FILE)
    unpacker = zstandard.ZstdDecompressor().decompressobj()
    with place.open("wb") as output:
        while packed := stream.read(_STEP):
            while packed:
                if unpacker.eof:  # one frame after another, as parallel compressors write
                    allowance.spend(FRAMES)
                    unpacker = zstandard.ZstdDecompressor().decompressobj()
                try:
                    data = unpacker.decompress(packed)
                except zstandard.ZstdError as err:
                    raise DamageError(f"expected sound zstd data, found: {err}") from err
                left -= len(data)
                if left < 0:
                    raise LogError(
                        f"expected up to {most} bytes in a compressed file of {size}, found more"
                    )
                output.write(data)
                packed = unpacker.unused_data if unpacker.eof else b""
    if not unpacker.eof:
        raise DamageError("expected sound zstd data, found the end of the file within it")
