"""Trajectories in space for tests: a curve that turns about every axis, and disturbed copies."""

from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.compare.trajectory_errors import Alignment, align_trajectory
from turtlelog.run.angles import Trajectory

STEP_NS: Final = 50_000_000


def make_trajectory(count: int = 120, *, name: str = "truth") -> Trajectory:
    """Return a curve in space whose rotations turn about every axis."""
    time_ns = 100_000_000_000 + np.arange(count, dtype=np.int64) * STEP_NS
    t = time_ns / 1e9
    xyz_m = np.column_stack([3.0 * np.cos(0.7 * t), 2.0 * np.sin(0.5 * t), np.sin(0.3 * t)])
    return Trajectory(
        name=name,
        time_ns=time_ns,
        xyz_m=xyz_m,
        orientation_quat_wxyz=make_quaternions(
            np.column_stack([np.sin(0.2 * t), np.cos(0.3 * t), 0.1 * t - 9.0])
        ),
        space="space",
    )


def make_quaternions(vectors_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return rotation vectors as quaternions w, x, y, z."""
    angle = np.linalg.norm(vectors_rad, axis=1, keepdims=True)
    return np.column_stack([np.cos(angle / 2), vectors_rad * np.sinc(angle / 2 / np.pi) / 2])


def make_alignment(*, scale: float = 1.0, planar: bool = False) -> Alignment:
    """Return a rotation by 40 deg, a shift and a scale."""
    axis = np.array([0.0, 0.0, 1.0]) if planar else np.array([2.0, -1.0, 2.0]) / 3.0
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    angle = np.radians(40.0)
    rotation = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    shift_m = np.array([1.0, -2.0, 0.0 if planar else 3.0])
    return Alignment(rotation=rotation, translation_m=shift_m, scale=scale)


def disturb(trajectory: Trajectory, seed: int = 1, *, jitter_ns: int = 0) -> Trajectory:
    """Return two thirds of the poses with noise, in another frame and with another scale."""
    random = np.random.default_rng(seed)
    rows = np.sort(random.permutation(len(trajectory) - 2)[: 2 * len(trajectory) // 3]) + 1
    count = len(rows)
    moved = align_trajectory(trajectory, make_alignment(scale=1.1))
    turns = make_quaternions(random.normal(0.0, 0.01, (count, 3)))
    turns = moved.orientation_quat_wxyz[rows] + turns * [0.0, 1.0, 1.0, 1.0]
    return Trajectory(
        name="estimate",
        time_ns=moved.time_ns[rows] + random.integers(-jitter_ns, jitter_ns + 1, count),
        xyz_m=moved.xyz_m[rows] + random.normal(0.0, 0.02, (count, 3)),
        orientation_quat_wxyz=turns / np.linalg.norm(turns, axis=1, keepdims=True),
        space="space",
    )


def write_tum(path: Path, trajectory: Trajectory, **changes: Any) -> Path:
    """Write a trajectory as TUM's benchmark does; NAME=(row, text) changes a cell."""
    lines = []
    for row, (time_ns, xyz, turn) in enumerate(
        zip(
            trajectory.time_ns.tolist(),
            trajectory.xyz_m.tolist(),
            trajectory.orientation_quat_wxyz.tolist(),
            strict=True,
        )
    ):
        cells = [
            f"{time_ns // 10**9}.{time_ns % 10**9:09d}",
            *map(repr, [*xyz, *turn[1:], turn[0]]),
        ]
        for place, (at, text) in ((int(name[1:]), change) for name, change in changes.items()):
            cells[place] = text if at == row else cells[place]
        lines.append(" ".join(cells))
    path.write_text("\n".join(lines) + "\n")
    return path
