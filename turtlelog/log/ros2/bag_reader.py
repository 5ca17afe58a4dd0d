"""Reading of a bag as a run: choice of topics, and their contents."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final, Unpack

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import format_utc
from turtlelog.errors import LogError
from turtlelog.laws.sequential_p import DECLARATION as SEQUENTIAL_P
from turtlelog.log.engine.opening import strip_suffixes
from turtlelog.log.engine.topic_columns import TopicColumns
from turtlelog.log.file_info import TopicInfo
from turtlelog.log.planar_poses import (
    TRANSFORMS,
    lift_poses,
    note_changes,
    separate_times,
    wrap_far_headings,
)
from turtlelog.log.read_choice import CHOSEN, ReadChoice, ReadOptions
from turtlelog.log.recording.head import MAY_BE_ABSENT, lacks_values
from turtlelog.log.recording.topics import (
    CONTROL,
    CONTROL_COLUMNS,
    LAW_STATE,
    PHASE,
    POSE,
    REFERENCE64,
    SENSED,
    SHAPED,
)
from turtlelog.log.ros2 import bag_commands
from turtlelog.log.ros2.bag_poses import (
    PoseSource,
    RobotTrack,
    find_poses,
    match_sensed,
    note_pick,
    order_poses,
    reports_sideways,
)
from turtlelog.log.ros2.bag_rows import (
    Bag,
    Held,
    OrderedRows,
    add_rows,
    note_lost,
    open_bag,
    time_rows,
)
from turtlelog.log.ros2.bag_topics import (
    NoPosesError,
    Pick,
    describe_other_places,
    describe_other_poses,
    describe_robots,
    describe_unread_topics,
    select_robot,
)
from turtlelog.log.ros2.computed_poses import judge_headings
from turtlelog.log.ros2.reported_motion import judge_rates, note_contradictions, note_motion
from turtlelog.log.ros2.set_clocks import note_steps
from turtlelog.log.ros2.stamps import TimesNs, note_crowded
from turtlelog.run import (
    Clock,
    CommandColumns,
    Origin,
    PoseColumns,
    Run,
    SampleColumns,
    find_greatest_loss,
)
from turtlelog.run.loops import DONE, PAUSE, Declaration

_SENSED: Final = (SENSED.name, SENSED.schema)


def read_bag(path: str | Path, **options: Unpack[ReadOptions]) -> Run:
    """Return the run in a ROS 2 bag, or in an MCAP file by another recorder.

    Poses with stamps are timed by their stamps, mapped to the recorder's clock; poses at nearly
    equal times are dropped (`time_rows`). Times count from the first pose or command. Rows are
    sorted by time, and exact duplicates are dropped. If several poses without stamps have the same
    time, the later poses are moved by 1 ns each. The run's notes give the counts, and the chosen
    topics with the alternatives.

    Args:
        path: A folder, with or without `metadata.yaml`, or a single MCAP or SQLite file.
        options: Fields of a `ReadChoice`, which override what is found in the bag.

    Raises:
        LogError: If the bag cannot be read, contains no poses, or several topics are possible. One
            line with the file and the place.
    """
    choice, bag = ReadChoice(**options), open_bag(path)
    with bag.name_errors():
        is_asked = choice.pose_topic is not None and choice.robot is None
        distinct, robots = (bag.topics, ()) if is_asked else select_robot(bag.topics, choice.robot)
        try:
            source = find_poses(bag, distinct, choice)
        except NoPosesError as err:
            run, topic = _read_commands_alone(bag, distinct, choice, err)
            named = describe_robots(robots, topic, choice.robot)
            return _note_rest(run, bag, distinct, choice, named)
        commands, lack = bag_commands.find_commands(bag, distinct, choice, pose_topic=source.home)
        names = {commands.topic.topic} if commands else set()
        if source.topic.topic == POSE.name:
            names |= {topic.topic for topic in distinct if (topic.topic, topic.type) == _SENSED}
        found: Held = [dict(of_file) for of_file in (*source.found, *bag.read(names))]
        source = replace(source, found=[])
        bag = bag.find_steps(found, source.topic.topic)
        moves_aside = partial(reports_sideways, bag, distinct, source)
        run, track = _build_run(
            bag.path, bag.undo_steps(found), source, commands, choice, moves_aside
        )
        run = note_steps(run, bag.steps)
        run = replace(run, notes={**run.notes, "commands": lack}) if lack else run
        if commands is not None and choice.command_topic is None:
            doubt = bag_commands.describe_other_robot(source.home, commands.topic.topic)
            run = replace(run, notes={**run.notes, "other_robot": doubt}) if doubt else run
        run = bag_commands.add_references(run, bag, source, track, choice)
        if source.topic.topic == POSE.name:
            run = _add_samples(run, bag, int(track.time_ns[0] - run.poses.time_ns[0]))
    # In transforms, the name of a robot may occur in the frames alone.
    has_frames = any((one.topic, one.type) == (source.topic.topic, TRANSFORMS) for one in distinct)
    asked = None if has_frames else choice.robot
    named = describe_robots(robots, source.topic.topic, asked)
    return _note_rest(run, bag, distinct, choice, named)


def _note_rest(
    run: Run, bag: Bag, topics: Sequence[TopicInfo], choice: ReadChoice, robots: str
) -> Run:
    """Return a run with notes on its bag's robots and other contents, and on the choices made."""
    # turtlelog's own topics are read only from its recordings.
    sensed = (SENSED,) if run.poses.sensed_xy_m is None else ()
    control = () if len(run.samples) else (CONTROL,)
    own = {topic.name: topic.schema for topic in (*control, REFERENCE64, SHAPED, *sensed)}
    rest = [
        topic
        for topic in topics
        if topic.count and (own.get(topic.topic) == topic.type or topic.topic == LAW_STATE)
    ]
    unread = ", ".join(f"{topic.count} of {topic.topic}" for topic in rest)
    found = {"robots": robots, "not_read": unread, "not_poses": describe_other_places(topics)}
    notes = {**run.notes, **{name: text for name, text in found.items() if text}}
    for info in bag.infos.values():
        notes |= info.notes
    if unreadable := describe_unread_topics(topics):
        notes["not_understood"] = unreadable
    origin = replace(
        run.origin,
        robot=choice.robot,
        unread_topics=tuple(topic.topic for topic in rest),
        lost=find_greatest_loss(*(info.lost for info in bag.infos.values())),
    )
    poses, commands = origin.poses, origin.commands
    line = f"poses from {poses.describe()}" if poses else "no poses"
    line += f", commands from {commands.describe()}" if commands else ", no commands"
    more = [f"; {text.format(notes[name])}" for name, text in _MORE.items() if name in notes]
    return replace(run, notes={**notes, CHOSEN: "".join([line, *more])}, origin=origin)


