"""Pairs of scenarios whose changes are known, and their Shapley values by brute force.

Nothing here shares code with `explain`: settings are set one group after the other onto the first
scenario, which is simulated by the plain loop, and a contribution is the mean over all orders.
"""

import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import permutations
from statistics import fmean
from typing import Any, Final

import turtlelog as tl
from turtlelog.explain.game import SEEDS
from turtlelog.scenario import Scenario, get_preset, override_scenario

Values = Mapping[str, Any]
Draw = Callable[[random.Random], Values]


def _set(*keys: str, low: float, high: float) -> Draw:
    """Return what draws one value for all keys."""

    def draw(source: random.Random) -> Values:
        return dict.fromkeys(keys, round(source.uniform(low, high), 3))

    return draw


def _choose(key: str, *values: Any) -> Draw:
    def draw(source: random.Random) -> Values:
        return {key: source.choice(values)}

    return draw


def _draw_goal(source: random.Random) -> Values:
    return {"goal.x_m": source.uniform(1.0, 10.0), "goal.y_m": source.uniform(1.0, 10.0)}


def _draw_start(source: random.Random) -> Values:
    return {"start.x_m": source.uniform(3.0, 8.0), "start.heading_rad": source.uniform(-2.0, 2.0)}


def _draw_queue(source: random.Random) -> Values:
    return {"loop.start_backlog": source.randint(7, 9), "loop.command_queue": source.randint(9, 12)}


OF_ALL: Final[Mapping[str, Draw]] = {
    "goal": _draw_goal,
    "start": _draw_start,
    "limits": _set("limits.speed_m_s", "limits.turn_rate_rad_s", low=0.4, high=0.9),
    "delay": _choose("loop.transport_delay_ticks", 1, 3, 8),
    "bias": _set("sensing.bias_heading_rad", low=-0.05, high=0.05),
    "quantum": _choose("sensing.quantum_position_m", 0.001, 0.02),
    "pose precision": _choose("loop.pose_precision", "float64"),
    "time span": _set("max_duration_s", low=6.0, high=50.0),
    "queue": _draw_queue,
}
OF_SEQUENTIAL: Final[Mapping[str, Draw]] = {
    "gains": _set("law.kp_angular", "law.kp_linear", low=0.5, high=12.0),
    "law.kp_linear": _set("law.kp_linear", low=0.5, high=12.0),
    "law.kp_angular": _set("law.kp_angular", low=0.5, high=12.0),
    "pause": _choose("law.pause_ticks", 5, 20, 60),
    "tolerance": _set(
        "law.heading_tolerance_rad", "law.position_tolerance_m", low=0.002, high=0.05
    ),
    "law": _choose("law.kind", "posture"),
}
OF_LAGGED: Final[Mapping[str, Draw]] = {
    "plant.speed_gain": _set("plant.speed_gain", low=0.7, high=0.95),
    "plant.turn_dead_time_s": _set("plant.turn_dead_time_s", low=0.15, high=0.3),
    "plant.speed_lag_s": _set("plant.speed_lag_s", low=0.15, high=0.3),
}
NOISE: Final[Draw] = _set("sensing.noise_position_m", low=0.002, high=0.02)
_APART: Final = ("gains", "law.kp_linear", "law.kp_angular")
"""Groups of which a pair has one."""

_OF_THE_LAW: Final = {"gains", "law.kp_linear", "law.kp_angular", "pause", "tolerance"}

BASES: Final = (
    "paper-kp1",
    "paper-kp2",
    "paper-kp4",
    "paper-kp10",
    "textbook",
    "posture",
    "lagged",
)
METRICS: Final = ("final.position_error", "run.duration", "run.path_length", "final.heading_error")


@dataclass(frozen=True)
class Pair:
    """Two scenarios.

    Attributes:
        first: The first.
        changes: What the second has otherwise, by the name of the group.
        metric: Whose difference is divided.
        is_random: Whether noise is among the changes.
    """

    first: Scenario
    changes: Mapping[str, Values]
    metric: str
    is_random: bool

    @cached_property
    def second(self) -> Scenario:
        """The second scenario."""
        return self.change(self.changes)

    def change(self, groups: Any) -> Scenario:
        """Return the first scenario with some of the changes."""
        values: dict[str, Any] = {}
        for name in groups:
            values |= self.changes[name]
        if "law.kind" in values:
            values = {key: one for key, one in values.items() if key.partition(".")[0] != "law"}
            values["law.kind"] = self.changes["law"]["law.kind"]
        return override_scenario(self.first, values, source="pair") if values else self.first

    def measure(self, groups: frozenset[str]) -> float | None:
        """Return the metric with some of the changes; of noise its mean over the seeds."""
        scenario = self.change(groups)
        draws = "noise" in groups
        scenarios = [replace(scenario, seed=seed) for seed in SEEDS] if draws else [scenario]
        values = [
            tl.measure_run(tl.simulate_run(one), only=[self.metric])[self.metric].value
            for one in scenarios
        ]
        known = [value for value in values if value is not None]
        return fmean(known) if len(known) == len(values) else None

    def divide(self) -> Mapping[str, float] | None:
        """Return the Shapley value of each group, over all orders; None where a set has none."""
        names = tuple(self.changes)
        worth: dict[frozenset[str], float] = {}
        for size in range(2 ** len(names)):
            inside = frozenset(name for bit, name in enumerate(names) if size >> bit & 1)
            value = self.measure(inside)
            if value is None:
                return None
            worth[inside] = value
        added: dict[str, list[float]] = {name: [] for name in names}
        for order in permutations(names):
            for place, name in enumerate(order):
                before = frozenset(order[:place])
                added[name].append(worth[before | {name}] - worth[before])
        return {name: fmean(sizes) for name, sizes in added.items()}


def draw_pair(source: random.Random, *, is_random: bool = False) -> Pair:
    """Return a pair that differs in one to six groups of keys, with noise in one or two."""
    base = source.choice(BASES)
    first = get_preset(base)
    table = dict(OF_ALL)
    if first.law.kind == "sequential-p":
        table |= OF_SEQUENTIAL
    if base == "lagged":
        table |= OF_LAGGED
        # Its loop has a timer of its own, so ticks are no unit of it.
        table = {name: one for name, one in table.items() if name not in {"delay", "queue"}}
    count = source.randint(0, 1) if is_random else source.randint(1, 6)
    names = source.sample(sorted(table), min(count, len(table)))
    apart = [name for name in names if name in _APART]
    names = [name for name in names if name not in apart[1:]]
    if "law" in names:
        names = [name for name in names if name not in _OF_THE_LAW]
    changes = {name: table[name](source) for name in names}
    if is_random:
        changes["noise"] = NOISE(source)
    metric = source.choice(METRICS)
    return Pair(first=first, changes=changes, metric=metric, is_random=is_random)
