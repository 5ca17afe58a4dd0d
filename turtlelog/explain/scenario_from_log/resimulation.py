"""Comparison of a simulated scenario with a log; test of the recorded scenario of a run.

A re-simulation of the recorded scenario either reproduces every sample or is rejected.
"""

import sys
from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import SimulationError
from turtlelog.explain.scenario_from_log.trace import Trace
from turtlelog.laws import LAWS
from turtlelog.replay import PoseError
from turtlelog.run import Run
from turtlelog.run.angles import subtract_headings
from turtlelog.scenario import DEFAULT_LAW, Scenario, resolve_scenario, restore_scenario
from turtlelog.simulate import (
    PlainLoop,
    Tick,
    declare_scenario,
    iterate_ticks,
    needs_time,
    simulate_run,
)

if TYPE_CHECKING:
    from turtlelog.explain.scenario_from_log.setting_search import Fits

CLOSE: Final = 1e-6
"""Largest difference of a scenario's poses between platforms [m, rad]."""

CLOSE_COMMAND: Final = 1e-9
"""Largest difference of a scenario's commands between platforms [m/s, rad/s]."""

Row = tuple[Any, ...]
"""The compared values of a sample."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Resimulation:
    """Comparison of the re-simulated scenario with the log.

    Attributes:
        samples: Number of compared samples, by their order in each phase.
        max_abs_error: Largest difference of the poses read [m or rad].
        max_command_error: Largest difference of the published commands [m/s or rad/s].
        is_exact: Whether each phase has the same number of samples, and none differs.
    """

    samples: int
    max_abs_error: PoseError
    max_command_error: float
    is_exact: bool


@dataclass(frozen=True, slots=True)
class Depths:
    """Depths of the queues for commands and poses, or the depths that a run needs."""

    commands: int
    poses: int

    def hold(self, needed: "Depths") -> bool:
        """Return whether queues of these depths lose no pose or command."""
        return self.commands >= needed.commands and self.poses >= needed.poses


class QueueGauge:
    """Gauge of the queue depths that lose nothing; deeper queues give the same run.

    The depths follow from the times of answers and commands; a constant delay does not change them.
    """

    def __init__(self, scenario: Scenario) -> None:
        loop = scenario.loop
        self._period_ticks = loop.period_ticks
        self._takes_newest = loop.queue_policy == "newest"
        self._is_known = not needs_time(scenario)
        self._waiting = self._queued = 0
        self._poses = self._commands = 1

    def receive(self, tick: int) -> None:
        """Queue the pose of a tick if the controller reads it."""
        if tick % self._period_ticks == 0:
            self._waiting += 1
            self._poses = max(self._poses, self._waiting)

    def answer(self, tick: Tick) -> None:
        """Remove the poses that a tick answers, and queue its commands; the plant takes one."""
        self._waiting -= len(tick.computed)
        if not self._takes_newest:
            self._queued = max(self._queued - 1, 0) + len(tick.published)
            self._commands = max(self._commands, self._queued)

    @property
    def needed(self) -> Depths:
        """Smallest sufficient depths so far; infinite if poses or commands travel for a time."""
        return Depths(self._commands, self._poses) if self._is_known else _BEYOND_ALL


_BEYOND_ALL: Final = Depths(sys.maxsize, sys.maxsize)


def read_depths(scenario: Scenario) -> Depths:
    """Return the depths of a scenario's queues."""
    return Depths(scenario.loop.command_queue, scenario.loop.pose_queue)


