"""The pieces of a run that are predicted one by one: where they begin and end, and their errors."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.identify.axis_motion import AXES, get_commands
from turtlelog.run import PoseColumns, Run
from turtlelog.run.angles import subtract_headings
from turtlelog.scenario import Scenario

Values = NDArray[np.float64]
Rows = NDArray[np.int64]

_NEAR: Final = 0.1
"""Share of the horizon within which a pose must lie to end a piece: errors grow by as much."""

_SPARSE: Final = 0.25
"""The same where poses are so far apart that the nearest may lie further off."""

_HALF_STEP: Final = 0.55
"""How far off the nearest pose may lie, by the usual time between poses: half, and some jitter."""

_JUMP_RATE: Final = 2.0
"""A jump goes further than so many times what the largest command leads to in the time."""

_JUMP_NOISE: Final = 12.0
"""And further than so many standard deviations of the steps between poses: normal noise never."""

_GRAIN: Final = 1e-6
"""And by what 32 bits cannot tell [m] or [rad]: a robot without noise does not jump."""

_NORMAL_MAD: Final = 1.4826
"""Standard deviation by median magnitude of normal noise."""

_MOST_GROWTH: Final = 20
"""Points of the curve of errors over time."""


def cut_pieces(time_ns: Rows, horizon_ns: int, known_ns: int) -> tuple[Rows, int]:
    """Return the rows at which pieces begin and end, shape (2, n), and how many gaps are between.

    Each piece begins where the one before it ends.
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


def drop_jumps(cut: Rows, jumps: Rows) -> tuple[Rows, int]:
    """Return the pieces without a jump in them, and how many have one."""
    inside = np.searchsorted(jumps, cut[1], side="right") - np.searchsorted(
        jumps, cut[0], side="right"
    )
    return cut[:, inside == 0], int(np.count_nonzero(inside))


def find_impossible_steps(run: Run, simulated: PoseColumns, scenario: Scenario) -> Rows:
    """Return the rows of poses to which no robot can have come from the pose before."""
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
        noise = _NORMAL_MAD * float(np.median(error))
        jumps |= error > _JUMP_RATE * most * apart_s + _JUMP_NOISE * noise + _GRAIN
    return np.flatnonzero(jumps) + 1


def measure_errors(actual: Values, predicted: Values) -> Values:
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


def stack_states(poses: PoseColumns) -> Values:
    """Return x, y [m] and heading [rad] of poses, shape (n, 3)."""
    return np.column_stack([poses.xy_m, poses.heading_rad])
