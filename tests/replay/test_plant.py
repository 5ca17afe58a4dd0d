import sqlite3
from contextlib import closing
from dataclasses import replace
from math import cos, sin
from struct import unpack_from
from typing import Any

import numpy as np
import pytest

import turtlelog as tl
from tests.log.runs import find_shared, simulate_preset
from turtlelog.log.ros2 import read_bag
from turtlelog.plants import Turtle
from turtlelog.plants.turtlesim import SPAWN_XY_M, TICK_NS, TICK_S
from turtlelog.replay import PlantReplay, PoseError, ReplayError, replay_plant
from turtlelog.replay.breaks_and_commands import place_commands, read_motion
from turtlelog.run import CommandColumns, PoseColumns, Run
from turtlelog.scenario import PAPER_RUNS

EXACT = PoseError()
POSE = "turtlesim/msg/Pose"
TWIST = "geometry_msgs/msg/Twist"


@pytest.fixture(scope="module")
def kp10() -> Run:
    return simulate_preset("paper-kp10")


@pytest.fixture(scope="module")
def real() -> Run:
    return read_bag(find_shared("ros2", "turtlesim_jazzy"))


def drop_rows(run: Run, first: int, after: int) -> Run:
    """Return a run without samples, and without some of its poses."""
    keep = np.r_[0:first, after : len(run.poses)]
    return replace_poses(run, keep=keep)


def replace_poses(run: Run, *, keep: Any = slice(None), **changes: Any) -> Run:
    columns = {
        name: getattr(run.poses, name)[keep].copy()
        for name in ("time_ns", "xy_m", "heading_rad", "speed_m_s", "turn_rate_rad_s")
    }
    no_samples = {
        name: getattr(run.samples, name)[:0]
        for name in run.samples.__dataclass_fields__
        if getattr(run.samples, name) is not None
    }
    return replace(
        run,
        poses=PoseColumns(**(columns | changes)),
        samples=replace(run.samples, **no_samples),
    )


def replace_commands(run: Run, **changes: Any) -> Run:
    return replace(run, commands=replace(run.commands, **changes))


def test_a_real_turtlesim_is_reproduced_bit_for_bit(real: Run) -> None:
    found = replay_plant(real)
    assert found.max_abs_error == EXACT
    assert [stretch.ticks for stretch in found.stretches] == [877, 1622]
    assert (found.commands.taken, found.commands.unseen, found.commands.stops) == (18, 0, 8)
    assert found.commands.unexplained_ticks == 0


def read_old_turtlesim() -> Run:
    """Return the poses and commands of a bag from before Humble, read with no code of ours."""
    path = find_shared("ros2", "turtlesim_v4", "subset_0.db3")
    query = (
        "select timestamp, data from messages join topics on topics.id = topic_id where type = ?"
    )
    with closing(sqlite3.connect(f"{path.as_uri()}?mode=ro&immutable=1", uri=True)) as file:
        # Behind the 4 bytes of the encoding.
        poses = [(at, *unpack_from("<5f", data, 4)) for at, data in file.execute(query, [POSE])]
        twists = [(at, *unpack_from("<6d", data, 4)) for at, data in file.execute(query, [TWIST])]
    pose, twist = (np.array(rows).T for rows in (poses, twists))
    pose_ns, twist_ns = (np.array([row[0] for row in rows]) for rows in (poses, twists))
    base = simulate_preset("paper-kp10")
    return replace_commands(
        replace_poses(
            replace(base, name="v4"),
            time_ns=pose_ns,
            xy_m=pose[1:3].T.copy(),
            heading_rad=pose[3].copy(),
            speed_m_s=np.abs(pose[4]),
            turn_rate_rad_s=pose[5].copy(),
        ),
        time_ns=twist_ns,
        speed_m_s=twist[1].copy(),
        lateral_speed_m_s=twist[2].copy(),
        turn_rate_rad_s=twist[6].copy(),
    )


