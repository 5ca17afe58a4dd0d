import shutil
import sys
import time
from pathlib import Path
from urllib.error import HTTPError
from urllib.parse import parse_qs, urlsplit
from urllib.request import ProxyHandler, Request, build_opener

import pytest

import turtlelog as tl
from tests.draw.rerun.headless import PATIENCE_S
from turtlelog.errors import ShowError

OPENER = build_opener(ProxyHandler({}))


def read_policy(address: str) -> dict[str, str]:
    """Return the sources that the page allows, by directive."""
    with OPENER.open(address, timeout=10) as answer:
        policy = answer.headers["Content-Security-Policy"] or ""
    pairs = (part.strip().partition(" ") for part in policy.split(";"))
    return {name: sources for name, _, sources in pairs}


def fetch(address: str, host: str | None = None) -> bytes:
    headers = {} if host is None else {"Host": host}
    with OPENER.open(Request(address, headers=headers), timeout=10) as answer:
        data: bytes = answer.read()
    return data


@pytest.mark.viewer
def test_a_browser_gets_the_page_the_program_and_every_recording(tmp_path: Path) -> None:
    paths = [tmp_path / "a b.rrd", tmp_path / "c.rrd"]
    for path in paths:
        path.write_bytes(path.name.encode() * 1000)
    with tl.draw.serve_recordings(paths) as address:
        root = address.partition("?")[0]
        assert root.startswith("http://127.0.0.1:")
        assert b"re_viewer.js" in fetch(address)
        # No font, no telemetry and no page of releases: neither named nor allowed.
        assert b"fonts." not in fetch(address)
        assert read_policy(address)["default-src"] == "'none'"
        assert read_policy(address)["connect-src"] == "'self'"
        assert fetch(f"{root}re_viewer_bg.wasm")[:4] == b"\0asm"
        assert parse_qs(urlsplit(address).query)["theme"] == ["dark"]
        named = parse_qs(urlsplit(address).query)["url"]
        assert [fetch(url) for url in named] == [path.read_bytes() for path in paths]
        for wrong, host in (("c.rrd", None), ("../c.rrd", None), ("", "elsewhere.example:80")):
            with pytest.raises(HTTPError, match=r"40[34]") as refusal:
                fetch(root + wrong, host)
            refusal.value.close()
    with pytest.raises(OSError, match="refused"):
        fetch(root)


@pytest.mark.viewer
@pytest.mark.skipif(sys.platform == "win32", reason="settings are elsewhere there")
def test_a_viewer_that_is_started_keeps_no_telemetry(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("HOME", "XDG_CONFIG_HOME", "XDG_DATA_HOME"):
        monkeypatch.setenv(name, str(tmp_path / "home"))
    monkeypatch.delenv("CI", raising=False)
    (tmp_path / "a.rrd").touch()
    with tl.draw.serve_recordings([tmp_path / "a.rrd"]):
        assert not list(tmp_path.rglob("analytics*"))


def test_nothing_to_serve_is_an_error(tmp_path: Path) -> None:
    with (
        pytest.raises(ShowError, match="expected a recording, found no such file"),
        tl.draw.serve_recordings([tmp_path / "none.rrd"]),
    ):
        pass


@pytest.mark.viewer
@pytest.mark.browser
def test_the_page_asks_nobody_but_this_machine(tmp_path: Path) -> None:
    """Chromium loads Rerun's page, and compiles it."""
    playwright, chromium = pytest.importorskip("playwright.sync_api"), shutil.which("chromium")
    if chromium is None:
        pytest.skip("no chromium is installed")
    tl.write_run_rrd(tl.read_run("recordings/paper/kp4.mcap"), tmp_path / "kp4.rrd")
    with (
        tl.draw.serve_recordings([tmp_path / "kp4.rrd"]) as address,
        playwright.sync_playwright() as p,
    ):
        browser = p.chromium.launch(
            executable_path=chromium, args=["--no-sandbox", "--enable-unsafe-swiftshader"]
        )
        page, asked = browser.new_page(), []
        page.on("requestfinished", lambda request: asked.append(request.url))
        page.on("requestfailed", lambda request: asked.append(f"{request.url} {request.failure}"))
        page.goto(address)
        if not page.evaluate("document.createElement('canvas').getContext('webgl2') !== null"):
            pytest.skip("Chromium has no WebGL here, which Rerun's page draws with")
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            page.wait_for_timeout(200)
            if any(url.endswith("/kp4.rrd") for url in asked):
                break
        browser.close()
    assert any(url.endswith("/kp4.rrd") for url in asked)
    left = [
        url for url in asked if not url.startswith("http://127.0.0.1") and not url.endswith(" csp")
    ]
    assert left == []
