"""Times of poses and commands against truths in closed form: what a clock and a transport make."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.log.ros2.bags import START_NS, make_odometry, write_mcap
from tests.log.ros2.stamped_poses import (
    EPOCH_NS,
    MS,
    TimesNs,
    make_stamps,
    make_times,
    read_clock,
    time_poses,
)
from tests.log.runs import find_shared
from turtlelog import read_run
from turtlelog.errors import LogError
from turtlelog.log.ros2.bag_rows import CLOCK
from turtlelog.log.ros2.stamps import Stamps, read_stamp_clock
from turtlelog.run import Clock


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
    assert "usually others take 3.7 ms more; their clock drifts by +500 ppm, taken out" in text
    assert text.endswith("; commands by the recorder's clock")
    assert (times.commands.time_ns == poses.log_ns[::4]).all()


@pytest.mark.parametrize(("offset_s", "shift"), [(0.0, ""), (0.0004, ""), (0.0006, " - 0.001 s")])
def test_a_shift_that_rounds_to_0_is_not_told(offset_s: float, shift: str) -> None:
    true_ns = make_times()
    stamps = Stamps(log_ns=true_ns, stamp_ns=true_ns + round(offset_s * 1e9))
    text = time_poses(stamps).notes[CLOCK]
    assert text.startswith(f"poses are timed by their stamps{shift}, mapped to the recorder's")


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
        (make_times(100) - 2**32 * 1000 * MS, "all stamps are 0 or before 1970"),
        (
            np.where(np.arange(100) < 51, 0, make_times(100)),
            "51 of 100 stamps are 0 or make no sense",
        ),
        (np.full(100, EPOCH_NS), "100 messages share 1 stamp"),
        (EPOCH_NS + np.arange(100) // 5 * 250 * MS, "100 messages share 20 stamps"),
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
    assert (len(as_logged.poses), as_logged.notes["close_rows"]) == (1244, "10")
    assert "as given" in as_logged.notes[CLOCK]


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


@pytest.mark.parametrize(
    ("pace", "is_other"), [(0.998, True), (1.00055, True), (1.00045, False), (0.9997, False)]
)
def test_a_clock_near_0_that_goes_as_no_quartz_does_is_a_simulations(
    pace: float, *, is_other: bool
) -> None:
    true_ns = make_times(2400)
    poses = make_stamps(true_ns, pace=pace, offset_s=EPOCH_NS / 1e9 - 5.0, jitter_ms=1.0)
    times = time_poses(poses)
    assert ("whose seconds are a simulation's" in times.notes[CLOCK]) == is_other
    expected_ns = (pace if is_other else 1.0) * np.ptp(true_ns)
    assert np.ptp(times.poses.time_ns) == pytest.approx(expected_ns, abs=2 * MS)


def test_a_short_drift_near_0_is_not_called_that_of_a_clock_that_was_set() -> None:
    poses = make_stamps(make_times(100), pace=0.9985, offset_s=EPOCH_NS / 1e9 - 5.0, jitter_ms=2.0)
    text = time_poses(poses).notes[CLOCK]
    assert "; their clock, which was never set or is a simulation's, drifts by -" in text
