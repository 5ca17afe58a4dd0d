"""A robot whose rates follow the command that it holds later and slowly; it knows no walls.

Per axis (speed along the heading, turn rate): rate = gain * exp(-dead_time s) / (lag s + 1) of the
commands, each of which holds until the next one. Between two switches a rate is exponential, and
rate, heading and way are known in closed form; the position is the integral of the speed along the
heading, by quadrature.
"""

from collections import deque
from collections.abc import Mapping
from functools import lru_cache
from math import cos, exp, expm1, inf, sin
from typing import Final, Protocol

import numpy as np

from turtlelog.angles import wrap_angle
from turtlelog.loops import read_number
from turtlelog.plants.turtlesim import TURTLESIM, Plant
from turtlelog.run import Run

LAGGED: Final = "lagged"
"""The kind of plant, as scenarios name it."""

LARGEST_M: Final = 1e6
"""Farthest from the origin that it starts or goes [m]: a double tells 0.1 nm apart there."""

LONGEST_PIECE: Final = 2.0
"""How far a piece of the quadrature turns [rad], plus its length in lags. 8 nodes are then right to
rounding, at 4 to 3e-13 of the way, at 8 no longer to 1e-9."""

SETTLED: Final = 1e-15
"""What the lag still adds to the way [m] or heading [rad] where a rate counts as constant: less
than a coordinate of 10 m can tell."""

MOST_TURN_RAD: Final = 1000.0
"""Turn within one advance that the quadrature follows [rad]; it would take forever with a loop that
runs away."""


@lru_cache(maxsize=1)
def find_gauss() -> tuple[tuple[float, float], ...]:
    """Return nodes and weights of Gauss and Legendre on [0, 1]."""
    # numpy's polynomials take time to load, which who simulates no such robot spares.
    nodes, weights = np.polynomial.legendre.leggauss(8)
    return tuple(
        (0.5 + 0.5 * float(node), 0.5 * float(weight))
        for node, weight in zip(nodes, weights, strict=True)
    )


def build_lagged_plant(period_ns: int) -> Plant:
    """Return the facts of such a robot that publishes a pose per period [ns]."""
    return Plant(
        name=LAGGED,
        period_ns=period_ns,
        low_m=-LARGEST_M,
        high_m=LARGEST_M,
        watchdog_ns=inf,
    )


def find_plant(run: Run) -> Plant:
    """Return the plant that a run is of; of a robot's own recordings no plant is known."""
    return read_plant(run.parameters)


def read_plant(parameters: Mapping[str, object]) -> Plant:
    """Return the plant of a run's or a scenario's parameters; turtlesim where they tell none."""
    period_s = read_number(parameters, "plant.period_s")
    if parameters.get("plant.kind") != LAGGED or not period_s:
        return TURTLESIM
    return build_lagged_plant(max(round(period_s * 1e9), 1))


class LaggedParameters(Protocol):
    """The numbers of such a robot, as the table `[plant]` of a scenario has them; None: 1 or 0."""

    @property
    def speed_gain(self) -> float | None:
        """Speed that a command of 1 m/s leads to [1]; 1 where it is None."""

    @property
    def speed_dead_time_s(self) -> float | None:
        """From the arrival of a command until the speed begins to follow [s]."""

    @property
    def speed_lag_s(self) -> float | None:
        """Time constant with which it follows [s]; 0: at once."""

    @property
    def turn_gain(self) -> float | None:
        """Turn rate that a command of 1 rad/s leads to [1]; 1 where it is None."""

    @property
    def turn_dead_time_s(self) -> float | None:
        """As of the speed [s]."""

    @property
    def turn_lag_s(self) -> float | None:
        """As of the speed [s]."""