def test_a_turtlesim_from_before_humble_is_known_by_its_heading_of_32_bits() -> None:
    run = read_old_turtlesim()
    found = replay_plant(run)
    assert (found.samples, found.commands.taken, found.heading_bits) == (987, 18, 32)
    assert (found.max_abs_error.heading_rad, found.within_rounding) == (0.0, True)
    # What is left of the position is the first pose's rounding: one start within half a 32-bit
    # step of it, the same throughout, reproduces every pose to the last bit.
    motion = read_motion(run)
    velocities, *_ = place_commands(motion, run, frozenset())
    turtle = Turtle(x_m=0.0, y_m=0.0, heading_rad=motion.heading_rad[0], keeps_32_bits=True)
    driven_m = np.zeros((len(motion.time_ns), 2))
    way_m = np.zeros(2)
    for row, (forward, left, turn_rate) in enumerate(velocities[1:], start=1):
        turtle.take_command(0.0, turn_rate)
        turtle.step()
        heading = turtle.state[2]
        assert left == 0.0
        way_m = way_m + forward * TICK_S * np.array([cos(heading), sin(heading)])
        driven_m[row] = way_m
    half_step_m = np.spacing(motion.xy_m.astype(np.float32)).astype(float) / 2.0
    lowest_m = (motion.xy_m - half_step_m - driven_m).max(axis=0)
    highest_m = (motion.xy_m + half_step_m - driven_m).min(axis=0)
    assert (highest_m - lowest_m > 1e-9).all()
    assert (np.abs((lowest_m + highest_m) / 2.0 - motion.xy_m[0]) < half_step_m[0]).all()


def simulate_pushed(**changes: float) -> Run:
    keys = {key.replace("__", "."): value for key, value in changes.items()}
    return tl.simulate_run(tl.override_scenario(tl.load_scenario("textbook"), keys))


def test_recorded_speeds_have_no_sign() -> None:
    """A robot that drifts and comes back slowly passes through speeds that no step shows."""
    run = simulate_pushed(
        law__kp_angular=8.0,
        law__kp_linear=8.0,
        loop__transport_delay_ticks=5,
        disturbance__speed_m_s=-0.02,
    )
    found = replay_plant(run)
    assert found.max_abs_error.y_m > 1e-5
    assert found.within_rounding
    assert found.stretches[0].rounding_m < 2e-4


@pytest.mark.parametrize(("speed_m_s", "ticks"), [(3.9e-4, 62), (4.1e-4, 0)])
def test_a_faster_step_shows_its_direction(speed_m_s: float, ticks: int) -> None:
    run = simulate_pushed(disturbance__speed_m_s=-speed_m_s, max_duration_s=1.0)
    (stretch,) = replay_plant(run).stretches
    assert stretch.within_rounding
    assert stretch.rounding_m - 2.0 * ticks * TICK_S * speed_m_s == pytest.approx(0.0, abs=2e-5)


def keep_heading_in_32_bits(run: Run) -> Run:
    """Return a run as turtlesim before Humble would have driven it."""
    velocities, *_ = place_commands(read_motion(run), run, frozenset())
    (x_m, y_m), heading_rad = run.poses.xy_m[0], float(run.poses.heading_rad[0])
    turtle = Turtle(x_m=x_m, y_m=y_m, heading_rad=heading_rad, keeps_32_bits=True)
    states = [turtle.state[:3]]
    for forward, left, turn_rate in velocities[1:]:
        turtle.take_command(forward, turn_rate, left)
        turtle.step()
        states.append(turtle.state[:3])
    published = np.array(states).astype(np.float32).astype(float)
    return replace_poses(run, xy_m=published[:, :2].copy(), heading_rad=published[:, 2].copy())


