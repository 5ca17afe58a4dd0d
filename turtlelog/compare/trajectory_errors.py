"""Absolute and relative errors between two trajectories: association, alignment, statistics.

Sources:

- ATE and RPE: J. Sturm, N. Engelhard, F. Endres, W. Burgard, D. Cremers, "A Benchmark for the
  Evaluation of RGB-D SLAM Systems", IROS 2012, section V.
- Alignment: S. Umeyama, "Least-Squares Estimation of Transformation Parameters Between Two Point
  Patterns", IEEE PAMI 13(4), 1991, equations 34 to 43.
- Interpolation of rotations: K. Shoemake, "Animating Rotation with Quaternion Curves", SIGGRAPH
  1985 (slerp).
- Choice of these errors: Z. Zhang, D. Scaramuzza, "A Tutorial on Quantitative Trajectory Evaluation
  for Visual(-Inertial) Odometry", IROS 2018.
"""

from dataclasses import dataclass, replace
from typing import Final, Literal, NamedTuple

import numpy as np

from turtlelog.measure.reductions import Rows, Values
from turtlelog.run.angles import Trajectory, find_quaternions, subtract_headings
from turtlelog.run.columns import PoseColumns

DeltaUnit = Literal["frames", "m", "deg", "s"]

_LEAST_SPREAD: Final = 1e-9
"""Singular value, as a share of the largest, from which points span a direction. Text with six
decimals gives 1e-7 for a path of 10 m, which is data; rounding of doubles gives 1e-16."""

_MOST_OFF: Final = 0.75
"""Largest deviation of a pair in time from its delta, in usual steps. The nearest of evenly spaced
poses deviates by at most half a step; the pose before a gap or the end by one step or more."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorStatistics:
    """Statistics of an error over poses or pairs, in the unit of the error.

    Attributes:
        count: Number of errors.
        rmse: Root mean square.
        mean: Mean.
        median: Median.
        std: Standard deviation about the mean, of this population: divided by `count`.
        min: Smallest.
        max: Largest.
        sse: Sum of squares, in the unit squared.
    """

    count: int
    rmse: float
    mean: float
    median: float
    std: float
    min: float
    max: float
    sse: float


class DegenerateError(ValueError):
    """Points that do not determine an alignment. The message names the missing direction."""


class StandstillError(DegenerateError):
    """Points that determine no alignment because they are all in one place."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Alignment:
    """Rotation matrix, then translation, of a scaled estimate into the frame of its reference."""

    rotation: Values
    translation_m: Values
    scale: float = 1.0


def summarise_errors(errors: Values) -> ErrorStatistics:
    """Return the statistics of at least one error."""
    return ErrorStatistics(
        count=len(errors),
        rmse=float(np.sqrt((errors**2).mean())),
        mean=float(errors.mean()),
        median=float(np.median(errors)),
        std=float(errors.std()),
        min=float(errors.min()),
        max=float(errors.max()),
        sse=float((errors**2).sum()),
    )


class Associated(NamedTuple):
    """Two trajectories of equal length whose rows belong together."""

    reference: Trajectory
    estimate: Trajectory


def associate_trajectories(
    reference: Trajectory, estimate: Trajectory, *, most_apart_ns: int, interpolates: bool
) -> Associated:
    """Return the poses of both trajectories at the times of the one with fewer poses.

    Each of these poses (with equally many, those of the estimate) is paired with the other
    trajectory's nearest pose in time, or with the earlier of two equally near ones. A pose whose
    nearest partner is further than `most_apart_ns` is left out. With interpolation, the other
    trajectory is then interpolated at these times: the position linearly, the rotation along the
    shortest arc (slerp). Times outside the other trajectory are left out, because nothing is
    extrapolated.
    """
    is_estimate_longer = len(estimate) > len(reference)
    short, long = (reference, estimate) if is_estimate_longer else (estimate, reference)
    nearest = _find_nearest(short.time_ns, long.time_ns)
    is_near = np.abs(long.time_ns[nearest] - short.time_ns) <= most_apart_ns
    if interpolates:
        is_near &= (short.time_ns >= long.time_ns[0]) & (short.time_ns <= long.time_ns[-1])
    kept = take_poses(short, np.flatnonzero(is_near))
    if interpolates:
        partner = _interpolate(long, kept.time_ns)
    else:
        partner = _take_at(long, nearest[is_near], kept.time_ns)
    if is_estimate_longer:
        return Associated(kept, partner)
    return Associated(partner, kept)


