import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
PROGRAM = """
import time
from turtlelog.show.rerun.connection import find_free_port, wait_for_viewer
from turtlelog.show.rerun.viewer import start_viewer

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
