"""A table while it is made: its parts, kept in a partial file, and its rows, packed in columns."""

import hashlib
import os
import struct
import sys
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Final, Generic, Literal, NamedTuple, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import SweepError
from turtlelog.files.urls import RemotePath
from turtlelog.libraries import load_library
from turtlelog.sweep import result_table
from turtlelog.sweep.result_table import ResultColumn

Cell = str | int | float | None
CellType = Literal["text", "real", "whole"]


class Key(NamedTuple):
    """Name, type and unit of a column; a name with several units has several columns."""

    name: str
    type: CellType = "text"
    unit: str = ""


FILE: Final = Key("file")  # first column of tables of recordings
ERROR: Final = Key("error")  # last column about the file

Row = Mapping[Key, Cell]
_NONES: Final[Mapping[str, Any]] = {"text": -1, "real": np.nan, "whole": -(2**63)}
_NUMBERS: Final = {"text": np.int32, "real": np.float64, "whole": np.int64}


class StoredCells(Sequence[Any]):
    """The cells of one column: 8 bytes per number, 4 per text. Repeated texts are mostly shared."""

    def __init__(self, kind: CellType, numbers: NDArray[Any], texts: Sequence[str] = ()) -> None:
        """Store numbers, or for texts the indices into the list of texts."""
        self._kind, self._numbers, self._texts = kind, numbers, list(texts)

    @classmethod
    def pack(cls, kind: CellType, cells: Iterable[Any]) -> "StoredCells":
        """Return cells from Python values."""
        none = _NONES[kind]
        if kind != "text":
            numbers = [none if cell is None else cell for cell in cells]
            return cls(kind, np.array(numbers, _NUMBERS[kind]))
        codes: dict[str, int] = {}
        found = [none if cell is None else codes.setdefault(cell, len(codes)) for cell in cells]
        return cls(kind, np.array(found, _NUMBERS[kind]), list(codes))

    @classmethod
    def pack_arrow(cls, kind: CellType, cells: Any) -> "StoredCells":
        """Return cells from an Arrow array."""
        texts: Sequence[str] = ()
        if kind == "text":
            encoded = cells.combine_chunks().dictionary_encode()
            cells, texts = encoded.indices, encoded.dictionary.to_pylist()
        if kind != "real":
            cells = load_library("pyarrow.compute").fill_null(cells, _NONES[kind])
        return cls(kind, cells.to_numpy(zero_copy_only=False).astype(_NUMBERS[kind]), texts)

    @classmethod
    def fill(cls, kind: CellType, count: int) -> "StoredCells":
        """Return a number of cells without a value."""
        return cls(kind, np.full(count, _NONES[kind], _NUMBERS[kind]))

    def take(self, rows: NDArray[np.intp]) -> "StoredCells":
        """Return the cells of some rows."""
        return StoredCells(self._kind, self._numbers[rows], self._texts)

    def put(self, places: NDArray[np.intp], other: "StoredCells", rows: NDArray[np.intp]) -> None:
        """Copy cells of another column of the same kind to given rows of this column."""
        numbers = other._numbers[rows]
        if other._texts:
            numbers = np.where(numbers < 0, -1, numbers + len(self._texts))
            self._texts += other._texts
        self._numbers[places] = numbers

    def __len__(self) -> int:
        return len(self._numbers)

    def __getitem__(self, place: Any) -> Any:
        if isinstance(place, slice):
            return StoredCells(self._kind, self._numbers[place], self._texts)
        number = self._numbers[place].item()
        if number == _NONES[self._kind] or number != number:  # noqa: PLR0124 - of a NaN it is
            return None
        return self._texts[number] if self._kind == "text" else number

    @property
    def has_value(self) -> NDArray[np.bool_]:
        """Return for each row whether its cell has a value."""
        has: NDArray[np.bool_] = self._numbers != _NONES[self._kind]
        return has & ~np.isnan(self._numbers) if self._kind == "real" else has

    def build_arrow(self) -> Any:
        """Return the cells as an Arrow array."""
        has_value = self.has_value
        if self._kind != "text":
            pa = load_library("pyarrow")
            kind = pa.int64() if self._kind == "whole" else pa.float64()
            return result_table.build_numbers(self._numbers, has_value, kind)
        texts = ["" if number < 0 else self._texts[number] for number in self._numbers.tolist()]
        return result_table.build_texts(texts, has_value)


@dataclass(frozen=True, slots=True)
class PartialColumns:
    """Rows stored as columns; cells of missing keys are None."""

    count: int
    cells: Mapping[Key, StoredCells]


class StoredRows:
    """Rows in parts that are loaded on demand."""

    def __init__(self) -> None:
        self.ends = [0]
        self.loads: list[Callable[[], PartialColumns]] = []

    def add(self, count: int, load: Callable[[], PartialColumns]) -> int:
        """Add a part, and return the number of its first row."""
        self.loads.append(load)
        self.ends.append(self.ends[-1] + count)
        return self.ends[-2]


