"""Writing of runs as recordings and rosbag2 folders, with /odom, /tf and /path for others."""

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import LogError
from turtlelog.files.urls import make_path
from turtlelog.log.engine.message_types import Column, PackedItems, lay_out_alike, read_type
from turtlelog.log.engine.topic_columns import TopicColumns
from turtlelog.log.file_access import create_folder, name_write_error
from turtlelog.log.file_info import METADATA_FILE, describe_bag, format_scenario_file
from turtlelog.log.mcap_writer import write_columns
from turtlelog.log.read_choice import NOTES
from turtlelog.log.recording import topics
from turtlelog.log.recording.head import (
    FORMAT_VERSION,
    HEAD,
    MAY_BE_ABSENT,
    Head,
    format_head,
)
from turtlelog.run import Event, PoseColumns, Run, SampleColumns, require_run
from turtlelog.run.loops import DONE, PAUSE
from turtlelog.run.tables import find_phase_spans
from turtlelog.scenario import DEFAULT_LAW

Values = dict[str, Any]

_LONGEST_NAME: Final = 255  # bytes; the limit of file systems

_INFO: Final = 20
_WARN: Final = 30
_TWIST: Final = ("linear.x", "angular.z")


def write_recording(run: Run, path: str | Path, *, shares_poses: bool = False) -> None:
    """Write a run as an MCAP file. Equal runs give identical files.

    Args:
        run: Run to write.
        path: The file.
        shares_poses: Whether to write the poses also to `/odom`, `/tf` and `/path` for other
            programs; turtlelog ignores these topics.

    Raises:
        LogError: If the file cannot be written, or a recording cannot store the run.
    """
    require_run(run)
    try:
        messages = build_messages(run)
        messages += build_shared_messages(run) if shares_poses else ()
        head, scenario = format_head(describe_run(run)), format_scenario_file(run)
    except (LogError, UnicodeEncodeError) as err:
        raise name_write_error(path, err) from err
    definitions = topics.define_types(run.declaration, run.parameters.get("law.kind", DEFAULT_LAW))
    write_columns(
        messages, path, definitions=definitions, metadata={HEAD: head}, attachments=scenario
    )


def export_rosbag2(run: Run, path: str | Path, *, shares_poses: bool = False) -> tuple[Path, ...]:
    """Write a run as a rosbag2 folder, which `ros2 bag` and programs based on it can open.

    The folder contains one recording, written by `write_recording` and named like the first file of
    a ROS 2 bag. `turtlelog` reads the folder back as the same run.

    Args:
        run: Run to write.
        path: Path of the folder.
        shares_poses: As in `write_recording`.

    Raises:
        LogError: If the folder exists or cannot be written, or a recording cannot store the run.
    """
    path = make_path(path)
    name = f"{path.resolve().name}_0.mcap"
    if len(name.encode(errors="replace")) > _LONGEST_NAME:
        raise LogError(f"{path}: expected a shorter name")
    if not name.isprintable():
        # The bag's metadata.yaml contains the name, in UTF-8 and on one line.
        raise LogError(f"{path}: expected a name of printable characters, found {name!a}")
    with create_folder(path) as folder:
        try:
            write_recording(run, folder / name, shares_poses=shares_poses)
        except LogError as err:
            # The name of the temporary folder is removed: users do not know it.
            raise LogError(f"{path}: {str(err).removeprefix(f'{folder / name}: ')}") from err
        text = describe_bag([folder / name])
        (folder / METADATA_FILE).write_text(text, encoding="utf-8", newline="\n")
    return path / name, path / METADATA_FILE


