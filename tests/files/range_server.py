"""A server of ranges that counts what it sends, and fails as it is asked to."""

import re
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Literal, Self

Fault = Literal["cut", "error", "hang", "denied"]


@dataclass(kw_only=True)
class RangeServer:
    """Serves bytes by name on 127.0.0.1 as long as the block lasts.

    Attributes:
        files: What it serves.
        has_ranges: Whether it answers a range with a range.
        faults: What goes wrong with the next answers with bytes, one each.
        ranges: Ranges that were asked for and sent.
        sent: Bytes that were sent.
        marks: Headers of every answer, as ETag.
        swap: Called before the answer to the second range.
    """

    files: Mapping[str, bytes]
    has_ranges: bool = True
    faults: list[Fault] = field(default_factory=list)
    ranges: list[tuple[int, int]] = field(default_factory=list)
    sent: int = 0
    marks: dict[str, str] = field(default_factory=dict)
    swap: Callable[[], None] | None = None

    def __enter__(self) -> Self:
        owner, self._released = self, threading.Event()

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"
            disable_nagle_algorithm = True

            def do_HEAD(self) -> None:
                self._answer(with_body=False)

            def do_GET(self) -> None:
                self._answer(with_body=True)

            def log_message(self, *_: object) -> None:
                pass

            def _answer(self, *, with_body: bool) -> None:
                owner._answer(self, with_body=with_body)

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._server.daemon_threads = True
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.02,))
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._released.set()
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    def url(self, name: str) -> str:
        return f"http://127.0.0.1:{self._server.server_address[1]}/{name}"

    def _answer(self, request: BaseHTTPRequestHandler, *, with_body: bool) -> None:
        if with_body and self.ranges and self.swap is not None:
            self.swap()
        data = self.files.get(request.path.lstrip("/"))
        fault = self.faults.pop(0) if self.faults and with_body else None
        asked = re.fullmatch(r"bytes=(\d+)-(\d+)", request.headers.get("Range", ""))
        if data is None or fault in {"error", "denied"}:
            status = 404 if data is None else 503 if fault == "error" else 403
            request.send_response(status)
            request.send_header("Content-Length", "0")
            request.end_headers()
            return
        start, end = (int(asked[1]), int(asked[2]) + 1) if asked else (0, len(data))
        end = min(end, len(data))
        is_range = asked is not None and self.has_ranges
        body = data[start:end] if is_range else data
        request.send_response(206 if is_range else 200)
        request.send_header("Content-Length", str(len(body)))
        for name, mark in self.marks.items():
            request.send_header(name, mark)
        if is_range:
            request.send_header("Content-Range", f"bytes {start}-{end - 1}/{len(data)}")
        request.end_headers()
        if with_body:
            self._send(request, start, body, fault)

    def _send(
        self, request: BaseHTTPRequestHandler, start: int, body: bytes, fault: Fault | None
    ) -> None:
        if fault is not None:
            request.wfile.write(body[: len(body) // 2])
            request.wfile.flush()
            if fault == "hang":
                self._released.wait(30)
            request.close_connection = True
            return
        self.ranges.append((start, start + len(body)))
        try:
            request.wfile.write(body)
        except OSError:  # who asked has seen enough
            request.close_connection = True
        else:
            self.sent += len(body)
