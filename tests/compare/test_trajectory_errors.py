import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import turtlelog as tl
from tests.compare.trajectories import STEP_NS, disturb, make_alignment, make_trajectory
from turtlelog.compare import (
    ErrorStatistics,
    TrajectoryComparison,
    TrajectorySettings,
    compare_trajectories,
    parse_delta,
)
from turtlelog.compare.trajectory_errors import (
    align_trajectory,
    associate_trajectories,
    build_rotations,
    choose_pairs,
    find_alignment,
    summarise_errors,
    take_poses,
)
from turtlelog.errors import CompareError
from turtlelog.run.angles import Trajectory, build_planar_trajectory, find_quaternions

TRUTH = make_trajectory()


def compare(
    estimate: Trajectory, reference: Trajectory = TRUTH, **settings: Any
) -> TrajectoryComparison:
    return compare_trajectories(reference, estimate, TrajectorySettings(**settings))


def find(found: TrajectoryComparison, kind: str) -> ErrorStatistics:
    statistics = found.find_error(kind, "position")
    assert statistics is not None
    return statistics


def drive_straight(way_m: float, count: int = 101, turned_rad: float = 0.0) -> Trajectory:
    run = tl.simulate_run(
        tl.override_scenario(tl.load_scenario("paper-kp1"), {"max_duration_s": 0.1})
    )
    planar = build_planar_trajectory(run)
    time_ns = np.arange(count, dtype=np.int64) * STEP_NS
    x_m = np.linspace(0.0, way_m, count)
    half_rad = np.linspace(0.0, turned_rad, count) / 2.0
    none = np.zeros(count)
    return replace(
        planar,
        name=f"{way_m:g}",
        time_ns=time_ns,
        xyz_m=np.column_stack([x_m, none, none]),
        orientation_quat_wxyz=np.column_stack([np.cos(half_rad), none, none, np.sin(half_rad)]),
    )


@pytest.mark.parametrize(("align", "scale"), [("se3", 1.0), ("sim3", 1.3), ("sim3", 0.2)])
def test_alignment_undoes_a_transformation(align: str, scale: float) -> None:
    moved = align_trajectory(TRUTH, make_alignment(scale=1.0 / scale))
    found = compare(moved, align=align)
    assert found.absolute.position_m.max() < 1e-13
    assert found.absolute.rotation_rad.max() < 1e-13
    assert found.alignment.scale == pytest.approx(scale, abs=1e-14)


def test_alignment_in_the_plane_compares_heading_and_leaves_the_height_out() -> None:
    moved = align_trajectory(TRUTH, make_alignment(planar=True))
    raised = replace(moved, xyz_m=moved.xyz_m + np.array([0.0, 0.0, 5.0]))
    found = compare(raised, align="se2")
    assert found.space == "plane"
    assert found.absolute.position_m.max() < 1e-13
    assert found.absolute.rotation_rad.max() < 1e-13
    assert compare(raised, align="none").before_m > 5.0


def test_no_other_rotation_or_shift_is_better_than_the_alignment() -> None:
    estimate = disturb(TRUTH)
    best = find(compare(estimate, align="se3"), "ate").rmse
    truth = take_poses(TRUTH, np.searchsorted(TRUTH.time_ns, estimate.time_ns))
    found = find_alignment(truth.xyz_m, estimate.xyz_m, dimensions=3, scales=False)
    for column in range(3):
        for step in (-1e-3, 1e-3):
            shift_m = found.translation_m + step * np.eye(3)[column]
            other = align_trajectory(estimate, replace(found, translation_m=shift_m))
            apart_m = np.linalg.norm(other.xyz_m - truth.xyz_m, axis=1)
            assert summarise_errors(apart_m).rmse > best


def test_a_mirrored_estimate_is_rotated_and_not_mirrored_back() -> None:
    found = compare(replace(TRUTH, xyz_m=TRUTH.xyz_m * [1.0, 1.0, -1.0]), align="se3")
    assert np.linalg.det(found.alignment.rotation) == pytest.approx(1.0)
    assert find(found, "ate").rmse > 0.01


