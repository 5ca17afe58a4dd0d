"""Reading of any file as a trajectory, in 3D if the file has heights and rotations."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import describe_count
from turtlelog.errors import LogError, RunError
from turtlelog.files.urls import RemotePath
from turtlelog.log import importers
from turtlelog.log.any_file import LOG_SUFFIXES, read_as_chosen
from turtlelog.log.engine.opening import is_bag_file
from turtlelog.log.file_access import name_file, open_file
from turtlelog.log.importers.plain_tables import KITTI_COLUMNS, PlainTable, Values, read_plain_table
from turtlelog.log.importers.table_columns import Cells, assign_columns
from turtlelog.log.planar_poses import PoseShape, find_pose_shape
from turtlelog.log.read_choice import CHOSEN, UNUSED, ReadChoice, split_topic
from turtlelog.log.ros2.bag_poses import find_poses
from turtlelog.log.ros2.bag_rows import Bag, open_bag
from turtlelog.log.ros2.bag_topics import NoPosesError, select_robot
from turtlelog.log.ros2.stamps import Stamps, read_stamp_clock, read_stamps
from turtlelog.run.trajectory import (
    Trajectory,
    build_planar_trajectory,
    find_quaternions,
    turn_headings,
)

Times = NDArray[np.int64]

_FRAME_NS: Final = 1_000_000_000
"""Time between poses of a trajectory without times [ns], so that times and indices are of one
kind."""

_MOST_SKEW: Final = 0.01
"""Largest entry of R^T R - 1 of a matrix that is accepted as a rotation.

