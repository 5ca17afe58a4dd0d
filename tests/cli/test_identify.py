import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import RrdReader

import turtlelog as tl
from tests.cli.conftest import Call
from tests.draw.rerun.rrds import read_blueprint_parts
from tests.identify.robots import Log, Truth, make_run, write_bag
from tests.log.ros2.bags import make_poses, write_mcap
from tests.log.runs import find_shared
from turtlelog.identify import AxisModel, Estimate

LOG = Log(
    speed=Truth(gain=0.9, dead_time_s=0.08, lag_s=0.12),
    turn_rate=Truth(gain=0.95, dead_time_s=0.06, lag_s=0.1),
    duration_s=20.0,
    poses_hz=20.0,
    commands_hz=10.0,
)
"""A robot of known truth."""

KEYS = {"files", "clock", "axes", "tick_delays", "events", "notes", "scenario"}
VALUES = {
    "speed": {"gain": 0.9, "dead_time_s": 0.08, "lag_s": 0.12, "total_delay_s": 0.2},
    "turn_rate": {"gain": 0.95, "dead_time_s": 0.06, "lag_s": 0.1, "total_delay_s": 0.16},
}


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_bag(make_run(LOG, 6), tmp_path_factory.mktemp("bag") / "robot.mcap")


def test_identify_finds_a_robot_of_known_truth(call: Call, bag: Path) -> None:
    answer = call("identify", bag, "--json").json
    assert answer.keys() == KEYS
    assert answer["files"] == [str(bag)]
    assert [axis["axis"] for axis in answer["axes"]] == ["speed", "turn_rate"]
    for axis in answer["axes"]:
        assert (axis["status"], axis["model"], axis["reason"]) == ("ok", "first_order", None)
        for name, truth in VALUES[axis["axis"]].items():
            assert axis[name].keys() == {"value", "low", "high"}
            assert axis[name]["low"] <= truth <= axis[name]["high"]
        assert 0.9 < axis["explained"] < 1.0
        assert 0.7 < axis["whiteness"] < 1.3
        assert axis["outliers"] == 0


def test_the_first_line_is_how_late_the_robot_follows(call: Call, bag: Path) -> None:
    text = call("identify", bag, "--time=log").out
    lines = text.splitlines()
    first = (
        r"robot\.mcap: total delay of speed ([\d.]+) ms \(.*\),"
        r" of turn rate ([\d.]+) ms \(.*\)\. Gains: speed 0\.\d+, turn rate 0\.\d+\."
    )
    found = re.match(first, " ".join(lines[:3]))
    assert found is not None
    assert (round(float(found[1]), -1), round(float(found[2]), -1)) == (200, 160)
    assert "axis" in {line.split("  ")[0] for line in lines[3:5]}
    words = " ".join(text.split())
    assert re.search(
        r"The robot drives at 90(\.\d)? % of the commanded speed and turns at 9", words
    )
    assert "correlate" not in text
    detailed = " ".join(call("identify", bag, "--details").out.split())
    assert "commands and motion correlate best at" in detailed
    assert f"identify {bag} --time=log --scenario robot.toml" in words
    assert lines[-1] == "A second opinion on the delays: --details"
    assert len(lines) <= 40
    assert max(map(len, [line for line in lines if str(bag) not in line])) <= 80


def test_the_text_has_what_to_paste_into_nav2(call: Call, bag: Path) -> None:
    lines = call("identify", bag).out.splitlines()
    delays = dict(line.split() for line in lines if line.startswith("  model_delay"))
    assert round(float(delays["model_delay_vx:"]), 2) == 0.2
    assert round(float(delays["model_delay_wz:"]), 2) == 0.16


@pytest.mark.parametrize(
    ("gain", "low", "high", "words"),
    [
        (1.0, 1.0, 1.0, "turns at the commanded rate"),
        (1.0004, 0.9999, 1.0009, "turns at the commanded rate"),
        (1.0005, 0.999, 1.0011, "turns at the commanded rate to within 0.11 %"),
        (1.015, 0.969, 1.062, "turns at the commanded rate to within 6.2 %"),
        (0.9, 0.88, 0.92, "turns at 90 % of the commanded rate"),
        (0.972, 0.96, 0.99, "turns at 97.2 % of the commanded rate"),
    ],
)
def test_what_the_robot_does_is_as_exact_as_its_interval(
    gain: float, low: float, high: float, words: str
) -> None:
    from turtlelog.cli.identify import describe_gain

    estimate = Estimate(value=gain, low=low, high=high, unit="1")
    assert describe_gain(AxisModel(axis="turn_rate", status="ok", gain=estimate)) == words


