"""Times of poses and commands against truths in closed form: what a clock and a transport make."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.log.ros2.bags import START_NS, make_odometry, write_mcap
from tests.log.runs import find_shared
from turtlelog import read_run
from turtlelog.errors import LogError
from turtlelog.log.ros2.bag_clock import CLOCK, CLOSE_ROWS, BagTimes, time_rows
from turtlelog.log.ros2.stamps import Stamps, read_stamp_clock
from turtlelog.run import Clock

TimesNs = NDArray[np.int64]

EPOCH_NS = 1_700_000_000_000_000_000
MS = 1_000_000


def make_times(count: int = 1200, step_ms: float = 50.0) -> TimesNs:
    """Return when a robot measured, by the recorder's clock."""
    return EPOCH_NS + (np.arange(count) * step_ms * MS).astype(np.int64)


def make_stamps(
    true_ns: TimesNs,
    *,
    pace: float = 1.0,
    offset_s: float = 0.0,
    jitter_ms: float = 5.0,
    seed: int = 0,
) -> Stamps:
    """Return messages with a random transport of at least 2 ms, in the order of their arrival."""
    delay = 2.0 + np.random.default_rng(seed).exponential(jitter_ms, len(true_ns))
    passed = true_ns - true_ns[0]
    stamp_ns = true_ns[0] + np.rint(pace * passed).astype(np.int64) - round(offset_s * 1e9)
    log_ns = true_ns + np.rint(delay * MS).astype(np.int64)
    order = np.argsort(log_ns, kind="stable")
    return Stamps(log_ns=log_ns[order], stamp_ns=stamp_ns[order])


def time_poses(poses: Stamps, time: Any = "auto", commands: Stamps | None = None) -> BagTimes:
    return time_rows(poses, commands, time)


def read_clock(times: BagTimes) -> Clock:
    assert times.clock is not None
    return times.clock


@pytest.mark.parametrize("drift", [0.0, 1e-5, 1e-4, 1e-3, -1e-3])
def test_mapped_times_are_within_the_jitter_of_the_truth(drift: float) -> None:
    for seed in range(10):
        random = np.random.default_rng(seed + 100)
        jitter_ms, offset_s = 10.0 ** random.uniform(-1.0, 1.5), random.normal(0.0, 1e6)
        true_ns = make_times(int(random.integers(200, 2000)))
        poses = make_stamps(
            true_ns, pace=1.0 + drift, offset_s=offset_s, jitter_ms=jitter_ms, seed=seed
        )
        times = time_poses(poses)
        # What stays unknown is the transport of the fastest message, here 2 ms.
        error_ms = (times.poses.time_ns - true_ns) / MS - 2.0
        clock = read_clock(times)
        assert clock.jitter_s is not None
        assert clock.jitter_s == pytest.approx(jitter_ms / 1e3 * np.log(2.0), rel=0.5)
        assert np.abs(error_ms).max() < 1e3 * clock.jitter_s
        assert clock.ratio == pytest.approx(1.0 + drift, abs=0.01 * jitter_ms / len(true_ns))
        assert clock.offset_s == pytest.approx(offset_s + 0.002, abs=clock.jitter_s)


def test_what_was_done_is_said_in_words() -> None:
    poses = make_stamps(make_times(), pace=1.0005, offset_s=-0.78)
    times = time_poses(poses, commands=Stamps(log_ns=poses.log_ns[::4]))
    text = times.notes[CLOCK]
    assert text.startswith("poses are timed by their stamps - 0.778 s, mapped to the recorder's")
    assert "usually it takes 3.7 ms more; their clock drifts by +500 ppm, taken out" in text
    assert text.endswith("; commands by the recorder's clock")
    assert (times.commands.time_ns == poses.log_ns[::4]).all()


@pytest.mark.parametrize(
    ("first_s", "words"),
    [(999_999_000.0, "whose seconds are a simulation's: "), (1e9, "whose seconds are of another")],
)
def test_only_stamps_of_no_wall_clock_are_called_a_simulations(first_s: float, words: str) -> None:
    # A recorder that falls behind: 2.5 s over 30 s.
    true_ns = make_times(600)
    late_ns = (true_ns - true_ns[0]) // 12
    stamp_ns = true_ns - true_ns[0] + round(first_s * 1e9)
    times = time_poses(Stamps(log_ns=true_ns + late_ns, stamp_ns=stamp_ns))
    assert words in times.notes[CLOCK]
    assert "s of the recorder's clock, ratio 0.923" in times.notes[CLOCK]


