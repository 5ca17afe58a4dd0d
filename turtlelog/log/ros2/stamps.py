"""Analysis of a topic's stamps: whether they are usable, their clock, and its rate."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Literal

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from turtlelog.display import describe_count, format_short
from turtlelog.log.engine.topic_columns import TopicColumns
from turtlelog.log.planar_poses import ROWS_AT_ONCE, Values

TimesNs = NDArray[np.int64]
Rows = NDArray[np.int64]

_FIELDS: Final = tuple(
    (f"{place}.sec", f"{place}.{rest}")
    for place in ("header.stamp", "stamp", "timestamp")
    for rest in ("nanosec", "nsec")
)
"""Fields of stamps: in ROS 2 headers, in other types, in Foxglove's messages."""

_MOST_DRIFT: Final = 2e-3
"""Largest drift between two computer clocks: quartz has about 1e-4, and correction at most 5e-4 on
each side. Faster or slower stamps come from a simulation."""

FIRST_WALL_NS: Final = 1_000_000_000_000_000_000
"""Smallest stamp of a wall clock [ns], in 2001: a simulation's stamps begin at 0. Later stamps at
another rate may come from a simulation, or from a recorder that falls behind."""

_MOST_FREE_DRIFT: Final = 5e-4
"""Largest drift of a clock that was never set: two quartz clocks differ by at most 2e-4. If stamps
are not of a wall clock, faster or slower stamps come from a simulation."""

_PARTED_NS: Final = 100_000_000
"""Drift over a recording up to which two clocks may be one with a changing transport delay [ns]."""

_LATE_SPREADS: Final = 3.0
"""The same drift as a multiple of the usual variation of the transport delay."""

_LATE_NS: Final = 1_000_000_000
"""Drift from which there are always two clocks [ns]."""

_JUMP_NS: Final = 500_000_000
"""Step between the clocks from which a clock was set forward [ns]; transport delays change by
less."""

JUMP_STEPS: Final = 3.0
"""Smallest step in usual steps. With one pose per second, some poses may be lost."""

JUMP_ROWS: Final = 5
"""Number of messages that show that a clock was set; fewer are late, or wrongly stamped."""

_NEAR_ROWS: Final = 3
"""Number of messages on either side that show which stamps are valid."""

_LEAST_STAMPED: Final = 0.5
"""Smallest share of messages with a stamp; otherwise most times would be interpolated."""

_LEAST_ADVANCES: Final = 0.25
"""Smallest share of messages with a stamp of their own: programs may publish a pose several
times."""

STRETCH_ROWS: Final = 20
"""Smallest mean number of messages between two jumps; a clock that is set more often is not
usable."""

_BINS: Final = 512
"""Number of time intervals whose fastest messages give the drift of two clocks."""

