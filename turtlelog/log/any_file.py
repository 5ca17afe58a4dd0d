"""Reading of any file as a run or a trajectory. The file's content determines its kind."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final, Unpack, cast

import numpy as np
from numpy.typing import NDArray

from turtlelog import log, run as runs
from turtlelog.display import describe_count
from turtlelog.errors import LogError
from turtlelog.files.text_files import iterate_lines
from turtlelog.files.urls import RemotePath, make_path
from turtlelog.log import recording, ros2
from turtlelog.log.engine.opening import is_bag_file, strip_suffixes
from turtlelog.log.file_access import name_file, open_file
from turtlelog.log.file_info import RecordingInfo, read_info
from turtlelog.log.read_choice import (
    CHOSEN,
    RESTARTS,
    UNUSED,
    FileKind,
    ReadChoice,
    ReadOptions,
    describe_unused,
    match_topic,
    parse_goal_option,
    split_topic,
)
from turtlelog.log.recording.topics import COMMAND, POSE

if TYPE_CHECKING:
    from turtlelog.log import Cells, PlainTable
    from turtlelog.run import Run, Trajectory

LOG_SUFFIXES: Final = frozenset({".json", ".csv", ".parquet", ".tsv", ".tum", ".txt"})
"""Suffixes of logs and tables."""


def read_run(path: str | Path, **options: Unpack[ReadOptions]) -> "Run":
    """Return the run in a recording, a third-party bag or .mcap, a paper's log, or a table.

    Args:
        path: A file or a bag's folder, which may contain a recording. FILE:TOPIC, as in
            `bag:/odom_kf`, reads the poses of this topic, and the run's name includes the topic.
        options: Fields of a `ReadChoice`: topics to read from third-party files, and whether an
            unfinished recording may be read, with a `PartialRecordingWarning`.

    Raises:
        LogError: If the file cannot be read; one line with the file and the place.
    """
    (path, topic), choice = split_topic(path), ReadChoice(**options)
    if topic is None:
        return _read(path, choice)
    return _read(path, replace(choice, pose_topic=topic), names_topic=True)


def _read(path: Path, choice: ReadChoice, *, names_topic: bool = False) -> "Run":
    has_tables, is_log = _recognise(path)
    if has_tables or is_log:
        if names_topic:
            found = "tables" if has_tables else "a log"
            raise LogError(
                f"{path}: expected a bag, of which {choice.pose_topic} is read, found {found}"
            )
        return _aim(path, _import_tables(path, choice, is_own=has_tables), choice)
    # Asking for the poses and commands of turtlelog's recordings loses none of their contents.
    pairs = (choice.pose_topic, POSE.name), (choice.command_topic, COMMAND.name)
    is_usual = all(name is None or match_topic(name, {usual}) == usual for name, usual in pairs)
    frames = choice.pose_frame, choice.world_frame
    others = choice.path_topic, *frames, choice.wheel_joints, choice.wheels
    is_usual &= choice.robot in {None, _OWN_ROBOT} and all(one is None for one in others)
    # A file that should be a recording and is not MCAP gets an error that says so.
    if is_usual or not (path.is_dir() or is_bag_file(path)):
        own = _read_own(path, allow_partial=choice.allow_partial)
        if own is not None:
            return _note_unused(_aim(path, own, choice), choice, "recording")
    run = _read_bag(path, choice)
    # A topic in the name distinguishes two topics of one bag. A recording keeps its name.
    run = replace(run, name=f"{run.name}:{choice.pose_topic}") if names_topic else run
    return _note_unused(run, choice, "bag")


def _read_bag(path: Path, choice: ReadChoice) -> "Run":
    """Return the run in a bag, or in what can be recovered of it if the choice allows this."""
    try:
        return ros2.read_bag(path, **_list_options(choice))
    except LogError:
        if not choice.allow_partial:
            raise
        with _recover(path) as recovered:
            if recovered is None:
                raise  # the first error names what is wrong
            copy, lost = recovered
            run = ros2.read_bag(copy, **_list_options(choice))
    # Without a part of the bag, the other parts may be sound.
    lost = run.notes.get("recovered", lost)
    is_told = run.origin.lost != "nothing"
    origin = run.origin if is_told else replace(run.origin, lost="rows")
    run = replace(run, origin=origin, notes={**run.notes, "recovered": lost})
    warnings.warn(f"{path}: {lost}", recording.PartialRecordingWarning, stacklevel=4)
    return run


@contextmanager
def _recover(path: Path) -> Iterator[tuple[Path, str] | None]:
    """Yield a copy of the readable part of a bag, and what is lost; None if all or nothing is."""
    from tempfile import TemporaryDirectory  # sound bags need none

    with TemporaryDirectory() as folder:
        copy = Path(folder) / (path.name if path.is_dir() else f"{strip_suffixes(path)}.mcap")
        report = None
        with suppress(LogError):
            report = log.recover_recording(path, copy)
        if report is None or report.complete:
            yield None
        else:
            yield copy, "; ".join(loss.reason for loss in report.lost)


def _import_tables(path: Path, choice: ReadChoice, *, is_own: bool) -> "Run":
    """Return the run in tables by turtlelog, or else in a log of the paper or a plain table."""
    # With the user's mapping of columns, a file is a plain table.
    is_mapped = bool(choice.columns) and not path.is_dir()
    if is_own and not is_mapped:
        run = log.import_tables(path)
    elif path.suffix.lower() == ".json" or (not is_mapped and log.is_papers(path)):
        run = log.import_log(path)
    else:
        run = log.import_plain_table(
            path, choice.columns, robot=choice.robot, allow_partial=choice.allow_partial
        )
    choice = replace(choice, robot=None) if run.origin.robot else choice
    return _note_unused(run, choice, "table")


_OWN_ROBOT: Final = POSE.name.split("/")[1]
"""The robot in turtlelog's recordings; any other robot is looked up as in a bag."""


