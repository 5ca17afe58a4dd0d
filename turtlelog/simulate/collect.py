"""From the ticks of a loop to the columns of a run."""

from collections.abc import Iterable
from struct import Struct
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import SimulationError
from turtlelog.run import CommandColumns, Event, PoseColumns, Run, SampleColumns
from turtlelog.scenario import Scenario, flatten_scenario
from turtlelog.simulate.loop import Tick, iterate_ticks

# Rows are packed as they come: 8 bytes a value, whole numbers first.
_POSE_ROW: Final = Struct("<q5d")
_COMMAND_ROW: Final = Struct("<q2d")
_SAMPLE_ROW: Final = Struct("<4q11d")


def simulate_run(scenario: Scenario) -> Run:
    """Simulate a scenario and return its run.

    Raises:
        SimulationError: Where the law fails, or no pose is answered within `max_duration_s`.
    """
    return collect_run(scenario, iterate_ticks(scenario))


def collect_run(scenario: Scenario, ticks: Iterable[Tick]) -> Run:
    """Return the run that a scenario's ticks make.

    Raises:
        SimulationError: Where no pose was answered.
    """
    poses, samples, commands = bytearray(), bytearray(), bytearray()
    events: list[Event] = []
    stop_reason: str | None = None
    for tick in ticks:
        pose = tick.pose
        poses += _POSE_ROW.pack(
            tick.time_ns, pose.x_m, pose.y_m, pose.heading_rad, tick.speed_m_s, tick.turn_rate_rad_s
        )
        for sample in tick.computed:
            samples += _SAMPLE_ROW.pack(sample.time_ns, *sample.row)
        for sample in tick.published:
            commands += _COMMAND_ROW.pack(tick.time_ns, sample.speed_m_s, sample.turn_rate_rad_s)
        events += tick.events
        stop_reason = tick.stop_reason
    if not samples:
        raise SimulationError(
            f"{scenario.name}: expected a pose answered within max_duration_s ="
            f" {scenario.max_duration_s}, found none: start_backlog = {scenario.loop.start_backlog}"
            f" poses come first"
        )
    return Run(
        name=scenario.name,
        source="simulation",
        poses=_build_poses(poses),
        commands=_build_commands(commands),
        samples=_build_samples(samples),
        goal_xy_m=(scenario.goal.x_m, scenario.goal.y_m),
        goal_heading_rad=scenario.goal.heading_rad,
        parameters=flatten_scenario(scenario),
        scenario_is_complete=True,
        stop_reason=stop_reason,
        events=tuple(events),
    )


def _build_poses(packed: bytearray) -> PoseColumns:
    (time_ns,), (x, y, heading, speed, turn_rate) = _split(packed, _POSE_ROW, integers=1)
    return PoseColumns(
        time_ns=time_ns,
        xy_m=np.column_stack([x, y]),
        heading_rad=heading,
        speed_m_s=speed,
        turn_rate_rad_s=turn_rate,
    )


def _build_commands(packed: bytearray) -> CommandColumns:
    (time_ns,), (speed, turn_rate) = _split(packed, _COMMAND_ROW, integers=1)
    return CommandColumns(
        time_ns=time_ns,
        speed_m_s=speed,
        lateral_speed_m_s=np.zeros_like(speed),
        turn_rate_rad_s=turn_rate,
    )


def _build_samples(packed: bytearray) -> SampleColumns:
    integers, values = _split(packed, _SAMPLE_ROW, integers=4)
    time_ns, sequence, pose_sequence, phase = integers
    bearing, heading_error, error_x, error_y, distance, *commands, world_x, world_y = values
    wanted_speed, wanted_turn_rate, speed, turn_rate = commands
    return SampleColumns(
        time_ns=time_ns,
        sequence=sequence,
        pose_sequence=pose_sequence,
        phase=phase,
        bearing_rad=bearing,
        heading_error_rad=heading_error,
        error_xy_m=np.column_stack([error_x, error_y]),
        distance_m=distance,
        wanted_speed_m_s=wanted_speed,
        wanted_turn_rate_rad_s=wanted_turn_rate,
        speed_m_s=speed,
        turn_rate_rad_s=turn_rate,
        world_velocity_m_s=np.column_stack([world_x, world_y]),
    )


def _split(
    packed: bytearray, row: Struct, *, integers: int
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the first columns as integers, the others as floats, each shape (columns, rows)."""
    words = np.frombuffer(packed, dtype="<i8").reshape(-1, row.size // 8).T
    return words[:integers].copy(), words[integers:].copy().view("<f8")
