"""Parameters of sequential-p: gains, limits, tolerances, and the rule that ended the run."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np

from turtlelog.explain.scenario_from_log import (
    Certainty,
    Finding,
    bound_value,
    find_exactly,
    fit_value,
    gain_fit,
    leave_open,
    miss,
)
from turtlelog.explain.scenario_from_log.gain_fit import CommandFit, Reproduce
from turtlelog.explain.scenario_from_log.trace import Trace, Values
from turtlelog.laws import SequentialPParameters
from turtlelog.measure.motion import CERTAIN
from turtlelog.plants.turtlesim import TICK_NS
from turtlelog.run.angles import wrap_angle
from turtlelog.run.loops import DONE, PAUSE
from turtlelog.run.stop_reasons import SETTLED, STANDSTILL, TIMEOUT, WITHIN_TOLERANCE
from turtlelog.scenario import DEFAULT_LAW

ROTATE: Final = "rotate"
TRANSLATE: Final = "translate"
PHASES: Final = (ROTATE, TRANSLATE)
"""Phases of sequential-p in order, each with the name of its loop."""

_NOUNS: Final = {ROTATE: "rotation", TRANSLATE: "translation"}
_ADVERBS: Final = {ROTATE: "rotating", TRANSLATE: "translating"}

_HALF_TURN_SURE: Final = 6.0
"""Excess over half a turn from which a noisy error has wrapped, in standard deviations."""


def describe_phase(kind: str, phase: str) -> str:
    """Return a phase of a law in words: `the rotation`, `phase approach`."""
    if phase in {PAUSE, DONE}:
        return "the pause" if phase == PAUSE else "the run"
    return f"the {_NOUNS[phase]}" if kind == DEFAULT_LAW and phase in _NOUNS else f"phase {phase}"


def describe_loop_name(kind: str, loop: str) -> str:
    """Return the action of a law's loop, or else its name: `rotating`, `of align`."""
    return _ADVERBS.get(loop, f"of {loop}") if kind == DEFAULT_LAW else f"of {loop}"


def identify_rotation(trace: Trace) -> tuple[dict[str, Finding], CommandFit | None]:
    """Return gain, limit, tolerance and wrapping of the heading loop, by key of the scenario."""
    rows = slice(1, trace.rotating - trace.ended_rotation)
    error = trace.bearing_rad - trace.read_heading_rad
    command = trace.turn_rate_rad_s[rows]
    if not np.any(command):
        reason = "the run has no command that turns"
        return {
            "law.kp_angular": miss(reason, 1.0),
            "limits.turn_rate_rad_s": miss(reason, math.inf),
            "law.heading_tolerance_rad": bound_heading_tolerance(trace, error, None),
            "law.wrap_error": miss(reason, assumed=False),
        }, None
    noise = gain_fit.measure_pose_noise(np.unwrap(trace.read_heading_rad)[:, None])
    plain = gain_fit.fit_command(command, partial(np.multiply, error[rows]), noise)
    wrapped = gain_fit.fit_command(command, partial(np.multiply, wrap_angle(error[rows])), noise)
    size, wraps = np.abs(error[rows]), wrapped.is_certain
    evidence = "the heading error exceeds half a turn"
    if plain.is_certain != wrapped.is_certain and (size >= math.pi).any():
        wrap_finding = find_exactly(wraps, evidence)
    elif (size >= math.pi + _HALF_TURN_SURE * plain.noise.size).any():
        left = gain_fit.compute_gain_misfit(wrapped, command, wrap_angle(error[rows]))
        wraps = left < gain_fit.compute_gain_misfit(plain, command, error[rows])
        wrap_finding = fit_value(wraps, evidence)
    else:
        wraps = False
        wrap_finding = miss("the heading error stays within half a turn", assumed=False)
    fit = wrapped if wraps else plain
    error = wrap_angle(error) if wraps else error
    return {
        "law.kp_angular": gain_fit.describe_fitted_gain(fit),
        "limits.turn_rate_rad_s": gain_fit.describe_limit(fit),
        "law.heading_tolerance_rad": bound_heading_tolerance(trace, error, fit),
        "law.wrap_error": wrap_finding,
    }, fit