def test_only_what_64_bits_do_not_reproduce_is_tried_with_32(kp10: Run) -> None:
    old = replay_plant(keep_heading_in_32_bits(kp10))
    assert (old.heading_bits, old.max_abs_error) == (32, EXACT)
    assert replay_plant(replace_poses(kp10)).heading_bits == 64
    # Neither reproduces a pose that is off: the plant of today stands for it.
    xy_m = kp10.poses.xy_m.copy()
    xy_m[400, 1] += 8e-6
    found = replay_plant(replace_poses(kp10, xy_m=xy_m))
    assert (found.heading_bits, found.within_rounding) == (64, False)


@pytest.mark.parametrize("steps_beyond", [0, 1])
def test_within_rounding_ends_at_the_bound(kp10: Run, steps_beyond: int) -> None:
    [stretch] = replay_plant(replace_poses(kp10)).stretches
    step_m = float(np.spacing(np.float32(kp10.poses.xy_m[300, 0])))
    steps = int(stretch.rounding_m / step_m) + steps_beyond
    xy_m = kp10.poses.xy_m.copy()
    xy_m[300, 0] += steps * step_m
    found = replay_plant(replace_poses(kp10, xy_m=xy_m))
    assert found.within_rounding is found.stretches[0].within_rounding is (not steps_beyond)
    assert found.of_rounding == pytest.approx(steps * step_m / stretch.rounding_m)
    assert (found.of_rounding <= 1.0) is (not steps_beyond)


def test_the_reset_and_the_silence_of_a_real_turtlesim_are_found(real: Run) -> None:
    found = replay_plant(real)
    [jump], [gap] = found.jumps, found.gaps
    assert (jump.kind, jump.to_pose) == ("spawn", (SPAWN_XY_M, SPAWN_XY_M, 0.0))
    assert jump.at_ns == gap.end_ns == 15_632_487_045
    assert gap.end_ns - gap.start_ns == 1_600_373_167


@pytest.mark.parametrize("name", [*PAPER_RUNS, "paper", "textbook"])
def test_a_simulation_is_reproduced_bit_for_bit(name: str) -> None:
    run = simulate_preset(name)
    found = replay_plant(run)
    assert (found.max_abs_error, found.commands.unexplained_ticks) == (EXACT, 0)
    assert (found.samples, found.jumps, found.gaps) == (len(run.poses), (), ())


@pytest.mark.parametrize(
    "changes",
    [
        {"loop__transport_delay_ticks": 5},
        {"loop__pose_precision": "float64"},
        {"loop__period_ticks": 7},
        {"loop__period_ticks": 80},
        {"law__kp_linear": 30.0, "limits__speed_m_s": float("inf")},
        {"goal__x_m": 11.0, "goal__y_m": 11.0, "law__kp_linear": 80.0, "limits__speed_m_s": 20.0},
    ],
    ids=str,
)
@pytest.mark.parametrize("name", ["paper-kp10", "textbook"])
def test_any_loop_is_reproduced_bit_for_bit(name: str, changes: dict[str, Any]) -> None:
    found = replay_plant(simulate_preset(name, max_duration_s=20.0, **changes))
    assert (found.max_abs_error, found.commands.unexplained_ticks) == (EXACT, 0)


def test_a_pose_that_is_wrong_by_a_little_shows_in_its_stretch(kp10: Run) -> None:
    xy_m = kp10.poses.xy_m.copy()
    xy_m[400, 1] = np.float32(xy_m[400, 1] + 3e-6)
    found = replay_plant(replace_poses(kp10, xy_m=xy_m))
    assert found.max_abs_error.y_m == pytest.approx(3e-6, abs=5e-7)
    assert (found.max_abs_error.x_m, found.max_abs_error.heading_rad) == (0.0, 0.0)


def test_a_command_that_is_wrong_by_a_little_shows_where_it_is_integrated(kp10: Run) -> None:
    turn_rate = kp10.commands.turn_rate_rad_s * (1.0 + 1e-9)
    found = replay_plant(replace_commands(kp10, turn_rate_rad_s=turn_rate))
    assert found.commands.unexplained_ticks == 0
    slower = replay_plant(replace_commands(kp10, turn_rate_rad_s=turn_rate * 1.001))
    assert slower.commands.unexplained_ticks > 100