_MORE: Final = {
    "poses": "{}",
    "commands": "{}",
    "robots": "robots {}",
    "path": "path {}",
    "goal": "goal {}",
    "not_understood": "{}",
    "other_pose_topics": "also there: {}: --pose-topic",
    "other_frames": "also there: {}: --pose-frame and --world-frame",
    "other_command_topics": "also there: {}: --command-topic",
    "other_path_topics": "also there: {}: --path-topic",
}
"""Notes that follow the topics, in order."""


def _build_run(
    path: Path,
    found: Held,
    source: PoseSource,
    command_pick: Pick | None,
    choice: ReadChoice,
    moves_aside: Callable[[], bool],
) -> tuple[Run, RobotTrack]:
    """Return the run, and the positions of the robot on the recorder's clock."""
    poses, dropped, unturned, vertical = order_poses(found, source.topic)
    commands, lost = None, 0
    if command_pick is not None:
        commands, lost = bag_commands.order_commands(found, command_pick.topic, choice)
    track = RobotTrack(
        time_ns=poses.time_ns,
        received_ns=poses.time_ns,
        xy_m=np.column_stack([poses.columns["x"], poses.columns["y"]]),
        frame=source.origin.frame,
        tree=source.tree,
    )
    # Views: a second copy of x and y would take 16 bytes per pose.
    poses = replace(poses, columns={**poses.columns, **dict(zip("xy", track.xy_m.T, strict=True))})
    times = time_rows(poses.stamps, None if commands is None else commands.stamps, choice.time)
    track = replace(track, received_ns=track.time_ns[times.poses.rows])
    poses = poses.take(times.poses.rows, times.poses.time_ns)
    if commands is not None:
        commands = commands.take(times.commands.rows, times.commands.time_ns)
    poses, heading_notes, has_courses = judge_headings(poses, commands, moves_aside)
    columns, rate_notes = judge_rates(poses.time_ns, poses.columns)
    tables = [rows for rows in (poses, commands) if rows]
    start_ns = min(int(rows.time_ns[0]) for rows in tables)
    time_ns, moved = separate_times(poses.time_ns - start_ns)
    heading_rad, wrapped = wrap_far_headings(poses.columns["heading"])
    changes = {"moved_rows": str(moved), "wrapped_headings": str(wrapped)}
    changes |= note_lost({"pose": dropped, "command": lost}, unturned)
    others = source.notes.get("other_pose_topics")
    has_courses |= source.origin.has_courses
    motion = note_motion(poses, columns, track.xy_m, commands, vertical=vertical, others=others)
    has_headings = not has_courses and not motion.leaves_plane
    origin = replace(
        add_rows(source.origin, tables, start_ns),
        commands=None if command_pick is None else command_pick.source,
        has_leaps=motion.has_leaps,
        has_courses=has_courses,
    )
    notes = {
        "original_timestamp": format_utc(start_ns),
        **source.notes,
        **({"frame": origin.frame} if origin.frame else {}),
        **note_changes(origin),
        **changes,
        **times.notes,
        **heading_notes,
        **rate_notes,
        **(
            note_crowded(time_ns)
            or note_contradictions(time_ns, columns, has_headings=has_headings)
        ),
        **motion.notes,
        **(note_pick("command_topic", command_pick) if command_pick is not None else {}),
    }
    pose_columns = PoseColumns(
        time_ns=time_ns,
        xy_m=np.column_stack([columns["x"], columns["y"]]),
        heading_rad=heading_rad,
        speed_m_s=columns.get("speed"),
        turn_rate_rad_s=columns.get("turn_rate"),
        measured_speed_m_s=columns.get("measured_speed"),
        measured_turn_rate_rad_s=columns.get("measured_turn_rate"),
        **match_sensed(found, track.time_ns, moved),
        **lift_poses(columns.get("z"), columns.get("tilt")),
    )
    command_columns = _build_commands(commands, start_ns)
    return _join_run(path, pose_columns, command_columns, times.clock, origin, notes), track