def _find_nearest(time_ns: Rows, among_ns: Rows) -> Rows:
    after = np.minimum(np.searchsorted(among_ns, time_ns), len(among_ns) - 1)
    before = np.maximum(after - 1, 0)
    is_after = np.abs(among_ns[after] - time_ns) < np.abs(time_ns - among_ns[before])
    return np.where(is_after, after, before)


def take_poses(trajectory: Trajectory, rows: Rows) -> Trajectory:
    """Return some of the poses, in rising order."""
    return _take_at(trajectory, rows, trajectory.time_ns[rows])


def _take_at(trajectory: Trajectory, rows: Rows, time_ns: Rows) -> Trajectory:
    return replace(
        trajectory,
        time_ns=time_ns.copy(),
        xyz_m=trajectory.xyz_m[rows],
        orientation_quat_wxyz=trajectory.orientation_quat_wxyz[rows],
    )


def _interpolate(trajectory: Trajectory, time_ns: Rows) -> Trajectory:
    if len(trajectory) == 1:
        return _take_at(trajectory, np.zeros(len(time_ns), dtype=np.int64), time_ns)
    after = np.clip(np.searchsorted(trajectory.time_ns, time_ns), 1, len(trajectory) - 1)
    before = after - 1
    step_ns = trajectory.time_ns[after] - trajectory.time_ns[before]
    share = ((time_ns - trajectory.time_ns[before]) / step_ns)[:, None]
    xyz_m = trajectory.xyz_m
    turns = trajectory.orientation_quat_wxyz
    return replace(
        trajectory,
        time_ns=time_ns.copy(),
        xyz_m=xyz_m[before] + share * (xyz_m[after] - xyz_m[before]),
        orientation_quat_wxyz=_slerp(turns[before], turns[after], share),
    )


def _slerp(first: Values, second: Values, share: Values) -> Values:
    """Return rotations at a fraction of the shortest arc, shape (n, 4)."""
    second = np.where((first * second).sum(axis=1, keepdims=True) < 0.0, -second, second)
    # From the chord: the cosine of a small angle has lost its digits.
    chord = np.linalg.norm(second - first, axis=1, keepdims=True)
    sum_ = np.linalg.norm(second + first, axis=1, keepdims=True)
    angle = 2.0 * np.arctan2(chord, sum_)
    is_turn = angle > 0.0
    sine = np.where(is_turn, np.sin(angle), 1.0)
    weight = np.where(is_turn, np.sin((1.0 - share) * angle) / sine, 1.0 - share)
    other = np.where(is_turn, np.sin(share * angle) / sine, share)
    found = weight * first + other * second
    return np.asarray(found / np.linalg.norm(found, axis=1, keepdims=True))


def find_alignment(
    reference_m: Values, estimate_m: Values, *, dimensions: Literal[2, 3], scales: bool
) -> Alignment:
    """Return the least-squares alignment of an estimate to its reference (Umeyama 1991).

    With 2 dimensions, the alignment is a rotation about the vertical and a translation in the
    plane; with 3, any rotation and translation. `scales`: the scale is estimated too.

    Raises:
        DegenerateError: If the points leave the rotation or the scale undetermined.
    """
    ours, theirs = estimate_m[:, :dimensions], reference_m[:, :dimensions]
    our_mean, their_mean = ours.mean(axis=0), theirs.mean(axis=0)
    ours, theirs = ours - our_mean, theirs - their_mean
    covariance = theirs.T @ ours / len(ours)
    left, singular, right = np.linalg.svd(covariance)
    sizes = [float(np.sqrt((one**2).sum(axis=1).mean())) for one in (theirs, ours)]
    _require_spread(singular, sizes, [their_mean, our_mean])
    signs = np.ones(dimensions)
    if np.linalg.det(left) * np.linalg.det(right) < 0.0:
        signs[-1] = -1.0  # equation 39: a rotation, not a reflection
    rotation, shift_m = np.eye(3), np.zeros(3)
    rotation[:dimensions, :dimensions] = left @ np.diag(signs) @ right
    variance = float((ours**2).sum(axis=1).mean())
    scale = float((singular * signs).sum() / variance) if scales else 1.0
    turned_m = rotation[:dimensions, :dimensions] @ our_mean
    shift_m[:dimensions] = their_mean - scale * turned_m
    return Alignment(rotation=rotation, translation_m=shift_m, scale=scale)


