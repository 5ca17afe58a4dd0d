"""turtlesim (ROS 2 Humble): fixed facts, and one turtle that moves as in the source.

Source of every formula: turtlesim's `turtle_frame.cpp` and `turtle.cpp` (`Turtle::update`), and
measurements on published logs.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, Final

from turtlelog.arithmetic import Direction, find_direction, floor, hypot, least, most, to_float32
from turtlelog.parts import Plant, PlantPart

TICK_NS: Final = 16_000_000
"""Duration of one plant step [ns]."""

TICK_S: Final = 0.016
"""Duration of one plant step [s]."""

WORLD_SIZE_M: Final = 11.088889122009277
"""Side length of the square world [m]: 499 / 45 as a 32-bit float. The origin is the lower left
corner."""

SPAWN_XY_M: Final = 5.544444561004639
"""Both coordinates of the spawn pose [m]: the middle of the world as a 32-bit float."""

WATCHDOG_NS: Final = 1_000_000_000
"""Time after the last taken command beyond which a turtle stops [ns]."""

_PI: Final = 3.14159265  # eight decimals, as in turtlesim's source
_TWO_PI: Final = 2.0 * _PI

TURTLESIM: Final = Plant(
    name="turtlesim",
    period_ns=TICK_NS,
    low_m=0.0,
    high_m=WORLD_SIZE_M,
    acts_in_steps=True,
    turns_first=True,
    holds_rates=True,
    dynamics="integrator",
    watchdog_ns=WATCHDOG_NS,
    has_live_logs=True,
)
"""Facts of turtlesim."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TurtlesimKeys:
    """No keys: turtlesim has no parameters."""


@dataclass(slots=True)
class TurtleState:
    """State of a turtle. Positions are y-down, as in turtlesim.

    Attributes:
        x_m: Position along x, world frame [m].
        down_m: Distance from the upper edge of the world [m].
        heading_rad: Heading, counter-clockwise from +x [rad].
        speed: Velocity that the turtle holds along its heading [m/s].
        lateral_speed: Velocity that the turtle holds to the left of its heading [m/s].
        turn_rate: Turn rate that the turtle holds [rad/s].
        push_speed: Disturbance of the speed [m/s].
        push_turn_rate: Disturbance of the turn rate [rad/s].
        applied_speed: Magnitude of the velocity in the last step [m/s].
        applied_turn_rate: Turn rate in the last step [rad/s].
        idle_ns: Time since the turtle took a command [ns].
        hit_wall: Whether the last step clamped the position to the world.
        keeps_32_bits: Whether each step rounds the heading to 32 bits twice: before and after
            wrapping. Releases older than Humble do this, because their `normalizeAngle` takes and
            returns a `float`.
        along: Direction of the heading.
    """

    x_m: float = 0.0
    down_m: float = 0.0
    heading_rad: float = 0.0
    speed: float = 0.0
    lateral_speed: float = 0.0
    turn_rate: float = 0.0
    push_speed: float = 0.0
    push_turn_rate: float = 0.0
    applied_speed: float = 0.0
    applied_turn_rate: float = 0.0
    idle_ns: int = 0
    hit_wall: bool = False
    keeps_32_bits: bool = False
    along: Direction = field(default_factory=Direction)


def begin(
    keys: Any, x_m: float, y_m: float, heading_rad: float, *, is_rounded: bool
) -> TurtleState:
    """Return a turtle that spawns at a pose, rounded to 32 bits like a spawned turtle.

    If `is_rounded` is False, the pose is not rounded, as for a turtle that has already moved.
    """
    del keys
    down_m = WORLD_SIZE_M - y_m
    if is_rounded:
        down_m = to_float32(WORLD_SIZE_M - to_float32(y_m))
        x_m, heading_rad = to_float32(x_m), to_float32(heading_rad)
    return TurtleState(x_m=x_m, down_m=down_m, heading_rad=heading_rad)


def hold(
    settings: Any, state: Any, rows: Any, time_ns: int, speed: float, turn_rate: float
) -> None:
    """Hold a command from the next step on. The plant limits no command."""
    state.speed, state.turn_rate = speed, turn_rate
    state.idle_ns = -settings.scene.period_ns


def push(settings: Any, state: Any, speed: float, turn_rate: float) -> None:
    """Add these disturbances to the rates in the next step."""
    state.push_speed, state.push_turn_rate = speed, turn_rate


