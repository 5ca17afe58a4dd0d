"""Servers that answer as no server should, on 127.0.0.1, each bounded in bytes and time."""

import re
import socket
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import repeat
from typing import Self

_MOST_BYTES = 2**26
_LONGEST_S = 20.0

DATA = b"\x89MCAP0\r\n" + bytes(10**6)
"""What they should serve."""

Answer = Callable[["Request"], Iterator[bytes]]


@dataclass(frozen=True, kw_only=True)
class Request:
    """What was asked for.

    Attributes:
        number: How many requests came before.
        head: Lines as they came.
        start: First byte asked for; None where there is no range.
        end: Behind the last one.
    """

    number: int
    head: str
    start: int | None
    end: int | None


@dataclass(kw_only=True)
class LyingServer:
    """Answers with whatever a function yields, as long as the block lasts.

    Attributes:
        answer: Yields the bytes of an answer.
        requests: What was asked for.
        sent: Bytes that somebody took.
    """

    answer: Answer
    requests: list[Request] = field(default_factory=list)
    sent: int = 0

    def __enter__(self) -> Self:
        self._socket = socket.create_server(("127.0.0.1", 0))
        self._port = self._socket.getsockname()[1]
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        # Wakes who waits for the next connection.
        socket.create_connection(self._socket.getsockname()).close()
        self._thread.join()
        self._socket.close()

    def url(self, name: str = "x.mcap") -> str:
        return f"http://127.0.0.1:{self._port}/{name}"

    def _serve(self) -> None:
        while not self._ended.is_set():
            line, _ = self._socket.accept()
            threading.Thread(target=self._talk, args=(line,), daemon=True).start()

    def _talk(self, line: socket.socket) -> None:
        deadline, head = time.monotonic() + _LONGEST_S, b""
        with line:
            line.settimeout(_LONGEST_S)
            # What waits in here counts as sent.
            line.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 2**16)
            while b"\r\n\r\n" not in head:
                received = line.recv(2**16)
                if not received:
                    return
                head += received
            asked = re.search(rb"Range: bytes=(\d+)-(\d+)", head)
            start, end = (int(asked[1]), int(asked[2]) + 1) if asked else (None, None)
            request = Request(number=len(self.requests), head=head.decode(), start=start, end=end)
            self.requests.append(request)
            for piece in self.answer(request):
                if self.sent > _MOST_BYTES or time.monotonic() > deadline or self._ended.is_set():
                    return
                try:
                    line.sendall(piece)
                except OSError:
                    return
                self.sent += len(piece)


def say(status: int, *fields: str) -> bytes:
    """Return the head of an answer."""
    lines = [f"HTTP/1.1 {status} So", "Connection: close", *fields]
    return "\r\n".join([*lines, "", ""]).encode()


def send_range(asked: Request, *fields: str) -> Iterator[bytes]:
    """Yield what an honest server sends."""
    start, end = asked.start or 0, min(asked.end or len(DATA), len(DATA))
    place = f"Content-Range: bytes {start}-{end - 1}/{len(DATA)}"
    yield say(206, place, f"Content-Length: {end - start}", *fields)
    yield DATA[start:end]


def first_range(*fields: str) -> bytes:
    """Return the head of an answer to the first request."""
    return say(206, f"Content-Range: bytes 0-16383/{len(DATA)}", *fields)


def slow_headers(_: Request) -> Iterator[bytes]:
    for number in first_range("Content-Length: 16384"):
        yield bytes([number])
        time.sleep(0.05)


def endless_headers(_: Request) -> Iterator[bytes]:
    yield first_range()[:-2]
    for number in range(10**7):
        yield f"X-{number}: {'a' * 1000}\r\n".encode()


def endless_chunks(_: Request) -> Iterator[bytes]:
    yield first_range("Transfer-Encoding: chunked")
    yield from repeat(b"8000\r\n" + bytes(2**15) + b"\r\n")


def short_length(_: Request) -> Iterator[bytes]:
    yield first_range("Content-Length: 5") + DATA[:5]


def long_length(_: Request) -> Iterator[bytes]:
    yield first_range("Content-Length: 60000000")
    yield from repeat(bytes(2**16), 900)


def negative_length(_: Request) -> Iterator[bytes]:
    yield first_range("Content-Length: -5") + DATA[:16384]


def two_lengths(_: Request) -> Iterator[bytes]:
    yield first_range("Content-Length: 16384", "Content-Length: 5") + DATA[:16384]


def cut_short(_: Request) -> Iterator[bytes]:
    yield first_range("Content-Length: 16384") + DATA[:100]


def other_range(asked: Request) -> Iterator[bytes]:
    if not asked.number:
        yield from send_range(asked)
        return
    count = (asked.end or 0) - (asked.start or 0)
    place = f"Content-Range: bytes 0-{count - 1}/{len(DATA)}"
    yield say(206, place, f"Content-Length: {count}") + DATA[:count]


def no_size(_: Request) -> Iterator[bytes]:
    yield say(206, "Content-Range: bytes 0-16383/*", "Content-Length: 16384") + DATA[:16384]


def growing_size(asked: Request) -> Iterator[bytes]:
    size = len(DATA) + asked.number
    start, end = asked.start or 0, asked.end or 0
    place = f"Content-Range: bytes {start}-{end - 1}/{size}"
    yield say(206, place, f"Content-Length: {end - start}") + DATA[start:end]


def growing_file(asked: Request) -> Iterator[bytes]:
    data = DATA + bytes(asked.number)
    yield say(200, f"Content-Length: {len(data)}") + data