_QUARTERS: Final = 4
"""Number of intervals that must each contain a message with nearly the shortest delay."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stamps:
    """The times of a topic's messages, in order of log time.

    Attributes:
        log_ns: Time of reception on the recorder's clock [ns], shape (n,).
        stamp_ns: Stamp, on the publisher's clock [ns], shape (n,); None if the type has no stamps.
    """

    log_ns: TimesNs
    stamp_ns: TimesNs | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StampClock:
    """Properties of the stamps of a topic.

    Attributes:
        reason: Why the stamps are not usable; empty if they are usable.
        time_ns: Time of each message [ns], shape (n,), on the recorder's clock; at another rate,
            stamp seconds from the first log time. Messages without a usable stamp have log times.
        pace: Stamp seconds per second of the recorder's clock; None if unknown.
        is_other_pace: Whether the rate differs by more than the drift of computer clocks.
        offset_ns: Recorder's time minus first stamp, for the shortest transport delay [ns].
        jitter_ns: Median transport delay minus the shortest delay [ns]; None at another rate.
        stamps_span_ns: Time from first to last stamp, without jumps [ns].
        log_span_ns: The same time on the recorder's clock [ns].
        jumps: Number of jumps of the stamps' clock.
        odd: Number of messages whose stamp is 0 or far from those of neighbouring messages.
        disordered: Number of messages whose stamp is before that of an earlier message.
        known: Rows of the messages that are timed by their stamps.
    """

    reason: str
    time_ns: TimesNs
    pace: float | None = None
    is_other_pace: bool = False
    offset_ns: int | None = None
    jitter_ns: int | None = None
    stamps_span_ns: int = 0
    log_span_ns: int = 0
    jumps: int = 0
    odd: int = 0
    disordered: int = 0
    known: Rows = field(default_factory=lambda: np.empty(0, dtype=np.int64))


def read_stamps(columns: TopicColumns) -> TimesNs | None:
    """Return the stamps in the headers of messages [ns]; None if their type has no stamps."""
    fields = columns.fields
    for seconds, rest in _FIELDS:
        if seconds in fields and rest in fields:
            whole, part = (fields[name].astype(np.int64) for name in (seconds, rest))
            return np.asarray(whole * 1_000_000_000 + part)
    return None


def join_stamps(found: Sequence[TopicColumns]) -> TimesNs | None:
    """Return the stamps of a topic in all files, as `read_stamps` does."""
    stamps = [of_file for one in found if (of_file := read_stamps(one)) is not None]
    return join_arrays(stamps) if len(stamps) == len(found) else None


def join_arrays(parts: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Return arrays as one array. A single array is not copied."""
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def read_stamp_clock(stamps: Stamps) -> StampClock:
    """Return the properties of a topic's stamps, with the times of its messages."""
    log_ns, stamp_ns = stamps.log_ns, stamps.stamp_ns
    if stamp_ns is None or not len(log_ns):
        return StampClock(reason="there are no stamps", time_ns=log_ns)
    rows = np.flatnonzero(stamp_ns > 0)
    is_stray = _find_strays(_take(log_ns, rows), _take(stamp_ns, rows))
    rows = rows[~is_stray] if is_stray.any() else rows
    starts = _find_jumps(_take(log_ns, rows), _take(stamp_ns, rows))
    stretches = np.split(rows, starts)
    backward = sum(_count_backward(stamp_ns[stretch]) for stretch in stretches)
    reason = _judge(stamp_ns, rows, len(starts), backward)
    if len(rows) and np.ptp(stamp_ns[rows]):
        return _place(log_ns, stamp_ns, stretches, reason)
    return StampClock(reason=reason, time_ns=log_ns, odd=len(log_ns) - len(rows))


def _take(values: TimesNs, rows: Rows) -> TimesNs:
    """Return the values at increasing indices. If these are all rows, nothing is copied."""
    return values if len(rows) == len(values) else values[rows]


def _judge(stamp_ns: TimesNs, rows: Rows, jumps: int, backward: int) -> str:
    count, zeros = len(stamp_ns), int((stamp_ns <= 0).sum())
    if zeros == count:
        return "all stamps are 0 or before 1970" if stamp_ns.any() else "all stamps are 0"
    if count == 1:
        return "one message tells no clock"
    if len(rows) < _LEAST_STAMPED * count:
        return f"{count - len(rows)} of {count} stamps are 0 or make no sense"
    distinct = int(np.count_nonzero(np.diff(np.sort(stamp_ns[rows])))) + 1
    if distinct < max(_LEAST_ADVANCES * count, 2):
        return f"{count} messages share {describe_count(distinct, 'stamp')}"
    if max(jumps, backward) > len(rows) / STRETCH_ROWS:
        return "the stamps' clock jumps to and fro"
    return ""


def _find_strays(log_ns: TimesNs, stamp_ns: TimesNs) -> NDArray[np.bool_]:
    """Return which stamps differ from the stamps of the messages on either side."""
    late_ns = log_ns - stamp_ns
    if len(late_ns) <= 2 * _NEAR_ROWS:
        return np.zeros(len(late_ns), dtype=bool)
    usual_ns = np.empty(len(late_ns))
    windows = sliding_window_view(late_ns, 2 * _NEAR_ROWS + 1)
    for first in range(0, len(windows), ROWS_AT_ONCE):  # the median copies its input 7 times
        part = windows[first : first + ROWS_AT_ONCE]
        usual_ns[first + _NEAR_ROWS :][: len(part)] = np.median(part, axis=1)
    # At both ends the median continues at its own rate, whatever the first and last stamps are.
    ends = late_ns[: 2 * _NEAR_ROWS + 1], late_ns[-2 * _NEAR_ROWS - 1 :]
    first_ns, last_ns = (float(np.median(np.diff(end))) for end in ends)
    rows = np.arange(_NEAR_ROWS)
    usual_ns[:_NEAR_ROWS] = usual_ns[_NEAR_ROWS] + (rows - _NEAR_ROWS) * first_ns
    usual_ns[-_NEAR_ROWS:] = usual_ns[-_NEAR_ROWS - 1] + (rows + 1) * last_ns
    apart_ns = np.abs(np.subtract(late_ns, usual_ns, out=usual_ns), out=usual_ns)
    return np.asarray(apart_ns > _LATE_NS + find_least_jump(stamp_ns))


