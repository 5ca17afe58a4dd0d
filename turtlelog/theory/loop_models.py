"""The declared loops of a law as models of theory, or the reason why there is no model.

This module reads both runs and scenarios, because they have the same dotted keys.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, TypedDict

import numpy as np
from numpy.typing import NDArray

from turtlelog.effects import EFFECTS
from turtlelog.errors import TheoryError
from turtlelog.plants import PLANTS, Plant, read_plant
from turtlelog.run import Parameter
from turtlelog.run.loops import (
    COMMAND_WORDS,
    LIMIT_KEYS,
    PLANT_KEYS,
    SIGNAL_WORDS,
    ControlLoop,
    Declaration,
    read_number,
)
from turtlelog.scenario import Scenario, flatten_scenario
from turtlelog.theory.pid_loop import PidLoop, analyse_pid_loop, is_pid_stable
from turtlelog.theory.pid_stability import PidGains
from turtlelog.theory.process import Process
from turtlelog.theory.step_motion import JERK_KEYS, SLOPE_KEYS, StepLimits, find_step_limits

_Array = NDArray[np.float64]

_SCENARIO: Final = "from the scenario"


class Settings(TypedDict):
    """Arguments of theory's functions other than the gains."""

    period_s: float
    process: Process


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredTiming:
    """Period and dead time of a loop, measured on a run.

    Attributes:
        period_s: Sampling period [s].
        dead_time_s: Dead time from a pose to the plant [s].
        sources: Sources of the values, in words, by `period_s` and `dead_time_s`.
    """

    period_s: float
    dead_time_s: float
    sources: Mapping[str, str]


@dataclass(frozen=True, slots=True, kw_only=True)
class NeglectedSetting:
    """A setting of a scenario that theory's linear loop leaves out.

    Attributes:
        key: Dotted key.
        value: Value in the scenario.
    """

    key: str
    value: Parameter

    def describe(self) -> str:
        """Return key and value as text: `loop.jitter_s = 0.01`."""
        value = f"{self.value:g}" if isinstance(self.value, float) else self.value
        return f"{self.key} = {value}"


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopModel:
    """Model of a declared loop for theory.

    Without a model, the methods raise TheoryError; the message is the reason.

    Attributes:
        loop: Loop as the law declares it.
        gains: Gains of the controller; None if there is no model.
        process: Plant with all dead time; None if there is no model.
        period_s: Sampling period T [s]; None if there is no model.
        most_dead_time_s: Largest possible dead time [s]; None if the dead time cannot grow.
        growth: Possible cause of a longer dead time, in words.
        limit: Limit of the loop's command [m/s or rad/s]; infinite without a limit.
        limits: Limits of command and rate with the loop's largest step, which recommended gains
            allow for; None if nothing limits the acceleration.
        jitter_s: Mean delay by jitter, which the dead time includes [s].
        oscillates: Whether the robot oscillates, for which the model has a longer dead time.
        unmeasured: Reason why period and dead time are those of the scenario although a run was
            measured; empty otherwise.
        reason: Reason why theory has no model of the loop; empty if there is a model.
        sources: Sources of the values, in words, by `gains`, `plant`, `period_s`, `dead_time_s`.
        left_out: Settings of the scenario that the linear loop leaves out.
    """

    loop: ControlLoop
    gains: PidGains | None = None
    process: Process | None = None
    period_s: float | None = None
    most_dead_time_s: float | None = None
    growth: str = "queues"
    limit: float = math.inf
    limits: StepLimits | None = None
    jitter_s: float = 0.0
    oscillates: bool = False
    unmeasured: str = ""
    reason: str = ""
    sources: Mapping[str, str] = field(default_factory=dict)
    left_out: tuple[NeglectedSetting, ...] = ()

    def analyse(self) -> PidLoop:
        """Return the properties of the loop."""
        gains, settings = self.require()
        return analyse_pid_loop(gains, **settings)

    def require(self) -> tuple[PidGains, Settings]:
        """Return the gains and the other arguments of theory's functions."""
        if self.gains is None or self.process is None or self.period_s is None:
            raise TheoryError(f"{self.loop.name}: {self.reason}")
        return self.gains, {"period_s": self.period_s, "process": self.process}

    def require_latest(self) -> Settings:
        """Return period and process with the largest possible dead time."""
        _, settings = self.require()
        if self.most_dead_time_s is not None:
            settings["process"] = replace(settings["process"], dead_time_s=self.most_dead_time_s)
        return settings

    def counts_as_delay(self, key: str) -> bool:
        """Return whether the dead time includes the mean delay by a setting."""
        return self.jitter_s > 0.0 and key in _JITTERS

    def allows_for(self, key: str) -> bool:
        """Return whether recommended gains allow for a setting that the linear loop leaves out."""
        plant = PLANT_KEYS[self.loop.command]
        limits = SLOPE_KEYS[self.loop.command], JERK_KEYS[self.loop.command]
        own = f"{plant}bound", f"{plant}acceleration"
        return self.limits is not None and key in {self.loop.limit_key, *limits, *own}


