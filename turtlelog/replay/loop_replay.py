"""Replay of a recording in closed loop, or of its poses through a law alone; where runs depart."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import ReplayError as ReplayError
from turtlelog.laws import Law, LawPart, Pose, find_law
from turtlelog.log.recording.topics import CONTROL
from turtlelog.plants import find_plant
from turtlelog.replay import differences
from turtlelog.replay.breaks_and_commands import advise_other_mode
from turtlelog.replay.differences import Answers, Difference, Pairing, ReplayResult, RowCount
from turtlelog.run import Run, SampleColumns, SourceKind, require_run
from turtlelog.run.loops import Declaration
from turtlelog.run.stop_reasons import FINISHED, FROM_OUTSIDE, MAX_DURATION, name_stop
from turtlelog.scenario import Scenario, choose_scenario, resolve_scenario, restore_scenario
from turtlelog.simulate import PlainLoop, SampleRow, SampleRows, simulate_run
from turtlelog.simulate.class_law import is_built_in
from turtlelog.simulate.step_budget import STEP_BUDGET_S, LimitedLoop, needs_watch, require_budget


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class LawReplay(ReplayResult):
    """Commands of a law for the recorded poses, compared with the recording.

    Attributes:
        name: Name of the run.
        scenario: Scenario with the law, limits and goal.
        samples: Number of compared samples: all, or those up to the stop of the replayed law.
        missing_samples: Number of recorded samples that are lost: the law did not read their poses.
        signals: Differences by signal, commands first.
        commands: Difference of the counts, unless one command per sample was published. None if
            there was one command per sample, or if rows are lost.
        stop: Difference of the ends, if the law ends the run at another sample or for another
            reason; else None.
        declaration: Difference of the declared loops, phases or states; else None. The runs do not
            count as different because of this alone.
        first_difference: The earliest difference; of several in one sample, that of the first
            signal in `signals`. None if nothing differs.
        first_command_difference: The earliest difference of the commands, computed or published.
        absent: Signals of the replay that are not recorded, or of which rows are lost.
        answers: Replayed samples.
    """

    name: str
    scenario: Scenario
    samples: int
    missing_samples: int
    signals: tuple[differences.SignalDifference, ...]
    commands: Difference | None
    stop: Difference | None
    declaration: Difference | None
    first_difference: Difference | None
    first_command_difference: Difference | None
    absent: tuple[str, ...]
    answers: SampleColumns

    @property
    def others(self) -> tuple[Difference, ...]:
        """Differences that belong to no signal: those of `commands` and `stop`."""
        return tuple(found for found in (self.commands, self.stop) if found is not None)


def replay_law(
    run: Run,
    scenario: Scenario | None = None,
    *,
    law: Any = None,
    tolerance: float = 0.0,
    trust_law: bool = False,
    step_budget_s: float | None = STEP_BUDGET_S,
) -> LawReplay:
    """Let a law answer the recorded poses, in the order and at the times of the samples.

    If poses were sensed, the law answers the sensed poses. Shaping and limits act again. The
    answers are compared with the recorded samples and the published commands. The law reads the
    same poses as the recorded law; its commands have no effect on the poses. Only the law, the
    path, the shaping, the limits and the goal of the scenario are used.

    Args:
        run: Run with samples.
        scenario: Scenario to use. Default: the scenario of the recording.
        law: Law that replaces the law of the scenario: a law with its parameters, or a class, a
            function or text as in `simulate_run`.
        tolerance: Largest difference that counts as equal, in the unit of each signal.
        trust_law: Whether to run the code of a recorded law that is not built in.
        step_budget_s: Largest computing time for one answer [s]; None: unlimited.

    Raises:
        ReplayError: If the run contains no samples.
        LawError: If `law` is not a law.
        ScenarioError: If no scenario is given, and the run does not contain its whole scenario or
            names a law that is neither built in nor trusted.
        SimulationError: If the law fails, exceeds its computing time, or returns a value that is
            not a number.
    """
    require_run(run)
    differences.require_tolerance(tolerance)
    if not len(run.samples):
        reason = f"{_describe_nothing_read(run)}: {run.source}; {advise_other_mode(run)}"
        raise ReplayError(f"{run.name}: {reason}")
    scenario = restore_scenario(run) if scenario is None else scenario
    is_made = not isinstance(law, type | LawPart) and hasattr(law, "step") and hasattr(law, "reset")
    if law is not None and not is_made:
        scenario, law = choose_scenario(scenario, law=law), None
    if law is None:
        scenario = resolve_scenario(scenario, trust_law=trust_law)
    found, blocks_ticks, stop_reason = _answer_poses(run, scenario, law, step_budget_s)
    answers, recorded = found.samples, Answers(run.samples, run.declaration)
    rows = slice(len(answers))
    pairings = [*differences.pair_samples(recorded, found, rows=rows, others=rows)]
    pairings += differences.pair_published(run, answers)
    if differences.has_ticks(run) and differences.has_all_commands(run):
        # The ticks between samples and their commands.
        rows = slice(min(len(run.commands), len(answers)))
        held = (run.commands.time_ns[rows] - run.samples.time_ns[rows]) / find_plant(run).period_ns
        time_ns = run.samples.time_ns[rows]
        pairings.append(Pairing("pause", "tick", time_ns, held, blocks_ticks[rows]))
    signals = differences.compare_pairings(pairings, tolerance)
    stop = compare_last_answer(run, len(answers) - 1, stop_reason, blocks=bool(blocks_ticks[-1]))
    missing, count = differences.count_missing_samples(run.samples), len(run.samples)
    is_lossy = missing or run.origin.lost != "nothing" or "commands" in run.absent
    has_published, commands = differences.has_published(run), None
    if not (has_published or is_lossy):
        given, at_ns = len(run.commands), run.end_ns
        commands = Difference(signal="commands", time_ns=at_ns, recorded=given, replayed=count)
    first = [*(signal.first_difference for signal in signals), commands, stop]
    absent = differences.list_unrecorded(recorded, found)
    return LawReplay(
        name=run.name,
        scenario=scenario,
        samples=len(answers),
        missing_samples=missing,
        signals=signals,
        commands=commands,
        stop=stop,
        declaration=compare_declarations(run, found.declaration),
        first_difference=differences.find_earliest(first),
        first_command_difference=differences.find_earliest(
            signal.first_difference for signal in signals if signal.signal in differences.COMMANDS
        ),
        absent=absent if has_published else (*absent, *differences.PUBLISHED),
        answers=answers,
    )


def _describe_nothing_read(run: Run) -> str:
    """Return why there are no samples: the file has none, or they were not read."""
    if CONTROL.name in run.origin.unread_topics:
        found = run.notes.get("not_read", CONTROL.name)
        where = "in a file without turtlelog's metadata record"
        return f"{found} {where} are not read as samples of a controller"
    lack = f"no samples of a controller (topic {CONTROL.name})"
    return f"{lack}: what the law read and commanded is not recorded"


def _answer_poses(
    run: Run, scenario: Scenario, law: Law | None, step_budget_s: float | None
) -> tuple[Answers, NDArray[np.int64], str | None]:
    """Return the samples up to the law's end, the blocking ticks of each, and the stop reason."""
    loop = PlainLoop(scenario, law=law, step_budget_s=step_budget_s)
    samples = _iterate_answers(run, loop)
    if step_budget_s is not None:
        require_budget(step_budget_s)
        kind = scenario.law.kind
        if needs_watch(step_budget_s, is_built_in=law is None and is_built_in(find_law(kind))):
            limited = LimitedLoop(samples, [loop], step_budget_s, law=kind, one_by_one=False)
            samples = limited.iterate()
    rows = SampleRows(loop.declaration, has_shaping=scenario.has_action("shape"))
    blocks_ticks = []
    for sample, states in samples:
        rows.add(sample, *states)
        blocks_ticks.append(sample.blocks_ticks)
    answers = Answers(rows.build_columns(), loop.declaration)
    reason = name_stop(sample.stop, loop.stops) if sample.stop else None
    return answers, np.array(blocks_ticks, dtype=np.int64), reason


