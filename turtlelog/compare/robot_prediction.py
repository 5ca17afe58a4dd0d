"""Comparison of a recorded robot with a simulated one that repeats its commands from many anchors.

The simulation includes the plant, disturbance and sensing of a scenario. The rates of the robot
follow from the commands and do not depend on the pose. Therefore one simulation from the first
command on is enough: moved to the recorded pose at an anchor, it equals a simulation that begins
there with all earlier commands.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.compare import robot_comparison, trajectory_errors
from turtlelog.compare.robot_comparison import (
    ErrorBand,
    ErrorGrowth,
    NoiseLevel,
    Quantity,
    RobotComparison,
)
from turtlelog.display import describe_count
from turtlelog.errors import CompareError
from turtlelog.identify import AxisTraces, axis_motion
from turtlelog.identify.axis_model import join_rates
from turtlelog.identify.axis_motion import AXES, Axis, AxisMotion, get_commands
from turtlelog.identify.robot_noise import NORMAL_MAD, find_short_runs
from turtlelog.identify.silent_stops import LOOK_S
from turtlelog.measure.reductions import Rows, Values
from turtlelog.replay.plant_replay import sense_driven
from turtlelog.run import CommandColumns, PoseColumns, Run
from turtlelog.run.angles import subtract_headings
from turtlelog.run.columns import take_rows
from turtlelog.run.loops import PLANT_KEYS, read_number
from turtlelog.scenario import Scenario, flatten_scenario, override_scenario
from turtlelog.simulate.loop_parts import RANDOM_KEYS, list_streams

HORIZONS_S: Final = (1.0, 5.0)
"""Times for which a motion is predicted before the next anchor [s]."""

_SHORTEST_S: Final = 0.1
"""Time after which the error of a robot model is still small compared with noise [s]."""

LONGEST_S: Final = 600.0
"""Longest simulated part of a run [s]: 120 pieces of 5 s."""

MOST_TICKS: Final = 30_000
"""Largest number of simulated plant periods: 600 s at 50 Hz, for which 39 seeds take 20 s."""

_FIRST_SEED: Final = 2**32
"""First seed: a recording simulated with a seed of its own differs from all other seeds."""

_MOST_NAMED: Final = 5
"""Largest number of jumps and stops that are named one by one."""

_MOVED: Final = 1e-9
"""Smallest motion between two poses of a moving robot [m] or [rad]; rounding alone moves a robot as
far."""

_QUANTITIES: Final[tuple[Quantity, Quantity]] = ("position", "heading")
_CENTRAL: Final = (0.025, 0.5, 0.975)


def compare_robot(
    run: Run, scenario: Scenario, horizons_s: Sequence[float] = HORIZONS_S
) -> RobotComparison:
    """Return the deviation of a simulated robot from a recorded one, driven by the same commands.

    After each horizon, the simulation is moved to the recorded pose; all earlier commands still
    act. If the scenario has noise, the simulation is repeated over seeds: the noise is right if
    recorded and simulated errors have the same distribution. Use a run to which the scenario was
    not fitted. Sensed poses are used if they are recorded.

    Args:
        run: Run with commands; poses may be irregular or missing.
        scenario: Scenario with the plant `lagged`; its law, goal, start and limits are not used.
        horizons_s: Times after which the simulation is anchored again [s].

    Raises:
        CompareError: If the scenario has another plant, or nothing can be predicted.
        SimulationError: If the simulated robot diverges.
    """
    _require_sense(run, scenario, horizons_s)
    zero_ns = run.start_ns
    run, notes = _take_part(run, scenario)
    motions = {axis: axis_motion.read_axis_motion(run, axis) for axis in AXES}
    recorded, commands = run.poses, _list_commands(run, motions, scenario)
    start_ns = min(int(recorded.time_ns[0]), int(commands.time_ns[0]))
    commands = replace(commands, time_ns=commands.time_ns - start_ns)
    times_ns = recorded.time_ns - start_ns
    states = sense_driven(_silence(scenario), commands, times_ns)
    simulated = replace(recorded, xy_m=states[:, :2], heading_rad=states[:, 2])
    known_ns = _find_known(run, scenario)
    jumps = _find_impossible_steps(run, simulated, scenario)
    cut = partial(robot_comparison.cut_pieces, recorded.time_ns, known_ns, jumps)
    found = {horizon_s: cut(horizon_s) for horizon_s in horizons_s}
    cuts = {horizon_s: sound for horizon_s, (sound, _, _) in found.items() if sound.shape[1]}
    if not cuts:
        raise CompareError(_tell_too_short(run, horizons_s, known_ns, len(jumps)))
    longest = cuts[max(cuts)]
    short_s = max(_SHORTEST_S, float(np.median(np.diff(recorded.time_ns))) / 1e9)
    short, _, _ = cut(short_s)
    grown = robot_comparison.list_growth_rows(recorded.time_ns, longest, max(cuts))
    rows = np.unique(np.concatenate([one.ravel() for one in (grown, short, *cuts.values())]))
    # Here sensed poses are never lost or late, so these random effects do nothing.
    is_random = bool(list_streams(scenario) - {"dropout_lose_pose", "jitter_pose_travel"})
    worlds = np.array(
        [
            sense_driven(replace(scenario, seed=_FIRST_SEED + seed), commands, times_ns[rows])
            for seed in range(robot_comparison.SEEDS if is_random else 0)
        ]
    )
    stack = _Stack(recorded, states, rows, worlds)
    return RobotComparison(
        name=run.name,
        scenario=scenario.name,
        seeds=len(worlds),
        clock=run.clock,
        bands=tuple(
            band
            for horizon_s, cut in cuts.items()
            for band in stack.measure_bands(horizon_s, cut, zero_ns)
        ),
        noise=stack.compare_noise(short_s, short, cuts[min(cuts)]),
        growth=stack.measure_growth(grown),
        recorded=recorded,
        simulated=simulated,
        begins=longest[0],
        ends=longest[1],
        traces=tuple(_trace_axis(axis, motions[axis], recorded, simulated) for axis in AXES),
        start_s=zero_ns / 1e9,
        notes=(*notes, *_list_cuts(found), *_list_notes(run, motions, zero_ns, known_ns, jumps)),
    )


def _trace_axis(
    axis: Axis, motion: AxisMotion, recorded: PoseColumns, simulated: PoseColumns
) -> AxisTraces:
    time_s, measured, _ = axis_motion.measure_axis_steps(recorded, axis)
    _, modelled, _ = axis_motion.measure_axis_steps(simulated, axis)
    return join_rates(axis, motion, time_s, measured, modelled)


def _list_cuts(found: Mapping[float, tuple[Rows, int, int]]) -> Iterator[str]:
    """Yield what is not predicted after each horizon."""
    for horizon_s, (sound, gaps, lost) in found.items():
        after = f"After {horizon_s:g} s:"
        if gaps:
            many = describe_count(gaps, "gap")
            yield f"{after} {many} of the poses, over which nothing is predicted."
        if lost:
            outliers = describe_count(lost, "outlier")
            yield f"{after} {outliers}, as the poses jump meanwhile; not counted."
        if not sound.shape[1]:
            yield f"No piece of {horizon_s:g} s is left to predict."


class _Stack:
    """The recorded states, the states without noise, and the states of each seed at given rows."""

    def __init__(
        self, recorded: PoseColumns, predicted: Values, rows: Rows, worlds: Values
    ) -> None:
        self._time_ns, self._rows, self._worlds = recorded.time_ns, rows, worlds
        self._recorded = trajectory_errors.stack_states(recorded)
        self._predicted = predicted

    def _measure(self, cut: Rows) -> tuple[Values, Values | None]:
        """Return the recorded errors, shape (2, n), and those of each seed, shape (seeds, 2, n)."""
        predicted, measure = self._predicted[cut], trajectory_errors.measure_piece_errors
        recorded = measure(self._recorded[cut], predicted)
        if not len(self._worlds):
            return recorded, None
        worlds = self._worlds[:, np.searchsorted(self._rows, cut)]
        return recorded, np.array([measure(one, predicted) for one in worlds])

    def measure_bands(self, horizon_s: float, cut: Rows, start_ns: int) -> list[ErrorBand]:
        """Return the errors of position and heading at the ends of pieces."""
        recorded, simulated = self._measure(cut)
        time_s = (self._time_ns[cut[1]] - start_ns) / 1e9
        bands = []
        for number, quantity in enumerate(_QUANTITIES):
            band = ErrorBand(
                quantity=quantity, horizon_s=horizon_s, time_s=time_s, recorded=recorded[number]
            )
            if simulated is not None and simulated[:, number].any():
                errors = simulated[:, number]
                band = replace(
                    band,
                    simulated=np.median(errors, axis=0),
                    low=errors.min(axis=0),
                    high=errors.max(axis=0),
                )
            bands.append(band)
        return bands

    def compare_noise(self, after_s: float, short: Rows, long: Rows) -> tuple[NoiseLevel, ...]:
        """Return the noise of position and heading, from pieces in which the robot moves."""
        found = []
        for cut in (short, long):
            moved = np.abs(self._predicted[cut[1]] - self._predicted[cut[0]]).max(axis=1) > _MOVED
            found.append(self._measure(cut[:, moved]))
        (recorded, simulated), (later, simulated_later) = found
        if simulated is None or simulated_later is None:
            return ()
        levels = (
            robot_comparison.compare_noise(
                quantity,
                after_s,
                (recorded[number], simulated[:, number]),
                (later[number], simulated_later[:, number]),
            )
            for number, quantity in enumerate(_QUANTITIES)
        )
        return tuple(level for level in levels if level is not None)

    def measure_growth(self, grown: Rows) -> tuple[ErrorGrowth, ErrorGrowth]:
        """Return the growth of errors from the first row of each piece, shape (pieces, points)."""
        begins = np.broadcast_to(grown[:, :1], grown.shape)
        since_s = (self._time_ns[grown] - self._time_ns[begins]).mean(axis=0) / 1e9
        recorded, simulated = self._measure(np.array([begins.ravel(), grown.ravel()]))

        def spread(errors: Values) -> Values:
            by_point = errors.reshape(-1, grown.shape[1])
            return np.asarray(np.quantile(by_point, _CENTRAL, axis=0).T)

        position, heading = (
            ErrorGrowth(
                quantity=quantity,
                since_s=since_s,
                recorded=spread(recorded[number]),
                simulated=None
                if simulated is None or not simulated[:, number].any()
                else spread(simulated[:, number]),
            )
            for number, quantity in enumerate(_QUANTITIES)
        )
        return position, heading


def _require_sense(run: Run, scenario: Scenario, horizons_s: Sequence[float]) -> None:
    if scenario.plant.facts.dynamics != "first-order":
        expected = 'expected a scenario of a robot, with plant.kind = "lagged"'
        raise CompareError(f"{scenario.name}: {expected}, found {scenario.plant.kind}")
    if not horizons_s or not all(math.isfinite(one) and one > 0.0 for one in horizons_s):
        found = [*map(float, horizons_s)]
        raise CompareError(f"horizons_s: expected times above 0 s, found {found}")
    if not len(run.poses):
        raise CompareError(f"{run.name}: the recording holds no poses, which are compared")
    if not len(run.commands):
        raise CompareError(f"{run.name}: no commands to drive the simulated robot with")


def _take_part(run: Run, scenario: Scenario) -> tuple[Run, list[str]]:
    """Return the comparable part of a run with sensed poses, and the time segments left out."""
    poses, notes = run.poses, []
    longest_s = min(LONGEST_S, MOST_TICKS * scenario.plant.facts.period_s)
    until_ns = poses.time_ns[0] + round(longest_s * 1e9)
    kept = ~poses.dropped_out & (poses.time_ns <= until_ns)
    if not kept.any():
        raise CompareError(f"{run.name}: no poses that were sensed")
    if poses.time_ns[-1] > until_ns:
        whole_s = (poses.time_ns[-1] - poses.time_ns[0]) / 1e9
        notes = [f"The first {longest_s:g} s of {whole_s:.0f} s are compared."]
    xy_m, heading_rad = poses.read_xy_m[kept], poses.read_heading_rad[kept]
    sensed = PoseColumns(time_ns=poses.time_ns[kept], xy_m=xy_m, heading_rad=heading_rad)
    none = take_rows(run.samples, slice(0, 0))
    return replace(run, poses=sensed, samples=none), notes


def _tell_too_short(run: Run, horizons_s: Sequence[float], known_ns: int, jumps: int) -> str:
    left_s = max((int(run.poses.time_ns[-1]) - known_ns) / 1e9, 0.0)
    extra = f" with {describe_count(jumps, 'jump')}" if jumps else ""
    return (
        f"{run.name}: expected at least {min(horizons_s):g} s of poses to predict, without gaps and"
        f" jumps, after the robot's rates are known, found {left_s:.3g} s{extra}"
    )


def _list_notes(
    run: Run, motions: Mapping[Axis, AxisMotion], start_ns: int, known_ns: int, jumps: Rows
) -> Iterator[str]:
    poses = run.poses
    if known_ns > poses.time_ns[0]:
        yield (
            f"Predictions begin at {(known_ns - start_ns) / 1e9:.3g} s: what was commanded before"
            " the first recorded command is not known."
        )
    for row in jumps[:_MOST_NAMED].tolist():
        moved_m = float(np.hypot(*(poses.xy_m[row] - poses.xy_m[row - 1])))
        turned_rad = float(subtract_headings(poses.heading_rad[row], poses.heading_rad[row - 1]))
        yield (
            f"Jump: the pose at {(poses.time_ns[row] - start_ns) / 1e9:.3f} s lies {moved_m:.3g} m"
            f" and {np.degrees(turned_rad):.3g} deg from the one before."
        )
    if len(jumps) > _MOST_NAMED:
        yield f"And {describe_count(len(jumps) - _MOST_NAMED, 'jump')} more."
    for axis, motion in motions.items():
        if motion.seen_stops:
            many = describe_count(len(motion.seen_stops), "time")
            yield (
                f"The {axis_motion.NAMES[axis]} stops by itself where no command comes, {many}; the"
                " simulated robot is stopped then."
            )
    aside = float(np.abs(run.commands.lateral_speed_m_s).max())
    if aside:
        yield f"Commands sideways, up to {aside:.3g} m/s, are left out: the plant has none."


_FADED: Final = 1e-3
"""Share of an earlier rate below which the rate no longer counts."""

_BEFORE_S: Final = 60.0
"""Time before the first pose; of earlier commands, only the last is simulated [s]."""

_HALF: Final = 0.5

_ROUNDING_NS: Final = 1000
"""Resolution of a double of seconds since 1970 [ns]: a silence ends before the next command."""

_JUMP_RATE: Final = 2.0
"""Size of a jump, as a multiple of the largest motion that a command can cause in the time."""

_JUMP_NOISE: Final = 12.0
"""Size of a jump, as a multiple of the standard deviation of the steps between poses: normal noise
never reaches it."""

_GRAIN: Final = 1e-6
"""Smallest size of a jump, the 32-bit resolution [m] or [rad]. Without this size, the rounding of a
robot without noise would be a jump."""


def _list_commands(
    run: Run, motions: Mapping[Axis, AxisMotion], scenario: Scenario
) -> CommandColumns:
    """Return the commands during the poses, with a 0 wherever the robot stops by itself."""
    first_ns, last_ns = int(run.poses.time_ns[0]), int(run.poses.time_ns[-1])
    columns = run.commands
    time_ns, speed, turn_rate = columns.time_ns, columns.speed_m_s, columns.turn_rate_rad_s
    if time_ns[0] >= last_ns:
        raise CompareError(
            f"{run.name}: expected commands while poses are recorded, found them from"
            f" {(time_ns[0] - last_ns) / 1e9:.3g} s after the last pose on"
        )
    begin_ns = first_ns - round(_BEFORE_S * 1e9)
    first = max(int(np.searchsorted(time_ns, begin_ns, side="right")) - 1, 0)
    after = int(np.searchsorted(time_ns, last_ns, side="right"))
    held = {"speed": speed[first:after].copy(), "turn_rate": turn_rate[first:after].copy()}
    time_ns = np.maximum(time_ns[first:after], begin_ns)
    for axis in AXES:
        for stop in motions[axis].seen_stops:
            # It is down to half by then, and the simulated robot takes its own time to get there.
            begun = max(int(np.searchsorted(time_ns, round(stop.begin_s * 1e9), "right")) - 1, 0)
            earlier_s = _find_delay(scenario, axis, float(held[axis][begun]), _HALF)
            stop_ns = round(max(stop.stop_s - earlier_s, stop.begin_s) * 1e9)
            row = int(np.searchsorted(time_ns, stop_ns, side="right"))
            if not row:
                continue
            time_ns = np.insert(time_ns, row, stop_ns)
            held = {name: np.insert(value, row, value[row - 1]) for name, value in held.items()}
            held[axis][row:][time_ns[row:] < round(stop.end_s * 1e9) - _ROUNDING_NS] = 0.0
    commands = CommandColumns(
        time_ns=time_ns,
        speed_m_s=held["speed"],
        lateral_speed_m_s=np.zeros(len(time_ns)),
        turn_rate_rad_s=held["turn_rate"],
    )
    loop = scenario.loop
    if loop.queue_policy != "newest" or loop != _silence(scenario).loop:
        return commands  # by chance or in a queue, a repeated command may have an effect
    changes = np.diff(held["speed"]) != 0.0
    changes |= np.diff(held["turn_rate"]) != 0.0
    return take_rows(commands, np.concatenate([[True], changes]))


def _find_known(run: Run, scenario: Scenario) -> int:
    """Return when rates begin to follow from recorded commands [ns]; if at rest, the beginning."""
    poses, first_ns = run.poses, int(run.commands.time_ns[0])
    earlier = poses.time_ns <= first_ns
    seen_s = (poses.time_ns[earlier][-1] - poses.time_ns[0]) / 1e9 if earlier.any() else 0.0
    if seen_s >= LOOK_S and all(_stands(run, axis, earlier, seen_s) for axis in AXES):
        return int(poses.time_ns[0])
    delays_s = [
        _find_delay(scenario, axis, float(np.abs(get_commands(run, axis)).max()), _FADED)
        for axis in AXES
    ]
    return first_ns + round(max(delays_s) * 1e9)


def _silence(scenario: Scenario) -> Scenario:
    """Return a scenario without its random effects."""
    return override_scenario(scenario, dict.fromkeys(RANDOM_KEYS, 0.0))


def _find_delay(scenario: Scenario, axis: Axis, command: float, left: float) -> float:
    """Return the time until the response to a command has decayed to a given fraction [s]."""
    values, loop = flatten_scenario(scenario), scenario.loop
    key = PLANT_KEYS[axis]
    transport_s: float = loop.transport_delay_s
    transport_s += loop.transport_delay_ticks * scenario.plant.facts.period_s
    lag_s = read_number(values, f"{key}lag_s")
    acceleration = read_number(values, f"{key}acceleration", math.inf)
    gains = [read_number(values, f"{key}{name}gain") for name in ("", "reverse_")]
    rate = max(map(abs, gains)) * abs(command)
    rate = min(rate, read_number(values, f"{key}bound", math.inf))
    fading_s, end = 0.0, left * rate
    if acceleration < math.inf:
        bend = min(max(acceleration * lag_s, end), rate)
        fading_s, rate = (rate - bend) / acceleration, bend
    if rate > end:
        fading_s += lag_s * math.log(rate / end)
    return transport_s + read_number(values, f"{key}dead_time_s") + fading_s


def _stands(run: Run, axis: Axis, earlier: NDArray[np.bool_], seen_s: float) -> bool:
    """Return whether a robot is at rest in a segment, or an axis is never commanded."""
    largest = float(np.abs(get_commands(run, axis)).max())
    poses = run.poses
    if axis == "speed":
        moved = float(np.hypot(*(poses.xy_m[earlier][-1] - poses.xy_m[0])))
    else:
        moved = abs(float(subtract_headings(poses.heading_rad[earlier][-1], poses.heading_rad[0])))
    return not largest or moved <= axis_motion.STANDING * largest * seen_s


def _find_impossible_steps(run: Run, simulated: PoseColumns, scenario: Scenario) -> Rows:
    """Return the rows of poses that no robot can have reached from the previous pose."""
    poses = run.poses
    if len(poses) < 2:
        return np.zeros(0, dtype=np.int64)
    steps = np.array([np.arange(len(poses) - 1), np.arange(1, len(poses))])
    states = (trajectory_errors.stack_states(one) for one in (poses, simulated))
    errors = trajectory_errors.measure_piece_errors(*(one[steps] for one in states))
    apart_s = np.diff(poses.time_ns) / 1e9
    apart_s = np.maximum(apart_s, np.median(apart_s))
    gains = scenario.plant.speed_gain, scenario.plant.turn_gain
    jumps = np.zeros(len(errors[0]), dtype=bool)
    for error, axis, gain in zip(errors, AXES, gains, strict=True):
        most = abs(1.0 if gain is None else gain) * float(np.abs(get_commands(run, axis)).max())
        noise = NORMAL_MAD * float(np.median(error))
        is_off = error > _JUMP_RATE * most * apart_s + _JUMP_NOISE * noise + _GRAIN
        # Steps that are off for long are a motion that the scenario lacks.
        jumps |= find_short_runs(is_off.astype(float))
    return np.flatnonzero(jumps) + 1