def _require_spread(singular: Values, sizes: list[float], means: list[Values]) -> None:
    """Raise an error if points do not determine a rotation, which needs all but one direction."""
    for who, size, mean in zip(("reference", "estimate"), sizes, means, strict=True):
        # Rounding of coordinates far from the origin is no motion.
        if size <= _LEAST_SPREAD * max(1.0, float(np.abs(mean).max())):
            raise StandstillError(f"the {who} stands still")
    if singular[-2] <= _LEAST_SPREAD * sizes[0] * sizes[1]:
        raise DegenerateError("all positions lie on one line")


def find_origin_alignment(reference: Trajectory, estimate: Trajectory) -> Alignment:
    """Return the transformation that makes the first poses of both trajectories equal."""
    ours, theirs = (
        build_rotations(one.orientation_quat_wxyz[:1])[0] for one in (estimate, reference)
    )
    rotation = theirs @ ours.T
    return Alignment(
        rotation=rotation, translation_m=reference.xyz_m[0] - rotation @ estimate.xyz_m[0]
    )


def align_trajectory(trajectory: Trajectory, alignment: Alignment) -> Trajectory:
    """Return a trajectory in another frame."""
    turn = find_quaternions(alignment.rotation[None])
    found = _multiply(turn, trajectory.orientation_quat_wxyz)
    return replace(
        trajectory,
        xyz_m=alignment.scale * trajectory.xyz_m @ alignment.rotation.T + alignment.translation_m,
        orientation_quat_wxyz=found / np.linalg.norm(found, axis=1, keepdims=True),
    )


def project_trajectory(trajectory: Trajectory) -> Trajectory:
    """Return x, y and the heading of the forward axis, projected onto the horizontal plane."""
    w, x, y, z = trajectory.orientation_quat_wxyz.T
    half_rad = np.arctan2(2.0 * (w * z + x * y), w**2 + x**2 - y**2 - z**2) / 2.0
    none = np.zeros(len(trajectory))
    return replace(
        trajectory,
        xyz_m=np.column_stack([trajectory.xyz_m[:, :2], none]),
        orientation_quat_wxyz=np.column_stack([np.cos(half_rad), none, none, np.sin(half_rad)]),
        space="plane",
    )


class PoseErrors(NamedTuple):
    """Errors of poses or of pairs, row by row; rotations are angles in [0, pi]."""

    position_m: Values
    rotation_rad: Values


def measure_absolute_errors(reference: Trajectory, estimate: Trajectory) -> PoseErrors:
    """Return the errors of associated, aligned poses (ATE)."""
    apart = _multiply(_conjugate(reference.orientation_quat_wxyz), estimate.orientation_quat_wxyz)
    return PoseErrors(
        position_m=np.linalg.norm(estimate.xyz_m - reference.xyz_m, axis=1),
        rotation_rad=_measure_angles(apart),
    )


def choose_pairs(
    trajectory: Trajectory, delta: float, unit: DeltaUnit, *, overlaps: bool = False
) -> tuple[Rows, Rows]:
    """Return the first and last rows of the pairs whose relative motion is compared.

    A pair ends at the first pose that is at least one delta after its first pose: in poses, in
    metres along the trajectory, or in degrees of turn summed over poses. For a delta in seconds, a
    pair ends at the nearest pose. The pair is left out if this pose is off by more than three
    quarters of the usual step between poses. If pairs overlap, one begins at every pose; otherwise
    each begins at the end of the last one.
    """
    if unit == "s":
        return _pair_times(trajectory.time_ns, round(delta * 1e9), overlaps=overlaps)
    steps = measure_way_steps(trajectory, unit)
    if overlaps:
        way = np.concatenate([[0.0], np.cumsum(steps)])
        firsts = np.arange(len(way))
        seconds = np.searchsorted(way, way + delta)
        is_whole = seconds < len(way)
        return firsts[is_whole], seconds[is_whole]
    ends, done = [0], 0.0
    for row, step in enumerate(steps.tolist(), start=1):
        done += step
        if done >= delta:
            ends.append(row)
            done = 0.0
    rows = np.array(ends, dtype=np.int64)
    return rows[:-1], rows[1:]


def _pair_times(time_ns: Rows, delta_ns: int, *, overlaps: bool) -> tuple[Rows, Rows]:
    nearest = _find_nearest(time_ns + delta_ns, time_ns)
    nearest = np.maximum(nearest, np.arange(len(time_ns)) + 1)
    firsts = np.arange(len(time_ns))
    if not overlaps:
        chain, ends = [], nearest.tolist()
        row = 0
        while row < len(ends) - 1:
            chain.append(row)
            row = ends[row]
        firsts = np.array(chain, dtype=np.int64)
    firsts = firsts[nearest[firsts] < len(time_ns)]
    seconds = nearest[firsts]
    usual_ns = float(np.median(np.diff(time_ns))) if len(time_ns) > 1 else 0.0
    is_near = np.abs(time_ns[seconds] - time_ns[firsts] - delta_ns) <= _MOST_OFF * usual_ns
    return firsts[is_near], seconds[is_near]


