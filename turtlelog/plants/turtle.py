"""A turtle without controller and queue, which can also move sideways and teleport."""

from dataclasses import dataclass
from math import cos, hypot, sin

from turtlelog.arithmetic import to_float32
from turtlelog.parts import Plant
from turtlelog.plants.turtlesim import TURTLESIM, WORLD_SIZE_M, begin, hold, move


@dataclass(frozen=True, slots=True)
class _Scene:
    period_ns: int
    period_s: float
    watchdog_ns: float
    is_pushed: bool = False


@dataclass(frozen=True, slots=True)
class _Settings:
    scene: _Scene


@dataclass(slots=True)
class _Teleport:
    """Target of a teleport: a relative motion, or a pose."""

    relative: bool
    first_m: float
    y_m: float
    angle_rad: float


class Turtle:
    """A turtle that integrates the command it holds."""

    __slots__ = ("_settings", "_state", "_teleports")

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

        If `is_rounded` is False, the pose is not rounded, as for a turtle that has already moved.
        The `plant` gives the length of a step. With `keeps_32_bits`, each step rounds the heading
        to 32 bits, before wrapping and after it: before Humble, `normalizeAngle` took and returned
        a `float`.
        """
        self._settings = _Settings(_Scene(plant.period_ns, plant.period_s, plant.watchdog_ns))
        self._state = begin(None, x_m, y_m, heading_rad, is_rounded=is_rounded)
        self._state.keeps_32_bits = keeps_32_bits
        self._teleports: list[_Teleport] = []

    def take_command(
        self, speed_m_s: float, turn_rate_rad_s: float, lateral_speed_m_s: float = 0.0
    ) -> None:
        """Hold a command from the next step on. The plant limits no command."""
        hold(self._settings, self._state, None, 0, speed_m_s, turn_rate_rad_s)
        self._state.lateral_speed = lateral_speed_m_s

    def teleport_to(self, x_m: float, y_m: float, heading_rad: float) -> None:
        """Request to be set to a pose in the world frame at the next step [m, m, rad]."""
        to = to_float32(x_m), to_float32(y_m), to_float32(heading_rad)
        self._teleports.append(_Teleport(False, *to))  # noqa: FBT003

    def teleport_by(self, forward_m: float, turn_rad: float) -> None:
        """Request to turn, then move along the new heading, at the next step [m, rad]."""
        by = to_float32(forward_m), 0.0, to_float32(turn_rad)
        self._teleports.append(_Teleport(True, *by))  # noqa: FBT003

    def step(self) -> None:
        """Move for one step: teleports, watchdog, turn, motion along the new heading, clamp."""
        for teleport in self._teleports:
            self._teleport(teleport)
        self._teleports.clear()
        move(self._settings, self._state, None, 0)

    def _teleport(self, to: _Teleport) -> None:
        state = self._state
        if to.relative:
            state.heading_rad += to.angle_rad
            state.x_m += cos(state.heading_rad) * to.first_m
            state.down_m -= sin(state.heading_rad) * to.first_m
        else:
            state.x_m = to.first_m
            state.down_m = max(0.0, to_float32(WORLD_SIZE_M - to.y_m))
            state.heading_rad = to.angle_rad

    @property
    def speed_m_s(self) -> float:
        """Velocity that the turtle holds along its heading [m/s]."""
        return self._state.speed

    @property
    def lateral_speed_m_s(self) -> float:
        """Velocity that the turtle holds to the left of its heading [m/s]."""
        return self._state.lateral_speed

    @property
    def turn_rate_rad_s(self) -> float:
        """Turn rate that the turtle holds, counter-clockwise [rad/s]."""
        return self._state.turn_rate

    @property
    def hit_wall(self) -> bool:
        """Whether the last step clamped the position to the world."""
        return self._state.hit_wall

    @property
    def state(self) -> tuple[float, float, float, float, float]:
        """Contents of a pose message, in double precision.

        Position x, y [m] and heading [rad] in the world frame, magnitude of the held velocity
        [m/s], held turn rate [rad/s].
        """
        state = self._state
        speed = hypot(state.speed, state.lateral_speed)
        return (state.x_m, WORLD_SIZE_M - state.down_m, state.heading_rad, speed, state.turn_rate)
