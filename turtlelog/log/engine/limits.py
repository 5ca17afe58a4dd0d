"""Limits on memory and time for a file, in proportion to its size.

A few kilobytes can unpack to gigabytes, or contain millions of empty records. A file of less than
10 MB takes less than 256 MB and 10 s in every command, whatever its content; a larger file may take
more. Most limits are about ten times the needs of recordings.
"""

from collections.abc import Mapping
from threading import Lock
from types import MappingProxyType
from typing import BinaryIO, Final

from mcap.records import Channel, Schema

from turtlelog.errors import LogError

UNPACKED: Final = "bytes in chunks"
UNPACKED_FILE: Final = "bytes of a file that is compressed as a whole"
FRAMES: Final = "frames of a file that is compressed as a whole"
RECORDS: Final = "records"
DESCRIPTIONS: Final = "schemas and channels"
SCHEMA_BYTES: Final = "bytes of schemas"
CHANNEL_BYTES: Final = "bytes of channels"
FIELDS: Final = "fields of types"
NOTES: Final = "metadata records and attachments"
DAMAGES: Final = "damaged places"
CHUNKS: Final = "chunks"
CHUNK_CHANNELS: Final = "channels in chunks"
COLUMNS: Final = "bytes of columns"
CHANGES: Final = "channels that change their meaning"

SMALL_FILE: Final = 10**7
"""Bytes below which a file is read with less than 256 MB of memory, and within 10 s."""

LARGEST_CHUNK: Final = 2**30
"""No chunk may hold more bytes, packed or unpacked; a damaged header may claim anything."""

MOST_DESCRIBED: Final = 2**17
"""Schemas and channels in one chunk: their ids have 16 bits each."""

LONGEST_DESCRIBED: Final = 2**24
"""Bytes of one of them; a text with all the types that it names takes 100 kB."""

# Writers close a chunk by the message that fills it: one of 64 MiB is a message longer. Chunks are
# there to be much smaller than their file: no large file is refused for one eight times as large.
_CHUNK: Final = 80 * 2**20
_CHUNK_SHARE: Final = 8

_BASES: Final[Mapping[str, tuple[int, float]]] = MappingProxyType(
    {
        # A robot that stands still packs to a fortieth, an empty map to a thousandth.
        UNPACKED: (2**30, 64),
        # Written to a disk before it is read.
        UNPACKED_FILE: (2**28, 64),
        # Parallel compressors write one for each 512 kB or more; to begin one takes 20 us.
        FRAMES: (2**14, 1 / 1000),
        # The times of a message take two bytes at least, however well they pack.
        RECORDS: (2**22, 0.5),
        # Some writers repeat all that they have in every chunk.
        DESCRIPTIONS: (2**19, 1 / 16),
        # Of those that differ.
        SCHEMA_BYTES: (2**24, 1),
        # In memory: enough for as many as there are ids, each with a table.
        CHANNEL_BYTES: (80 * 2**20, 1),
        # Of types that differ, about 1 kB each in memory; 200 types of 50 fields are many.
        FIELDS: (50_000, 1 / 1000),
        # And the entries of the summary that name them; recordings have a handful, and each
        # attachment costs 200 us in every pass.
        NOTES: (2**12, 1 / 1000),
        # Each is noted, with the reason.
        DAMAGES: (10_000, 1 / 1000),
        # One a second for an hour; those with poses of a second and all schemas pack to 1 kB;
        # each costs 100 us in every pass, and some answers take five.
        CHUNKS: (2**12, 1 / 1000),
        # Each in every chunk that it has messages in.
        CHUNK_CHANNELS: (2**18, 1 / 32),
        # Files that were joined have one for each channel.
        CHANGES: (2**12, 1 / 1000),
    }
)
"""By kind: what a file may hold, and what more by byte of the file."""

# What a run is made of takes five times as much. The columns of recordings take up to three bytes a
# byte, and those of a robot that stands still 25: one that does for hours fits into few bytes. No
# more fits: with as many poses as are allowed, `explain` and `replay --plant` take 240 MB.
_COLUMNS: Final = 40_000_000
_COLUMNS_SHARE: Final = 16  # of what is beyond

_LARGER_CHUNKS: Final = "mcap filter FILE -o NEW.mcap writes larger ones"

_CHANNEL: Final = 500  # bytes in memory beside its letters
_ENTRY: Final = 200  # the same of an entry of its table


class Allowance:
    """Remaining limits of a pass over a file.

    Attributes:
        largest_chunk: Largest size of an unpacked chunk [bytes].
    """

    def __init__(self, file_size: int) -> None:
        self.largest_chunk = min(LARGEST_CHUNK, max(_CHUNK, _CHUNK_SHARE * file_size))
        self._file_size = file_size
        self._most = {kind: grow_bound(bound, file_size) for kind, bound in _BASES.items()}
        self._most[COLUMNS] = _COLUMNS + _COLUMNS_SHARE * max(0, file_size - SMALL_FILE)
        self._left = dict(self._most)
        self._spending = Lock()

    def count_left(self, kind: str) -> int:
        """Return the remaining number of a kind."""
        return max(self._left[kind], 0)

    def spend(self, kind: str, count: int = 1) -> None:
        """Subtract a number of a kind from the limit.

        Raises:
            LogError: If there are more values than a file of this size may contain. The line says
                what is wrong and, for columns, which option leaves some out.
        """
        with self._spending:  # threads unpack messages at once
            self._left[kind] = left = self._left[kind] - count
        if left < 0:
            raise LogError(self._describe_most(kind))

    def _describe_most(self, kind: str) -> str:
        most, size = self._most[kind], self._file_size
        if kind != COLUMNS:
            reason = f"expected up to {most} {kind} in a file of {size} bytes, found more"
            return f"{reason}; {_LARGER_CHUNKS}" if kind == CHUNKS else reason
        return (
            f"its messages take more than {most:,} bytes as columns, the most for a file of"
            f" {size:,} bytes. Cut the file into parts, or store it without compression"
            " (mcap decompress FILE)"
        )

    def spend_description(self, described: Schema | Channel) -> None:
        """Subtract a new schema or channel from the limits.

        Raises:
            LogError: As for `spend`.
        """
        if isinstance(described, Schema):
            texts = described.data, described.name, described.encoding
            self.spend(SCHEMA_BYTES, sum(map(len, texts)))
        else:
            entries, size = described.metadata, _CHANNEL + len(described.topic)
            size += len(described.message_encoding)
            if entries:
                size += _ENTRY * len(entries) + sum(map(len, entries.values()))
            self.spend(CHANNEL_BYTES, size)


def grow_bound(bound: tuple[int, float], file_size: int) -> int:
    """Return the limit for a file: a fixed number plus a fraction of its bytes."""
    base, share = bound
    return base + int(share * file_size)


def measure_stored(stream: BinaryIO) -> int:
    """Return the size of a stream's file; for an unpacked file its packed size [bytes]."""
    stored: int | None = getattr(stream, "stored_size", None)
    if stored is not None:
        return stored
    place = stream.tell()
    size = stream.seek(0, 2)
    stream.seek(place)
    return size