def measure_way_steps(trajectory: Trajectory, unit: DeltaUnit) -> Values:
    """Return the distance from each pose to the next, in the unit, shape (n - 1,)."""
    if unit == "frames":
        return np.ones(max(len(trajectory) - 1, 0))
    if unit == "m":
        return np.asarray(np.linalg.norm(np.diff(trajectory.xyz_m, axis=0), axis=1))
    turns = trajectory.orientation_quat_wxyz
    return np.degrees(_measure_angles(_multiply(_conjugate(turns[:-1]), turns[1:])))


def measure_relative_errors(
    reference: Trajectory, estimate: Trajectory, pairs: tuple[Rows, Rows]
) -> PoseErrors:
    """Return the errors of relative motions (RPE) of associated trajectories, pair by pair."""
    motions = [_find_motions(one, pairs) for one in (reference, estimate)]
    (their_shift_m, their_turn), (our_shift_m, our_turn) = motions
    return PoseErrors(
        position_m=np.linalg.norm(our_shift_m - their_shift_m, axis=1),
        rotation_rad=_measure_angles(_multiply(_conjugate(their_turn), our_turn)),
    )


def _find_motions(trajectory: Trajectory, pairs: tuple[Rows, Rows]) -> tuple[Values, Values]:
    """Return translations in the frame of the first poses [m], and rotations."""
    first, second = pairs
    turns = trajectory.orientation_quat_wxyz
    shift_m = trajectory.xyz_m[second] - trajectory.xyz_m[first]
    turned = np.einsum("nji,nj->ni", build_rotations(turns[first]), shift_m)
    return turned, _multiply(_conjugate(turns[first]), turns[second])


def build_rotations(quat_wxyz: Values) -> Values:
    """Return the rotation matrices of unit quaternions, shape (n, 3, 3)."""
    w, x, y, z = quat_wxyz.T
    rows = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def _conjugate(quat_wxyz: Values) -> Values:
    return np.asarray(quat_wxyz * np.array([1.0, -1.0, -1.0, -1.0]))


def _multiply(first: Values, second: Values) -> Values:
    """Return the rotations `second` followed by `first`, shape (n, 4)."""
    w1, x1, y1, z1 = first.T
    w2, x2, y2, z2 = second.T
    return np.column_stack(
        [
            w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2,
            w1 * x2 + x1 * w2 + y1 * z2 - z1 * y2,
            w1 * y2 - x1 * z2 + y1 * w2 + z1 * x2,
            w1 * z2 + x1 * y2 - y1 * x2 + z1 * w2,
        ]
    )


def _measure_angles(quat_wxyz: Values) -> Values:
    """Return the angles of rotations, in [0, pi] [rad]."""
    return np.asarray(
        2.0 * np.arctan2(np.linalg.norm(quat_wxyz[:, 1:], axis=1), np.abs(quat_wxyz[:, 0]))
    )


def measure_piece_errors(actual: Values, predicted: Values) -> Values:
    """Return the errors in distance [m] and turn [rad] at the end of each piece, shape (2, n).

    Both states have the shape (2, n, 3), for beginnings and ends of pieces. The predictions are
    moved so that they begin at the actual state.
    """
    turn_rad = actual[0, :, 2] - predicted[0, :, 2]
    cosine, sine = np.cos(turn_rad), np.sin(turn_rad)
    ahead_m, aside_m = (predicted[1, :, :2] - predicted[0, :, :2]).T
    moved_m = actual[1, :, :2] - actual[0, :, :2]
    off_m = np.hypot(
        moved_m[:, 0] - (cosine * ahead_m - sine * aside_m),
        moved_m[:, 1] - (sine * ahead_m + cosine * aside_m),
    )
    turned_rad = subtract_headings(actual[1, :, 2], actual[0, :, 2])
    expected_rad = subtract_headings(predicted[1, :, 2], predicted[0, :, 2])
    return np.array([off_m, np.abs(subtract_headings(turned_rad, expected_rad))])


def stack_states(poses: PoseColumns) -> Values:
    """Return x, y [m] and heading [rad] of poses, shape (n, 3)."""
    return np.column_stack([poses.xy_m, poses.heading_rad])
