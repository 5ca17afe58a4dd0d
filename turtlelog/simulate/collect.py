"""Conversion of a loop's ticks to the columns of a run."""

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from struct import Struct
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import SimulationError
from turtlelog.laws import is_given, read_law_source
from turtlelog.parts import Plant
from turtlelog.run import CommandColumns, Event, PoseColumns, Run, SampleColumns
from turtlelog.run.loops import Declaration
from turtlelog.scenario import Scenario, choose_scenario, flatten_scenario, resolve_scenario
from turtlelog.simulate.class_law import declare_scenario
from turtlelog.simulate.plain_loop import Tick, iterate_ticks
from turtlelog.simulate.rows import SampleRow, describe_stop
from turtlelog.simulate.step_budget import STEP_BUDGET, STEP_BUDGET_S, StepBudgetError
from turtlelog.simulate.versions import find_software

# Rows are packed at once: 8 bytes per value, whole numbers first.
_POSE_ROW: Final = Struct("<q5d")
_COMMAND_ROW: Final = Struct("<q2d")
_SENSED_ROW: Final = Struct("<3d")


def simulate_run(
    scenario: Scenario | str | Path,
    plant: Plant | None = None,
    *,
    law: Any = None,
    changes: Mapping[str, Any] | None = None,
    step_budget_s: float | None = STEP_BUDGET_S,
) -> Run:
    """Simulate a scenario and return its run; with a `plant`, on the clock of that plant.

    Args:
        scenario: Scenario to simulate: a scenario, the name of a preset, or a file.
        plant: Plant whose clock is used. Default: the scenario's plant.
        law: Law to use instead of the scenario's law: a class, a function of `(time_ns, pose,
            goal)` that returns speed [m/s] and turn rate [rad/s], an object with `step`, a
            `LawPart`, or the name of a law, as in `my_law.py:MyLaw`.
        changes: Values by dotted key, as in `{"law.kp_linear": 4.0}`.
        step_budget_s: Time for computing one answer of the law, by the computer's clock [s]; None:
            unlimited.

    Raises:
        LawError: If `law` is not a law.
        ScenarioError: If the law cannot be loaded or may not run, or a change is wrong.
        SimulationError: If the law fails or exceeds its time, or no pose is answered within
            `max_duration_s`; the error's `run` is the run so far.
    """
    scenario = resolve_scenario(choose_scenario(scenario, law=law, changes=changes))
    return collect_run(scenario, iterate_ticks(scenario, plant, step_budget_s=step_budget_s))


def collect_run(scenario: Scenario, ticks: Iterable[Tick]) -> Run:
    """Return the run with a scenario's ticks.

    Raises:
        SimulationError: If no pose was answered or the law fails; the error's `run` is the run so
            far.
    """
    collector = RunCollector(scenario)
    try:
        collector.take(ticks)
    except SimulationError as err:
        if isinstance(err, StepBudgetError):
            collector.end_late(err)
        err.run = collector.build_run() if collector.has_samples else None
        raise
    return collector.build_run()