def _build_commands(rows: OrderedRows | None, start_ns: int) -> CommandColumns:
    """Return commands as columns of a run, with times from its start."""
    if rows is None:
        return CommandColumns.build_empty()
    return CommandColumns(
        time_ns=rows.time_ns - start_ns,
        speed_m_s=rows.columns["speed"],
        lateral_speed_m_s=rows.columns["lateral_speed"],
        turn_rate_rad_s=rows.columns["turn_rate"],
    )


def _join_run(
    path: Path,
    poses: PoseColumns,
    commands: CommandColumns,
    clock: Clock | None,
    origin: Origin,
    notes: Mapping[str, str],
) -> Run:
    """Return the run of a bag, perhaps without poses."""
    name = path.resolve().name
    storage = {".mcap": "mcap", ".bag": "rosbag1"}.get(path.suffix, "rosbag2")
    absent: tuple[str, ...] = () if len(poses) else ("poses",)
    absent += () if poses.speed_m_s is not None else ("poses.speed_m_s", "poses.turn_rate_rad_s")
    return Run(
        name=name if path.is_dir() else strip_suffixes(path),
        source=f"{storage}: {name}",
        poses=poses,
        commands=commands,
        samples=SampleColumns.build_empty(),
        clock=clock,
        absent=(*absent, *(() if len(commands) else ("commands",)), *_NEVER_IN_BAGS),
        origin=origin,
        notes=notes,
    )


