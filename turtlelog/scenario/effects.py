"""The tables of a scenario that are absent by default: another plant, and effects around the loop.

Times in seconds (`_s`) are rounded to nanoseconds. Without any of these tables the plant is
turtlesim, and what the law wants is what it gets, up to the limits.
"""

from dataclasses import dataclass, field
from typing import Annotated, Any, Final, Literal

from msgspec import Meta

from turtlelog.errors import ParameterError
from turtlelog.laws import ABSENT_BY_DEFAULT, MAY_BE_INFINITE
from turtlelog.plants import LAGGED, LARGEST_M, TURTLESIM, Plant, build_lagged_plant

MOST_RAD_S: Final = 1e3
"""Fastest push of a turn rate, 160 turns a second [rad/s]: the way of the lagged robot is
integrated turn by turn, and more would take minutes."""

MOST_S: Final = 1e6
"""Longest time [s]."""

Probability = Annotated[float, Meta(ge=0.0, le=1.0)]
NotNegative = Annotated[float, Meta(ge=0.0)]
Size = Annotated[float, Meta(ge=0.0, le=LARGEST_M)]
Offset = Annotated[float, Meta(ge=-LARGEST_M, le=LARGEST_M)]
TurnSize = Annotated[float, Meta(ge=0.0, le=MOST_RAD_S)]
TurnOffset = Annotated[float, Meta(ge=-MOST_RAD_S, le=MOST_RAD_S)]
Period = Annotated[float, Meta(ge=0.001, le=1.0)]
Time = Annotated[float, Meta(ge=0.0, le=MOST_S)]


def absent(default: Any, *, may_be_infinite: bool = False) -> Any:
    """Return a field that stays out of a file while it has its default."""
    infinite = MAY_BE_INFINITE if may_be_infinite else {}
    return field(default=default, metadata={**ABSENT_BY_DEFAULT, **infinite})


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantChoice:
    """What is driven: the table `[plant]`.

    Attributes:
        kind: `turtlesim`: the turtle, with its walls and its period of 0.016 s, and no other key;
            `lagged`: a robot without walls. Per axis its rate is the command that it holds, times
            a gain, later by a dead time and behind a lag of first order.
        period_s: Time between two poses [s]; 0.05 where it is not given.
        speed_gain: Speed that a command of 1 m/s leads to [1]; 1 where it is not given.
        speed_dead_time_s: From the arrival of a command until the speed begins to follow [s].
        speed_lag_s: Time constant with which it follows [s].
        turn_gain: Turn rate that a command of 1 rad/s leads to [1]; 1 where it is not given.
        turn_dead_time_s: As of the speed [s].
        turn_lag_s: As of the speed [s].

    Raises:
        ParameterError: Where turtlesim is given a key of the other kind.
    """

    kind: Literal["turtlesim", "lagged"] = "turtlesim"
    period_s: Period | None = None
    speed_gain: Offset | None = None
    speed_dead_time_s: Time | None = None
    speed_lag_s: Time | None = None
    turn_gain: Offset | None = None
    turn_dead_time_s: Time | None = None
    turn_lag_s: Time | None = None

    def __post_init__(self) -> None:
        own = {name: getattr(self, name) for name in _ROBOT_DEFAULTS}
        given = {name: value for name, value in own.items() if value is not None}
        if self.kind == LAGGED:
            for name, value in (_ROBOT_DEFAULTS | given).items():
                object.__setattr__(self, name, value)
        elif given:
            name, value = next(iter(given.items()))
            raise ParameterError(f"{name}: expected none, for kind is {self.kind}, found {value!r}")

    @property
    def facts(self) -> Plant:
        """What the loop around the plant needs to know of it."""
        if self.kind != LAGGED:
            return TURTLESIM
        return build_lagged_plant(round((self.period_s or 0.0) * 1e9))