def identify_translation(trace: Trace) -> tuple[dict[str, Finding], CommandFit | None]:
    """Return gain, limit, tolerance and projection of the position loop, by key of the scenario."""
    rows = slice(trace.rotating, trace.rotating + trace.translating)
    command = trace.speed_m_s[rows]
    driven = command != 0.0
    if trace.goal_xy_m is None or not driven.any():
        known = "the log does not hold the goal" if driven.any() else "no command drives"
        return {
            "law.kp_linear": miss(known, 1.0),
            "limits.speed_m_s": miss(known, math.inf),
            "law.position_tolerance_m": miss(known, DEFAULT_TOLERANCE),
            "law.projection": miss(known, "heading"),
        }, None
    errors = np.subtract(trace.goal_xy_m, trace.read_xy_m[rows])
    along = {
        "bearing": np.full(int(driven.sum()), trace.bearing_rad),
        "heading": trace.read_heading_rad[rows][driven],
    }
    noise = gain_fit.measure_pose_noise(trace.read_xy_m)
    fits = {
        name: gain_fit.fit_command(command[driven], _project(errors[driven], headings), noise)
        for name, headings in along.items()
    }
    projection = _choose_projection(fits)
    fit = fits[projection.used]
    return {
        "law.kp_linear": gain_fit.describe_fitted_gain(fit),
        "limits.speed_m_s": gain_fit.describe_limit(fit),
        "law.position_tolerance_m": bound_position_tolerance(errors, command, fit),
        "law.projection": projection,
    }, fit


def _project(errors: Values, headings: Values) -> Reproduce:
    """Return the projection, computed in the law's order; numpy's cosine differs in one bit."""
    cosine = np.array([math.cos(heading) for heading in headings.tolist()])
    sine = np.array([math.sin(heading) for heading in headings.tolist()])
    x, y = errors.T.copy()

    def reproduce(gain: float) -> Values:
        return np.asarray(gain * x * cosine + gain * y * sine)

    return reproduce


def _choose_projection(fits: dict[str, CommandFit]) -> Finding:
    bearing, heading = fits["bearing"].gain, fits["heading"].gain
    if bearing is None or heading is None:
        signed = [name for name, fit in fits.items() if fit.has_signs]
        assumed = signed[0] if len(signed) == 1 else "bearing"
        return miss("every command is at its limit", assumed)
    if bearing.is_exact == heading.is_exact and (bearing.is_exact or bearing.is_close):
        return leave_open(tuple(fits), "both reproduce every command", "heading")
    for name, gain in (("bearing", bearing), ("heading", heading)):
        if gain.is_exact:
            return find_exactly(name, f"reproduces {gain.rows} unclipped commands")
    better, other = ("bearing", heading) if bearing.noise <= heading.noise else ("heading", bearing)
    found = fits[better].gain or other
    ratio = other.noise / found.noise if found.noise > 0.0 else math.inf
    if found.rows * math.log(max(ratio, 1.0)) < CERTAIN:
        return leave_open(tuple(fits), "noise hides the difference", better)
    return fit_value(better, f"the other leaves {ratio:.3g} times")


DEFAULT_TOLERANCE: Final = 0.001
"""Default tolerance of heading [rad] and position [m], if the log does not show it."""

_LAST_TWO: Final = "the errors at the end and before it"

_SURE: Final = 4.0
"""Standard deviations by which a bound from one noisy error is widened, so that it always holds
instead of in 95 % of cases."""


