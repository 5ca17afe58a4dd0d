"""Reading of a bag as a run: choice of topics, and their contents."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Unpack

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import describe_count, format_short, format_utc
from turtlelog.errors import LogError
from turtlelog.log.file_access import name_file
from turtlelog.log.file_info import TopicInfo
from turtlelog.log.read_choice import CHOSEN, ReadChoice, ReadOptions
from turtlelog.log.recording.topics import CONTROL, LAW_STATE, POSE, REFERENCE64, SENSED, SHAPED
from turtlelog.log.ros2.bag import Bag, open_bag
from turtlelog.log.ros2.bag_clock import time_rows
from turtlelog.log.ros2.bag_commands import (
    NEVER_IN_BAGS,
    add_samples,
    build_commands,
    choose_commands,
    name_bag,
    order_commands,
    read_commands_alone,
)
from turtlelog.log.ros2.bag_poses import PoseSource, find_poses, note_pick
from turtlelog.log.ros2.bag_references import RobotTrack, add_references
from turtlelog.log.ros2.bag_robots import BagRobot, describe_robots, require_robot, select_robot
from turtlelog.log.ros2.bag_rows import (
    Held,
    OrderedRows,
    Values,
    drop_not_finite,
    order_topic,
    separate_times,
    wrap_far_headings,
)
from turtlelog.log.ros2.bag_topics import NoPosesError, Pick, describe_unread_topics
from turtlelog.log.ros2.pose_types import TRANSFORMS, extract_poses
from turtlelog.log.ros2.reported_motion import (
    LATERAL,
    PATH_NOTE,
    SPEED,
    describe_leaps,
    describe_paths,
    describe_small_leaps,
    judge_rates,
    measure_paths,
)
from turtlelog.log.spatial_poses import describe_height, describe_level, lift_poses
from turtlelog.run import PoseColumns, Run, SampleColumns

NOT_READ: Final = "not_read"
"""Name of the note on messages that were not read."""

NOT_UNDERSTOOD: Final = "not_understood"
"""Name of the note on topics of poses, commands, goals or paths that cannot be read."""

_SENSED: Final = (SENSED.name, SENSED.schema)

_RATES: Final = frozenset({"speed", "turn_rate", "lateral_speed"})
"""Rates in messages of poses. In a topic of sensed poses, all rates are NaN."""


def read_bag(path: str | Path, **options: Unpack[ReadOptions]) -> Run:
    """Return the run in a ROS 2 bag, or in an MCAP file by another recorder.

    Poses with stamps are timed by their stamps, mapped to the recorder's clock; poses at nearly
    equal times are dropped (`time_rows`). Times count from the first pose or command. Rows are
    sorted by time, and exact duplicates are dropped. If several poses without stamps have the same
    time, the later poses are moved by 1 ns each. The run's notes give the counts, and the chosen
    topics with the alternatives.

    Args:
        path: A folder, with or without `metadata.yaml`, or a single MCAP or SQLite file.
        options: Fields of a `ReadChoice`: topics, frames and goal, which add to or override those
            found in the bag.

    Raises:
        LogError: If the bag cannot be read, contains no poses, or several topics are possible. One
            line with the file and the place.
    """
    choice, bag = ReadChoice(**options), open_bag(path)
    with _name_once(bag):
        is_asked = choice.pose_topic is not None and choice.robot is None
        distinct, robots = (bag.topics, ()) if is_asked else select_robot(bag.topics, choice.robot)
        try:
            source = find_poses(bag, distinct, choice)
        except NoPosesError as err:
            run, topic = read_commands_alone(bag, distinct, choice, err)
            return _note_chosen(_note_robots(run, robots, topic, choice.robot), bag, distinct)
        commands, lack = choose_commands(distinct, choice, pose_topic=source.home)
        names = {commands.topic.topic} if commands else set()
        if source.topic.topic == POSE.name:
            names |= {topic.topic for topic in distinct if (topic.topic, topic.type) == _SENSED}
        found: Held = [dict(of_file) for of_file in (*source.found, *bag.read(names))]
        source = replace(source, found=[])
        run, track = _build_run(bag.path, found, source, commands, choice)
        run = replace(run, notes={**run.notes, "commands": lack}) if lack else run
        run = add_references(run, bag, source, track, choice)
        if source.topic.topic == POSE.name:
            run = add_samples(run, bag, int(track.time_ns[0] - run.poses.time_ns[0]))
    # In transforms, the name of a robot may occur in the frames alone.
    has_frames = any((one.topic, one.type) == (source.topic.topic, TRANSFORMS) for one in distinct)
    asked = None if has_frames else choice.robot
    return _note_chosen(_note_robots(run, robots, source.topic.topic, asked), bag, distinct)


def _note_robots(run: Run, robots: Sequence[BagRobot], topic: str, asked: str | None) -> Run:
    """Return a run with a note on the robots of its bag and the one that the topic belongs to.

    A requested robot is refused if the topic belongs to another.
    """
    words = {*topic.split("/")[:-1]}
    if asked is not None:
        require_robot(asked, topic, robots)
    chosen = next((robot.name for robot in robots if robot.name in words), None)
    notes = {"robots": describe_robots(robots, chosen)} if robots else {}
    return replace(run, notes={**run.notes, **notes})


def _note_chosen(run: Run, bag: Bag, topics: Sequence[TopicInfo]) -> Run:
    """Return a run with notes on its bag's other contents and on the choices made."""
    unread = describe_unread_topics(topics)
    of_files = {name: text for info in bag.infos.values() for name, text in info.notes.items()}
    notes = {**run.notes, **_note_rest(topics, run), **of_files}
    notes |= {NOT_UNDERSTOOD: unread} if unread else {}
    return replace(run, notes={**notes, CHOSEN: _describe_chosen(notes)})