def build_messages(run: Run) -> tuple[TopicColumns, ...]:
    """Return the messages of a run in the order of `list_topics`, without empty topics."""
    _require_range("poses.time_ns", run.poses.time_ns, 2**63)
    _require_range("commands.time_ns", run.commands.time_ns, 2**63)
    _require_range("samples.time_ns", run.samples.time_ns, 2**63)
    _require_range("samples.sequence", run.samples.sequence, 2**32)
    _require_range("events.time_ns", np.array([event.time_ns for event in run.events]), 2**63)
    poses, samples, goal = run.poses, run.samples, list[tuple[int, Values]]()
    if run.goal_xy_m is not None:
        time_ns = int(poses.time_ns[0])
        goal = [(time_ns, describe_pose(time_ns, *run.goal_xy_m, run.goal_heading_rad))]
    measured = poses.measured_speed_m_s, poses.measured_turn_rate_rad_s
    shaped = samples.shaped_speed_m_s, samples.shaped_turn_rate_rad_s
    messages = (
        _collect_rows(topics.GOAL, goal),
        *_build_poses(poses),
        *_build_sensed(poses),
        *_build_twists(topics.MEASURED, poses.time_ns, measured),
        _build_samples(samples),
        *_build_states(run),
        *_build_references(run),
        *_build_twists(topics.SHAPED, samples.time_ns, shaped, samples.sequence.astype(np.uint32)),
        _build_commands(run),
        _build_phases(run),
        _collect_rows(topics.EVENT, [(one.time_ns, tabulate_event(one)) for one in run.events]),
    )
    return tuple(of_topic for of_topic in messages if len(of_topic))


_NOT_RECORDED: Final = frozenset(name for name, kind in NOTES.items() if not kind.is_recorded)


def describe_run(run: Run) -> Head:
    """Return the metadata for the recording of a run."""
    poses, samples = ["speed_m_s", "turn_rate_rad_s"], [*MAY_BE_ABSENT]
    measured = [f"measured_{name}" for name in poses]
    is_measured = any(getattr(run.poses, name) is not None for name in measured)
    poses += measured if is_measured else ()
    if run.declaration.has_reference:
        samples += "reference_xy_m", "reference_heading_rad"
    nan_columns = [f"poses.{name}" for name in poses if getattr(run.poses, name) is None]
    nan_columns += [f"samples.{name}" for name in samples if getattr(run.samples, name) is None]
    more_topics = {
        topics.SENSED.name: run.poses.sensed_xy_m is not None,
        topics.SHAPED.name: run.samples.shaped_speed_m_s is not None,
        topics.MEASURED.name: is_measured,
    }
    return Head(
        format_version=FORMAT_VERSION,
        source=run.source,
        name=run.name,
        stop_reason=run.stop_reason,
        goal_heading_rad=run.goal_heading_rad,
        absent=run.absent,
        nan_columns=frozenset(nan_columns),
        more_topics=frozenset(name for name, is_there in more_topics.items() if is_there),
        declaration=run.declaration,
        clock=run.clock,
        origin=run.origin,
        simulated_by=run.simulated_by,
        notes={name: text for name, text in run.notes.items() if name not in _NOT_RECORDED},
    )


def describe_pose(time_ns: int, x_m: float, y_m: float, heading_rad: float | None) -> Values:
    """Return the fields of a goal or reference; a missing heading becomes 0."""
    half_rad = (heading_rad or 0.0) / 2.0
    seconds, nanoseconds = divmod(time_ns, 1_000_000_000)
    return {
        "header.stamp.sec": seconds,
        "header.stamp.nanosec": nanoseconds,
        "header.frame_id": "world",
        "pose.position.x": x_m,
        "pose.position.y": y_m,
        "pose.orientation.z": math.sin(half_rad),
        "pose.orientation.w": math.cos(half_rad),
    }


def tabulate_event(event: Event) -> Values:
    """Return the fields of an event's message."""
    seconds, nanoseconds = divmod(event.time_ns, 1_000_000_000)
    return {
        "stamp.sec": seconds,
        "stamp.nanosec": nanoseconds,
        "level": _INFO if event.kind == "stop" else _WARN,
        "name": "turtlesim" if event.kind == "wall_hit" else "controller",
        "msg": event.text,
        "function": event.kind,
    }


