"""A run from a compiled loop: its arrays are filled, simulated, and converted to columns."""

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from turtlelog.laws import LawPart, find_law
from turtlelog.parts import Plant
from turtlelog.run import CommandColumns, Event, PoseColumns, Run, SampleColumns
from turtlelog.run.loops import Declaration
from turtlelog.run.path_pieces import PathPiece
from turtlelog.scenario import Scenario, flatten_scenario
from turtlelog.simulate.class_law import declare_scenario, is_built_in
from turtlelog.simulate.collect import keep_whole
from turtlelog.simulate.compiled.compiled_loop import PIECE, CompiledLoop
from turtlelog.simulate.compiled.twins import as_record
from turtlelog.simulate.rows import MAX_DURATION, describe_event
from turtlelog.simulate.settings import bound_rows, build_settings
from turtlelog.simulate.step_budget import WatchedCode
from turtlelog.simulate.streams import STREAMS, draw_events, list_of, list_streams
from turtlelog.simulate.versions import find_software


class CompiledRunner:
    """Simulations with compiled loops, one scenario after another in the same arrays."""

    def __init__(self, step_budget_s: float | None = None) -> None:
        """Start without arrays.

        Args:
            step_budget_s: Time that a user law may compute for one answer [s]; None: unlimited.
        """
        self._rows: dict[Any, Any] = {}
        self._watched = None if step_budget_s is None else WatchedCode(step_budget_s)

    def simulate(self, loop: CompiledLoop, scenario: Scenario, plant: Plant) -> Run | None:
        """Return the run of a scenario from a loop that supports it.

        The law of the scenario must be resolved. The result is None if the law fails or answers no
        pose; the loop in Python then gives the reason.

        Raises:
            StepBudgetError: If a step of a user law does not return within its budget.
        """
        law, declaration = find_law(scenario.law.kind), declare_scenario(scenario)
        _, settings, start = build_settings(scenario, law, declaration, plant)
        ticks, samples = bound_rows(scenario, plant)
        rows = self._rows.get(loop)
        if rows is None or ticks > len(rows.ticks) or samples > len(rows.samples):
            rows = self._rows[loop] = loop.kinds.allocate(ticks, samples)
        rows = begin_rows(rows, scenario, ticks, samples)
        state = as_record(start, loop.kinds.state)
        now = state[0]["now"]
        run = partial(loop.run, as_record(settings, loop.kinds.settings), state, rows)
        if self._watched is None or is_built_in(law):
            run()
        else:
            del self._rows[loop]  # code that never returns keeps its arrays
            self._watched.call(run, lambda: int(now["samples"]))
            self._rows[loop] = rows
        if now["failure"] or not now["samples"]:
            return None
        return _build_run(scenario, declaration, plant, rows, now)


def begin_rows(rows: Any, scenario: Scenario, ticks: int, samples: int) -> Any:
    """Return the arrays with the initial values of a scenario."""
    draw_streams(rows, list_streams(scenario), scenario.seed, ticks, samples)
    table, pieces = build_tables(scenario)
    return rows._replace(table=table, pieces=pieces)


def build_tables(scenario: Scenario) -> tuple[NDArray[np.float64], NDArray[Any]]:
    """Return the table of a law, and the pieces of a path."""
    law = find_law(scenario.law.kind)
    rows: tuple[Any, ...] = ()
    if isinstance(law, LawPart) and law.build_table is not None:
        rows = tuple(law.build_table(scenario.law.parameters))
    table = np.array(rows, np.float64) if rows else np.empty((0, 0))
    pieces: tuple[PathPiece, ...] = () if scenario.path is None else scenario.path.ways
    return table, np.array([piece[1:] for piece in pieces], PIECE)


def draw_streams(rows: Any, names: frozenset[str], seed: int, ticks: int, samples: int) -> None:
    """Generate the random numbers of effects, event by event."""
    for table, count, of_ticks in (
        (rows.drawn_ticks, ticks, True),
        (rows.drawn_samples, samples, False),
    ):
        for name in list_of(ticks=of_ticks):
            if name in names:
                drawn = draw_events(seed, STREAMS[name], count)
                for place, field in enumerate(STREAMS[name].fields):
                    table[name][field][:count] = drawn[:, place]


def name_stop(law: Any, number: int) -> str:
    """Return the stop reason of a compiled loop, in one word."""
    return "max_duration" if number == MAX_DURATION else law.stops[number - 1]


