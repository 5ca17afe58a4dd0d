"""The class `Trajectory`: poses in 2D or 3D by absolute time, for errors between two of them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import describe_count, fit_line
from turtlelog.errors import RunError
from turtlelog.run.columns import Rebuilding, rebuild_value
from turtlelog.run.run import Run

Values = NDArray[np.float64]

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


def build_planar_trajectory(run: Run) -> Trajectory:
    """Return the poses of a run as a planar trajectory, with the run's times."""
    return Trajectory(
        name=run.name,
        time_ns=run.poses.time_ns,
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


def turn_headings(heading_rad: Values) -> Values:
    """Return headings [rad], shape (n,), as quaternions w, x, y, z, shape (n, 4)."""
    none = np.zeros(len(heading_rad))
    return np.column_stack([np.cos(heading_rad / 2.0), none, none, np.sin(heading_rad / 2.0)])


def find_quaternions(rotations: Values) -> Values:
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
