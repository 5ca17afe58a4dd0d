"""turtlesim (ROS 2 Humble): what is fixed about it, and one turtle as its source moves it.

Source of every formula: turtlesim's `turtle_frame.cpp` and `turtle.cpp` (`Turtle::update`), and
measurements on published logs.
"""

from array import array
from dataclasses import dataclass, replace
from math import cos, floor, hypot, sin
from typing import Final

TICK_NS: Final = 16_000_000
"""One plant step [ns]."""

TICK_S: Final = 0.016
"""One plant step [s]."""

WORLD_SIZE_M: Final = 11.088889122009277
"""Side of the square world [m]: 499 / 45 as a 32-bit float. The origin is its lower left corner."""

SPAWN_XY_M: Final = 5.544444561004639
"""Both coordinates of the spawn pose [m]: the middle of the world as a 32-bit float."""

WATCHDOG_NS: Final = 1_000_000_000
"""A turtle stops when more than this has passed since it last took a command [ns]."""

_PI: Final = 3.14159265  # eight decimals, as in turtlesim's source
_TWO_PI: Final = 2.0 * _PI


@dataclass(frozen=True, slots=True, kw_only=True)
class Plant:
    """The facts of a plant that the loop around it needs.

    Attributes:
        name: As people call it.
        period_ns: One step [ns].
        low_m: The least coordinate of start and goal [m].
        high_m: The largest [m].
        watchdog_ns: The plant stops when more than this has passed since it last took a command
            [ns], whatever its period; inf: it never does.
        steps_per_tick: Steps that take as long as one tick of the plant as it is; 1 but for a finer
            clock.
    """

    name: str
    period_ns: int
    low_m: float
    high_m: float
    watchdog_ns: float
    steps_per_tick: int = 1

    @property
    def period_s(self) -> float:
        """One step [s]."""
        return self.period_ns / 1e9

    def refine(self, times: int) -> "Plant":
        """Return the same plant with a clock that is so many times finer."""
        period_ns, rest = divmod(self.period_ns, times)
        if rest:
            raise ValueError(f"expected a divisor of {self.period_ns} ns, found {times}")
        return replace(self, period_ns=period_ns, steps_per_tick=self.steps_per_tick * times)


TURTLESIM: Final = Plant(
    name="turtlesim",
    period_ns=TICK_NS,
    low_m=0.0,
    high_m=WORLD_SIZE_M,
    watchdog_ns=WATCHDOG_NS,
)
"""turtlesim as it is."""


