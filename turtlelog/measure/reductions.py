"""Searches and sums along rows for metrics, each as a numpy version and a loop version.

The numpy version serves one run; the loop is compiled for the batch of `sweep`. Both return the
same bits. Each metric is a single function built on these.

`memory` belongs to the compiled batch, which creates no arrays; ordinary Python passes None.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from turtlelog.arithmetic import compiled_as, inlined

Values = NDArray[np.float64]
Rows = NDArray[np.int64]
_BLOCK = 128
_LANES = 8
"""Number of values that numpy's `sum` adds at once, each into its own partial sum."""

_BUFFER = 8192
"""Number of rows that numpy's `einsum` adds before it starts a new sum."""

USES = 4
"""Number of rows of `memory.numbers` used here; each has twice as many numbers as there are
rows."""
PIECES, _TIMES, _SIZES, _STEPS = range(USES)


def subtract_neighbours(values: NDArray[Any]) -> NDArray[Any]:
    """Return each row minus the row before, shape (n - 1,).

    As `np.diff`, which takes three times as long for a run of some hundred rows.
    """
    return np.asarray(values[1:] - values[:-1])


def compute_median(values: NDArray[Any]) -> float:
    """Return the median of one row as `np.median` does; NaN for an empty row.

    `np.median` itself is not used: to look for NaN, it loads numpy's masked arrays, in a tenth of
    numpy's loading time.
    """
    half, odd = divmod(len(values), 2)
    if not len(values):
        return math.nan
    places = [half] if odd else [half - 1, half]
    ordered = np.partition(values, [*places, -1])
    last = float(ordered[-1])  # NaN is sorted after all numbers
    return last if math.isnan(last) else sum(float(ordered[n]) for n in places) / len(places)


def _find_furthest_row(values: Any, direction: float) -> int:
    row = 0
    for place in range(1, len(values)):
        value, best = values[place], values[row]
        if value > best if direction > 0.0 else value < best:
            row = place
    return row


@compiled_as(_find_furthest_row)
def find_furthest_row(values: Values, direction: float) -> int:
    """Return the first row of the largest value; of the smallest if the direction is not > 0."""
    return int(values.argmax() if direction > 0.0 else values.argmin())


def _find_first_beyond(values: Any, threshold: float, direction: float) -> int:
    for row in range(len(values)):
        if values[row] >= threshold if direction > 0.0 else values[row] <= threshold:
            return row
    return -1


@compiled_as(_find_first_beyond)
def find_first_beyond(values: Values, threshold: float, direction: float) -> int:
    """Return the first row at or beyond a threshold in a direction; -1 if no row is."""
    reached = values >= threshold if direction > 0.0 else values <= threshold
    row = int(reached.argmax())
    return row if reached[row] else -1


def _find_last_outside(values: Any, low: float, high: float) -> int:
    row = len(values) - 1
    while row >= 0 and low <= values[row] <= high:
        row -= 1
    return row


@compiled_as(_find_last_outside)
def find_last_outside(values: Values, low: float, high: float) -> int:
    """Return the last row below `low` or above `high`; -1 if no row is."""
    outside = (values > high) | (values < low)
    row = len(values) - 1 - int(outside[::-1].argmax())
    return row if outside[row] else -1


def _find_bounds(values: Any) -> tuple[float, float]:
    low = high = values[0]
    for row in range(1, len(values)):
        low, high = min(low, values[row]), max(high, values[row])
    return low, high


@compiled_as(_find_bounds)
def find_bounds(values: Values) -> tuple[float, float]:
    """Return the least and the largest of some values."""
    return float(values.min()), float(values.max())


def _find_largest(error: Any) -> tuple[float, int]:
    low = high = 0
    for row in range(1, len(error)):
        if error[row] < error[low]:
            low = row
        if error[row] > error[high]:
            high = row
    row = low if -error[low] > error[high] else high
    return abs(error[row]), row


@compiled_as(_find_largest)
def find_largest(error: Values) -> tuple[float, int]:
    """Return the largest magnitude [unit] and its row."""
    low, high = int(error.argmin()), int(error.argmax())
    row = low if -error[low] > error[high] else high
    return abs(float(error[row])), row


def _find_furthest_between(
    arcs_m: Any, error: Any, begin_m: float, end_m: float, direction: float
) -> int:
    found = -1
    for row in range(len(arcs_m)):
        if begin_m <= arcs_m[row] < end_m and (
            found < 0 or error[row] * direction > error[found] * direction
        ):
            found = row
    return found


@compiled_as(_find_furthest_between)
def find_furthest_between(
    arcs_m: Values, error: Values, begin_m: float, end_m: float, direction: float
) -> int:
    """Return the first row with the largest error in a direction between two arc lengths, or -1."""
    rows = np.flatnonzero((arcs_m >= begin_m) & (arcs_m < end_m))
    return int(rows[int((error[rows] * direction).argmax())]) if len(rows) else -1


def _find_largest_change(error: Any) -> float:
    largest, before = 0.0, abs(error[0])
    for row in range(1, len(error)):
        size = abs(error[row])
        largest = max(largest, abs(size - before))
        before = size
    return largest