def _iterate_answers(run: Run, loop: PlainLoop) -> Iterator[tuple[SampleRow, tuple[float, ...]]]:
    poses, read = run.poses, run.samples.pose_sequence
    columns = (run.samples.time_ns, read, *poses.read_xy_m[read].T, poses.read_heading_rad[read])
    for time_ns, row, x, y, heading in zip(*(column.tolist() for column in columns), strict=True):
        sample = loop.answer_pose(time_ns, row, Pose(x, y, heading))
        yield sample, loop.take_states(sample.sequence)
        if sample.stop:
            break


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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class LoopReplay(ReplayResult):
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
        declaration: Difference of the declared loops, phases or states; else None. The runs do not
            count as different because of this alone.
        first_difference: The earliest difference, including counts and stop; of several at one
            time, that of the first signal in `signals`. None if nothing differs.
        absent: Signals of the replay that are not recorded.
    """

    name: str
    scenario: Scenario
    run: Run
    by_tick: bool
    samples: int
    max_abs_error: differences.PoseError
    signals: tuple[differences.SignalDifference, ...]
    counts: Mapping[str, RowCount]
    stop: Difference | None
    others: tuple[Difference, ...]
    declaration: Difference | None
    first_difference: Difference | None
    absent: tuple[str, ...]


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
        ReplayError: If the run contains neither such ticks nor samples, or the simulation of the
            recorded scenario lasts much longer than the recording.
        ScenarioError: If no scenario is given, and the run does not contain its whole scenario or
            names a law that is neither built in nor trusted.
        SimulationError: If the simulation cannot continue.
    """
    require_run(run)
    differences.require_tolerance(tolerance)
    by_tick = differences.has_ticks(run)
    if not by_tick and not len(run.samples):
        raise ReplayError(
            f"{run.name}: replay needs turtlesim's pose of each tick"
            f" ({find_plant(run).period_ns / 1e6:g} ms) or the samples of a controller; this"
            f" recording has neither; {advise_other_mode(run)}"
        )
    is_own = scenario is None
    scenario = restore_scenario(run) if scenario is None else scenario
    scenario = resolve_scenario(scenario, trust_law=trust_law)
    within, most_s = scenario, max(_LONGEST_S, _LONGER * run.end_ns / 1e9)
    if is_own and scenario.max_duration_s > most_s:
        within = replace(scenario, max_duration_s=most_s)
    replayed = simulate_run(within, step_budget_s=step_budget_s)
    if replayed.stop_reason == MAX_DURATION and within is not scenario:
        raise ReplayError(
            f"{run.name}: the replay goes on after {within.max_duration_s:g} s, and the recording"
            f" ends after {run.end_ns / 1e9:g} s. --set max_duration_s={scenario.max_duration_s:g}"
            " simulates all of it"
        )
    parameters = {**replayed.parameters, "max_duration_s": scenario.max_duration_s}
    replayed = replace(replayed, source=SourceKind.REPLAY.describe(run.name), parameters=parameters)
    pair = differences.pair_by_tick if by_tick else differences.pair_by_sample
    signals = differences.compare_pairings(pair(run, replayed), tolerance)
    known = {found.signal: found for found in signals}
    counts = differences.count_recorded_rows(run, replayed, by_tick=by_tick)
    stop = compare_ends(run, replayed.stop_reason)
    ends = [differences.find_count_difference(run, name, count) for name, count in counts.items()]
    others = tuple(found for found in (*ends, stop) if found is not None)
    first = [found.first_difference for found in signals]
    is_sensed = run.poses.sensed_xy_m is None and replayed.poses.sensed_xy_m is not None
    was, now = (Answers(one.samples, one.declaration) for one in (run, replayed))
    absent = (*(differences.SENSED if is_sensed else ()), *differences.list_unrecorded(was, now))
    return LoopReplay(
        name=run.name,
        scenario=scenario,
        run=replayed,
        by_tick=by_tick,
        samples=known["phase"].rows if "phase" in known else 0,
        max_abs_error=differences.find_pose_error(signals),
        signals=signals,
        counts=counts,
        stop=stop,
        others=others,
        declaration=compare_declarations(run, replayed.declaration) if len(run.samples) else None,
        first_difference=differences.find_earliest([*first, *others]),
        absent=(*absent, *(name for name in _OF_TICKS if name not in known)),
    )


