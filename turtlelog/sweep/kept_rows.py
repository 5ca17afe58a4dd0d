"""What an interrupted command has read: a file beside its table, which grows chunk by chunk.

Each part names what it is of, has its length and its checksum: what was cut off while it was
written, and what other commands wrote, is left out.
"""

import hashlib
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO, Final

import msgspec

from turtlelog.errors import LogError
from turtlelog.sweep.row_columns import Cell, CellType, Key, Row

_FRAME: Final = struct.Struct("<8s8sII")
"""Mark, what it is of, length and checksum of what follows, which is compressed."""
_MARK: Final = b"turtles1"


class FileRows(msgspec.Struct, frozen=True, array_like=True):
    """What was read of a file, and the state in which it was.

    Attributes:
        label: As in `FoundRecording`.
        size: Likewise.
        mtime_ns: Likewise.
        sha256: Of its content; None where it is to be read again in any case.
        rows: Cells by key; at least one row.
    """

    label: str
    size: int
    mtime_ns: int
    sha256: str | None
    rows: list[list[tuple[str, CellType, str, Cell]]]

    @classmethod
    def pack(
        cls, label: str, state: tuple[int, int, str | None], rows: Sequence[Row]
    ) -> "FileRows":
        """Return rows with the state of their file: size, time of the last change, hash."""
        packed = [[(*key, cell) for key, cell in row.items()] for row in rows]
        return cls(label, *state, packed)

    def iterate_rows(self) -> Iterator[dict[Key, Cell]]:
        """Yield its rows."""
        for row in self.rows:
            yield {Key(name, kind, unit): cell for name, kind, unit, cell in row}


class KeptRows:
    """The file; several commands may add to it at once."""

    def __init__(self, output: Path, facts: Mapping[str, str]) -> None:
        """Choose the place.

        Args:
            output: Where the table is to be.
            facts: What the rows depend on besides the content of files.
        """
        self.path = output.with_name(f"{output.name}.partial")
        self._of = hashlib.sha256(msgspec.json.encode(dict(sorted(facts.items())))).digest()[:8]

    def read(self) -> Iterator[FileRows]:
        """Yield what was kept for the same facts, without parts that were cut or are damaged."""
        with suppress(FileNotFoundError), self.path.open("rb") as stream:
            while len(head := stream.read(_FRAME.size)) == _FRAME.size:
                mark, of, length, checksum = _FRAME.unpack(head)
                begin = stream.tell()
                packed = stream.read(length) if mark == _MARK else b""
                if mark != _MARK or len(packed) < length or zlib.crc32(packed) != checksum:
                    # What a later call added stands behind it.
                    _seek_mark(stream, begin - _FRAME.size + 1)
                elif of == self._of:
                    yield from msgspec.msgpack.decode(zlib.decompress(packed), type=list[FileRows])

    def add(self, found: Sequence[FileRows]) -> None:
        """Keep what was read of some files.

        Raises:
            LogError: Where there is no room.
        """
        packed = zlib.compress(msgspec.msgpack.encode(found), 1)
        frame = _FRAME.pack(_MARK, self._of, len(packed), zlib.crc32(packed)) + packed
        try:
            with self.path.open("ab", buffering=0) as stream:
                rest = memoryview(frame)
                while rest:
                    rest = rest[stream.write(rest) :]
        except OSError as err:
            raise LogError(
                f"{self.path}: expected room for what is read, found: {err.strerror or err};"
                " the same command goes on from there"
            ) from err

    def drop(self) -> None:
        """Remove the file: the table is complete."""
        with suppress(OSError):
            self.path.unlink()


_SEARCHED_BYTES: Final = 2**20


def _seek_mark(stream: BinaryIO, place: int) -> None:
    """Go to the next mark from a place on; to the end where there is none."""
    stream.seek(place)
    while len(block := stream.read(_SEARCHED_BYTES)) >= len(_MARK):
        found = block.find(_MARK)
        if found >= 0:
            stream.seek(place + found)
            return
        place += len(block) - len(_MARK) + 1  # a mark may lie across two blocks
        stream.seek(place)
