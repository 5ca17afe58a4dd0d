"""From the ticks of a loop to the columns of a run."""

from collections.abc import Iterable
from struct import Struct
from typing import Final

import numpy as np

from turtlelog.errors import SimulationError
from turtlelog.plants import TURTLESIM, Plant
from turtlelog.run import CommandColumns, Event, PoseColumns, Run
from turtlelog.scenario import Scenario, flatten_scenario, resolve_scenario
from turtlelog.simulate.closed_loop import Tick, iterate_ticks
from turtlelog.simulate.law_driver import declare_scenario
from turtlelog.simulate.sample_rows import SampleRows, split_rows

# Rows are packed as they come: 8 bytes a value, whole numbers first.
_POSE_ROW: Final = Struct("<q5d")
_COMMAND_ROW: Final = Struct("<q2d")


def simulate_run(scenario: Scenario, plant: Plant = TURTLESIM) -> Run:
    """Simulate a scenario and return its run; with another plant on that plant's clock.

    Raises:
        ScenarioError: Where the law cannot be loaded or may not run.
        SimulationError: Where the law fails, with the run so far as `run`, or no pose is answered
            within `max_duration_s`.
    """
    scenario = resolve_scenario(scenario)
    return collect_run(scenario, iterate_ticks(scenario, plant))


def collect_run(scenario: Scenario, ticks: Iterable[Tick]) -> Run:
    """Return the run that a scenario's ticks make.

    Raises:
        SimulationError: Where no pose was answered, or the law fails: with the run so far as `run`.
    """
    collector = RunCollector(scenario)
    try:
        collector.take(ticks)
    except SimulationError as err:
        err.run = collector.build_run() if collector.has_samples else None
        raise
    return collector.build_run()


class RunCollector:
    """Ticks packed as they come, and the run that they make so far."""

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = resolve_scenario(scenario)
        self._declaration = declare_scenario(self._scenario)
        self._poses, self._commands = bytearray(), bytearray()
        self._samples = SampleRows(self._declaration)
        self._events: list[Event] = []
        self._stop_reason: str | None = None

    @property
    def has_samples(self) -> bool:
        """Whether there is a run yet: without a sample there is none."""
        return len(self._samples) > 0

    def take(self, ticks: Iterable[Tick]) -> None:
        """Add the next ticks."""
        poses, commands, add_sample = self._poses, self._commands, self._samples.add
        for tick in ticks:
            pose, time_ns = tick.pose, tick.time_ns
            poses += _POSE_ROW.pack(
                time_ns, pose.x_m, pose.y_m, pose.heading_rad, tick.speed_m_s, tick.turn_rate_rad_s
            )
            for sample in tick.computed:
                add_sample(sample)
            for sample in tick.published:
                commands += _COMMAND_ROW.pack(time_ns, sample.speed_m_s, sample.turn_rate_rad_s)
            self._events += tick.events
            self._stop_reason = tick.stop_reason

    def build_run(self) -> Run:
        """Return the run of all ticks so far.

        Raises:
            SimulationError: Where no pose was answered.
        """
        scenario = self._scenario
        if not self.has_samples:
            raise SimulationError(
                f"{scenario.name}: expected a pose answered within max_duration_s ="
                f" {scenario.max_duration_s}, found none: start_backlog ="
                f" {scenario.loop.start_backlog} poses come first"
            )
        has_goal = self._declaration.uses_goal
        return Run(
            name=scenario.name,
            source="simulation",
            poses=_build_poses(self._poses),
            commands=_build_commands(self._commands),
            samples=self._samples.build_columns(),
            goal_xy_m=(scenario.goal.x_m, scenario.goal.y_m) if has_goal else None,
            goal_heading_rad=scenario.goal.heading_rad if has_goal else None,
            declaration=self._declaration,
            parameters=flatten_scenario(scenario),
            scenario_is_complete=True,
            stop_reason=self._stop_reason,
            events=tuple(self._events),
        )


def _build_poses(packed: bytearray) -> PoseColumns:
    (time_ns,), (x, y, heading, speed, turn_rate) = split_rows(packed, _POSE_ROW, integers=1)
    return PoseColumns(
        time_ns=time_ns,
        xy_m=np.column_stack([x, y]),
        heading_rad=heading,
        speed_m_s=speed,
        turn_rate_rad_s=turn_rate,
    )


def _build_commands(packed: bytearray) -> CommandColumns:
    (time_ns,), (speed, turn_rate) = split_rows(packed, _COMMAND_ROW, integers=1)
    return CommandColumns(
        time_ns=time_ns,
        speed_m_s=speed,
        lateral_speed_m_s=np.zeros_like(speed),
        turn_rate_rad_s=turn_rate,
    )