def _aim(path: Path, run: "Run", choice: ReadChoice) -> "Run":
    """Return a run with the requested goal. A run with samples and their own goal is refused."""
    if choice.goal is None:
        return run
    if len(run.samples) and "goal_xy_m" not in run.absent:
        raise LogError(f"{path}: goal: expected none beside the samples of a controller, found one")
    goal_xy_m, heading_rad = parse_goal_option(choice.goal)
    names = {"goal_xy_m"} | (set() if heading_rad is None else {"goal_heading_rad"})
    absent = tuple(name for name in run.absent if name not in names)
    return replace(run, goal_xy_m=goal_xy_m, goal_heading_rad=heading_rad, absent=absent)


def read_as_chosen(path: str | Path, choice: ReadChoice) -> "Run":
    """Return the run in a file, as `read_run` does, or of a preset. Notes describe lost data."""
    if not make_path(path).exists():
        from turtlelog.scenario import PRESETS, get_preset  # no file needs it

        if (name := str(path)) in PRESETS:
            from turtlelog.simulate import simulate_run

            run = simulate_run(get_preset(name))
            return replace(run, notes={**run.notes, "preset": "a preset, simulated first"})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", recording.PartialRecordingWarning)
        return read_run(path, **_list_options(choice))


def _list_options(choice: ReadChoice) -> ReadOptions:
    return cast("ReadOptions", {one: getattr(choice, one) for one in ReadOptions.__annotations__})


def _read_bag_info(path: Path, choice: ReadChoice) -> RecordingInfo:
    def read(path: Path) -> RecordingInfo:
        is_folder, is_partial = path.is_dir(), choice.allow_partial
        return ros2.read_bag_info(path) if is_folder else read_info(path, allow_partial=is_partial)

    try:
        return read(path)
    except LogError:
        if not choice.allow_partial or not (path.is_dir() or is_bag_file(path)):
            raise
        with _recover(path) as recovered:
            if recovered is None:
                raise
            copy, lost = recovered
            found = read(copy)
    notes = {"recovered": lost, **found.notes}
    return replace(found, file=str(path), name=path.stem, complete=False, notes=notes)


