"""The recorder's clock, and that of the robot with it, is set while a bag is recorded."""

import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.cli.conftest import Call, call as call
from tests.log.ros2.bags import START_NS, Said, make_vector, write_mcap, write_sqlite
from turtlelog import read_bag
from turtlelog.log import read_trajectory
from turtlelog.log.read_choice import CLOCK_SET
from turtlelog.run import Run

STEP_S, SPEED_M_S = 0.02, 0.5


def drive(
    shift_s: float,
    *,
    at_s: float = 4.0,
    speed_m_s: float = SPEED_M_S,
    pause_s: float = 0.0,
    has_stamps: bool = True,
    jumps_stamps: bool = True,
    command_s: float = 0.1,
    step_s: float = STEP_S,
    noise_m: float = 0.0,
    begin_s: float = 0.0,
    radius_m: float = 1.25,
) -> list[Said]:
    """Return 10 s on a circle, in order of arrival, by a clock that is set at `at_s`.

    After that the robot drives for `pause_s` without being recorded. Commands begin at `begin_s`.
    """
    said, random = list[tuple[float, Said]](), np.random.default_rng(1)
    for row in range(round(10.0 / step_s) + 1):
        time_s = row * step_s
        true_s = time_s + pause_s * (time_s >= at_s)
        shift = (shift_s + pause_s) * (time_s >= at_s)
        angle_rad = speed_m_s * true_s / radius_m
        x_m, y_m = radius_m * math.sin(angle_rad), radius_m * (1.0 - math.cos(angle_rad))
        place = make_vector(x_m + random.normal(0.0, noise_m), y_m + random.normal(0.0, noise_m))
        turn = {"z": math.sin(angle_rad / 2), "w": math.cos(angle_rad / 2)}
        pose = {"position": place, "orientation": make_vector() | turn}
        stamp_ns = START_NS + round(1e9 * (time_s + shift * jumps_stamps)) if has_stamps else 0
        stamp = {"sec": stamp_ns // 10**9, "nanosec": stamp_ns % 10**9}
        values = {"header": {"stamp": stamp, "frame_id": "map"}, "pose": pose}
        kind = "geometry_msgs/msg/PoseStamped"
        log_ns = START_NS + round(1e9 * (time_s + shift + 0.002))
        said.append((time_s, Said(topic="/pose", type=kind, values=values, time_ns=log_ns)))
    for number in range(round(10.0 / command_s)):
        time_s = begin_s + number * command_s + 0.005
        shift = (shift_s + pause_s) * (time_s >= at_s)
        values = {"linear": make_vector(speed_m_s), "angular": make_vector(z=number / 1e3)}
        log_ns = START_NS + round(1e9 * (time_s + shift))
        kind = "geometry_msgs/msg/Twist"
        said.append((time_s, Said(topic="/cmd_vel", type=kind, values=values, time_ns=log_ns)))
    return [one for _, one in sorted(said, key=lambda pair: pair[0])]


def read(folder: Path, messages: Iterable[Said]) -> Run:
    return read_bag(write_mcap(folder / "bag.mcap", messages))


def require_whole_poses(run: Run) -> None:
    """Require the poses of the drive by a clock that was never set."""
    assert len(run.poses) == 501
    assert np.diff(run.poses.time_ns) / 1e9 == pytest.approx(STEP_S, abs=1e-6)
    steps_m = np.hypot(*np.diff(run.poses.xy_m, axis=0).T)
    assert steps_m == pytest.approx(SPEED_M_S * STEP_S, rel=1e-3)


def require_whole(run: Run) -> None:
    """Require that the run is the drive by a clock that was never set."""
    require_whole_poses(run)
    # The numbers of commands, and that each is within a pose's step of its true time.
    true_s = np.rint(1e3 * run.commands.turn_rate_rad_s) * 0.1
    assert (np.diff(true_s) > 0.0).all()
    shift_s = run.commands.time_ns / 1e9 - true_s
    assert np.ptp(shift_s) < 1e-6


@pytest.mark.parametrize("write", [write_mcap, write_sqlite])
@pytest.mark.parametrize(
    ("shift_s", "words"),
    [
        (-3.7, "back by 3.70 s at 4.0 s, as messages are stored in order of arrival; "),
        (-3600.0, "back by 3600 s at 4.0 s, as messages are stored in order of arrival; "),
        (3.7, "forward by 3.70 s at 4.0 s, as motion or stamps go on without a break ("),
        (259200.0, "forward by 259200 s at 4.0 s, as motion or stamps go on without a break ("),
    ],
)
@pytest.mark.parametrize("has_stamps", [True, False])
def test_a_clock_that_was_set_is_taken_out_and_named(
    tmp_path: Path, write: Callable[..., Path], shift_s: float, words: str, *, has_stamps: bool
) -> None:
    path = tmp_path / ("bag.mcap" if write is write_mcap else "bag.db3")
    run = read_bag(write(path, drive(shift_s, has_stamps=has_stamps)))
    require_whole(run)
    assert run.notes[CLOCK_SET].startswith(f"the recorder's clock was set {words}")
    if has_stamps:
        assert run.notes["clock"].startswith("poses are timed by their stamps + 0.002 s")
        assert "their clock was set 1 time" in run.notes["clock"]


def test_a_clock_is_set_twice(tmp_path: Path) -> None:
    messages = drive(-3.7)
    late = [one for one in drive(259200.0, at_s=7.0) if one.time_ns > START_NS + 10**14]
    run = read(tmp_path, messages[: -len(late)] + late)
    require_whole(run)
    assert "back by 3.70 s at 4.0 s and forward by 259204 s at 7.0 s" in run.notes[CLOCK_SET]


def test_the_clock_of_the_longest_segment_counts(tmp_path: Path) -> None:
    run = read(tmp_path, drive(259200.0))
    assert run.notes["original_timestamp"].startswith("2023-11-17")
    run = read(tmp_path, drive(259200.0, at_s=6.0))
    assert run.notes["original_timestamp"].startswith("2023-11-14")


@pytest.mark.parametrize("at_s", [4.0, 6.0])
def test_rare_messages_stay_on_their_side_of_a_step(tmp_path: Path, at_s: float) -> None:
    # One command in 5 s: its topic does not step back by 3.7 s.
    run = read(tmp_path, drive(-3600.0, at_s=at_s, command_s=5.0))
    assert np.diff(run.commands.time_ns) / 1e9 == pytest.approx(5.0, abs=1e-6)


@pytest.mark.parametrize("shift_s", [-0.6, -1.0, -2.5])
@pytest.mark.parametrize("write", [write_mcap, write_sqlite])
@pytest.mark.parametrize("begin_s", [0.0, 0.2, 0.7, 0.995])
def test_rare_messages_are_divided_as_they_are_stored(
    tmp_path: Path, write: Callable[..., Path], shift_s: float, begin_s: float
) -> None:
    # Set back by less than the second between two commands, their times go on.
    messages = drive(shift_s, at_s=5.0, command_s=1.0, begin_s=begin_s)
    path = tmp_path / ("bag.mcap" if write is write_mcap else "bag.db3")
    run = read_bag(write(path, messages))
    assert len(run.commands) == 10
    assert np.diff(run.commands.time_ns) / 1e9 == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize(("pause_s", "is_set"), [(0.03, True), (0.05, False), (3.7, False)])
def test_a_robot_that_drove_on_in_a_silence_shows_that_time_passed(
    tmp_path: Path, pause_s: float, *, is_set: bool
) -> None:
    # A step of up to three usual ones counts as none: two of them are 0.04 s.
    run = read(tmp_path, drive(3.7 - pause_s, pause_s=pause_s))
    assert (CLOCK_SET in run.notes) == is_set
    assert (run.poses.time_ns[-1] / 1e9 < 11.0) == is_set


@pytest.mark.parametrize(("shift_s", "is_set"), [(0.45, False), (0.55, True)])
def test_a_step_forward_of_half_a_second_counts(
    tmp_path: Path, shift_s: float, *, is_set: bool
) -> None:
    assert (CLOCK_SET in read(tmp_path, drive(shift_s)).notes) == is_set


@pytest.mark.parametrize(("shift_s", "is_set"), [(1.75, False), (1.85, True)])
def test_a_silence_of_ten_slow_steps_counts(
    tmp_path: Path, shift_s: float, *, is_set: bool
) -> None:
    # With the usual step of 0.2 s, silences of 1.95 s and 2.05 s.
    run = read(tmp_path, drive(shift_s, step_s=0.2, at_s=3.999, command_s=2.0))
    assert (CLOCK_SET in run.notes) == is_set


@pytest.mark.parametrize(("noise_m", "is_set"), [(0.003, True), (0.03, False)])
def test_noise_larger_than_a_step_hides_whether_the_robot_drives_on(
    tmp_path: Path, noise_m: float, *, is_set: bool
) -> None:
    assert (CLOCK_SET in read(tmp_path, drive(3.7, noise_m=noise_m)).notes) == is_set


@pytest.mark.parametrize("topic", ["/cmd_vel", "/battery"])
def test_any_message_in_a_silence_shows_that_time_passed(tmp_path: Path, topic: str) -> None:
    messages = drive(3.7)
    command = next(one for one in messages if one.topic == "/cmd_vel")
    within = replace(command, topic=topic, time_ns=START_NS + 6 * 10**9)
    messages = sorted([*messages, within], key=lambda one: one.time_ns)
    assert CLOCK_SET not in read(tmp_path, messages).notes
    found: Any = read_trajectory(tmp_path / "bag.mcap")
    assert np.ptp(found.time_ns) / 1e9 == pytest.approx(13.7)


@pytest.mark.parametrize(
    ("speed_m_s", "radius_m", "is_set"),
    [(0.6, 10.0, True), (0.65, 10.0, False), (0.12, 0.25, True), (0.13, 0.25, False)],
)
def test_poses_that_may_come_by_way_show_no_set_clock(
    tmp_path: Path, speed_m_s: float, radius_m: float, *, is_set: bool
) -> None:
    # At 5 Hz a way of 0.12 or 0.13 m, or a turn of 0.096 or 0.104 rad, between two poses.
    messages = drive(
        30.0, step_s=0.2, at_s=3.999, command_s=2.0, speed_m_s=speed_m_s, radius_m=radius_m
    )
    run = read(tmp_path, messages)
    assert (CLOCK_SET in run.notes) == is_set
    assert (run.poses.time_ns[-1] / 1e9 > 39.0) != is_set


def test_a_robot_at_rest_does_not_show_whether_time_passed(tmp_path: Path) -> None:
    run = read(tmp_path, drive(259200.0, speed_m_s=0.0))
    assert CLOCK_SET not in run.notes
    assert run.notes["silence"].startswith("no pose or command for 259200 s from 4.0 s: the robot ")


@pytest.mark.parametrize(("shift_s", "is_told"), [(9.5, False), (10.5, True)])
def test_a_silence_longer_than_the_rest_is_told(
    tmp_path: Path, shift_s: float, *, is_told: bool
) -> None:
    assert ("silence" in read(tmp_path, drive(shift_s, speed_m_s=0.0)).notes) == is_told


def test_a_robot_at_rest_shows_that_a_clock_was_set_back(tmp_path: Path) -> None:
    run = read(tmp_path, drive(-3.7, speed_m_s=0.0))
    assert "set back by 3.70 s" in run.notes[CLOCK_SET]
    assert run.poses.time_ns[-1] / 1e9 == pytest.approx(10.0, abs=1e-3)


@pytest.mark.parametrize(("begin_s", "is_set"), [(0, True), (1_600_000_000, False)])
def test_only_stamps_of_a_wall_clock_show_that_the_recorders_alone_was_set(
    tmp_path: Path, begin_s: int, *, is_set: bool
) -> None:
    messages = drive(3.7, speed_m_s=0.0, jumps_stamps=False)
    for one in messages:
        if one.topic == "/pose":  # of a simulation that began 10^8 s ago and paused
            one.values["header"]["stamp"]["sec"] -= begin_s
    run = read(tmp_path, messages)
    assert (CLOCK_SET in run.notes) == is_set
    assert run.poses.time_ns[-1] / 1e9 == pytest.approx(10.0, abs=1e-3)


@pytest.mark.parametrize("has_stamps", [True, False])
def test_a_network_that_stalls_sets_no_clock(tmp_path: Path, *, has_stamps: bool) -> None:
    stall_ns = START_NS + np.array([4, 7]) * 10**9
    messages = [
        replace(one, time_ns=max(one.time_ns, int(stall_ns[1]) + number))
        if stall_ns[0] < one.time_ns < stall_ns[1]
        else one
        for number, one in enumerate(drive(0.0, has_stamps=has_stamps))
    ]
    run = read(tmp_path, sorted(messages, key=lambda one: one.time_ns))
    assert CLOCK_SET not in run.notes
    assert run.poses.time_ns[-1] / 1e9 == pytest.approx(10.0, abs=1e-3)


def test_two_recordings_in_one_file_are_sorted(tmp_path: Path) -> None:
    messages = drive(0.0)
    run = read(tmp_path, messages[300:] + messages[:300])
    assert CLOCK_SET not in run.notes
    require_whole(run)


def test_blocks_that_are_stored_late_are_sorted(tmp_path: Path) -> None:
    messages = drive(0.0, speed_m_s=0.0)
    run = read(tmp_path, [*messages[:100], *messages[200:300], *messages[100:200], *messages[300:]])
    assert CLOCK_SET not in run.notes
    assert run.poses.time_ns[-1] / 1e9 == pytest.approx(10.0, abs=1e-3)


def test_commands_alone_are_in_order_of_storage(tmp_path: Path) -> None:
    commands = [one for one in drive(-3.7) if one.topic == "/cmd_vel"]
    run = read_bag(write_mcap(tmp_path / "bag.mcap", commands), allow_no_poses=True)
    assert (np.diff(run.commands.turn_rate_rad_s) > 0.0).all()
    assert "set back by 3.70 s at 3.9 s" in run.notes[CLOCK_SET]


def test_a_trajectory_is_without_the_step(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "bag.mcap", drive(-3.7))
    found: Any = read_trajectory(path)
    assert np.diff(found.time_ns) / 1e9 == pytest.approx(STEP_S, abs=1e-6)


def test_info_says_how_long_the_run_really_is(tmp_path: Path, call: Call) -> None:
    text = call("info", write_mcap(tmp_path / "bag.mcap", drive(259200.0))).out
    assert text.startswith("bag.mcap: ROS 2 bag of a robot (not turtlesim), 10.0 s")
    assert "clock set" in text