def test_noise_of_an_estimate_makes_no_relative_motion_shorter() -> None:
    random = np.random.default_rng(1)
    straight = drive_straight(10.0)
    noisy = replace(straight, xyz_m=straight.xyz_m + random.normal(0.0, 0.2, (101, 3)))
    found = compare(noisy, straight, align="none", deltas=(parse_delta("0.95m"),))
    assert find(found, "rpe").count == 10


def test_statistics_are_those_of_the_population() -> None:
    found = summarise_errors(np.array([3.0, 4.0, 5.0, 4.0]))
    assert (found.mean, found.median, found.min, found.max, found.sse) == (4.0, 4.0, 3.0, 5.0, 66.0)
    assert found.rmse == pytest.approx(math.sqrt(16.5))
    assert found.std == pytest.approx(math.sqrt(0.5))


def test_relative_error_of_a_scale_is_that_share_of_the_way() -> None:
    found = compare(
        drive_straight(11.0), drive_straight(10.0), align="none", deltas=(parse_delta("0.95m"),)
    )
    error = find(found, "rpe")
    assert error.count == 10
    assert error.rmse == pytest.approx(0.1, abs=1e-9)


@pytest.mark.parametrize(
    ("delta", "count"), [("1s", 5), ("10frames", 10), ("0.5m", 20), ("9deg", 10), ("1000frames", 0)]
)
def test_pairs_follow_each_other_by_frames_metres_angle_and_time(delta: str, count: int) -> None:
    trajectory = drive_straight(10.0 + 1e-9, turned_rad=math.radians(90.0 + 1e-6))
    parsed = parse_delta(delta)
    first, second = choose_pairs(trajectory, parsed.value, parsed.unit)
    assert len(first) == count
    assert (first[1:] == second[:-1]).all()


def test_pairs_begin_at_every_pose_where_they_may_overlap() -> None:
    trajectory = drive_straight(10.0)
    for delta in (parse_delta("10frames"), parse_delta("0.5s")):
        first, second = choose_pairs(trajectory, delta.value, delta.unit, overlaps=True)
        assert first.tolist() == list(range(91))
        assert (second - first == 10).all()


def test_a_motion_over_a_gap_is_no_motion_of_a_second() -> None:
    whole = drive_straight(10.0)
    cut = take_poses(whole, np.r_[0:31, 75:101])
    first, second = choose_pairs(cut, 1.0, "s")
    assert ((cut.time_ns[second] - cut.time_ns[first]) == 1_000_000_000).all()
    assert len(first) == 2


def find_matrices(trajectory: Trajectory) -> NDArray[np.float64]:
    """Return the poses as homogeneous matrices, shape (n, 4, 4)."""
    matrices = np.tile(np.eye(4), (len(trajectory), 1, 1))
    matrices[:, :3, :3] = build_rotations(trajectory.orientation_quat_wxyz)
    matrices[:, :3, 3] = trajectory.xyz_m
    return matrices


@pytest.mark.parametrize("overlaps", [False, True])
@pytest.mark.parametrize("delta", ["0.5s", "1s", "10frames"])
def test_relative_errors_are_those_of_the_definition(delta: str, *, overlaps: bool) -> None:
    # Sturm et al., 2012: E_i = (Q_i^-1 Q_j)^-1 (P_i^-1 P_j); j is half a second or a second later.
    random = np.random.default_rng(2)
    turns = TRUTH.orientation_quat_wxyz + random.normal(0.0, 0.01, (len(TRUTH), 4))
    estimate = replace(
        TRUTH,
        xyz_m=TRUTH.xyz_m + random.normal(0.0, 0.02, (len(TRUTH), 3)),
        orientation_quat_wxyz=turns / np.linalg.norm(turns, axis=1, keepdims=True),
    )
    steps = 20 if delta == "1s" else 10
    firsts = np.arange(0, len(TRUTH) - steps, 1 if overlaps else steps)
    true, found = find_matrices(TRUTH), find_matrices(estimate)
    motions = [np.linalg.inv(one[firsts]) @ one[firsts + steps] for one in (true, found)]
    errors = np.linalg.inv(motions[0]) @ motions[1]
    cosine = (np.trace(errors[:, :3, :3], axis1=1, axis2=2) - 1.0) / 2.0
    rows = compare(estimate, align="none", deltas=(parse_delta(delta),), overlaps=overlaps)
    expected = np.linalg.norm(errors[:, :3, 3], axis=1)
    statistics = find(rows, "rpe")
    assert statistics.count == len(firsts)
    assert statistics.rmse == pytest.approx(np.sqrt(np.mean(expected**2)), rel=1e-12)
    assert statistics.max == pytest.approx(expected.max(), rel=1e-12)
    turned = rows.find_error("rpe", "rotation")
    assert turned is not None
    assert turned.mean == pytest.approx(np.arccos(cosine).mean(), rel=1e-8)