def _build_run(
    scenario: Scenario, declaration: Declaration, plant: Plant, rows: Any, now: Any
) -> Run:
    law, has_goal = find_law(scenario.law.kind), declaration.uses_goal
    samples = rows.samples[: now["samples"]]
    events = rows.events[: now["events"]]
    return Run(
        name=scenario.name,
        source="simulation",
        poses=_build_poses(scenario, plant, rows.ticks[: now["ticks"]]),
        commands=_build_commands(samples[: now["published"]]),
        samples=_build_samples(scenario, declaration, samples, rows.states[: now["samples"]]),
        goal_xy_m=(scenario.goal.x_m, scenario.goal.y_m) if has_goal else None,
        goal_heading_rad=scenario.goal.heading_rad if has_goal else None,
        declaration=declaration,
        parameters=flatten_scenario(scenario),
        scenario_is_complete=True,
        stop_reason=name_stop(law, int(now["stop"])),
        events=tuple(_describe_events(events, plant.period_ns, law)),
        simulated_by=find_software(scenario.law.kind),
    )


def _describe_events(rows: NDArray[Any], period_ns: int, law: Any) -> Iterator[Event]:
    for row in rows.view(np.recarray):
        yield describe_event(row, period_ns, lambda number: name_stop(law, number))


def _pair(rows: NDArray[Any], *names: str) -> NDArray[np.float64]:
    return np.column_stack([rows[name] for name in names])


def _build_poses(scenario: Scenario, plant: Plant, rows: NDArray[Any]) -> PoseColumns:
    senses = scenario.has_action("sense", "lose_pose")
    return PoseColumns(
        time_ns=np.arange(len(rows)) * plant.period_ns,
        xy_m=_pair(rows, "x_m", "y_m"),
        heading_rad=rows["heading_rad"].copy(),
        speed_m_s=rows["speed_m_s"].copy(),
        turn_rate_rad_s=rows["turn_rate_rad_s"].copy(),
        sensed_xy_m=_pair(rows, "sensed_x_m", "sensed_y_m") if senses else None,
        sensed_heading_rad=rows["sensed_heading_rad"].copy() if senses else None,
    )


def _build_commands(samples: NDArray[Any]) -> CommandColumns:
    speed = samples["speed_m_s"].copy()
    return CommandColumns(
        time_ns=samples["published_ns"].copy(),
        speed_m_s=speed,
        lateral_speed_m_s=np.zeros_like(speed),
        turn_rate_rad_s=samples["turn_rate_rad_s"].copy(),
    )


def _build_samples(
    scenario: Scenario, declaration: Declaration, rows: NDArray[Any], states: NDArray[Any]
) -> SampleColumns:
    shapes, moves = scenario.has_action("shape"), declaration.has_reference
    world = _pair(rows, "world_v_x_m_s", "world_v_y_m_s")
    errors = _pair(rows, "error_x_m", "error_y_m")
    return SampleColumns(
        time_ns=rows["time_ns"].copy(),
        sequence=rows["sequence"].copy(),
        pose_sequence=rows["pose_sequence"].copy(),
        phase=rows["phase"].copy(),
        bearing_rad=keep_whole(rows["bearing_rad"].copy()),
        heading_error_rad=keep_whole(rows["heading_error_rad"].copy()),
        error_xy_m=keep_whole(errors),
        distance_m=keep_whole(rows["distance_m"].copy()),
        wanted_speed_m_s=rows["wanted_speed_m_s"].copy(),
        wanted_turn_rate_rad_s=rows["wanted_turn_rate_rad_s"].copy(),
        speed_m_s=rows["speed_m_s"].copy(),
        turn_rate_rad_s=rows["turn_rate_rad_s"].copy(),
        shaped_speed_m_s=rows["shaped_speed_m_s"].copy() if shapes else None,
        shaped_turn_rate_rad_s=rows["shaped_turn_rate_rad_s"].copy() if shapes else None,
        world_velocity_m_s=None if np.isnan(world).all() else world,
        states=_pair(states, *declaration.states) if declaration.states else None,
        reference_xy_m=_pair(rows, "reference_x_m", "reference_y_m") if moves else None,
        reference_heading_rad=rows["reference_heading_rad"].copy() if moves else None,
    )
