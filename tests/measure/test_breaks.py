"""Jumps and gaps of any robot's poses: what is one, and what is none."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.log.runs import find_shared, make_bare_run, simulate_preset
from turtlelog import Run, read_run
from turtlelog.measure.breaks import find_gaps, find_jumps
from turtlelog.measure.pose_quality import describe_breaks
from turtlelog.run import Origin, PoseColumns
from turtlelog.run.angles import wrap_angle

Values = NDArray[np.float64]


def make_robot(
    speed: Any = 0.2, turn_rate: Any = 0.1, *, count: int = 200, hz: float = 20.0
) -> Run:
    """Return a run of a robot at some rates, along arcs."""
    speed, turn_rate = (np.broadcast_to(rate, count - 1) for rate in (speed, turn_rate))
    heading = np.r_[0.0, np.cumsum(turn_rate / hz)]
    mean = 0.5 * (heading[1:] + heading[:-1])
    steps = np.column_stack([speed * np.cos(mean), speed * np.sin(mean)]) / hz
    poses = PoseColumns(
        time_ns=np.arange(count) * round(1e9 / hz),
        xy_m=np.vstack([np.zeros(2), np.cumsum(steps, axis=0)]),
        heading_rad=np.asarray(wrap_angle(heading)),
    )
    run = make_bare_run()
    samples = replace(run.samples, pose_sequence=np.zeros_like(run.samples.pose_sequence))
    return replace(run, poses=poses, samples=samples)


def move(run: Run, row: int, ahead_m: float = 0.0, turned_rad: float = 0.0) -> Run:
    """Return the run with all poses from a row on moved forward, and turned where they are."""
    xy_m, heading_rad = run.poses.xy_m.copy(), run.poses.heading_rad.copy()
    along = 0.5 * (heading_rad[row] + heading_rad[row - 1])
    xy_m[row:] += ahead_m * np.array([np.cos(along), np.sin(along)])
    heading_rad[row:] += turned_rad
    poses = replace(run.poses, xy_m=xy_m, heading_rad=wrap_angle(heading_rad))
    return replace(run, poses=poses)


def list_rows(run: Run) -> list[int]:
    return [jump.row for jump in find_jumps(run)]


def test_the_step_back_of_a_real_robot_is_found() -> None:
    run = read_run(find_shared("robots", "tb3"))
    (jump,) = find_jumps(run)
    assert jump.moved_m == pytest.approx(-0.00726, abs=1e-5)
    # It is where its odometry reports a turn rate of -143.6 rad/s.
    assert run.poses.measured_turn_rate_rad_s is not None
    assert jump.row == int(np.abs(run.poses.measured_turn_rate_rad_s).argmax())
    assert describe_breaks(run)["jumps"].startswith("1 jump, 0.00726 m back at 31.")


@pytest.mark.parametrize(
    ("parts", "jumps", "gaps"),
    [
        (("robots", "tf_only"), 0, 1),
        # It spins at 6.6 rad/s, and moves 1 cm aside in a single step.
        (("robots", "sim_time"), 1, 0),
        (("ros2", "turtlesim_jazzy"), 0, 3),
    ],
)
def test_other_real_robots_break_where_they_do(
    parts: tuple[str, ...], jumps: int, gaps: int
) -> None:
    run = read_run(find_shared(*parts))
    assert (len(find_jumps(run)), len(find_gaps(run))) == (jumps, gaps)


@pytest.mark.parametrize(("share", "is_found"), [(1.02, True), (0.98, False)])
@pytest.mark.parametrize("speed", [0.0, 0.2, 1.0, 5.0])
def test_what_exceeds_driving_is_a_jump_however_fast_that_is(
    speed: float, share: float, *, is_found: bool
) -> None:
    # Speeding up at 2 m/s2 for 75 ms and braking as long adds 11 mm; stamps may be 2 ms off.
    beyond_m = share * (2.0 * 0.075**2 + 0.002 * speed)
    run = move(make_robot(speed), 100, beyond_m)
    assert list_rows(run) == ([100] if is_found else [])
    if is_found and speed:
        (jump,) = find_jumps(run)
        assert jump.excess_m == pytest.approx(beyond_m, rel=0.02)
        assert jump.moved_m == pytest.approx(speed / 20.0 + beyond_m, rel=0.01)


@pytest.mark.parametrize(("noise_m", "least"), [(0.0, 1.0), (0.0005, 1.0), (0.005, 0.9)])
@pytest.mark.parametrize("hz", [10.0, 20.0, 50.0])
def test_corrections_of_a_tenth_of_a_metre_every_second_are_found(
    hz: float, noise_m: float, least: float
) -> None:
    random = np.random.default_rng(3)
    count = round(60 * hz)
    rows = np.arange(round(hz), count, round(hz))
    speed = 0.5 + 0.4 * np.sin(np.arange(count - 1) / hz)
    run = make_robot(speed, 0.3, count=count, hz=hz)
    xy_m = run.poses.xy_m + random.normal(0.0, noise_m, (count, 2))
    for row in rows:
        angle = random.uniform(-np.pi, np.pi)
        xy_m[row:] += 0.1 * np.array([np.cos(angle), np.sin(angle)])
    found = {*list_rows(replace(run, poses=replace(run.poses, xy_m=xy_m)))}
    assert len(found & {*rows.tolist()}) >= least * (len(rows) - 1)
    assert found <= {*rows.tolist()}


def test_jumps_are_ranked_by_what_exceeds_driving() -> None:
    # 0.1 m beyond 0.05 m of driving are a longer way than 0.12 m of a robot that stands.
    speed = np.repeat([1.0, 0.0], [100, 99])
    run = move(move(make_robot(speed), 50, 0.1), 150, 0.12)
    assert list_rows(run) == [50, 150]
    assert describe_breaks(run)["jumps"] == "2 jumps, the largest 0.12 m ahead at 7.5 s"
    alone = describe_breaks(move(make_robot(speed), 50, 0.1))["jumps"]
    assert alone == "1 jump, 0.15 m ahead at 2.5 s, 0.1 m more than it drove"


@pytest.mark.parametrize("turned_rad", [0.09, 0.5, -1.5, 3.0])
def test_a_jump_of_the_heading_alone_has_no_way(turned_rad: float) -> None:
    told = describe_breaks(move(make_robot(0.5), 100, turned_rad=turned_rad))["jumps"]
    assert told == f"1 jump, {np.degrees(turned_rad) + 0.286:+.3g} deg at 5.0 s"


def test_a_jump_that_turns_and_moves_has_its_way_along_the_heading_before_it() -> None:
    told = describe_breaks(move(make_robot(0.5, 0.0), 100, 0.3, 1.0))["jumps"]
    assert told == "1 jump, 0.325 m ahead and +57.3 deg at 5.0 s"


@pytest.mark.parametrize(("turned_rad", "aside"), [(0.09, 0.3 * 0.045), (0.11, 0.0)])
def test_a_jump_that_turns_little_has_its_way_along_the_mean_heading(
    turned_rad: float, aside: float
) -> None:
    (jump,) = find_jumps(move(make_robot(0.0, 0.0), 100, 0.3, turned_rad))
    assert abs(jump.aside_m) == pytest.approx(aside, rel=0.01, abs=1e-6)


def test_courses_of_a_receiver_that_backs_up_are_no_jumps() -> None:
    speed = np.repeat([1.0, -1.0], [100, 99])
    run = make_robot(speed, 0.0)
    heading_rad = np.where(np.arange(200) < 100, 0.0, -np.pi)
    run = replace(run, poses=replace(run.poses, heading_rad=heading_rad))
    assert list_rows(run) == [100]
    receiver = replace(run, origin=Origin(has_courses=True))
    assert not list_rows(receiver)
    told = describe_breaks(move(receiver, 50, 2.0))["jumps"]
    assert told == "1 jump, 2.05 m east at 2.5 s"


@pytest.mark.parametrize("seed", range(3))
def test_lost_messages_are_no_jumps(seed: int) -> None:
    random = np.random.default_rng(seed)
    rows = np.arange(1199) // 40
    speed = np.clip(np.cumsum(random.normal(0.0, 0.3, 30)), -1.0, 1.0)[rows]
    run = make_robot(speed, random.normal(0.0, 0.5, 30)[rows], count=1200)
    kept = random.random(1200) > 0.1
    noise_m = random.normal(0.0, 0.001, (1200, 2))
    poses = PoseColumns(
        time_ns=run.poses.time_ns[kept],
        xy_m=(run.poses.xy_m + noise_m)[kept],
        heading_rad=run.poses.heading_rad[kept],
    )
    assert list_rows(replace(run, poses=poses)) == []


def test_poses_that_are_published_several_times_do_not_jump() -> None:
    run = make_robot(2.0, count=600, hz=100.0)
    rows = np.arange(600) // 10 * 10
    poses = replace(run.poses, xy_m=run.poses.xy_m[rows], heading_rad=run.poses.heading_rad[rows])
    assert list_rows(replace(run, poses=poses)) == []


@pytest.mark.parametrize(("ahead_m", "is_found"), [(0.0115, True), (0.011, False)])
def test_what_a_robot_can_reach_from_rest_is_no_jump(ahead_m: float, *, is_found: bool) -> None:
    assert list_rows(move(make_robot(0.0, 0.0), 100, ahead_m)) == ([100] if is_found else [])


@pytest.mark.parametrize(("turned_rad", "is_found"), [(0.058, True), (0.055, False)])
def test_what_a_robot_can_turn_from_rest_is_no_jump(turned_rad: float, *, is_found: bool) -> None:
    run = move(make_robot(0.0, 0.0), 100, turned_rad=turned_rad)
    assert list_rows(run) == ([100] if is_found else [])


@pytest.mark.parametrize(("back", "is_found"), [(3.3, True), (2.7, False)])
def test_a_single_step_back_on_a_steady_way_is_a_jump(back: float, *, is_found: bool) -> None:
    # The way varies by 0.1 m/s around 0.2 m/s; a step back is off that by some times as much.
    speed = 0.2 + 0.05 * np.sin(np.arange(199))
    speed[100] = 0.2 - 0.1 * back
    assert list_rows(make_robot(speed)) == ([101] if is_found else [])


def test_two_steps_back_are_motion() -> None:
    speed = 0.2 + 0.05 * np.sin(np.arange(199))
    speed[100:102] = -0.3
    assert list_rows(make_robot(speed)) == []


def test_what_turtlesim_says_it_applied_is_no_jump() -> None:
    run = simulate_preset("plant-impulse")
    assert list_rows(run) == []
    poses = replace(run.poses, speed_m_s=None, turn_rate_rad_s=None)
    assert list_rows(replace(run, poses=poses)) != []


@pytest.mark.parametrize(("steps", "is_found"), [(4.1, True), (3.9, False)])
def test_a_long_step_in_time_is_a_gap(steps: float, *, is_found: bool) -> None:
    run = make_robot()
    time_ns = run.poses.time_ns.copy()
    time_ns[100:] += round((steps - 1.0) * 50_000_000)
    run = replace(run, poses=replace(run.poses, time_ns=time_ns))
    assert [gap.row for gap in find_gaps(run)] == ([100] if is_found else [])
    assert ("gaps" in describe_breaks(run)) == is_found


@pytest.mark.parametrize(("every", "gaps"), [(17, 0), (21, 9)])
def test_steps_that_are_usual_are_no_gaps(every: int, gaps: int) -> None:
    run = make_robot()
    time_ns = run.poses.time_ns + np.arange(200) // every * 400_000_000
    assert len(find_gaps(replace(run, poses=replace(run.poses, time_ns=time_ns)))) == gaps


def test_clean_robots_have_neither() -> None:
    random = np.random.default_rng(5)
    found: list[Any] = []
    for number in range(60):
        count = int(random.integers(20, 1500))
        hz = float(random.choice([5.0, 10.0, 20.0, 50.0]))
        rows = np.arange(count - 1) // round(2.0 * hz)
        speed, turn_rate = random.uniform(-0.5, 1.0, 900)[rows], random.normal(0.0, 1.0, 900)[rows]
        run = make_robot(speed, turn_rate, count=count, hz=hz)
        draw = (random.normal, random.laplace, random.uniform)[number % 3]
        noise = draw(-1.0, 1.0, (count, 3)) * 10.0 ** random.uniform(-6.0, -2.0)
        jitter_ns = np.rint(random.uniform(0.0, 0.2, count) * 1e9 / hz).astype(np.int64)
        poses = PoseColumns(
            time_ns=run.poses.time_ns + jitter_ns,
            xy_m=run.poses.xy_m + noise[:, :2],
            heading_rad=wrap_angle(run.poses.heading_rad + noise[:, 2]),
        )
        found += describe_breaks(replace(run, poses=poses)).values()
    assert found == []


@pytest.mark.parametrize("count", [1, 2, 3, 5])
def test_few_poses_do_not_break(count: int) -> None:
    assert describe_breaks(make_robot(0.2, count=count)) == {}


def stray(run: Run, rows: Any, aside_m: float) -> Run:
    """Return the run with single poses off to the side, back at the next one."""
    xy_m = run.poses.xy_m.copy()
    xy_m[rows, 1] += aside_m
    return replace(run, poses=replace(run.poses, xy_m=xy_m))


def test_a_pose_that_strays_is_two_jumps() -> None:
    run = stray(make_robot(turn_rate=0.0), [100], 1.0)
    assert list_rows(run) == [100, 101]
    assert describe_breaks(run)["jumps"].startswith("2 jumps, the largest ")


@pytest.mark.parametrize(("every", "are_found"), [(21, True), (19, False)])
def test_poses_that_stray_all_the_time_are_noise(every: int, *, are_found: bool) -> None:
    """Two steps of 21 are 9.5 % of all, two of 19 are 10.5 %."""
    run = stray(make_robot(turn_rate=0.0, count=900), slice(20, 880, every), 1.0)
    assert bool(list_rows(run)) is are_found


@pytest.mark.parametrize(("size", "are_found"), [(7.0, False), (20.0, True)])
def test_poses_that_stray_among_noisy_ones_are_found(size: float, *, are_found: bool) -> None:
    """At 10 Hz some stray side by side or with one pose between; `size` is in the noise."""
    run = make_robot(0.3, 0.0, count=400, hz=10.0)
    noise_m = np.random.default_rng(1).normal(0.0, 0.08, run.poses.xy_m.shape)
    run = replace(run, poses=replace(run.poses, xy_m=run.poses.xy_m + noise_m))
    strays = [40, 90, 91, 150, 152, 220, 301, 350]
    steps = {row + place for row in strays for place in (0, 1)} - {91}
    assert set(list_rows(stray(run, strays, size * 0.08))) == (steps if are_found else set())


@pytest.mark.parametrize("speed", [0.0, 0.2])
@pytest.mark.parametrize("hz", [10.0, 50.0])
def test_noise_of_poses_strays_nowhere(speed: float, hz: float) -> None:
    for seed in range(20):
        run = make_robot(speed, 0.0, count=2000, hz=hz)
        noise_m = np.random.default_rng(seed).normal(0.0, 0.02, run.poses.xy_m.shape)
        run = replace(run, poses=replace(run.poses, xy_m=run.poses.xy_m + noise_m))
        assert list_rows(run) == []