class RunCollector:
    """Collector of ticks, which builds the run so far."""

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = resolve_scenario(scenario)
        self._declaration = declare_scenario(self._scenario)
        self._poses, self._commands = bytearray(), bytearray()
        self._sensed = bytearray() if self._scenario.has_action("sense", "lose_pose") else None
        has_shaping = self._scenario.has_action("shape")
        self._samples = SampleRows(self._declaration, has_shaping=has_shaping)
        self._events: list[Event] = []
        self._stop_reason: str | None = None

    @property
    def has_samples(self) -> bool:
        """Whether there is a sample, which a run needs."""
        return len(self._samples) > 0

    def take(self, ticks: Iterable[Tick]) -> None:
        """Add the next ticks."""
        self._add(ticks if self._sensed is None else _pack_sensed(ticks, self._sensed))

    def _add(self, ticks: Iterable[Tick]) -> None:
        poses, commands, add_sample = self._poses, self._commands, self._samples.add
        pack_pose, pack_command = _POSE_ROW.pack, _COMMAND_ROW.pack
        for tick in ticks:
            row, states = tick.row, tick.states
            poses += pack_pose(
                tick.time_ns,
                row.x_m,
                row.y_m,
                row.heading_rad,
                row.speed_m_s,
                row.turn_rate_rad_s,
            )
            if states:
                for sample, own in zip(tick.computed, states, strict=True):
                    add_sample(sample, own)
            else:
                for sample in tick.computed:
                    add_sample(sample)
            for sample in tick.published:
                commands += pack_command(
                    sample.published_ns, sample.speed_m_s, sample.turn_rate_rad_s
                )
            self._events += tick.events
            self._stop_reason = tick.stop_reason

    def end_late(self, err: StepBudgetError) -> None:
        """Record the failure of a loop whose step could not be ended; there is no last tick."""
        if self._stop_reason is None and self._poses:
            last_ns = int.from_bytes(self._poses[-_POSE_ROW.size :][:8], "little", signed=True)
            text = describe_stop(STEP_BUDGET, f": {err}")
            self._stop_reason = STEP_BUDGET
            self._events.append(Event(time_ns=last_ns, kind="stop", text=text))

    def build_run(self) -> Run:
        """Return the run of all ticks so far.

        Raises:
            SimulationError: If no pose was answered.
        """
        scenario = self._scenario
        if not self.has_samples:
            raise SimulationError(
                f"{scenario.name}: no pose is answered within max_duration_s ="
                f" {scenario.max_duration_s}: {_describe_wait(scenario)}"
            )
        has_goal = self._declaration.uses_goal
        return Run(
            name=scenario.name,
            source="simulation",
            poses=_build_poses(self._poses, self._sensed),
            commands=_build_commands(self._commands),
            samples=self._samples.build_columns(),
            goal_xy_m=(scenario.goal.x_m, scenario.goal.y_m) if has_goal else None,
            goal_heading_rad=scenario.goal.heading_rad if has_goal else None,
            declaration=self._declaration,
            parameters=flatten_scenario(scenario),
            scenario_is_complete=True,
            stop_reason=self._stop_reason,
            events=tuple(self._events),
            simulated_by=find_software(scenario.law.kind),
            notes=_describe_law(scenario.law.kind),
        )


def _describe_law(kind: str) -> dict[str, str]:
    """Return the source of a law that exists only in this session, as text."""
    source = read_law_source(kind) if is_given(kind) else None
    return {} if source is None else {"law_source": source}


def _describe_wait(scenario: Scenario) -> str:
    """Return why the first answer has to wait."""
    sensing, backlog = scenario.sensing, scenario.loop.start_backlog
    effects = {"dropout_probability": sensing.dropout_probability, "delay_s": sensing.delay_s}
    others = [f", sensing.{key} = {value:g}" for key, value in effects.items() if value]
    return f"start_backlog = {backlog} poses come first{''.join(others)}"


def _pack_sensed(ticks: Iterable[Tick], packed: bytearray) -> Iterator[Tick]:
    """Yield ticks and collect their sensed poses; NaN for poses that dropped out."""
    for tick in ticks:
        row = tick.row
        packed += _SENSED_ROW.pack(row.sensed_x_m, row.sensed_y_m, row.sensed_heading_rad)
        yield tick


def _build_poses(packed: bytearray, packed_sensed: bytearray | None) -> PoseColumns:
    (time_ns,), (x, y, heading, speed, turn_rate) = _split_rows(packed, _POSE_ROW.size, integers=1)
    sensed = None
    if packed_sensed is not None:
        _, sensed = _split_rows(packed_sensed, _SENSED_ROW.size, integers=0)
    return PoseColumns(
        time_ns=time_ns,
        xy_m=np.column_stack([x, y]),
        heading_rad=heading,
        speed_m_s=speed,
        turn_rate_rad_s=turn_rate,
        sensed_xy_m=None if sensed is None else np.column_stack([*sensed[:2]]),
        sensed_heading_rad=None if sensed is None else sensed[2],
    )


def _build_commands(packed: bytearray) -> CommandColumns:
    (time_ns,), (speed, turn_rate) = _split_rows(packed, _COMMAND_ROW.size, integers=1)
    return CommandColumns(
        time_ns=time_ns,
        speed_m_s=speed,
        lateral_speed_m_s=np.zeros_like(speed),
        turn_rate_rad_s=turn_rate,
    )


