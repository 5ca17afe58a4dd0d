"""Commands that drive a simulated robot instead of a recorded one, and segments of its run."""

import math
from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import CompareError
from turtlelog.identify.axis_motion import AXES, LOOK_S, STANDING, Axis, AxisMotion, get_commands
from turtlelog.identify.robot_noise import NORMAL_MAD
from turtlelog.run import CommandColumns, PoseColumns, Run
from turtlelog.run.angles import subtract_headings
from turtlelog.run.columns import take_rows
from turtlelog.run.loops import PLANT_KEYS, read_number
from turtlelog.scenario import Scenario, flatten_scenario, override_scenario
from turtlelog.simulate.loop_parts import RANDOM_KEYS, list_streams

_FADED: Final = 1e-3
"""Share of an earlier rate below which the rate no longer counts."""

_BEFORE_S: Final = 60.0
"""Time before the first pose; of earlier commands, only the last is simulated [s]."""

_HALF: Final = 0.5

_ROUNDING_NS: Final = 1000
"""Resolution of a double of seconds since 1970 [ns]: a silence ends before the next command."""


def list_commands(
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
        for stop in motions[axis].stops:
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
    if loop.queue_policy != "newest" or loop != silence(scenario).loop:
        return commands  # by chance or in a queue, a repeated command may have an effect
    changes = np.diff(held["speed"]) != 0.0
    changes |= np.diff(held["turn_rate"]) != 0.0
    return take_rows(commands, np.concatenate([[True], changes]))


def find_known(run: Run, scenario: Scenario) -> int:
    """Return the time from which the rates follow from recorded commands [ns].

    For a robot at rest until its first command, this is the beginning.
    """
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


def silence(scenario: Scenario) -> Scenario:
    """Return a scenario without its random effects."""
    return override_scenario(scenario, dict.fromkeys(RANDOM_KEYS, 0.0))


def is_random(scenario: Scenario) -> bool:
    """Return whether the sensed poses of a driven robot depend on the seed of its scenario.

    In the comparison, sensed poses are never lost or late.
    """
    return bool(list_streams(scenario) - {"dropout_lose_pose", "jitter_pose_travel"})


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
    return not largest or moved <= STANDING * largest * seen_s


Values = NDArray[np.float64]
Rows = NDArray[np.int64]

_NEAR: Final = 0.1
"""Share of the horizon within which a pose must lie to end a piece. Errors grow by the same
share."""

_SPARSE: Final = 0.25
"""The same share for sparse poses, of which the nearest may be further away."""

_HALF_STEP: Final = 0.55
"""Largest distance of the nearest pose, relative to the usual time between poses: half, plus
jitter."""

_JUMP_RATE: Final = 2.0
"""Size of a jump, as a multiple of the largest motion that a command can cause in the time."""

_JUMP_NOISE: Final = 12.0
"""Size of a jump, as a multiple of the standard deviation of the steps between poses: normal noise
never reaches it."""

_GRAIN: Final = 1e-6
"""Smallest size of a jump, the 32-bit resolution [m] or [rad]. Without this size, the rounding of a
robot without noise would be a jump."""

_MOST_GROWTH: Final = 20
"""Number of points of the curve of errors over time."""


def cut_pieces(time_ns: Rows, horizon_ns: int, known_ns: int) -> tuple[Rows, int]:
    """Return the first and last rows of pieces, shape (2, n), and the number of gaps between them.

    Each piece begins where the previous one ends.
    """
    row, gaps = int(np.searchsorted(time_ns, known_ns)), 0
    begins, ends = [], []
    last = len(time_ns) - 1
    apart_ns = float(np.median(np.diff(time_ns))) if last else 0.0
    near_ns = min(max(_NEAR * horizon_ns, _HALF_STEP * apart_ns), _SPARSE * horizon_ns)
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


def list_growth_rows(time_ns: Rows, cut: Rows, horizon_s: float) -> Rows:
    """Return rows at equal times after each beginning, shape (pieces, points)."""
    usual_s = float(np.median(np.diff(time_ns))) / 1e9
    points = max(min(_MOST_GROWTH, int(horizon_s / (2.0 * usual_s))), 1)
    share = np.arange(points + 1) / points
    wanted_ns = time_ns[cut[0]][:, None] + np.rint(share * horizon_s * 1e9).astype(np.int64)
    after = np.clip(np.searchsorted(time_ns, wanted_ns), 1, len(time_ns) - 1)
    is_before = wanted_ns - time_ns[after - 1] < time_ns[after] - wanted_ns
    rows = np.clip(after - is_before, cut[0][:, None], cut[1][:, None])
    rows[:, 0] = cut[0]
    return np.asarray(rows)


def drop_jumps(cut: Rows, jumps: Rows) -> tuple[Rows, int]:
    """Return the pieces without jumps, and the number of pieces with jumps."""
    inside = np.searchsorted(jumps, cut[1], side="right") - np.searchsorted(
        jumps, cut[0], side="right"
    )
    return cut[:, inside == 0], int(np.count_nonzero(inside))


def find_impossible_steps(run: Run, simulated: PoseColumns, scenario: Scenario) -> Rows:
    """Return the rows of poses that no robot can have reached from the previous pose."""
    poses = run.poses
    if len(poses) < 2:
        return np.zeros(0, dtype=np.int64)
    time_ns = poses.time_ns
    rows = np.arange(len(poses))
    cut = np.array([rows[:-1], rows[1:]])
    errors = measure_errors(*(stack_states(one)[cut] for one in (poses, simulated)))
    apart_s = np.diff(time_ns) / 1e9
    apart_s = np.maximum(apart_s, np.median(apart_s))
    gains = scenario.plant.speed_gain, scenario.plant.turn_gain
    jumps = np.zeros(len(errors[0]), dtype=bool)
    for error, axis, gain in zip(errors, AXES, gains, strict=True):
        most = abs(1.0 if gain is None else gain) * float(np.abs(get_commands(run, axis)).max())
        noise = NORMAL_MAD * float(np.median(error))
        jumps |= error > _JUMP_RATE * most * apart_s + _JUMP_NOISE * noise + _GRAIN
    return np.flatnonzero(jumps) + 1


def measure_errors(actual: Values, predicted: Values) -> Values:
    """Return the errors in distance [m] and turn [rad] at the end of each piece, shape (2, n).

    Both states have the shape (2, n, 3), for beginnings and ends of pieces. The predictions are
    moved so that they begin at the actual state.
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


def stack_states(poses: PoseColumns) -> Values:
    """Return x, y [m] and heading [rad] of poses, shape (n, 3)."""
    return np.column_stack([poses.xy_m, poses.heading_rad])