class Turtle:
    """A turtle that integrates the command it holds. Positions inside are y-down, as in turtlesim.

    Attributes:
        speed_m_s: Velocity along the heading that the last tick applied [m/s].
        lateral_speed_m_s: Velocity to the left of the heading [m/s].
        turn_rate_rad_s: Counter-clockwise [rad/s].
        hit_wall: Whether the last tick clamped the position to the world.
    """

    __slots__ = (
        "_down_m",
        "_heading_rad",
        "_idle_ns",
        "_keeps_32_bits",
        "_period_ns",
        "_period_s",
        "_teleports",
        "_watchdog_ns",
        "_x_m",
        "hit_wall",
        "lateral_speed_m_s",
        "speed_m_s",
        "turn_rate_rad_s",
    )

    def __init__(
        self,
        *,
        x_m: float,
        y_m: float,
        heading_rad: float = 0.0,
        is_rounded: bool = True,
        keeps_32_bits: bool = False,
        plant: Plant = TURTLESIM,
    ) -> None:
        """Spawn at a pose in the world frame [m, m, rad], rounded to 32 bits as spawning does.

        Unless `is_rounded`: then it stands there since it moved before. The `plant` says how long a
        step is. With `keeps_32_bits` each step rounds the heading to 32 bits, before it is wrapped
        and after: before Humble, `normalizeAngle` took and returned a `float`.
        """
        self._keeps_32_bits = keeps_32_bits
        self._period_ns, self._period_s = plant.period_ns, plant.period_s
        self._watchdog_ns = plant.watchdog_ns
        self._x_m, self._down_m, self._heading_rad = x_m, WORLD_SIZE_M - y_m, heading_rad
        if is_rounded:
            self._x_m = round_to_float32(x_m)
            self._down_m = round_to_float32(WORLD_SIZE_M - round_to_float32(y_m))
            self._heading_rad = round_to_float32(heading_rad)
        self._idle_ns = 0
        self._teleports: list[tuple[bool, float, float, float]] = []
        self.speed_m_s = self.lateral_speed_m_s = self.turn_rate_rad_s = 0.0
        self.hit_wall = False

    def take_command(
        self, speed_m_s: float, turn_rate_rad_s: float, lateral_speed_m_s: float = 0.0
    ) -> None:
        """Hold a command from the next step on; there is no limit in the plant."""
        self.speed_m_s = speed_m_s
        self.lateral_speed_m_s = lateral_speed_m_s
        self.turn_rate_rad_s = turn_rate_rad_s
        self._idle_ns = -self._period_ns

    def teleport_to(self, x_m: float, y_m: float, heading_rad: float) -> None:
        """Ask to be set to a pose in the world frame at the next step [m, m, rad]."""
        to = (round_to_float32(x_m), round_to_float32(y_m), round_to_float32(heading_rad))
        self._teleports.append((False, *to))

    def teleport_by(self, forward_m: float, turn_rad: float) -> None:
        """Ask to be turned, then moved along the new heading, at the next step [m, rad]."""
        self._teleports.append((True, round_to_float32(forward_m), 0.0, round_to_float32(turn_rad)))

    def step(self) -> None:
        """Move for one step: teleports, watchdog, turn, move along the new heading, clamp."""
        if self._teleports:
            self._apply_teleports()
        period_s = self._period_s
        self._idle_ns += self._period_ns
        if self._idle_ns > self._watchdog_ns:
            self.speed_m_s = self.lateral_speed_m_s = self.turn_rate_rad_s = 0.0
        heading_rad = self._heading_rad + self.turn_rate_rad_s * period_s
        if self._keeps_32_bits:
            heading_rad = round_to_float32(heading_rad)
        heading_rad -= _TWO_PI * floor((heading_rad + _PI) / _TWO_PI)
        if self._keeps_32_bits:
            heading_rad = round_to_float32(heading_rad)
        forward, left = self.speed_m_s, self.lateral_speed_m_s
        cosine, sine = cos(heading_rad), sin(heading_rad)
        x_m = self._x_m + (cosine * forward * period_s - sine * left * period_s)
        down_m = self._down_m - (cosine * left * period_s + sine * forward * period_s)
        self.hit_wall = not (0.0 <= x_m <= WORLD_SIZE_M and 0.0 <= down_m <= WORLD_SIZE_M)
        if self.hit_wall:
            x_m = min(max(x_m, 0.0), WORLD_SIZE_M)
            down_m = min(max(down_m, 0.0), WORLD_SIZE_M)
        self._x_m, self._down_m, self._heading_rad = x_m, down_m, heading_rad

    def _apply_teleports(self) -> None:
        for relative, first_m, y_m, angle_rad in self._teleports:
            if relative:
                self._heading_rad += angle_rad
                self._x_m += cos(self._heading_rad) * first_m
                self._down_m -= sin(self._heading_rad) * first_m
            else:
                self._x_m = first_m
                self._down_m = max(0.0, round_to_float32(WORLD_SIZE_M - y_m))
                self._heading_rad = angle_rad
        self._teleports.clear()

    @property
    def state(self) -> tuple[float, float, float, float, float]:
        """What a pose message holds, in double precision.

        Position x, y [m] and heading [rad] in the world frame, magnitude of the applied velocity
        [m/s], applied turn rate [rad/s].
        """
        return (
            self._x_m,
            WORLD_SIZE_M - self._down_m,
            self._heading_rad,
            hypot(self.speed_m_s, self.lateral_speed_m_s),
            self.turn_rate_rad_s,
        )


_CELL = array("f", [0.0])


def round_to_float32(value: float) -> float:
    """Return the nearest 32-bit float."""
    _CELL[0] = value
    return _CELL[0]