_SAMPLE_ROW: Final = Struct("<4q11d")
_WHOLE: Final = 4


class SampleRows:
    """Collector of a law's samples, 8 bytes per value, whole numbers first."""

    __slots__ = ("_declaration", "_extra", "_has_shaping", "_pack", "_packed")

    def __init__(self, declaration: Declaration, *, has_shaping: bool = False) -> None:
        """Allocate space for the declared states and reference of a law, and for shaping."""
        self._declaration, self._has_shaping = declaration, has_shaping
        self._pack = _SAMPLE_ROW.pack
        extra = len(declaration.states) + 3 * declaration.has_reference + 2 * has_shaping
        self._extra = Struct(f"<{extra}d") if extra else None
        self._packed = bytearray()

    def __len__(self) -> int:
        return len(self._packed) // self._row_size

    @property
    def _row_size(self) -> int:
        return _SAMPLE_ROW.size + (self._extra.size if self._extra else 0)

    def add(self, sample: SampleRow, states: tuple[float, ...] = ()) -> None:
        """Add the next sample and the states of its law."""
        self._packed += self._pack(
            sample.time_ns,
            sample.sequence,
            sample.pose_sequence,
            sample.phase,
            sample.bearing_rad,
            sample.heading_error_rad,
            sample.error_x_m,
            sample.error_y_m,
            sample.distance_m,
            sample.wanted_speed_m_s,
            sample.wanted_turn_rate_rad_s,
            sample.speed_m_s,
            sample.turn_rate_rad_s,
            sample.world_v_x_m_s,
            sample.world_v_y_m_s,
        )
        if self._extra is not None:
            values = states
            if self._declaration.has_reference:
                pose = sample.reference_x_m, sample.reference_y_m, sample.reference_heading_rad
                values = *values, *pose
            if self._has_shaping:
                values = *values, sample.shaped_speed_m_s, sample.shaped_turn_rate_rad_s
            self._packed += self._extra.pack(*values)

    def build_columns(self) -> SampleColumns:
        """Return the columns of all samples so far."""
        declaration = self._declaration
        integers, values = _split_rows(self._packed, self._row_size, integers=_WHOLE)
        time_ns, sequence, pose_sequence, phase = integers
        bearing, heading_error, error_x, error_y, distance, *commands = values[:9]
        world, extra = values[9:11], values[11:]
        wanted_speed, wanted_turn_rate, speed, turn_rate = commands
        states = extra[: len(declaration.states)]
        shaped = extra[len(extra) - 2 * self._has_shaping :]
        reference = extra[len(declaration.states) : len(extra) - len(shaped)]
        return SampleColumns(
            time_ns=time_ns,
            sequence=sequence,
            pose_sequence=pose_sequence,
            phase=phase,
            bearing_rad=keep_whole(bearing),
            heading_error_rad=keep_whole(heading_error),
            error_xy_m=keep_whole(np.column_stack([error_x, error_y])),
            distance_m=keep_whole(distance),
            wanted_speed_m_s=wanted_speed,
            wanted_turn_rate_rad_s=wanted_turn_rate,
            speed_m_s=speed,
            turn_rate_rad_s=turn_rate,
            shaped_speed_m_s=shaped[0] if len(shaped) else None,
            shaped_turn_rate_rad_s=shaped[1] if len(shaped) else None,
            world_velocity_m_s=None if np.isnan(world).all() else np.column_stack([*world]),
            states=np.column_stack(list(states)) if declaration.states else None,
            reference_xy_m=np.column_stack(list(reference[:2])) if len(reference) else None,
            reference_heading_rad=reference[2] if len(reference) else None,
        )


def _split_rows(
    packed: bytearray, size: int, *, integers: int
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    words = np.frombuffer(packed, dtype="<i8").reshape(-1, size // 8).T
    return words[:integers].copy(), words[integers:].copy().view("<f8")


def keep_whole(values: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Return a column; None if a row has no number, for example an error without a goal."""
    return None if np.isnan(values).any() else values