_Parameters = Mapping[str, Parameter]


def model_loops(declaration: Declaration, parameters: _Parameters) -> tuple[LoopModel, ...]:
    """Return the models of a law's loops under a scenario, one for each declared loop.

    Args:
        declaration: Declaration of the law.
        parameters: Parameters of the scenario, by dotted key.
    """
    return tuple(model_loop(loop, parameters) for loop in declaration.loops)


def model_loop(
    loop: ControlLoop,
    parameters: _Parameters,
    *,
    timing: MeasuredTiming | str | None = None,
    sources: Mapping[str, str] | None = None,
) -> LoopModel:
    """Return the model of one loop.

    Args:
        loop: Loop of a law.
        parameters: Parameters of a run or a scenario, by dotted key.
        timing: Measured timing, or the reason why it is missing. Default: the timing of the
            scenario.
        sources: Sources of gains and plant. Default: the scenario.
    """
    told = {"gains": _SCENARIO, "plant": _SCENARIO, **(sources or {})}
    scheduled = find_timing(parameters)
    jitter_s = 0.0
    if timing is None and not isinstance(scheduled, str):
        jitter_s = scheduled.jitter_s
        with_jitter = ", with the mean delay by jitter" if jitter_s else ""
        from_scenario = {"period_s": _SCENARIO, "dead_time_s": f"{_SCENARIO}{with_jitter}"}
        timing = MeasuredTiming(
            period_s=scheduled.period_s, dead_time_s=scheduled.least_s, sources=from_scenario
        )
    timing = str(scheduled) if timing is None else timing
    dead_time_s = 0.0 if isinstance(timing, str) else timing.dead_time_s
    gains, process = read_gains(loop, parameters), read_process(loop, parameters, dead_time_s)
    reasons = [found for found in (gains, process, timing) if isinstance(found, str)]
    left_out = _list_neglected(loop, parameters)
    if isinstance(gains, str) or isinstance(process, str) or isinstance(timing, str):
        return LoopModel(loop=loop, reason="; ".join(dict.fromkeys(reasons)), left_out=left_out)
    is_timed = parameters.get("loop.trigger") == "timer"
    most_s = 0.0 if isinstance(scheduled, str) else scheduled.most_s
    grows = most_s > dead_time_s + _WHOLE * timing.period_s
    found = LoopModel(
        loop=loop,
        gains=gains,
        process=process,
        period_s=timing.period_s,
        most_dead_time_s=most_s + process.dead_time_s - dead_time_s if grows else None,
        growth="the age of the poses" if is_timed else "queues",
        limit=read_number(parameters, loop.limit_key, math.inf),
        limits=find_step_limits(loop, parameters),
        jitter_s=jitter_s,
        oscillates=bool(parameters.get(f"{PLANT_KEYS[loop.command]}oscillates")),
        sources={**told, **timing.sources},
        left_out=left_out,
    )
    try:
        is_pid_stable(gains, period_s=timing.period_s, process=process)
    except TheoryError as err:  # its numbers are out of theory's range
        return LoopModel(loop=loop, reason=str(err), left_out=left_out)
    return found


def list_known(models: Sequence[LoopModel]) -> list[LoopModel]:
    """Return the models without a reason against them."""
    return [model for model in models if not model.reason]


_WHOLE: Final = 1e-6
"""Share of a period within which a time in whole nanoseconds counts as a multiple of the period."""

_OF_SPEED: Final = ("speed_m_s", "noise_speed", "acceleration_m_s2", "jerk_m_s3")
"""Endings of keys that concern only the speed."""

_OF_PLANT: Final = ("gain", "dead_time_s", "lag_s")

_DEFAULTS: Final = flatten_scenario(Scenario())

_MODELLED: Final = frozenset(
    {
        *(key for key in _DEFAULTS if not key.startswith(("limits.", "loop."))),
        *(key for effect in EFFECTS for key in effect.modelled),
        *("goal.heading_rad", "start.precision", "plant.kind", "plant.period_s"),
        *(f"{key}{name}" for key in PLANT_KEYS.values() for name in _OF_PLANT),
    }
)
"""Keys that theory models, and keys without influence on the loop."""

_ADDED: Final = frozenset(
    {
        *(key for effect in EFFECTS for key in effect.added),
        *(key for plant in PLANTS.values() for key in plant.added),
    }
)
"""Keys that theory ignores and that cannot make an unstable loop stable. Disturbances and offsets
move the point of rest; limits bound the amplitude of an oscillation."""

