"""Headings [rad], counter-clockwise positive: wrapped, subtracted, as rotations and quaternions.

The turtle frame has its x axis along the heading and its y axis to the left. Equation numbers are
those of "Simulation-Based Learning of Feedback Control Through Planar Robot Motion". The paper
prints the matrix of equations 7 and 10 transposed; the formulas here follow equations 11 and 16.

Arrays broadcast: vectors of shape (..., 2) against headings of shape (...).
"""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, TypeVar, overload

import numpy as np
from numpy import fmod, rint
from numpy.typing import ArrayLike, NDArray

from turtlelog import arithmetic
from turtlelog.errors import FrameError

if TYPE_CHECKING:
    from turtlelog.run.columns import PoseColumns

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