def test_a_teleport_begins_a_new_stretch(kp10: Run) -> None:
    xy_m = kp10.poses.xy_m.copy()
    xy_m[450:] += (0.5, -0.5)
    found = replay_plant(replace_poses(kp10, xy_m=xy_m))
    [jump] = found.jumps
    assert (jump.kind, jump.at_ns) == ("teleport", 450 * TICK_NS)
    assert [stretch.ticks for stretch in found.stretches] == [449, len(kp10.poses) - 451]
    assert_agrees_to_rounding(found)


def test_a_turn_on_the_spot_that_nobody_commanded_is_a_jump(kp10: Run) -> None:
    heading_rad = kp10.poses.heading_rad.copy()
    heading_rad[20:] += 0.1
    [jump] = replay_plant(replace_poses(kp10, heading_rad=heading_rad)).jumps
    assert jump.at_ns == 20 * TICK_NS


@pytest.mark.parametrize("first", [50, 300, 700])
def test_missing_poses_are_a_gap_and_no_jump(kp10: Run, first: int) -> None:
    found = replay_plant(drop_rows(kp10, first, first + 7))
    [gap] = found.gaps
    assert (found.jumps, gap.missing_ticks) == ((), 7)
    assert gap.start_ns == (first - 1) * TICK_NS
    assert_agrees_to_rounding(found)


def test_a_stretch_from_the_middle_of_a_motion_agrees_to_its_rounding(kp10: Run) -> None:
    for first in range(60, 700, 80):
        found = replay_plant(replace_poses(kp10, keep=slice(first, None)))
        assert_agrees_to_rounding(found)
        assert found.max_abs_error.x_m < 2e-6 > found.max_abs_error.y_m


def assert_agrees_to_rounding(found: PlantReplay) -> None:
    for stretch in found.stretches:
        error = stretch.max_abs_error
        assert max(error.x_m, error.y_m) <= stretch.rounding_m
        assert error.heading_rad <= stretch.rounding_rad


def test_ticks_without_a_recorded_command_use_the_recorded_velocity() -> None:
    run = simulate_preset("paper-kp1")
    keep = np.r_[0:150, 190 : len(run.commands)]
    columns = {
        name: getattr(run.commands, name)[keep].copy() for name in run.commands.__dataclass_fields__
    }
    found = replay_plant(replace(run, commands=CommandColumns(**columns)))
    assert found.commands.unexplained_ticks == 40
    assert found.max_abs_error.heading_rad < 1e-6


def test_a_recording_without_commands_is_replayed_from_its_velocities(real: Run) -> None:
    none = {name: getattr(real.commands, name)[:0] for name in real.commands.__dataclass_fields__}
    found = replay_plant(replace(real, commands=CommandColumns(**none)))
    speed, turn_rate = real.poses.speed_m_s, real.poses.turn_rate_rad_s
    assert speed is not None
    assert turn_rate is not None
    moving = int(np.count_nonzero(np.hypot(speed, turn_rate)))
    assert (found.commands.taken, found.commands.unexplained_ticks) == (0, moving)
    assert found.max_abs_error == EXACT


