"""A recorded robot beside a simulated one that its commands drive, anchored anew again and again.

What is simulated is the robot of a scenario: its plant, disturbance and sensing. The rates of such
a robot follow from the commands, and it moves in the same way wherever it stands; so a simulation
from the first command on, moved to the recorded pose at an anchor, is one that begins there and
knows all earlier commands.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.angles import subtract_headings
from turtlelog.compare.robot_comparison import (
    SEEDS,
    ErrorBand,
    ErrorGrowth,
    Quantity,
    RobotComparison,
)
from turtlelog.display import describe_count
from turtlelog.errors import CompareError
from turtlelog.identify.axis_motion import (
    AXES,
    NAMES,
    Axis,
    AxisMotion,
    get_commands,
    measure_steps,
    read_axis_motion,
)
from turtlelog.identify.motion_prediction import AxisTraces, join_rates
from turtlelog.replay.lagged_drive import sense_driven
from turtlelog.run import CommandColumns, PoseColumns, Run
from turtlelog.run.columns import take_rows
from turtlelog.scenario import Scenario

Values = NDArray[np.float64]
Rows = NDArray[np.int64]

HORIZONS_S: Final = (1.0, 5.0)
"""For how long a motion is predicted before it is anchored anew [s]."""

LONGEST_S: Final = 600.0
"""How much of a run is simulated [s]: 120 pieces of 5 s, in about 12 s of computing."""

_FIRST_SEED: Final = 2**32
"""The first seed: a recording that was simulated with a seed of its own is none of the others."""

_NEAR: Final = 0.1
"""Share of the horizon within which a pose must lie to end a piece: errors grow by as much."""

_FADED: Final = 1e-3
"""Share of an earlier rate that is left when it counts no more."""

_STANDING: Final = 0.02
"""Mean rate, as a share of the largest command, below which a robot stands."""

_LOOK_S: Final = 0.3
"""For how long a robot must be seen to stand before its first command [s]."""

_JUMP_RATE: Final = 2.0
"""A jump goes further than so many times what the largest command leads to in the time."""

_JUMP_NOISE: Final = 12.0
"""And further than so many standard deviations of the steps between poses: normal noise never."""

_GRAIN: Final = 1e-6
"""And by what 32 bits cannot tell [m] or [rad]: a robot without noise does not jump."""

_BEFORE_S: Final = 60.0
"""Of the commands longer before the first pose the last one is simulated alone [s]."""

_HALF: Final = 0.5

_NORMAL_MAD: Final = 1.4826
"""Standard deviation by median magnitude of normal noise."""

_MOST_GROWTH: Final = 20
"""Points of the curve of errors over time."""

_MOST_NAMED: Final = 5
"""Jumps and stops that are named one by one."""

_QUANTITIES: Final[tuple[Quantity, Quantity]] = ("position", "heading")
_CENTRAL: Final = (0.025, 0.5, 0.975)


def compare_robot(
    run: Run, scenario: Scenario, horizons_s: Sequence[float] = HORIZONS_S
) -> RobotComparison:
    """Return how far a simulated robot is from a recorded one, driven with the same commands.

    The simulation begins anew at the recorded pose after each horizon, and knows the commands from
    before. Where the scenario has noise it is repeated over seeds: whether the recorded errors lie
    among the simulated ones tells whether that noise is right. Use a run that the scenario was not
    fitted to. Of a recording that holds sensed poses these are used.

    Args:
        run: With commands; its poses may be irregular, and some may be missing.
        scenario: With the plant `lagged`; its law, goal, start and limits play no part.
        horizons_s: After which times the simulation begins anew [s].

    Raises:
        CompareError: Where the scenario is of another plant, or nothing can be predicted.
        SimulationError: Where the simulated robot runs away.
    """
    _require_sense(run, scenario, horizons_s)
    zero_ns = run.start_ns
    run, notes = _take_part(run)
    motions = {axis: read_axis_motion(run, axis) for axis in AXES}
    recorded, commands = run.poses, _list_commands(run, motions, scenario)
    start_ns = min(int(recorded.time_ns[0]), int(commands.time_ns[0]))
    commands = replace(commands, time_ns=commands.time_ns - start_ns)
    times_ns = recorded.time_ns - start_ns
    states = sense_driven(_silence(scenario), commands, times_ns)
    simulated = _build_poses(recorded.time_ns, states)
    known_ns = _find_known(run, scenario)
    jumps = _find_jumps(run, simulated, scenario)
    cuts = {}
    for horizon_s in horizons_s:
        cut, gaps = _cut(recorded.time_ns, round(horizon_s * 1e9), known_ns)
        sound, lost = _drop_jumps(cut, jumps)
        notes += _tell_lost(horizon_s, gaps, lost)
        if sound.shape[1]:
            cuts[horizon_s] = sound
    if not cuts:
        raise CompareError(_tell_too_short(run, horizons_s, known_ns, len(jumps)))
    longest = cuts[max(cuts)]
    grown = _list_growth_rows(recorded.time_ns, longest, max(cuts))
    rows = np.unique(np.concatenate([grown.ravel(), *(cut.ravel() for cut in cuts.values())]))
    worlds = np.array(
        [
            sense_driven(replace(scenario, seed=_FIRST_SEED + seed), commands, times_ns[rows])
            for seed in range(SEEDS if _is_random(scenario) else 0)
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
        growth=stack.measure_growth(grown),
        recorded=recorded,
        simulated=simulated,
        begins=longest[0],
        ends=longest[1],
        traces=tuple(_trace(axis, motions[axis], recorded, simulated) for axis in AXES),
        start_s=zero_ns / 1e9,
        notes=(
            *notes,
            *_tell_start(run, zero_ns, known_ns),
            *_tell_jumps(run, zero_ns, jumps),
            *_tell_motion(run, motions),
        ),
    )


class _Stack:
    """The recorded states, those without noise, and those of each seed at some rows."""

    def __init__(
        self, recorded: PoseColumns, predicted: Values, rows: Rows, worlds: Values
    ) -> None:
        self._time_ns, self._rows, self._worlds = recorded.time_ns, rows, worlds
        self._recorded = _stack_states(recorded)
        self._predicted = predicted

    def _measure(self, cut: Rows) -> tuple[Values, Values | None]:
        """Return recorded errors, shape (2, n), and those of each seed, shape (seeds, 2, n)."""
        recorded = _measure_errors(self._recorded[cut], self._predicted[cut])
        if not len(self._worlds):
            return recorded, None
        found = self._worlds[:, np.searchsorted(self._rows, cut)]
        return recorded, np.array([_measure_errors(one, self._predicted[cut]) for one in found])

    def measure_bands(self, horizon_s: float, cut: Rows, start_ns: int) -> list[ErrorBand]:
        """Return the errors at the ends of pieces, of position and of heading."""
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

    def measure_growth(self, grown: Rows) -> tuple[ErrorGrowth, ErrorGrowth]:
        """Return how errors grow from the first row of each piece on, shape (pieces, points)."""
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


def _measure_errors(actual: Values, predicted: Values) -> Values:
    """Return distance [m] and turn [rad] between ends, the predicted pieces moved to the begins.

    Args:
        actual: States at begins and ends of pieces, shape (2, n, 3).
        predicted: Likewise.

    Returns:
        Shape (2, n).
    """
    turn_rad = actual[0, :, 2] - predicted[0, :, 2]
    cosine, sine = np.cos(turn_rad), np.sin(turn_rad)
    ahead_m, aside_m = (predicted[1, :, :2] - predicted[0, :, :2]).T
    moved_m = actual[1, :, :2] - actual[0, :, :2]
    off_m = np.hypot(
        moved_m[:, 0] - (cosine * ahead_m - sine * aside_m),
        moved_m[:, 1] - (sine * ahead_m + cosine * aside_m),
    )
    turned_rad = subtract_headings(actual[1, :, 2], actual[0, :, 2])
    expected_rad = subtract_headings(predicted[1, :, 2], predicted[0, :, 2])
    return np.array([off_m, np.abs(subtract_headings(turned_rad, expected_rad))])


def _require_sense(run: Run, scenario: Scenario, horizons_s: Sequence[float]) -> None:
    if scenario.plant.kind != "lagged":
        raise CompareError(
            f'{scenario.name}: expected a scenario of a robot, with plant.kind = "lagged", found'
            f" {scenario.plant.kind}"
        )
    if not horizons_s or not all(math.isfinite(one) and one > 0.0 for one in horizons_s):
        raise CompareError(
            f"horizons_s: expected times above 0 s, found {[*map(float, horizons_s)]}"
        )
    if not len(run.commands):
        raise CompareError(
            f"{run.name}: expected commands to drive the simulated robot with, found none"
        )


def _take_part(run: Run) -> tuple[Run, list[str]]:
    """Return what is simulated of a run, its poses as they were sensed, and what that leaves."""
    poses, notes = run.poses, []
    until_ns = poses.time_ns[0] + round(LONGEST_S * 1e9)
    kept = ~poses.dropped_out & (poses.time_ns <= until_ns)
    if not kept.any():
        raise CompareError(f"{run.name}: expected poses that were sensed, found none")
    if poses.time_ns[-1] > until_ns:
        whole_s = (poses.time_ns[-1] - poses.time_ns[0]) / 1e9
        notes = [f"The first {LONGEST_S:g} s of {whole_s:.0f} s are compared."]
    sensed = PoseColumns(
        time_ns=poses.time_ns[kept],
        xy_m=poses.read_xy_m[kept],
        heading_rad=poses.read_heading_rad[kept],
    )
    none = take_rows(run.samples, slice(0, 0))
    return replace(run, poses=sensed, samples=none), notes


def _list_commands(
    run: Run, motions: Mapping[Axis, AxisMotion], scenario: Scenario
) -> CommandColumns:
    """Return the commands while poses are recorded, with a 0 where the robot stops by itself."""
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
        for stop in motions[axis].stops:
            # It is down to half by then, and the simulated robot takes its own time to get there.
            earlier_s = _find_delay(scenario, axis, _HALF)
            stop_ns = round(max(stop.stop_s - earlier_s, stop.begin_s) * 1e9)
            row = int(np.searchsorted(time_ns, stop_ns, side="right"))
            if not row:
                continue
            time_ns = np.insert(time_ns, row, stop_ns)
            held = {name: np.insert(value, row, value[row - 1]) for name, value in held.items()}
            held[axis][row:][time_ns[row:] < round(stop.end_s * 1e9)] = 0.0
    commands = CommandColumns(
        time_ns=time_ns,
        speed_m_s=held["speed"],
        lateral_speed_m_s=np.zeros(len(time_ns)),
        turn_rate_rad_s=held["turn_rate"],
    )
    return commands if _counts_commands(scenario) else _drop_repeated(commands)


def _counts_commands(scenario: Scenario) -> bool:
    """Return whether a command that repeats the one before may act: by chance, or in a queue."""
    loop = scenario.loop
    return loop.queue_policy != "newest" or loop != _silence(scenario).loop


def _drop_repeated(commands: CommandColumns) -> CommandColumns:
    """Return commands without those that repeat the one before, which only take time."""
    changes = np.diff(commands.speed_m_s) != 0.0
    changes |= np.diff(commands.turn_rate_rad_s) != 0.0
    return take_rows(commands, np.concatenate([[True], changes]))


def _find_delay(scenario: Scenario, axis: Axis, left: float) -> float:
    """Return after what time a share of an earlier rate is left [s]."""
    plant, loop = scenario.plant, scenario.loop
    dead_time_s, lag_s = (
        (plant.speed_dead_time_s, plant.speed_lag_s)
        if axis == "speed"
        else (plant.turn_dead_time_s, plant.turn_lag_s)
    )
    transport_s = loop.transport_delay_s + loop.transport_delay_ticks * plant.facts.period_s
    return transport_s + (dead_time_s or 0.0) - math.log(left) * (lag_s or 0.0)


def _silence(scenario: Scenario) -> Scenario:
    """Return a scenario without what is random."""
    loop = replace(
        scenario.loop,
        jitter_s=0.0,
        loss_probability=0.0,
        repeat_probability=0.0,
        late_probability=0.0,
    )
    return replace(
        scenario,
        loop=loop,
        disturbance=replace(scenario.disturbance, noise_speed=0.0, noise_turn_rate=0.0),
        sensing=replace(
            scenario.sensing,
            noise_position_m=0.0,
            noise_heading_rad=0.0,
            outlier_probability=0.0,
            dropout_probability=0.0,
        ),
    )


def _is_random(scenario: Scenario) -> bool:
    """Return whether simulations of a scenario differ by their seeds; dropout is not simulated."""
    sensing = replace(scenario.sensing, dropout_probability=0.0)
    return replace(scenario, sensing=sensing) != _silence(scenario)


def _build_poses(time_ns: Rows, states: Values) -> PoseColumns:
    return PoseColumns(time_ns=time_ns, xy_m=states[:, :2], heading_rad=states[:, 2])


def _find_known(run: Run, scenario: Scenario) -> int:
    """Return from when on the rates follow from recorded commands [ns].

    A robot that stands until its first command is known from the beginning.
    """
    poses, first_ns = run.poses, int(run.commands.time_ns[0])
    earlier = poses.time_ns <= first_ns
    seen_s = (poses.time_ns[earlier][-1] - poses.time_ns[0]) / 1e9 if earlier.any() else 0.0
    if seen_s >= _LOOK_S and all(_stands(run, axis, earlier, seen_s) for axis in AXES):
        return int(poses.time_ns[0])
    return first_ns + round(max(_find_delay(scenario, axis, _FADED) for axis in AXES) * 1e9)


def _stands(run: Run, axis: Axis, earlier: NDArray[np.bool_], seen_s: float) -> bool:
    """Return whether a robot stands meanwhile, or an axis is never commanded."""
    largest = float(np.abs(get_commands(run, axis)).max())
    poses = run.poses
    if axis == "speed":
        moved = float(np.hypot(*(poses.xy_m[earlier][-1] - poses.xy_m[0])))
    else:
        moved = abs(float(subtract_headings(poses.heading_rad[earlier][-1], poses.heading_rad[0])))
    return not largest or moved <= _STANDING * largest * seen_s


def _cut(time_ns: Rows, horizon_ns: int, known_ns: int) -> tuple[Rows, int]:
    """Return the rows at which pieces begin and end, shape (2, n), and how many gaps are between.

    Each piece begins where the one before it ends.
    """
    row, gaps = int(np.searchsorted(time_ns, known_ns)), 0
    begins, ends = [], []
    near_ns, last = round(_NEAR * horizon_ns), len(time_ns) - 1
    while row < last and time_ns[last] - time_ns[row] >= horizon_ns - near_ns:
        wanted_ns = int(time_ns[row]) + horizon_ns
        after = min(int(np.searchsorted(time_ns, wanted_ns)), last)
        end = (
            after - 1 if wanted_ns - time_ns[after - 1] < abs(time_ns[after] - wanted_ns) else after
        )
        if end > row and abs(int(time_ns[end]) - wanted_ns) <= near_ns:
            begins.append(row)
            ends.append(end)
            row = end
        else:
            gaps += 1
            row = after if after > row else row + 1
    return np.array([begins, ends], dtype=np.int64).reshape(2, -1), gaps


def _list_growth_rows(time_ns: Rows, cut: Rows, horizon_s: float) -> Rows:
    """Return the rows at equal times after each begin, shape (pieces, points)."""
    usual_s = float(np.median(np.diff(time_ns))) / 1e9
    points = max(min(_MOST_GROWTH, int(horizon_s / (2.0 * usual_s))), 1)
    share = np.arange(points + 1) / points
    wanted_ns = time_ns[cut[0]][:, None] + np.rint(share * horizon_s * 1e9).astype(np.int64)
    after = np.clip(np.searchsorted(time_ns, wanted_ns), 1, len(time_ns) - 1)
    is_before = wanted_ns - time_ns[after - 1] < time_ns[after] - wanted_ns
    rows = np.clip(after - is_before, cut[0][:, None], cut[1][:, None])
    rows[:, 0] = cut[0]
    return np.asarray(rows)


def _find_jumps(run: Run, simulated: PoseColumns, scenario: Scenario) -> Rows:
    """Return the rows of poses to which no robot can have come from the pose before."""
    poses = run.poses
    if len(poses) < 2:
        return np.zeros(0, dtype=np.int64)
    time_ns = poses.time_ns
    rows = np.arange(len(poses))
    cut = np.array([rows[:-1], rows[1:]])
    errors = _measure_errors(*(_stack_states(one)[cut] for one in (poses, simulated)))
    apart_s = np.diff(time_ns) / 1e9
    apart_s = np.maximum(apart_s, np.median(apart_s))
    gains = scenario.plant.speed_gain, scenario.plant.turn_gain
    jumps = np.zeros(len(errors[0]), dtype=bool)
    for error, axis, gain in zip(errors, AXES, gains, strict=True):
        most = abs(1.0 if gain is None else gain) * float(np.abs(get_commands(run, axis)).max())
        noise = _NORMAL_MAD * float(np.median(error))
        jumps |= error > _JUMP_RATE * most * apart_s + _JUMP_NOISE * noise + _GRAIN
    return np.flatnonzero(jumps) + 1


def _stack_states(poses: PoseColumns) -> Values:
    return np.column_stack([poses.xy_m, poses.heading_rad])


def _drop_jumps(cut: Rows, jumps: Rows) -> tuple[Rows, int]:
    """Return the pieces without a jump in them, and how many have one."""
    inside = np.searchsorted(jumps, cut[1], side="right") - np.searchsorted(
        jumps, cut[0], side="right"
    )
    return cut[:, inside == 0], int(np.count_nonzero(inside))


def _trace(
    axis: Axis, motion: AxisMotion, recorded: PoseColumns, simulated: PoseColumns
) -> AxisTraces:
    time_s, measured, _ = measure_steps(recorded, axis)
    _, modelled, _ = measure_steps(simulated, axis)
    return join_rates(axis, motion, time_s, measured, modelled)


def _tell_lost(horizon_s: float, gaps: int, jumped: int) -> list[str]:
    told = []
    if gaps:
        many = describe_count(gaps, "gap")
        told.append(f"After {horizon_s:g} s: {many} of the poses, over which nothing is predicted.")
    if jumped:
        many = describe_count(jumped, "outlier")
        told.append(f"After {horizon_s:g} s: {many}, as the poses jump meanwhile; not counted.")
    return told


def _tell_too_short(run: Run, horizons_s: Sequence[float], known_ns: int, jumps: int) -> str:
    left_s = max((int(run.poses.time_ns[-1]) - known_ns) / 1e9, 0.0)
    extra = f" with {describe_count(jumps, 'jump')}" if jumps else ""
    return (
        f"{run.name}: expected at least {min(horizons_s):g} s of poses to predict, without gaps and"
        f" jumps, after the robot's rates are known, found {left_s:.3g} s{extra}"
    )


def _tell_start(run: Run, start_ns: int, known_ns: int) -> list[str]:
    first_ns = int(run.poses.time_ns[0])
    if known_ns <= first_ns:
        return []
    return [
        f"Predictions begin at {(known_ns - start_ns) / 1e9:.3g} s: what was commanded before the"
        " first recorded command is not known."
    ]


def _tell_jumps(run: Run, start_ns: int, jumps: Rows) -> list[str]:
    poses, told = run.poses, []
    for row in jumps[:_MOST_NAMED].tolist():
        moved_m = float(np.hypot(*(poses.xy_m[row] - poses.xy_m[row - 1])))
        turned_rad = float(subtract_headings(poses.heading_rad[row], poses.heading_rad[row - 1]))
        told.append(
            f"Jump: the pose at {(poses.time_ns[row] - start_ns) / 1e9:.3f} s lies {moved_m:.3g} m"
            f" and {np.degrees(turned_rad):.3g} deg from the one before."
        )
    more = len(jumps) - len(told)
    return [*told, f"And {describe_count(more, 'jump')} more."] if more else told


def _tell_motion(run: Run, motions: Mapping[Axis, AxisMotion]) -> list[str]:
    told = []
    for axis, motion in motions.items():
        if motion.stops:
            many = describe_count(len(motion.stops), "time")
            told.append(
                f"The {NAMES[axis]} stops by itself where no command comes, {many}; the simulated"
                " robot is stopped then."
            )
    aside = float(np.abs(run.commands.lateral_speed_m_s).max())
    if aside:
        told.append(f"Commands sideways, up to {aside:.3g} m/s, are left out: the plant has none.")
    return told