_JITTERS: Final = ("loop.jitter_s", "sensing.jitter_s")

_BESIDE: Final = ("law.", "path.", "name", "max_duration_s", "seed", "format")
"""Keys that add only gains and a reference to a loop."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopTiming:
    """Sampling period and dead time of a loop.

    Attributes:
        period_s: Sampling period T [s].
        least_s: Smallest dead time from a pose to the plant, without the plant's own dead time [s].
        most_s: Largest dead time that lasts [s]; longer dead times are short exceptions.
        step_s: Resolution of the dead time between these limits [s]: the plant's period.
        jitter_s: Mean delay by jitter, which both dead times include [s].
    """

    period_s: float
    least_s: float
    most_s: float
    step_s: float
    jitter_s: float = 0.0


def read_gains(loop: ControlLoop, parameters: _Parameters) -> PidGains | str:
    """Return the gains of a loop for theory, or the reason why they are unknown."""
    if not loop.is_integrator:
        words = SIGNAL_WORDS[loop.signal], COMMAND_WORDS[loop.command]
        return f"theory knows no loop of {words[0]} under {words[1]}"
    if loop.gain is None:
        return "the law declares no constant proportional gain"
    if not (loop.is_proportional or loop.integral_gain or loop.derivative_gain):
        return "the law declares that its command is more than gain times error, but not its terms"
    found = []
    kinds = (loop.gain, loop.integral_gain, loop.derivative_gain, loop.derivative_filter)
    for key in kinds:
        value = 0.0 if key is None else parameters.get(key)
        if not isinstance(value, int | float) or isinstance(value, bool):
            return f"{key} is not known"
        found.append(float(value))
    try:
        return PidGains(kp=found[0], ki=found[1], kd=found[2], filter_s=found[3])
    except TheoryError as err:
        return str(err)


def read_process(loop: ControlLoop, parameters: _Parameters, dead_time_s: float) -> Process | str:
    """Return the process that a loop's command drives, or the reason why it is unknown.

    The gain is the larger of the gains forward and in reverse. A gain below 0 in either direction
    feeds errors of one sign back with the wrong sign, so that no gain of the law is stable.

    Args:
        loop: Loop of a law.
        parameters: Parameters of a run or a scenario.
        dead_time_s: Dead time in addition to that of the plant [s].
    """
    if unknown := _find_unknown_plant(parameters):
        return unknown
    key = PLANT_KEYS[loop.command]
    if parameters.get(f"{key}assumed"):
        return f"no log shows how the {COMMAND_WORDS[loop.command]} follows commands ({key}assumed)"
    own_s = read_number(parameters, f"{key}dead_time_s")
    gain = read_number(parameters, f"{key}gain", 1.0)
    reverse_gain = read_number(parameters, f"{key}reverse_gain", gain)
    for name, value in (("gain", gain), ("reverse_gain", reverse_gain)):
        if value < 0.0:
            wrong = f"{key}{name} = {value:g} feeds the error back with the wrong sign"
            return f"{wrong}, so no gain above 0 is stable"
    try:
        return Process(
            gain=max(gain, reverse_gain),
            lag_s=read_number(parameters, f"{key}lag_s"),
            dead_time_s=dead_time_s + own_s,
            low_pass_s=read_number(parameters, "shaping.low_pass_s"),
        )
    except TheoryError as err:
        return f"plant: {err}"


def find_timing(parameters: _Parameters) -> LoopTiming | str:
    """Return the timing of a scenario's loops, or the reason why theory cannot describe it."""
    if unknown := _find_unknown_plant(parameters):
        return unknown
    plant = read_plant(parameters)
    step_s = plant.period_s
    every = int(read_number(parameters, "loop.period_ticks", 1.0))
    period_s, delay_s = every * step_s, read_number(parameters, "sensing.delay_s")
    if parameters.get("loop.trigger") == "timer":
        period_s = read_number(parameters, "loop.period_s")
    if period_s > (_count_held_ticks(plant) + _WHOLE) * step_s:
        after = f"{plant.watchdog_ns / 1e9:g} s after a command"
        return f"{plant.name} stops by itself between two samples, {after}"
    delay_s += read_number(parameters, "loop.transport_delay_s")
    delay_s += read_number(parameters, "loop.transport_delay_ticks") * step_s
    queued = parameters.get("loop.queue_policy") == "one-per-tick"

    def find_effect(delay_s: _Array) -> _Array:
        """Return the times after which commands with these delays act [s]."""
        if plant.acts_in_steps:  # a command acts on the whole tick in which it arrives
            return step_s * np.floor(delay_s / step_s + _WHOLE)
        # A robot with a queue takes it at its next period.
        return step_s * np.ceil(delay_s / step_s - _WHOLE) if queued else delay_s

    jitters_s = [read_number(parameters, key) for key in ("sensing.jitter_s", "loop.jitter_s")]
    waits_s = most_wait_s = 0.0
    if queued and every == 1 and parameters.get("loop.trigger") != "timer":
        # One command leaves and one comes in each tick, so what waits first waits for good. No
        # pause makes it less: it drains commands while as many poses pile up, or a full queue.
        keys = ("start_backlog", "pose_queue", "command_queue")
        queues = [read_number(parameters, f"loop.{key}", 1.0) for key in keys]
        waits_s, most_wait_s = (min(queues) - 1.0) * step_s, (queues[2] - 1.0) * step_s
    if sum(jitters_s) <= waits_s:  # a late command only waits for less time
        jitters_s = [0.0, 0.0]
    poses_s, pose_shares = _spread_jitter(jitters_s[0], step_s)
    commands_s, shares = _spread_jitter(jitters_s[1], period_s)
    late_s = find_effect(delay_s + np.add.outer(poses_s, commands_s))
    fixed_s, delay_s = float(find_effect(np.array(delay_s))), float(pose_shares @ late_s @ shares)
    jitter_s = delay_s - fixed_s
    return LoopTiming(
        period_s=period_s,
        least_s=delay_s + waits_s,
        most_s=delay_s + most_wait_s + _find_most_age(parameters, step_s),
        step_s=step_s,
        jitter_s=jitter_s,
    )