def _require_range(name: str, values: NDArray[np.int64], end: int) -> None:
    for value in (values.min(), values.max()) if values.size else ():
        if not 0 <= value < end:
            raise LogError(f"{name}: expected values from 0 to below {end}, found {value}")


def _collect(
    topic: topics.Topic,
    time_ns: NDArray[np.int64],
    fields: Mapping[str, Column],
    sequence: NDArray[np.uint32] | None = None,
) -> TopicColumns:
    """Return messages of a topic, numbered from 0 or by `sequence`."""
    return TopicColumns(
        topic=topic.name,
        type=topic.schema,
        log_time_ns=time_ns,
        publish_time_ns=time_ns,
        sequence=np.arange(len(time_ns), dtype=np.uint32) if sequence is None else sequence,
        fields=fields,
    )


def _collect_rows(
    topic: topics.Topic,
    rows: Sequence[tuple[int, Values]],
    sequence: NDArray[np.uint32] | None = None,
) -> TopicColumns:
    names = rows[0][1] if rows else ()
    fields = {name: np.array([row[name] for _, row in rows], dtype=object) for name in names}
    time_ns = np.array([time_ns for time_ns, _ in rows], dtype=np.int64)
    return _collect(topic, time_ns, fields, sequence)


def _build_poses(poses: PoseColumns) -> Iterator[TopicColumns]:
    """Yield the poses, and their exact values if 32-bit floats would lose digits."""
    place = {"x": poses.xy_m[:, 0], "y": poses.xy_m[:, 1], "theta": poses.heading_rad}
    speed, turn_rate = poses.speed_m_s, poses.turn_rate_rad_s
    names = "linear_velocity", "angular_velocity"
    velocity = [_or_nan(values, len(poses)) for values in (speed, turn_rate)]
    yield _collect(topics.POSE, poses.time_ns, place | dict(zip(names, velocity, strict=True)))
    if not (_fits_float32(poses.xy_m) and _fits_float32(poses.heading_rad)):
        yield _collect(topics.POSE64, poses.time_ns, place)
    if not (_fits_float32(speed) and _fits_float32(turn_rate)):
        yield _collect(topics.VELOCITY64, poses.time_ns, dict(zip(_TWIST, velocity, strict=True)))


def _build_sensed(poses: PoseColumns) -> Iterator[TopicColumns]:
    """Yield the sensed poses by pose number, exact too if 32-bit floats lose digits."""
    xy_m, heading_rad = poses.sensed_xy_m, poses.sensed_heading_rad
    if xy_m is None or heading_rad is None:
        return
    rows = np.column_stack([xy_m, heading_rad])
    has = ~np.isnan(rows).all(axis=1)
    time_ns, sequence = poses.time_ns[has], np.flatnonzero(has).astype(np.uint32)
    place = dict(zip(("x", "y", "theta"), rows[has].T, strict=True))
    none = dict.fromkeys(("linear_velocity", "angular_velocity"), _or_nan(None, len(time_ns)))
    yield _collect(topics.SENSED, time_ns, place | none, sequence)
    if not _fits_float32(rows[has]):
        yield _collect(topics.SENSED64, time_ns, place, sequence)


def _build_twists(
    topic: topics.Topic,
    time_ns: NDArray[np.int64],
    rates: tuple[NDArray[np.float64] | None, NDArray[np.float64] | None],
    sequence: NDArray[np.uint32] | None = None,
) -> Iterator[TopicColumns]:
    """Yield speed and turn rate as one topic, if any is known."""
    if any(values is not None for values in rates):
        columns = [_or_nan(values, len(time_ns)) for values in rates]
        yield _collect(topic, time_ns, dict(zip(_TWIST, columns, strict=True)), sequence)