@contextmanager
def _name_once(bag: Bag) -> Iterator[None]:
    """Add the bag's name to errors, unless an error names one of its files."""
    try:
        with name_file(bag.path, expected="a bag"):
            yield
    except LogError as err:
        text = str(err).removeprefix(f"{bag.path}: ")
        if not any(text.startswith(f"{file}: ") for file in bag.infos):
            raise
        raise LogError(text) from err


def _describe_chosen(notes: Mapping[str, str]) -> str:
    """Return one line on the topics that were read, with the alternatives."""
    poses, commands = notes.get("pose_topic"), notes.get("command_topic")
    line = f"poses from {poses}" if poses else "no poses"
    line += f", commands from {commands}" if commands else ", no commands"
    more = [f"; {text.format(notes[name])}" for name, text in _MORE.items() if name in notes]
    return "".join([line, *more])


_MORE: Final = {
    "commands": "{}",
    "robots": "robots {}",
    "path": "path {}",
    "goal": "goal {}",
    NOT_UNDERSTOOD: "{}",
    "other_pose_topics": "also there: {}: --pose-topic",
    "other_frames": "also there: {}: --pose-frame and --world-frame",
    "other_command_topics": "also there: {}: --command-topic",
    "other_path_topics": "also there: {}: --path-topic",
}
"""Notes that follow the topics, in order."""


def _note_rest(topics: Iterable[TopicInfo], run: Run) -> dict[str, str]:
    """Return a note on turtlelog's topics, which are read only from turtlelog's recordings."""
    sensed = (SENSED,) if run.poses.sensed_xy_m is None else ()
    control = () if len(run.samples) else (CONTROL,)
    own = {topic.name: topic.schema for topic in (*control, REFERENCE64, SHAPED, *sensed)}
    rest = [
        f"{topic.count} of {topic.topic}"
        for topic in topics
        if topic.count and (own.get(topic.topic) == topic.type or topic.topic == LAW_STATE)
    ]
    return {NOT_READ: ", ".join(rest)} if rest else {}


