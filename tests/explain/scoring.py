"""What an identification says, against the truth of the log."""

from collections import Counter
from statistics import mode
from typing import Any

import numpy as np

from tests.explain.truth import Log
from turtlelog.explain import Certainty, Finding, Identification

ATTRIBUTES = {
    "law.kp_angular": "kp_angular",
    "law.kp_linear": "kp_linear",
    "limits.turn_rate_rad_s": "turn_limit",
    "limits.speed_m_s": "speed_limit",
    "law.heading_tolerance_rad": "heading_tolerance",
    "law.position_tolerance_m": "position_tolerance",
    "law.wrap_error": "wrap",
    "law.pause_ticks": "pause",
    "law.timeout_s": "timeout_s",
    "law.settled_for_s": "settled_for_s",
    "law.settled_within_m": "settled_within",
    "law.standstill_samples": "standstill_samples",
    "law.standstill_below": "standstill_below",
    "loop.start_backlog": "backlog",
    "loop.pose_queue": "pose_queue",
    "loop.command_queue": "command_queue",
    "loop.transport_delay_ticks": "delay",
    "loop.period_ticks": "period",
}
"""Which attribute of a truth a key of the scenario is."""

CLAIMS = ("law.kp_angular", "law.kp_linear", "limits.turn_rate_rad_s", "limits.speed_m_s")
"""What is true of no other law."""


def list_truth(log: Log) -> dict[str, Any]:
    """Return the truth by key of a finding; what has none is left out."""
    truth = log.truth
    values: dict[str, Any] = {key: getattr(truth, name) for key, name in ATTRIBUTES.items()}
    values |= {
        "law.projection": "heading" if truth.on_heading else "bearing",
        "loop.queue_policy": "newest" if truth.newest else "one-per-tick",
        "loop.pose_precision": "float32",
        "stop_reason": log.reason,
        "lost_commands": sum(tick <= log.answered[-1] for tick in log.losses),
        "pause.held_turn_rate_rad_s": log.held,
        "pause.burst": log.burst,
        **dict(zip(("start.x_m", "start.y_m", "start.heading_rad"), truth.start, strict=True)),
        **dict(zip(("goal.x_m", "goal.y_m"), truth.goal, strict=True)),
    }
    if truth.law != "p":
        # Of another law no parameter is true.
        values = {key: None if key in CLAIMS else value for key, value in values.items()}
    return values | _list_dead_times(log)


def _list_dead_times(log: Log) -> dict[str, int | None]:
    found: dict[str, int | None] = {}
    for state, name in (("ROTACIONAR", "rotate"), ("TRANSLADAR", "translate")):
        rows = [row for row in log.taken if row < len(log.rows) and log.rows[row][-1] == state]
        late = rows[len(rows) // 2 :]
        found[f"dead_time.{name}"] = (
            mode(log.taken[row] - 1 - log.read[row] for row in late) if late else None
        )
    return found


def judge(finding: Finding, truth: Any) -> str:
    """Return `exact`, `fitted` ... and whether that is true, as `exact false` where it is not."""
    if finding.certainty is Certainty.AMBIGUOUS:
        holds = truth in finding.candidates
    elif finding.certainty is Certainty.EXACT:
        holds = bool(finding.value == truth)
    elif finding.interval is not None:
        low, high = finding.interval
        holds = finding.value is None if truth is None else bool(low <= truth <= high)
    elif finding.certainty is Certainty.UNKNOWN:
        holds = True
    else:
        holds = bool(finding.value == truth)
    return f"{finding.certainty.value} {str(holds).lower()}"


def score(log: Log, found: Identification) -> Counter[tuple[str, str]]:
    """Count the findings of one log by key and judgement."""
    truth = list_truth(log)
    with np.errstate(invalid="ignore"):
        return Counter(
            (key, judge(finding, truth[key]))
            for key, finding in found.findings.items()
            if key in truth
        )
