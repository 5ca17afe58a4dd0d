"""Stops of a robot without a command: by its watchdog, or in a silence of the commands."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy
from numpy.lib.stride_tricks import sliding_window_view

from turtlelog.identify.held_response import HeldInput, Values, hold_commands

_WATCHDOG_S, SILENCE_S = 0.5, 0.4
"""Shortest time for which mobile bases wait before they stop by themselves [s], and the same with
an allowance for jitter."""

LOOK_S: Final = 0.3
"""Time for which a robot must be at rest before the end of a silence or a first command [s]."""

_JOINED_S: Final = 0.1
"""Time over which rates are averaged [s]; otherwise noise of poses would hide the time of a
stop."""

_STOPPED: Final = 0.1  # share of the largest rate in a silence below which the robot is at rest

_OBEYS: Final = 0.25
"""Share of the held command from which a robot still follows it: gains are at least 0.5. Before a
small command, the robot may have been ten times as fast."""

_ABOVE_NOISE: Final = 3.0
"""Smallest motion in a silence, as a multiple of the scatter of the poses at its end: noise of
1,000 poses spreads 2.5 times as far as noise of six."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SilentStop:
    """A stop of the robot without a command.

    Attributes:
        begin_s: Time of the last command [s].
        stop_s: Time at which the rate has dropped to half [s].
        zero_s: Time from which the robot acts as if commanded to 0 [s]: that of its watchdog, or
            `stop_s` if the log does not show a watchdog.
        end_s: Time of the next command, or of the last pose [s]; later for an unseen stop.
        is_seen: Whether the poses show the stop; else other silences do.
    """

    begin_s: float
    stop_s: float
    zero_s: float
    end_s: float
    is_seen: bool = True


def find_silent_stops(
    command_s: Values, command: Values, time_s: Values, moved: Values, *, memory_s: float
) -> list[SilentStop]:
    """Return the silences after a nonzero command in which a robot stops, or may stop.

    `time_s` are the times of the poses [s], shape (n + 1,), `moved` the steps between them, (n,).
    `memory_s` is the time for which a command acts [s].
    """
    if not len(command) or not len(moved):
        return []
    ends_s = np.append(command_s[1:], time_s[-1])
    silent = np.flatnonzero((ends_s - command_s > SILENCE_S) & (command != 0.0))
    rows = np.column_stack([command_s, ends_s, np.abs(command)])[silent].tolist()
    watchdog = _find_watchdog(command_s, command, rows, time_s, moved, memory_s)
    if watchdog:
        return watchdog
    long = [row for row in rows if row[1] - row[0] > SILENCE_S + LOOK_S]
    looks = (_look_at_silence(row[0], row[1], row[2], time_s, moved) for row in long)
    seen = [stop for stop in looks if stop is not None]
    if not seen:
        return []
    known, wait_s = {one.begin_s for one in seen}, min(one.stop_s - one.begin_s for one in seen)
    for begin_s, end_s, _ in rows:
        # The robot may also stop in silences that are too short to show its rest.
        is_near = -LOOK_S <= end_s - begin_s - wait_s <= LOOK_S + SILENCE_S
        if begin_s not in known and is_near and end_s - begin_s > _WATCHDOG_S:
            stop_s, until_s = min(begin_s + wait_s, end_s - 1e-9), end_s + LOOK_S
            seen.append(
                SilentStop(
                    begin_s=begin_s, stop_s=stop_s, zero_s=stop_s, end_s=until_s, is_seen=False
                )
            )
    return sorted(seen, key=lambda stop: stop.begin_s)


def hold_with_stops(command_s: Values, command: Values, zeros_s: Sequence[float]) -> HeldInput:
    """Return held commands with a 0 where the robot stopped without a command."""
    places = np.searchsorted(command_s, zeros_s, side="right")
    return hold_commands(np.insert(command_s, places, zeros_s), np.insert(command, places, 0.0))


def _look_at_silence(
    begin_s: float, end_s: float, held: float, time_s: Values, moved: Values
) -> SilentStop | None:
    at_s, way, rate_s, rate = _measure_rates(begin_s, end_s, time_s, moved)
    last_s = at_s[-1] - LOOK_S if len(at_s) else begin_s
    if len(at_s) < 4 or last_s <= begin_s:
        return None
    # The mean, because at a slow command noise of poses looks like motion.
    left = abs(float(way[-1] - np.interp(last_s, at_s, way))) / LOOK_S
    largest = float(rate.max(initial=0.0))
    still_moves = left > min(_STOPPED * largest, _OBEYS * held)
    # A robot at rest throughout does not stop.
    least = max(_OBEYS * held * SILENCE_S, _ABOVE_NOISE * float(np.ptp(way[at_s >= last_s])))
    if not largest or still_moves or float(np.abs(way).max()) <= least:
        return None
    stop_s = float(rate_s[np.flatnonzero(rate > 0.5 * largest)[-1]])
    return SilentStop(begin_s=begin_s, stop_s=stop_s, zero_s=stop_s, end_s=end_s)


