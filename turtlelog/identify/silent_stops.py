"""Where a robot stops by itself because no command comes any more.

Many bases stop some tenths of a second after the last command, if nobody sends a 0. A model whose
commands hold for ever would take that for a slow robot.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.identify.held_response import Values

_SILENCE_S: Final = 0.4
"""Shortest silence after which a robot may stop by itself [s]: bases wait for 0.5 s and more."""

_LOOK_S: Final = 0.3
"""How long before the end of a silence the robot must stand [s]."""

_JOINED_S: Final = 0.1
"""Over what rates are averaged [s]: the noise of poses would hide when a robot stops."""

_STOPPED: Final = 0.1
"""Share of its largest rate within the silence below which it stands."""

_OBEYS: Final = 0.25
"""Share of the held command from which on the robot still follows it: gains are 0.5 and more. What
it did before a small command may be ten times as fast."""

_ABOVE_NOISE: Final = 3.0
"""How far a robot must go in a silence, by how far its poses wander at the end: the noise of 1,000
poses goes 2.5 times as far as that of six."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SilentStop:
    """One of them.

    Attributes:
        begin_s: Time of the last command [s].
        stop_s: When the robot has lost half of its rate [s].
        end_s: Time of the next command, or of the last pose [s].
    """

    begin_s: float
    stop_s: float
    end_s: float


def find_silent_stops(
    command_s: Values, command: Values, time_s: Values, moved: Values
) -> list[SilentStop]:
    """Return the silences, with a command other than 0 held, at whose end a robot stands.

    Args:
        command_s: Times of the commands [s].
        command: Their values.
        time_s: Times of the poses [s], shape (n + 1,).
        moved: How far each step between poses went, shape (n,).
    """
    if not len(command) or not len(moved):
        return []
    ends_s = np.append(command_s[1:], time_s[-1])
    silent = np.flatnonzero((ends_s - command_s > _SILENCE_S + _LOOK_S) & (command != 0.0))
    found = [
        _look_at_silence(
            float(command_s[row]), float(ends_s[row]), abs(float(command[row])), time_s, moved
        )
        for row in silent.tolist()
    ]
    return [stop for stop in found if stop is not None]


def _look_at_silence(
    begin_s: float, end_s: float, held: float, time_s: Values, moved: Values
) -> SilentStop | None:
    first, after = np.searchsorted(time_s, [begin_s, end_s])
    way = np.concatenate([[0.0], np.cumsum(moved[first : after - 1])])
    at_s = time_s[first:after]
    last_s = at_s[-1] - _LOOK_S if len(at_s) else begin_s
    if len(at_s) < 4 or last_s <= begin_s:
        return None
    before = np.interp(at_s - _JOINED_S, at_s, way)
    is_whole = at_s >= at_s[0] + _JOINED_S
    rate = np.abs(way - before)[is_whole] / _JOINED_S
    rate_s = at_s[is_whole] - 0.5 * _JOINED_S
    # The mean: of a slow command the noise of poses looks like motion.
    left = abs(float(way[-1] - np.interp(last_s, at_s, way))) / _LOOK_S
    largest = float(rate.max(initial=0.0))
    still_moves = left > min(_STOPPED * largest, _OBEYS * held)
    if not largest or still_moves or not _has_moved(way, way[at_s >= last_s], held):
        return None
    moving = np.flatnonzero(rate > 0.5 * largest)
    stop_s = float(rate_s[moving[-1]])
    return SilentStop(begin_s=begin_s, stop_s=stop_s, end_s=end_s)


def _has_moved(way: Values, at_end: Values, held: float) -> bool:
    """Return whether a robot moves in a silence: one that stands all the while stops nowhere."""
    went = float(np.abs(way).max())
    return went > max(_OBEYS * held * _SILENCE_S, _ABOVE_NOISE * float(np.ptp(at_end)))


def insert_stops(
    command_s: Values, command: Values, stops: list[SilentStop]
) -> tuple[Values, Values]:
    """Return commands with a 0 where the robot stopped by itself."""
    stop_s = np.array([stop.stop_s for stop in stops])
    places = np.searchsorted(command_s, stop_s, side="right")
    return np.insert(command_s, places, stop_s), np.insert(command, places, 0.0)


def find_doubtful(stops: list[SilentStop], begins_s: Values, ends_s: Values) -> NDArray[np.bool_]:
    """Return the steps in which it is not known when the robot was told to stop."""
    doubtful = np.zeros(len(begins_s), dtype=bool)
    for stop in stops:
        doubtful |= (ends_s > stop.begin_s + _SILENCE_S) & (begins_s < stop.end_s)
    return doubtful