def find_least_jump(stamp_ns: TimesNs) -> float:
    """Return the smallest step between two messages that shows that a clock was set [ns]."""
    return max(_JUMP_NS, JUMP_STEPS * float(np.median(np.abs(np.diff(stamp_ns)))))


def _find_jumps(log_ns: TimesNs, stamp_ns: TimesNs) -> list[int]:
    starts = [0]
    while len(starts) - 1 <= len(log_ns) / STRETCH_ROWS:
        jump = _find_jump(log_ns[starts[-1] :], stamp_ns[starts[-1] :])
        if jump is None:
            break
        starts.append(starts[-1] + jump)
    return starts[1:]


def _find_jump(log_ns: TimesNs, stamp_ns: TimesNs) -> int | None:
    """Return the first row after a jump of the stamps' clock; None without a jump."""
    if len(stamp_ns) < 2 * JUMP_ROWS:
        return None
    # Set back: later messages have stamps before that of an earlier message.
    highest = np.maximum.accumulate(stamp_ns)[:-JUMP_ROWS]
    is_jump = sliding_window_view(stamp_ns[1:], JUMP_ROWS).max(axis=1) < highest
    # Set forward: later messages seem to be transported faster than the fastest before.
    late_ns = log_ns - stamp_ns
    fastest = np.minimum.accumulate(late_ns)[:-JUMP_ROWS]
    least_ns = find_least_jump(stamp_ns)
    is_faster = sliding_window_view(late_ns[1:], JUMP_ROWS).max(axis=1) < fastest - least_ns
    is_jump |= is_faster & (np.diff(late_ns)[: len(fastest)] < -least_ns)
    return int(is_jump.argmax()) + 1 if is_jump.any() else None


def _place(log_ns: TimesNs, stamp_ns: TimesNs, stretches: list[Rows], reason: str) -> StampClock:
    """Return the times of all messages for a clock with known jumps."""
    rows = np.concatenate(stretches)
    spans = [(np.ptp(stamp_ns[stretch]), np.ptp(log_ns[stretch])) for stretch in stretches]
    stamps_ns, passed_ns = (int(sum(span)) for span in zip(*spans, strict=True))
    longest = max(stretches, key=len)
    longest_log_ns, longest_ns = log_ns[longest], stamp_ns[longest]
    slope = _fit_slope(longest_log_ns, longest_ns)
    # The delay of each message relative to the fastest.
    late_ns = (longest_log_ns - longest_log_ns[0]) - slope * (longest_ns - longest_ns[0])
    late_ns -= late_ns.min()
    is_wall = int(stamp_ns[longest[0]]) >= FIRST_WALL_NS
    is_other = _is_other_pace(late_ns, abs(slope - 1.0) * stamps_ns, slope, is_wall=is_wall)
    if is_other:
        pace = stamps_ns / max(passed_ns, 1)
        times = _chain(log_ns, stamp_ns, stretches, pace)
    else:
        slope = slope if abs(slope - 1.0) <= _MOST_DRIFT else 1.0
        pace = 1.0 / slope
        times = np.concatenate([_map(log_ns[own], stamp_ns[own], slope) for own in stretches])
    time_ns = log_ns.copy()
    time_ns[rows] = times
    jitter_ns = None if is_other else int(np.median(log_ns[rows] - times))
    clock = StampClock(
        reason=reason,
        time_ns=time_ns,
        pace=pace,
        is_other_pace=is_other,
        offset_ns=int(time_ns[longest[0]] - stamp_ns[longest[0]]),
        jitter_ns=jitter_ns,
        stamps_span_ns=stamps_ns,
        log_span_ns=passed_ns,
        jumps=len(stretches) - 1,
        odd=len(log_ns) - len(rows),
        disordered=sum(
            int((own < np.maximum.accumulate(own)).sum())
            for own in (stamp_ns[stretch] for stretch in stretches)
        ),
        known=rows,
    )
    odd = np.ones(len(log_ns), dtype=bool)
    odd[rows] = False
    if is_other:
        time_ns[odd] = place_log_times(clock, log_ns, log_ns[odd])
    else:
        time_ns[odd] -= jitter_ns or 0
    return clock