def move(settings: Any, state: Any, rows: Any, time_ns: int) -> bool:
    """Move for one step: watchdog, disturbance, turn, motion along the new heading, clamp."""
    scene = settings.scene
    state.idle_ns += scene.period_ns
    if state.idle_ns > scene.watchdog_ns:
        state.speed = state.lateral_speed = state.turn_rate = 0.0
    forward, left, turn_rate = state.speed, state.lateral_speed, state.turn_rate
    if scene.is_pushed:
        forward, turn_rate = forward + state.push_speed, turn_rate + state.push_turn_rate
    heading_rad = state.heading_rad + turn_rate * scene.period_s
    if state.keeps_32_bits:
        heading_rad = to_float32(heading_rad)
    heading_rad -= _TWO_PI * floor((heading_rad + _PI) / _TWO_PI)
    if state.keeps_32_bits:
        heading_rad = to_float32(heading_rad)
    cosine, sine = find_direction(state.along, heading_rad)
    period_s = scene.period_s
    x_m = state.x_m + (cosine * forward * period_s - sine * left * period_s)
    down_m = state.down_m - (cosine * left * period_s + sine * forward * period_s)
    state.hit_wall = not (0.0 <= x_m <= WORLD_SIZE_M and 0.0 <= down_m <= WORLD_SIZE_M)
    if state.hit_wall:
        x_m = least(most(x_m, 0.0), WORLD_SIZE_M)
        down_m = least(most(down_m, 0.0), WORLD_SIZE_M)
    state.x_m, state.down_m, state.heading_rad = x_m, down_m, heading_rad
    state.applied_speed = abs(forward) if left == 0.0 else hypot(forward, left)
    state.applied_turn_rate = turn_rate
    return True


def read(state: Any) -> tuple[float, float, float, float, float]:
    """Return the contents of a pose message, in double precision.

    Position x, y [m] and heading [rad] in the world frame, magnitude of the applied velocity
    [m/s], applied turn rate [rad/s].
    """
    return (
        state.x_m,
        WORLD_SIZE_M - state.down_m,
        state.heading_rad,
        state.applied_speed,
        state.applied_turn_rate,
    )


PART: Final = PlantPart(
    name="turtlesim",
    meaning="the turtle of ROS 2, in its square world",
    Keys=TurtlesimKeys,
    find_facts=lambda _: TURTLESIM,
    State=TurtleState,
    begin=begin,
    hold=hold,
    push=push,
    move=move,
    read=read,
)


class Turtle:
    """A turtle without controller and queue, which can also move sideways and teleport."""

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
        scene = SimpleNamespace(
            period_ns=plant.period_ns,
            period_s=plant.period_s,
            watchdog_ns=plant.watchdog_ns,
            is_pushed=False,
        )
        self._settings = SimpleNamespace(scene=scene)
        self._state = begin(None, x_m, y_m, heading_rad, is_rounded=is_rounded)
        self._state.keeps_32_bits = keeps_32_bits
        self._teleports: list[Callable[[TurtleState], None]] = []

    def take_command(
        self, speed_m_s: float, turn_rate_rad_s: float, lateral_speed_m_s: float = 0.0
    ) -> None:
        """Hold a command from the next step on. The plant limits no command."""
        hold(self._settings, self._state, None, 0, speed_m_s, turn_rate_rad_s)
        self._state.lateral_speed = lateral_speed_m_s

    def teleport_to(self, x_m: float, y_m: float, heading_rad: float) -> None:
        """Request to be set to a pose in the world frame at the next step [m, m, rad]."""
        down_m = max(0.0, to_float32(WORLD_SIZE_M - to_float32(y_m)))
        pose = to_float32(x_m), down_m, to_float32(heading_rad)

        def set_pose(state: TurtleState) -> None:
            state.x_m, state.down_m, state.heading_rad = pose

        self._teleports.append(set_pose)

    def teleport_by(self, forward_m: float, turn_rad: float) -> None:
        """Request to turn, then move along the new heading, at the next step [m, rad]."""
        way_m, turned_rad = to_float32(forward_m), to_float32(turn_rad)

        def turn_and_move(state: TurtleState) -> None:
            state.heading_rad += turned_rad
            state.x_m += math.cos(state.heading_rad) * way_m
            state.down_m -= math.sin(state.heading_rad) * way_m

        self._teleports.append(turn_and_move)

    def step(self) -> None:
        """Move for one step: teleports, watchdog, turn, motion along the new heading, clamp."""
        for teleport in self._teleports:
            teleport(self._state)
        self._teleports.clear()
        move(self._settings, self._state, None, 0)

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
        speed = math.hypot(state.speed, state.lateral_speed)
        return (state.x_m, WORLD_SIZE_M - state.down_m, state.heading_rad, speed, state.turn_rate)
