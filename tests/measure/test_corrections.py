"""Corrections of poses: found in noise, and nothing else taken for one."""

from typing import Any, Final

import numpy as np
import pytest
from numpy.typing import NDArray

from turtlelog.measure.breaks import find_corrections
from turtlelog.run import PoseColumns
from turtlelog.run.angles import wrap_angle

Values = NDArray[np.float64]

_DURATION_S: Final = 60.0
_FINE_S: Final = 0.005


def drive(random: np.random.Generator, *, turns: bool, acceleration: float) -> list[Values]:
    """Return time [s], x, y [m] and heading [rad] of a robot that stops, drives and turns."""
    count = round(_DURATION_S / _FINE_S)
    speed, rate = np.zeros(count), np.zeros(count)
    begin = round(random.uniform(0.5, 2.0) / _FINE_S)
    while begin < count:
        end = begin + round(random.uniform(1.0, 5.0) / _FINE_S)
        speed[begin:end] = random.choice([0.0, 0.5, 0.5 * random.uniform(0.2, 1.0)])
        rate[begin:end] = random.choice([0.0, random.uniform(-0.8, 0.8)]) if turns else 0.0
        begin = end
    speed, rate = limit(speed, acceleration * _FINE_S), limit(rate, 4.0 * acceleration * _FINE_S)
    heading = np.r_[0.0, np.cumsum(rate[:-1]) * _FINE_S]
    x, y = (np.cumsum(speed * of(heading)) * _FINE_S for of in (np.cos, np.sin))
    return [np.arange(count) * _FINE_S, x, y, heading]


def limit(wanted: Values, step: float) -> Values:
    if np.isinf(step):
        return wanted
    values, now = np.empty_like(wanted), 0.0
    for row, target in enumerate(wanted.tolist()):
        now += min(max(target - now, -step), step)
        values[row] = now
    return values


def make_poses(
    seed: int,
    *,
    hz: float,
    noise_m: float = 0.0,
    size_m: float = 0.0,
    turns: bool = True,
    acceleration: float = 1.0,
    jitter: float = 0.0,
    noise: str = "normal",
) -> tuple[PoseColumns, set[int]]:
    """Return poses of a drive, with a correction every second, and the steps that are these."""
    random = np.random.default_rng(seed)
    fine_s, *places = drive(random, turns=turns, acceleration=acceleration)
    time_s = np.arange(0.0, _DURATION_S - 0.1, 1.0 / hz)
    time_s += random.uniform(0.0, jitter / hz, len(time_s))
    x, y, heading = (np.interp(time_s, fine_s, place) for place in places)
    scatter = np.column_stack([x, y, heading])
    scatter += getattr(random, noise)(0.0, noise_m, scatter.shape) if noise_m else 0.0
    steps = set()
    for at_s in np.arange(1.5, _DURATION_S - 1.5) + random.uniform(-0.2, 0.2) if size_m else ():
        row, angle = int(np.searchsorted(time_s, at_s)), random.uniform(-np.pi, np.pi)
        scatter[row:, :2] += size_m * np.array([np.cos(angle), np.sin(angle)])
        steps.add(row - 1)
    poses = PoseColumns(
        time_ns=np.rint(time_s * 1e9).astype(np.int64),
        xy_m=scatter[:, :2].copy(),
        heading_rad=np.asarray(wrap_angle(scatter[:, 2])),
    )
    return poses, steps


def count(seeds: range, **options: Any) -> tuple[float, int]:
    """Return the share of corrections that is found, and how many others are."""
    found = total = others = 0
    for seed in seeds:
        poses, steps = make_poses(seed, **options)
        rows = {*np.flatnonzero(find_corrections(poses)).tolist()}
        found, total = found + len(rows & steps), total + len(steps)
        others += len(rows - steps)
    return found / total, others


@pytest.mark.parametrize("turns", [False, True], ids=["straight", "curved"])
@pytest.mark.parametrize(
    ("hz", "size_m", "noise_m", "least"),
    [
        (10.0, 0.1, 0.005, 0.9),
        (10.0, 0.05, 0.002, 0.9),
        (10.0, 0.2, 0.01, 0.9),
        (20.0, 0.1, 0.005, 0.98),
        (50.0, 0.05, 0.002, 0.98),
        (50.0, 0.1, 0.005, 0.98),
        (5.0, 0.2, 0.005, 0.85),
    ],
)
def test_corrections_are_found_in_noise(
    hz: float, size_m: float, noise_m: float, least: float, *, turns: bool
) -> None:
    share, others = count(range(2), hz=hz, size_m=size_m, noise_m=noise_m, turns=turns)
    assert share >= least
    assert others == 0