_NEVER_IN_BAGS: Final = (
    *("samples", "goal_xy_m", "goal_heading_rad", "parameters", "stop_reason", "events"),
)
"""Fields of `Run` that no bag of a robot contains."""


def _read_commands_alone(
    bag: Bag, topics: Sequence[TopicInfo], choice: ReadChoice, err: NoPosesError
) -> tuple[Run, str]:
    """Return the run of a bag that contains commands but no poses, and the topic's name."""
    pick, lack = bag_commands.choose_commands(topics, choice, pose_topic="")
    if pick is None:
        raise NoPosesError(f"no poses; {lack}") if lack else err
    if not choice.allow_no_poses:
        if err.is_unread:  # the reason of unreadable poses is more helpful
            raise err
        raise NoPosesError(
            f"no poses, only commands on {pick.source.describe()}: info, metrics, check, plot and"
            " replay take commands alone, and what was asked for needs poses"
        )
    for name in ("goal", "path_topic"):
        if getattr(choice, name) is not None:
            raise LogError(f"{name}: expected poses, found commands alone on {pick.topic.topic}")
    found: Held = [dict(of_file) for of_file in bag.read({pick.topic.topic})]
    bag = bag.find_steps(found, pick.topic.topic)
    rows, dropped = bag_commands.order_commands(bag.undo_steps(found), pick.topic, choice)
    if rows is None:
        raise LogError(
            f"topic {pick.topic.topic}: expected numbers, found nan or infinity in all"
            f" {dropped} commands"
        )
    times = time_rows(rows.stamps, None, choice.time, noun="commands")
    rows = rows.take(times.poses.rows, times.poses.time_ns)
    poses, start_ns = PoseColumns.build_empty(), int(rows.time_ns[0])
    origin = add_rows(Origin(commands=pick.source), [rows], start_ns)
    notes = {
        "original_timestamp": format_utc(start_ns),
        **note_changes(origin),
        **note_lost({"command": dropped}),
        **times.notes,
        **describe_other_poses(topics),
        **note_pick("command_topic", pick),
    }
    commands = _build_commands(rows, start_ns)
    run = _join_run(bag.path, poses, commands, times.clock, origin, notes)
    return note_steps(run, bag.steps), pick.topic.topic


def _add_samples(run: Run, bag: Bag, start_ns: int) -> Run:
    """Return a run with the samples of its bag if they fit its poses. A note describes the result.

    The run has the poses of `/turtle1/pose`; its time 0 is `start_ns` on the recorder's clock.
    """
    kinds = {(topic.topic, topic.type) for topic in bag.topics if topic.count}
    if (CONTROL.name, CONTROL.schema) not in kinds:
        return run
    names = {CONTROL.name, *({PHASE.name} if (PHASE.name, PHASE.schema) in kinds else ())}
    files = bag.read(names)
    found = [of_file[CONTROL.name] for of_file in files if CONTROL.name in of_file]
    phases = [of_file[PHASE.name] for of_file in files if PHASE.name in of_file]
    try:
        time_ns, columns = _join(found)
        written = sum(topic.count for topic in bag.topics if topic.topic == POSE.name)
        _require_fit(run, written, time_ns - start_ns, columns)
    except LogError as err:
        return replace(run, notes={**run.notes, "samples": f"not read: {err}"})
    told = _read_names(phases, time_ns, columns["phase"])
    usual = "as those of sequential-p, as nothing else names them"
    note = (
        f"from {CONTROL.name}; phases are named {usual if told is None else 'by /turtle1/phase'};"
        " the law, its loops and its parameters are not known"
    )
    return replace(
        run,
        samples=SampleColumns(time_ns=time_ns - start_ns, **columns),
        declaration=_declare(told, int(columns["phase"].max())),
        absent=("declaration", *(name for name in run.absent if name != "samples")),
        notes={**run.notes, "samples": note},
    )