def list_recorded_rows(trace: Trace) -> list[Row | None]:
    """Return the values of each sample that a re-simulation must reproduce; None if one is lost."""
    samples = trace.run.samples
    columns = [
        trace.xy_m[:, 0],
        trace.xy_m[:, 1],
        trace.heading_rad,
        trace.speed_m_s,
        trace.turn_rate_rad_s,
        np.array(trace.run.phase_names)[samples.phase],
    ]
    if trace.has_ticks:
        columns.append(number_poses(trace))
    if trace.has_exact_clock and trace.has_ticks:
        columns.append(trace.time_ns - trace.run.poses.time_ns[0])
    rows: list[Row | None] = [None] * (int(trace.number[-1]) + 1)
    columns = [column.tolist() for column in columns]
    for number, row in zip(trace.number.tolist(), zip(*columns, strict=True), strict=True):
        rows[number] = row
    return rows


def number_poses(trace: Trace) -> NDArray[np.int64]:
    """Return the number of the pose that each sample read; poses may also be lost."""
    poses, read = trace.run.poses, trace.run.samples.pose_sequence
    return (
        (poses.time_ns[read] - poses.time_ns[0]) // trace.tick_ns if trace.has_exact_clock else read
    )


def count_equal(
    scenario: Scenario, rows: list[Row | None], *, to_rounding: bool = False
) -> tuple[int, Depths]:
    """Return how many samples, from the first, a simulation reproduces bit for bit.

    The number is one more if all are reproduced and the simulation continues. `to_rounding` allows
    differences of 1e-6 for poses and 1e-9 for commands, as between platforms. The second value is
    the smallest queue depths with the same result.
    """
    width = len(rows[-1] or ())
    equal, poses, gauge = 0, list[Row](), QueueGauge(scenario)
    phases = declare_scenario(scenario).phase_names
    for number, tick in enumerate(iterate_ticks(scenario)):
        gauge.receive(number)
        poses.append((tick.row.x_m, tick.row.y_m, tick.row.heading_rad))
        for sample in tick.computed:
            if equal == len(rows):
                return equal + 1, gauge.needed
            again = (
                *poses[sample.pose_sequence],
                *(sample.speed_m_s, sample.turn_rate_rad_s, phases[sample.phase]),
                *(sample.pose_sequence, sample.time_ns),
            )[:width]
            row = rows[equal]
            if row not in {None, again} and not (to_rounding and _agrees(again, row)):
                return equal, gauge.needed
            equal += 1
        gauge.answer(tick)
    return equal, gauge.needed


def _agrees(again: Row, recorded: Row) -> bool:
    apart = [abs(left - right) for left, right in zip(again[:5], recorded[:5], strict=True)]
    is_close = max(apart[:3]) < CLOSE and max(apart[3:]) < CLOSE_COMMAND
    return is_close and again[5:] == recorded[5:]


def compare_samples(trace: Trace, again: Run) -> Resimulation:
    """Return a comparison of a simulated run with the log."""
    pairs: list[tuple[Any, Any]] = []
    if trace.number[-1] + 1 > len(trace):
        rows = np.flatnonzero(trace.number < len(again.samples))
        pairs.append((rows, trace.number[rows]))
    else:
        logged, simulated = (
            np.array(run.phase_names)[run.samples.phase] for run in (trace.run, again)
        )
        for phase in trace.run.phase_names:
            both = np.flatnonzero(logged == phase), np.flatnonzero(simulated == phase)
            count = min(map(len, both))
            pairs.append((both[0][:count], both[1][:count]))
    left, right = (np.concatenate(rows) for rows in zip(*pairs, strict=True))
    read = again.samples.pose_sequence[right]
    xy = np.abs(trace.xy_m[left] - again.poses.xy_m[read])
    turned = np.abs(subtract_headings(trace.heading_rad[left], again.poses.heading_rad[read]))
    speed = np.abs(trace.speed_m_s[left] - again.samples.speed_m_s[right])
    turn_rate = np.abs(trace.turn_rate_rad_s[left] - again.samples.turn_rate_rad_s[right])
    columns = (*xy.T, turned, speed, turn_rate)
    x_m, y_m, heading_rad, *commands = (float(one.max(initial=0.0)) for one in columns)
    error, command_error = PoseError(x_m=x_m, y_m=y_m, heading_rad=heading_rad), max(commands)
    is_whole = len(trace) == len(left) and int(trace.number[-1]) + 1 == len(again.samples)
    return Resimulation(
        samples=len(left),
        max_abs_error=error,
        max_command_error=command_error,
        is_exact=is_whole and error == PoseError() and command_error == 0.0,
    )


