"""Stamps that jump, stall, are late or make no sense: what is mended, left out, or refused."""

import numpy as np
import pytest

from tests.log.ros2.stamped_poses import MS, make_stamps, make_times, read_clock, time_poses
from turtlelog.log.ros2.bag_rows import CLOCK
from turtlelog.log.ros2.stamps import Stamps, read_stamp_clock


def test_a_few_bad_stamps_are_timed_by_when_they_were_received() -> None:
    true_ns = make_times()
    poses = make_stamps(true_ns, offset_s=5.0)
    assert poses.stamp_ns is not None
    poses.stamp_ns[[3, 400, 401]] = 0
    poses.stamp_ns[700] += 3600 * 1_000_000_000
    times = time_poses(poses)
    assert np.abs(times.poses.time_ns - true_ns - 2 * MS).max() < 60 * MS
    assert "; 4 without a usable stamp by when they were received" in times.notes[CLOCK]


@pytest.mark.parametrize("set_by_s", [-0.78, 0.78, -3600.0, 3600.0])
def test_a_clock_that_is_set_is_followed(set_by_s: float) -> None:
    true_ns = make_times()
    poses = make_stamps(true_ns, offset_s=5.0)
    assert poses.stamp_ns is not None
    poses.stamp_ns[600:] += round(set_by_s * 1e9)
    times = time_poses(poses)
    assert np.abs(times.poses.time_ns - true_ns - 2 * MS).max() < 0.2 * MS
    assert "; their clock was set 1 time" in times.notes[CLOCK]


@pytest.mark.parametrize(("set_by_s", "jumps"), [(0.51, 1), (0.49, 0)])
def test_less_than_half_a_second_forward_is_transport(set_by_s: float, jumps: int) -> None:
    poses = make_stamps(make_times(), jitter_ms=0.1)
    assert poses.stamp_ns is not None
    poses.stamp_ns[600:] += round(set_by_s * 1e9)
    assert read_stamp_clock(poses).jumps == jumps


@pytest.mark.parametrize(("steps", "jumps"), [(3.1, 1), (2.9, 0)])
def test_of_slow_poses_some_may_be_lost(steps: float, jumps: int) -> None:
    stamp_ns = make_times(200, step_ms=1000.0)
    stamp_ns[100:] += round(steps * 1000 * MS)
    log_ns = make_times(200, step_ms=1000.0)
    assert read_stamp_clock(Stamps(log_ns=log_ns, stamp_ns=stamp_ns)).jumps == jumps


@pytest.mark.parametrize(("rows", "is_usable"), [(21, True), (19, False)])
def test_a_clock_that_is_set_often_tells_no_time(rows: int, *, is_usable: bool) -> None:
    true_ns = make_times(437)
    stamp_ns = true_ns - np.arange(437) // rows * 5_000 * MS
    clock = read_stamp_clock(Stamps(log_ns=true_ns, stamp_ns=stamp_ns))
    assert clock.reason == ("" if is_usable else "the stamps' clock jumps to and fro")


@pytest.mark.parametrize(("rows", "odd"), [(3, 3), (4, 0)])
def test_up_to_three_stamps_that_make_no_sense_are_left_out(rows: int, odd: int) -> None:
    true_ns = make_times(200)
    stamp_ns = true_ns.copy()
    stamp_ns[100 : 100 + rows] -= 3_600_000 * MS
    assert read_stamp_clock(Stamps(log_ns=true_ns, stamp_ns=stamp_ns)).odd == odd


def test_a_simulation_that_starts_again_goes_on() -> None:
    true_ns = make_times()
    passed_ns = (true_ns - true_ns[0]) // 4
    stamp_ns = MS + passed_ns - np.where(np.arange(1200) >= 600, passed_ns[600], 0)
    times = time_poses(Stamps(log_ns=true_ns, stamp_ns=stamp_ns))
    assert np.abs(times.poses.time_ns - true_ns[0] - passed_ns).max() < MS
    assert read_clock(times).ratio == pytest.approx(0.25, rel=1e-3)


def test_a_stall_of_the_recorder_is_mended() -> None:
    true_ns = make_times()
    poses = make_stamps(true_ns, jitter_ms=0.1)
    stalled = (poses.log_ns > true_ns[600]) & (poses.log_ns < true_ns[660])
    poses.log_ns[stalled] = true_ns[660]
    times = time_poses(poses)
    assert np.abs(times.poses.time_ns - true_ns - 2 * MS).max() < 0.1 * MS
    assert "close_rows" not in times.notes


def test_poses_in_disorder_are_sorted_and_counted() -> None:
    true_ns = make_times()
    stamp_ns = true_ns.copy()
    stamp_ns[[10, 11]] = stamp_ns[[11, 10]]
    times = time_poses(Stamps(log_ns=true_ns + 5 * MS, stamp_ns=stamp_ns))
    assert times.poses.rows[[10, 11]].tolist() == [11, 10]
    assert (np.diff(times.poses.time_ns) > 0).all()
    assert "; 1 received out of order is sorted" in times.notes[CLOCK]


@pytest.mark.parametrize(("rows", "jumps"), [(4, 0), (5, 1)])
def test_few_stamps_behind_an_earlier_one_are_late(rows: int, jumps: int) -> None:
    stamp_ns = make_times(200)
    stamp_ns[100 : 100 + rows] -= 400 * MS
    clock = read_stamp_clock(Stamps(log_ns=make_times(200), stamp_ns=stamp_ns))
    assert clock.jumps >= jumps
    assert (clock.disordered > 0) == (jumps == 0)


@pytest.mark.parametrize(("step_us", "close"), [(999, 1), (1000, 0)])
def test_a_pose_a_moment_before_another_is_left_out(step_us: int, close: int) -> None:
    true_ns = make_times()
    true_ns[101] = true_ns[100] + step_us * 1000
    times = time_poses(Stamps(log_ns=true_ns + 3 * MS, stamp_ns=true_ns))
    assert len(times.poses.rows) == len(true_ns) - close
    assert times.notes.get("close_rows", "0") == str(close)
    assert (100 in times.poses.rows) == (close == 0)


@pytest.mark.parametrize(("share", "close"), [(0.24, 1), (0.26, 0)])
def test_of_quick_poses_only_closer_ones_are_left_out(share: float, close: int) -> None:
    true_ns = make_times(step_ms=0.5)
    true_ns[101] = true_ns[100] + round(share * 0.5 * MS)
    times = time_poses(Stamps(log_ns=true_ns, stamp_ns=true_ns))
    assert len(times.poses.rows) == len(true_ns) - close


@pytest.mark.parametrize("row", [0, 1, 2, -1])
def test_a_first_or_last_message_of_another_time_is_no_clock_that_was_set(row: int) -> None:
    true_ns = make_times(200)
    poses = make_stamps(true_ns, offset_s=5.0)
    assert poses.stamp_ns is not None
    poses.stamp_ns[row] -= 1000 * 1_000_000_000
    clock = read_stamp_clock(poses)
    assert (clock.odd, clock.jumps) == (1, 0)
    assert clock.offset_ns == pytest.approx(5e9, abs=10 * MS)


@pytest.mark.parametrize(
    ("apart_s", "reason"), [(1.6, "the stamps' clock jumps to and fro"), (1.4, "")]
)
def test_stamps_of_two_clocks_in_turn_tell_no_time(apart_s: float, reason: str) -> None:
    true_ns = make_times(200)
    stamp_ns = true_ns - np.arange(200) % 2 * round(apart_s * 1e9)
    assert read_stamp_clock(Stamps(log_ns=true_ns, stamp_ns=stamp_ns)).reason == reason
