"""What an interrupted sweep has done: a partial file beside its results, that one sweep writes.

It begins with what the sweep is of, and grows by the results of a chunk at a time. Each part has
its length and checksum: what was cut off while it was written is left out.
"""

import os
import struct
import sys
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import BinaryIO, Final

import msgspec

from turtlelog.errors import SweepError
from turtlelog.sweep.result_table import read_result_facts
from turtlelog.sweep.simulate_rows import RowResults

_MAGIC: Final = b"turtlelog sweep 1\n"
_FRAME: Final = struct.Struct("<II")
"""Length and checksum of what follows, which is compressed."""

_MOST_BYTES: Final = 2**30
"""Of one part: a length beyond is damage."""


def name_partial(output: Path) -> Path:
    """Return the file that holds what a sweep has done so far."""
    return output.with_name(f"{output.name}.partial")


def require_same_sweep(output: Path, facts: Mapping[str, str]) -> bool:
    """Return whether the results of this sweep are there already.

    Raises:
        SweepError: Where the file holds something else.
        LogError: Where it cannot be read.
    """
    if not output.exists():
        return False
    found = read_result_facts(output)
    if found is None or found["kind"] != "sweep":
        raise SweepError(f"{output}: expected a new name, found a file that no sweep wrote")
    _require_same(output, "the results", found, facts)
    return True


def _require_same(
    path: Path, what: str, found: Mapping[str, str], facts: Mapping[str, str]
) -> None:
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


class PartialResults:
    """The partial file of a sweep, locked while it is open."""

    def __init__(self, output: Path, facts: Mapping[str, str]) -> None:
        """Open the file, or begin it.

        Args:
            output: Where the results are to be.
            facts: What the sweep is of.

        Raises:
            SweepError: Where it is that of another sweep, another process writes to it, or it
                cannot be written.
        """
        self.path, self._output = name_partial(output), output
        self.done: list[RowResults] = []
        self.was_begun = False
        try:
            self._stream = self._open()
            try:
                self._begin(facts)
            except BaseException:
                self._stream.close()
                raise
        except OSError as err:
            raise self._describe(err) from err

    def _open(self) -> BinaryIO:
        """Return the file, locked; not one that another sweep finished and removed meanwhile."""
        while True:
            descriptor = os.open(self.path, os.O_RDWR | os.O_CREAT | _BINARY, 0o666)
            stream = os.fdopen(descriptor, "r+b", buffering=0)
            if not _lock(stream):
                stream.close()
                raise SweepError(
                    f"{self._output}: expected a file of its own, found another sweep at work on it"
                )
            if self.path.exists() and os.path.samestat(os.fstat(descriptor), self.path.stat()):
                return stream
            stream.close()

    def _begin(self, facts: Mapping[str, str]) -> None:
        size = os.fstat(self._stream.fileno()).st_size
        head = self._stream.read(len(_MAGIC))
        parts = self._iterate_parts() if head == _MAGIC else iter(())
        found = next(parts, None)
        if found is None:
            # A head that was cut holds nothing of anybody; anything else is not ours to replace.
            if size and not (_MAGIC.startswith(head) or head == _MAGIC):
                raise SweepError(f"{self.path}: expected what a sweep left, found another file")
            self._stream.seek(0)
            self._stream.truncate()
            self._write(_MAGIC + _frame(msgspec.msgpack.encode(dict(facts))))
            return
        self.was_begun = True
        _require_same(
            self.path, "what is done", msgspec.msgpack.decode(found, type=dict[str, str]), facts
        )
        end = self._stream.tell()
        for part in parts:
            self.done.append(msgspec.msgpack.decode(part, type=RowResults))
            end = self._stream.tell()
        self._stream.seek(end)
        self._stream.truncate()

    def _iterate_parts(self) -> Iterator[bytes]:
        """Yield whole parts up to one that was cut or damaged."""
        while True:
            frame = self._stream.read(_FRAME.size)
            if len(frame) < _FRAME.size:
                return
            length, checksum = _FRAME.unpack(frame)
            packed = self._stream.read(length) if length < _MOST_BYTES else b""
            if len(packed) < length or zlib.crc32(packed) != checksum:
                return
            yield zlib.decompress(packed)

    def add(self, results: RowResults) -> None:
        """Keep the results of a chunk.

        Raises:
            SweepError: Where the disk is full, or gone.
        """
        try:
            self._write(_frame(msgspec.msgpack.encode(results)))
        except OSError as err:
            raise self._describe(err) from err
        self.done.append(results)

    def _write(self, data: bytes) -> None:
        rest = memoryview(data)
        while rest:
            rest = rest[self._stream.write(rest) :]

    def _describe(self, err: OSError) -> SweepError:
        return SweepError(
            f"{self.path}: expected room for what is done, found: {err.strerror or err}; the same"
            " command goes on from there"
        )

    def close(self, *, is_complete: bool = False) -> None:
        """Release the file; one that is complete is removed."""
        # Under the lock where the system allows it: once it is released the name may be another's.
        if is_complete and sys.platform != "win32":
            self.path.unlink(missing_ok=True)
        self._stream.close()
        if is_complete and sys.platform == "win32":
            self.path.unlink(missing_ok=True)


def _frame(data: bytes) -> bytes:
    packed = zlib.compress(data, 1)
    return _FRAME.pack(len(packed), zlib.crc32(packed)) + packed


_BINARY: Final = getattr(os, "O_BINARY", 0)

if sys.platform == "win32":
    import msvcrt

    _FAR: Final = 2**40
    """A place that no file reaches: a lock there hinders nobody who reads."""

    def _lock(stream: BinaryIO) -> bool:
        """Return whether nobody else has locked the file."""
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
        """Return whether nobody else has locked the file; True where it cannot be locked."""
        try:
            fcntl.flock(stream.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        except OSError:  # a file system without locks
            return True
        return True