def _build_samples(samples: SampleColumns) -> TopicColumns:
    columns: dict[str, Column] = {}
    for name, fields in topics.CONTROL_COLUMNS.items():
        values = getattr(samples, name)
        if values is None:
            columns |= dict.fromkeys(fields, _or_nan(None, len(samples)))
        else:
            columns |= zip(fields, values.T.reshape(len(fields), -1), strict=True)
    return _collect(topics.CONTROL, samples.time_ns, columns, samples.sequence.astype(np.uint32))


def _build_states(run: Run) -> list[TopicColumns]:
    samples, names = run.samples, run.declaration.states
    if samples.states is None or not names:
        return []
    topic = topics.Topic(
        topics.LAW_STATE, topics.name_state_type(run.parameters.get("law.kind", DEFAULT_LAW))
    )
    columns = dict(zip(names, samples.states.T, strict=True))
    return [_collect(topic, samples.time_ns, columns, samples.sequence.astype(np.uint32))]


def _build_references(run: Run) -> list[TopicColumns]:
    """Return the reference poses of samples, for other tools (as quaternions) and exact."""
    samples = run.samples
    xy_m, heading_rad = samples.reference_xy_m, samples.reference_heading_rad
    if xy_m is None or heading_rad is None or not run.declaration.has_reference:
        return []
    poses = np.column_stack([xy_m, heading_rad])
    has = ~np.isnan(poses).all(axis=1)
    time_ns, sequence = samples.time_ns[has], samples.sequence[has].astype(np.uint32)
    x, y, heading = poses[has].T
    listed = zip(time_ns.tolist(), x.tolist(), y.tolist(), heading.tolist(), strict=True)
    rows = [(row[0], describe_pose(*row)) for row in listed]
    exact = _collect(topics.REFERENCE64, time_ns, {"x": x, "y": y, "theta": heading}, sequence)
    return [_collect_rows(topics.REFERENCE, rows, sequence), exact]


def _build_commands(run: Run) -> TopicColumns:
    commands = run.commands
    columns = {
        "linear.x": commands.speed_m_s,
        "linear.y": commands.lateral_speed_m_s,
        "angular.z": commands.turn_rate_rad_s,
    }
    # Commands are published in the order of their samples; only the last ones may be missing.
    sequence = np.arange(len(commands), dtype=np.uint32)
    answered = run.samples.sequence[: len(commands)]
    sequence[: len(answered)] = answered
    return _collect(topics.COMMAND, commands.time_ns, columns, sequence)


def _build_phases(run: Run) -> TopicColumns:
    spans = find_phase_spans(run, has_all=True)
    changes: list[tuple[int, Values]] = [(span.start_ns, {"data": span.phase}) for span in spans]
    is_held = len(run.commands) < len(run.samples)
    if spans and is_held and spans[-1].phase != PAUSE:
        # The pause begins at the last tick and has no duration, but a live recording writes it.
        changes.append((spans[-1].end_ns, {"data": PAUSE}))
    if spans and run.is_complete:
        changes.append((spans[-1].end_ns, {"data": DONE}))
    return _collect_rows(topics.PHASE, changes)


def _or_nan(values: NDArray[np.float64] | None, rows: int) -> NDArray[np.float64]:
    return np.full(rows, math.nan) if values is None else values


def _fits_float32(values: NDArray[np.float64] | None) -> bool:
    with np.errstate(over="ignore"):
        return values is None or bool((values == values.astype(np.float32)).all())


_WORLD: Final = "world"
_ROBOT: Final = "turtle1"
"""Frames of the tf2 tutorials, where a broadcaster sends turtlesim's poses."""

MOST_SHARED: Final = 100_000
"""Largest number of poses that are also written for other programs.

An odometry message has 720 bytes, mostly covariances. Together with the transforms, this number of
poses takes 160 MB during writing. At 62.5 Hz, it is a drive of 27 minutes."""

_LATEST_NS: Final = 2**31 * 1_000_000_000
"""Latest time of a stamp [ns]: its seconds have 32 bits."""


