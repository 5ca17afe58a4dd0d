"""Times of the poses and commands of a bag: stamps compared with the recorder's clock.

A message has two times: its stamp, set by the publisher, and its log time, when the recorder
received it. The two times differ by the offset of two clocks and the transport delay. Stamps have
less jitter, but commands without stamps have only the recorder's clock. Poses are therefore timed
by their stamps, mapped to the recorder's clock by the messages with the shortest transport delay.
The shortest delay is unknown, so all pose times are late by this delay.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import describe_count
from turtlelog.errors import LogError
from turtlelog.log.read_choice import TimeSource
from turtlelog.log.ros2.stamps import (
    FIRST_WALL_NS,
    StampClock,
    Stamps,
    TimesNs,
    place_log_times,
    read_stamp_clock,
)
from turtlelog.run import Clock

CLOCK: Final = "clock"
"""Name of the note on the clock of a run's poses."""

CLOSE_ROWS: Final = "close_rows"
"""Name of the note on dropped poses at nearly equal times."""

_CLOSEST_NS: Final = 1_000_000
"""Smallest time between two poses that gives a usable rate [ns]: noise of 0.2 mm becomes 0.2 m/s
and more."""

_CLOSEST_SHARE: Final = 0.25
"""Share of the usual step below which poses count as close, because a motion capture may run at 2
kHz."""

_SAME_CLOCK_NS: Final = 1_000_000_000
"""Largest time between a stamp of a command and its reception [ns] for stamps of the poses'
simulation. Stamps of another simulation, or of a wall clock, differ by more."""

_SHOWN_DRIFT_NS: Final = 1_000_000
"""Smallest total drift that is mentioned [ns]."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _TimedRows:
    """The rows of a topic in order of the times used.

    Attributes:
        rows: Indices of the given rows, shape (m,).
        time_ns: Time on the recorder's clock [ns], shape (m,), not decreasing.
    """

    rows: NDArray[np.int64]
    time_ns: TimesNs


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BagTimes:
    """Times of the poses and commands of a bag.

    Attributes:
        poses: Times of the poses that are kept.
        commands: Times of all commands.
        clock: Clock that times the poses; None if the poses have no stamps.
        notes: Description of the timing, for the notes of a run.
    """

    poses: _TimedRows
    commands: _TimedRows
    clock: Clock | None = None
    notes: Mapping[str, str] = field(default_factory=dict)


def time_rows(
    poses: Stamps, commands: Stamps | None, time: TimeSource, *, noun: str = "poses"
) -> BagTimes:
    """Return the times of poses and commands on one timeline.

    The timeline is the recorder's clock. If stamps run at another rate, as in simulation, the
    motion follows the stamps: the timeline has the rate of the stamps, and commands are mapped to
    it. Commands with usable stamps are timed by their stamps, like poses.

    Both topics are in order of log time. With `auto`, stamps of poses are used if they are usable.
    In a bag without poses, its commands are given as poses, with this noun. No command is dropped,
    however close in time.

    Raises:
        LogError: If stamps are requested and no pose has a usable stamp.
    """
    commands = commands or Stamps(log_ns=np.empty(0, dtype=np.int64))
    if poses.stamp_ns is None:
        if time == "stamp":
            raise LogError(f"time: expected {noun} with stamps, found a type without: take log")
        return BagTimes(poses=_sort(poses.log_ns), commands=_sort(commands.log_ns))
    found = read_stamp_clock(poses)
    if time == "stamp" and found.pace is None:
        raise LogError(f"time: expected usable stamps of {noun}, but {found.reason}: take log")
    if time == "log" or (time == "auto" and found.reason):
        text = f"{noun} are timed by the recorder's clock, {_describe_log(found)}"
        rows, clock = _sort(poses.log_ns), _make_clock(found, "log")
    else:
        text = f"{noun} are timed by their stamps{_describe(found)}"
        rows, clock = _sort(found.time_ns), _make_clock(found, "stamp")
    commands_ns, how = commands.log_ns, ""
    if clock.used == "stamp" and noun == "poses":
        commands_ns, how = _time_commands(commands, poses, found)
    notes = {CLOCK: text + how}
    if noun == "poses":
        kept = _find_apart(rows.time_ns)
        if close := int(len(kept) - kept.sum()):
            closest = f"{describe_count(close, 'pose')} less than 1 ms before another left out"
            notes |= {CLOCK: f"{notes[CLOCK]}; {closest}", CLOSE_ROWS: str(close)}
        rows = _TimedRows(rows=rows.rows[kept], time_ns=rows.time_ns[kept])
    return BagTimes(poses=rows, commands=_sort(commands_ns), clock=clock, notes=notes)


def _time_commands(commands: Stamps, poses: Stamps, found: StampClock) -> tuple[TimesNs, str]:
    """Return the times of commands on the poses' timeline, and a description of their source."""
    if not len(commands.log_ns):
        return commands.log_ns, ""
    own = read_stamp_clock(commands)
    if not found.is_other_pace:
        if own.reason or own.is_other_pace:
            return commands.log_ns, "; commands by the recorder's clock"
        return own.time_ns, "; commands by their stamps, likewise"
    placed_ns = place_log_times(found, poses.log_ns, commands.log_ns)
    if not own.reason and not found.jumps and commands.stamp_ns is not None:
        stamped_ns = commands.stamp_ns + (found.offset_ns or 0)
        if np.abs(stamped_ns - placed_ns).max() < _SAME_CLOCK_NS:
            return stamped_ns, "; commands by their stamps of the same clock"
    return placed_ns, "; commands are mapped to it by the poses that were received with them"


