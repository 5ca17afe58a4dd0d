"""Run -> messages, topic by topic."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import LogError
from turtlelog.log.cdr import encode_columns, encode_message
from turtlelog.log.topics import (
    COMMAND,
    CONTROL,
    EVENT,
    GOAL,
    PHASE,
    POSE,
    POSE64,
    VELOCITY64,
    Topic,
)
from turtlelog.run import Event, PoseColumns, Run

_INFO: Final = 20
_WARN: Final = 30


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicMessages:
    """The messages of one topic.

    Attributes:
        topic: Where they go.
        time_ns: Log time of each [ns].
        sequence: Number of each.
        payloads: CDR bytes of each.
    """

    topic: Topic
    time_ns: list[int]
    sequence: list[int]
    payloads: list[bytes]


def build_messages(run: Run) -> tuple[TopicMessages, ...]:
    """Return the messages of a run, in the order of `TOPICS`; a topic without any is left out.

    Raises:
        LogError: Where a time or a number does not fit.
    """
    _require_range("poses.time_ns", run.poses.time_ns, 2**63)
    _require_range("commands.time_ns", run.commands.time_ns, 2**63)
    _require_range("samples.time_ns", run.samples.time_ns, 2**63)
    _require_range("samples.sequence", run.samples.sequence, 2**32)
    _require_range("events.time_ns", np.array([event.time_ns for event in run.events]), 2**63)
    topics = (
        _build_goal(run),
        _build_poses(run.poses),
        _build_poses64(run.poses),
        _build_velocities64(run.poses),
        _build_samples(run),
        _build_commands(run),
        _build_phases(run),
        _build_events(run.events),
    )
    return tuple(messages for messages in topics if messages.payloads)


def _require_range(name: str, values: NDArray[np.int64], end: int) -> None:
    for value in (values.min(), values.max()) if values.size else ():
        if not 0 <= value < end:
            raise LogError(f"{name}: expected values from 0 to below {end}, found {value}")


def _number(topic: Topic, time_ns: list[int], payloads: list[bytes]) -> TopicMessages:
    sequence = list(range(len(payloads)))
    return TopicMessages(topic=topic, time_ns=time_ns, sequence=sequence, payloads=payloads)


def _build_goal(run: Run) -> TopicMessages:
    if run.goal_xy_m is None:
        return _number(GOAL, [], [])
    half_rad = (run.goal_heading_rad or 0.0) / 2.0
    time_ns = int(run.poses.time_ns[0])
    values = {
        **_stamp(time_ns),
        "frame_id": "world",
        "position.x": run.goal_xy_m[0],
        "position.y": run.goal_xy_m[1],
        "orientation.z": math.sin(half_rad),
        "orientation.w": math.cos(half_rad),
    }
    return _number(GOAL, [time_ns], [encode_message(GOAL.schema, values)])


def _build_poses(poses: PoseColumns) -> TopicMessages:
    columns = {
        "x": poses.xy_m[:, 0],
        "y": poses.xy_m[:, 1],
        "theta": poses.heading_rad,
        "linear_velocity": _or_nan(poses.speed_m_s),
        "angular_velocity": _or_nan(poses.turn_rate_rad_s),
    }
    payloads = encode_columns(POSE.schema, len(poses), columns)
    return _number(POSE, poses.time_ns.tolist(), payloads)


def _build_poses64(poses: PoseColumns) -> TopicMessages:
    if _fits_float32(poses.xy_m) and _fits_float32(poses.heading_rad):
        return _number(POSE64, [], [])
    columns = {"x": poses.xy_m[:, 0], "y": poses.xy_m[:, 1], "theta": poses.heading_rad}
    payloads = encode_columns(POSE64.schema, len(poses), columns)
    return _number(POSE64, poses.time_ns.tolist(), payloads)


def _build_velocities64(poses: PoseColumns) -> TopicMessages:
    if _fits_float32(poses.speed_m_s) and _fits_float32(poses.turn_rate_rad_s):
        return _number(VELOCITY64, [], [])
    columns = {
        "linear.x": _or_nan(poses.speed_m_s),
        "angular.z": _or_nan(poses.turn_rate_rad_s),
    }
    payloads = encode_columns(VELOCITY64.schema, len(poses), columns)
    return _number(VELOCITY64, poses.time_ns.tolist(), payloads)


def _build_samples(run: Run) -> TopicMessages:
    samples = run.samples
    columns = {
        "sequence": samples.sequence,
        "pose_sequence": samples.pose_sequence,
        "phase": samples.phase,
        "bearing": samples.bearing_rad,
        "heading_error": samples.heading_error_rad,
        "error_x": samples.error_xy_m[:, 0],
        "error_y": samples.error_xy_m[:, 1],
        "distance": samples.distance_m,
        "wanted_speed": _or_nan(samples.wanted_speed_m_s),
        "wanted_turn_rate": _or_nan(samples.wanted_turn_rate_rad_s),
        "speed": samples.speed_m_s,
        "turn_rate": samples.turn_rate_rad_s,
        "world_v_x": samples.world_velocity_m_s[:, 0],
        "world_v_y": samples.world_velocity_m_s[:, 1],
    }
    return TopicMessages(
        topic=CONTROL,
        time_ns=samples.time_ns.tolist(),
        sequence=samples.sequence.tolist(),
        payloads=encode_columns(CONTROL.schema, len(samples), columns),
    )


def _build_commands(run: Run) -> TopicMessages:
    commands = run.commands
    columns = {
        "linear.x": commands.speed_m_s,
        "linear.y": commands.lateral_speed_m_s,
        "angular.z": commands.turn_rate_rad_s,
    }
    # Commands go out in the order of their samples; only the last ones may be missing.
    sequence = np.arange(len(commands))
    answered = run.samples.sequence[: len(commands)]
    sequence[: len(answered)] = answered
    return TopicMessages(
        topic=COMMAND,
        time_ns=commands.time_ns.tolist(),
        sequence=sequence.tolist(),
        payloads=encode_columns(COMMAND.schema, len(commands), columns),
    )


def _build_phases(run: Run) -> TopicMessages:
    spans = run.find_phase_spans()
    changes = [(span.start_ns, span.phase.label) for span in spans]
    if spans and run.is_complete:
        changes.append((spans[-1].end_ns, "done"))
    payloads = [encode_message(PHASE.schema, {"data": label}) for _, label in changes]
    return _number(PHASE, [time_ns for time_ns, _ in changes], payloads)


def _build_events(events: tuple[Event, ...]) -> TopicMessages:
    payloads = [
        encode_message(
            EVENT.schema,
            {
                **_stamp(event.time_ns),
                "level": _INFO if event.kind == "stop" else _WARN,
                "name": "turtlesim" if event.kind == "wall_hit" else "controller",
                "msg": event.text,
                "function": event.kind,
            },
        )
        for event in events
    ]
    return _number(EVENT, [event.time_ns for event in events], payloads)


def _stamp(time_ns: int) -> dict[str, int]:
    seconds, nanoseconds = divmod(time_ns, 1_000_000_000)
    return {"stamp.sec": seconds, "stamp.nanosec": nanoseconds}


def _or_nan(values: NDArray[np.float64] | None) -> NDArray[np.float64] | float:
    return math.nan if values is None else values


def _fits_float32(values: NDArray[np.float64] | None) -> bool:
    with np.errstate(over="ignore"):
        return values is None or bool((values == values.astype(np.float32)).all())
