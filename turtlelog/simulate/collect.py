"""From the ticks of a loop to the columns of a run."""

from array import array
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import SimulationError
from turtlelog.run import CommandColumns, Event, PoseColumns, Run, SampleColumns
from turtlelog.scenario import Scenario, flatten_scenario
from turtlelog.simulate.controller import Sample
from turtlelog.simulate.loop import Tick, iterate_ticks


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
    poses, samples, commands = array("d"), array("d"), array("d")
    pose_ns, sample_ns, command_ns = array("q"), array("q"), array("q")
    numbers = array("q")
    events: list[Event] = []
    stop_reason: str | None = None
    for tick in ticks:
        pose = tick.pose
        pose_ns.append(tick.time_ns)
        poses.extend((pose.x_m, pose.y_m, pose.heading_rad, tick.speed_m_s, tick.turn_rate_rad_s))
        for sample in tick.computed:
            sample_ns.append(sample.time_ns)
            numbers.extend((sample.sequence, sample.pose_sequence, sample.decision.phase))
            samples.extend(_list_values(sample))
        for sample in tick.published:
            command_ns.append(tick.time_ns)
            commands.extend((sample.speed_m_s, 0.0, sample.turn_rate_rad_s))
        events += tick.events
        stop_reason = tick.stop_reason
    if not sample_ns:
        raise SimulationError(
            f"{scenario.name}: expected a pose answered within max_duration_s ="
            f" {scenario.max_duration_s}, found none: start_backlog = {scenario.loop.start_backlog}"
            f" poses come first"
        )
    x, y, heading, speed, turn_rate = _split(poses, 5)
    forward, lateral, turn = _split(commands, 3)
    return Run(
        name=scenario.name,
        source="simulation",
        poses=PoseColumns(
            time_ns=np.array(pose_ns, dtype=np.int64),
            xy_m=np.column_stack([x, y]),
            heading_rad=heading,
            speed_m_s=speed,
            turn_rate_rad_s=turn_rate,
        ),
        commands=CommandColumns(
            time_ns=np.array(command_ns, dtype=np.int64),
            speed_m_s=forward,
            lateral_speed_m_s=lateral,
            turn_rate_rad_s=turn,
        ),
        samples=_build_samples(sample_ns, numbers, samples),
        goal_xy_m=(scenario.goal.x_m, scenario.goal.y_m),
        goal_heading_rad=scenario.goal.heading_rad,
        parameters=flatten_scenario(scenario),
        scenario_is_complete=True,
        stop_reason=stop_reason,
        events=tuple(events),
    )


def _list_values(sample: Sample) -> tuple[float, ...]:
    decision = sample.decision
    return (
        decision.bearing_rad,
        decision.heading_error_rad,
        decision.error_x_m,
        decision.error_y_m,
        sample.distance_m,
        decision.speed_m_s,
        decision.turn_rate_rad_s,
        sample.speed_m_s,
        sample.turn_rate_rad_s,
        decision.world_v_x_m_s,
        decision.world_v_y_m_s,
    )


def _build_samples(
    time_ns: "array[int]", numbers: "array[int]", values: "array[float]"
) -> SampleColumns:
    sequence, pose_sequence, phase = np.array(numbers, dtype=np.int64).reshape(-1, 3).T.copy()
    columns = _split(values, 11)
    bearing, heading_error, error_x, error_y, distance, *commands, world_x, world_y = columns
    wanted_speed, wanted_turn_rate, speed, turn_rate = commands
    return SampleColumns(
        time_ns=np.array(time_ns, dtype=np.int64),
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


def _split(values: "array[float]", width: int) -> tuple[NDArray[np.float64], ...]:
    rows = np.frombuffer(values, dtype=np.float64) if values else np.zeros(0)
    return tuple(np.ascontiguousarray(rows.reshape(-1, width).T))
