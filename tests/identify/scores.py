"""How well robots of known truth are identified."""

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

import turtlelog as tl
from tests.identify.robots import Log, make_run

PARAMETERS = ("gain", "dead_time_s", "lag_s", "total_delay_s")


@dataclass
class Score:
    """What became of the axes: which intervals hold the truth, and how far values are off."""

    axes: int = 0
    refused: int = 0
    of_second_order: int = 0
    held: dict[str, list[bool]] = field(default_factory=lambda: {name: [] for name in PARAMETERS})
    errors: dict[str, list[float]] = field(
        default_factory=lambda: {name: [] for name in PARAMETERS}
    )
    noise_m: list[float] = field(default_factory=list)

    def find_coverage(self, name: str) -> float:
        return float(np.mean(self.held[name]))

    def find_median_error(self, name: str, most_noise_m: float = np.inf) -> float:
        kept = np.array(self.noise_m) <= most_noise_m
        return float(np.median(np.abs(self.errors[name])[kept]))


def score_robots(logs: Iterable[tuple[int, Log]]) -> Score:
    score = Score()
    for seed, log in logs:
        model = tl.identify_robot(make_run(log, seed))
        for axis, truth in ((model.speed, log.speed), (model.turn_rate, log.turn_rate)):
            score.axes += 1
            if not axis.is_known:
                score.refused += 1
                continue
            score.of_second_order += axis.model == "second_order" or axis.rate_limit is not None
            score.noise_m.append(log.noise_m)
            dead_time_s = truth.dead_time_s + log.least_transport_s
            values = truth.gain, dead_time_s, truth.lag_s, dead_time_s + truth.lag_s
            true = dict(zip(PARAMETERS, values, strict=True))
            for name, value in true.items():
                found = getattr(axis, name)
                score.held[name].append(found.low <= value <= found.high)
                score.errors[name].append(found.value - value)
    return score
