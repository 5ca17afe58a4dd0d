"""Files read over http, with a check of each response header before the body is read.

fsspec provides the session with the user's configuration. This module makes its own requests,
because fsspec reads bodies of any length, decompresses them, and reports a redirect loop as a
missing file.
"""

import asyncio
import re
import time
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager
from typing import Any, BinaryIO, Final, TypeVar

from turtlelog.files import requests
from turtlelog.files.requests import AnswerError, NoRangesError, ReplacedError
from turtlelog.files.urls import format_size

T = TypeVar("T")

HEAD: Final = 2**14
"""Size of the first request [bytes]: enough for the kind and the header of a file."""

_SLOWEST_BYTES_PER_S: Final = 1000.0
"""Slowest accepted transfer, a line of 9600 baud: below this rate, 1 MB takes more than a quarter
of an hour."""

PATIENCE_S: float = 30.0
"""Time for which a slower transfer is accepted [s]; a line that is lost for a moment recovers
within this time."""

_PIECE: Final = 2**16
_MARKS: Final = ("ETag", "Last-Modified")
"""Response headers that identify the content of a file, the most reliable one first."""


class HttpFile:
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
        self._run(self._ask_first)

    def fetch(self, start: int, end: int) -> bytes:
        """Return a range of bytes.

        Raises:
            NoRangesError: If the server sends the whole file instead.
            AnswerError: If the server sends other bytes than the requested bytes.
        """
        return self._run(lambda: self._fetch(start, end))

    def copy(self, target: BinaryIO, most: int) -> None:
        """Write the whole file into another file.

        Args:
            target: File to write to.
            most: Largest size if the server announced no length [bytes].
        """
        self._run(lambda: self._copy(target, most))

    def _run(self, work: Callable[[], Coroutine[Any, Any, T]]) -> T:
        from fsspec.asyn import sync

        found: T = sync(self._system.loop, work)
        return found

    @asynccontextmanager
    async def _ask(self, span: tuple[int, int] | None) -> AsyncIterator[Any]:
        """Yield a response whose header has been read.

        Stalled or endless responses raise an error.
        """
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
            _require_good(answer)
            self._require_same(answer)
            yield answer
        finally:
            answer.close()  # what was not read is not fetched

    async def _ask_first(self) -> None:
        async with self._ask((0, HEAD)) as answer:
            length = _read_length(answer)
            if answer.status == 416:
                self.size = _require_empty(answer)
            elif answer.status == 206:
                start, end, self.size = _read_range(answer)
                if (start, end) != (0, min(HEAD, self.size)):
                    raise _deny(f"bytes {start} to {end}", f"bytes 0 to {min(HEAD, self.size)}")
                self.head = await _read_exactly(answer, end, length)
            else:
                self.size, self.has_ranges = length, False
                self.head = await _read_most(answer, HEAD if length is None else min(HEAD, length))

    async def _fetch(self, start: int, end: int) -> bytes:
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

    async def _copy(self, target: BinaryIO, most: int) -> None:
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
                    raise AnswerError(describe_too_long(most))
                target.write(piece)

    def _require_same(self, answer: Any) -> None:
        """Refuse a response if the file has changed since the first response."""
        if answer.status not in {200, 206}:
            return
        found = {name: answer.headers[name] for name in _MARKS if name in answer.headers}
        first = self._marks = self._marks or found
        shared = next((name for name in _MARKS if name in first and name in found), None)
        if shared is not None and _strip_weak(first[shared]) != _strip_weak(found[shared]):
            raise ReplacedError


def describe_too_long(most: int) -> str:
    """Return the message about a file that is too large to download."""
    return (
        f"expected at most {format_size(most)}, found a file that is longer;"
        " --max-download SIZE allows more"
    )


def _strip_weak(mark: str) -> str:
    return mark.removeprefix("W/")


def _require_good(answer: Any) -> None:
    """Refuse a response that does not contain the plain bytes of the file."""
    if answer.status not in {200, 206, 416}:
        answer.raise_for_status()
        raise _deny(f"status {answer.status}", "the file")
    encoding = answer.headers.get("Content-Encoding", "").lower()
    if encoding not in {"", "identity"}:
        raise _deny(f"bytes compressed with {encoding[:20]}", "the bytes of the file")


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
    """Return the start, the end and the file size in Content-Range."""
    text = answer.headers.get("Content-Range", "none")
    found = re.fullmatch(r"bytes (\d{1,18})-(\d{1,18})/(\d{1,18})", text)
    if found is None:
        raise _deny(f"Content-Range {text[:60]}", "a range with the size of the file")
    return int(found[1]), int(found[2]) + 1, int(found[3])


def _require_empty(answer: Any) -> int:
    if answer.headers.get("Content-Range") != "bytes */0":
        raise _deny("no bytes", "the first bytes of the file")
    return 0


async def _read_exactly(answer: Any, count: int, length: int | None) -> bytes:
    """Return a body of the expected length. A longer body is refused before it is read."""
    if length is not None and length != count:
        raise _deny(f"an answer of {length} bytes", f"an answer of {count} bytes")
    data = bytearray()
    async for piece in _read_pieces(answer):
        data += piece
        if len(data) > count:
            raise _deny("a longer answer", f"an answer of {count} bytes")
    if len(data) < count:
        raise OSError(f"{len(data)} of {count} bytes")
    return bytes(data)


async def _read_most(answer: Any, count: int) -> bytes:
    """Return the first bytes of a body."""
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