KITTI's files have six digits after the point, which gives 1e-5; another layout of twelve numbers
gives about 1."""

_QUATERNION: Final = ("qx", "qy", "qz", "qw")
_LONGEST_TIMES: Final = 64 * 2**20
"""Largest file of times [bytes]: 2 million lines of 32 bytes, more than 50 hours at 10 Hz."""


def read_trajectory(
    path: str | Path, choice: ReadChoice | None = None, *, times: Path | None = None
) -> Trajectory:
    """Return the poses of a file, with heights and rotations if the file has them.

    Rows with NaN are dropped. Rows are sorted by time, and of rows with equal times only the first
    is kept. The notes give the counts. Poses of bags are timed by usable stamps in their headers.

    Args:
        path: A trajectory in TUM, KITTI or EuRoC format, or any file that `read_run` reads;
            FILE:TOPIC for one topic of a bag.
        choice: Selection as for `read_run`.
        times: File with the time of each pose [s] for a KITTI trajectory, which has no times.

    Raises:
        LogError: If the file cannot be read. One line with the file and the place.
    """
    choice = choice or ReadChoice()
    file, topic = split_topic(path)
    if topic is None and _is_plain_table(file, choice):
        with name_file(file, expected="a trajectory"):
            table = read_plain_table(file)
            if table.names == KITTI_COLUMNS and not table.has_header:
                return _build_kitti(file, table, times)
            if _has_rotations(table, choice):
                return _build_from_table(file, table, choice)
    bag = _open_bag(file)
    is_own = bag is not None and any(info.format_version is not None for info in bag.infos.values())
    # A turtlelog recording is read as a run; if a topic is named, like any bag.
    asked = choice if topic is None else replace(choice, pose_topic=topic)
    if bag is not None and (asked.pose_topic is not None or not is_own):
        found = _read_bag(bag, asked, names_topic=topic is not None)
        if found is not None:
            return found
    run = read_as_chosen(path, choice)
    planar = build_planar_trajectory(run)
    return replace(
        planar, notes={name: run.notes[name] for name in (CHOSEN, UNUSED) if name in run.notes}
    )


def _open_bag(path: Path) -> Bag | None:
    """Return a bag; None for other or unreadable files, whose own reader gives the error."""
    if not path.exists() or not (path.is_dir() or is_bag_file(path)):
        return None
    try:
        return open_bag(path)
    except LogError:
        return None


def _is_plain_table(path: Path, choice: ReadChoice) -> bool:
    """Return whether a file is a table that is neither turtlelog's nor the paper's."""
    if isinstance(path, RemotePath) or path.suffix.lower() == ".json" or path.is_dir():
        return False
    if not path.exists() or (path.suffix.lower() not in LOG_SUFFIXES) or is_bag_file(path):
        return False
    if choice.columns:
        return True
    with name_file(path, expected="a trajectory"):
        return not (importers.holds_tables(path) or importers.is_papers(path))


def _has_rotations(table: PlainTable, choice: ReadChoice) -> bool:
    chosen = assign_columns(table.names, choice.columns, table.units)
    return {"t", "x", "y", "z", *_QUATERNION} <= {*chosen}


def _build_from_table(path: Path, table: PlainTable, choice: ReadChoice) -> Trajectory:
    cells = Cells(table, assign_columns(table.names, choice.columns, table.units))
    xyz_m = np.column_stack([cells.require(name) for name in "xyz"])
    turns = np.column_stack([cells.require(name) for name in ("qw", "qx", "qy", "qz")])
    with np.errstate(over="ignore"):
        empty = (turns**2).sum(axis=1) == 0.0
    if empty.any():
        cells.refuse("qw", int(empty.argmax()), "a rotation of a length other than 0")
    notes = {CHOSEN: cells.describe()} if table.has_header else {}
    return _build(path.stem, cells.time_ns, xyz_m, turns, notes=notes)


def _build_kitti(path: Path, table: PlainTable, times: Path | None) -> Trajectory:
    columns = table.columns.read(range(len(KITTI_COLUMNS)))
    values = np.empty((len(columns[0]), len(columns)))
    for place, cells in enumerate(columns):
        for row, cell in enumerate(cells):
            try:
                values[row, place] = float(cell)
            except ValueError as err:
                line = table.columns.lines[row]
                raise LogError(
                    f"line {line}, column {place + 1}: expected a number, found {str(cell)[:40]!r}"
                ) from err
    matrices = values.reshape(-1, 3, 4)
    rotations = matrices[:, :, :3]
    known = np.isfinite(values).all(axis=1)
    with np.errstate(over="ignore", invalid="ignore"):
        skew = np.abs(np.einsum("nji,njk->nik", rotations, rotations) - np.eye(3)).max(axis=(1, 2))
        is_rotation = (skew <= _MOST_SKEW) & (np.linalg.det(np.nan_to_num(rotations)) > 0.0)
    wrong = known & ~is_rotation
    if wrong.any():
        line = table.columns.lines[int(wrong.argmax())]
        raise LogError(
            f"line {line}: expected 12 numbers of a KITTI pose (r11 r12 r13 tx r21 ...), found a"
            " matrix that is no rotation"
        )
    turns = np.full((len(values), 4), np.nan)
    turns[known] = find_quaternions(rotations[known])
    if times is not None:
        time_ns = _read_times(times, len(values))
        return _build(path.stem, time_ns, matrices[:, :, 3], turns, notes={})
    time_ns = np.arange(len(values), dtype=np.int64) * _FRAME_NS
    return replace(_build(path.stem, time_ns, matrices[:, :, 3], turns, notes={}), clock="frame")


def _read_times(path: Path, count: int) -> Times:
    """Return the times of poses [ns] from a file with one time [s] per line."""
    found: list[int] = []
    with name_file(path, expected="a file of times"), open_file(path) as stream:
        data = stream.read(_LONGEST_TIMES + 1)
        if len(data) > _LONGEST_TIMES:
            raise LogError(f"a file of times has at most {_LONGEST_TIMES // 2**20} MiB")
        lines = enumerate(data.decode("utf-8", errors="replace").splitlines(), 1)
        kept = [
            (number, line) for number, line in lines if line.strip() and line.lstrip()[0] != "#"
        ]
        if len(kept) != count:
            raise LogError(
                f"expected a time for each of {describe_count(count, 'pose')}, found"
                f" {describe_count(len(kept), 'line')}"
            )
        for number, line in kept:
            time_ns = importers.read_time(line.strip(), 9)
            if time_ns is None:
                raise LogError(f"line {number}: expected a time in s, found {line[:40]!r}")
            found.append(time_ns)
    return np.array(found, dtype=np.int64)


def _read_bag(bag: Bag, choice: ReadChoice, *, names_topic: bool) -> Trajectory | None:
    """Return the poses of a bag with all their fields; None if it has no such poses."""
    with name_file(bag.path, expected="a bag"):
        is_asked = choice.pose_topic is not None and choice.robot is None
        topics = bag.topics if is_asked else select_robot(bag.topics, choice.robot)[0]
        try:
            source = find_poses(bag, topics, choice)
        except NoPosesError:
            return None  # a run may be made of commands alone
        rows: list[tuple[Values, Values]] = []
        log_ns, stamp_ns, is_spatial = list[Times](), list[Times](), True
        for of_file in source.found:
            columns = of_file.get(source.topic.topic)
            if columns is None or not len(columns):
                continue
            shape = find_pose_shape(columns.fields)
            if shape is None:
                return None
            is_spatial &= shape.heading is None and f"{shape.position}z" in columns.fields
            stamps = read_stamps(columns)
            log_ns.append(columns.log_time_ns)
            stamp_ns += [] if stamps is None else [stamps]
            rows.append(_read_poses(columns.fields, shape))
        if not rows:
            return None
        time_ns, clock = _choose_times(log_ns, stamp_ns, choice)
        xyz_m, turns = (np.concatenate(parts) for parts in zip(*rows, strict=True))
        turns[(turns**2).sum(axis=1) == 0.0] = np.nan
        never = time_ns <= 0
        if never.all() and len(never) > 1:
            raise LogError(
                f"topic {source.topic.topic}: expected times of poses, found 0 or before 1970 in"
                f" all {len(never)}"
            )
        turns[never if never.sum() > 1 else []] = np.nan  # a simulation begins at 0 once
        name = bag.path.name if bag.path.is_dir() else bag.path.stem
        name += f":{source.topic.topic}" if names_topic else ""
        notes = {CHOSEN: f"poses from {source.notes['pose_topic']}", "timed_by": clock}
        found = _build(name, time_ns, xyz_m, turns, notes=notes)
    return found if is_spatial else replace(found, space="plane")


def _choose_times(
    logged: list[Times], stamps: list[Times], choice: ReadChoice
) -> tuple[Times, str]:
    """Return the times of poses and the name of their clock."""
    log_ns = np.concatenate(logged)
    if choice.time == "log" or len(stamps) < len(logged):
        return log_ns, "the recorder's clock"
    stamp_ns, order = np.concatenate(stamps), np.argsort(log_ns, kind="stable")
    clock = read_stamp_clock(Stamps(log_ns=log_ns[order], stamp_ns=stamp_ns[order]))
    if not clock.reason:
        return stamp_ns, "header stamps"
    if choice.time == "stamp":
        raise LogError(f"time: expected usable stamps of poses, but {clock.reason}: take log")
    return log_ns, f"the recorder's clock ({clock.reason})"


def _read_poses(
    fields: Mapping[str, NDArray[np.generic]], shape: PoseShape
) -> tuple[Values, Values]:
    """Return positions [m] and rotations as quaternions w, x, y, z."""
    place = [fields[f"{shape.position}{axis}"].astype(np.float64) for axis in "xy"]
    has_height = f"{shape.position}z" in fields
    height = fields[f"{shape.position}z"].astype(np.float64) if has_height else 0.0 * place[0]
    xyz_m = np.column_stack([*place, height])
    if shape.heading is not None:
        heading = fields[shape.heading].astype(np.float64)
        return xyz_m, turn_headings(np.radians(heading) if shape.is_degrees else heading)
    parts = [fields[f"{shape.orientation}{axis}"].astype(np.float64) for axis in "wxyz"]
    return xyz_m, np.column_stack(parts)


def _build(
    name: str, time_ns: Times, xyz_m: Values, turns: Values, *, notes: Mapping[str, str]
) -> Trajectory:
    """Return a trajectory of the finite rows in order of time, one row for each time."""
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        turns = turns / np.linalg.norm(turns, axis=1, keepdims=True)
    is_pose = np.isfinite(xyz_m).all(axis=1) & np.isfinite(turns).all(axis=1)
    if not is_pose.any():
        raise LogError("no row has a position of finite numbers and a rotation")
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
    try:
        return Trajectory(
            name=name,
            time_ns=time_ns[is_first],
            xyz_m=xyz_m[is_first],
            orientation_quat_wxyz=turns[is_first],
            space="space",
            notes={**notes, **{key: text for key, text in told.items() if counts[key]}},
        )
    except RunError as err:
        raise LogError(str(err)) from err