def changing_mark(asked: Request) -> Iterator[bytes]:
    yield from send_range(asked, f'ETag: "{asked.number}"')


def to_a_file(_: Request) -> Iterator[bytes]:
    yield say(302, "Location: file:///etc/passwd", "Content-Length: 0")


def in_circles(asked: Request) -> Iterator[bytes]:
    yield say(302, f"Location: /{asked.number}.mcap", "Content-Length: 0")


def after_hops(count: int) -> Answer:
    """Return an answer that sends on so often, then serves."""

    def answer(asked: Request) -> Iterator[bytes]:
        if asked.number % (count + 1) < count:
            yield say(302, f"Location: /{asked.number}.mcap", "Content-Length: 0")
        else:
            yield from send_range(asked)

    return answer


def nowhere(_: Request) -> Iterator[bytes]:
    yield say(302, "Content-Length: 0")


def bomb(_: Request) -> Iterator[bytes]:
    import gzip

    body = gzip.compress(bytes(5 * 2**20), 1)
    yield first_range("Content-Encoding: gzip", f"Content-Length: {len(body)}") + body


def no_range_at_all(_: Request) -> Iterator[bytes]:
    yield say(416, f"Content-Range: bytes */{len(DATA)}", "Content-Length: 0")


def no_content(_: Request) -> Iterator[bytes]:
    yield say(204)


def trickle(_: Request) -> Iterator[bytes]:
    yield first_range("Content-Length: 16384")
    for number in range(16384):
        yield DATA[number : number + 1]
        time.sleep(0.05)


def drip(count: int) -> Answer:
    """Return an answer of 1500 bytes that comes by so many bytes in 50 ms."""

    def answer(_: Request) -> Iterator[bytes]:
        yield say(206, "Content-Range: bytes 0-1499/1500", "Content-Length: 1500")
        for start in range(0, 1500, count):
            yield DATA[start : min(start + count, 1500)]
            time.sleep(0.05)

    return answer


def several_parts(asked: Request) -> Iterator[bytes]:
    part = b"--x\r\nContent-Range: bytes 0-9/1000008\r\n\r\n" + DATA[:10] + b"\r\n--x--\r\n"
    kind = "Content-Type: multipart/byteranges; boundary=x"
    yield say(206, kind, f"Content-Length: {len(part)}") + part


def interim_answers(_: Request) -> Iterator[bytes]:
    for hints in repeat(b"HTTP/1.1 103 Early Hints\r\nLink: </a>\r\n\r\n" * 10):
        yield hints
        time.sleep(0.002)  # how many come is not the speed of this machine


def huge_chunk(_: Request) -> Iterator[bytes]:
    yield first_range("Transfer-Encoding: chunked") + b"FFFFFFFFFFFFFFFFF\r\n"
    yield DATA[:16384]


def endless_trailers(_: Request) -> Iterator[bytes]:
    body = f"{16384:x}\r\n".encode() + DATA[:16384] + b"\r\n0\r\n"
    yield first_range("Transfer-Encoding: chunked") + body
    yield from repeat(b"X-More: a\r\n" * 100)


def escapes_in_range(_: Request) -> Iterator[bytes]:
    yield say(206, "Content-Range: bytes \x1b[2J\x1b]0;x\x07 0-1/5", "Content-Length: 2") + b"ab"


def immense_size(asked: Request) -> Iterator[bytes]:
    yield say(206, f"Content-Range: bytes 0-16383/{2**62}", "Content-Length: 16384")
    yield DATA[:16384]


def come_again_in_a_century(_: Request) -> Iterator[bytes]:
    yield say(429, "Retry-After: 3153600000", "Content-Length: 0")


def whole_file(_: Request) -> Iterator[bytes]:
    yield say(200, f"Content-Length: {len(DATA)}") + DATA


def endless_file(_: Request) -> Iterator[bytes]:
    yield say(200)
    yield DATA
    for piece in repeat(bytes(2**16)):
        time.sleep(0.005)  # 13 MB/s, so that little waits in the buffers of a slow reader
        yield piece


def huge_ranges(asked: Request) -> Iterator[bytes]:
    start, end = asked.start or 0, asked.end or 0
    place = f"Content-Range: bytes {start}-{end - 1}/{10**13}"
    yield say(206, place, f"Content-Length: {end - start}") + b"1,2,3\n" * (2**14 // 6) + b"1,2\n"


def huge_file(_: Request) -> Iterator[bytes]:
    yield say(200, f"Content-Length: {10**13}")
    yield DATA
    yield from repeat(bytes(2**16))


def web_page(_: Request) -> Iterator[bytes]:
    yield say(200)
    yield b"<!DOCTYPE html><html>" + b"<p>Log in</p>" * 10**5
    yield from repeat(b"<p>Log in</p>" * 5000)


def long_web_page(_: Request) -> Iterator[bytes]:
    yield say(200, "Content-Length: 60000000")
    yield b"<!DOCTYPE html><html>" + b"<p>Log in</p>" * 10**4
    yield from repeat(b"<p>Log in</p>" * 5000)


def long_footer(length: int) -> Answer:
    """Return the answers of a Parquet file of 2^40 bytes that ends with a footer of so many."""

    def answer(asked: Request) -> Iterator[bytes]:
        size, ending = 2**40, length.to_bytes(4, "little") + b"PAR1"
        start, end = asked.start or 0, asked.end or 0
        place = f"Content-Range: bytes {start}-{end - 1}/{size}"
        yield say(206, place, f"Content-Length: {end - start}")
        data = b"PAR1" + bytes(end - start - 4) if not start else bytes(end - start)
        yield data[: -len(ending)] + ending if end == size else data

    return answer