def test_the_nearest_pose_is_taken_up_to_the_largest_difference() -> None:
    late = replace(TRUTH, time_ns=TRUTH.time_ns + 10_000_000)
    assert len(compare(late, most_apart_s=0.010).estimate) == len(TRUTH)
    with pytest.raises(CompareError, match=r"0 poses within 0.009 s .* larger --max-difference"):
        compare(late, most_apart_s=0.009)


def test_interpolation_meets_a_straight_way_and_a_steady_turn_exactly() -> None:
    whole = drive_straight(10.0, turned_rad=3.0)
    halves = take_poses(whole, np.arange(0, 101, 2))
    odd = take_poses(whole, np.arange(21, 60, 4))
    pair = associate_trajectories(halves, odd, most_apart_ns=STEP_NS, interpolates=True)
    assert np.abs(pair.reference.xyz_m - odd.xyz_m).max() < 1e-14
    assert np.abs(pair.reference.orientation_quat_wxyz - odd.orientation_quat_wxyz).max() < 1e-14


def test_nothing_is_extrapolated() -> None:
    late = replace(TRUTH, time_ns=TRUTH.time_ns + 5_000_000)
    assert len(compare(late, interpolates=True).estimate) == len(TRUTH) - 1


def test_quaternions_of_matrices_lose_no_digits_near_half_a_turn() -> None:
    for axis in np.vstack([np.eye(3), [[0.6, 0.8, 0.0]]]):
        for angle in (0.0, 1e-9, 3.0, math.pi - 1e-9, math.pi):
            cross = np.cross(np.eye(3), axis)
            rotation = np.eye(3) - math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross
            w, *xyz = find_quaternions(rotation[None])[0]
            turned = 2.0 * math.atan2(np.linalg.norm(xyz), abs(w))
            assert turned == pytest.approx(angle, abs=1e-15)


@pytest.mark.parametrize("align", ["se3", "sim3", "se2", "sim2"])
def test_an_estimate_that_stands_still_is_not_aligned(align: str) -> None:
    still = replace(TRUTH, xyz_m=np.tile([1e4, 2.0, 3.0], (len(TRUTH), 1)))
    with pytest.raises(CompareError, match=r"the estimate stands still, .* by origin or none"):
        compare(still, align=align)
    assert find(compare(still, align="none"), "ate").rmse > 9e3


def test_a_straight_line_leaves_a_rotation_in_space_open_but_not_in_the_plane() -> None:
    straight = replace(drive_straight(10.0), space="space")
    with pytest.raises(CompareError, match=r"lie on one line, .* by se2 or none"):
        compare(straight, straight, align="se3")
    assert find(compare(straight, straight, align="se2"), "ate").rmse < 1e-12


def test_an_alignment_that_explains_little_is_called_weak() -> None:
    random = np.random.default_rng(3)
    shaken = {
        share: replace(TRUTH, xyz_m=TRUTH.xyz_m + random.normal(0.0, share, TRUTH.xyz_m.shape))
        for share in (0.2, 4.0)
    }
    assert not compare(shaken[0.2]).notes
    assert "The alignment is weak" in compare(shaken[4.0]).notes[0]