class WindowedRows:
    """Stored rows in a given order, with one segment in memory."""

    def __init__(self, stored: StoredRows, order: NDArray[np.intp] | range) -> None:
        """Store the rows and the row numbers in order."""
        self._stored, self._order = stored, order
        self._stretch, self._held = (0, 0), PartialColumns(0, {})

    def __len__(self) -> int:
        return len(self._order)

    def load(self, segment: slice) -> PartialColumns:
        """Return a segment of the rows; each part is loaded once."""
        begin, end, _ = segment.indices(len(self))
        if (begin, end) == self._stretch:
            return self._held
        rows, ends = np.asarray(self._order[begin:end], np.intp), np.array(self._stored.ends)
        parts = np.searchsorted(ends, rows, "right") - 1
        found: dict[Key, StoredCells] = {}
        for part in np.unique(parts).tolist():
            places = np.flatnonzero(parts == part)
            for key, cells in self._stored.loads[part]().cells.items():
                if key not in found:
                    found[key] = StoredCells.fill(key.type, len(rows))
                found[key].put(places, cells, rows[places] - ends[part])
        self._stretch, self._held = (begin, end), PartialColumns(len(rows), found)
        return self._held


def build_result_columns(rows: WindowedRows, keys: Sequence[Key]) -> Iterator[ResultColumn]:
    """Yield the columns of keys. If a name has several units, the unit is appended to the name."""
    names = [key.name for key in keys]
    for key in keys:

        def load(begin: int, end: int, key: Key = key) -> StoredCells:
            found = rows.load(slice(begin, end))
            return found.cells.get(key) or StoredCells.fill(key.type, found.count)

        name = key.name if names.count(key.name) == 1 else f"{key.name} [{key.unit}]"
        cells = result_table.ComputedItems(len(rows), load)
        yield ResultColumn(name=name, type=key.type, cells=cells, unit=key.unit or None)


Require = Callable[[Path, Mapping[str, str]], None]
T = TypeVar("T")
U = TypeVar("U")

_MAGIC: Final = b"turtlelog sweep 1\n"
_FRAME: Final = struct.Struct("<II")  # length and checksum of the following compressed data
_MOST_BYTES: Final = 2**30  # largest length of a part [bytes]. A larger length is a sign of damage

_SMALL_PART: Final = 2**23
_MOST_PACKED: Final = 2
"""Largest ratio of unpacked to packed size of a large part. A list takes eight bytes for each byte:
a file of 10 MB takes 160 MB. Data with a larger ratio were not packed by turtlelog."""


def name_partial(output: Path) -> Path:
    """Return the path of the partial file: next to a table, or in the working folder.

    Objects behind URLs cannot grow: their partial files are in the working folder, with names that
    distinguish tables of the same name.
    """
    if not isinstance(output, RemotePath):
        return output.with_name(f"{output.name}.partial")
    told = hashlib.sha256(output.url.encode()).hexdigest()[:8]
    return Path(f"{output.name}.{told}.partial")


def has_results(output: Path, facts: Mapping[str, str]) -> bool:
    """Return whether the results of this sweep already exist; SweepError for another content."""
    if not result_table.has_result_file(output):
        return False
    found = result_table.read_result_facts(output)
    if found is None or found["kind"] != "sweep":
        raise SweepError(f"{output}: expected a new name, found a file that no sweep wrote")
    require_same(facts, output, found, what="the results")
    return True


def require_same(
    facts: Mapping[str, str], path: Path, found: Mapping[str, str], *, what: str = "what is done"
) -> None:
    """Raise SweepError for a file of another sweep; `what` is its content, for the message."""
    others = [name for name, text in facts.items() if found.get(name) != text]
    if others:
        named = " and ".join(_NAMES.get(name, name) for name in others)
        raise SweepError(
            f"{path}: expected a new name, found {what} of a sweep with another {named}"
        )


_NAMES: Final = {
    "base": "base scenario",
    "plan": "plan",
    "metrics": "choice of metrics",
    "records": "choice of recordings",
    "law_code": "code of the law",
    "version": "version of turtlelog",
}