@pytest.mark.parametrize(("pace", "is_other"), [(1.0019, False), (1.0021, True), (0.9979, True)])
def test_a_pace_that_no_clock_drifts_by_is_a_simulations(pace: float, *, is_other: bool) -> None:
    poses = make_stamps(make_times(2400), pace=pace, jitter_ms=0.5)
    assert read_stamp_clock(poses).is_other_pace == is_other
    span_ns = np.ptp(time_poses(poses).poses.time_ns)
    expected_ns = (pace if is_other else 1.0) * np.ptp(make_times(2400))
    assert span_ns == pytest.approx(expected_ns, abs=MS)


@pytest.mark.parametrize(("count", "is_other"), [(35, False), (50, True)])
def test_in_a_short_recording_clocks_part_by_too_little_to_tell(
    count: int, *, is_other: bool
) -> None:
    # At 5 % more, clocks part by 0.1 s within 2 s: 40 poses.
    poses = make_stamps(make_times(count), pace=1.05, jitter_ms=2.0)
    assert read_stamp_clock(poses).is_other_pace == is_other


@pytest.mark.parametrize(("apart_s", "is_other"), [(0.28, False), (0.32, True), (1.05, True)])
def test_clocks_that_part_by_no_more_than_transport_varies_are_one(
    apart_s: float, *, is_other: bool
) -> None:
    # A tenth of the messages takes 0.1 s more, three times of which may be transport.
    true_ns = make_times(200)
    passed_s = (true_ns - true_ns[0]) / 1e9
    late_ns = np.where(np.arange(200) % 8 == 4, 100 * MS, 0)
    stamp_ns = true_ns + np.rint(apart_s * 1e9 * passed_s / passed_s[-1]).astype(np.int64)
    clock = read_stamp_clock(Stamps(log_ns=true_ns + late_ns, stamp_ns=stamp_ns))
    assert clock.is_other_pace == is_other


@pytest.mark.parametrize(("apart_s", "is_other"), [(0.95, False), (1.05, True)])
def test_clocks_that_part_by_a_second_are_two(apart_s: float, *, is_other: bool) -> None:
    true_ns = make_times(200)
    passed_s = (true_ns - true_ns[0]) / 1e9
    late_ns = np.where(np.arange(200) % 8 == 4, 900 * MS, 0)
    stamp_ns = true_ns + np.rint(apart_s * 1e9 * passed_s / passed_s[-1]).astype(np.int64)
    clock = read_stamp_clock(Stamps(log_ns=true_ns + late_ns, stamp_ns=stamp_ns))
    assert clock.is_other_pace == is_other


@pytest.mark.parametrize(("pause_ms", "is_other"), [(1900, False), (2100, True)])
def test_a_pause_that_leaves_a_second_for_good_is_a_simulations(
    pause_ms: int, *, is_other: bool
) -> None:
    # Half of a pause in the middle passes for a drift, which is small in so long a recording.
    true_ns = make_times(4800, step_ms=1000.0)
    late_ns = np.where(np.arange(4800) >= 2400, pause_ms * MS, 0)
    clock = read_stamp_clock(Stamps(log_ns=true_ns + late_ns, stamp_ns=true_ns))
    assert clock.is_other_pace == is_other


@pytest.mark.parametrize("pace", [0.05, 0.22, 3.0])
def test_simulated_times_keep_their_seconds_and_commands_follow(pace: float) -> None:
    true_ns = make_times()
    poses = make_stamps(true_ns, pace=pace, offset_s=1.6e9)
    commands = Stamps(log_ns=true_ns[::2] + 20 * MS)
    times = time_poses(poses, commands=commands)
    assert read_clock(times).ratio == pytest.approx(pace, rel=1e-3)
    assert read_clock(times).jitter_s is None
    start_ns = times.poses.time_ns[0]
    expected_ns = pace * (true_ns - true_ns[0])
    assert np.abs(times.poses.time_ns - start_ns - expected_ns).max() < 2
    # A command that was received 20 ms after a pose was measured: to the transport of poses.
    late_ms = (times.commands.time_ns - start_ns - expected_ns[::2]) / MS / pace
    assert np.abs(late_ms - 20.0).max() < 60.0
    assert np.median(np.abs(late_ms - 15.0)) < 10.0


def test_a_simulation_that_pauses_keeps_its_seconds() -> None:
    true_ns = make_times()
    passed_ns = true_ns - true_ns[0]
    late_ns = np.where(passed_ns > 30_000 * MS, 10_000 * MS, 0)
    poses = Stamps(log_ns=true_ns + late_ns, stamp_ns=passed_ns + 1)
    commands = Stamps(log_ns=poses.log_ns)
    times = time_poses(poses, commands=commands)
    assert (np.diff(times.poses.time_ns) == 50 * MS).all()
    assert (times.commands.time_ns == times.poses.time_ns).all()


