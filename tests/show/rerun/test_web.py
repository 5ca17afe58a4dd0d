from pathlib import Path
from urllib.error import HTTPError
from urllib.parse import parse_qs, urlsplit
from urllib.request import ProxyHandler, Request, build_opener

import pytest

import turtlelog as tl
from turtlelog.errors import ShowError

OPENER = build_opener(ProxyHandler({}))


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
    with tl.show.serve_recordings(paths) as address:
        root = address.partition("?")[0]
        assert root.startswith("http://127.0.0.1:")
        assert b"re_viewer.js" in fetch(address)
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


def test_nothing_to_serve_is_an_error(tmp_path: Path) -> None:
    with (
        pytest.raises(ShowError, match="expected a recording, found no such file"),
        tl.show.serve_recordings([tmp_path / "none.rrd"]),
    ):
        pass
