"""What a row of the compiled batch adds up or looks for along its poses and samples.

Sums are numpy's to the last bit: `add_up` adds in the order of `ndarray.sum`, by pairs of halves.
The compiled `hypot` is that of numpy, both the C library's.
"""

import math
from typing import Any

import numpy as np

from turtlelog.sweep.batch_functions import measure

_BLOCK = 128
_LANES = 8
"""As many values numpy adds in one go, in so many sums side by side."""


@measure
def _add_block(values: Any, first: int, count: int) -> float:
    if count < _LANES:
        total = 0.0
        for place in range(first, first + count):
            total += values[place]
        return total
    a, b, c, d = values[first], values[first + 1], values[first + 2], values[first + 3]
    e, f, g, h = values[first + 4], values[first + 5], values[first + 6], values[first + 7]
    whole = count - count % _LANES
    for place in range(first + _LANES, first + whole, _LANES):
        a += values[place]
        b += values[place + 1]
        c += values[place + 2]
        d += values[place + 3]
        e += values[place + 4]
        f += values[place + 5]
        g += values[place + 6]
        h += values[place + 7]
    total = ((a + b) + (c + d)) + ((e + f) + (g + h))
    for place in range(first + whole, first + count):
        total += values[place]
    return total  # type: ignore[no-any-return]


@measure
def _find_half(first: int, count: int, depth: int, path: int) -> tuple[int, int]:
    """Return where a half begins and its count; the bits of `path` tell which half of which."""
    for level in range(depth - 1, -1, -1):
        half = count // 2
        half -= half % _LANES
        if path >> level & 1:
            first, count = first + half, count - half
        else:
            count = half
    return first, count


@measure
def add_up(values: Any, first: int, count: int) -> float:
    """Return the sum of so many values from one on, in the order of numpy's `sum`.

    The sum of a left half is kept in the place of its first value, which is lost.
    """
    # Without recursion: what calls itself crashes when numba loads it from its cache on disk.
    depth = path = 0
    while True:
        begin, left = _find_half(first, count, depth, path)
        while left > _BLOCK:
            depth, path = depth + 1, path << 1
            begin, left = _find_half(first, count, depth, path)
        total = _add_block(values, begin, left)
        while path & 1:
            depth, path = depth - 1, path >> 1
            begin, _ = _find_half(first, count, depth, path)
            total = values[begin] + total
        if depth == 0:
            return total  # type: ignore[no-any-return]
        values[begin], path = total, path | 1


@measure
def tell_time(stretch: Any, row: int) -> float:
    """Return the time of a pose from the start of its stretch [s]."""
    return max(row * stretch.period_ns - stretch.start_ns, 0) / 1e9  # type: ignore[no-any-return]


@measure
def integrate_error(values: Any, stretch: Any, reference: float, pieces: Any) -> float:
    """Return the integral of the magnitude of the error, folded where it passes through 0.

    `pieces` has room for two values of each pose.
    """
    count = 0
    before, begin_s = reference - values[stretch.first], tell_time(stretch, stretch.first)
    for row in range(stretch.first + 1, stretch.after):
        after, end_s = reference - values[row], tell_time(stretch, row)
        size, next_size = abs(before), abs(after)
        if (before < 0.0) != (after < 0.0) and before != 0.0 and after != 0.0:
            zero_s = begin_s + size / (size + next_size) * (end_s - begin_s)
            pieces[count] = (zero_s - begin_s) * size
            pieces[count + 1] = (end_s - zero_s) * next_size
            count += 2
        else:
            pieces[count] = (end_s - begin_s) * (size + next_size)
            count += 1
        before, begin_s = after, end_s
    return add_up(pieces, 0, count) / 2.0  # type: ignore[no-any-return]


@measure
def measure_way(ticks: Any, count: int, pieces: Any) -> float:
    """Return the length of the line through the poses [m]."""
    for row in range(count - 1):
        x_m, y_m = ticks[row + 1].x_m - ticks[row].x_m, ticks[row + 1].y_m - ticks[row].y_m
        pieces[row] = math.hypot(x_m, y_m)
    return add_up(pieces, 0, count - 1)  # type: ignore[no-any-return]


@measure
def find_cross_track(ticks: Any, first: int, count: int, line: Any) -> float:
    """Return the largest distance of the poses from one on from the line to the goal [m]."""
    largest_m = 0.0
    for row in range(min(first, count - 1), count):
        x_m, y_m = ticks[row].x_m - line.x_m, ticks[row].y_m - line.y_m
        largest_m = max(largest_m, abs(y_m * line.cos - x_m * line.sin))
    return largest_m


@measure
def find_largest_gap(samples: Any, count: int) -> float:
    """Return the longest time from one sample to the next [s], NaN of one sample."""
    if count < 2:
        return np.nan
    largest_ns = 0
    for row in range(1, count):
        largest_ns = max(largest_ns, samples[row].time_ns - samples[row - 1].time_ns)
    return largest_ns / 1e9


@measure
def share_saturated(samples: Any, rows: tuple[int, int], axis: int, limit: float) -> float:
    """Return the share of samples, from one up to another, whose command is at its limit."""
    saturated = 0
    for row in range(rows[0], rows[1]):
        command = samples[row].turn_rate_rad_s if axis else samples[row].speed_m_s
        saturated += abs(command) >= limit
    return saturated / (rows[1] - rows[0])


@measure
def count_crossings(values: Any, stretch: Any, reference: float) -> float:
    """Return how often values come to the other side of the reference."""
    crossings, side = 0, 0
    for row in range(stretch.first, stretch.after):
        now = 1 if values[row] > reference else -1 if values[row] < reference else 0
        if now:
            crossings += side == -now
            side = now
    return float(crossings)


@measure
def find_sample(samples: Any, count: int, phase: int) -> int:
    """Return the row of the first sample of a phase or a later one; `count` where there is none."""
    low, high = 0, count  # by halving: no law returns to an earlier phase
    while low < high:
        middle = (low + high) // 2
        if samples[middle].phase < phase:
            low = middle + 1
        else:
            high = middle
    return low