def test_an_axis_without_a_value_has_a_reason_and_what_to_drive(call: Call, tmp_path: Path) -> None:
    run = make_run(LOG, 6)
    still = replace(run.commands, speed_m_s=np.zeros(len(run.commands)))
    bag = write_bag(replace(run, commands=still), tmp_path / "turns.mcap")
    answer = call("identify", bag)
    text = " ".join(answer.out.split())
    assert answer.code == 0
    assert text.startswith("turns.mcap: total delay of turn rate ")
    assert "The speed could not be identified." in text
    assert (
        "Speed: not identifiable: the speed is never commanded. To know it, step the speed ten"
        " times for 2 s."
    ) in text
    assert "model_delay_vx" not in text
    speed = call("identify", bag, "--json").json["axes"][0]
    assert speed["status"] == "not_identifiable"
    assert {speed[name] for name in ("gain", "dead_time_s", "lag_s", "total_delay_s")} == {None}


def test_a_table_without_a_column_of_commands_asks_for_the_column(
    call: Call, tmp_path: Path
) -> None:
    rows = [f"{row / 10},{row / 20},0,0,{row % 3}" for row in range(30)]
    path = tmp_path / "drive.csv"
    path.write_text("\n".join(["t,x,y,yaw,v_ref", *rows]), "utf-8")
    text = " ".join(call("identify", path).out.split())
    assert "no column of the table is read as the commanded speed. To know it, name that" in text
    missing = call("info", path, "--json").json[0]["missing"]
    assert "--column command_speed='v_ref'" in missing[0]


@pytest.mark.parametrize("options", [[], ["--json"]], ids=["text", "json"])
def test_without_any_axis_the_answer_is_no(call: Call, tmp_path: Path, options: list[str]) -> None:
    answer = call("identify", write_mcap(tmp_path / "poses.mcap", make_poses()), *options)
    assert answer.code == 1
    assert "no commands were recorded" in answer.out
    if not options:
        assert answer.out.startswith("poses.mcap: no axis could be identified.\n")
        assert "\n\n" not in answer.out


@pytest.mark.thorough
def test_several_bags_are_one_robot(call: Call, bag: Path, tmp_path: Path) -> None:
    other = write_bag(make_run(LOG, 7), tmp_path / "other.mcap")
    answer = call("identify", bag, other, "--json").json
    assert answer["files"] == [str(bag), str(other)]
    alone = call("identify", bag, "--json").json
    width, width_alone = (
        [axis["gain"]["high"] - axis["gain"]["low"] for axis in found["axes"]]
        for found in (answer, alone)
    )
    assert all(together < one for together, one in zip(width, width_alone, strict=True))
    assert call("identify", bag, other).out.startswith("2 runs of one robot: total delay of speed")


@pytest.mark.thorough
def test_a_figure_of_one_robot_is_drawn(call: Call, bag: Path, tmp_path: Path) -> None:
    answer = call("identify", bag, "--plot", tmp_path / "robot.svg")
    assert answer.code == 0
    assert "robot.svg" in answer.err
    assert (tmp_path / "robot.svg").read_bytes().startswith(b"<?xml")


def test_without_a_model_the_exit_code_is_1_and_the_motion_is_drawn(
    call: Call, tmp_path: Path
) -> None:
    held = make_run(LOG, 6)
    commands = held.commands
    same = {"speed_m_s": 0.2, "turn_rate_rad_s": 0.3}
    constant = {name: value + 0.0 * getattr(commands, name) for name, value in same.items()}
    bag = write_bag(replace(held, commands=replace(commands, **constant)), tmp_path / "held.mcap")
    asked = ["--plot", tmp_path / "held.svg", "--rrd", tmp_path / "held.rrd"]
    answer = call("identify", bag, *asked)
    assert answer.code == 1
    assert "motion" in (tmp_path / "held.svg").read_text()
    assert "held.rrd is not written: no axis was identified" in answer.err
    assert not (tmp_path / "held.rrd").exists()


def test_a_view_holds_command_motion_model_and_residual(
    call: Call, bag: Path, tmp_path: Path
) -> None:
    assert call("identify", bag, "--rrd", tmp_path / "robot.rrd").code == 0
    entities = {chunk.entity_path for chunk in RrdReader(tmp_path / "robot.rrd").stream()}
    names = ("commanded", "measured", "modelled", "residual")
    assert {f"/{axis}/{name}" for axis in VALUES for name in names} <= entities
    ranges = read_blueprint_parts(tmp_path / "robot.rrd", "TimeAxis:view_range")
    assert {"start": None, "end": None} in ranges  # all there is, wherever the cursor stands


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["--plot", "robot.txt"], "the name must end in .pdf, .png or .svg"),
        (["again.mcap", "--rrd", "robot.rrd"], "--rrd: draws one file, not 2"),
        (["--rrd", "robot.svg"], "the name must end in .rrd"),
        (["again.mcap", "--plot", "robot.svg"], "--plot: draws one file, not 2"),
    ],
    ids=["suffix", "two files in a view", "suffix of a view", "two files"],
)
def test_a_figure_that_cannot_be_drawn_is_one_line(
    call: Call, bag: Path, words: list[str], line: str
) -> None:
    answer = call("identify", bag, *words)
    assert (answer.code, answer.out, answer.err.count("\n")) == (2, "", 1)
    assert line in answer.err