def bound_heading_tolerance(trace: Trace, error: Values, fit: CommandFit | None) -> Finding:
    """Bound the tolerance by the error that ended the rotation and the smallest that turned."""
    moving = slice(1, trace.rotating - trace.ended_rotation)
    ended = float(abs(error[trace.rotating - 1])) if trace.ended_rotation else 0.0
    if fit is not None and fit.gain is not None and not fit.is_certain:
        if fit.obstacle:
            return miss(fit.obstacle, DEFAULT_TOLERANCE)
        # The command shows its error more precisely than the noisy pose.
        commands = np.abs(trace.turn_rate_rad_s[moving])
        least = float(commands[commands > 0.0].min()) / fit.gain.interval[0]
        return _bound_by_noise(ended, least, "rad", (fit.gain.noise, 0.0))
    if not np.any(trace.turn_rate_rad_s[moving]):
        return miss("the run has no command that turns", DEFAULT_TOLERANCE)
    high = float(np.abs(error[moving]).min(initial=math.inf))
    if not trace.ended_rotation:
        return _bound_between(0.0, high, "the rotation has no end", "rad")
    return _bound_between(ended, high, _LAST_TWO, "rad")


def bound_position_tolerance(errors: Values, command: Values, fit: CommandFit) -> Finding:
    """Bound the tolerance by the error that ended the run and the smallest that still drove."""
    larger = np.abs(errors).max(axis=1)
    is_within = command[-1] == 0.0
    if fit.gain is not None and not fit.is_certain:
        if fit.obstacle:
            return miss(fit.obstacle, DEFAULT_TOLERANCE)
        driven = float(larger[command != 0.0][-1])
        ended = float(larger[-1]) if is_within else 0.0
        return _bound_by_noise(ended, driven, "m", (fit.gain.noise, fit.gain.noise))
    high = float(larger[command != 0.0].min())
    if not is_within:
        return _bound_between(0.0, high, "the run ends outside it", "m")
    return _bound_between(float(larger[-1]), high, _LAST_TWO, "m")


def _bound_by_noise(low: float, high: float, unit: str, noise: tuple[float, float]) -> Finding:
    """Return bounds from noisy errors, each widened by its noise."""
    low = max(low - _SURE * noise[0], 0.0)
    high += _SURE * noise[1]
    seen = f"noise; from the last errors and commands: {_name_bounds(low, high, unit)}"
    return miss(seen, _choose(low, high), (low, high))


def _bound_between(low: float, high: float, evidence: str, unit: str) -> Finding:
    if low >= high:
        return miss("errors that moved are no larger than the one that ended", DEFAULT_TOLERANCE)
    if low <= 0.0 or math.isinf(high):
        return miss(f"{evidence}: {_name_bounds(low, high, unit)}", _choose(low, high), (low, high))
    return bound_value(_choose(low, high), evidence, (low, high))


def _choose(low: float, high: float) -> float:
    """Return the default tolerance if it fits, otherwise the roundest number."""
    if low <= DEFAULT_TOLERANCE < high:
        return DEFAULT_TOLERANCE
    return find_round_number(low, min(high, 10.0 * low) if low > 0.0 else high)


def _name_bounds(low: float, high: float, unit: str) -> str:
    if unit == "rad":
        low, high, unit = math.degrees(low), math.degrees(high), "deg"
    if low <= 0.0:
        return f"below {high:.4g} {unit}"
    return f"at least {low:.4g} {unit}" + ("" if math.isinf(high) else f", below {high:.4g} {unit}")


_LEADING: Final = "1528346790"  # first digits of a number, more common digits first


def find_round_number(low: float, high: float) -> float:
    """Return the roundest number in [low, high), 0 < high: fewest digits, then common digits."""
    if low <= 0.0:
        return float(f"1e{int(np.ceil(np.log10(high))) - 1}")  # the power of ten below it
    for digits in range(1, gain_fit.DIGITS + 1):
        exponent = int(np.floor(np.log10(high))) - digits + 1
        found = []
        for place in range(exponent - 1, exponent + 1):
            first = int(np.ceil(low / 10.0**place))
            found += [float(f"{multiple}e{place}") for multiple in range(first, first + 20)]
        found = [number for number in found if low <= number < high]
        if found:
            return min(found, key=_rank)
    return low


