"""Files behind URLs, read by range requests: few requests, bounded memory.

Over http, each response header is checked before the body is read. fsspec provides the session with
the user's configuration; the requests are made here, because fsspec reads bodies of any length,
decompresses them, and reports a redirect loop as a missing file.
"""

import asyncio
import io
import os
import re
import tempfile
import time
import warnings
import weakref
from collections.abc import AsyncIterator, Callable, Coroutine, Iterable, Iterator
from contextlib import ExitStack, asynccontextmanager, suppress
from typing import IO, Any, BinaryIO, Final, TypeVar, cast
from urllib.parse import urlsplit

from turtlelog.errors import RemoteError
from turtlelog.escapes import show_url
from turtlelog.files import requests
from turtlelog.files.requests import AnswerError, NoRangesError, ReplacedError, try_thrice
from turtlelog.files.urls import RemoteNote, format_size

T = TypeVar("T")

_HEAD: Final = 2**14
"""Size of the first request [bytes]: enough for the kind and the header of a file."""

_SLOWEST_BYTES_PER_S: Final = 1000.0
"""Slowest accepted transfer, a line of 9600 baud; 1 MB takes a quarter of an hour."""

PATIENCE_S: float = 30.0
"""Time for which a slower transfer is accepted [s]; a lost line recovers within it."""

_PIECE: Final = 2**16
_MARKS: Final = ("ETag", "Last-Modified")
"""Response headers that identify the content of a file, the most reliable one first."""

_TAIL: Final = 2**18
"""Size of the end that is fetched first [bytes]: the summary of several thousand chunks. At 100
Mbit/s this takes 20 ms, about as long as one more request."""

_WINDOW: Final = 2**23
"""Largest size of one request [bytes]: the memory needed, and the loss when a request fails."""

_GAP: Final = 2**16
"""Largest gap between two ranges that are fetched together [bytes]; a request takes longer."""