@compiled_as(_find_largest_change)
def find_largest_change(error: Values) -> float:
    """Return the largest change of the magnitude between rows [unit]; needs two rows or more."""
    return float(np.abs(subtract_neighbours(np.abs(error))).max())


def _find_rise_behind_peak(error: Any) -> float:
    peak = least = rise = 0.0
    for row in range(len(error)):
        size = abs(error[row])
        if size > peak:
            peak, least, rise = size, size, 0.0
        least = min(least, size)
        rise = max(rise, size - least)
    return rise


@compiled_as(_find_rise_behind_peak)
def find_rise_behind_peak(error: Values) -> float:
    """Return the increase of the magnitude after its maximum [unit]."""
    size = np.abs(error)
    falling = size[int(size.argmax()) :]
    return float((falling - np.minimum.accumulate(falling)).max())


def _count_beyond(values: Any, limit: float) -> tuple[int, int]:
    count, first = 0, -1
    for row in range(len(values)):
        if abs(values[row]) >= limit:
            first = row if count == 0 else first
            count += 1
    return count, first


@compiled_as(_count_beyond)
def count_beyond(values: Values, limit: float) -> tuple[int, int]:
    """Return the number of magnitudes at or beyond a limit, and the first such row (-1: none)."""
    is_beyond = np.abs(values) >= limit
    count = int(is_beyond.sum())
    return count, int(is_beyond.argmax()) if count else -1


@inlined
def _find_crossing_rows(values: Any, reference: float, memory: Any) -> Any:
    count, side = 0, 0
    for row in range(len(values)):
        now = 1 if values[row] > reference else -1 if values[row] < reference else 0
        if now != 0:
            if side == -now:
                memory.rows[count] = row
                count += 1
            side = now
    return memory.rows[:count]


@compiled_as(_find_crossing_rows)
def find_crossing_rows(values: Values, reference: float, memory: Any) -> Rows:  # noqa: ARG001
    """Return the rows at which the response has crossed to the other side of the reference.

    Touching the reference is not a crossing. Resting on the reference and then moving to the other
    side is a crossing.
    """
    beyond, short = values > reference, values < reference
    rows = np.flatnonzero(beyond | short)
    side = beyond[rows]
    return np.asarray(rows[1:][side[1:] != side[:-1]])


def _compare_durations(rows: Any, first: int) -> float:
    apart = 2 if len(rows) - first > 3 else 1
    shorter = longer = 0
    for place in range(first, len(rows) - 1 - apart):
        before = rows[place + 1] - rows[place]
        after = rows[place + 1 + apart] - rows[place + apart]
        shorter += min(before, after)
        longer += max(before, after)
    return shorter / longer


@compiled_as(_compare_durations)
def compare_durations(rows: Rows, first: int) -> float:
    """Return the shorter by the longer duration of successive swings to one side, over all swings.

    `rows` are those of the crossings, at least three from `first` on. Of only two swings, both
    sides are compared.
    """
    lasting = rows[first + 1 :] - rows[first:-1]
    apart = 2 if len(lasting) > 2 else 1
    before, after = lasting[:-apart], lasting[apart:]
    return int(np.minimum(before, after).sum()) / int(np.maximum(before, after).sum())


def _find_swing_ends(
    time_s: Any, values: Any, reference: float, width: float, apart_s: float
) -> tuple[int, int]:
    last = after = -1
    for row in range(len(values) - 1, -1, -1):
        error = values[row] - reference
        if not abs(error) > width:
            continue
        is_last = after < 0
        if after >= 0:
            is_last = after - row > 1 and time_s[after] - time_s[row] >= apart_s
            is_last = is_last or (error > 0.0) != (values[after] - reference > 0.0)
        after = row
        if not is_last or row == len(values) - 1:
            continue
        if last >= 0:
            return row, last
        last = row
    return -1, last


@compiled_as(_find_swing_ends)
def find_swing_ends(
    time_s: Values, values: Values, reference: float, width: float, apart_s: float
) -> tuple[int, int]:
    """Return the last rows of the last two completed half-oscillations ("swings"); -1 if none.

    A swing is a segment of rows on one side of the reference, further away than a given width.
    Segments separated by less than a given time form one swing. A swing at the end of the recording
    is not completed.
    """
    error = values - reference
    rows = np.flatnonzero(np.abs(error) > width)
    side = error[rows] > 0.0
    is_away = (subtract_neighbours(rows) > 1) & (subtract_neighbours(time_s[rows]) >= apart_s)
    is_last = np.append(is_away | (side[1:] != side[:-1]), True)[: len(rows)]
    before, last = (-1, -1, *rows[is_last & (rows < len(values) - 1)][-2:].tolist())[-2:]
    return before, last


