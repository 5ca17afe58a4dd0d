"""What `view --snapshot` refuses before it draws."""

import math
from pathlib import Path

import pytest

import turtlelog as tl
from tests.cli.conftest import Call
from tests.draw.rerun.rrds import list_entities
from tests.fresh_process import run_command
from tests.log.ros2.robots import say_odometry, write_robot
from tests.log.ros2.test_bag_scans import say_map, say_scan
from turtlelog.cli.view import (
    MovieOptions,
    PictureOptions,
    _choose_time,
    _parse_size,
    _require_picture,
)
from turtlelog.draw.rerun.viewer import _require_inside
from turtlelog.errors import ShowError, UsageError
from turtlelog.scenario import get_preset


@pytest.mark.parametrize("size", ["479x320", "480x319"])
def test_a_size_at_which_no_curve_shows_is_refused(size: str) -> None:
    with pytest.raises(UsageError, match=f"--size {size}: must be at least 480x320"):
        _parse_size(size)
    assert _parse_size("480x320") == (480, 320)


def test_a_time_without_the_run_is_refused_and_without_one_the_picture_is_of_its_end() -> None:
    span_s = (-0.08, 12.608)
    assert _choose_time(PictureOptions(), span_s) == 12.608
    assert _choose_time(PictureOptions(at=12.608), span_s) == 12.608
    with pytest.raises(UsageError, match=r"--at 12.61: must be at most 12.608 s"):
        _choose_time(PictureOptions(at=12.61), span_s)
    assert _choose_time(PictureOptions(at=-0.08), span_s) == -0.08
    with pytest.raises(UsageError, match=r"--at -0.09: must be at least -0.080 s"):
        _choose_time(PictureOptions(at=-0.09), span_s)
    assert _choose_time(PictureOptions(at=99.0, timeline="translate_time"), span_s) == 99.0
    assert _choose_time(PictureOptions(), None) is None


@pytest.mark.parametrize(
    ("picture", "line"),
    [
        (PictureOptions(at=3.0), "--at: needs --snapshot NAME.png"),
        (PictureOptions(size="800x600"), "--size: needs --snapshot NAME.png"),
        (PictureOptions(at=math.nan, snapshot=Path("x.png")), "--at nan: must be seconds"),
        (PictureOptions(at=1e9, snapshot=Path("x.png")), "--at 1e.09: must be seconds"),
    ],
)
def test_an_option_that_a_picture_cannot_have_is_named(picture: PictureOptions, line: str) -> None:
    with pytest.raises(UsageError, match=line):
        _require_picture(picture, MovieOptions())


def test_a_time_at_which_a_view_has_nothing_is_refused() -> None:
    _require_inside(13.4, "sim_time", -0.064, 13.4)
    _require_inside(-0.064, "sim_time", -0.064, 13.4)
    for cursor_s in (13.41, -0.07):
        with pytest.raises(ShowError, match=f"at: expected -0.064 to 13.400 s, .* {cursor_s}"):
            _require_inside(cursor_s, "sim_time", -0.064, 13.4)


def test_a_picture_that_shows_nothing_is_one_line_and_no_file(tmp_path: Path) -> None:
    """The first command forks from a process that loads the program."""
    run = tl.simulate_run(get_preset("paper-kp10"))
    tl.write_recording(run, tmp_path / "run.mcap")
    words = ("view", tmp_path / "run.mcap", "--snapshot", tmp_path / "x.png", "--at", "99")
    answer = run_command(*map(str, words), folder=tmp_path)
    assert answer.returncode == 2
    assert answer.stderr.splitlines()[-1].startswith("turtlelog: error: --at 99.0: must be at most")
    assert not (tmp_path / "x.png").exists()


def test_the_view_of_a_bag_has_its_scans_unless_told_not_to(call: Call, tmp_path: Path) -> None:
    bag = write_robot(tmp_path, say_odometry(count=4), say_scan(1.0), say_map([100], 1))
    shown, bare = tmp_path / "shown.rrd", tmp_path / "bare.rrd"
    answer = call("view", bag, "--save", shown)
    assert f"{bag}: Scans of /scan: 1 scan." in answer.err
    assert f"{bag}: Map of /map: 1 x 1 cells of 0.5 m, 1 occupied cell." in answer.err
    assert {"/plane/scan", "/plane/walls", "/plane/map"} <= list_entities(shown)
    assert "Scans of" not in call("view", bag, "--save", bare, "--no-scans").err
    assert not {"/plane/scan", "/plane/walls", "/plane/map"} & list_entities(bare)