def find_end_s(trace: Trace, scenario: Scenario, samples: int) -> float:
    """Return the time in a simulation at which the log ends, if it reproduces all samples [s]."""
    run, tick_s = trace.run, trace.tick_ns / 1e9
    if trace.has_exact_clock and trace.has_ticks:
        return max(float(run.end_ns - run.poses.time_ns[0]) / 1e9, tick_s)
    computed = 0
    for tick in iterate_ticks(scenario):
        computed += len(tick.computed)
        if computed >= samples:
            return max(tick.time_ns / 1e9, tick_s)
    return scenario.max_duration_s


def cut_where_logged(scenario: Scenario, trace: Trace) -> Scenario:
    """Return the scenario, ended at the tick in which the log ends."""
    run, loop = trace.run, scenario.loop
    first_ns = run.poses.time_ns[0] if trace.has_ticks else trace.time_ns[0]
    waited = 0 if trace.has_ticks else (loop.start_backlog - 1) * loop.period_ticks
    ticks = waited + round(float(run.end_ns - first_ns) / trace.tick_ns)
    end_s = max(ticks, 1) * (trace.tick_ns / 1e9)
    return replace(scenario, max_duration_s=min(scenario.max_duration_s, end_s))


def list_lost_commands(scenarios: Sequence[Scenario]) -> list[int]:
    """Return how many published commands the plant never takes, for each scenario.

    Commands on their way at the end do not count. Scenarios that differ only in queues of
    sufficient depth are simulated once.
    """
    known: list[tuple[Scenario, Depths, int]] = []
    counts = []
    for scenario in scenarios:
        shallow = replace(scenario.loop, command_queue=1, pose_queue=1)
        alike, depths = replace(scenario, loop=shallow), read_depths(scenario)
        found = (lost for other, needed, lost in known if depths.hold(needed) and other == alike)
        lost = next(found, None)
        if lost is None:
            gauge, loops, superseded = QueueGauge(scenario), list[PlainLoop](), 0
            for number, tick in enumerate(iterate_ticks(scenario, made=loops)):
                gauge.receive(number)
                superseded += max(len(tick.published) - 1, 0)
                gauge.answer(tick)
            is_newest = scenario.loop.queue_policy == "newest"
            lost, needed = superseded if is_newest else loops[0].now.commands_dropped, gauge.needed
            if depths.hold(needed):
                known.append((alike, needed, lost))
        counts.append(lost)
    return counts


def read_pause(scenario: Scenario) -> tuple[float | None, int]:
    """Return the turn rate held at the end of the law's pause, and the poses answered at once then.

    The rate is None if commands were still queued. The number is 0 if there is no pause.
    """
    is_blocked, sent = False, 0.0
    for tick in iterate_ticks(scenario):
        if is_blocked and tick.computed:
            is_held = float(np.float32(sent)) == tick.row.turn_rate_rad_s
            return (sent if is_held else None), len(tick.computed)
        for sample in tick.computed:
            is_blocked = sample.blocks_ticks > 0
            sent = sent if is_blocked else sample.turn_rate_rad_s
    return None, 0


LONGEST_S: Final = 3600.0
"""Longest run that is simulated again [s]: 225,000 ticks, about five seconds for each
simulation."""