def compare_last_answer(
    run: Run, row: int, stop_reason: str | None, *, blocks: bool
) -> Difference | None:
    """Return the difference between an end by the answer of sample `row` and the recorded end."""
    time_ns = int(run.samples.time_ns[row])
    if row < len(run.samples) - 1:
        return _build(time_ns, None, stop_reason)
    if blocks and run.stop_reason == MAX_DURATION:
        return None  # the time was up before it could stop
    agrees = _agrees(run, stop_reason or MAX_DURATION)
    return None if agrees else _build(time_ns, run.stop_reason, stop_reason)


def compare_ends(run: Run, stop_reason: str | None) -> Difference | None:
    """Return the difference between the end of a replay with this reason and the recorded end."""
    return None if _agrees(run, stop_reason) else _build(run.end_ns, run.stop_reason, stop_reason)


def _agrees(run: Run, stop_reason: str | None) -> bool:
    if run.stop_reason == FINISHED:
        return stop_reason != MAX_DURATION
    return run.stop_reason in FROM_OUTSIDE or run.stop_reason == stop_reason


def _build(time_ns: int, recorded: str | None, replayed: str | None) -> Difference:
    return Difference(signal="stop", time_ns=time_ns, recorded=recorded, replayed=replayed)


def compare_declarations(run: Run, replayed: Declaration) -> Difference | None:
    """Return the difference between the declaration of the answering law and the recorded one."""
    if run.declaration == replayed:
        return None
    was, now = _describe_declaration(run.declaration), _describe_declaration(replayed)
    parts = [(a, b) for a, b in zip(was, now, strict=True) if a != b]
    return Difference(
        signal="declaration",
        time_ns=run.start_ns,
        recorded="; ".join(a for a, _ in parts),
        replayed="; ".join(b for _, b in parts),
    )


