import signal
import subprocess
import sys
import time
from pathlib import Path
from urllib.request import ProxyHandler, build_opener

import pytest

from tests.cli.conftest import Call
from tests.log.live import ROOT

PROC = Path("/proc/net/tcp")
LISTENING = "0A"


def list_listeners(process_id: int) -> set[str]:
    """Return the addresses at which a process listens, as the kernel writes them."""
    links = [link.readlink() for link in Path(f"/proc/{process_id}/fd").iterdir()]
    own = {str(link)[8:-1] for link in links if str(link).startswith("socket:[")}
    tables = (PROC, PROC.with_name("tcp6"))
    lines = [line.split() for table in tables for line in table.read_text().splitlines()[1:]]
    return {line[1].split(":")[0] for line in lines if line[3] == LISTENING and line[9] in own}


@pytest.mark.thorough
@pytest.mark.skipif(not PROC.exists(), reason="other systems tell who listens in other ways")
def test_web_serves_on_this_machine_only_until_it_is_ended(kp10: Path) -> None:
    """A command starts a server, and is ended."""
    command = [sys.executable, "-m", "turtlelog", "view", str(kp10), "--web"]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT
    ) as process:
        assert process.stdout is not None
        address = process.stdout.readline().strip()
        try:
            with build_opener(ProxyHandler({})).open(address, timeout=10) as answer:
                assert b"re_viewer.js" in answer.read()
            assert list_listeners(process.pid) == {"0100007F"}
            children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
            assert children.read_text() == ""
        finally:
            process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=20)
    assert (process.returncode, err.count("\n")) == (0, 1)


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (["a.mcap", "b.mcap", "--follow"], "--follow: takes one .mcap file"),
        (["a.rrd", "--follow"], "--follow: takes one .mcap file"),
        (["a.mcap", "--follow", "--web"], "--follow: leave out --save"),
        (["a.mcap", "--follow", "--save", "a.rrd"], "--follow: leave out --save"),
        (["a.mcap", "--connect", "rerun+http://127.0.0.1:9/proxy"], "--connect: needs --follow"),
        (["a.mcap", "--timeline", "translate_time"], "--timeline: needs --snapshot"),
        (["a.mcap", "--save", "a.png"], "did you mean --snapshot a.png?"),
        (["a.mcap", "--save", "a.gif"], "did you mean --movie a.gif?"),
        (["a.mcap", "--follow"], "a.mcap: no such file"),
    ],
)
def test_ways_to_look_that_exclude_each_other_are_refused(
    words: list[str], found: str, call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    answer = call("view", *words)
    assert (answer.code, answer.out) == (2, "")
    assert found in answer.err


@pytest.mark.parametrize(
    ("ending", "option"), [("open_viewer", None), ("draw.follow_recording", "--follow")]
)
def test_ctrl_c_ends_a_look_as_well_as_the_windows_own_button(
    ending: str, option: str | None, kp10: Path, call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    def press_ctrl_c(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(f"turtlelog.{ending}", press_ctrl_c)
    answer = call("view", kp10, *filter(None, [option]))
    assert (answer.code, answer.out, answer.err) == (0, "", "")


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have a display")
@pytest.mark.parametrize(
    "words",
    [["run", "paper", "--live", "--realtime", "-o", "new.mcap"], ["view", "kp10", "--follow"]],
    ids=["live", "follow"],
)
def test_without_a_display_the_way_to_a_picture_is_named(
    words: list[str], kp10: Path, call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    start_s = time.monotonic()
    answer = call(*(kp10 if word == "kp10" else word for word in words))
    assert (answer.code, answer.err.count("\n")) == (2, 1)
    assert "viewer: expected a window" in answer.err
    assert "--snapshot X.png" in answer.err
    assert not Path("new.mcap").exists()
    assert time.monotonic() - start_s < 10.0


def test_a_run_in_a_viewer_that_is_not_there_never_starts(call: Call, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    url = "rerun+http://127.0.0.1:9/proxy"
    answer = call("run", "paper", "--realtime", "-o", path, "--connect", url)
    assert (answer.code, answer.out, path.exists()) == (2, "", False)
    assert f"{url}: expected a viewer that runs, found: " in answer.err