def build_shared_messages(run: Run) -> tuple[TopicColumns, ...]:
    """Return the poses as odometry, as transforms and as one path, unless `list_unshared`."""
    poses = run.poses
    if not len(poses) or list_unshared(run):
        return ()
    seconds, nanoseconds = divmod(poses.time_ns, 1_000_000_000)
    half_rad = poses.heading_rad / 2.0
    place = dict(zip("xy", poses.xy_m.T, strict=True))
    turn = {"z": np.sin(half_rad), "w": np.cos(half_rad)}
    head: dict[str, NDArray[Any]] = {
        "header.stamp.sec": seconds,
        "header.stamp.nanosec": nanoseconds,
        "header.frame_id": np.full(len(poses), _WORLD, dtype=object),
    }
    child = np.full(len(poses), _ROBOT, dtype=object)
    rates = zip(("twist.twist.linear.x", "twist.twist.angular.z"), _read_rates(run), strict=True)
    odometry = {
        **head,
        "child_frame_id": child,
        **_prefix("pose.pose.position.", place),
        **_prefix("pose.pose.orientation.", turn),
        **dict(rates),
    }
    transform = {
        **head,
        "child_frame_id": child,
        **_prefix("transform.translation.", place),
        **_prefix("transform.rotation.", turn),
    }
    pose = {**head, **_prefix("pose.position.", place), **_prefix("pose.orientation.", turn)}
    path = {name: values[-1:] for name, values in head.items()}
    path["poses"] = np.array([_pack_poses(pose, len(poses))], dtype=object)
    return (
        _collect(topics.ODOMETRY, poses.time_ns, odometry),
        _collect(topics.TRANSFORMS, poses.time_ns, _prefix("transforms.0.", transform)),
        _collect(topics.PATH, poses.time_ns[-1:], path),
    )


def _prefix(prefix: str, columns: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    return {prefix + name: values for name, values in columns.items()}


def _pack_poses(columns: Mapping[str, NDArray[Any]], rows: int) -> PackedItems:
    """Return stamped poses as the items of one message."""
    kind = "geometry_msgs/msg/PoseStamped"
    layout = lay_out_alike(read_type(kind, topics.SCHEMAS[kind]).fields, columns)
    assert layout is not None
    assert not layout.size % 8  # each item starts with the same alignment
    codes = {name: f"<{code}" for name, code, *_ in layout.numbers}
    numbers = {name: columns[name].astype(codes[name]) for name in columns.keys() & codes.keys()}
    return PackedItems(rows, layout.fill(rows, numbers).tobytes())


def list_unshared(run: Run) -> list[str]:
    """Return why poses are not written for other programs: one sentence, or an empty list."""
    reason = ""
    if len(run.poses) > MOST_SHARED:
        reason = f"{len(run.poses):,} poses are more than {MOST_SHARED:,}"
    elif len(run.poses) and int(run.poses.time_ns[-1]) >= _LATEST_NS:
        reason = "the times do not fit the stamps of ROS"
    return [f"/odom, /tf and /path are left out: {reason}"] if reason else []


def _read_rates(run: Run) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return forward speed [m/s] and turn rate [rad/s] of every pose; NaN if unknown.

    They are measured by the robot, or else applied by turtlesim, which publishes the magnitude of
    its speed; the sign comes from the motion along the heading.
    """
    poses = run.poses
    unknown = np.full(len(poses), np.nan)
    speed, turn_rate = poses.measured_speed_m_s, poses.measured_turn_rate_rad_s
    if speed is None and poses.speed_m_s is not None and not run.commands.lateral_speed_m_s.any():
        step_m = np.diff(poses.xy_m, axis=0, prepend=poses.xy_m[:1])
        ahead = np.column_stack([np.cos(poses.heading_rad), np.sin(poses.heading_rad)])
        speed = poses.speed_m_s * np.where((step_m * ahead).sum(axis=1) < 0.0, -1.0, 1.0)
    if turn_rate is None:
        turn_rate = poses.turn_rate_rad_s
    return (unknown if speed is None else speed), (unknown if turn_rate is None else turn_rate)
