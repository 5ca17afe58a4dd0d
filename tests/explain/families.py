"""Families of logs with known truth: what befalls people's recordings."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from tests.explain.truth import Log, Truth, make_log

Change = Callable[[Log, np.random.Generator], Log]


@dataclass(frozen=True, slots=True, kw_only=True)
class Family:
    """Logs of one kind.

    Attributes:
        meaning: What sets them apart, in one clause.
        fixed: Attributes of their truths that are not drawn.
        drawn: Further attributes, drawn for each.
        change: What is done to a log afterwards.
    """

    meaning: str
    fixed: dict[str, Any]
    drawn: Callable[[np.random.Generator], dict[str, Any]] | None = None
    change: Change | None = None


def _cut(log: Log, rng: np.random.Generator) -> Log:
    return replace(
        log.drop(range(int(rng.integers(12, len(log.rows))), len(log.rows))), reason="cut"
    )


def _lose_rows(log: Log, rng: np.random.Generator) -> Log:
    return log.drop(rng.integers(10, len(log.rows) - 1, int(rng.integers(1, 4))).tolist())


def _lose_stretch(log: Log, rng: np.random.Generator) -> Log:
    first = int(rng.integers(10, max(len(log.rows) - 80, 11)))
    return log.drop(range(first, min(first + int(rng.integers(5, 60)), len(log.rows) - 1)))


def _start_between_floats(rng: np.random.Generator) -> dict[str, Any]:
    x, y = rng.uniform(3.0, 8.0, 2).tolist()
    return {"start": (x, y, float(rng.uniform(-3.0, 3.0))), "on_heading": False}


def _teleport(rng: np.random.Generator) -> dict[str, Any]:
    x, y = rng.uniform(2.0, 9.0, 2).tolist()
    tick = int(rng.integers(20, 400))
    return {"teleports": {tick: (x, y, float(rng.uniform(-3.0, 3.0)))}}


def _delay(rng: np.random.Generator) -> dict[str, Any]:
    return {"delay": int(rng.integers(1, 8))}


def _depth(rng: np.random.Generator) -> dict[str, Any]:
    return {"command_queue": int(rng.integers(3, 11)), "delay": int(rng.integers(0, 3))}


def _stop(rng: np.random.Generator) -> dict[str, Any]:
    rules: list[dict[str, Any]] = [
        {"timeout_s": math.inf, "kp_linear": float(rng.uniform(0.08, 0.2)), "cut_s": 45.0},
        {"timeout_s": 8.0},
        {"settled_for_s": float(rng.choice([1.0, 2.0, 9.0]))},
        {"standstill_samples": int(rng.choice([20, 250]))},
        {"settled_within": 0.05, "settled_for_s": 2.0},
    ]
    return rules[int(rng.integers(5))]


def _law(rng: np.random.Generator) -> dict[str, Any]:
    return {"law": str(rng.choice(["pid", "cubic", "bang"]))}


FAMILIES = MappingProxyType(
    {
        "clean": Family(meaning="whole, without noise", fixed={}),
        "cut": Family(meaning="cut anywhere", fixed={}, change=_cut),
        "cut delay": Family(meaning="cut anywhere, with a transport delay", fixed={}, drawn=_delay,
                            change=_cut),
        "depths": Family(meaning="other depths of the command queue", fixed={}, drawn=_depth),
        "delay": Family(meaning="with a transport delay", fixed={}, drawn=_delay),
        "period": Family(meaning="every second pose answered", fixed={"period": 2}),
        "second": Family(meaning="a second run without a reset", fixed={},
                         drawn=_start_between_floats),
        "stops": Family(meaning="other stop rules", fixed={}, drawn=_stop),
        "rows": Family(meaning="one to three rows missing", fixed={}, change=_lose_rows),
        "gap": Family(meaning="a stretch missing", fixed={}, change=_lose_stretch),
        "jump": Family(meaning="a teleport", fixed={}, drawn=_teleport),
        "laws": Family(meaning="other laws", fixed={}, drawn=_law),
        "sensed 1e-4": Family(meaning="noise in what the controller reads", fixed={"noise": 1e-4}),
        "sensed 1e-2": Family(meaning="noise in what the controller reads", fixed={"noise": 1e-2}),
        **{f"misread {size:.0e}".replace("e-0", "e-"):
           Family(meaning="noise in what the controller reads, not logged",
                  fixed={"hidden_noise": size}) for size in (1e-5, 1e-4, 1e-3)},
        "logged 1e-4": Family(meaning="noise in the log alone", fixed={"log_noise": 1e-4}),
        "logged 1e-2": Family(meaning="noise in the log alone", fixed={"log_noise": 1e-2}),
        "logged 1e-2, cut": Family(meaning="noise in the log alone, cut", fixed={"log_noise": 1e-2},
                                   change=_cut),
        "quantum": Family(meaning="read in steps of 1 mm and 1 mrad", fixed={"quantum": 1e-3}),
        "quantum in the log": Family(meaning="logged in steps of 0.1 mm and 0.1 mrad",
                                     fixed={"log_quantum": 1e-4}),
    }
)  # fmt: skip


def make_family(name: str, seed: int, amount: int) -> Iterator[Log]:
    """Yield logs of a family; runs of other seeds are other runs."""
    family = FAMILIES[name]
    for number in range(amount):
        rng = np.random.default_rng([seed, number, *name.encode()])
        drawn = family.drawn(rng) if family.drawn else {}
        log = make_log(replace(_draw(rng), **family.fixed, **drawn, seed=int(rng.integers(2**31))))
        yield family.change(log, rng) if family.change else log


def _draw(rng: np.random.Generator) -> Truth:
    gains = np.round(np.exp(rng.uniform(np.log(0.6), np.log(10.0), 2)), 3).tolist()
    return Truth(
        kp_angular=gains[0],
        kp_linear=gains[int(rng.integers(2))],
        turn_limit=float(rng.choice([1.0, 1.0, 0.5, 2.0, math.inf])),
        speed_limit=float(rng.choice([1.0, 1.0, 0.5, 2.0, math.inf])),
        goal=tuple(np.round(rng.uniform(0.8, 10.2, 2), 1).tolist()),
        backlog=int(rng.integers(1, 9)),
        pause=int(rng.choice([0, 2, 10, 33, 34, 50])),
        newest=bool(rng.random() < 0.2),
        on_heading=bool(rng.random() < 0.4),
        wrap=bool(rng.random() < 0.3),
    )
