"""Views in a browser: a run in a notebook, and recordings in Rerun's web viewer on this machine."""

import re
import shutil
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.util import find_spec
from numbers import Integral
from pathlib import Path
from typing import TYPE_CHECKING, Final
from urllib.error import URLError
from urllib.parse import quote, urlencode, urlsplit
from urllib.request import ProxyHandler, build_opener

from turtlelog.errors import ShowError
from turtlelog.escapes import write_policy
from turtlelog.run import Run, require_run

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rerun.notebook import Viewer

    from turtlelog.draw.rerun.viewer import ViewerProcess


def show_run(run: Run, *, width: int = 960, height: int = 640) -> "Viewer | Figure":
    """Return a run as a widget of Rerun's viewer, or without the extra `notebook` as a figure.

    The figure is `panel`. A notebook shows the widget or figure as the value of a cell.

    Args:
        run: Run to show.
        width: Width of the widget [pixels].
        height: Height of the widget [pixels].

    Raises:
        ShowError: If width or height is below 1, or the environment disables Rerun.
    """
    require_run(run)
    for name, value in (("width", width), ("height", height)):
        if not isinstance(value, Integral) or value < 1:
            raise ShowError(f"{name}: must be at least 1 pixel, not {value!r:.60}")
    if any(find_spec(module) is None for module in ("rerun", "rerun_notebook")):
        from turtlelog.draw.figures import draw_figure  # not needed for the widget

        return draw_figure("panel", run)
    return _build_widget(run, (width, height))


def _build_widget(run: Run, size: tuple[int, int]) -> "Viewer":
    """Return a notebook widget of this width and height [pixels] with the recording of a run.

    The page gets the recording in one message. Rerun itself would send one message per part; a
    browser without a graphics card often shows nothing after hundreds of messages.
    """
    from tempfile import TemporaryDirectory

    from turtlelog.draw.rerun.live_viewer import build_viewer
    from turtlelog.draw.rerun.run_scene import write_run_rrd

    with TemporaryDirectory(prefix="turtlelog-") as folder:
        file = Path(folder, "run.rrd")
        try:
            write_run_rrd(run, file, size=size)
        except ShowError as err:
            raise ShowError(str(err).replace(str(file), run.name)) from err
        data = file.read_bytes()
    viewer = build_viewer(size)
    viewer._viewer.send_rrd(data)
    return viewer


_KINDS: Final[Mapping[str, str]] = {
    "": "text/html; charset=utf-8",
    "re_viewer.js": "text/javascript",
    "re_viewer_bg.wasm": "application/wasm",
    "favicon.ico": "image/x-icon",
}
"""Files of the page by name, with the content types that a browser expects."""

_HOSTS: Final = frozenset({"127.0.0.1", "localhost"})  # names of this machine

_PATIENCE_S: Final = 30.0
_PAUSE_S: Final = 0.02


@contextmanager
def serve_recordings(paths: Sequence[str | Path]) -> Iterator[str]:
    """Serve .rrd files with the web viewer on 127.0.0.1 while the block runs; yield the address.

    The viewer's own web server keeps a core busy even without a visitor. The page is therefore
    fetched from that server once, kept in memory, and served from a thread of this process, without
    a display. Only the page and the given files are served, and only to this page. A
    Content-Security-Policy restricts the page's requests to this server. Otherwise Rerun's viewer
    would contact its telemetry, a page of releases and a font server, and it has no option against
    the first two.

    Raises:
        ShowError: If a file is missing, or the page cannot be fetched.
    """
    from turtlelog.draw.rerun import viewer as viewers  # a notebook without Rerun shows a figure

    viewers.require_recordings(paths)
    files = {f"{number}/{Path(path).name}": Path(path) for number, path in enumerate(paths)}
    ports = {name: viewers.find_free_port() for name in ("--port", "--web-viewer-port")}
    options = [word for name, port in ports.items() for word in (name, str(port))]
    with viewers.start_viewer(["--serve-web", *options]) as viewer:
        root = f"http://{viewers.LOCAL}:{ports['--web-viewer-port']}/"
        page = {name: _fetch(viewer, root + name) for name in _KINDS}
    page[""] = _REMOTE_LINK.sub(b"", page[""])
    policy = write_policy(
        re.findall(r"<script>(.*?)</script>", page[""].decode(), re.DOTALL),
        script_src="'self' 'wasm-unsafe-eval'",  # the viewer is WebAssembly
        connect_src="'self'",
        img_src="'self'",
        worker_src="'self' blob:",
        frame_ancestors="'none'",
    )
    fields = {"Content-Security-Policy": policy, "Referrer-Policy": "no-referrer"}
    handler = partial(_Handler, page, fields, files)
    with ThreadingHTTPServer((viewers.LOCAL, 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever, name="web", daemon=True)
        thread.start()
        try:
            root = f"http://{viewers.LOCAL}:{server.server_port}/"
            words = [("theme", "dark"), *(("url", root + quote(name)) for name in files)]
            yield f"{root}?{urlencode(words)}"
        finally:
            server.shutdown()
            thread.join()


_REMOTE_LINK: Final = re.compile(rb"<link[^>]*https?://[^>]*>")
"""Links to fonts and early connections, which no policy covers."""


def _fetch(viewer: "ViewerProcess", address: str) -> bytes:
    deadline = time.monotonic() + _PATIENCE_S
    opener = build_opener(ProxyHandler({}))
    while True:
        try:
            with opener.open(address, timeout=_PATIENCE_S) as answer:
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
        # Another page may give its own name this machine's address; it gets nothing.
        if self.headers.get("Host", "").rsplit(":", 1)[0] not in _HOSTS:
            self.send_error(HTTPStatus.FORBIDDEN)
        elif name in self._page:
            self._send_head(_KINDS[name], len(self._page[name]))
            self.wfile.write(self._page[name])
        elif name in self._files:
            self._send_file(self._files[name])
        else:
            self.send_error(HTTPStatus.NOT_FOUND)

    def handle(self) -> None:
        """Answer until the browser disconnects, possibly in the middle of an answer."""
        try:
            super().handle()
        except ConnectionError:
            self.close_connection = True

    def log_message(self, format: str, *values: object) -> None:  # noqa: A002
        """Print nothing, because the terminal belongs to the user."""

    def _send_file(self, path: Path) -> None:
        try:
            stream = path.open("rb")
        except OSError:
            self.send_error(HTTPStatus.NOT_FOUND)
            return
        with stream:
            self._send_head("application/octet-stream", path.stat().st_size)
            shutil.copyfileobj(stream, self.wfile)

    def _send_head(self, kind: str, size: int) -> None:
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(size))
        self.send_header("Cache-Control", "no-store")
        for name, value in self._fields.items():
            self.send_header(name, value)
        self.end_headers()
