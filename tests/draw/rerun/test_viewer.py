import math
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import cast

import pytest
from rerun.experimental import ViewerClient

from turtlelog.draw import write_snapshot
from turtlelog.draw.rerun import viewer
from turtlelog.draw.rerun.viewer import ViewerProcess, wait_for_viewer
from turtlelog.errors import ShowError

ROOT = Path(__file__).parents[3]
PROGRAM = """
import time
from turtlelog.draw.rerun.viewer import find_free_port, wait_for_viewer
from turtlelog.draw.rerun.viewer import start_viewer

port = find_free_port()
with start_viewer(["--headless", "--port", str(port)]) as viewer:
    wait_for_viewer(viewer, port)
    print(viewer.process_id, flush=True)
    time.sleep(60.0)
"""


def is_running(place: Path) -> bool:
    try:
        return place.read_bytes() != b""  # a zombie's is empty
    except OSError:
        return False


@pytest.mark.thorough
@pytest.mark.viewer
@pytest.mark.skipif(shutil.which("setpriv") is None, reason="needs Linux and its setpriv")
def test_a_viewer_whose_parent_is_killed_ends_too() -> None:
    parent = subprocess.Popen(
        [sys.executable, "-c", PROGRAM],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert parent.stdout is not None
    with parent:
        number = parent.stdout.readline()
        if not number:
            pytest.skip("no viewer can run here")
        place = Path(f"/proc/{int(number)}/cmdline")
        assert b"rerun" in place.read_bytes()
        parent.kill()
    deadline = time.monotonic() + 20.0
    while is_running(place):
        assert time.monotonic() < deadline
        time.sleep(0.05)


class DyingClient:
    """Answers like a viewer without a graphics driver, which dies when it begins to draw."""

    def get_state(self) -> object:
        return object()

    def take_screenshot(self, **_: object) -> bytes:
        raise ConnectionError("transport error")


class DyingViewer:
    """A process that is gone at the second look."""

    def __init__(self, *, looks: float = 1) -> None:
        self.looks = looks

    @property
    def has_ended(self) -> bool:
        self.looks -= 1
        return self.looks < 0

    def read_error(self) -> str:
        return "'Failed to get render context'"


@pytest.fixture
def answering(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let every viewer answer, draw nothing and die."""

    @contextmanager
    def start_dying(options: Sequence[str]) -> Iterator[DyingViewer]:
        yield DyingViewer()

    monkeypatch.setattr(ViewerClient, "connect", lambda _: DyingClient())
    monkeypatch.setattr(viewer, "start_viewer", start_dying)


@pytest.mark.usefixtures("answering")
def test_a_viewer_that_answers_but_draws_nothing_is_none() -> None:
    with pytest.raises(ConnectionError, match="Failed to get render context"):
        wait_for_viewer(cast("ViewerProcess", DyingViewer()), 9876)


@pytest.mark.usefixtures("answering")
def test_a_viewer_that_lives_but_draws_nothing_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(viewer, "_START_S", 0.3)
    with pytest.raises(ConnectionError, match=r"no picture in 0\.3 s"):
        wait_for_viewer(cast("ViewerProcess", DyingViewer(looks=math.inf)), 9876)


@pytest.mark.usefixtures("answering")
def test_a_snapshot_by_a_viewer_that_draws_nothing_names_what_is_missing(
    run_rrd: Path, tmp_path: Path
) -> None:
    with pytest.raises(ShowError, match=r"expected a graphics adapter .*Failed to get render"):
        write_snapshot(run_rrd, tmp_path / "x.png")
    assert not (tmp_path / "x.png").exists()


@pytest.mark.usefixtures("answering")
def test_a_window_that_draws_nothing_is_none() -> None:
    with (
        pytest.raises(ShowError, match=r"expected a window, found: .*render context.*; without"),
        viewer.open_window("take a picture"),
    ):
        pytest.fail("the window counts as open")
