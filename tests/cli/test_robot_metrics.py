"""Bags of a robot in the commands that measure and compare."""

import json
import math
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import turtlelog as tl
from tests.cli.conftest import Call
from tests.cli.step_robots import STEPS, tell_command, tell_odometry, write_robot
from tests.identify.robots import write_bag
from tests.log.ros2.bags import write_mcap
from tests.measure.driven import publish, respond


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_robot(tmp_path_factory.mktemp("robot") / "robot.mcap")


@pytest.fixture(scope="module")
def silent(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_robot(tmp_path_factory.mktemp("silent") / "silent.mcap", commands=False)


def test_jumps_that_a_path_length_contains_are_told_beside_it(
    call: Call, robot: Path, tmp_path: Path
) -> None:
    run = tl.read_run(robot)
    xy_m = run.poses.xy_m + np.where(np.arange(len(run.poses)) < 50, 0.0, 0.3)[:, None]
    leap = write_bag(replace(run, poses=replace(run.poses, xy_m=xy_m)), tmp_path / "leap.mcap")
    told = "1 jump, 0.31 m ahead and 0.3 m to the left at 2.5 s"
    answer = call("metrics", leap)
    assert f"The path length counts as driven: {told}" in answer.flat
    assert answer.out.startswith("leap.mcap: the path is 0.821 m long, 52 % of it jumps, and takes")
    assert call("metrics", leap, "--json").json[0]["jumps"].startswith(told)
    both = call("metrics", robot, leap, "--metric", "run.path_length").flat
    assert f"The path length of leap counts as driven: {told}" in both
    assert call("metrics", robot, "--json").json[0]["jumps"] is None
    assert "jump" not in call("metrics", leap, "--metric", "run.duration").flat


def test_a_jump_is_no_measured_speed(call: Call, tmp_path: Path) -> None:
    table = tmp_path / "poses.csv"
    for leap_m, share in (
        (3.0, " long, 45 % of it jumps,"),
        (0.2, " long, 5 % of it jumps,"),
        (0.18, " long"),
        (0.0, " long"),
    ):
        rows = [f"{i / 50},{0.3 * i / 50 + leap_m * (i >= 500)},0,0" for i in range(600)]
        table.write_text("\n".join(["time,x,y,theta", *rows]), encoding="utf-8")
        answer = call("metrics", table).flat
        assert "largest measured speed 0.3 m/s" in answer
        assert f"m{share} and takes 12 s." in answer


@pytest.mark.parametrize(
    ("gap_s", "first", "told"),
    [
        (20.0, " and takes 40 s, 20 s of it without poses.", "20 s"),
        (0.5, " and takes 40 s.", "0.5 s"),
        (0.15, " and takes 40 s.", None),
    ],
)
def test_time_without_poses_is_told_and_left_out(
    gap_s: float, first: str, told: str | None, call: Call, tmp_path: Path
) -> None:
    times = [i / 50 for i in range(2001) if not 10.0 < i / 50 < 10.0 + gap_s]
    rows = [f"{t},{0.3 * t - 0.3 * gap_s * (t > 10.0)},0,0" for t in times]
    table = tmp_path / "poses.csv"
    table.write_text("\n".join(["time,x,y,theta", *rows]), encoding="utf-8")
    answer = call("metrics", table).flat
    assert first in answer
    assert "share of the time at rest 0 %" in answer
    said = f"Rates and rest leave out {told} without poses; the path length counts a straight line"
    assert (said in answer) is (told is not None)
    gaps = call("metrics", table, "--json").json[0]["gaps"]
    assert gaps == (None if told is None else f"{said} there.")


def test_repeated_poses_are_told(call: Call, tmp_path: Path) -> None:
    table = tmp_path / "poses.csv"
    for each, told in ((5, "repeat the one before"), (1, None)):
        rows = [f"{i / 50},{0.3 * (i // each * each) / 50:.6f},0,0" for i in range(600)]
        table.write_text("\n".join(["time,x,y,theta", *rows]), encoding="utf-8")
        for command in ("info", "metrics"):
            answer = call(command, table).flat
            assert ("repeat the one before" in answer) is (told is not None)
            assert ("change at 10 Hz" in answer) is (told is not None)


@pytest.mark.parametrize(
    ("noise_m", "period_s", "told"),
    [
        ((0.02, 0.02), 0.02, "17.3 m long, 3 m through the median of each second, and takes"),
        ((0.001, 0.001), 0.02, "3.07 m long and takes"),  # driven are 2.99 m
        ((0.1, 0.1), 0.2, "8.33 m long, 3.2 m through the median of each second, and takes"),
        ((0.1, 0.0), 0.2, "4.84 m long and takes"),  # a robot itself may turn round within 0.4 s
    ],
)
def test_a_path_that_noise_lengthens_is_told_without_it(
    noise_m: tuple[float, float], period_s: float, told: str, call: Call, tmp_path: Path
) -> None:
    time_s = np.arange(0.0, 10.0, period_s)
    random = np.random.default_rng(0)
    noise = random.normal(0.0, 1.0, (2, len(time_s))) * np.array(noise_m)[:, None]
    x_m, y_m = np.array([[0.3], [0.0]]) * time_s + noise
    rows = [f"{t:.3f},{x:.6f},{y:.6f},0" for t, x, y in zip(time_s, x_m, y_m, strict=True)]
    table = tmp_path / "poses.csv"
    table.write_text("\n".join(["time,x,y,theta", *rows]), encoding="utf-8")
    answer = call("metrics", table).flat
    assert f"the path is {told}" in answer
    said = "The path length counts steps back and forth between poses, as from noise; through the"
    assert (said in answer) is ("median" in told)
    rates = "differences of poses, and contain their noise: about"
    assert (rates in answer) is (noise_m[1] > 0.0)
    assert (call("metrics", table, "--json").json[0]["scatter"] is None) is ("median" not in told)


@pytest.mark.parametrize(("rate_hz", "rest"), [(1.0, "0 %"), (0.0, "100 %")])
def test_a_robot_that_swings_does_not_rest_when_it_is_back(
    rate_hz: float, rest: str, call: Call, tmp_path: Path
) -> None:
    time_s = np.arange(0.0, 20.0, 0.05)
    x_m = 0.3 * np.sin(2.0 * np.pi * rate_hz * time_s)
    rows = [f"{t:.3f},{x:.6f},0,0" for t, x in zip(time_s, x_m, strict=True)]
    table = tmp_path / "poses.csv"
    table.write_text("\n".join(["time,x,y,theta", *rows]), encoding="utf-8")
    answer = call("metrics", table).flat
    assert f"share of the time at rest {rest}" in answer
    assert "judged over half a second" not in answer


@pytest.mark.parametrize("digits", [3, 6])
def test_a_resolution_of_poses_is_told_in_json_too(digits: int, call: Call, tmp_path: Path) -> None:
    rows = [f"{i / 50},{0.137 * i / 50:.{digits}f},0,0" for i in range(500)]
    table = tmp_path / "poses.csv"
    table.write_text("\n".join(["time,x,y,theta", *rows]), encoding="utf-8")
    (answer,) = call("metrics", table, "--json").json
    assert ((answer["resolution"] or "").partition(" (")[0], answer["leads"]) == (
        "Poses have a resolution of 1 mm" if digits == 3 else "",
        None,
    )


@pytest.mark.parametrize(("speed_m_s", "crept"), [(0.001, "0.1 m"), (0.02, None)])
def test_motion_that_counts_as_rest_is_told(
    speed_m_s: float, crept: str | None, call: Call, tmp_path: Path
) -> None:
    rows = [f"{i / 50},{speed_m_s * i / 50:.6f},0,0" for i in range(0, 5001, 5)]
    table = tmp_path / "poses.csv"
    table.write_text("\n".join(["time,x,y,theta", *rows]), encoding="utf-8")
    rest = call("metrics", table, "--json").json[0]["rest"]
    said = f"Rest, judged over half a second, includes {crept} of slow or brief motion."
    assert rest == (None if crept is None else said)
    assert (said in call("metrics", table).flat) is (crept is not None)


def test_a_pose_that_strays_and_returns_is_told_as_steps_back_and_forth(
    call: Call, tmp_path: Path
) -> None:
    rows = [f"{i / 50},{0.3 * i / 50},{5.0 * (i % 30 == 7)},0" for i in range(600)]
    table = tmp_path / "poses.csv"
    table.write_text("\n".join(["time,x,y,theta", *rows]), encoding="utf-8")
    answer = call("metrics", table).flat
    assert (
        "is 203 m long, 98 % of it jumps, 3.59 m through the median of each second, and takes 12 s"
        in answer
    )
    assert "steps back and forth between poses" in answer
    five = call("metrics", *[table] * 5).flat
    assert five.count("counts steps back and forth between poses") == 3
    assert "Gaps, jumps or steps are in 2 more runs, too." in five


@pytest.mark.parametrize(("align", "largest"), [(None, 0.0), ("first_sample", 0.2)])
def test_two_topics_of_one_bag_share_its_clock(
    align: str | None, largest: float, call: Call, tmp_path: Path
) -> None:
    """Their first poses are 2 ms apart, so that from them on, equal commands differ at steps."""
    time_s = np.arange(0.0, 5.0, 0.05)
    rates, ways = respond(time_s, STEPS, 0.1)
    said = [tell_odometry(*row) for row in zip(time_s, rates, ways, strict=True)]
    said += [replace(one, topic="/mocap", time_ns=one.time_ns + 2_000_000) for one in said]
    at_s, values = publish([(0.5, 0.0), *STEPS], 4.5)
    said += [tell_command(*row) for row in zip(at_s, values, strict=True)]
    bag = tmp_path / "two.mcap"
    write_mcap(bag, sorted(said, key=lambda one: one.time_ns))
    asked = [] if align is None else ["--align", align]
    topics = [f"{bag}:/mocap", "--reference", f"{bag}:/odom", *asked]
    answer = call("compare", *topics, "--json").json
    assert answer["alignment"] == (align or "recorded")
    signals = {one["signal"]: one["largest"] for one in answer["runs"][0]["signals"]}
    assert signals["speed"] == pytest.approx(largest, abs=1e-9)


def test_the_table_of_a_bag_shows_what_it_has_and_what_would_add_more(
    call: Call, robot: Path
) -> None:
    answer = call("metrics", robot)
    lines = answer.out.splitlines()
    assert answer.code == 0
    assert lines[0] == "robot.mcap: the path is 0.4 m long and takes 4.95 s."
    assert "absent" not in answer.out
    for name in ("path length", "speed lag", "speed rise time", "share of the time at rest"):
        assert f"\n{name} " in answer.out
    assert "Measured rates are those that the robot reports." in lines
    assert "No goal: --goal X,Y adds final.position_error and run.time_to_goal." in lines
    assert "No samples of a controller" in answer.out
    assert "No commands" not in answer.out
    assert f"Dead time and time constants: turtlelog identify {robot}" in lines
    assert len(lines) <= 40
    assert max(map(len, [line for line in lines if str(robot) not in line])) <= 80


def test_advised_commands_repeat_the_options_for_reading(call: Call, robot: Path) -> None:
    """Takes some 3 s: the robot is identified."""
    reading = ["--time=log", "--goal=-1,2"]
    *_, identify, measure = call("metrics", robot, *reading).out.splitlines()
    assert identify.endswith(f": turtlelog identify {robot} --time=log")  # it takes no goal
    assert measure.endswith(f": turtlelog metrics {robot} --time=log --goal=-1,2 --all")
    answer = call(*shlex.split(identify.partition(": turtlelog ")[2]))
    assert answer.code != 2


def test_a_table_without_commands_names_the_option_that_reads_them(
    call: Call, tmp_path: Path
) -> None:
    rows = [f"{t / 10},{t / 20},0,0,0.5" for t in range(40)]
    table = tmp_path / "drive.csv"
    table.write_text("\n".join(["t,x,y,yaw,v_ref", *rows, ""]))
    words = " ".join(call("metrics", table).out.split())
    assert "No commands: a column of set-points (--column command_speed=NAME, command_tu" in words
    assert "--command-topic" not in words
    words = call("metrics", table, "--column", "command_speed=v_ref").out
    assert "No commands" not in words
    assert "RMS error of the speed" in words


def test_the_table_of_a_bag_without_commands_says_what_would_add_them(
    call: Call, silent: Path
) -> None:
    words = " ".join(call("metrics", silent).out.split())
    assert "speed lag" not in words
    assert "No commands: a recorded Twist or TwistStamped (--command-topic TOPIC) adds" in words
    assert "turtlelog identify" not in words
    assert "absent" in call("metrics", silent, "--all").out


def test_a_bag_with_a_goal_ends_that_far_from_it(call: Call, robot: Path) -> None:
    assert call("metrics", robot, "--goal", "1,0").out.startswith(
        "robot.mcap: ended 0.6 m from the goal after 4.95 s.\n"
    )


def test_json_and_csv_hold_every_metric_of_a_bag(call: Call, robot: Path) -> None:
    (found,) = call("metrics", robot, "--json").json
    assert [one["id"] for one in found["metrics"]] == list(
        tl.measure.list_metrics(tl.Declaration())
    )
    status = {one["id"]: one["status"] for one in found["metrics"]}
    assert (status["final.position_error"], status["run.speed_lag"]) == ("absent", "ok")


def test_a_bag_beside_a_recording_has_the_rows_of_both(call: Call, robot: Path, kp4: Path) -> None:
    rows = {
        words[0]: words[2:]
        for line in call("metrics", robot, kp4, "--markdown").out.splitlines()
        if (words := line.strip("| ").split(" | ")) and "." in words[0]
    }
    assert set(rows["run.path_length"]).isdisjoint({"-", "absent"})
    assert set(rows["run.speed_lag"]).isdisjoint({"-", "absent"})
    assert "-" in rows["rotate.overshoot"]
    assert "absent" in rows["final.position_error"]
    assert rows.keys() > set(tl.measure.list_essential_metrics(tl.read_run(kp4)))


def test_the_table_of_a_recording_alone_is_that_of_its_law(call: Call, kp4: Path) -> None:
    out = call("metrics", kp4, "--markdown").out
    rows = [line.strip("| ").split(" | ")[0] for line in out.splitlines() if "." in line[:20]]
    assert rows == [*tl.measure.list_essential_metrics(tl.read_run(kp4).declaration)]


def test_bags_are_compared_by_what_they_have(
    call: Call, robot: Path, silent: Path, kp4: Path
) -> None:
    out = call("compare", robot, silent).out
    assert out.startswith("2 runs: goal is not known of every run, so nothing is called best.\n")
    assert "position" not in out.split("No goal")[0]
    assert "measured" in out
    assert len(out.splitlines()) <= 40
    assert max(map(len, out.splitlines())) <= 80
    mixed = call("compare", robot, kp4).out
    assert "rotate" in mixed
    assert "measured" in mixed


def test_a_bag_against_a_reference_is_told_how_far_off_its_path_it_is(
    call: Call, robot: Path, tmp_path: Path
) -> None:
    slower = write_robot(tmp_path / "slower.mcap", gain=0.5)
    answer = call("compare", "--reference", robot, slower)
    told = " ".join(answer.out.split())
    # It stays on the line that the reference drove, and falls back by half of 0.4 m.
    assert told.startswith("slower stays on the path of robot, within 1e-9 m.")
    assert "slower: at equal times up to 0.2 m apart" in told
    found = call("compare", "--reference", robot, slower, "--json").json["runs"][0]["path_error"]
    assert found["largest_m"] == pytest.approx(0.0, abs=1e-12)
    assert found["largest_apart_m"] == pytest.approx(0.2, abs=1e-4)
    assert 0.0 < found["rms_apart_m"] < 0.2


def test_a_recording_against_a_bag_has_values_of_both(call: Call, robot: Path, kp4: Path) -> None:
    for pair in ((robot, kp4), (kp4, robot)):
        table = call("compare", "--reference", *pair).out.split("Largest differences")[0]
        (row,) = (line for line in table.splitlines() if line.startswith("paper-kp4  "))
        assert row.split().count("-") == 0


def test_metrics_of_a_bag_are_asked_for_in_tests(robot: Path) -> None:
    recording = tl.check.Recording(robot)
    assert recording.metric("run.path_length") == pytest.approx(0.4, abs=1e-3)
    lag = recording.metric("run.speed_lag")
    assert lag <= 0.1
    assert lag == pytest.approx(0.1 * math.log(2.0), abs=0.02)
    with pytest.raises(tl.errors.MissingValueError, match="the goal is not known"):
        assert recording.metric("final.position_error") <= 1.0
    with pytest.raises(
        tl.TurtlelogError, match=r'"run\.path_lenght"; did you mean run\.path_length\?'
    ):
        recording.metric("run.path_lenght")


def test_a_bag_has_no_json_that_is_not_json(call: Call, silent: Path) -> None:
    json.loads(call("metrics", silent, "--json").out, parse_constant=lambda _: pytest.fail("NaN"))


@pytest.mark.parametrize("rates", [("v",), ("w",), ("v", "w")], ids="+".join)
def test_a_rate_that_is_not_reported_is_told_as_a_difference(
    rates: tuple[str, ...], call: Call, tmp_path: Path
) -> None:
    table = tmp_path / "poses.csv"
    rows = [
        f"{i / 20},{i / 20},0,0{',1' if 'v' in rates else ''}{',0' * ('w' in rates)}"
        for i in range(40)
    ]
    table.write_text("\n".join([f"time,x,y,theta,{','.join(rates)}", *rows]), encoding="utf-8")
    said = "Measured rates are those that the robot reports"
    other = {"v": "; the turn rate is", "w": "; the speed is"}.get("".join(rates))
    said += "." if other is None else f"{other} a difference of poses."
    assert said in call("metrics", table).flat
