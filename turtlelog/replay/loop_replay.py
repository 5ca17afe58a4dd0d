"""Repeated simulation of the closed loop, compared with the whole recording."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final

from turtlelog.display import fit_line
from turtlelog.errors import ReplayError
from turtlelog.plants import find_plant
from turtlelog.replay.differences import (
    Difference,
    SignalDifference,
    compare_pairing,
    describe_replay,
    find_earliest,
    format_replay_html,
    require_tolerance,
)
from turtlelog.replay.plant_replay import PoseError, find_pose_error
from turtlelog.replay.plant_ticks import advise_other_mode
from turtlelog.replay.run_pairs import (
    SENSED,
    TIME_IS_UP,
    Answers,
    RowCount,
    compare_declarations,
    compare_ends,
    count_recorded_rows,
    find_count_difference,
    has_ticks,
    list_unrecorded,
    pair_by_sample,
    pair_by_tick,
)
from turtlelog.run import Run, require_run
from turtlelog.scenario import Scenario, resolve_scenario, restore_scenario
from turtlelog.simulate import simulate_run
from turtlelog.simulate.step_budget import STEP_BUDGET_S

_OF_TICKS: Final = (
    *("applied_speed", "applied_turn_rate", "sample_time", "pose_read", "command_time"),
)
"""Signals that are recorded only if a recording has one pose per tick."""

_LONGEST_S: Final = 3600.0
"""Largest simulated time that a recording may request, however short the recording is [s]: an hour
takes 5 s and 140 MB."""
_LONGER: Final = 1.1
"""Largest ratio of a replay's duration to that of its recording; applies if it allows more than
`_LONGEST_S`."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LoopReplay:
    """Repeated simulation of a scenario, compared with the recording.

    Attributes:
        name: Name of the recorded run.
        scenario: Scenario as simulated.
        run: The replayed run.
        by_tick: Whether poses were compared tick by tick; otherwise the poses that samples read
            were compared.
        samples: Number of compared samples.
        max_abs_error: Largest difference of all compared poses.
        signals: Differences by signal: poses, samples, commands.
        counts: Numbers of rows of `samples`, `poses` and `commands`, if recorded.
        stop: Difference of the stop reasons; None if they are equal.
        others: Differences that belong to no signal: those of `counts` and `stop`.
        declaration: Difference of the declarations, if the law declares other loops, phases or
            states than the recording; else None. The runs do not count as different because of this
            alone.
        first_difference: The earliest difference, including counts and stop; of several at one
            time, that of the first signal in `signals`. None if nothing differs.
        absent: Signals of the replay that are not recorded.
    """

    name: str
    scenario: Scenario
    run: Run
    by_tick: bool
    samples: int
    max_abs_error: PoseError
    signals: tuple[SignalDifference, ...]
    counts: Mapping[str, RowCount]
    stop: Difference | None
    others: tuple[Difference, ...]
    declaration: Difference | None
    first_difference: Difference | None
    absent: tuple[str, ...]

    def __repr__(self) -> str:
        found = describe_replay(self.samples, self.first_difference)
        return fit_line(f"<LoopReplay of {self.name}: {found}>")

    def _repr_html_(self) -> str:
        return format_replay_html(self.name, self.samples, self.first_difference, self.signals)


def replay_loop(
    run: Run,
    scenario: Scenario | None = None,
    *,
    tolerance: float = 0.0,
    trust_law: bool = False,
    step_budget_s: float | None = STEP_BUDGET_S,
) -> LoopReplay:
    """Simulate the scenario of a recording again, and compare row by row.

    Ticks are matched by time, samples by number, commands by order. Times are compared like other
    values. A log with one pose per sample is compared sample by sample, without its clock. A
    truncated recording may end before its replay.

    Args:
        run: Run with samples, or with ticks exactly one plant period apart.
        scenario: Scenario to simulate. Default: the scenario of the recording. A changed scenario
            answers "what if".
        tolerance: Largest difference that counts as equal, in the unit of each signal.
        trust_law: Whether to run the code of a recorded law that is not built in.
        step_budget_s: Largest computing time for one answer [s]; None: unlimited.

    Raises:
        ReplayError: If the run contains neither such ticks nor samples.
        ScenarioError: If no scenario is given, and the run does not contain its whole scenario or
            names a law that is neither built in nor trusted.
        SimulationError: If the simulation cannot continue.
        ReplayError: If the simulation of the recorded scenario lasts much longer than the
            recording.
    """
    require_run(run)
    require_tolerance(tolerance)
    by_tick = has_ticks(run)
    if not by_tick and not len(run.samples):
        raise ReplayError(
            f"{run.name}: replay needs turtlesim's pose of each tick"
            f" ({find_plant(run).period_ns / 1e6:g} ms) or the samples of a controller; this"
            f" recording has neither; {advise_other_mode(run)}"
        )
    is_own = scenario is None
    scenario = restore_scenario(run) if scenario is None else scenario
    scenario = resolve_scenario(scenario, trust_law=trust_law)
    within = _shorten(scenario, run) if is_own else scenario
    replayed = simulate_run(within, step_budget_s=step_budget_s)
    if replayed.stop_reason == TIME_IS_UP and within is not scenario:
        raise ReplayError(
            f"{run.name}: the replay goes on after {within.max_duration_s:g} s, and the recording"
            f" ends after {run.end_ns / 1e9:g} s. --set max_duration_s={scenario.max_duration_s:g}"
            " simulates all of it"
        )
    replayed = replace(
        replayed,
        source=f"replay of {run.name}",
        parameters={**replayed.parameters, "max_duration_s": scenario.max_duration_s},
    )
    pairings = pair_by_tick(run, replayed) if by_tick else pair_by_sample(run, replayed)
    signals = tuple(compare_pairing(pairing, tolerance=tolerance) for pairing in pairings)
    counts = count_recorded_rows(run, replayed, by_tick=by_tick)
    stop = compare_ends(run, replayed.stop_reason)
    ends = [find_count_difference(run, name, count) for name, count in counts.items()]
    others = tuple(found for found in (*ends, stop) if found is not None)
    return LoopReplay(
        name=run.name,
        scenario=scenario,
        run=replayed,
        by_tick=by_tick,
        samples=next((found.rows for found in signals if found.signal == "phase"), 0),
        max_abs_error=find_pose_error(signals),
        signals=signals,
        counts=MappingProxyType(counts),
        stop=stop,
        others=others,
        declaration=compare_declarations(run, replayed.declaration) if len(run.samples) else None,
        first_difference=find_earliest([*(found.first_difference for found in signals), *others]),
        absent=(*_list_absent(run, replayed), *_list_missing(_OF_TICKS, signals)),
    )


def _shorten(scenario: Scenario, run: Run) -> Scenario:
    """Return the scenario, shortened if it lasts much longer than its recording."""
    most_s = max(_LONGEST_S, _LONGER * run.end_ns / 1e9)
    return (
        replace(scenario, max_duration_s=most_s) if scenario.max_duration_s > most_s else scenario
    )


def _list_absent(run: Run, replayed: Run) -> tuple[str, ...]:
    was = Answers(run.samples, run.declaration)
    is_lacking = run.poses.sensed_xy_m is None and replayed.poses.sensed_xy_m is not None
    sensed = tuple(SENSED) if is_lacking else ()
    return (*sensed, *list_unrecorded(was, Answers(replayed.samples, replayed.declaration)))


def _list_missing(names: Sequence[str], signals: Sequence[SignalDifference]) -> tuple[str, ...]:
    found = {signal.signal for signal in signals}
    return tuple(name for name in names if name not in found)
