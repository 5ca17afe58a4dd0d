"""Rerun's viewers: the native viewer as a child process, and the web viewer on this machine."""

import os
import re
import shutil
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from typing import IO, TYPE_CHECKING, Final
from urllib.error import URLError
from urllib.parse import quote, urlencode, urlsplit
from urllib.request import ProxyHandler, build_opener

from turtlelog.errors import ShowError
from turtlelog.escapes import write_policy

if TYPE_CHECKING:
    from rerun.experimental import ViewerClient


_PATIENCE_S: Final = 5.0

_LOCAL: Final = "127.0.0.1"
"""Loopback address, which other machines cannot reach."""

_START_S: Final = 30.0
_ANSWER_S: Final = 5.0
_SCHEMES: Final = frozenset({"rerun", "rerun+http", "rerun+https"})
_RETRY_S: Final = 0.1

_NO_TELEMETRY: Final = {"CI": "1"}
"""Environment that disables Rerun's telemetry, which has no option for a single viewer."""

_PROOF_PIXELS: Final = 16
"""Longest side of the picture that proves that a viewer draws [pixels]; the smallest costs
least."""


class ViewerProcess:
    """A started viewer, with its messages on stderr."""

    def __init__(self, process: "subprocess.Popen[bytes]", messages: IO[bytes]) -> None:
        self._process, self._messages = process, messages

    @property
    def process_id(self) -> int:
        """The process id."""
        return self._process.pid

    @property
    def has_ended(self) -> bool:
        """Whether the process has ended."""
        return self._process.poll() is not None

    def wait(self) -> int:
        """Wait for the end of the process and return its exit code."""
        return self._process.wait()

    def read_error(self) -> str:
        """Return the viewer's error message in one line, without places in its source."""
        self._messages.seek(0)
        lines = self._messages.read().decode(errors="replace").splitlines()
        errors = [line for line in lines if re.search(r"^Error:|panicked at", line)]
        if not errors:
            return f"exit code {self._process.poll()}"
        return re.sub(
            r"^(Error: |thread '.*' panicked at )|(os error )?at \S+\.rs:\d+: ", "", errors[0]
        )

    def end(self) -> None:
        """End the process if it has not ended."""
        if self.has_ended:
            return
        self._process.terminate()
        try:
            self._process.wait(_PATIENCE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def find_viewer() -> Path:
    """Return the viewer's binary, because the `rerun` script would add another process.

    Raises:
        ShowError: If there is no such binary.
    """
    name = "rerun.exe" if sys.platform == "win32" else "rerun"
    package = find_spec("rerun_cli")
    binary = Path(package.origin).with_name(name) if package and package.origin else Path(name)
    if not binary.is_file():
        raise ShowError(f"{binary}: the viewer that comes with rerun-sdk is not there")
    return binary


def open_viewer(paths: Sequence[str | Path]) -> None:
    """Open recordings in a window and wait until it is closed.

    Raises:
        ShowError: If a file is missing, or no window can be opened.
    """
    require_recordings(paths)
    with start_viewer(["--port", "auto", *(str(path) for path in paths)]) as viewer:
        if viewer.wait():
            raise ShowError(
                f"viewer: the window failed ({viewer.read_error().rstrip('.')});"
                " without a display `turtlelog view FILE --snapshot X.png` makes a picture,"
                " `--save X.rrd` a file to open elsewhere"
            )


@contextmanager
def open_window(advice: str) -> Iterator[tuple[ViewerProcess, str]]:
    """Open a viewer without a recording until the block ends, and yield it with its address.

    Args:
        advice: Advice if no window can be opened, in one clause.

    Raises:
        ShowError: If no window can be opened.
    """
    port = find_free_port()
    options = ["--port", str(port), "--hide-welcome-screen", "--expect-data-soon"]
    with start_viewer(options) as viewer:
        try:
            wait_for_viewer(viewer, port)
        except ConnectionError as err:
            raise ShowError(
                f"viewer: expected a window, found: {err}; without a display {advice}"
            ) from err
        yield viewer, build_url(port)


@contextmanager
def start_viewer(options: Sequence[str]) -> Iterator[ViewerProcess]:
    """Start a viewer that listens only on this machine, and end it after the block."""
    # Only Linux has a command that ends a viewer whose parent was killed.
    setpriv = shutil.which("setpriv") if sys.platform == "linux" else None
    guard = [] if setpriv is None else [setpriv, "--pdeathsig", "TERM"]
    # The viewer leaves a folder in the temporary folder, so it gets a folder of its own.
    with TemporaryFile() as messages, TemporaryDirectory(prefix="turtlelog-") as folder:
        process = subprocess.Popen(
            [*guard, find_viewer(), "--bind", _LOCAL, *options],
            env={**os.environ, **_NO_TELEMETRY, "TMPDIR": folder, "TEMP": folder, "TMP": folder},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=messages,
        )
        viewer = ViewerProcess(process, messages)
        try:
            yield viewer
        finally:
            viewer.end()


def require_recordings(paths: Sequence[str | Path]) -> None:
    """Raise ShowError if there is no path, or no file at a path."""
    if not paths:
        raise ShowError("viewer: no recording to open")
    for path in paths:
        if not Path(path).is_file():
            raise ShowError(f"{path}: expected a recording, found no such file")


def find_free_port() -> int:
    """Return a port of this machine that is free now."""
    with socket.socket() as probe:
        probe.bind((_LOCAL, 0))
        return int(probe.getsockname()[1])


def build_url(port: int) -> str:
    """Return the address at which a viewer receives data."""
    return f"rerun+http://{_LOCAL}:{port}/proxy"


def require_viewer(url: str) -> None:
    """Refuse an address without a viewer.

    Raises:
        ShowError: If the text is not an address of a viewer, or nothing answers at the address.
    """
    try:
        parts = urlsplit(url)
        is_address = bool(parts.hostname and parts.port) and parts.scheme in _SCHEMES
    except ValueError:
        is_address = False
    if not is_address:
        raise ShowError(f"{url}: expected a viewer's address, as {build_url(9876)}")
    try:
        socket.create_connection((parts.hostname or "", parts.port or 0), _ANSWER_S).close()
    except OSError as err:
        raise ShowError(
            f"{url}: expected a viewer that runs, found: {err.strerror or err}"
        ) from err


def wait_for_viewer(viewer: ViewerProcess, port: int) -> "ViewerClient":
    """Return a client as soon as the viewer has drawn something.

    An answer alone is not sufficient: without a graphics driver, the viewer listens first and ends
    when it begins to draw.

    Raises:
        ConnectionError: If the viewer ended, or never drew anything.
    """
    from rerun.experimental import ViewerClient

    deadline = time.monotonic() + _START_S
    while True:
        try:
            client = ViewerClient.connect(build_url(port))
            client.take_screenshot(max_size=_PROOF_PIXELS)
        except Exception as err:
            if not viewer.has_ended and time.monotonic() < deadline:
                time.sleep(_RETRY_S)
                continue
            found = viewer.read_error() if viewer.has_ended else f"no picture in {_START_S:g} s"
            raise ConnectionError(found) from err
        return client


_KINDS: Final[Mapping[str, str]] = {
    "": "text/html; charset=utf-8",
    "re_viewer.js": "text/javascript",
    "re_viewer_bg.wasm": "application/wasm",
    "favicon.ico": "image/x-icon",
}
"""Files of the page by name, with the content types that a browser expects."""

_RECORDING: Final = "application/octet-stream"
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
    require_recordings(paths)
    files = {f"{number}/{Path(path).name}": Path(path) for number, path in enumerate(paths)}
    ports = {"--port": find_free_port(), "--web-viewer-port": find_free_port()}
    options = [word for name, port in ports.items() for word in (name, str(port))]
    with start_viewer(["--serve-web", *options]) as viewer:
        root = f"http://{_LOCAL}:{ports['--web-viewer-port']}/"
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
    with ThreadingHTTPServer((_LOCAL, 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever, name="web", daemon=True)
        thread.start()
        try:
            root = f"http://{_LOCAL}:{server.server_port}/"
            words = [("theme", "dark"), *(("url", root + quote(name)) for name in files)]
            yield f"{root}?{urlencode(words)}"
        finally:
            server.shutdown()
            thread.join()


_REMOTE_LINK: Final = re.compile(rb"<link[^>]*https?://[^>]*>")
"""Links to fonts and early connections, which no policy covers."""


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
        # Another page may give its own name this machine's address; it gets nothing.
        if self.headers.get("Host", "").rsplit(":", 1)[0] not in {_LOCAL, "localhost"}:
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
