"""Files behind URLs, read by range requests: few requests, bounded memory."""

import io
import os
import re
import tempfile
import warnings
import weakref
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, suppress
from typing import IO, Any, BinaryIO, Final, cast
from urllib.parse import urlsplit

from turtlelog.errors import RemoteError
from turtlelog.escapes import show_url
from turtlelog.files.http_file import HEAD, HttpFile, describe_too_long
from turtlelog.files.requests import AnswerError, NoRangesError, open_system, try_thrice
from turtlelog.files.urls import RemoteNote

_TAIL: Final = 2**18
"""Size of the end that is fetched first [bytes]: the summary of several thousand chunks. At 100
Mbit/s this takes 20 ms, about as long as one more request."""

_WINDOW: Final = 2**23
"""Largest size of one request [bytes]: the memory needed, and the loss when a request fails."""

_GAP: Final = 2**16
"""Largest gap between two ranges that are fetched together [bytes]: fetching the gap takes no
longer than another request."""


class RemoteFile:
    """A file behind a URL.

    Attributes:
        size: Size of the file [bytes].
    """

    def __init__(self, url: str, most: int) -> None:
        """Request the first bytes and the size.

        Args:
            url: URL of the file.
            most: Largest number of bytes that may be fetched into a temporary file.

        Raises:
            RemoteError: If the file does not exist or cannot be reached.
            LibraryError: If the library for such URLs is not installed.
        """
        self._system, self._path = open_system(url)
        self._url, self._most = url, most
        self._ends: dict[int, bytes] = {}
        self._copy: IO[bytes] | None = None
        self._failure: RemoteError | None = None
        self._http: HttpFile | None = None
        if "::" not in url and urlsplit(url).scheme.lower() in {"http", "https"}:
            self._http = try_thrice(lambda: HttpFile(self._system, url), url)
            self.size = self._take_head(self._http)
            return
        self._file: Any = try_thrice(
            lambda: self._system.open(self._path, "rb", cache_type="none"), url
        )
        if self._file.seekable() and not type(self._file).__name__.endswith("StreamFile"):
            self.size = int(self._file.seek(0, os.SEEK_END))
        else:
            self.size = self._copy_whole()

    def require_copy(self) -> None:
        """Refuse to fetch the whole file if it is too large.

        Raises:
            RemoteError: If the file is larger than allowed.
        """
        if self.size > self._most:
            raise RemoteError(describe_too_long(self._most))

    def _take_head(self, http: HttpFile) -> int:
        """Keep the first bytes, which show the kind of the file, and return the size.

        Raises:
            RemoteError: If the size is unknown and the file looks like a web page or is too large.
        """
        if http.head:
            self._ends[0] = http.head
        if http.size is not None:
            return http.size
        if re.match(rb"\s*<(!doctype|html|\?xml)", http.head, re.IGNORECASE):
            raise RemoteError("expected a file, found a web page; nothing more of it was fetched")
        return self._copy_whole()

    def open(self) -> BinaryIO:
        """Return a stream of the file, which the caller must close."""
        return cast("BinaryIO", RangeStream(self))

    def fetch(self, start: int, end: int) -> bytes:
        """Return a range of bytes. Failed requests are repeated.

        Raises:
            RemoteError: If the bytes cannot be fetched.
        """
        if self._failure is not None:  # who asks again in another way waits no second time
            raise self._failure
        try:
            return self._fetch(start, end)
        except RemoteError as err:
            self._failure = err
            raise

    def _fetch(self, start: int, end: int) -> bytes:
        if self._copy is None and (self._http is None or self._http.has_ranges):
            with suppress(NoRangesError):
                return try_thrice(lambda: self._fetch_once(start, end), self._url)
        if self._copy is None:
            self._copy_whole()
        copy = cast("IO[bytes]", self._copy)
        copy.seek(start)
        return copy.read(end - start)

    def fetch_whole(self) -> int:
        """Fetch the file into a temporary file, unless that is done already, and return its size.

        Raises:
            RemoteError: If the file cannot be fetched or is larger than allowed.
        """
        if self._copy is None:
            if getattr(self, "size", None) is not None:
                self.require_copy()
            self._copy = try_thrice(self._copy_once, self._url)
            weakref.finalize(self, self._copy.close)
        return self._copy.seek(0, os.SEEK_END)

    def find_held(self, place: int) -> tuple[int, bytes] | None:
        """Return the start and data of the fetched end of the file with a byte; None if missing."""
        for start, data in self._ends.items():
            if start <= place < start + len(data):
                return start, data
        return None

    def fetch_around(self, place: int, end: int) -> tuple[int, bytes]:
        """Return a segment that contains a byte.

        The segments at both ends of the file are cached.
        """
        tail = max(self.size - _TAIL, 0)
        start = tail if place >= tail else place
        end = self.size if start == tail else min(end, max(tail, place + 1))
        data = self.fetch(start, end)
        if start in {tail, 0}:
            self._ends[start] = data[:_TAIL]
        return start, data

    def _fetch_once(self, start: int, end: int) -> bytes:
        if self._http is not None:
            return self._http.fetch(start, end)
        self._file.seek(start)
        data = bytes(self._file.read(end - start))
        if len(data) != end - start:
            raise OSError(f"{len(data)} of {end - start} bytes at byte {start}")
        return data

    def _copy_whole(self) -> int:
        """Fetch the whole file if the server supports no ranges, and return its size."""
        warnings.warn(
            f"{show_url(self._url)}: the server sends no ranges, so all of it is read",
            RemoteNote,
            stacklevel=2,
        )
        return self.fetch_whole()

    def _copy_once(self) -> IO[bytes]:
        with ExitStack() as undoing:
            copy = undoing.enter_context(tempfile.TemporaryFile())
            if self._http is not None:
                self._http.copy(cast("BinaryIO", copy), self._most)
            else:
                self._copy_stream(copy)
            undoing.pop_all()
        return copy

    def _copy_stream(self, copy: IO[bytes]) -> None:
        with self._system.open(self._path, "rb") as source:
            while data := source.read(_WINDOW // 8):
                copy.write(data)
                if copy.tell() > self._most:
                    raise AnswerError(describe_too_long(self._most))


class RangeStream(io.RawIOBase):
    """A stream of a remote file, with read-ahead for sequential reads."""

    def __init__(self, file: RemoteFile) -> None:
        self._file, self._place = file, 0
        self._start, self._data = 0, b""  # what was fetched last
        self._ahead = HEAD
        self._expected: list[tuple[int, int]] = []

    def expect(self, ranges: Iterable[tuple[int, int]]) -> None:
        """Announce the next ranges to read, in order. Neighbouring ranges are fetched together."""
        merged: list[tuple[int, int]] = []
        for start, end in ranges:
            if merged and 0 <= start - merged[-1][1] <= _GAP:
                merged[-1] = merged[-1][0], end
            else:
                merged.append((start, end))
        self._expected = merged

    def readable(self) -> bool:
        """Return True."""
        return True

    def seekable(self) -> bool:
        """Return True."""
        return True

    def tell(self) -> int:
        """Return the position of the next read."""
        return self._place

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Set the position of the next read."""
        base = {os.SEEK_SET: 0, os.SEEK_CUR: self._place, os.SEEK_END: self._file.size}[whence]
        self._place = max(base + offset, 0)
        return self._place

    def read(self, size: int | None = -1) -> bytes:
        """Return up to this many bytes; fewer bytes only at the end of the file."""
        left = max(self._file.size - self._place, 0)
        if size is None or size < 0:
            self._file.require_copy()
        count = left if size is None or size < 0 else min(size, left)
        return b"".join(bytes(piece) for piece in self._iterate(count))

    def readall(self) -> bytes:
        """Return all bytes up to the end of the file."""
        return self.read()

    def readinto(self, buffer: Any) -> int:
        """Fill a buffer. The buffer is filled partly only at the end of the file."""
        view = memoryview(buffer).cast("B")
        done = 0
        for piece in self._iterate(min(len(view), max(self._file.size - self._place, 0))):
            view[done : done + len(piece)] = piece
            done += len(piece)
        return done

    def _iterate(self, count: int) -> Iterator[memoryview]:
        while count > 0:
            start, data = self._find(self._place, count)
            piece = memoryview(data)[self._place - start :][:count]
            self._place += len(piece)
            count -= len(piece)
            yield piece

    def _find(self, place: int, count: int) -> tuple[int, bytes]:
        """Return a segment of bytes that contains a position; fetch it if necessary."""
        if self._start <= place < self._start + len(self._data):
            return self._start, self._data
        held = self._file.find_held(place)
        if held is not None:
            return held
        goes_on = place == self._start + len(self._data)
        self._ahead = min(self._ahead * 2, _WINDOW) if goes_on and place else HEAD
        end = place + min(max(count, self._ahead), _WINDOW)
        for first, last in self._expected:
            if first <= place < last:
                end = min(last, place + _WINDOW)
        self._start, self._data = self._file.fetch_around(place, min(end, self._file.size))
        return self._start, self._data