def test_stamped_commands_of_the_same_simulation_keep_their_stamps() -> None:
    true_ns = make_times()
    poses = make_stamps(true_ns, pace=0.25, offset_s=1.6e9)
    commands = make_stamps(true_ns, pace=0.25, offset_s=1.6e9, seed=1)
    times = time_poses(poses, commands=commands)
    assert (times.commands.time_ns == times.poses.time_ns).all()
    # Stamps of the wall's clock are no use there.
    others = make_stamps(true_ns, seed=1)
    placed_ns = time_poses(poses, commands=others).commands.time_ns
    assert np.abs(placed_ns - times.poses.time_ns).max() < 60 * MS


def test_stamped_commands_of_another_clock_are_mapped_by_their_own() -> None:
    true_ns = make_times()
    poses = make_stamps(true_ns, offset_s=-0.78)
    commands = make_stamps(true_ns, offset_s=40.0, seed=1)
    times = time_poses(poses, commands=commands)
    assert np.abs(times.commands.time_ns - true_ns - 2 * MS).max() < 0.1 * MS
    assert times.notes[CLOCK].endswith("; commands by their stamps, likewise")


def test_by_the_log_all_stays_as_it_was_received() -> None:
    poses = make_stamps(make_times(), pace=0.5)
    times = time_poses(poses, "log", Stamps(log_ns=poses.log_ns))
    assert (times.commands.time_ns == poses.log_ns).all()
    assert np.isin(times.poses.time_ns, poses.log_ns).all()
    clock = read_clock(times)
    assert clock.used == "log"
    assert clock.ratio == pytest.approx(0.5, rel=1e-3)
    assert "rates are those of the motion times 0.5" in times.notes[CLOCK]