def test_two_runs_of_turtlesim_are_explained_one_by_one(call: Call, kp4: Path, kp10: Path) -> None:
    last = call("identify", kp4, kp10).out.splitlines()[-1]
    assert last == f"Why? turtlelog explain {kp4}"


def test_turtlesim_tells_its_dead_time_in_ticks(call: Call, kp10: Path) -> None:
    answer = call("identify", kp10, "--json").json
    delays = answer["tick_delays"]
    assert (delays["least_s"], delays["median_s"], delays["largest_s"]) == (0.016, 0.112, 0.112)
    text = call("identify", kp10).out
    told = "kp10.mcap: total delay of speed 96 ms (0 to 96), of turn rate 64 ms"
    assert text.startswith(told)
    assert "In brackets: the least and the largest." in " ".join(text.split())
    assert "least 16.0 ms, median 112.0 ms, largest 112.0 ms" in " ".join(text.split())
    assert text.splitlines()[-1] == f"Why? turtlelog explain {kp10}"


def test_a_bag_of_turtlesim_without_samples_has_no_command_that_explains_it(call: Call) -> None:
    lines = call("identify", find_shared("ros2", "turtlesim_jazzy")).out.splitlines()
    assert lines[-1].startswith("  model_delay_wz: ")


def test_without_files_and_with_none_that_can_be_read_it_says_so(call: Call) -> None:
    answer = call("identify")
    assert (answer.code, answer.out) == (2, "")
    answer = call("identify", "nothing.mcap")
    assert answer.code == 2
    assert answer.err.count("\n") == 1
    assert "nothing.mcap" in answer.err


def test_what_times_poses_is_told_beside_delays_alone(call: Call, bag: Path) -> None:
    said = "Poses are timed by their stamps"
    assert said in call("identify", find_shared("robots", "tb3")).out
    # Its stamps are a simulation's, and it has no commands.
    assert said not in call("identify", find_shared("robots", "amcl_pose")).out
    assert said not in call("identify", bag).out


def test_outliers_are_named_one_by_one_unless_they_are_many(call: Call, tmp_path: Path) -> None:
    run = make_run(LOG, 6)
    poses = run.poses
    along = np.column_stack([np.cos(poses.heading_rad), np.sin(poses.heading_rad)])

    def tell(jumps: int) -> tuple[int, int, str]:
        size_m = np.zeros(len(along))
        size_m[50 : 50 + 30 * jumps : 30] = 0.3
        xy_m = poses.xy_m + np.cumsum(size_m[:, None] * along, axis=0)
        faulty = write_bag(replace(run, poses=replace(poses, xy_m=xy_m)), tmp_path / "jumps.mcap")
        speed = call("identify", faulty, "--json").json["axes"][0]
        return speed["outliers"], speed["steps"], " ".join(call("identify", faulty).out.split())

    outliers, steps, text = tell(3)
    assert (outliers, outliers <= 0.01 * steps, text.count("Outlier:")) == (3, True, 3)
    outliers, steps, text = tell(5)
    assert (outliers, outliers > 0.01 * steps, text.count("Outlier:")) == (5, True, 0)
    assert f"Speed: 5 of {steps} steps are off by far more than is usual" in text


@pytest.mark.parametrize(("least_s", "is_told"), [(0.0, True), (0.001, False)])
def test_a_sum_that_the_log_does_not_divide_is_told(least_s: float, *, is_told: bool) -> None:
    from turtlelog.cli.identify import format_robot

    part = Estimate(value=0.1, low=0.0, high=0.2)
    axis = AxisModel(
        axis="speed",
        status="ok",
        gain=Estimate(value=1.0, low=0.9, high=1.1),
        dead_time_s=part,
        lag_s=Estimate(value=0.1, low=least_s, high=0.2),
        total_delay_s=Estimate(value=0.2, low=0.19, high=0.21),
        explained=0.9,
        steps=100,
    )
    unknown = AxisModel(axis="turn_rate", status="not_identifiable", reason="it never turns")
    model = tl.RobotModel(files=("bag",), speed=axis, turn_rate=unknown)
    words = " ".join(format_robot(model, [Path("bag")]).split())
    assert ("does not separate dead time from time constant" in words) == is_told