class RemoteFile:
    """A file behind a URL.

    Attributes:
        size: Size of the file [bytes].
    """

    def __init__(self, url: str, most: int) -> None:
        """Request the first bytes and the size; `most` bytes may be fetched into a temporary file.

        Raises:
            RemoteError: If the file does not exist or cannot be reached.
            LibraryError: If the library for such URLs is not installed.
        """
        self._system, self._path = requests.open_system(url)
        self._url, self._most = url, most
        self._ends: dict[int, bytes] = {}
        self._copy: IO[bytes] | None = None
        self._failure: RemoteError | None = None
        self._http: _HttpFile | None = None
        if "::" not in url and urlsplit(url).scheme.lower() in {"http", "https"}:
            self._http = http = try_thrice(lambda: _HttpFile(self._system, url), url)
            if http.head:  # it shows the kind of the file
                self._ends[0] = http.head
            if http.size is None and re.match(rb"\s*<(!doctype|html|\?xml)", http.head, re.I):
                raise RemoteError(
                    "expected a file, found a web page; nothing more of it was fetched"
                )
            self.size = self._copy_whole() if http.size is None else http.size
            return
        self._file: Any = try_thrice(
            lambda: self._system.open(self._path, "rb", cache_type="none"), url
        )
        if self._file.seekable() and not type(self._file).__name__.endswith("StreamFile"):
            self.size = int(self._file.seek(0, os.SEEK_END))
        else:
            self.size = self._copy_whole()

    def require_copy(self) -> None:
        """Refuse to fetch the whole file if it is too large."""
        if self.size > self._most:
            raise RemoteError(_describe_too_long(self._most))

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
        """Return a segment that contains a byte. Those at both ends of the file are cached."""
        tail = max(self.size - _TAIL, 0)
        start = tail if place >= tail else place
        end = self.size if start == tail else min(end, max(tail, place + 1))
        data = self.fetch(start, end)
        if start in {tail, 0}:
            self._ends[start] = data[:_TAIL]
        return start, data

    def _fetch_once(self, start: int, end: int) -> bytes:
        if (http := self._http) is not None:
            return http.run(lambda: http.fetch(start, end))
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
            if (http := self._http) is not None:
                http.run(lambda: http.copy(cast("BinaryIO", copy), self._most))
            else:
                with self._system.open(self._path, "rb") as source:
                    while data := source.read(_WINDOW // 8):
                        copy.write(data)
                        if copy.tell() > self._most:
                            raise AnswerError(_describe_too_long(self._most))
            undoing.pop_all()
        return copy


class RangeStream(io.RawIOBase):
    """A stream of a remote file, with read-ahead for sequential reads."""

    def __init__(self, file: RemoteFile) -> None:
        self._file, self._place = file, 0
        self._start, self._data = 0, b""  # what was fetched last
        self._ahead = _HEAD
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
        self._ahead = min(self._ahead * 2, _WINDOW) if goes_on and place else _HEAD
        end = place + min(max(count, self._ahead), _WINDOW)
        for first, last in self._expected:
            if first <= place < last:
                end = min(last, place + _WINDOW)
        self._start, self._data = self._file.fetch_around(place, min(end, self._file.size))
        return self._start, self._data


class _HttpFile:
    """A file read over http or https.

    Attributes:
        size: Size that the server announces [bytes]; None if it announces no size.
        head: First bytes of the file, from the first response.
        has_ranges: Whether the server supports range requests.
    """

    def __init__(self, system: Any, url: str) -> None:
        """Request the first bytes."""
        self._system, self._url = system, url
        self._marks: dict[str, str] | None = None
        self.size: int | None = None
        self.head, self.has_ranges = b"", True
        self.run(self._ask_first)

    def run(self, work: Callable[[], Coroutine[Any, Any, T]]) -> T:
        """Return the result of one of the requests below."""
        from fsspec.asyn import sync

        found: T = sync(self._system.loop, work)
        return found

    @asynccontextmanager
    async def _ask(self, span: tuple[int, int] | None) -> AsyncIterator[Any]:
        """Yield a response with a checked header; stalled or endless responses raise an error."""
        session = await self._system.set_session()
        options = {name: value for name, value in self._system.kwargs.items() if name != "headers"}
        headers = {**self._system.kwargs.get("headers", {})}
        if span is not None:
            headers["Range"] = f"bytes={span[0]}-{span[1] - 1}"
        # aiohttp counts the answer that it no longer follows.
        options = {"max_redirects": requests.MOST_REDIRECTS + 1, **options, "headers": headers}
        address = self._system.encode_url(self._url)
        answer = await asyncio.wait_for(session.get(address, **options), requests.STALL_S)
        try:
            if answer.status not in {200, 206, 416}:
                answer.raise_for_status()
                raise _deny(f"status {answer.status}", "the file")
            encoding = answer.headers.get("Content-Encoding", "").lower()
            if encoding not in {"", "identity"}:
                raise _deny(f"bytes compressed with {encoding[:20]}", "the bytes of the file")
            self._require_same(answer)
            yield answer
        finally:
            answer.close()  # what was not read is not fetched

    async def _ask_first(self) -> None:
        async with self._ask((0, _HEAD)) as answer:
            length = _read_length(answer)
            if answer.status == 416:
                if answer.headers.get("Content-Range") != "bytes */0":
                    raise _deny("no bytes", "the first bytes of the file")
                self.size = 0
            elif answer.status == 206:
                start, end, self.size = _read_range(answer)
                if (start, end) != (0, min(_HEAD, self.size)):
                    raise _deny(f"bytes {start} to {end}", f"bytes 0 to {min(_HEAD, self.size)}")
                self.head = await _read_exactly(answer, end, length)
            else:
                self.size, self.has_ranges = length, False
                self.head = await _read_most(
                    answer, _HEAD if length is None else min(_HEAD, length)
                )

    async def fetch(self, start: int, end: int) -> bytes:
        """Return a range of bytes.

        Raises:
            NoRangesError: If the server sends the whole file instead.
            AnswerError: If the server sends other bytes than the requested bytes.
        """
        async with self._ask((start, end)) as answer:
            if answer.status == 200:
                raise NoRangesError
            if answer.status == 416:
                raise _deny("no bytes", f"bytes {start} to {end} of {self.size}")
            found, asked = _read_range(answer), (start, end, self.size)
            if found[2] != self.size:
                raise ReplacedError
            if found != asked:
                raise _deny(f"bytes {found[0]} to {found[1]}", f"bytes {start} to {end}")
            return await _read_exactly(answer, end - start, _read_length(answer))

    async def copy(self, target: BinaryIO, most: int) -> None:
        """Write the whole file into another, at most so many bytes if no length was announced."""
        async with self._ask(None) as answer:
            if answer.status != 200:
                raise _deny(f"status {answer.status}", "the whole file")
            length = _read_length(answer)
            if self.size is not None and length != self.size:
                raise ReplacedError
            count = 0
            async for piece in _read_pieces(answer):
                count += len(piece)
                if count > (most if length is None else length):
                    raise AnswerError(_describe_too_long(most))
                target.write(piece)

    def _require_same(self, answer: Any) -> None:
        """Refuse a response if the file has changed since the first response."""
        if answer.status not in {200, 206}:
            return
        found = {name: answer.headers[name] for name in _MARKS if name in answer.headers}
        first = self._marks = self._marks or found
        shared = next((name for name in _MARKS if name in first and name in found), None)
        if shared and len({of[shared].removeprefix("W/") for of in (first, found)}) > 1:
            raise ReplacedError


def _describe_too_long(most: int) -> str:
    return (
        f"expected at most {format_size(most)}, found a file that is longer;"
        " --max-download SIZE allows more"
    )


def _deny(found: str, expected: str) -> AnswerError:
    return AnswerError(
        f"expected {expected} from the server, found {found}; download the file, then name the copy"
    )


def _read_length(answer: Any) -> int | None:
    """Return the announced length of a body; None for chunked transfer."""
    lengths = set(answer.headers.getall("Content-Length", []))
    if len(lengths) > 1 or not all(re.fullmatch(r"\d{1,18}", length) for length in lengths):
        raise _deny(f"Content-Length {', '.join(sorted(lengths))[:60]}", "one length")
    return int(lengths.pop()) if lengths else None


def _read_range(answer: Any) -> tuple[int, int, int]:
    text = answer.headers.get("Content-Range", "none")
    found = re.fullmatch(r"bytes (\d{1,18})-(\d{1,18})/(\d{1,18})", text)
    if found is None:
        raise _deny(f"Content-Range {text[:60]}", "a range with the size of the file")
    return int(found[1]), int(found[2]) + 1, int(found[3])


async def _read_exactly(answer: Any, count: int, length: int | None) -> bytes:
    """Return a body of the expected length. A longer body is refused before it is read."""
    if length is not None and length != count:
        raise _deny(f"an answer of {length} bytes", f"an answer of {count} bytes")
    data = await _read_most(answer, count + 1)
    if len(data) > count:
        raise _deny("a longer answer", f"an answer of {count} bytes")
    if len(data) < count:
        raise OSError(f"{len(data)} of {count} bytes")
    return data


async def _read_most(answer: Any, count: int) -> bytes:
    data = bytearray()
    async for piece in _read_pieces(answer):
        data += piece
        if len(data) >= count:
            break
    return bytes(data[:count])


async def _read_pieces(answer: Any) -> AsyncIterator[bytes]:
    """Yield a body in pieces. A transfer that is too slow raises an error."""
    begun_s, count = time.monotonic(), 0
    while piece := await answer.content.read(_PIECE):
        count += len(piece)
        yield piece
        passed_s = time.monotonic() - begun_s
        if passed_s < PATIENCE_S:
            continue
        if count < _SLOWEST_BYTES_PER_S * passed_s:
            raise AnswerError(
                f"expected at least {_SLOWEST_BYTES_PER_S / 1000:g} kB/s, found"
                f" {count / passed_s:.0f} B/s for {PATIENCE_S:g} s; try again later"
            )
        begun_s, count = time.monotonic(), 0