def _is_other_pace(late_ns: Values, parted_ns: float, slope: float, *, is_wall: bool) -> bool:
    """Return whether stamps have another rate; `late_ns` are the residuals of the fitted line."""
    # A simulation that paused: all messages after the pause are late.
    quarters = [float(part.min()) for part in np.array_split(late_ns, _QUARTERS) if len(part)]
    if max(quarters) > _LATE_NS:
        return True
    if abs(slope - 1.0) <= (_MOST_DRIFT if is_wall else _MOST_FREE_DRIFT):
        return False
    spread_ns = _LATE_SPREADS * float(np.quantile(late_ns, 0.9))
    # A clock that is not a wall clock is always another clock; a wall clock may have changing
    # delays.
    return parted_ns > min(max(spread_ns, _PARTED_NS if is_wall else 0.0), _LATE_NS)


def _fit_slope(log_ns: TimesNs, stamp_ns: TimesNs) -> float:
    """Return recorder seconds per stamp second, from the fastest messages.

    The line is the edge of the lower hull at the mean (Moon, Skelly and Towsley, 1999).
    """
    passed = (stamp_ns - stamp_ns[0]).astype(np.float64)
    late = (log_ns - log_ns[0]) - passed
    width = float(np.ptp(passed)) / _BINS
    if not width:
        return 1.0
    bins = np.minimum(((passed - passed.min()) / width).astype(np.int64), _BINS - 1)
    order = np.lexsort([late, bins])
    first = order[np.r_[True, np.diff(bins[order]) > 0]]
    hull: list[tuple[float, float]] = []
    for point in zip(passed[first].tolist(), late[first].tolist(), strict=True):
        while len(hull) > 1:
            (x0, y0), (x1, y1) = hull[-2:]
            if (x1 - x0) * (point[1] - y0) > (y1 - y0) * (point[0] - x0):
                break
            hull.pop()
        hull.append(point)
    mean = float(passed.mean())
    after = next((i for i, (x, _) in enumerate(hull) if x >= mean and i), len(hull) - 1)
    (x0, y0), (x1, y1) = hull[after - 1 : after + 1]
    return 1.0 + (y1 - y0) / (x1 - x0)


def _map(log_ns: TimesNs, stamp_ns: TimesNs, slope: float) -> TimesNs:
    """Return stamps mapped to the recorder's clock, with zero delay for the fastest message."""
    passed = stamp_ns - stamp_ns[0]
    # The drift is small, so that floats lose no digits.
    mapped = log_ns[0] + passed + np.rint((slope - 1.0) * passed).astype(np.int64)
    return np.asarray(mapped + (log_ns - mapped).min())


def _chain(log_ns: TimesNs, stamp_ns: TimesNs, stretches: list[Rows], pace: float) -> TimesNs:
    """Return segments of stamps in their own seconds, joined one after another."""
    times: list[TimesNs] = []
    start, last = int(log_ns[stretches[0][0]]), stretches[0][0]
    for rows in stretches:
        if times:
            start = int(times[-1].max() + np.rint(pace * (log_ns[rows[0]] - log_ns[last])))
        times.append(start + stamp_ns[rows] - stamp_ns[rows[0]])
        last = rows[-1]
    return np.concatenate(times)


def place_log_times(clock: StampClock, of_ns: TimesNs, log_ns: TimesNs) -> TimesNs:
    """Return recorder times `log_ns` [ns] mapped to the timeline of stamps at another rate.

    The stamped messages have the log times `of_ns` [ns]. Beyond them the mean rate is used.
    """
    known, at_ns = of_ns[clock.known], np.maximum.accumulate(clock.time_ns[clock.known])
    start_ns, inside = int(known[0]), np.clip(log_ns, known[0], known[-1])
    at = np.interp(inside - start_ns, known - start_ns, at_ns - at_ns[0])
    at += (clock.pace or 1.0) * (log_ns - inside)
    return np.asarray(at_ns[0] + np.rint(at).astype(np.int64))