def test_planar_poses_are_compared_in_the_plane() -> None:
    planar = replace(drive_straight(5.0), time_ns=TRUTH.time_ns[:101].copy())
    found = compare(planar, align="none")
    assert found.space == "plane"
    assert "x, y and heading alone" in found.notes[-1]
    with pytest.raises(CompareError, match=r"cannot be aligned in SE3; take se2"):
        compare(planar, align="se3")


def test_few_poses_and_times_that_do_not_meet_are_refused() -> None:
    early = replace(TRUTH, time_ns=TRUTH.time_ns - 10**12)
    with pytest.raises(CompareError, match=r"do not overlap: .*--time-offset start"):
        compare(early)
    assert find(compare(early, offset_s=None), "ate").rmse < 1e-12
    assert find(compare(early, offset_s=1000.0), "ate").rmse < 1e-12
    two = take_poses(TRUTH, np.arange(2))
    with pytest.raises(CompareError, match=r"2 poses within .* but 3 are needed"):
        compare(two)
    assert compare(take_poses(TRUTH, np.arange(3)), align="origin").poses == (3, 120)


@pytest.mark.parametrize("text", ["1", "m", "0m", "-1m", "1x", "1.5frames", "nan m", "1e3m"])
def test_a_delta_needs_a_length_and_a_unit(text: str) -> None:
    with pytest.raises(CompareError, match="must be a"):
        parse_delta(text)


def test_a_delta_longer_than_the_way_says_how_long_that_is() -> None:
    with pytest.raises(
        CompareError, match=r"no relative motion of 1000 m: .* cover .* m and 5.95 s and turn"
    ):
        compare(TRUTH, deltas=(parse_delta("1000m"),))


def test_numbered_poses_have_no_seconds() -> None:
    numbered = replace(TRUTH, clock="frame")
    with pytest.raises(CompareError, match="has no times, but truth has; --times FILE"):
        compare(numbered)
    with pytest.raises(CompareError, match="no relative motions in s"):
        compare(numbered, numbered, deltas=(parse_delta("1s"),))


@pytest.mark.parametrize(("lost", "is_told"), [(9, True), (8, False)])
def test_time_without_pairs_is_told_from_a_hundredth_of_the_duration_on(
    *, lost: int, is_told: bool
) -> None:
    """Of 50 s, the gap is 0.50 or 0.45 s."""
    truth = make_trajectory(1000)
    rows = np.delete(np.arange(1000), np.arange(400, 400 + lost))
    found = compare(replace(take_poses(truth, rows), name="estimate"), truth)
    told = [note for note in found.notes if note.startswith("No poses are compared for ")]
    assert bool(told) is is_told
    if told:
        assert told[0].startswith("No poses are compared for 0.5 s, from 19.9 s after the first:")
    assert len(found.reference) == 1000 - lost
    assert len(found.whole_reference) == 1000


@pytest.mark.parametrize(("lost", "is_told"), [(10, True), (9, False)])
def test_time_before_and_after_the_pairs_is_told_from_a_hundredth_on(
    *, lost: int, is_told: bool
) -> None:
    """Of 50 s, 0.50 or 0.45 s are lost, some at either end."""
    truth = make_trajectory(1001)
    part = replace(take_poses(truth, np.arange(4, 1001 - (lost - 4))), name="part")
    for pair in ((part, truth), (replace(truth, name="truth"), replace(part, name="part"))):
        found = compare(*pair)
        told = [note for note in found.notes if note.startswith("The compared poses cover ")]
        assert bool(told) is is_told
        if told:
            assert len(told) == 1
            assert told[0].startswith("The compared poses cover 49.5 s of the 50 s of truth:")


def test_the_whole_reference_ends_with_the_compared_times() -> None:
    truth = make_trajectory(200)
    found = compare(take_poses(truth, np.arange(20, 120, 2)), truth)
    assert found.whole_reference.time_ns.tolist() == truth.time_ns[20:119].tolist()