class KeptParts(Generic[T]):
    """The partial file of a table, locked while it is open."""

    def __init__(
        self,
        output: Path,
        facts: Mapping[str, str],
        kind: type[T],
        *,
        require: Require | None = None,
    ) -> None:
        """Open the file for parts of a type, or create the file.

        If the file has other facts, `require` is called with its path and its facts, and raises an
        error; without `require`, the file is replaced.
        """
        self.path, self._output = name_partial(output), output
        self.places: list[int] = []  # start of each part in the file [bytes]
        self.was_begun = False  # whether the file already existed, for the same table
        self._decoder = msgspec.msgpack.Decoder(kind)
        try:
            self._stream = self._open()
            try:
                self._begin(dict(facts), require)
            except BaseException:
                self._stream.close()
                raise
        except OSError as err:
            raise self._describe(err) from err

    def _open(self) -> BinaryIO:
        """Return the locked file. If another command removed the file during this, open again."""
        while True:
            descriptor = os.open(self.path, os.O_RDWR | os.O_CREAT | _BINARY, 0o666)
            stream = os.fdopen(descriptor, "r+b", buffering=0)
            if not _lock(stream):
                stream.close()
                raise SweepError(
                    f"{self._output}: another command is writing it; choose another name or wait"
                )
            if self.path.exists() and os.path.samestat(os.fstat(descriptor), self.path.stat()):
                return stream
            stream.close()

    def _begin(self, facts: dict[str, str], require: Require | None) -> None:
        head = self._stream.read(len(_MAGIC))
        # A truncated head belongs to nobody; a file with other content must not be replaced.
        if not _MAGIC.startswith(head):
            raise SweepError(
                f"{self.path}: is in the way, and not left by an interrupted command;"
                " delete or rename it"
            )
        parts = self._iterate_parts() if head == _MAGIC else iter(())
        packed = next(parts, (0, b""))[1]
        if packed:
            found = self._decode(packed, msgspec.msgpack.Decoder(dict[str, str]))
            if found != facts and require is not None:
                require(self.path, found)
            self.was_begun = found == facts
        if self.was_begun:
            end = self._stream.tell()
            for place, packed in parts:
                self.places.append(place)
                end = place + _FRAME.size + len(packed)
            self._stream.truncate(end)
        else:
            self._stream.truncate(0)
            self._append(_MAGIC + _frame(msgspec.msgpack.encode(facts)))

    def _iterate_parts(self) -> Iterator[tuple[int, bytes]]:
        """Yield complete packed parts, up to the first truncated or damaged one."""
        while True:
            place = self._stream.tell()
            frame = self._stream.read(_FRAME.size)
            if len(frame) < _FRAME.size:
                return
            length, checksum = _FRAME.unpack(frame)
            packed = self._stream.read(length) if length < _MOST_BYTES else b""
            if len(packed) < length or zlib.crc32(packed) != checksum:
                return
            yield place, packed

    def read(self, place: int) -> T:
        """Return the part that begins at a place; SweepError if it cannot be read or is damaged."""
        try:
            self._stream.seek(place)
            packed = next(self._iterate_parts())[1]
        except OSError as err:
            raise self._describe(err) from err
        except StopIteration as err:
            raise SweepError(f"{self.path}: expected what was kept, found it damaged") from err
        return self._decode(packed, self._decoder)

    def _decode(self, packed: bytes, decoder: msgspec.msgpack.Decoder[U]) -> U:
        most = _count_most(packed)
        unpacking = zlib.decompressobj()
        try:
            data = unpacking.decompress(packed, most + 1)
            if len(data) <= most and unpacking.eof:
                return decoder.decode(data)
        except (zlib.error, msgspec.DecodeError, RecursionError):
            pass
        raise SweepError(
            f"{self.path}: a part of it is none that this command wrote, or is damaged. Delete the"
            " file, then type the same command again"
        )

    def add(self, part: T) -> int:
        """Append a part and return its start in the file; SweepError if there is no room."""
        try:
            self.places.append(self._append(_frame(msgspec.msgpack.encode(part))))
        except OSError as err:
            raise self._describe(err) from err
        return self.places[-1]

    def _append(self, data: bytes) -> int:
        place, rest = self._stream.seek(0, os.SEEK_END), memoryview(data)
        while rest:
            rest = rest[self._stream.write(rest) :]
        return place

    def _describe(self, err: OSError) -> SweepError:
        return SweepError(
            f"{self.path}: expected room for what is done, found: {err.strerror or err}; the same"
            " command goes on from there"
        )

    def close(self, *, is_complete: bool = False) -> None:
        """Close the file, and remove it if the table is complete."""
        # Under the lock if the system allows it: after its release the name may belong to another
        # file.
        if is_complete and sys.platform != "win32":
            self.path.unlink(missing_ok=True)
        self._stream.close()
        if is_complete and sys.platform == "win32":
            self.path.unlink(missing_ok=True)


def _frame(data: bytes) -> bytes:
    packed = zlib.compress(data, 1)
    if len(data) > _count_most(packed):
        packed = zlib.compress(data, 0)
    return _FRAME.pack(len(packed), zlib.crc32(packed)) + packed


def _count_most(packed: bytes) -> int:
    """Return the largest size of an unpacked part [bytes]."""
    return max(_SMALL_PART, _MOST_PACKED * len(packed))


_BINARY: Final = getattr(os, "O_BINARY", 0)

if sys.platform == "win32":
    import msvcrt

    _FAR: Final = 2**40
    """Offset of the lock, beyond any file, so that it does not hinder readers."""

    def _lock(stream: BinaryIO) -> bool:
        """Lock the file, or return False if another process has locked it."""
        stream.seek(_FAR)
        try:
            msvcrt.locking(stream.fileno(), msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        finally:
            stream.seek(0)
        return True

else:
    import fcntl

    def _lock(stream: BinaryIO) -> bool:
        """Lock the file; return False if another process has locked it. Without locks: True."""
        try:
            fcntl.flock(stream.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        except OSError:  # a file system without locks
            return True
        return True