def _join(found: list[TopicColumns]) -> tuple[NDArray[np.int64], dict[str, Any]]:
    """Return times and columns of the samples of all files, sorted by sample number."""
    names = [name for parts in CONTROL_COLUMNS.values() for name in parts]
    try:
        fields = {
            name: np.concatenate([columns.fields[name] for columns in found]) for name in names
        }
    except KeyError as err:
        raise LogError(f"the field {err.args[0]} is missing") from err
    order = np.argsort(fields["sequence"], kind="stable")
    time_ns = np.concatenate([columns.log_time_ns for columns in found])[order]
    numbers = fields["sequence"][order].astype(np.int64)
    if (np.diff(numbers) <= 0).any() or (np.diff(time_ns) < 0).any():
        raise LogError("expected numbers and times that rise together, found others")
    columns: dict[str, Any] = {}
    for name, parts in CONTROL_COLUMNS.items():
        values = np.column_stack([fields[part][order] for part in parts])
        kind = np.float64 if values.dtype.kind == "f" else np.int64
        columns[name] = (values if len(parts) > 1 else values[:, 0]).astype(kind)
    return time_ns, {
        name: None if name in MAY_BE_ABSENT and lacks_values(name, values) else values
        for name, values in columns.items()
    }


def _require_fit(run: Run, written: int, time_ns: TimesNs, columns: Mapping[str, Any]) -> None:
    """Refuse samples, answered at `time_ns`, whose pose numbers are not rows of the run's poses."""
    read, poses = columns["pose_sequence"], run.poses
    if written != len(poses):
        raise LogError(f"expected the {written} poses as they are numbered, found {len(poses)}")
    if int(read.max()) >= len(poses):
        raise LogError(f"expected pose {read.max()}, which a sample read, found {len(poses)} poses")
    early = time_ns < poses.time_ns[read]
    if early.any() or (np.diff(read) < 0).any():
        row = int(early.argmax())
        raise LogError(f"expected pose {read[row]} before the sample that read it, found it later")
    speeds = columns["speed_m_s"], columns["turn_rate_rad_s"]
    if not np.isfinite(speeds).all():
        raise LogError("expected commands that are numbers, found nan or infinity")


def _read_names(
    phases: list[TopicColumns], time_ns: TimesNs, phase: NDArray[np.int64]
) -> dict[int, str] | None:
    """Return the phase names by number; None if the phase messages contradict the samples."""
    named: dict[int, str] = {}
    for columns in phases:
        pairs = zip(columns.log_time_ns.tolist(), columns.fields["data"].tolist(), strict=True)
        for at_ns, name in pairs:
            row = int(np.searchsorted(time_ns, at_ns))
            if name in {PAUSE, DONE} or row >= len(time_ns) or time_ns[row] != at_ns:
                continue
            if named.setdefault(int(phase[row]), name) != name:
                return None
    is_whole = {*phase.tolist()} <= {*named}
    return named if is_whole and len({*named.values()}) == len(named) else None


def _declare(named: Mapping[int, str] | None, highest: int) -> Declaration:
    usual = dict(enumerate(SEQUENTIAL_P.phase_names))
    if named is None or all(usual.get(number) == name for number, name in named.items()):
        named = usual
    names = [named.get(number, f"phase_{number}") for number in range(max(highest, *named) + 1)]
    return Declaration(phases=dict.fromkeys(names, ()))