def read_file_info(path: str | Path, choice: ReadChoice | None = None) -> RecordingInfo:
    """Return the contents of any file that `read_run` reads.

    Args:
        path: The file. Logs are read completely; others as by `read_info` and `read_bag_info`.
        choice: Selection as for `read_run`, of which `columns` and `allow_partial` are used.

    Raises:
        LogError: If the file cannot be read; one line with the file and the place.
    """
    path, topic = split_topic(path)
    choice = choice or ReadChoice()
    if topic is not None:
        info = read_file_info(path, choice)
        names = [found.topic for found in info.topics]
        if match_topic(topic, names) not in names:
            listed = ", ".join(names)[:300] or "none"
            raise LogError(f"{info.file}: expected a topic {topic}, found {listed}")
        return info
    has_tables, is_log = _recognise(path)
    if not has_tables and not is_log:
        found = _read_bag_info(path, choice)
        if found.format_version is None:
            return found  # what a bag does not use depends on its topics, which only reading shows
        unused = describe_unused(choice, "recording")
        return replace(found, notes={**found.notes, UNUSED: unused}) if unused else found
    run = _import_tables(path, choice, is_own=has_tables)
    rows = f"{len(run.poses)} poses, {len(run.commands)} commands, {len(run.samples)} samples"
    return RecordingInfo(
        file=str(path),
        format_version=None,
        source=run.source,
        name=run.name,
        complete=True,
        stop_reason=run.stop_reason,
        duration_s=(run.end_ns - run.begin_ns) / 1e9,
        parameters=run.parameters,
        topics=(),
        absent=run.absent,
        notes={"rows": rows} | {name: text for name, text in run.notes.items() if name != CHOSEN},
    )


def _recognise(path: Path) -> tuple[bool, bool]:
    """Return whether a file or folder contains exported tables, and whether it is a log of text."""
    with name_file(path, expected="a recording, a bag or a log"):
        path.stat()
        suffix, is_folder = path.suffix.lower(), path.is_dir()
        if suffix == ".toml":
            raise LogError(
                "a scenario or specification, not a recording; turtlelog run FILE.toml -o FILE.mcap"
                " makes one of a scenario"
            )
        # Table readers are loaded only for what may contain tables.
        has_tables = (suffix in LOG_SUFFIXES or is_folder) and log.holds_tables(path)
    return has_tables, suffix in LOG_SUFFIXES and not is_folder and not is_bag_file(path)


def _note_unused(run: "Run", choice: ReadChoice, kind: FileKind) -> "Run":
    unused = describe_unused(choice, kind, run.origin.commands)
    return replace(run, notes={**run.notes, UNUSED: unused}) if unused else run


def _read_own(path: Path, *, allow_partial: bool) -> "Run | None":
    """Return the run in a file or bag by turtlelog; None for third-party files."""
    try:
        files = ros2.list_bag_files(path) if path.is_dir() else (path,)
    except LogError:
        if not allow_partial:
            raise
        return None
    if len(files) != 1:
        return None
    try:
        return recording.read_if_own(files[0], allow_partial=allow_partial)
    except LogError:
        if allow_partial and ".bag" in files[0].suffixes:  # recovered as any other bag
            return None
        if is_bag_file(files[0]):
            with suppress(LogError):
                if read_info(files[0]).format_version is None:
                    return None
        raise


_FRAME_NS: Final = 1_000_000_000
"""Time between poses of a trajectory without times [ns], so that times and indices are of one
kind."""

_MOST_SKEW: Final = 0.01
"""Largest entry of R^T R - 1 of a rotation. The six digits of KITTI's files give 1e-5."""

_LONGEST_TIMES: Final = 64 * 2**20
"""Largest file of times [bytes]: 2 million lines of 32 bytes, more than 50 hours at 10 Hz."""