def _build_run(
    path: Path, found: Held, source: PoseSource, command_pick: Pick | None, choice: ReadChoice
) -> tuple[Run, RobotTrack]:
    """Return the run, and the positions of the robot on the recorder's clock."""
    poses, dropped = _order_poses(found, source.topic)
    commands = None
    if command_pick is not None:
        commands, lost = order_commands(found, command_pick.topic, choice)
        dropped = replace(dropped, commands=lost)
    track = RobotTrack(
        time_ns=poses.time_ns,
        xy_m=np.column_stack([poses.columns["x"], poses.columns["y"]]),
        frame=source.frame,
        tree=source.tree,
    )
    # Views: a second copy of x and y would take 16 bytes per pose.
    poses = replace(poses, columns={**poses.columns, **dict(zip("xy", track.xy_m.T, strict=True))})
    times = time_rows(poses.stamps, None if commands is None else commands.stamps, choice.time)
    poses = poses.take(times.poses.rows, times.poses.time_ns)
    columns, rate_notes = judge_rates(poses.time_ns, poses.columns)
    if commands is not None:
        commands = commands.take(times.commands.rows, times.commands.time_ns)
    tables = [rows for rows in (poses, commands) if rows]
    start_ns = min(int(rows.time_ns[0]) for rows in tables)
    time_ns, moved = separate_times(poses.time_ns - start_ns)
    heading_rad, wrapped = wrap_far_headings(poses.columns["heading"])
    name, source_words = name_bag(path)
    absent = () if "speed" in columns else ("poses.speed_m_s", "poses.turn_rate_rad_s")
    sensed = _match_sensed(found, track.time_ns, moved)
    plane = describe_height(columns.get("z"), columns.get("tilt"))
    others = source.notes.get("other_pose_topics")
    notes = {
        "original_timestamp": format_utc(start_ns),
        **source.notes,
        **({"frame": source.frame} if source.frame else {}),
        **_note_rows(tables, dropped, moved=moved, wrapped=wrapped),
        **times.notes,
        **rate_notes,
        **_note_crowded(time_ns),
        **_note_plane(plane, dropped.vertical, track, columns.get("z")),
        **({} if plane else _note_paths(poses, columns, commands, others)),
        **(note_pick("command_topic", command_pick) if command_pick is not None else {}),
    }
    run = Run(
        name=name,
        source=source_words,
        poses=_build_poses(time_ns, heading_rad, columns, sensed),
        commands=build_commands(commands, start_ns),
        samples=SampleColumns.build_empty(),
        clock=times.clock,
        absent=(*absent, *(() if commands else ("commands",)), *NEVER_IN_BAGS),
        notes=notes,
    )
    return run, track