class LaggedRobot:
    """A robot that is driven by commands that arrive, and moved to the times that are asked for.

    Its position is right to 1e-9 m, however long a command holds and however small a lag is, for a
    turn of up to 1,000 rad within one `advance`. Whatever happens at a time acts from that time on:
    a robot without lag and dead time has its new rate at the time at which the command arrives.
    """

    __slots__ = ("_heading_rad", "_now_ns", "_pushes", "_speed", "_turn", "_x_m", "_y_m")

    hit_wall: Final = False
    """There are no walls."""

    def __init__(
        self,
        parameters: LaggedParameters,
        *,
        x_m: float,
        y_m: float,
        heading_rad: float = 0.0,
    ) -> None:
        """Stand still at a pose [m, m, rad] at time 0; parameters: a scenario's `plant`."""
        self._speed = _Axis(
            parameters.speed_gain, parameters.speed_dead_time_s, parameters.speed_lag_s
        )
        self._turn = _Axis(parameters.turn_gain, parameters.turn_dead_time_s, parameters.turn_lag_s)
        self._pushes: deque[tuple[int, float, float]] = deque()
        self._x_m, self._y_m, self._heading_rad = x_m, y_m, heading_rad
        self._now_ns = 0

    def take_command(self, time_ns: int, speed_m_s: float, turn_rate_rad_s: float) -> None:
        """Let a command arrive [ns], [m/s], [rad/s]; it holds until the next one.

        No command arrives before an earlier one did, nor before the time to which the robot has
        moved.
        """
        self._speed.queue(time_ns, speed_m_s)
        self._turn.queue(time_ns, turn_rate_rad_s)

    def push(self, time_ns: int, speed_m_s: float, turn_rate_rad_s: float) -> None:
        """Add these rates after the lag, from a time on [ns], [m/s], [rad/s]; times as commands."""
        self._pushes.append((time_ns, speed_m_s, turn_rate_rad_s))

    def advance(self, time_ns: int) -> None:
        """Move to a time that is not in the past [ns]; what switches at that time has switched."""
        while (switch_ns := self._find_switch()) <= time_ns:
            self._move_to(int(switch_ns))
            self._speed.switch(self._now_ns)
            self._turn.switch(self._now_ns)
            while self._pushes and self._pushes[0][0] <= self._now_ns:
                _, self._speed.push, self._turn.push = self._pushes.popleft()
        self._move_to(time_ns)

    @property
    def state(self) -> tuple[float, float, float, float, float]:
        """What a pose message holds: rates of this instant, pushes included.

        Position x, y [m], heading in [-pi, pi) [rad], magnitude of the speed [m/s], turn rate
        [rad/s].
        """
        heading_rad = wrap_angle(self._heading_rad)
        return self._x_m, self._y_m, heading_rad, abs(self._speed.rate), self._turn.rate

    def _find_switch(self) -> float:
        pushed_ns = self._pushes[0][0] if self._pushes else inf
        return min(self._speed.next_ns, self._turn.next_ns, pushed_ns)

    def _move_to(self, time_ns: int) -> None:
        left_s = (time_ns - self._now_ns) / 1e9
        if left_s <= 0.0:
            return
        speed, turn = self._speed, self._turn
        turn_limit = MOST_TURN_RAD / left_s
        while True:
            is_straight = turn.is_settled and not turn.constant
            is_spin = speed.is_settled and not speed.constant
            if is_straight or is_spin or (speed.is_settled and turn.is_settled):
                self._move_along_arc(left_s)
                break
            pace = min(abs(turn.constant) + abs(turn.transient), turn_limit)
            pace += (not speed.is_settled) and 1.0 / speed.lag_s
            pace += (not turn.is_settled) and 1.0 / turn.lag_s
            pieces = int(left_s * pace / LONGEST_PIECE) + 1
            self._move_by_quadrature(left_s / pieces)
            if pieces == 1:
                break
            left_s -= left_s / pieces
        self._now_ns = time_ns

    def _move_along_arc(self, duration_s: float) -> None:
        """Drive a circle, or a line; the rest of a transient adds to its length and its turn."""
        way_m = self._speed.advance(duration_s)
        half_rad = 0.5 * self._turn.advance(duration_s)
        chord_m = way_m * (sin(half_rad) / half_rad) if half_rad else way_m
        middle_rad = self._heading_rad + half_rad
        self._x_m += chord_m * cos(middle_rad)
        self._y_m += chord_m * sin(middle_rad)
        self._heading_rad = wrap_angle(self._heading_rad + 2.0 * half_rad)

    def _move_by_quadrature(self, duration_s: float) -> None:
        x_m = y_m = 0.0
        for node, weight in find_gauss():
            time_s = node * duration_s
            heading_rad = self._heading_rad + self._turn.integrate(time_s)
            way_m = weight * self._speed.find_rate(time_s)
            x_m += way_m * cos(heading_rad)
            y_m += way_m * sin(heading_rad)
        self._x_m += duration_s * x_m
        self._y_m += duration_s * y_m
        self._speed.advance(duration_s)
        self._heading_rad = wrap_angle(self._heading_rad + self._turn.advance(duration_s))


class _Axis:
    """One rate: a constant part, and a transient that fades with the lag.

    Attributes:
        lag_s: Time constant [s].
        push: Rate that is added after the lag.
        transient: What the lag still lacks, or has too much.
        next_ns: When the target switches next; inf: it does not.
    """

    __slots__ = (
        "_dead_time_ns",
        "_gain",
        "_target",
        "_waiting",
        "lag_s",
        "next_ns",
        "push",
        "transient",
    )

    def __init__(self, gain: float | None, dead_time_s: float | None, lag_s: float | None) -> None:
        self._gain = 1.0 if gain is None else gain
        self._dead_time_ns = round((dead_time_s or 0.0) * 1e9)
        self.lag_s = lag_s or 0.0
        self._target = self.push = self.transient = 0.0
        self._waiting: deque[tuple[int, float]] = deque()
        self.next_ns: float = inf

    @property
    def constant(self) -> float:
        return self._target + self.push

    @property
    def rate(self) -> float:
        return self._target + self.transient + self.push

    @property
    def is_settled(self) -> bool:
        return abs(self.transient) * self.lag_s <= SETTLED

    def queue(self, time_ns: int, command: float) -> None:
        self._waiting.append((time_ns + self._dead_time_ns, self._gain * command))
        self.next_ns = self._waiting[0][0]

    def switch(self, time_ns: int) -> None:
        """Follow the commands whose dead time is over."""
        while self._waiting and self._waiting[0][0] <= time_ns:
            before, self._target = self._target, self._waiting.popleft()[1]
            if self.lag_s:
                self.transient += before - self._target
        self.next_ns = self._waiting[0][0] if self._waiting else inf

    def find_rate(self, time_s: float) -> float:
        """Return the rate after a time [s] without a switch."""
        if not self.transient:
            return self.constant
        return self.constant + self.transient * exp(-time_s / self.lag_s)

    def integrate(self, time_s: float) -> float:
        """Return the way, or turn, within a time [s] without a switch."""
        if not self.transient:
            return self.constant * time_s
        faded = -expm1(-time_s / self.lag_s)
        return self.constant * time_s + self.transient * self.lag_s * faded

    def advance(self, time_s: float) -> float:
        """Let a time pass [s]; return the way, or turn, within it."""
        way = self.integrate(time_s)
        if self.transient:
            self.transient *= exp(-time_s / self.lag_s)
        return way