def _rank(number: float) -> tuple[int, int]:
    digits = f"{number:.16e}".split("e")[0].rstrip("0").replace(".", "")
    return len(digits), _LEADING.index(digits[0])


_USUAL: Final = SequentialPParameters()

RULE_KEYS: Final = (
    *("law.timeout_s", "law.settled_within_m", "law.settled_for_s"),
    *("law.standstill_samples", "law.standstill_below"),
)
"""Parameters of the rules that end a run. These parameters have their defaults unless the log
contradicts."""

_SLACK_NS: Final = 1.5 * TICK_NS
"""Largest difference between the clocks of log and law: a callback may be a tick late."""

_ENDLESS_SAMPLES: Final = 1_000_000

_ROUND_DIGITS: Final = 2  # largest number of digits of a typed time or number


class Ending(NamedTuple):
    """The rule that ended a run (`stop_reason`), and rules with unusual values, by key."""

    reason: Finding
    rules: dict[str, Finding]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Rule:
    """A rule over the log's last samples, with the key and the default of its duration.

    Attributes:
        now: Time for which the condition has been true at the last sample; `before`, at the sample
            before it.
        longest: Longest earlier time for which the condition was true without ending the run.
        slack: Uncertainty of these durations.
    """

    name: str
    key: str
    usual: float
    now: float
    before: float
    longest: float
    slack: float
    evidence: str

    @property
    def ends_here(self) -> bool:
        return self.now + self.slack > self.usual >= self.before - self.slack

    @property
    def beyond(self) -> float:
        return max(self.longest, self.before - self.slack)

    @property
    def is_contradicted(self) -> bool:
        return self.beyond > self.usual


def find_stop_rule(trace: Trace, *, is_certain: bool, is_finished: bool) -> Ending:
    """Return the name of the law's rule that the last sample meets, or `cut`.

    A rule that would have ended the run earlier does not have its default value, and the log bounds
    it. `is_certain`: the commands follow the logged poses bit for bit. `is_finished`: the log shows
    that the controller finished.
    """
    speed = trace.speed_m_s[trace.rotating :]
    if not len(speed):
        return Ending(find_exactly("cut", "the log ends while the robot rotates"), {})
    rules = [_judge_standstill(trace), *_judge_times(trace)]
    contradicted = {
        rule.key: miss(
            f"the run goes on after {rule.beyond:.4g}: more than the usual {rule.usual:g}",
            _ENDLESS_SAMPLES if rule.name == STANDSTILL else math.inf,
            (rule.beyond, math.inf),
        )
        for rule in rules
        if rule.is_contradicted
    }
    if speed[-1] == 0.0:
        reason = _say(WITHIN_TOLERANCE, "the last command is 0", is_certain=is_certain)
        return Ending(reason, contradicted)
    met = [rule for rule in rules if rule.ends_here and not rule.is_contradicted]
    if met:
        needs_poses = met[0].name == SETTLED
        reason = _say(met[0].name, met[0].evidence, is_certain=is_certain or not needs_poses)
        return Ending(reason, contradicted)
    if not is_finished:
        evidence = "no rule of the law ends the run at the last sample"
        return Ending(_say("cut", evidence, is_certain=is_certain), contradicted)
    # The rules that may have ended the run if their values are not the defaults.
    likely = [rule for rule in rules if rule.now > rule.before > 0.0 and rule.now > rule.longest]
    # A rounder value was more likely typed.
    likely.sort(key=lambda rule: len(f"{_round_value(rule):.12g}".strip("0.")))
    for rule in likely[:1]:
        value = _round_value(rule)
        contradicted[rule.key] = miss(f"{value:.6g} would end the run as the log does", value)
    told = "the log says that the run ended, and no rule with its usual value ends it"
    if len(likely) < 2:
        known = [f"; with another {rule.name} would" for rule in likely]
        return Ending(miss("".join([told, *known])), contradicted)
    names = tuple(rule.name for rule in likely)
    return Ending(leave_open(names, told, names[0]), contradicted)