_ROBOT_DEFAULTS: Final = {
    "period_s": 0.05,
    "speed_gain": 1.0,
    "speed_dead_time_s": 0.0,
    "speed_lag_s": 0.0,
    "turn_gain": 1.0,
    "turn_dead_time_s": 0.0,
    "turn_lag_s": 0.0,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Disturbance:
    """What is added to the rates of the plant, after its lag: the table `[disturbance]`.

    Attributes:
        speed_m_s: Push along the heading [m/s].
        turn_rate_rad_s: Push of the turn rate, counter-clockwise [rad/s].
        from_s: The pushes and the noise begin [s].
        to_s: They end [s]; inf: with the run.
        noise_speed: White noise of the speed [m/s times the root of a second]: after a time t the
            way has a standard deviation of the noise times the root of t.
        noise_turn_rate: White noise of the turn rate [rad/s times the root of a second].
    """

    speed_m_s: Offset = absent(0.0)
    turn_rate_rad_s: TurnOffset = absent(0.0)
    from_s: Time = absent(0.0)
    to_s: NotNegative = absent(float("inf"), may_be_infinite=True)
    noise_speed: Size = absent(0.0)
    noise_turn_rate: TurnSize = absent(0.0)

    @property
    def acts(self) -> bool:
        """Whether anything is added."""
        return any((self.speed_m_s, self.turn_rate_rad_s, self.noise_speed, self.noise_turn_rate))


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensing:
    """What lies between the plant's pose and the pose that is read: the table `[sensing]`.

    A pose is biased, made noisy, perhaps made an outlier, then rounded to the quantum, and arrives
    after its delay unless it drops out. x and y are treated alike, each with a noise of its own.

    Attributes:
        noise_position_m: Standard deviation of the noise of x and of y [m].
        noise_heading_rad: Standard deviation of the noise of the heading [rad].
        bias_position_m: Added to x and to y [m].
        bias_heading_rad: Added to the heading [rad].
        quantum_position_m: Step to which x and y are rounded [m]; 0: none.
        quantum_heading_rad: Step to which the heading is rounded [rad]; 0: none.
        dropout_probability: That a pose does not arrive.
        outlier_probability: That a pose is an outlier.
        outlier_m: How far away an outlier lies, in any direction [m].
        outlier_rad: By how much its heading is off, to either side [rad].
        delay_s: From a pose to its arrival at the controller [s].
        jitter_s: Added to the delay: from 0 to this, uniform [s]. No pose overtakes another.
    """

    noise_position_m: Size = absent(0.0)
    noise_heading_rad: Size = absent(0.0)
    bias_position_m: Offset = absent(0.0)
    bias_heading_rad: Offset = absent(0.0)
    quantum_position_m: Size = absent(0.0)
    quantum_heading_rad: Size = absent(0.0)
    dropout_probability: Probability = absent(0.0)
    outlier_probability: Probability = absent(0.0)
    outlier_m: Size = absent(0.0)
    outlier_rad: Size = absent(0.0)
    delay_s: Time = absent(0.0)
    jitter_s: Time = absent(0.0)

    @property
    def changes_poses(self) -> bool:
        """Whether what is read differs from the plant's poses: only then it is recorded."""
        noise = self.noise_position_m or self.noise_heading_rad
        bias = self.bias_position_m or self.bias_heading_rad
        quantum = self.quantum_position_m or self.quantum_heading_rad
        return bool(
            noise or bias or quantum or self.dropout_probability or self.outlier_probability
        )

    @property
    def delays_poses(self) -> bool:
        """Whether poses arrive later than they are published."""
        return bool(self.delay_s or self.jitter_s)


@dataclass(frozen=True, slots=True, kw_only=True)
class Shaping:
    """What becomes of the wanted commands before the limits: the table `[shaping]`.

    In this order: a low-pass filter, the dead zone, rounding to the quantum.

    Attributes:
        low_pass_s: Time constant of a filter of first order on both commands [s]; 0: none.
        dead_zone_speed_m_s: Speeds of a smaller magnitude become 0, others stay [m/s].
        dead_zone_turn_rate_rad_s: Turn rates likewise [rad/s].
        quantum_speed_m_s: Step to which the speed is rounded [m/s]; 0: none.
        quantum_turn_rate_rad_s: Step to which the turn rate is rounded [rad/s]; 0: none.
    """

    low_pass_s: Time = absent(0.0)
    dead_zone_speed_m_s: Size = absent(0.0)
    dead_zone_turn_rate_rad_s: Size = absent(0.0)
    quantum_speed_m_s: Size = absent(0.0)
    quantum_turn_rate_rad_s: Size = absent(0.0)

    @property
    def acts(self) -> bool:
        """Whether commands may change."""
        dead_zone = self.dead_zone_speed_m_s or self.dead_zone_turn_rate_rad_s
        quantum = self.quantum_speed_m_s or self.quantum_turn_rate_rad_s
        return bool(self.low_pass_s or dead_zone or quantum)
