"""A run by the compiled loop: its arrays filled, simulated, and made the columns of a run."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from turtlelog.loops import Declaration
from turtlelog.plants import Plant
from turtlelog.run import CommandColumns, Event, PoseColumns, Run, SampleColumns
from turtlelog.scenario import Scenario, flatten_scenario
from turtlelog.simulate.compiled.fields import fill_settings
from turtlelog.simulate.compiled.memory import (
    COMMANDS_DROPPED,
    EVENT_KINDS,
    POSES_DROPPED,
    STOP_REASONS,
    WALL_HIT,
    Memory,
    allocate,
    begin,
    prepare,
)
from turtlelog.simulate.event_watch import describe_loss, describe_stop, describe_wall
from turtlelog.simulate.law_driver import declare_scenario


class KernelRunner:
    """Simulates by compiled loops, one scenario after the other in the same arrays."""

    def __init__(self) -> None:
        """Begin without room for any."""
        self._memory: Memory = allocate(1, 1)

    def simulate(self, kernel: Any, scenario: Scenario, plant: Plant) -> Run | None:
        """Return the run of a scenario by the module of a loop that covers it.

        Its law is resolved. None where it fails or answers no pose: the interpreted loop says why.
        """
        settings = fill_settings(scenario, plant)
        ticks, samples = count_rows(scenario, plant)
        if ticks > len(self._memory.ticks) or samples > len(self._memory.samples):
            self._memory = allocate(ticks, samples)
        prepare(self._memory, scenario, ticks, samples)
        state = begin(scenario)
        kernel.run_loop(settings, state, self._memory)
        found = state[0]
        if found["has_failed"] or not found["samples"]:
            return None
        return _build_run(scenario, plant, self._memory, found)


def count_rows(scenario: Scenario, plant: Plant) -> tuple[int, int]:
    """Return the most ticks and samples that a run may have."""
    ticks = round(scenario.max_duration_s * 1e9) // plant.period_ns + 1
    period_s = scenario.loop.period_s
    return ticks, ticks if period_s is None else int(scenario.max_duration_s / period_s) + 2


def _build_run(scenario: Scenario, plant: Plant, memory: Memory, found: Any) -> Run:
    declaration = declare_scenario(scenario)
    has_goal = declaration.uses_goal
    stop_reason = STOP_REASONS[found["stop_reason"]]
    samples = memory.samples[: found["samples"]]
    return Run(
        name=scenario.name,
        source="simulation",
        poses=_build_poses(scenario, plant, memory.ticks[: found["ticks"]]),
        commands=_build_commands(samples, samples["published"][: found["commands"]]),
        samples=_build_samples(scenario, declaration, samples),
        goal_xy_m=(scenario.goal.x_m, scenario.goal.y_m) if has_goal else None,
        goal_heading_rad=scenario.goal.heading_rad if has_goal else None,
        declaration=declaration,
        parameters=flatten_scenario(scenario),
        scenario_is_complete=True,
        stop_reason=stop_reason,
        events=tuple(_build_events(memory.events[: found["events"]], plant.period_ns, stop_reason)),
    )


def _pair(rows: NDArray[Any], *names: str) -> NDArray[np.float64]:
    return np.column_stack([rows[name] for name in names])


def _build_poses(scenario: Scenario, plant: Plant, rows: NDArray[Any]) -> PoseColumns:
    senses = scenario.sensing.changes_poses
    return PoseColumns(
        time_ns=np.arange(len(rows)) * plant.period_ns,
        xy_m=_pair(rows, "x_m", "y_m"),
        heading_rad=rows["heading_rad"].copy(),
        speed_m_s=rows["applied_speed"].copy(),
        turn_rate_rad_s=rows["applied_turn_rate"].copy(),
        sensed_xy_m=_pair(rows, "sensed_x_m", "sensed_y_m") if senses else None,
        sensed_heading_rad=rows["sensed_heading_rad"].copy() if senses else None,
    )


def _build_commands(samples: NDArray[Any], published: NDArray[np.int64]) -> CommandColumns:
    speed = samples["speed"][published]
    return CommandColumns(
        time_ns=samples["published_ns"][published],
        speed_m_s=speed,
        lateral_speed_m_s=np.zeros_like(speed),
        turn_rate_rad_s=samples["turn_rate"][published],
    )


def _build_samples(
    scenario: Scenario, declaration: Declaration, rows: NDArray[Any]
) -> SampleColumns:
    shapes, moves = scenario.shaping.acts, declaration.has_reference
    # Only the sequential laws have a world velocity, and without a goal there are no errors.
    has_goal, world = declaration.uses_goal, ("world_v_x_m_s", "world_v_y_m_s")
    has_world = not np.isnan(rows[world[0]][0])
    has_heading_error = not np.isnan(rows["heading_error_rad"][0])
    return SampleColumns(
        time_ns=rows["time_ns"].copy(),
        sequence=np.arange(len(rows)),
        pose_sequence=rows["pose_sequence"].copy(),
        phase=rows["phase"].copy(),
        bearing_rad=rows["bearing_rad"].copy() if has_goal else None,
        heading_error_rad=rows["heading_error_rad"].copy() if has_heading_error else None,
        error_xy_m=_pair(rows, "error_x_m", "error_y_m") if has_goal else None,
        distance_m=rows["distance_m"].copy() if has_goal else None,
        wanted_speed_m_s=rows["wanted_speed"].copy(),
        wanted_turn_rate_rad_s=rows["wanted_turn_rate"].copy(),
        speed_m_s=rows["speed"].copy(),
        turn_rate_rad_s=rows["turn_rate"].copy(),
        shaped_speed_m_s=rows["shaped_speed"].copy() if shapes else None,
        shaped_turn_rate_rad_s=rows["shaped_turn_rate"].copy() if shapes else None,
        world_velocity_m_s=_pair(rows, *world) if has_world else None,
        states=_pair(rows, *declaration.states) if declaration.states else None,
        reference_xy_m=_pair(rows, "reference_x_m", "reference_y_m") if moves else None,
        reference_heading_rad=rows["reference_heading_rad"].copy() if moves else None,
    )


def _build_events(rows: NDArray[np.float64], period_ns: int, stop_reason: str) -> Iterator[Event]:
    """Yield the events in the words of the interpreted loop."""
    for tick, number, first, second in rows.tolist():
        if number == WALL_HIT:
            text = describe_wall(first, second)
        elif number == POSES_DROPPED:
            text = f"The controller's queue dropped {int(second)} poses."
        elif number == COMMANDS_DROPPED and first < 0.0:
            text = f"The plant's queue dropped {int(second)} commands."
        elif number < WALL_HIT:
            text = describe_loss(EVENT_KINDS[int(number)], int(first), int(second))
        else:
            text = describe_stop(stop_reason)
        yield Event(time_ns=int(tick) * period_ns, kind=EVENT_KINDS[int(number)], text=text)
