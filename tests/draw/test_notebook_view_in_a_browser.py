"""The widget of a notebook, as its page in Chromium draws it."""

import importlib.util
import io
import shutil
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest

import turtlelog as tl
from tests.draw.rerun.headless import PATIENCE_S
from tests.draw.rerun.rrds import simulate_preset

PAGE: Final = """<!doctype html><div id="cell"></div><script type="module">
import widget from "./widget.js";
const data = await (await fetch("run.rrd")).arrayBuffer();
const values = {_width: 900, _height: 500};
let receive = null;
const model = {
  get: (name) => values[name] ?? null,
  on: (event, handler) => { if (event === "msg:custom") receive = handler; },
  send: (message) => { if (message === "ready") receive({type: "rrd"}, [new DataView(data)]); },
};
widget.render({model, el: document.getElementById("cell")});
</script>"""
"""Jupyter's part: it hands over what the widget sends, once the page is ready."""

CURVE: Final = (0, 114, 178)
"""Colour of the run, and of nothing else in the page."""


@contextmanager
def serve(folder: Path) -> Iterator[str]:
    """Serve a folder on this machine."""

    class Quiet(SimpleHTTPRequestHandler):
        def log_message(self, format: str, *args: Any) -> None:  # noqa: A002
            del format, args

    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(folder)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_port}/"
    finally:
        server.shutdown()
        server.server_close()


def count_curve(png: bytes) -> int:
    """Return the pixels that have the colour of the run."""
    from PIL import Image

    pixels = np.asarray(Image.open(io.BytesIO(png)).convert("RGB"), np.int64)
    return int((np.abs(pixels - CURVE).max(axis=2) <= 12).sum())


@pytest.mark.viewer
@pytest.mark.browser
@pytest.mark.thorough
def test_the_widget_shows_the_run(tmp_path: Path) -> None:
    """Chromium compiles Rerun's viewer and draws in software: 20 s."""
    playwright, chromium = pytest.importorskip("playwright.sync_api"), shutil.which("chromium")
    found = importlib.util.find_spec("rerun_notebook")
    if chromium is None or found is None or found.origin is None:
        pytest.skip("no chromium, or the extra notebook is not installed")
    shown: Any = tl.show_run(simulate_preset("paper-kp4"), width=900, height=500)
    [(_, [data])] = shown._viewer._event_queue
    (tmp_path / "run.rrd").write_bytes(data)
    (tmp_path / "index.html").write_text(PAGE, "utf-8")
    for file in (Path(found.origin).parent / "static").iterdir():
        (tmp_path / file.name).symlink_to(file)
    with serve(tmp_path) as address, playwright.sync_playwright() as p:
        browser = p.chromium.launch(
            executable_path=chromium, args=["--no-sandbox", "--enable-unsafe-swiftshader"]
        )
        page = browser.new_page(viewport={"width": 1000, "height": 600})
        page.goto(address)
        if not page.evaluate("document.createElement('canvas').getContext('webgl2') !== null"):
            pytest.skip("Chromium has no WebGL here, which Rerun's page draws with")
        drawn = 0
        for _ in range(round(PATIENCE_S)):
            page.wait_for_timeout(1000)
            drawn = count_curve(page.screenshot())
            if drawn > 1000:
                break
        browser.close()
    assert drawn > 1000  # the welcome screen of an empty viewer has none
