"""Recordings served to a browser on this machine: Rerun's web viewer, and the files beside it."""

import re
import shutil
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Final
from urllib.error import URLError
from urllib.parse import quote, urlencode, urlsplit
from urllib.request import ProxyHandler, build_opener

from turtlelog.draw.page_policy import write_policy
from turtlelog.draw.rerun.viewer import (
    LOCAL,
    ViewerProcess,
    find_free_port,
    require_recordings,
    start_viewer,
)
from turtlelog.errors import ShowError

_KINDS: Final[Mapping[str, str]] = {
    "": "text/html; charset=utf-8",
    "re_viewer.js": "text/javascript",
    "re_viewer_bg.wasm": "application/wasm",
    "favicon.ico": "image/x-icon",
}
"""What the page consists of, by name, with the types that a browser expects."""

_RECORDING: Final = "application/octet-stream"
_START_S: Final = 30.0
_PAUSE_S: Final = 0.02


@contextmanager
def serve_recordings(paths: Sequence[str | Path]) -> Iterator[str]:
    """Serve .rrd files with the web viewer on 127.0.0.1 while the block runs; yield the address.

    The viewer's own web server keeps a core busy even where nobody looks. So the page is taken from
    it once, kept in memory, and served from a thread of this process: nothing outlives it, and it
    needs no display. Only the page and the files named are served, and only to pages of its own.
    A Content-Security-Policy allows the page to ask this server alone. Rerun's viewer would ask its
    telemetry, a page of releases and a server of fonts, and has no option against the first two.

    Raises:
        ShowError: If a file is missing, or the page cannot be had.
    """
    require_recordings(paths)
    files = {f"{number}/{Path(path).name}": Path(path) for number, path in enumerate(paths)}
    page = _fetch_page()
    handler = partial(_Handler, page, _write_head_fields(page), files)
    with ThreadingHTTPServer((LOCAL, 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever, name="web", daemon=True)
        thread.start()
        try:
            yield _build_address(f"http://{LOCAL}:{server.server_port}/", list(files))
        finally:
            server.shutdown()
            thread.join()


def _build_address(root: str, names: Sequence[str]) -> str:
    words = [("theme", "dark"), *(("url", root + quote(name)) for name in names)]
    return f"{root}?{urlencode(words)}"


def _fetch_page() -> dict[str, bytes]:
    """Return what the page consists of, from a server of the viewer's that ends at once."""
    ports = {"--port": find_free_port(), "--web-viewer-port": find_free_port()}
    options = [word for name, port in ports.items() for word in (name, str(port))]
    with start_viewer(["--serve-web", *options]) as viewer:
        root = f"http://{LOCAL}:{ports['--web-viewer-port']}/"
        page = {name: _fetch(viewer, root + name) for name in _KINDS}
    return page | {"": _REMOTE_LINK.sub(b"", page[""])}


_REMOTE_LINK: Final = re.compile(rb"<link[^>]*https?://[^>]*>")
"""Fonts, and connections ahead of time, which no policy covers."""


def _write_head_fields(page: Mapping[str, bytes]) -> dict[str, str]:
    """Return the policy of the page and its viewer, which is WebAssembly."""
    scripts = re.findall(r"<script>(.*?)</script>", page[""].decode(), re.DOTALL)
    policy = write_policy(
        scripts,
        script_src="'self' 'wasm-unsafe-eval'",
        connect_src="'self'",
        img_src="'self'",
        worker_src="'self' blob:",
        frame_ancestors="'none'",
    )
    return {"Content-Security-Policy": policy, "Referrer-Policy": "no-referrer"}


def _fetch(viewer: ViewerProcess, address: str) -> bytes:
    deadline = time.monotonic() + _START_S
    opener = build_opener(ProxyHandler({}))
    while True:
        try:
            with opener.open(address, timeout=_START_S) as answer:
                data: bytes = answer.read()
        except (URLError, OSError) as err:
            if not viewer.has_ended and time.monotonic() < deadline:
                time.sleep(_PAUSE_S)
                continue
            raise ShowError(f"viewer: expected its web page, found: {viewer.read_error()}") from err
        return data


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    def __init__(
        self,
        page: Mapping[str, bytes],
        fields: Mapping[str, str],
        files: Mapping[str, Path],
        *words: object,
    ) -> None:
        self._page, self._fields = page, fields
        self._files = {quote(name): path for name, path in files.items()}
        super().__init__(*words)  # type: ignore[arg-type]

    def do_GET(self) -> None:
        """Answer with a part of the page or a file."""
        name = urlsplit(self.path).path.removeprefix("/")
        # A page elsewhere may give its own name the address of this machine: it gets nothing.
        if self.headers.get("Host", "").rsplit(":", 1)[0] not in {LOCAL, "localhost"}:
            self.send_error(HTTPStatus.FORBIDDEN)
        elif name in self._page:
            self._send_head(_KINDS[name], len(self._page[name]))
            self.wfile.write(self._page[name])
        elif name in self._files:
            self._send_file(self._files[name])
        else:
            self.send_error(HTTPStatus.NOT_FOUND)

    def handle(self) -> None:
        """Answer until the browser goes, which may be in the middle."""
        try:
            super().handle()
        except ConnectionError:
            self.close_connection = True

    def log_message(self, format: str, *values: object) -> None:  # noqa: A002
        """Say nothing: the terminal is the user's."""

    def _send_file(self, path: Path) -> None:
        try:
            stream = path.open("rb")
        except OSError:
            self.send_error(HTTPStatus.NOT_FOUND)
            return
        with stream:
            self._send_head(_RECORDING, path.stat().st_size)
            shutil.copyfileobj(stream, self.wfile)

    def _send_head(self, kind: str, size: int) -> None:
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(size))
        self.send_header("Cache-Control", "no-store")
        for name, value in self._fields.items():
            self.send_header(name, value)
        self.end_headers()