def _build_poses(
    time_ns: NDArray[np.int64],
    heading_rad: Values,
    columns: Mapping[str, Values],
    sensed: Values | None,
) -> PoseColumns:
    """Return the poses of a run; `sensed` has x, y and heading in columns."""
    return PoseColumns(
        time_ns=time_ns,
        xy_m=np.column_stack([columns["x"], columns["y"]]),
        heading_rad=heading_rad,
        speed_m_s=columns.get("speed"),
        turn_rate_rad_s=columns.get("turn_rate"),
        measured_speed_m_s=columns.get("measured_speed"),
        measured_turn_rate_rad_s=columns.get("measured_turn_rate"),
        sensed_xy_m=None if sensed is None else sensed[:, :2].copy(),
        sensed_heading_rad=None if sensed is None else sensed[:, 2].copy(),
        **lift_poses(columns.get("z"), columns.get("tilt")),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Dropped:
    """Numbers of rows that were left out.

    Attributes:
        poses: Poses with NaN or infinity.
        commands: Commands with NaN or infinity.
        unturned: Poses at a place, but without a heading.
        vertical: Poses without a heading because the forward axis points up or down.
    """

    poses: int
    commands: int = 0
    unturned: int
    vertical: int


def _order_poses(found: Held, topic: TopicInfo) -> tuple[OrderedRows, _Dropped]:
    """Return the finite poses in order of time, and the numbers of dropped ones."""
    poses = order_topic(found, topic, extract_poses)
    has_place = np.isfinite(poses.columns["x"]) & np.isfinite(poses.columns["y"])
    unturned = has_place & np.isnan(poses.columns["heading"])
    vertical = _count_vertical(poses.columns, unturned)
    poses, dropped = _drop_nan(poses, topic.topic)
    return poses, _Dropped(poses=dropped, unturned=int(unturned.sum()), vertical=vertical)


def _drop_nan(rows: OrderedRows, topic: str) -> tuple[OrderedRows, int]:
    """Return the finite poses and the number of dropped poses. Speeds with NaN are dropped."""
    speeds = [name for name in rows.columns if name.removeprefix("measured_") in _RATES]
    unknown = [name for name in speeds if not np.isfinite(rows.columns[name]).any()]
    columns = {name: column for name, column in rows.columns.items() if name not in unknown}
    # Height and tilt are only described, and few robots move sideways.
    needed = [name for name in columns if name not in {"z", "tilt", LATERAL}]
    kept, dropped = drop_not_finite(replace(rows, columns=columns), needed)
    if not len(kept.time_ns) and _count_vertical(columns, np.isnan(columns["heading"])) == dropped:
        raise LogError(
            f"topic {topic}: the forward axis points up or down in all {dropped} poses: there is no"
            " heading"
        )
    if not len(kept.time_ns):
        raise LogError(
            f"topic {topic}: expected numbers in x, y and heading, found nan or infinity in all"
            f" {dropped} poses"
        )
    return kept, dropped


_CROWDED_NS: Final = 10_000
"""Usual time between poses below which the times are wrong [ns]: the fastest motion capture takes a
pose every 100 us."""


def _note_crowded(time_ns: NDArray[np.int64]) -> dict[str, str]:
    """Return a note on poses that are too close in time for a sensor, if they are."""
    steps_ns = np.diff(time_ns)
    if len(time_ns) < 3 or 2 * np.count_nonzero(steps_ns < _CROWDED_NS) <= len(steps_ns):
        return {}
    span = format_short(float(time_ns[-1] - time_ns[0]) / 1e9, "s")
    text = f"all {len(time_ns)} poses lie within {span}: their times, and all rates, are wrong"
    return {"crowded": text}


def _list_speeds(commands: OrderedRows | None) -> tuple[NDArray[np.int64], Values] | None:
    """Return publication times [ns] and speeds [m/s] of the commands."""
    if commands is None:
        return None
    speed, lateral = commands.columns["speed"], commands.columns["lateral_speed"]
    return commands.time_ns, np.hypot(speed, lateral)


def _count_vertical(columns: Mapping[str, Values], rows: NDArray[np.bool_]) -> int:
    """Return the number of poses without a heading because the forward axis points up or down."""
    tilt_rad = columns.get("tilt")
    # A quaternion that was never set has a tilt of 0.
    return 0 if tilt_rad is None else int((tilt_rad[rows] > 0.0).sum())


def _note_rows(
    tables: Sequence[OrderedRows], dropped: _Dropped, *, moved: int, wrapped: int
) -> dict[str, str]:
    """Return notes on rows that were sorted, changed or left out."""
    notes = {
        "sorted_rows": str(sum(rows.late for rows in tables)),
        "dropped_duplicates": str(sum(rows.duplicates for rows in tables)),
        "moved_rows": str(moved),
        "wrapped_headings": str(wrapped),
    }
    kinds = {"pose": dropped.poses, "command": dropped.commands}
    counts = [describe_count(count, kind) for kind, count in kinds.items() if count]
    if not counts:
        return notes
    without = f", {dropped.unturned} of the poses without a heading" if dropped.unturned else ""
    return {**notes, "dropped_nan": f"{' and '.join(counts)}{without}"}


def _note_plane(
    plane: str | None, vertical: int, track: RobotTrack, z_m: Values | None
) -> dict[str, str]:
    """Return notes on poses off the plane, on leaps, and on the height of a level robot."""
    notes = {}
    if plane is not None or vertical:
        lost = ""
        if vertical:
            which = "pose has" if vertical == 1 else "poses have"
            lost = (
                f"; left out: {vertical} {which} no heading, as the forward axis points up or down"
            )
        notes["plane"] = f"{plane or 'the robot leaves the plane'}{lost}"
    leaps = describe_leaps(track.xy_m) or describe_small_leaps(track.xy_m)
    if leaps is not None:
        notes["leaps"] = leaps
    level = describe_level(z_m) if plane is None else None
    return notes if level is None else {**notes, "height": level}


def _note_paths(
    poses: OrderedRows,
    columns: Mapping[str, Values],
    commands: OrderedRows | None,
    others: str | None,
) -> dict[str, str]:
    """Return a note on lengths of paths that differ; `others` are the other topics of poses.

    The robot must stay in the plane: speeds are along its axes, and differ from those seen from
    above if it leaves the plane.
    """
    reported = poses.columns if SPEED in columns else columns
    paths = describe_paths(measure_paths(poses.time_ns, reported, _list_speeds(commands)))
    if paths is None:
        return {}
    is_of_poses = others is not None and "poses" in paths
    return {PATH_NOTE: f"{paths}; others: {others}" if is_of_poses else paths}


def _match_sensed(found: Held, time_ns: NDArray[np.int64], moved: int) -> Values | None:
    """Return sensed x, y and heading at the times of the poses; NaN if a pose was not sensed.

    The result is None if there are no sensed poses, or their times do not identify the poses, as
    with a wall clock.
    """
    kind = TopicInfo(topic=SENSED.name, type=SENSED.schema, count=0)
    if moved or not any(SENSED.name in of_file for of_file in found):
        return None
    sensed = order_topic(found, kind, extract_poses)
    rows = np.searchsorted(time_ns, sensed.time_ns)
    is_known = np.isin(sensed.time_ns, time_ns).all()
    if not is_known or (np.diff(sensed.time_ns) == 0).any():
        return None
    values = np.full((len(time_ns), 3), np.nan)
    values[rows] = np.column_stack([sensed.columns[name] for name in ("x", "y", "heading")])
    return values
