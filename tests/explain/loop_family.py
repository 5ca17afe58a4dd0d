"""Logs of laws other than the sequential one, whose loop is known."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from turtlelog.explain import Finding, identify_run
from turtlelog.run import Run
from turtlelog.scenario import build_scenario, nest_parameters
from turtlelog.simulate import simulate_run

LAWS = (
    ("examples/turn_and_drive.py:TurnAndDrive", "kp_angular"),
    ("tests/explain/other_laws.py:Weaving", "gain"),
    ("tests/strange_law.py:StrangeLaw", "gain_a"),
)
"""Each with one of its gains."""

NOISES = (0.0, 1e-4, 1e-3)
"""Added to logged poses [m, rad]."""

_GAINS = (1.5, 4.0)

_WITHOUT_PAUSE = {"tests/strange_law.py:StrangeLaw": {"law.hesitates_ticks": 0}}
"""A pause would leave another dead time after it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopLog:
    """A log and its truth, by key of a finding."""

    run: Run
    truth: dict[str, Any]
    trusts: bool


def make_loop_logs(seed: int, amount: int, *, is_usual: bool) -> Iterator[LoopLog]:
    """Yield logs; of every other one the law is trusted. `is_usual`: queues of 7 and 10."""
    rng = np.random.default_rng(seed)
    for number in range(amount):
        kind, gain = LAWS[number % len(LAWS)]
        values: dict[str, Any] = {
            "law.kind": kind,
            f"law.{gain}": float(rng.choice(_GAINS)),
            **_WITHOUT_PAUSE.get(kind, {}),
            "max_duration_s": 12.0,
            "loop.queue_policy": str(rng.choice(["newest", "one-per-tick"])),
            "loop.start_backlog": int(rng.integers(1, 8)),
            "loop.transport_delay_ticks": int(rng.integers(0, 7)),
            "loop.period_ticks": int(rng.choice([1, 1, 1, 5])),
            "loop.command_queue": 7 if is_usual else int(rng.integers(2, 11)),
            "loop.pose_queue": 10 if is_usual else int(rng.integers(1, 11)),
        }
        run = simulate_run(build_scenario(nest_parameters(values), trust_law=True))
        noise = NOISES[number // len(LAWS) % len(NOISES)]
        truth = {key: value for key, value in values.items() if key.startswith("loop.")}
        truth["dead_time"] = _count_dead_time(truth)
        if noise:
            xy_m = run.poses.xy_m + rng.normal(0.0, noise, run.poses.xy_m.shape)
            heading_rad = run.poses.heading_rad + rng.normal(0.0, noise, len(run.poses))
            run = replace(run, poses=replace(run.poses, xy_m=xy_m, heading_rad=heading_rad))
        yield LoopLog(run=run, truth=truth, trusts=number % 2 == 0)


def count_true(logs: Iterator[LoopLog]) -> Counter[tuple[str, str]]:
    """Return how many findings of each key and certainty hold the truth, and how many do not."""
    said: Counter[tuple[str, str]] = Counter()
    for log in logs:
        findings = identify_run(log.run, trust_law=log.trusts).findings
        for key, finding in findings.items():
            name = "dead_time" if key.startswith("dead_time.") else key
            if name in log.truth:
                said[name, _judge(finding, log.truth[name])] += 1
    return said


def _judge(finding: Finding, truth: Any) -> str:
    certainty = finding.certainty.value
    if finding.value is None:
        return f"{certainty} true"
    holds = finding.value == truth or truth in finding.candidates
    return f"{certainty} {'true' if holds else 'false'}"


def _count_dead_time(loop: dict[str, Any]) -> int:
    """Return the ticks that a command waits: in transport, and behind those that came before."""
    waits = loop["loop.queue_policy"] == "one-per-tick" and loop["loop.period_ticks"] == 1
    names = ("loop.start_backlog", "loop.command_queue", "loop.pose_queue")
    waiting = min(loop[name] for name in names) - 1 if waits else 0
    return int(loop["loop.transport_delay_ticks"] + waiting)