def _describe_declaration(declaration: Declaration) -> tuple[str, ...]:
    loops = [
        f"{one.name} ({one.signal} by {one.command} to {one.reference}, gain {one.gain or 'none'}"
        f"{'' if one.is_proportional else ', not proportional'}, limit {one.limit_key})"
        for one in declaration.loops
    ]
    phases = [f"{name} ({', '.join(of) or 'no loop'})" for name, of in declaration.phases.items()]
    return (
        f"loops {', '.join(loops) or 'none'}",
        f"phases {', '.join(phases)}",
        f"states {', '.join(declaration.states) or 'none'}",
        "a goal" if declaration.uses_goal else "no goal",
    )


Part = Literal["start", "robot", "sensor", "controller", "timing", "end"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Departure:
    """The earliest difference of two runs.

    Attributes:
        part: Part that differs first. `start`: the first pose. `robot`: the motion after equal
            commands. `sensor`: the sensed pose. `controller`: the answer to an equal pose.
            `timing`: the time of a sample or command. `end`: one run is longer.
        signal: Name of the signal that differs.
        unit: Unit of the values; empty for a name or a count.
        time_s: Time of the difference from the first sample, or else from the first pose [s].
        first: Value of the first run; None if it has no value there.
        second: Value of the second run.
        samples: Number of equal samples before the difference.
    """

    part: Part
    signal: str
    unit: str
    time_s: float
    first: float | str | None
    second: float | str | None
    samples: int


_PARTS: Final[Mapping[str, Part]] = {
    **dict.fromkeys(("stop", "samples", "poses", "commands"), "end"),
    **dict.fromkeys(("sample_time", "pose_read", "command_time"), "timing"),
    **dict.fromkeys(differences.SENSED, "sensor"),
    **dict.fromkeys(("x", "y", "heading", "applied_speed", "applied_turn_rate"), "robot"),
}
"""Parts by the signal that differs; every other signal belongs to the controller."""


def find_departure(first: Run, second: Run) -> Departure | None:
    """Return the first difference of two runs; None if all their common data are equal.

    Poses are compared tick by tick if both runs contain all ticks. Otherwise only the poses that
    samples read are compared.
    """
    by_tick = differences.has_ticks(first) and differences.has_ticks(second)
    pair = differences.pair_by_tick if by_tick else differences.pair_by_sample
    # Rows are matched by sample number. At equal times, causes come before their consequences.
    is_whole = not differences.count_missing_samples(second.samples)
    pairings = [one for one in pair(first, second) if len(one.time_ns)] if is_whole else []
    found = [differences.compare_pairing(one, tolerance=0.0).first_difference for one in pairings]
    for name, count in differences.count_recorded_rows(first, second, by_tick=by_tick).items():
        apart = differences.find_count_difference(first, name, count)
        found.append(apart and replace(apart, time_ns=min(first.end_ns, second.end_ns)))
    earliest = differences.find_earliest([*found, compare_ends(first, second.stop_reason)])
    if earliest is None:
        return None
    part = _PARTS.get(earliest.signal, "controller")
    if part == "robot" and earliest.time_ns <= first.poses.time_ns[0]:
        part = "start"
    return Departure(
        part=part,
        signal=earliest.signal,
        unit=next((one.unit for one in pairings if one.signal == earliest.signal), ""),
        time_s=float(earliest.time_ns - first.start_ns) / 1e9,
        first=earliest.recorded,
        second=earliest.replayed,
        samples=int(np.searchsorted(first.samples.time_ns, earliest.time_ns)),
    )
