"""Notes on a scenario before it is run.

They name gains that theory calls unstable, and parts of the scenario that its law does not use.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Final

from turtlelog.errors import TheoryError
from turtlelog.laws import find_law, list_unused_keys
from turtlelog.loops import ControlLoop, Declaration
from turtlelog.plants.turtlesim import TICK_S, TURTLESIM, WATCHDOG_NS
from turtlelog.run import Parameter
from turtlelog.scenario import LoopSettings, Scenario, flatten_scenario, resolve_scenario
from turtlelog.simulate.law_driver import declare_scenario
from turtlelog.theory import PidGains, find_stable_gains, is_pid_stable

_ROUNDING: Final = 1e-9
"""As a share of a limit: a gain no farther beyond it is at the limit, of which nothing is said."""

_LONGEST_HOLD_TICKS: Final = WATCHDOG_NS // TURTLESIM.period_ns + 1
"""A command is held for so many ticks; in the next the plant stops by itself."""

_DEFAULTS: Final = flatten_scenario(Scenario())

_UNDERSTOOD: Final = frozenset({*_DEFAULTS, "goal.heading_rad", "start.precision"})
"""Keys whose part in the loop is known here. Of a loop with any other nothing is claimed."""

_BESIDE_THE_LOOP: Final = ("law.", "path.")
"""Tables that add nothing to a loop but its gains and its reference."""


def list_scenario_notes(scenario: Scenario, *, given: Collection[str] = ()) -> tuple[str, ...]:
    """Return notes on a scenario that is to be run, one line each; () where there is none.

    A gain gets a note where theory's linear loop, with the sampling period and the least dead time
    that the scenario's settings make certain, is unstable. The run itself may still end, or go on
    in an oscillation that clipping bounds. Nothing is said of what is not known: a loop without
    theory or whose law declares no gain, a dead time between two samples.

    Args:
        scenario: As it is to be run; its law's code is loaded if need be.
        given: Keys that the user set, even if to the default, as in `goal.x_m`.

    Raises:
        ScenarioError: Where the law cannot be loaded or may not run.
        LawError: Where what the law says of itself is wrong.
    """
    scenario = resolve_scenario(scenario)
    declaration = declare_scenario(scenario)
    parameters = flatten_scenario(scenario)
    unused = _describe_unused(scenario, declaration, parameters, given)
    return (*_describe_unstable(scenario.loop, declaration, parameters), *unused)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Timing:
    """When theory's loop acts.

    Attributes:
        period_s: Sampling period [s].
        least: Dead time that is certain [samples].
        most: Dead time that it never exceeds for long [samples].
        words: Both, for the note.
    """

    period_s: float
    least: int
    most: int
    words: str


def _describe_unstable(
    settings: LoopSettings, declaration: Declaration, parameters: Mapping[str, Parameter]
) -> list[str]:
    others = {key for key in parameters if not key.startswith(_BESIDE_THE_LOOP)}
    timing = None if others - _UNDERSTOOD else _find_timing(settings)
    if timing is None:
        return []
    found = []
    for loop in declaration.loops:
        gains = _read_gains(loop, parameters)
        said = None if gains is None else _judge(loop, gains, timing)
        if said is not None:
            found.append(f"{loop.name}: {said}; clipping only bounds how far it swings")
    return found


def _find_timing(settings: LoopSettings) -> _Timing | None:
    """Return a loop's timing; None where a dead time is no whole number of samples.

    A part of a sample may steady a loop: without it P is stable up to Kp T = 2, with a quarter of a
    sample up to 4.
    """
    every, delay = settings.period_ticks, settings.transport_delay_ticks
    if delay % every or every > _LONGEST_HOLD_TICKS:
        return None
    least = most = delay // every
    if every == 1 and settings.queue_policy == "one-per-tick":
        # One command leaves and one comes in each tick, so what waits first waits for good. No
        # pause makes it less: it drains commands while as many poses pile up, or a full queue.
        queues = (settings.start_backlog, settings.pose_queue, settings.command_queue)
        least, most = delay + min(queues) - 1, delay + settings.command_queue - 1
    words = f"a period of {1e3 * TICK_S * every:g} ms and {_name_dead_time(least, most, every)}"
    return _Timing(period_s=TICK_S * every, least=least, most=most, words=words)


def _name_dead_time(least: int, most: int, every: int) -> str:
    if not most:
        return "no dead time"
    count = f"{least * every} tick{'' if least * every == 1 else 's'}"
    return f"a dead time of {count}{'' if least == most else ' (the least it can be)'}"


def _read_gains(loop: ControlLoop, parameters: Mapping[str, Parameter]) -> PidGains | None:
    """Return the gains of a loop that theory knows; None of another, and where one is not known."""
    kp = loop.read_gain(parameters)
    more = (loop.integral_gain, loop.derivative_gain, loop.derivative_filter)
    is_told = loop.is_proportional or loop.integral_gain or loop.derivative_gain
    if kp is None or not loop.is_integrator or not is_told:
        return None
    values = [0.0 if key is None else parameters.get(key) for key in more]
    numbers = [
        float(value)
        for value in values
        if isinstance(value, int | float) and not isinstance(value, bool)
    ]
    if len(numbers) != len(values):
        return None
    try:
        return PidGains(kp=kp, ki=numbers[0], kd=numbers[1], filter_s=numbers[2])
    except TheoryError:
        return None


def _judge(loop: ControlLoop, gains: PidGains, timing: _Timing) -> str | None:
    """Return why a loop is unstable at every dead time that it may have, None where it is not."""
    others = ((loop.integral_gain, gains.ki), (loop.derivative_gain, gains.kd))
    values = [f"{key} = {_write(value)}" for key, value in others if value > 0.0]
    named = f"{loop.gain} = {_write(gains.kp)}"
    words = f"theory's loop with {', '.join([*values, timing.words])}"
    try:
        if gains.kd > 0.0 and timing.least < timing.most:
            return _judge_each(gains, timing, f"with {named} {words}")
        ranges = find_stable_gains(gains, period_s=timing.period_s, dead_time_ticks=timing.least)
    except TheoryError:  # numbers beyond those that theory takes
        return None
    if not ranges:
        return f"at any {loop.gain} {words} is unstable"
    low, high = ranges[0][0], ranges[-1][1]
    if gains.kp > high * (1.0 + _ROUNDING):
        limit = _round_towards(high, gains.kp)
        return f"{named} is above {limit} {loop.gain_unit}, where {words} becomes unstable"
    if gains.kp < low * (1.0 - _ROUNDING):
        limit = _round_towards(low, gains.kp)
        return f"{named} is below {limit} {loop.gain_unit}, where {words} becomes stable"
    return None


def _judge_each(gains: PidGains, timing: _Timing, words: str) -> str | None:
    """Return that a loop with a derivative is unstable, whose limit may rise with the dead time."""
    for ticks in range(timing.least, timing.most + 1):
        if is_pid_stable(gains, period_s=timing.period_s, dead_time_ticks=ticks):
            return None
    return f"{words} is unstable"


def _round_towards(limit: float, kp: float) -> str:
    """Return a limit in few digits, as many as leave it on its side of a gain."""
    for digits in range(4, 17):
        text = f"{limit:.{digits}g}"
        if float(text) != kp and (float(text) < kp) == (limit < kp):
            return text
    return repr(limit)


def _write(value: float) -> str:
    return repr(value).removesuffix(".0")


def _describe_unused(
    scenario: Scenario,
    declaration: Declaration,
    parameters: Mapping[str, Parameter],
    given: Collection[str],
) -> list[str]:
    """Return that the law does not use what the user set: what is given, or not the default."""
    unused = [
        *([] if declaration.uses_goal else ["goal"]),
        *list_unused_keys(find_law(scenario.law.kind), scenario.law.parameters),
    ]
    found = {
        f"[{unused_key}]" if "." not in unused_key else unused_key
        for key, value in parameters.items()
        for unused_key in unused
        if f"{key}.".startswith(f"{unused_key}.") and (key in given or _DEFAULTS.get(key) != value)
    }
    shown = sorted(name for name in found if f"[{name.partition('.')[0]}]" not in found - {name})
    return [f"law {scenario.law.kind} does not use {' and '.join(shown)}"] if shown else []