_DRIVES: Final[dict[str, dict[str, Any]]] = {
    "usual": {},
    "at once": {"acceleration": np.inf},
    "slow": {"acceleration": 0.3},
    "hard": {"acceleration": 3.0},
    "late": {"jitter": 0.2},
    "Laplace": {"noise": "laplace"},
}


def count_false(runs: int, **options: Any) -> int:
    """Return how many runs without a correction have one found."""
    return sum(
        bool(find_corrections(make_poses(seed, **options)[0]).any())
        for seed in range(1000, 1000 + runs)
    )


@pytest.mark.parametrize("drive", _DRIVES)
def test_runs_without_corrections_have_none(drive: str) -> None:
    assert count_false(1, hz=10.0, noise_m=0.005, **_DRIVES[drive]) == 0
    assert count_false(1, hz=50.0, noise_m=0.002, **_DRIVES[drive]) == 0
    assert count_false(1, hz=20.0, noise_m=0.0, **_DRIVES[drive]) == 0


@pytest.mark.thorough
@pytest.mark.parametrize("drive", _DRIVES)
@pytest.mark.parametrize("noise_m", [0.0, 0.002, 0.005, 0.01])
@pytest.mark.parametrize("hz", [5.0, 10.0, 20.0, 50.0])
def test_one_run_in_a_hundred_without_corrections_has_one(
    hz: float, noise_m: float, drive: str
) -> None:
    """100 drives a case take 5 to 20 s: the rate of false alarms is the subject."""
    assert count_false(100, hz=hz, noise_m=noise_m, **_DRIVES[drive]) <= 1


def make_straight(speed: Values, *, hz: float = 20.0) -> PoseColumns:
    way = np.r_[0.0, np.cumsum(speed / hz)]
    return PoseColumns(
        time_ns=np.arange(len(way)) * round(1e9 / hz),
        xy_m=np.column_stack([way, np.zeros(len(way))]),
        heading_rad=np.zeros(len(way)),
    )


def list_steps(poses: PoseColumns) -> list[int]:
    return [int(step) for step in np.flatnonzero(find_corrections(poses))]


@pytest.mark.parametrize(("share", "is_found"), [(0.37, True), (0.43, False)])
@pytest.mark.parametrize("place", [-2, -1, 1, 2])
def test_a_peak_of_the_speed_takes_several_steps(
    share: float, place: int, *, is_found: bool
) -> None:
    speed = np.full(100, 0.3)
    speed[50] += 1.0
    speed[50 + place] += share
    assert list_steps(make_straight(speed)) == ([50] if is_found else [])


@pytest.mark.parametrize(("aside_m", "is_found"), [(0.0029, True), (0.0027, False)])
def test_a_robot_on_wheels_hardly_moves_aside(aside_m: float, *, is_found: bool) -> None:
    # A quarter of 11 mm.
    poses = make_straight(np.full(100, 0.0))
    xy_m = poses.xy_m.copy()
    xy_m[51:, 1] += aside_m
    moved = PoseColumns(time_ns=poses.time_ns, xy_m=xy_m, heading_rad=poses.heading_rad)
    assert list_steps(moved) == ([50] if is_found else [])


def test_a_pose_that_strays_and_returns_is_no_correction() -> None:
    poses = make_straight(np.full(100, 0.3))
    xy_m = poses.xy_m.copy()
    xy_m[51, 1] += 0.2
    strayed = PoseColumns(time_ns=poses.time_ns, xy_m=xy_m, heading_rad=poses.heading_rad)
    assert list_steps(strayed) == []


@pytest.mark.parametrize("acceleration", [0.5, 1.0, 2.0, 50.0])
@pytest.mark.parametrize("hz", [5.0, 20.0, 50.0])
def test_starts_and_stops_are_no_corrections(acceleration: float, hz: float) -> None:
    time_s = np.arange(0.0, 20.0, 1.0 / hz)
    wanted = np.where((time_s % 4.0) < 2.0, 0.5, 0.0)
    assert list_steps(make_straight(limit(wanted, acceleration / hz), hz=hz)) == []


def test_stamps_of_whole_milliseconds_are_no_corrections() -> None:
    """A timer of 16 ms that fires after 15 or 16 ms, of a robot at 2 m/s."""
    time_s = np.arange(0.0, 30.0, 0.016)
    poses = make_straight(np.full(len(time_s) - 1, 2.0), hz=62.5)
    time_ns = (np.floor(time_s * 1e3 + 0.3 * np.sin(time_s)) * 1e6).astype(np.int64)
    late = PoseColumns(time_ns=time_ns, xy_m=poses.xy_m, heading_rad=poses.heading_rad)
    assert list_steps(late) == []


@pytest.mark.parametrize("length", range(14))
def test_few_poses_have_no_correction(length: int) -> None:
    if length:
        assert list_steps(make_straight(np.full(length - 1, 0.3))) == []