def read_trajectory(
    path: str | Path, choice: ReadChoice | None = None, *, times: Path | None = None
) -> "Trajectory":
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
            table = log.read_plain_table(file, allow_partial=choice.allow_partial)
            if table.names == log.KITTI_COLUMNS and not table.has_header:
                return _build_kitti(file, table, times)
            of_robot = log.find_table_robots(table.names).get(choice.robot or "", {})
            columns = {**of_robot, **choice.columns}
            chosen = log.assign_columns(table.names, columns, table.units)
            if {"t", "x", "y", "z", "qx", "qy", "qz", "qw"} <= {*chosen}:
                return _build_from_table(file, log.Cells(table, chosen, choice.robot))
    bag = None
    if file.exists() and (file.is_dir() or is_bag_file(file)):
        with suppress(LogError):  # the reader of the run gives the error
            bag = ros2.open_bag(file)
    is_own = bag is not None and any(info.format_version is not None for info in bag.infos.values())
    # A turtlelog recording is read as a run; if a topic is named, like any bag.
    asked = choice if topic is None else replace(choice, pose_topic=topic)
    if bag is not None and (asked.pose_topic is not None or not is_own):
        found = ros2.read_bag_trajectory(bag, asked, names_topic=topic is not None)
        if found is not None:
            return found
    run = read_as_chosen(path, choice)
    planar = runs.build_planar_trajectory(run)
    names = [name for name in (CHOSEN, UNUSED, RESTARTS) if name in run.notes]
    return replace(planar, notes={name: run.notes[name] for name in names})


def _is_plain_table(path: Path, choice: ReadChoice) -> bool:
    """Return whether a file is a table that is neither turtlelog's nor the paper's."""
    if isinstance(path, RemotePath) or path.suffix.lower() == ".json" or path.is_dir():
        return False
    if not path.exists() or (path.suffix.lower() not in LOG_SUFFIXES) or is_bag_file(path):
        return False
    if choice.columns:
        return True
    with name_file(path, expected="a trajectory"):
        return not (log.holds_tables(path) or log.is_papers(path))


def _build_from_table(path: Path, cells: "Cells") -> "Trajectory":
    xyz_m = np.column_stack([cells.require(name) for name in "xyz"])
    x, y, z, w = cells.require_turns()
    turns = np.column_stack([w, x, y, z])
    notes = {CHOSEN: cells.describe()} if cells.table.has_header else {}
    notes |= cells.notes
    return runs.build_trajectory(path.stem, cells.time_ns, xyz_m, turns, notes=notes)


def _build_kitti(path: Path, table: "PlainTable", times: Path | None) -> "Trajectory":
    columns = table.columns.read(range(len(table.names)))
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
    turns[known] = runs.find_quaternions(rotations[known])
    if times is not None:
        time_ns = _read_times(times, len(values))
        return runs.build_trajectory(path.stem, time_ns, matrices[:, :, 3], turns, notes={})
    time_ns = np.arange(len(values), dtype=np.int64) * _FRAME_NS
    found = runs.build_trajectory(path.stem, time_ns, matrices[:, :, 3], turns, notes={})
    return replace(found, clock="frame")


def _read_times(path: Path, count: int) -> NDArray[np.int64]:
    """Return the times of poses [ns] from a file with one time [s] per line."""
    found: list[int] = []
    with name_file(path, expected="a file of times"), open_file(path) as stream:
        data = stream.read(_LONGEST_TIMES + 1)
        if len(data) > _LONGEST_TIMES:
            raise LogError(f"a file of times has at most {_LONGEST_TIMES // 2**20} MiB")
        kept = [*iterate_lines(data.decode("utf-8", errors="replace"), comments=False)]
        if len(kept) != count:
            raise LogError(
                f"expected a time for each of {describe_count(count, 'pose')}, found"
                f" {describe_count(len(kept), 'line')}"
            )
        for number, line in kept:
            time_ns = log.read_time(line.strip(), 9)
            if time_ns is None:
                raise LogError(f"line {number}: expected a time in s, found {line[:40]!r}")
            found.append(time_ns)
    return np.array(found, dtype=np.int64)
