"""What `view --snapshot` refuses before it draws."""

from pathlib import Path

import pytest

import turtlelog as tl
from tests.fresh_process import run_command
from turtlelog.cli.view import PictureOptions, _choose_time, _parse_size
from turtlelog.errors import UsageError
from turtlelog.scenario import get_preset


@pytest.mark.parametrize("size", ["479x320", "480x319"])
def test_a_size_at_which_no_curve_shows_is_refused(size: str) -> None:
    with pytest.raises(UsageError, match=f"--size: expected at least 480x320, .*, found {size}"):
        _parse_size(size)
    assert _parse_size("480x320") == (480, 320)


def test_a_time_beyond_the_run_is_refused_and_without_one_the_picture_is_of_its_end() -> None:
    assert _choose_time(PictureOptions(), 12.608) == 12.608
    assert _choose_time(PictureOptions(at=12.608), 12.608) == 12.608
    with pytest.raises(UsageError, match=r"--at: expected at most 12.608 s, .*, found 12.61"):
        _choose_time(PictureOptions(at=12.61), 12.608)
    assert _choose_time(PictureOptions(at=99.0, timeline="translate_time"), 12.608) == 99.0
    assert _choose_time(PictureOptions(), None) is None


def test_a_picture_that_shows_nothing_is_one_line_and_no_file(tmp_path: Path) -> None:
    run = tl.simulate_run(get_preset("paper-kp10"))
    tl.write_recording(run, tmp_path / "run.mcap")
    words = ("view", tmp_path / "run.mcap", "--snapshot", tmp_path / "x.png", "--at", "99")
    answer = run_command(*map(str, words), folder=tmp_path)
    assert answer.returncode == 2
    assert answer.stderr.splitlines()[-1].startswith("turtlelog: error: --at: expected at most")
    assert not (tmp_path / "x.png").exists()