NOT_DETERMINISTIC: Final = (
    "the recorded scenario reproduces every sample once, and not when it is simulated again:"
    " its law is not deterministic, and nothing is claimed of it"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedScenario:
    """Result of testing the recorded scenario of a run.

    Attributes:
        scenario: Scenario that ends with the log, if it reproduces every sample.
        run: Re-simulated run, and `resimulation` its comparison with the log, if simulated.
        reach: Agreement with the log, or why the scenario was not simulated, in one clause.
    """

    scenario: Scenario | None = None
    run: Run | None = None
    resimulation: Resimulation | None = None
    reach: str


def require_trust(run: Run, *, trust_law: bool) -> None:
    """Refuse a run whose complete scenario has a law that is neither built in nor trusted.

    Raises:
        ScenarioError: If a trusted law cannot run, or the law is not trusted; the message contains
            the law's name and how to trust it.
    """
    if run.scenario_is_complete and run.parameters.get("law.kind", DEFAULT_LAW) not in LAWS:
        resolve_scenario(restore_scenario(run), trust_law=trust_law)


def check_recorded_scenario(trace: Trace, *, trust_law: bool) -> RecordedScenario:
    """Simulate the recorded scenario of a log's run, and compare both sample by sample.

    Raises:
        ScenarioError: If the law may not or cannot run.
    """
    scenario = resolve_scenario(restore_scenario(trace.run), trust_law=trust_law)
    rows = list_recorded_rows(trace)
    try:
        count, _ = count_equal(scenario, rows, to_rounding=True)
        if count < len(rows):
            way = describe_departure(trace, count)
            reach = f"the recorded scenario {way}: nothing is claimed of the law"
            return RecordedScenario(reach=reach)
        if count > len(rows):
            end_s = find_end_s(trace, scenario, len(rows))
            scenario = replace(scenario, max_duration_s=end_s)
        if scenario.law.kind not in LAWS:
            # Called once: a law that counts its calls may start alike after each run of one length.
            next((tick for tick in iterate_ticks(scenario, one_by_one=True) if tick.computed), None)
        again = simulate_run(scenario)
    except SimulationError as err:
        return RecordedScenario(reach=f"the recorded scenario cannot be simulated again: {err}")
    resimulation = compare_samples(trace, again)
    error = max(astuple(resimulation.max_abs_error))
    if error >= CLOSE or resimulation.max_command_error >= CLOSE_COMMAND:
        return RecordedScenario(reach=NOT_DETERMINISTIC)
    rounding = " to rounding, not bit for bit" if error or resimulation.max_command_error else ""
    return RecordedScenario(
        scenario=scenario,
        run=again,
        resimulation=resimulation,
        reach=f"the recorded scenario reproduces all {len(trace)} samples{rounding}",
    )


def describe_departure(trace: Trace, equal: int) -> str:
    """Return how many samples a re-simulation reproduces, fewer than all, and where it departs."""
    row = int(np.searchsorted(trace.number, equal))
    at_s = float(trace.time_ns[row] - trace.run.start_ns) / 1e9
    return f"reproduces the first {row:,} samples and departs at {at_s:.3f} s"


def describe_difference(trace: Trace, fits: "Fits", resimulation: Resimulation) -> list[str]:
    """Return how the re-simulation differs from the log, in at most one sentence."""
    if fits.is_exact:
        return []
    if fits.is_close:
        return ["the re-simulation agrees to rounding, not bit for bit"]
    if resimulation.is_exact:
        return ["poses and commands are reproduced, but not the times at which they were answered"]
    way = f"reproduces all {len(trace)} samples and goes on"
    if np.searchsorted(trace.number, fits.reproduced) < len(trace):
        way = describe_departure(trace, fits.reproduced)
    reach = f"the re-simulation {way}"
    if not fits.is_fitted:
        return [
            f"{reach}: no setting explains the motion: an effect that does not show in a log, such"
            " as loss, jitter or a disturbance, or commands that the log does not contain"
        ]
    noise = fits.drive.noise if fits.drive else (0.0, 0.0, 0.0)
    left = f"{max(noise[:2]):.2g} m and {np.degrees(noise[2]):.2g} deg"
    return [f"{reach}; driven with the log's own commands the plant leaves {left} of noise"]
