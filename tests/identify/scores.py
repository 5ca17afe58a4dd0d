"""How well robots of known truth are identified."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

import turtlelog as tl
from tests.identify.robots import Log, Truth, draw_limited, make_run, turn_with_limit
from turtlelog.identify import AxisModel

PARAMETERS = ("gain", "dead_time_s", "lag_s", "total_delay_s")


@dataclass
class Score:
    """What became of the axes: which intervals hold the truth, and how far values are off."""

    axes: int = 0
    refused: int = 0
    of_second_order: int = 0
    held: dict[str, list[bool]] = field(
        default_factory=lambda: {name: [] for name in (*PARAMETERS, "rate_limit")}
    )
    errors: dict[str, list[float]] = field(
        default_factory=lambda: {name: [] for name in PARAMETERS}
    )
    noise_m: list[float] = field(default_factory=list)

    def add(self, axis: AxisModel, truth: Truth, log: Log) -> None:
        """Count an axis."""
        self.axes += 1
        if not axis.is_known:
            self.refused += 1
            return
        self.of_second_order += axis.model == "second_order" or axis.rate_limit is not None
        self.noise_m.append(log.noise_m)
        dead_time_s = truth.dead_time_s + log.least_transport_s
        lag_s = truth.lag_s + truth.second_lag_s
        values = truth.gain, dead_time_s, lag_s, dead_time_s + lag_s
        for name, value in zip(PARAMETERS, values, strict=True):
            found = getattr(axis, name)
            self.held[name].append(found.low <= value <= found.high)
            self.errors[name].append(found.value - value)

    def find_coverage(self, name: str) -> float:
        return float(np.mean(self.held[name]))

    def find_median_error(self, name: str, most_noise_m: float = np.inf) -> float:
        kept = np.array(self.noise_m) <= most_noise_m
        return float(np.median(np.abs(self.errors[name])[kept]))


def score_robots(logs: Iterable[tuple[int, Log]]) -> Score:
    return score_models(identify_logs(logs))


def identify_logs(logs: Iterable[tuple[int, Log]]) -> Iterator[tuple[Log, tl.Run, tl.RobotModel]]:
    for seed, log in logs:
        run = make_run(log, seed)
        yield log, run, tl.identify_robot(run)


def score_models(models: Iterable[tuple[Log, tl.Run, tl.RobotModel]]) -> Score:
    score = Score()
    for log, _, model in models:
        score.add(model.speed, log.speed, log)
        score.add(model.turn_rate, log.turn_rate, log)
    return score


def score_limited(seeds: Iterable[int]) -> Score:
    """Identify robots whose turn rate changes no faster than a limit."""
    score = Score()
    for seed in seeds:
        log, limit = draw_limited(seed)
        run = turn_with_limit(log.turn_rate, log, limit, seed)
        axis = tl.identify_robot(run).turn_rate
        score.add(axis, log.turn_rate, log)
        if axis.rate_limit is not None:
            score.held["rate_limit"].append(axis.rate_limit.low <= limit <= axis.rate_limit.high)
    return score