def drive(*commands: tuple[float, float, float], ticks: int = 30) -> Run:
    """Return a run in which a turtle takes a command every `ticks` ticks."""
    turtle = Turtle(x_m=5.0, y_m=5.0, heading_rad=0.0)
    rows = []
    for tick in range(ticks * len(commands)):
        if tick % ticks == ticks // 2:
            turtle.take_command(*commands[tick // ticks])
        turtle.step()
        rows.append(turtle.state)
    values = np.array(rows, dtype=np.float32).astype(np.float64)
    forward, turn_rate, left = np.array(commands).T
    run = replace_poses(simulate_preset("paper-kp1", max_duration_s=0.5))
    return replace(
        run,
        poses=PoseColumns(
            time_ns=np.arange(len(rows)) * TICK_NS,
            xy_m=values[:, :2],
            heading_rad=values[:, 2],
            speed_m_s=values[:, 3],
            turn_rate_rad_s=values[:, 4],
        ),
        commands=CommandColumns(
            time_ns=(np.arange(len(commands)) * ticks + ticks // 2) * TICK_NS - TICK_NS // 2,
            speed_m_s=forward.copy(),
            lateral_speed_m_s=left.copy(),
            turn_rate_rad_s=turn_rate.copy(),
        ),
    )


def test_backward_and_sideward_motion_is_told_from_forward() -> None:
    run = drive((1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.6, 0.3, -0.8))
    found = replay_plant(run)
    assert (found.max_abs_error, found.commands.taken) == (EXACT, 4)
    lost = replay_plant(replace_commands(run, speed_m_s=np.full(4, 9.0)))
    assert lost.commands.unexplained_ticks > 100
    assert max(lost.max_abs_error.x_m, lost.max_abs_error.y_m) < 2e-5


def test_a_wall_is_no_jump() -> None:
    found = replay_plant(drive((200.0, 0.0, 0.0), (-200.0, 1.0, 0.0), (3.0, 0.0, 0.0)))
    assert (found.max_abs_error, found.jumps) == (EXACT, ())


def test_a_wall_clock_that_jitters_hides_no_tick() -> None:
    rng = np.random.default_rng(3)
    run = drive(*[(1.0, 0.5, 0.0), (0.5, -1.0, 0.0)] * 6)
    jitter_ns = rng.integers(-7_000_000, 7_000_000, len(run.poses))
    time_ns = np.maximum.accumulate(run.poses.time_ns + jitter_ns)
    found = replay_plant(replace_poses(run, time_ns=time_ns + np.arange(len(time_ns))))
    assert (found.max_abs_error, found.gaps, found.jumps) == (EXACT, (), ())


@pytest.mark.parametrize("early_ns", [0, 9_000_000])
def test_a_message_lost_from_a_moving_turtle_is_a_gap_on_a_wall_clock(early_ns: int) -> None:
    run = drive(*[(1.0, 0.5, 0.0)] * 4)
    time_ns = run.poses.time_ns + np.arange(len(run.poses)) % 5
    time_ns[61] -= early_ns
    found = replay_plant(drop_rows(replace_poses(run, time_ns=time_ns), 60, 61))
    [gap] = found.gaps
    assert (gap.start_ns, gap.missing_ticks, found.jumps) == (int(time_ns[59]), 1, ())


def test_a_command_stamped_after_the_pose_that_shows_it_is_found_on_a_wall_clock() -> None:
    run = drive((1.0, 0.5, 0.0), (0.5, -1.0, 0.0), (-1.0, 0.3, 0.2))
    run = replace_poses(run, time_ns=run.poses.time_ns + np.arange(len(run.poses)) % 5)
    found = replay_plant(replace_commands(run, time_ns=run.commands.time_ns + TICK_NS))
    assert (found.commands.taken, found.commands.unexplained_ticks) == (3, 0)
    assert found.max_abs_error == EXACT


@pytest.mark.parametrize(("ticks", "gaps"), [(10, 0), (11, 1)])
def test_ten_ticks_of_silence_of_a_standing_turtle_are_no_gap(ticks: int, gaps: int) -> None:
    run = drive((0.0, 0.0, 0.0))
    time_ns = run.poses.time_ns + np.arange(len(run.poses)) % 5
    time_ns[15:] += (ticks - 1) * TICK_NS
    assert len(replay_plant(replace_poses(run, time_ns=time_ns)).gaps) == gaps


@pytest.mark.parametrize(("late_ns", "ticks"), [(2 * TICK_NS - 10, 0), (2 * TICK_NS + 10, 6)])
def test_a_command_may_be_stamped_two_ticks_after_its_pose(late_ns: int, ticks: int) -> None:
    run = drive((1.0, 0.5, 0.0), (0.5, -1.0, 0.0))
    run = replace_poses(run, time_ns=run.poses.time_ns + np.arange(len(run.poses)) % 5)
    shown_ns = run.poses.time_ns[[15, 45]]
    found = replay_plant(replace_commands(run, time_ns=shown_ns + late_ns)).commands
    assert found.unexplained_ticks == ticks


@pytest.mark.parametrize(("aside_m_s", "taken"), [(1.6e-4, 1), (2.4e-4, 0)])
def test_a_step_tells_its_direction_to_a_fifth_of_a_millimetre_per_second(
    aside_m_s: float, taken: int
) -> None:
    run = drive((1.0, 0.0, 0.0))
    aside = np.array([aside_m_s])
    turned = replace_commands(run, speed_m_s=np.sqrt(1.0 - aside**2), lateral_speed_m_s=aside)
    assert replay_plant(turned).commands.taken == taken


def test_a_jump_names_both_poses() -> None:
    run = drive((0.0, 0.0, 0.0))
    xy_m, heading_rad = run.poses.xy_m.copy(), run.poses.heading_rad.copy()
    xy_m[9:], heading_rad[9:] = (2.0, 3.0), 1.0
    [jump] = replay_plant(replace_poses(run, xy_m=xy_m, heading_rad=heading_rad)).jumps
    assert (jump.from_pose, jump.to_pose) == ((5.0, 5.0, 0.0), (2.0, 3.0, 1.0))


def test_one_pose_is_a_stretch_of_no_ticks(kp10: Run) -> None:
    found = replay_plant(replace_poses(kp10, keep=slice(0, 1)))
    assert ([stretch.ticks for stretch in found.stretches], found.max_abs_error) == ([0], EXACT)


def test_a_run_without_applied_velocities_is_refused(kp10: Run) -> None:
    run = replace_poses(kp10, speed_m_s=None)
    with pytest.raises(ReplayError, match="paper-kp10: no poses with the applied velocities"):
        replay_plant(run)


def test_a_robot_that_is_no_turtlesim_is_refused(kp10: Run) -> None:
    run = replace_poses(kp10, time_ns=kp10.poses.time_ns * 2)
    with pytest.raises(ReplayError, match="expected a pose per tick of 16 ms, found one per 32 ms"):
        replay_plant(run)


def test_the_rounding_grows_with_the_way_driven() -> None:
    short, far = (drive(*[(2.0, 1.0, 0.0)] * count) for count in (1, 8))
    [first], [second] = replay_plant(short).stretches, replay_plant(far).stretches
    driven_m = 2.0 * TICK_S * 8 * 30
    assert first.rounding_m < second.rounding_m < 3 * 2.0**-21 + driven_m * 2.0**-23
    assert (cos(second.rounding_rad), sin(second.rounding_rad)) == pytest.approx(
        (1.0, 0.0), abs=3e-7
    )


def test_the_first_pose_beyond_rounding_is_named(kp10: Run) -> None:
    drift_m = 2e-6 * np.maximum(np.arange(len(kp10.poses)) - 300, 0)
    xy_m = kp10.poses.xy_m.copy()
    xy_m[:, 1] = np.float32(xy_m[:, 1] + drift_m)
    found = replay_plant(replace(kp10, poses=replace(kp10.poses, xy_m=xy_m))).first_difference
    assert found is not None
    assert found.signal == "y"
    assert 300 < found.time_ns / TICK_NS < 305
    assert 0.0 < float(found.recorded or 0.0) - float(found.replayed or 0.0) < 1e-5


def test_what_rounding_explains_is_no_difference(kp10: Run, real: Run) -> None:
    assert replay_plant(kp10).first_difference is None
    assert replay_plant(real).first_difference is None
