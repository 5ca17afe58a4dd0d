"""Notes on a scenario before it is run.

The notes name gains that are unstable in theory, and unused settings.
"""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from itertools import chain
from typing import Final

from turtlelog import theory
from turtlelog.display import describe_count
from turtlelog.effects import EFFECTS
from turtlelog.errors import TheoryError
from turtlelog.laws import find_law, list_unused_keys
from turtlelog.plants import read_plant
from turtlelog.run import Parameter
from turtlelog.run.loops import PLANT_KEYS, ControlLoop, Declaration, read_number
from turtlelog.scenario import Scenario, flatten_scenario, resolve_scenario
from turtlelog.simulate.class_law import declare_scenario

_ROUNDING: Final = 1e-9
"""Share of a limit within which a larger gain counts as equal to the limit, without a note."""

_DEFAULTS: Final = flatten_scenario(Scenario())


def list_scenario_notes(scenario: Scenario, *, given: Collection[str] = ()) -> tuple[str, ...]:
    """Return notes on a scenario before its run, one line each; empty if there is nothing to note.

    A gain gets a note if theory's linear loop is unstable with this gain. The loop includes the
    plant's time constant, the sampling period and the smallest dead time that the settings
    guarantee. The run itself may still end, or oscillate within the limits. No note is given for a
    loop without theory or without a declared gain. The same holds for a timing that is random or
    changes between samples, and for shaping other than a low-pass.

    Args:
        scenario: Scenario that will run; the code of its law is loaded if needed.
        given: Keys that the user set, as in `goal.x_m`, also those set to the default.

    Raises:
        ScenarioError: If the law cannot be loaded or may not run.
        LawError: If the law's declaration is wrong.
    """
    scenario = resolve_scenario(scenario)
    declaration = declare_scenario(scenario)
    parameters = flatten_scenario(scenario)
    unused = _describe_unused(scenario, declaration, parameters, given)
    unstable = [*_describe_signs(declaration, parameters)]
    unstable += _describe_unstable(declaration, parameters)
    idle = [one.notes(scenario) for one in EFFECTS if one.notes is not None]
    return (*unstable, *unused, *chain.from_iterable(idle))


def _describe_signs(declaration: Declaration, parameters: Mapping[str, Parameter]) -> Iterator[str]:
    """Yield the loops whose plant inverts the feedback.

    The open loop is real and negative for real z > 1, from minus infinity at 1 up to 0. For any
    gains, delays and lags, one pole of the closed loop therefore lies in this range.
    """
    for loop in declaration.loops:
        for name in ("gain", "reverse_gain"):
            key = f"{PLANT_KEYS[loop.command]}{name}"
            gain = read_number(parameters, key)
            if gain < 0.0 and not isinstance(theory.read_gains(loop, parameters), str):
                yield (
                    f"{loop.name}: {key} = {_write(gain)} feeds the error back with the wrong sign:"
                    f" theory's loop is unstable at any {loop.gain} above 0"
                )


def _describe_unstable(declaration: Declaration, parameters: Mapping[str, Parameter]) -> list[str]:
    timing = theory.find_timing(parameters)
    if isinstance(timing, str) or theory.hides_stability(parameters):
        return []
    found = []
    for loop in declaration.loops:
        gains = theory.read_gains(loop, parameters)
        process = theory.read_process(loop, parameters, timing.least_s)
        if isinstance(gains, str) or isinstance(process, str):
            continue
        in_ticks = read_plant(parameters).acts_in_steps
        if said := _judge(loop, gains, process, timing, in_ticks=in_ticks):
            found.append(f"{loop.name}: {said}; clipping only bounds its oscillation")
    return found


def _describe_timing(process: theory.Process, timing: theory.LoopTiming, *, in_ticks: bool) -> str:
    """Return a description of the period, dead time and lag."""
    words = [f"a period of {1e3 * timing.period_s:g} ms"]
    if process.lag_s > 0.0:
        words.append(f"a lag of {process.lag_s:g} s")
    if process.low_pass_s > 0.0:
        words.append(f"a low-pass of {process.low_pass_s:g} s")
    least = "" if timing.least_s == timing.most_s else " (the least it can be)"
    if not process.dead_time_s and not timing.most_s:
        words.append("no dead time")
    elif in_ticks:
        ticks = describe_count(round(process.dead_time_s / timing.step_s), "tick")
        words.append(f"a dead time of {ticks}{least}")
    else:
        words.append(f"a dead time of {process.dead_time_s:.6g} s{least}")
    return f"{', '.join(words[:-1])} and {words[-1]}"


def _judge(
    loop: ControlLoop,
    gains: theory.PidGains,
    process: theory.Process,
    timing: theory.LoopTiming,
    *,
    in_ticks: bool,
) -> str | None:
    """Return why a loop is unstable for every possible dead time; None otherwise."""
    others = ((loop.integral_gain, gains.ki), (loop.derivative_gain, gains.kd))
    values = [f"{key} = {_write(value)}" for key, value in others if value > 0.0]
    named = f"{loop.gain} = {_write(gains.kp)}"
    timed = _describe_timing(process, timing, in_ticks=in_ticks)
    words = f"theory's loop with {', '.join([*values, timed])}"
    is_plain = gains.kd == 0.0 and process.lag_s == process.low_pass_s == 0.0
    try:
        if not is_plain and timing.least_s < timing.most_s:
            # Limits rise with the dead time: the loop must be unstable at each.
            ticks = range(round((timing.most_s - timing.least_s) / timing.step_s) + 1)
            times_s = [process.dead_time_s + tick * timing.step_s for tick in ticks]
            is_stable = any(
                theory.is_pid_stable(
                    gains, period_s=timing.period_s, process=replace(process, dead_time_s=time_s)
                )
                for time_s in times_s
            )
            return None if is_stable else f"with {named} {words} is unstable"
        ranges = theory.find_stable_gains(gains, period_s=timing.period_s, process=process)
    except TheoryError:  # numbers beyond the range of theory
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


def _round_towards(limit: float, kp: float) -> str:
    """Return a limit with few digits, but enough digits to stay on its side of a gain."""
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
    """Return notes on unused settings that the user gave or that differ from their defaults."""
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