def _say(reason: str, evidence: str, *, is_certain: bool) -> Finding:
    certainty = Certainty.EXACT if is_certain else Certainty.FITTED
    return Finding(value=reason, certainty=certainty, evidence=evidence)


def _judge_standstill(trace: Trace) -> _Rule:
    still = np.abs(trace.speed_m_s[trace.rotating :]) < _USUAL.standstill_below
    counts = _count_held(still)
    # Missing rows count as well if the robot is at rest in the rows around them.
    number = trace.number[trace.rotating :]
    first = np.arange(len(counts)) - np.maximum(counts - 1, 0)
    counts = np.where(counts > 0, number - number[first] + 1, 0)
    return _Rule(
        name=STANDSTILL,
        key="law.standstill_samples",
        usual=_USUAL.standstill_samples,
        now=int(counts[-1]),
        before=int(counts[-1]) - 1,
        longest=int(counts[:-1].max(initial=0)),
        slack=0.0,
        evidence=f"{counts[-1]} samples below {_USUAL.standstill_below:g} m/s",
    )


def _judge_times(trace: Trace) -> Iterator[_Rule]:
    time_s = (trace.time_ns - trace.time_ns[0]) / 1e9
    slack = 0.0 if trace.has_exact_clock else _SLACK_NS / 1e9
    if trace.goal_xy_m is not None:
        driving = time_s[trace.rotating :]
        errors = np.abs(np.subtract(trace.goal_xy_m, trace.read_xy_m[trace.rotating :]))
        close = np.asarray((errors < _USUAL.settled_within_m).all(axis=1))
        held = _count_held(close)
        since = driving - driving[np.arange(len(close)) - np.maximum(held - 1, 0)]
        yield _Rule(
            name=SETTLED,
            key="law.settled_for_s",
            usual=_USUAL.settled_for_s,
            now=float(since[-1]),
            before=float(since[-2]) if len(since) > 1 else 0.0,
            longest=float(since[:-1].max(initial=0.0)) - slack,
            slack=slack,
            evidence=f"both errors below {_USUAL.settled_within_m:g} m for {since[-1]:.2f} s",
        )
    yield _Rule(
        name=TIMEOUT,
        key="law.timeout_s",
        usual=_USUAL.timeout_s,
        now=float(time_s[-1]),
        before=float(time_s[-2]) if len(time_s) > trace.rotating + 1 else 0.0,
        longest=0.0,
        slack=slack,
        evidence=f"{time_s[-1]:.2f} s after the first sample",
    )


def _count_held(holds: Any) -> Any:
    """Return, for each row, how many rows up to it a condition has been true."""
    rows = np.arange(1, len(holds) + 1)
    return rows - np.maximum.accumulate(np.where(holds, 0, rows))


def _round_value(rule: _Rule) -> float:
    if rule.key == "law.standstill_samples":
        return int(rule.before)
    low, high = max(rule.before - rule.slack, 1e-9), rule.now + rule.slack
    found = find_round_number(low, high)
    return found if len(f"{found:.12g}".strip("0.")) <= _ROUND_DIGITS + 1 else rule.before


def withhold_law(
    findings: Mapping[str, Finding], turning: CommandFit | None, driving: CommandFit | None
) -> dict[str, Finding]:
    """Remove findings of a loop whose commands are all clipped, unless a scenario reproduces it."""
    sides = (
        (turning, ("law.kp_angular", "limits.turn_rate_rad_s", "law.heading_tolerance_rad")),
        (driving, ("law.kp_linear", "limits.speed_m_s", "law.position_tolerance_m")),
    )
    return {
        key: miss(f"all {fit.rows} commands are alike in size: any law", findings[key].used)
        for fit, keys in sides
        if fit is not None and fit.gain is None
        for key in keys
    }
