"""Events between phases, and the rule of the law that ended the run."""

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from turtlelog.explain.scenario_from_log.identification import (
    Certainty,
    Finding,
    find_exactly,
    leave_open,
    miss,
)
from turtlelog.explain.scenario_from_log.law_identification import find_round_number
from turtlelog.explain.scenario_from_log.loop_guesses import Hints
from turtlelog.explain.scenario_from_log.trace import Trace
from turtlelog.laws import SequentialPParameters
from turtlelog.plants.turtlesim import TICK_NS

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

_ROUND_DIGITS: Final = 2
"""Largest number of digits of a typed time or number."""

_PAUSE_KEYS: Final = (
    *("pause.seconds", "pause.held_turn_rate_rad_s", "pause.turned_rad", "pause.burst"),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Ending:
    """The law's rule that ended a run.

    Attributes:
        reason: Finding `stop_reason`.
        rules: Findings of rules with unusual values, by key of the scenario.
    """

    reason: Finding
    rules: dict[str, Finding]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Rule:
    """A rule over the log's last samples.

    Attributes:
        name: Name of the rule in the law.
        key: Key of the parameter that sets its duration.
        usual: Default value of the parameter.
        now: Time for which the condition has been true at the last sample.
        before: Time for which it had been true at the sample before.
        longest: Longest earlier time for which the condition was true without ending the run.
        slack: Uncertainty of these durations.
        evidence: Evidence in words.
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
    def is_contradicted(self) -> bool:
        return max(self.longest, self.before - self.slack) > self.usual


def find_pause(hints: Hints) -> dict[str, Finding]:
    """Return how long the controller was silent after rotating.

    The robot's motion in this time and the number of poses answered afterwards come from a
    simulation; see `describe_pause`.
    """
    if hints.pause_s is None:
        return dict.fromkeys(_PAUSE_KEYS, miss("the log does not show the end of a rotation"))
    reason = "no setting reproduces every sample"
    return {
        "pause.seconds": find_exactly(hints.pause_s, "from the last answer to the next one"),
        "pause.held_turn_rate_rad_s": miss(reason),
        "pause.burst": miss(f"{reason}; by the clock {hints.burst - 1} or {hints.burst}"),
    }


def find_stop_rule(trace: Trace, *, is_certain: bool, is_finished: bool) -> Ending:
    """Return the name of the law's rule that the last sample meets, or `cut`.

    A rule that would have ended the run earlier does not have its default value, and the log bounds
    it.

    Args:
        trace: Samples of the run.
        is_certain: Whether the commands follow the logged poses bit for bit.
        is_finished: Whether the log shows that the controller finished.
    """
    speed = trace.speed_m_s[trace.rotating :]
    if not len(speed):
        return Ending(reason=find_exactly("cut", "the log ends while the robot rotates"), rules={})
    rules = [_judge_standstill(trace), *_judge_times(trace)]
    contradicted = {rule.key: _describe_beyond(rule) for rule in rules if rule.is_contradicted}
    if speed[-1] == 0.0:
        return Ending(
            reason=_say("within_tolerance", "the last command is 0", is_certain=is_certain),
            rules=contradicted,
        )
    met = [rule for rule in rules if rule.ends_here and not rule.is_contradicted]
    if met:
        needs_poses = met[0].name == "settled"
        reason = _say(met[0].name, met[0].evidence, is_certain=is_certain or not needs_poses)
        return Ending(reason=reason, rules=contradicted)
    if not is_finished:
        evidence = "no rule of the law ends the run at the last sample"
        return Ending(reason=_say("cut", evidence, is_certain=is_certain), rules=contradicted)
    return _guess_rule(rules, contradicted)


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
        name="standstill",
        key="law.standstill_samples",
        usual=_USUAL.standstill_samples,
        now=int(counts[-1]),
        before=int(counts[-1]) - 1,
        longest=int(counts[:-1].max(initial=0)),
        slack=0.0,
        evidence=f"{counts[-1]} samples below {_USUAL.standstill_below:g} m/s",
    )


def _judge_times(trace: Trace) -> list[_Rule]:
    time_s = (trace.time_ns - trace.time_ns[0]) / 1e9
    slack = 0.0 if trace.has_exact_clock else _SLACK_NS / 1e9
    rules = []
    if trace.goal_xy_m is not None:
        driving = time_s[trace.rotating :]
        errors = np.abs(np.subtract(trace.goal_xy_m, trace.read_xy_m[trace.rotating :]))
        close = np.asarray((errors < _USUAL.settled_within_m).all(axis=1))
        held = _count_held(close)
        since = driving - driving[np.arange(len(close)) - np.maximum(held - 1, 0)]
        rules.append(
            _Rule(
                name="settled",
                key="law.settled_for_s",
                usual=_USUAL.settled_for_s,
                now=float(since[-1]),
                before=float(since[-2]) if len(since) > 1 else 0.0,
                longest=float(since[:-1].max(initial=0.0)) - slack,
                slack=slack,
                evidence=f"both errors below {_USUAL.settled_within_m:g} m for {since[-1]:.2f} s",
            )
        )
    before = float(time_s[-2]) if len(time_s) > trace.rotating + 1 else 0.0
    rules.append(
        _Rule(
            name="timeout",
            key="law.timeout_s",
            usual=_USUAL.timeout_s,
            now=float(time_s[-1]),
            before=before,
            longest=0.0,
            slack=slack,
            evidence=f"{time_s[-1]:.2f} s after the first sample",
        )
    )
    return rules


def _count_held(holds: Any) -> Any:
    """Return, for each row, how many rows up to it a condition has been true."""
    rows = np.arange(1, len(holds) + 1)
    return rows - np.maximum.accumulate(np.where(holds, 0, rows))


def _describe_beyond(rule: _Rule) -> Finding:
    seen = max(rule.longest, rule.before - rule.slack)
    is_count = rule.key == "law.standstill_samples"
    return miss(
        f"the run goes on after {seen:.4g}: more than the usual {rule.usual:g}",
        _ENDLESS_SAMPLES if is_count else math.inf,
        (seen, math.inf),
    )


def _guess_rule(rules: list[_Rule], contradicted: dict[str, Finding]) -> Ending:
    """Return the stop rules that may have ended a run if their values are not the defaults."""
    likely = [rule for rule in rules if rule.now > rule.before > 0.0 and rule.now > rule.longest]
    findings = dict(contradicted)
    # A rounder value was more likely typed.
    likely.sort(key=lambda rule: len(f"{_round_value(rule):.12g}".strip("0.")))
    for rule in likely[:1]:
        value = _round_value(rule)
        findings[rule.key] = miss(f"{value:.6g} would end the run as the log does", value)
    reason = "the log says that the run ended, and no rule with its usual value ends it"
    if len(likely) < 2:
        known = [f"; with another {rule.name} would" for rule in likely]
        return Ending(reason=miss("".join([reason, *known])), rules=findings)
    return Ending(
        reason=leave_open(tuple(rule.name for rule in likely), reason, likely[0].name),
        rules=findings,
    )


def _round_value(rule: _Rule) -> float:
    if rule.key == "law.standstill_samples":
        return int(rule.before)
    low, high = max(rule.before - rule.slack, 1e-9), rule.now + rule.slack
    found = find_round_number(low, high)
    return found if len(f"{found:.12g}".strip("0.")) <= _ROUND_DIGITS + 1 else rule.before