def _count_held_ticks(plant: Plant) -> float:
    """Return for how many ticks a plant holds a command; in the next tick it stops by itself."""
    return math.inf if plant.watchdog_ns == math.inf else plant.watchdog_ns // plant.period_ns + 1


def _find_unknown_plant(parameters: _Parameters) -> str:
    """Return why theory has no model of a scenario's plant; empty if it has one."""
    plant = read_plant(parameters)
    kind = parameters.get("plant.kind", plant.name)
    is_known = kind in PLANTS and plant.dynamics != "other"
    return "" if is_known else f"theory knows no plant of the kind {kind}"


_MOST_WAITING: Final = 2000
"""Largest jitter in periods whose mean delay is computed. Beyond, a message is delayed by the whole
jitter, which is less than 3 % too much."""


def _spread_jitter(jitter_s: float, period_s: float) -> tuple[_Array, _Array]:
    """Return delays of messages with uniform jitter that do not overtake each other, and shares.

    The probability that a message and all earlier ones have arrived after x is the product of
    min(1, (x + k T) / J) over k.
    """
    if jitter_s > _MOST_WAITING * period_s or jitter_s == 0.0:
        return np.array([jitter_s]), np.ones(1)
    x_s = np.linspace(0.0, jitter_s, 1001)
    arrived = np.ones_like(x_s)
    for k in range(math.ceil(jitter_s / period_s)):
        arrived *= np.minimum(1.0, (x_s + k * period_s) / jitter_s)
    return 0.5 * (x_s[1:] + x_s[:-1]), np.diff(arrived)


def _list_neglected(loop: ControlLoop, parameters: _Parameters) -> tuple[NeglectedSetting, ...]:
    """Return the settings that theory's linear loop leaves out."""
    found = []
    for key, value in parameters.items():
        if key in _MODELLED or key.startswith(_BESIDE) or value == float("inf"):
            continue
        if key == loop.limit_key or (key not in LIMIT_KEYS.values() and _is_of(loop.command, key)):
            found.append(NeglectedSetting(key=key, value=value))
    return tuple(found)


def _is_of(command: str, key: str) -> bool:
    """Return whether a key belongs to a command, or to both commands."""
    if "turn_" in key:
        return command == "turn_rate"
    is_of_speed = key.endswith(_OF_SPEED) or key.startswith(PLANT_KEYS["speed"])
    return command == "speed" or not is_of_speed


def hides_stability(parameters: _Parameters) -> bool:
    """Return whether a neglected setting may stabilise a loop that is unstable in theory."""
    known = _MODELLED | _ADDED
    if _find_most_age(parameters, read_plant(parameters).period_s):
        return True
    return any(key not in known and not key.startswith(_BESIDE) for key in parameters)


def _find_most_age(parameters: _Parameters, step_s: float) -> float:
    """Return the largest age of the pose that a timer reads [s].

    The timer starts when a pose arrives. If the timer's period is not a multiple of the plant's
    period, a later pose may be up to one plant period old.
    """
    if parameters.get("loop.trigger") != "timer":
        return 0.0
    periods = read_number(parameters, "loop.period_s") / step_s
    return 0.0 if abs(periods - round(periods)) <= _WHOLE else step_s