@pytest.mark.parametrize(
    ("stamp_ns", "reason"),
    [
        (np.zeros(100, dtype=np.int64), "all stamps are 0"),
        (
            np.where(np.arange(100) < 51, 0, make_times(100)),
            "51 of 100 stamps are 0 or make no sense",
        ),
        (np.full(100, EPOCH_NS), "100 poses share 1 stamp"),
        (EPOCH_NS + np.arange(100) // 5 * 250 * MS, "100 poses share 20 stamps"),
        (make_times(100) - np.arange(100) // 10 * 9_000 * MS, "the stamps' clock jumps to and fro"),
    ],
)
def test_stamps_of_no_use_leave_the_log(stamp_ns: TimesNs, reason: str) -> None:
    poses = Stamps(log_ns=make_times(100) + 3 * MS, stamp_ns=stamp_ns)
    times = time_poses(poses)
    assert (times.poses.time_ns == poses.log_ns).all()
    assert read_clock(times).used == "log"
    assert times.notes[CLOCK].endswith(f"as {reason}")


def test_stamps_that_are_just_enough_are_used() -> None:
    true_ns = make_times(100)
    some = np.where(np.arange(100) < 50, 0, true_ns)
    repeated = true_ns[0] + np.arange(100) // 4 * 200 * MS
    for stamp_ns in (some, repeated):
        poses = Stamps(log_ns=true_ns + 3 * MS, stamp_ns=stamp_ns)
        assert read_clock(time_poses(poses)).used == "stamp"


def test_stamps_that_are_asked_for_have_to_be_there() -> None:
    true_ns = make_times(100)
    with pytest.raises(LogError, match="found a type without: take log"):
        time_poses(Stamps(log_ns=true_ns), "stamp")
    with pytest.raises(LogError, match="but all stamps are 0: take log"):
        time_poses(Stamps(log_ns=true_ns, stamp_ns=np.zeros_like(true_ns)), "stamp")


def test_poses_without_stamps_stay_as_they_are() -> None:
    burst = np.sort(make_times(100) // (500 * MS) * (500 * MS))
    times = time_poses(Stamps(log_ns=burst))
    assert (times.clock, dict(times.notes)) == (None, {})
    assert (times.poses.time_ns == burst).all()
    assert (times.poses.rows == np.arange(100)).all()


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
    assert CLOSE_ROWS not in times.notes


def test_poses_in_disorder_are_sorted_and_counted() -> None:
    true_ns = make_times()
    stamp_ns = true_ns.copy()
    stamp_ns[[10, 11]] = stamp_ns[[11, 10]]
    times = time_poses(Stamps(log_ns=true_ns + 5 * MS, stamp_ns=stamp_ns))
    assert times.poses.rows[[10, 11]].tolist() == [11, 10]
    assert (np.diff(times.poses.time_ns) > 0).all()
    assert "; 1 received out of order are sorted" in times.notes[CLOCK]


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
    assert times.notes.get(CLOSE_ROWS, "0") == str(close)
    assert (100 in times.poses.rows) == (close == 0)


@pytest.mark.parametrize(("share", "close"), [(0.24, 1), (0.26, 0)])
def test_of_quick_poses_only_closer_ones_are_left_out(share: float, close: int) -> None:
    true_ns = make_times(step_ms=0.5)
    true_ns[101] = true_ns[100] + round(share * 0.5 * MS)
    times = time_poses(Stamps(log_ns=true_ns, stamp_ns=true_ns))
    assert len(times.poses.rows) == len(true_ns) - close


@pytest.mark.parametrize("count", [0, 1, 2, 3, 7, 9])
def test_few_poses_are_timed_too(count: int) -> None:
    true_ns = make_times(count)
    poses = Stamps(log_ns=true_ns + 3 * MS, stamp_ns=true_ns)
    times = time_poses(poses)
    assert len(times.poses.time_ns) == count
    assert read_clock(times).used == ("stamp" if count > 1 else "log")


def test_a_real_robots_clock_is_found_and_taken_out() -> None:
    path = find_shared("robots", "tb3")
    run, as_logged = read_run(path), read_run(path, time="log")
    clock = run.clock
    assert clock is not None
    assert clock.used == "stamp"
    assert clock.offset_s == pytest.approx(-0.779, abs=0.001)
    assert clock.ratio == pytest.approx(1.0, abs=2e-5)
    assert clock.jitter_s == pytest.approx(0.0051, abs=0.0003)
    assert len(run.poses) == 1254
    assert np.diff(run.poses.time_ns).min() > 37 * MS
    # The recorder received some poses in bursts; two of them 0.126 ms apart.
    assert (len(as_logged.poses), as_logged.notes[CLOSE_ROWS]) == (1244, "10")
    assert "as asked" in as_logged.notes[CLOCK]


def test_a_real_simulation_keeps_its_seconds() -> None:
    path = find_shared("robots", "sim_time")
    run = read_run(path, pose_topic="/odom")
    as_logged = read_run(path, pose_topic="/odom", time="log")
    spans_s = [np.ptp(found.poses.time_ns) / 1e9 for found in (run, as_logged)]
    assert spans_s == pytest.approx([43.76, 196.47], abs=0.01)
    assert run.clock is not None
    assert run.clock.ratio == pytest.approx(0.2227, abs=1e-4)
    assert "43.8 s in 196.5 s of the recorder's clock, ratio 0.223" in run.notes[CLOCK]


def test_a_real_turtlesim_has_no_stamps_and_stays_as_it_is() -> None:
    path = find_shared("ros2", "turtlesim_jazzy")
    run, as_logged = read_run(path), read_run(path, time="log")
    assert (run.clock, CLOCK in run.notes) == (None, False)
    assert run.poses.time_ns.tobytes() == as_logged.poses.time_ns.tobytes()
    with pytest.raises(LogError, match=r"turtlesim_jazzy: time: expected poses with stamps"):
        read_run(path, time="stamp")


def test_a_bag_of_the_same_clock_reads_as_it_was_stamped(tmp_path: Path) -> None:
    true_ns = START_NS + np.arange(50) * 50 * MS
    odometry = make_odometry(yaw_rad=0.5, speed=(1.0, 0.0), turn_rate=0.0)
    messages = []
    for row, time_ns in enumerate(true_ns.tolist()):
        stamp = {"sec": time_ns // 10**9, "nanosec": time_ns % 10**9}
        values = odometry.values | {"header": {"stamp": stamp, "frame_id": "odom"}}
        messages.append(replace(odometry, values=values, time_ns=time_ns + 3 * MS + row % 7 * MS))
    run = read_run(write_mcap(tmp_path / "bag.mcap", messages))
    assert (run.poses.time_ns == true_ns - START_NS).all()
    assert run.clock == Clock(used="stamp", ratio=1.0, offset_s=0.003, jitter_s=0.003)
    none = [replace(said, values=odometry.values) for said in messages]
    run = read_run(write_mcap(tmp_path / "bag.mcap", none))
    assert run.clock == Clock(used="log")
    assert run.notes[CLOCK] == "poses are timed by the recorder's clock, as all stamps are 0"


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