def _make_clock(found: StampClock, used: Literal["log", "stamp"]) -> Clock:
    offset_s, jitter_s = (
        None if time_ns is None else time_ns / 1e9 for time_ns in (found.offset_ns, found.jitter_ns)
    )
    return Clock(used=used, ratio=found.pace, offset_s=offset_s, jitter_s=jitter_s)


def _describe_log(found: StampClock) -> str:
    """Return the reason why log times are used, and its effect on rates."""
    if found.reason or not found.is_other_pace:
        return f"as {found.reason or 'given'}"
    return f"as given: rates are those of the motion times {found.pace:.3g}, the stamps' pace"


def _describe(found: StampClock) -> str:
    """Return the relation of stamps to the recorder's clock, in words that follow `stamps`."""
    texts = []
    pace, offset_ns, jitter_ns = found.pace or 1.0, found.offset_ns or 0, found.jitter_ns or 0
    is_wall = int(found.time_ns[found.known[0]]) - offset_ns >= FIRST_WALL_NS
    if found.is_other_pace:
        why = "of another pace" if is_wall else "a simulation's"
        texts.append(
            f", whose seconds are {why}: {found.stamps_span_ns / 1e9:.1f} s in"
            f" {found.log_span_ns / 1e9:.1f} s of the recorder's clock, ratio"
            f" {_format_pace(pace)}"
        )
    else:
        texts.append(
            f" {_format_offset(offset_ns)}, mapped to the recorder's clock by the fastest message,"
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


def _format_pace(pace: float) -> str:
    """Return a ratio with enough digits to differ from 1."""
    return f"{pace:.3g}" if abs(pace - 1.0) > 0.01 else f"{pace:.5g}"


def _format_offset(offset_ns: int) -> str:
    """Return an offset with a sign, and without milliseconds for offsets of decades."""
    sign, offset_s = "-" if offset_ns < 0 else "+", abs(offset_ns) / 1e9
    return f"{sign} {offset_s:.3f} s" if offset_s < 1000.0 else f"{sign} {offset_s:.0f} s"


def _find_apart(time_ns: TimesNs) -> NDArray[np.bool_]:
    """Return which rows to keep: those that no other row follows too closely for a rate.

    The last of several close rows is kept: if poses were delayed, its time is correct.
    """
    step_ns = np.diff(time_ns)
    moving_ns = step_ns[step_ns > 0]
    if not len(moving_ns):
        return np.ones(len(time_ns), dtype=bool)
    least_ns = min(_CLOSEST_NS, _CLOSEST_SHARE * float(np.median(moving_ns)))
    return np.append(step_ns >= least_ns, True)


def _sort(time_ns: TimesNs) -> _TimedRows:
    rows = np.argsort(time_ns, kind="stable")
    return _TimedRows(rows=rows, time_ns=time_ns[rows])