def _fold_at_zero(time_s: Any, error: Any, memory: Any) -> tuple[Any, Any, Any]:
    times, sizes, steps = memory.numbers[_TIMES], memory.numbers[_SIZES], memory.numbers[_STEPS]
    count, after = 0, 0.0
    for row in range(len(error)):
        before, after = after, error[row]
        crosses = (before < 0.0) != (after < 0.0) and before != 0.0 and after != 0.0
        if row > 0 and crosses:
            size = abs(before)
            share = size / (size + abs(after))
            times[count] = time_s[row - 1] + share * (time_s[row] - time_s[row - 1])
            sizes[count] = 0.0
            count += 1
        times[count], sizes[count] = time_s[row], abs(after)
        count += 1
    for row in range(count - 1):
        steps[row] = times[row + 1] - times[row]
    return times[:count], steps[: count - 1], sizes[:count]


@compiled_as(_fold_at_zero)
def fold_at_zero(time_s: Values, error: Values, memory: Any) -> tuple[Values, Values, Values]:  # noqa: ARG001
    """Return times [s], time steps [s] and magnitudes, with a row added wherever the error is 0."""
    changes = np.flatnonzero((error[:-1] < 0.0) != (error[1:] < 0.0))
    changes = changes[(error[changes] != 0.0) & (error[changes + 1] != 0.0)]
    magnitude = np.abs(error)
    if len(changes):
        before, after = magnitude[changes], magnitude[changes + 1]
        share = before / (before + after)
        zero_s = time_s[changes] + share * (time_s[changes + 1] - time_s[changes])
        time_s = np.insert(time_s, changes + 1, zero_s)
        magnitude = np.insert(magnitude, changes + 1, 0.0)
    return time_s, subtract_neighbours(time_s), magnitude


def _add_block(values: Any, first: int, count: int) -> float:
    total = 0.0
    whole = 0
    if count >= _LANES:
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
    return total


def _find_half(count: int, depth: int, path: int) -> tuple[int, int]:
    """Return the start and count of a half; the bits of `path` select the halves."""
    first = 0
    for level in range(depth - 1, -1, -1):
        half = count // 2
        half -= half % _LANES
        if path >> level & 1:
            first, count = first + half, count - half
        else:
            count = half
    return first, count


def add_up(values: Any, count: int) -> float:
    """Return the sum of the first values in the order of numpy's `sum` (pairwise summation).

    The sum of a left half overwrites its first value.
    """
    # Without recursion: recursive functions crash when numba loads them from its disk cache.
    depth = path = 0
    while True:
        begin, left = _find_half(count, depth, path)
        while left > _BLOCK:
            depth, path = depth + 1, path << 1
            begin, left = _find_half(count, depth, path)
        total = _add_block(values, begin, left)
        while path & 1:
            depth, path = depth - 1, path >> 1
            begin, _ = _find_half(count, depth, path)
            total = values[begin] + total
        if depth == 0:
            return total
        values[begin], path = total, path | 1


def _add_values(values: Any, memory: Any) -> float:
    pieces = memory.numbers[PIECES]
    for row in range(len(values)):
        pieces[row] = values[row]
    return add_up(pieces, len(values))


@compiled_as(_add_values)
def add_values(values: Values, memory: Any) -> float:  # noqa: ARG001
    """Return the sum of values [unit]."""
    return float(values.sum())


def _integrate(step_s: Any, values: Any, memory: Any) -> float:
    pieces = memory.numbers[PIECES]
    for row in range(len(step_s)):
        pieces[row] = step_s[row] * (values[row] + values[row + 1])
    return add_up(pieces, len(step_s)) / 2.0


@compiled_as(_integrate)
def integrate(step_s: Values, values: Values, memory: Any) -> float:  # noqa: ARG001
    """Return the integral of the signal [unit s]; for a folded error this is the IAE."""
    return float((step_s * (values[:-1] + values[1:])).sum()) / 2.0


def _add_triples(first: Any, second: Any, third: Any) -> float:
    total = 0.0
    for begin in range(0, len(first), _BUFFER):
        part = 0.0
        for row in range(begin, min(begin + _BUFFER, len(first))):
            part += first[row] * second[row] * third[row]
        total = part + total
    return total


@compiled_as(_add_triples)
def add_triples(first: Values, second: Values, third: Values) -> float:
    """Return the sum over the rows of the products of three columns."""
    return sum_products(first, second, third)


def sum_products(*columns: NDArray[Any]) -> float:
    """Return the sum over the rows of the products of two or three columns, shape (n,).

    The bits are the same on every processor, unlike those of `np.dot`, which depend on a library.
    No temporary array is created, so a long signal takes only the time to read it.
    """
    rows = ",".join("i" for _ in columns)
    return float(np.einsum(f"{rows}->", *columns))


def _measure_way(x_m: Any, y_m: Any, memory: Any) -> float:
    count, pieces = len(x_m) - 1, memory.numbers[PIECES]
    for row in range(count):
        pieces[row] = math.hypot(x_m[row + 1] - x_m[row], y_m[row + 1] - y_m[row])
    return add_up(pieces, count)


@compiled_as(_measure_way)
def measure_way(x_m: Values, y_m: Values, memory: Any) -> float:  # noqa: ARG001
    """Return the length of the line through points [m]."""
    return float(np.hypot(subtract_neighbours(x_m), subtract_neighbours(y_m)).sum())