def _count_backward(stamp_ns: TimesNs) -> int:
    """Return the number of stamps far before an earlier stamp, which come from a second clock."""
    if len(stamp_ns) < 2:
        return 0
    back_ns = np.maximum.accumulate(stamp_ns) - stamp_ns
    return int((back_ns > _LATE_NS + find_least_jump(np.sort(stamp_ns))).sum())


_SHOWN_DRIFT_NS: Final = 1_000_000
"""Smallest total drift that is mentioned [ns]."""


def describe_stamp_clock(found: StampClock, used: Literal["log", "stamp"]) -> str:
    """Return the clock that is used, and its relation to the other one."""
    if used == "log":
        text = f"the recorder's clock, as {found.reason or 'given'}"
        if found.reason or not found.is_other_pace:
            return text
        return f"{text}: rates are those of the motion times {found.pace:.3g}, the stamps' pace"
    texts = ["their stamps"]
    pace, offset_ns, jitter_ns = found.pace or 1.0, found.offset_ns or 0, found.jitter_ns or 0
    is_wall = int(found.time_ns[found.known[0]]) - offset_ns >= FIRST_WALL_NS
    if found.is_other_pace:
        why = "of another pace" if is_wall else "a simulation's"
        ratio = f"{pace:.3g}" if abs(pace - 1.0) > 0.01 else f"{pace:.5g}"  # differs from 1
        texts.append(
            f", whose seconds are {why}: {found.stamps_span_ns / 1e9:.1f} s in"
            f" {found.log_span_ns / 1e9:.1f} s of the recorder's clock, ratio {ratio}"
        )
    else:
        sign, offset_s = "-" if offset_ns < 0 else "+", abs(offset_ns) / 1e9
        offset = f"{offset_s:.3f}" if offset_s < 1000.0 else f"{offset_s:.0f}"  # decades
        shift = "" if offset == "0.000" else f" {sign} {offset} s"
        texts.append(
            f"{shift}, mapped to the recorder's clock by the fastest message,"
            f" whose transport is unknown; usually others take {jitter_ns / 1e6:.1f} ms more"
        )
        if abs(pace - 1.0) * found.log_span_ns > max(jitter_ns, _SHOWN_DRIFT_NS):
            drift = f"{(pace - 1.0) * 1e6:+.0f} ppm"
            whose = "clock" if is_wall else "clock, which was never set or is a simulation's,"
            texts.append(f"; their {whose} drifts by {drift}, taken out")
    if found.jumps:
        texts.append(f"; their clock was set {describe_count(found.jumps, 'time')}")
    if found.odd:
        texts.append(f"; {found.odd} without a usable stamp by when they were received")
    if found.disordered:
        verb = "is" if found.disordered == 1 else "are"
        texts.append(f"; {found.disordered} received out of order {verb} sorted")
    return "".join(texts)


CROWDED_NS: Final = 10_000
"""Usual time between poses below which the times are wrong [ns]; motion capture takes 100 us."""


def note_crowded(time_ns: NDArray[np.int64], *, may_be_rounded: bool = False) -> dict[str, str]:
    """Return a note on poses that are too close in time for a sensor, if they are.

    Times of a table may be rounded; equal ones are 1 ns apart.
    """
    steps_ns = np.diff(time_ns)
    if len(time_ns) < 3 or 2 * np.count_nonzero(steps_ns < CROWDED_NS) <= len(steps_ns):
        return {}
    same = int(np.count_nonzero(steps_ns == 1)) if may_be_rounded else 0
    if 2 * same > len(time_ns):
        text = (
            f"{same} of {len(time_ns)} poses have the time of the pose before, and all rates are"
            " wrong: save times with all their digits"
        )
        return {"crowded": text}
    span = format_short(float(time_ns[-1] - time_ns[0]) / 1e9, "s")
    text = f"all {len(time_ns)} poses lie within {span}: their times, and all rates, are wrong"
    return {"crowded": text}


def thin_rows(time_ns: TimesNs, stride_ns: int) -> NDArray[np.int64]:
    """Return the first row at or after each multiple of a stride from the first to the last time.

    The times do not decrease. They may span years if the first time was never set.
    """
    strides = (np.minimum(time_ns, time_ns[-1] - 1) - time_ns[0]) // stride_ns
    return np.flatnonzero(np.diff(strides, prepend=-1) > 0)
