"""Scenario: everything that determines a run, frozen and typed."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from msgspec import Meta

from turtlelog.escapes import escape_controls
from turtlelog.laws import ABSENT_BY_DEFAULT, MAY_BE_INFINITE, SequentialPParameters
from turtlelog.paths import Path
from turtlelog.plants.turtlesim import SPAWN_XY_M
from turtlelog.scenario.dotted_keys import DEFAULT_LAW
from turtlelog.scenario.effects import (
    Disturbance,
    Period,
    PlantChoice,
    Probability,
    Sensing,
    Shaping,
    Time,
    absent,
)

Positive = Annotated[float, Meta(gt=0.0)]

Count = Annotated[int, Meta(ge=1, le=1_000_000)]
Ticks = Annotated[int, Meta(ge=0, le=1_000_000)]
# No more than a turn either way: more is most likely meant in degrees.
Heading = Annotated[float, Meta(ge=-2.0 * math.pi, le=2.0 * math.pi)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Start:
    """Where the turtle spawns.

    Attributes:
        x_m: World frame [m].
        y_m: World frame [m].
        heading_rad: Counter-clockwise from +x [rad].
        precision: `float32`: rounded to 32 bits, as spawning does; `float64`: as given, where a
            turtle stands that moved before.
    """

    x_m: float = SPAWN_XY_M
    y_m: float = SPAWN_XY_M
    heading_rad: Heading = 0.0
    precision: Literal["float32", "float64"] = field(default="float32", metadata=ABSENT_BY_DEFAULT)


@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """Where it should go.

    Attributes:
        x_m: World frame [m].
        y_m: World frame [m].
        heading_rad: Final heading [rad], None where any will do.
    """

    x_m: float = 2.0
    y_m: float = 10.0
    heading_rad: Heading | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class LawTable:
    """The keys of a law whose code has not been loaded yet; `resolve_scenario` loads it.

    Attributes:
        values: As written, beside `kind`.
        sources: Where they were read, for error lines; the first named the law.
        is_trusted: Whether the user named the law; one that a recording names is not loaded.
    """

    values: Mapping[str, Any]
    sources: tuple[str, ...] = field(default=("scenario",), compare=False)
    is_trusted: bool = field(default=True, compare=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class LawChoice:
    """The law under test and its parameters.

    Attributes:
        kind: A built-in kind, `path.py:Class` or `package.module:Class`.
        parameters: The law's own frozen dataclass; a `LawTable` until its code is loaded.
    """

    kind: str = DEFAULT_LAW
    parameters: Any = field(default_factory=SequentialPParameters)


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Where the controller clips its commands; inf: nowhere.

    Attributes:
        speed_m_s: Largest magnitude of the forward speed [m/s].
        turn_rate_rad_s: Largest magnitude of the turn rate [rad/s].
        acceleration_m_s2: Largest magnitude of the change of the speed per second [m/s^2].
        turn_acceleration_rad_s2: Of the turn rate [rad/s^2].
        jerk_m_s3: Largest magnitude of the change of that acceleration per second [m/s^3].
        turn_jerk_rad_s3: Of the turn acceleration [rad/s^3].
    """

    speed_m_s: Positive = field(default=1.0, metadata=MAY_BE_INFINITE)
    turn_rate_rad_s: Positive = field(default=1.0, metadata=MAY_BE_INFINITE)
    acceleration_m_s2: Positive = absent(math.inf, may_be_infinite=True)
    turn_acceleration_rad_s2: Positive = absent(math.inf, may_be_infinite=True)
    jerk_m_s3: Positive = absent(math.inf, may_be_infinite=True)
    turn_jerk_rad_s3: Positive = absent(math.inf, may_be_infinite=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopSettings:
    """What lies between plant and controller.

    Attributes:
        period_ticks: The controller answers every n-th pose.
        start_backlog: Poses that wait when the controller starts; 1: none but the newest.
        pose_queue: Depth of the controller's pose queue.
        command_queue: Depth of the plant's command queue.
        queue_policy: `one-per-tick`: the plant takes one command per tick; `newest`: it takes the
            newest and drops the rest.
        transport_delay_ticks: Ticks between publication and arrival of a command.
        pose_precision: Precision of published poses.
        trigger: `pose`: the controller answers poses as they come; `timer`: it answers the newest
            pose every `period_s`.
        period_s: Period of the timer [s]; only where it triggers.
        transport_delay_s: Adds to the ticks between publication and arrival [s].
        jitter_s: Added to the transport of each command: from 0 to this, uniform [s]. No command
            overtakes another.
        loss_probability: That a published command does not arrive.
        repeat_probability: That a command arrives twice.
        late_probability: That a command is late.
        late_s: By how much [s].
    """

    period_ticks: Count = 1
    start_backlog: Count = 1
    pose_queue: Count = 10
    command_queue: Count = 7
    queue_policy: Literal["one-per-tick", "newest"] = "newest"
    transport_delay_ticks: Ticks = 0
    pose_precision: Literal["float32", "float64"] = "float32"
    trigger: Literal["pose", "timer"] = absent("pose")
    period_s: Period | None = None
    transport_delay_s: Time = absent(0.0)
    jitter_s: Time = absent(0.0)
    loss_probability: Probability = absent(0.0)
    repeat_probability: Probability = absent(0.0)
    late_probability: Probability = absent(0.0)
    late_s: Time = absent(0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenario:
    """Everything that determines a run. The defaults are the textbook's: no implementation effects.

    Attributes:
        name: Short name for tables and legends.
        max_duration_s: Simulated time after which a run is cut [s].
        seed: For effects that draw random numbers.
        start: Where the turtle spawns.
        goal: Where it should go.
        law: The law under test.
        limits: Where commands are clipped.
        loop: Queues, delays and precision.
        path: What a law that tracks a path follows; None where there is none.
        plant: What is driven.
        disturbance: What pushes it.
        sensing: How its pose is read.
        shaping: What becomes of the commands that the law wants.
    """

    name: str = "textbook"
    max_duration_s: Annotated[float, Meta(gt=0.0, le=1e6)] = 60.0
    seed: Annotated[int, Meta(ge=0)] = 0
    start: Start = field(default_factory=Start)
    goal: Target = field(default_factory=Target)
    law: LawChoice = field(default_factory=LawChoice)
    limits: Limits = field(default_factory=Limits)
    loop: LoopSettings = field(default_factory=LoopSettings)
    path: Path | None = None
    plant: PlantChoice = absent(PlantChoice())
    disturbance: Disturbance = absent(Disturbance())
    sensing: Sensing = absent(Sensing())
    shaping: Shaping = absent(Shaping())

    def __repr__(self) -> str:
        goal = f"goal ({self.goal.x_m:g}, {self.goal.y_m:g}) m"
        return escape_controls(f"<Scenario {self.name}: {self.law.kind}, {goal}>")
