"""File -> Run."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import LogError
from turtlelog.log.border import name_file
from turtlelog.log.cdr import Column
from turtlelog.log.columns import Contents, build_columns, read_contents
from turtlelog.log.head import HEAD, Head, parse_head, parse_scenario_file
from turtlelog.log.topics import COMMAND, CONTROL, EVENT, GOAL, POSE, POSE64, VELOCITY64
from turtlelog.run import CommandColumns, Event, PoseColumns, Run, SampleColumns
from turtlelog.scenario import flatten_tables

Columns = Mapping[str, Column]
Values = NDArray[np.float64]


def read_recording(path: str | Path) -> Run:
    """Return the run in a recording, checksums checked. A law that it names is not loaded.

    Raises:
        LogError: One line with the file and the place, where it cannot be read, is no recording,
            is damaged, or was written by a newer turtlelog.
    """
    with name_file(path, expected="a turtlelog recording"):
        return _build_run(read_contents(Path(path).read_bytes()))


def _build_run(contents: Contents) -> Run:
    if HEAD not in contents.metadata:
        raise LogError(
            f"expected a metadata record {HEAD}, found none: not a recording by turtlelog"
        )
    head = parse_head(contents.metadata[HEAD])
    tables, is_complete = parse_scenario_file(contents.attachments)
    columns = build_columns(contents)
    goal = columns[GOAL.name]
    goal_xy_m = None
    if len(goal["log_time"]):
        goal_xy_m = float(goal["position.x"][0]), float(goal["position.y"][0])
    return Run(
        name=head.name,
        source=head.source,
        poses=_build_poses(columns, head),
        commands=_build_commands(columns[COMMAND.name]),
        samples=_build_samples(columns[CONTROL.name], head),
        goal_xy_m=goal_xy_m,
        goal_heading_rad=head.goal_heading_rad,
        parameters=flatten_tables(tables),
        scenario_is_complete=is_complete,
        stop_reason=head.stop_reason,
        events=_build_events(columns[EVENT.name]),
        absent=head.absent,
        notes=head.notes,
    )


def _build_poses(columns: Mapping[str, Columns], head: Head) -> PoseColumns:
    pose = columns[POSE.name]
    if not len(pose["log_time"]):
        raise LogError(f"topic {POSE.name}: expected messages, found none")
    position = _prefer(columns[POSE64.name], pose, POSE64.name)
    velocity = _prefer(columns[VELOCITY64.name], pose, VELOCITY64.name)
    speed = velocity["linear.x" if "linear.x" in velocity else "linear_velocity"]
    turn_rate = velocity["angular.z" if "angular.z" in velocity else "angular_velocity"]
    return PoseColumns(
        time_ns=pose["log_time"],
        xy_m=_pair(position["x"], position["y"]),
        heading_rad=_widen(position["theta"]),
        speed_m_s=_unless_nan(head, "poses.speed_m_s", speed),
        turn_rate_rad_s=_unless_nan(head, "poses.turn_rate_rad_s", turn_rate),
    )


def _prefer(exact: Columns, rounded: Columns, topic: str) -> Columns:
    if not len(exact["log_time"]):
        return rounded
    if not np.array_equal(exact["log_time"], rounded["log_time"]):
        expected, found = len(rounded["log_time"]), len(exact["log_time"])
        raise LogError(
            f"topic {topic}: expected the times of the {expected} poses, found {found} others"
        )
    return exact


def _build_commands(command: Columns) -> CommandColumns:
    return CommandColumns(
        time_ns=command["log_time"],
        speed_m_s=command["linear.x"],
        lateral_speed_m_s=command["linear.y"],
        turn_rate_rad_s=command["angular.z"],
    )


def _build_samples(control: Columns, head: Head) -> SampleColumns:
    wanted_speed, wanted_turn_rate = control["wanted_speed"], control["wanted_turn_rate"]
    return SampleColumns(
        time_ns=control["log_time"],
        sequence=control["sequence"].astype(np.int64),
        pose_sequence=control["pose_sequence"].astype(np.int64),
        phase=control["phase"].astype(np.int64),
        bearing_rad=control["bearing"],
        heading_error_rad=control["heading_error"],
        error_xy_m=_pair(control["error_x"], control["error_y"]),
        distance_m=control["distance"],
        wanted_speed_m_s=_unless_nan(head, "samples.wanted_speed_m_s", wanted_speed),
        wanted_turn_rate_rad_s=_unless_nan(
            head, "samples.wanted_turn_rate_rad_s", wanted_turn_rate
        ),
        speed_m_s=control["speed"],
        turn_rate_rad_s=control["turn_rate"],
        world_velocity_m_s=_pair(control["world_v_x"], control["world_v_y"]),
    )


def _build_events(event: Columns) -> tuple[Event, ...]:
    rows = zip(event["log_time"].tolist(), event["function"], event["msg"], strict=True)
    return tuple(Event(time_ns=time_ns, kind=kind, text=text) for time_ns, kind, text in rows)


def _unless_nan(head: Head, name: str, values: Column) -> Values | None:
    return None if name in head.nan_columns else _widen(values)


def _widen(values: Column) -> Values:
    return values.astype(np.float64)


def _pair(x: Column, y: Column) -> Values:
    return np.column_stack([_widen(x), _widen(y)])