def _measure_rates(
    begin_s: float, end_s: float, time_s: Values, moved: Values
) -> tuple[Values, Values, Values, Values]:
    """Return times and displacement in a silence, and times and magnitudes of joined rates."""
    first, after = np.searchsorted(time_s, [begin_s, end_s])
    way = np.concatenate([[0.0], np.cumsum(moved[first : max(after - 1, first)])])
    at_s = time_s[first:after]
    if not len(at_s):
        return at_s, way[:0], at_s, way[:0]
    before = np.interp(at_s - _JOINED_S, at_s, way)
    is_whole = at_s >= at_s[0] + _JOINED_S
    rate = np.abs(way - before)[is_whole] / _JOINED_S
    return at_s, way, at_s[is_whole] - 0.5 * _JOINED_S, rate


_FEWEST_FALLS: Final = 3
"""Number of silences in which the rate falls to half from which a watchdog is searched. A single
stop may have another cause."""

_MOST_BINS: Final = 6_000  # of `_JOINED_S`, from which a watchdog is searched: ten minutes

_COARSE_S, _FINE_S = 0.05, 0.01
"""Distances of the times of a watchdog that are tried [s]: first all, then near the best."""

_STOPS_SURELY: Final = 0.5
"""Largest share of the squares that held commands leave unexplained that may be left with a
watchdog. A robot without a watchdog is explained less with one."""


def _find_watchdog(
    command_s: Values, command: Values, silences: Sequence[Sequence[float]], time_s: Values,
    moved: Values, memory_s: float,
) -> list[SilentStop]:  # fmt: skip
    """Return the stops of a robot that stops a fixed time after its last command; else none.

    `silences` are begin [s], end [s] and magnitude of the held command.
    """
    falls_s = [_find_fall(row[0], row[1], row[2], time_s, moved) for row in silences]
    waits_s = [
        fall_s - row[0] for fall_s, row in zip(falls_s, silences, strict=True) if fall_s is not None
    ]
    if len(waits_s) < _FEWEST_FALLS:
        return []
    misfit = _StopMisfit(command_s, command, silences, time_s, moved, memory_s)
    tried = {float(one): misfit.measure(one) for one in np.arange(0.1, max(waits_s), _COARSE_S)}
    near_s = min(tried, key=lambda one: tried[one])
    fine = np.arange(near_s - _COARSE_S + _FINE_S, near_s + _COARSE_S, _FINE_S)
    tried |= {float(one): misfit.measure(one) for one in fine}
    wait_s = min(tried, key=lambda one: tried[one])
    if tried[wait_s] > _STOPS_SURELY * misfit.measure(np.inf):
        return []
    usual_s = float(np.median(waits_s))
    return [
        SilentStop(
            begin_s=row[0],
            stop_s=min(row[0] + usual_s, row[1] - 1e-9) if fall_s is None else fall_s,
            zero_s=row[0] + wait_s,
            end_s=row[1],
            is_seen=fall_s is not None,
        )
        for fall_s, row in zip(falls_s, silences, strict=True)
        if row[0] + wait_s < row[1]
    ]


def _find_fall(
    begin_s: float, end_s: float, held: float, time_s: Values, moved: Values
) -> float | None:
    """Return the time at which the rate falls to half in a silence [s]; None if it does not."""
    _, _, rate_s, rate = _measure_rates(begin_s, end_s, time_s, moved)
    largest = float(rate.max(initial=0.0))
    if largest <= _OBEYS * held or rate[-1] > 0.5 * largest:
        return None
    return float(rate_s[np.flatnonzero(rate > 0.5 * largest)[-1]])


class _StopMisfit:
    """Squares of the rates that no rising step response to the commands explains."""

    def __init__(
        self, command_s: Values, command: Values, silences: Sequence[Sequence[float]],
        time_s: Values, moved: Values, memory_s: float,
    ) -> None:  # fmt: skip
        """Average the rates over equal times; jumps are clipped."""
        # Divided by the largest, so that squares are finite.
        self._commands, self._silences = (command_s, command / np.abs(command).max()), silences
        moved = moved / (np.abs(moved).max() or 1.0)
        self._bins = round(memory_s / _JOINED_S)
        count = min(int((time_s[-1] - time_s[0]) / _JOINED_S), _MOST_BINS)
        way = np.concatenate([[0.0], np.cumsum(moved)])
        self._bounds_s = time_s[0] + _JOINED_S * np.arange(-self._bins, count + 1)
        rate = np.diff(np.interp(self._bounds_s[self._bins :], time_s, way)) / _JOINED_S
        self._rate = np.clip(rate, *np.quantile(rate, [0.01, 0.99])) if count else rate

    def measure(self, wait_s: float) -> float:
        """Return the squares that are left for a watchdog of some time [s]; none if infinite."""
        ends = [row[0] + wait_s for row in self._silences if row[0] + wait_s < row[1]]
        way = hold_with_stops(*self._commands, ends).place(self._bounds_s).way
        asked = np.diff(way) / _JOINED_S
        earlier = sliding_window_view(asked, self._bins + 1)[: len(self._rate)]
        squares = earlier.T @ earlier
        # The same sum of squares, of as many rows as unknowns.
        size = 1e-9 * float(np.trace(squares)) + np.finfo(float).tiny
        root = np.linalg.cholesky(squares + size * np.eye(len(squares)))
        along = np.linalg.solve(root, earlier.T @ self._rate)
        _, left = scipy.optimize.nnls(root.T, along)
        return float(self._rate @ self._rate - along @ along + left**2)
