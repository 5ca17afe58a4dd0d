import subprocess
import sys
from pathlib import Path

import pytest
import rerun as rr

from tests.draw.rerun.rrds import make_foreign_run
from tests.log.live import ROOT
from turtlelog.draw import write_run_rrd
from turtlelog.draw.rerun import recording_stream
from turtlelog.errors import ShowError

RUN = make_foreign_run(3)


def test_a_missing_folder_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(ShowError, match=r"run\.rrd: cannot be written") as caught:
        write_run_rrd(RUN, tmp_path / "missing" / "run.rrd")
    assert "\n" not in str(caught.value)


def test_a_folder_in_place_of_the_file_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(ShowError, match="found a folder"):
        write_run_rrd(RUN, tmp_path)


def test_rerun_switched_off_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RERUN", "off")
    with pytest.raises(ShowError, match="RERUN='off'"):
        write_run_rrd(RUN, tmp_path / "run.rrd")
    assert not list(tmp_path.iterdir())


def test_a_file_that_rerun_did_not_write_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rr.RecordingStream, "save", lambda *_, **__: None)
    with pytest.raises(ShowError, match="found: none"):
        write_run_rrd(RUN, tmp_path / "run.rrd")


LIMITED = """
import resource, sys
from pathlib import Path
import turtlelog as tl

run = tl.simulate_run(tl.load_scenario("paper-kp10"))
folder, limit = Path(sys.argv[1]), int(sys.argv[2])
tl.write_run_rrd(run, folder / "a.rrd")
size = (folder / "a.rrd").stat().st_size
resource.setrlimit(resource.RLIMIT_FSIZE, (limit if limit > 0 else size + limit,) * 2)
try:
    tl.write_run_rrd(run, folder / "b.rrd")
except tl.TurtlelogError as err:
    print(err)
"""


@pytest.mark.thorough
@pytest.mark.skipif(sys.platform == "win32", reason="Windows knows no largest size of files")
def test_a_file_that_can_grow_no_further_is_one_line(tmp_path: Path) -> None:
    """Two processes start Rerun, which waits for seconds when a write fails."""
    # At once: Rerun leaves some of them waiting for seconds.
    started = {limit: start_limited(limit, tmp_path) for limit in (1, -20_000)}
    for limit, process in started.items():
        out, err = process.communicate(timeout=60)
        assert "b.rrd: cannot be written: File too large" in out, limit
        assert (process.returncode, out.count("\n"), err) == (0, 1, ""), limit
        assert [path.name for path in (tmp_path / str(limit)).iterdir()] == ["a.rrd"], limit


def start_limited(limit: int, folder: Path) -> "subprocess.Popen[str]":
    (folder / str(limit)).mkdir()
    return subprocess.Popen(
        [sys.executable, "-c", LIMITED, str(folder / str(limit)), str(limit)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
    )


def fail_in_recording(path: Path) -> None:
    layout = rr.blueprint.Blueprint(rr.blueprint.TextLogView())
    with recording_stream.open_recording(path, name="x", layout=layout) as stream:
        stream.log("x", rr.Scalars("no number"))


def test_wrong_data_raises_and_leaves_no_file(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no number"):
        fail_in_recording(tmp_path / "run.rrd")
    assert not list(tmp_path.iterdir())


def test_strict_mode_ends_with_the_recording(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no number"):
        fail_in_recording(tmp_path / "run.rrd")
    assert not rr.strict_mode()


def test_strict_mode_lasts_until_the_last_of_several_recordings_ends() -> None:
    first, second = recording_stream.strict_mode(), recording_stream.strict_mode()
    first.__enter__()
    second.__enter__()
    first.__exit__(None, None, None)
    assert rr.strict_mode()
    second.__exit__(None, None, None)
    assert not rr.strict_mode()


def test_importing_the_package_does_not_load_rerun() -> None:
    code = "import sys, turtlelog.draw; sys.exit('rerun' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
