"""Headings [rad], counter-clockwise positive: wrapped, subtracted, as rotations; trajectories.

The turtle frame has its x axis along the heading and its y axis to the left. Equation numbers are
those of "Simulation-Based Learning of Feedback Control Through Planar Robot Motion". The paper
prints the matrix of equations 7 and 10 transposed; the formulas here follow equations 11 and 16.

Arrays broadcast: vectors of shape (..., 2) against headings of shape (...).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, Literal, TypeVar, overload

import numpy as np
from numpy import fmod, rint
from numpy.typing import ArrayLike, NDArray

from turtlelog import arithmetic
from turtlelog.display import describe_count, fit_line
from turtlelog.errors import FrameError, RunError
from turtlelog.run.columns import Rebuilding, Values, rebuild_value

if TYPE_CHECKING:
    from turtlelog.run.columns import PoseColumns
    from turtlelog.run.run import Run

_TURN_RAD = 2.0 * math.pi
Angle = TypeVar("Angle", float, NDArray[np.float64])


def wrap_angle(angle_rad: Angle) -> Angle:
    """Return the same direction in [-pi, pi) [rad]; arrays keep their shape.

    An angle already in this interval is returned unchanged.
    """
    if isinstance(angle_rad, np.ndarray):
        turned = np.fmod(angle_rad, _TURN_RAD)
        wrapped = turned - _TURN_RAD * np.floor((turned + np.pi) / _TURN_RAD)
        # Just below -pi the sum rounds up to pi itself, which is the same direction as -pi.
        wrapped = np.where(wrapped >= np.pi, -np.pi, wrapped)
        inside = (angle_rad >= -np.pi) & (angle_rad < np.pi)
        return np.asarray(np.where(inside, angle_rad, wrapped))
    return arithmetic.wrap_angle(angle_rad)


@overload
def subtract_headings(to_rad: float, from_rad: float) -> float: ...


@overload
def subtract_headings(
    to_rad: float | NDArray[np.float64], from_rad: NDArray[np.float64]
) -> NDArray[np.float64]: ...


def subtract_headings(
    to_rad: float | NDArray[np.float64], from_rad: float | NDArray[np.float64]
) -> float | NDArray[np.float64]:
    """Return the smallest rotation from one heading to another [rad], in [-pi, pi)."""
    turned_rad: Any = to_rad - from_rad
    return wrap_angle(turned_rad)  # type: ignore[no-any-return]


EXPLAINED_RAD: Final = 0.1
"""Largest difference of a step of the heading from turn rate times duration, up to full turns, for
which the rate counts full turns [rad]. With 32 bits a rate of 1e6 rad per step is off by 0.06; a
wrong rate fits by chance in 3 %."""

_USUAL: Final = 1.5
"""Longest step in which the rate at its end counts, as a multiple of the usual one."""


# Rules for one step of the heading, or for columns of steps; compiled in the batch of `sweep`.


def _choose(condition: Any, one: Any, other: Any) -> Any:
    return one if condition else other


@arithmetic.compiled_as(_choose)
def choose(condition: Any, one: Any, other: Any) -> Any:
    """Return one value where a condition holds, and the other elsewhere."""
    return np.where(condition, one, other)


def find_turn(step_rad: Any) -> Any:
    """Return the angle that makes a step the shortest way [rad]; 0 up to half a turn."""
    rest_rad = fmod(step_rad + math.pi, _TURN_RAD)
    rest_rad = choose(rest_rad < 0.0, rest_rad + _TURN_RAD, rest_rad)
    return choose(abs(step_rad) <= math.pi, 0.0, rest_rad - math.pi - step_rad)


def is_fast_turn(turned_rad: Any) -> Any:
    """Return whether a rate turns by more than half a turn in a step."""
    return abs(turned_rad) > math.pi


def _find_full_turns(step_rad: Any, turned_rad: Any) -> Any:
    return _TURN_RAD * rint((turned_rad - step_rad) / _TURN_RAD)


def explains_step(step_rad: Any, turned_rad: Any) -> Any:
    """Return whether a step differs from the turn of the rate by full turns."""
    rest_rad = turned_rad - step_rad - _find_full_turns(step_rad, turned_rad)
    return abs(rest_rad) <= EXPLAINED_RAD


def continue_step(step_rad: Any, turned_rad: Any, is_fast: Any) -> Any:
    """Return the angle to add from the end of a step on [rad]: full turns by a fast rate."""
    is_counted = is_fast & explains_step(step_rad, turned_rad)
    return choose(is_counted, _find_full_turns(step_rad, turned_rad), find_turn(step_rad))


@dataclass(frozen=True, slots=True, eq=False)
class HeadingSteps:
    """Steps from each heading to the next.

    Attributes:
        added_rad: Angle to add from the end of each step on [rad], shape (n - 1,).
        is_fast: Whether the rate turns by more than half a turn, shape (n - 1,).
        is_lost: Whether the rate then does not explain the step, shape (n - 1,).
    """

    added_rad: NDArray[np.float64]
    is_fast: NDArray[np.bool_]
    is_lost: NDArray[np.bool_]


def find_heading_steps(poses: "PoseColumns") -> HeadingSteps:
    """Return how headings continue: the shortest way, or as the applied turn rate says.

    The rate of each pose is that of the step before the pose.
    """
    heading_rad, turn_rate_rad_s = poses.heading_rad, poses.turn_rate_rad_s
    step_rad = heading_rad[1:] - heading_rad[:-1]
    is_fast = is_lost = np.zeros(len(step_rad), dtype=np.bool_)
    if turn_rate_rad_s is None:
        return HeadingSteps(find_turn(step_rad), is_fast, is_lost)
    lasting_ns = poses.time_ns[1:] - poses.time_ns[:-1]
    turned_rad = turn_rate_rad_s[1:] * (lasting_ns / 1e9)
    is_fast = is_fast_turn(turned_rad)
    if not is_fast.any():
        return HeadingSteps(find_turn(step_rad), is_fast, is_lost)
    is_fast &= lasting_ns <= _USUAL * np.median(lasting_ns)
    added_rad = continue_step(step_rad, turned_rad, is_fast)
    return HeadingSteps(added_rad, is_fast, is_fast & ~explains_step(step_rad, turned_rad))


def unwrap_headings(poses: "PoseColumns") -> NDArray[np.float64]:
    """Return headings without jumps at full turns [rad], shape (n,); see `find_heading_steps`."""
    heading_rad, added_rad = poses.heading_rad, find_heading_steps(poses).added_rad
    return heading_rad + np.append(0.0, np.cumsum(added_rad)) if added_rad.any() else heading_rad


def build_rotation(heading_rad: ArrayLike) -> NDArray[np.float64]:
    """Return the rotation matrix from the turtle frame to the world frame, shape (..., 2, 2).

    The columns are the turtle's axes in the world frame: [[cos, -sin], [sin, cos]]. The inverse is
    the transpose. The matrix and its inverse are the corrected matrices of equations 7 and 10.

    Args:
        heading_rad: Heading, counter-clockwise from the world's +x [rad], shape (...).
    """
    heading = np.asarray(heading_rad, dtype=np.float64)
    cos, sin = np.cos(heading), np.sin(heading)
    return np.stack([np.stack([cos, -sin], axis=-1), np.stack([sin, cos], axis=-1)], axis=-2)


def rotate_to_world(turtle_xy: ArrayLike, heading_rad: ArrayLike) -> NDArray[np.float64]:
    """Return a turtle-frame vector in the world frame, in the same unit, shape (..., 2).

    x_G = x_T cos - y_T sin, y_G = x_T sin + y_T cos: the motion of turtlesim in a tick.

    Args:
        turtle_xy: Components forward and to the left, any unit, shape (..., 2).
        heading_rad: Heading, counter-clockwise from the world's +x [rad], shape (...).
    """
    (forward, left), cos, sin = _split(turtle_xy, heading_rad)
    return np.stack([forward * cos - left * sin, forward * sin + left * cos], axis=-1)


def rotate_to_turtle(world_xy: ArrayLike, heading_rad: ArrayLike) -> NDArray[np.float64]:
    """Return a world-frame vector in the turtle frame, in the same unit, shape (..., 2).

    x_T = x_G cos + y_G sin, y_T = -x_G sin + y_G cos (11). If the heading is the direction of the
    vector, y_T = 0 (15). If the heading is the goal bearing, a displacement from the start becomes
    along-track and cross-track.

    Args:
        world_xy: Components along the world's x and y, any unit, shape (..., 2).
        heading_rad: Heading, counter-clockwise from the world's +x [rad], shape (...).
    """
    (x, y), cos, sin = _split(world_xy, heading_rad)
    return np.stack([x * cos + y * sin, y * cos - x * sin], axis=-1)


def project_on_heading(world_xy: ArrayLike, heading_rad: ArrayLike) -> NDArray[np.float64]:
    """Return the forward part of a world-frame vector, in the same unit, shape (...).

    The forward part is the dot product with the heading's unit vector (cos, sin) (16). This part is
    negative if the vector points behind the turtle, which then drives in reverse (17).

    Args:
        world_xy: Components along the world's x and y, any unit, shape (..., 2).
        heading_rad: Heading, counter-clockwise from the world's +x [rad], shape (...).
    """
    (x, y), cos, sin = _split(world_xy, heading_rad)
    return np.asarray(x * cos + y * sin)


def _split(
    xy: ArrayLike, heading_rad: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    vectors = np.asarray(xy, dtype=np.float64)
    if vectors.shape[-1:] != (2,):
        raise FrameError(f"expected vectors of shape (..., 2), found {vectors.shape}")
    heading = np.asarray(heading_rad, dtype=np.float64)
    return np.moveaxis(vectors, -1, 0), np.cos(heading), np.sin(heading)


def compose_transforms(
    place_m: Values, turn: Values, next_m: Values, next_turn: Values
) -> tuple[Values, Values]:
    """Return a transform followed by another, positions of shape (n, 3), rotations of (n, 4).

    Rotations of transforms are quaternions x, y, z, w, as in messages of ROS.
    """
    parts = (np.split(_normalise(one), [3], axis=1) for one in (turn, next_turn))
    (a, v), (b, w) = parts
    vector = v * b + w * a + np.cross(a, b)
    both = np.hstack([vector, v * w - (a * b).sum(axis=1, keepdims=True)])
    return place_m + rotate_vectors(turn, next_m), both


def place_points(place_m: Values, turn: Values, points_m: Values) -> Values:
    """Return points of a frame, given the place and rotation of the frame, shape (n, 3)."""
    return np.asarray(place_m + rotate_vectors(np.tile(turn, (len(points_m), 1)), points_m))


def rotate_vectors(turn: Values, vector: Values) -> Values:
    """Return vectors rotated by quaternions of any length except 0."""
    axis, w = np.split(_normalise(turn), [3], axis=1)
    across = 2.0 * np.cross(axis, vector)
    return np.asarray(vector + w * across + np.cross(axis, across))


def invert_transform(place_m: Values, turn: Values) -> tuple[Values, Values]:
    """Return the inverse transform."""
    back = turn * np.array([-1.0, -1.0, -1.0, 1.0])
    return -rotate_vectors(back, place_m), back


def _normalise(turn: Values) -> Values:
    length = np.linalg.norm(turn, axis=1, keepdims=True)
    # Quaternions that were never set stay 0; the computation of headings reports them.
    return np.asarray(turn / np.where(length == 0.0, 1.0, length))


def interpolate_rotation(first: Values, last: Values, share: float) -> Values:
    """Return a rotation on the shortest arc between two quaternions."""
    first, last = _normalise(np.stack([first, last]))
    cosine = float(first @ last)
    last, cosine = (-last, -cosine) if cosine < 0.0 else (last, cosine)
    angle = float(np.arccos(min(cosine, 1.0)))
    if angle < _SMALL_RAD:
        return np.asarray((1.0 - share) * first + share * last)
    weights = np.sin([(1.0 - share) * angle, share * angle]) / np.sin(angle)
    return np.asarray(weights[0] * first + weights[1] * last)


_SMALL_RAD: Final = 1e-6
"""Angle below which an arc equals a line to the last bit [rad]."""


def turn_headings(heading_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return headings [rad], shape (n,), as quaternions w, x, y, z, shape (n, 4)."""
    none = np.zeros(len(heading_rad))
    return np.column_stack([np.cos(heading_rad / 2.0), none, none, np.sin(heading_rad / 2.0)])


def find_quaternions(rotations: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return rotation matrices, shape (n, 3, 3), as quaternions w, x, y, z of length 1, (n, 4).

    The largest of the four components is computed first, to avoid cancellation: S. W. Shepperd,
    "Quaternion from Rotation Matrix", Journal of Guidance and Control 1(3), 1978.
    """
    diagonal = np.einsum("nii->ni", rotations)
    trace = diagonal.sum(axis=1)
    # Of each matrix the column of 4 q q^T whose part on the diagonal is the largest.
    squares = np.column_stack([1.0 + trace, *(1.0 - trace + 2.0 * one for one in diagonal.T)])
    outer = np.empty((len(rotations), 4, 4))
    outer[:, range(4), range(4)] = squares
    for row, (i, j) in enumerate(((2, 1), (0, 2), (1, 0)), start=1):
        outer[:, 0, row] = outer[:, row, 0] = rotations[:, i, j] - rotations[:, j, i]
    for (first, second), (i, j) in zip(
        ((1, 2), (1, 3), (2, 3)), ((0, 1), (0, 2), (1, 2)), strict=True
    ):
        mixed = rotations[:, i, j] + rotations[:, j, i]
        outer[:, first, second] = outer[:, second, first] = mixed
    found = outer[np.arange(len(rotations)), squares.argmax(axis=1)]
    return np.asarray(found / np.linalg.norm(found, axis=1, keepdims=True))


_UNIT_LENGTH: Final = 1e-6
"""Largest deviation of a quaternion's length from 1; built quaternions are normalised."""

_FARTHEST_M: Final = 1e12
"""Largest coordinate of a robot [m]: the sun is at 1.5e11 m, and squares of 1e155 overflow."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trajectory:
    """Poses of a robot. The arrays are made read-only without a copy.

    Attributes:
        name: Name of the trajectory in answers.
        time_ns: Time of each pose as in the file [ns], shape (n,), strictly increasing. For a
            trajectory without times, the number of the pose in units of 1 s.
        xyz_m: Position in the world frame [m], shape (n, 3).
        orientation_quat_wxyz: Unit quaternion of the rotation from the robot's frame to the world
            frame, shape (n, 4).
        space: `space` if the file has heights and rotations; `plane` if it has only x, y and
            heading.
        clock: `time`, or `frame` for poses that are only numbered.
        notes: Notes on rows omitted in reading, by keyword.
    """

    name: str
    time_ns: NDArray[np.int64]
    xyz_m: Values
    orientation_quat_wxyz: Values
    space: Literal["plane", "space"]
    clock: Literal["time", "frame"] = "time"
    notes: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        count = len(self.time_ns)
        shapes = (self.xyz_m.shape, self.orientation_quat_wxyz.shape)
        if shapes != ((count, 3), (count, 4)):
            raise RunError(
                f"trajectory: expected rows of 3 and 4 for {count} times, found {shapes}"
            )
        if (np.diff(self.time_ns) <= 0).any():
            row = int((np.diff(self.time_ns) <= 0).argmax()) + 1
            raise RunError(f"trajectory.time_ns[{row}]: expected a time after the one before")
        for name in ("xyz_m", "orientation_quat_wxyz"):
            if not np.isfinite(getattr(self, name)).all():
                raise RunError(f"trajectory.{name}: expected finite numbers")
        if (farthest_m := float(np.abs(self.xyz_m).max(initial=0.0))) > _FARTHEST_M:
            raise RunError(
                f"trajectory: expected positions within {_FARTHEST_M:g} m, found {farthest_m:g} m"
            )
        lengths = np.linalg.norm(self.orientation_quat_wxyz, axis=1)
        if (np.abs(lengths - 1.0) > _UNIT_LENGTH).any():
            raise RunError("trajectory.orientation_quat_wxyz: expected quaternions of length 1")
        for array in (self.time_ns, self.xyz_m, self.orientation_quat_wxyz):
            array.flags.writeable = False
        object.__setattr__(self, "notes", MappingProxyType(dict(self.notes)))

    def __len__(self) -> int:
        return len(self.time_ns)

    def __repr__(self) -> str:
        return fit_line(f"<Trajectory {self.name}: {len(self)} poses in {self.space}>")

    def __reduce__(self) -> Rebuilding:
        return rebuild_value(self)


def build_planar_trajectory(run: "Run") -> Trajectory:
    """Return the poses of a run as a planar trajectory, with its source's times."""
    return Trajectory(
        name=run.name,
        time_ns=run.poses.time_ns + run.source_start_ns,
        xyz_m=np.column_stack([run.poses.xy_m, np.zeros(len(run.poses))]),
        orientation_quat_wxyz=turn_headings(run.poses.heading_rad),
        space="plane",
    )


def build_trajectory(
    name: str,
    time_ns: NDArray[np.int64],
    xyz_m: Values,
    turns: Values,
    *,
    notes: Mapping[str, str],
) -> Trajectory:
    """Return a trajectory of the finite rows in order of time, one row for each time.

    Args:
        name: Name of the trajectory.
        time_ns: Time of each row [ns], shape (n,), in any order.
        xyz_m: Position [m], shape (n, 3).
        turns: Rotation as a quaternion w, x, y, z of any length, shape (n, 4).
        notes: Notes, to which the numbers of rows left out or sorted are added.

    Raises:
        RunError: If no row has a position and a rotation, or the rows are no trajectory.
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        turns = turns / np.linalg.norm(turns, axis=1, keepdims=True)
    is_pose = np.isfinite(xyz_m).all(axis=1) & np.isfinite(turns).all(axis=1)
    if not is_pose.any():
        raise RunError("no row has a position of finite numbers and a rotation")
    time_ns, xyz_m, turns = time_ns[is_pose], xyz_m[is_pose], turns[is_pose]
    late = int((time_ns < np.maximum.accumulate(time_ns)).sum())
    if late:
        order = np.argsort(time_ns, kind="stable")
        time_ns, xyz_m, turns = time_ns[order], xyz_m[order], turns[order]
    is_first = np.concatenate([[True], np.diff(time_ns) > 0])
    counts = {
        "without a time, a position or a rotation": int((~is_pose).sum()),
        "out of order in time, sorted": late,
        "at a time that an earlier pose has, left out": int((~is_first).sum()),
    }
    told = {name: f"{describe_count(count, 'pose')} {name}" for name, count in counts.items()}
    return Trajectory(
        name=name,
        time_ns=time_ns[is_first],
        xyz_m=xyz_m[is_first],
        orientation_quat_wxyz=turns[is_first],
        space="space",
        notes={**notes, **{key: text for key, text in told.items() if counts[key]}},
    )
