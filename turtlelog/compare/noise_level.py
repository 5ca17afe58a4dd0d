"""Whether a recorded robot is noisier or quieter than a simulated one."""

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]
Quantity = Literal["position", "heading"]
Level = Literal["as simulated", "noisier", "quieter"]

SHORTEST_S: Final = 0.1
"""After this time errors of a robot that is not noisier are small beside noise [s]."""

_NOTED: Final = float(np.sqrt(2.0))
"""Halfway, in powers of two, between the same noise and the double or half [1]. Noise that was
identified from 60 s is 0.85 to 1.25 times the true noise."""

_SURE: Final = 3.0
"""Student's t of 38 degrees of freedom that chance exceeds once in 200 [1]."""

_T_95: Final = 2.024
"""Student's t of 38 degrees of freedom within which chance stays in 95 of 100 cases [1]."""

_FEWEST: Final = 30
"""Errors of a robot that moves whose median is worth naming."""

_GROWN: Final = 2.0
"""Student's t that chance exceeds once in 20: a doubt is enough to say nothing [1]."""

_GROWTH: Final = 1.25
"""Noise that is doubled is doubled after any time. The error of a wrong model grows with time, by
ten between 0.1 s and 1 s, where that of noise grows by three at most [1]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseLevel:
    """The noise of a recorded robot beside that of the simulated one.

    Attributes:
        quantity: `position` or `heading`.
        after_s: The time over which motions are compared [s].
        ratio: Median recorded error by median simulated error [1].
        low: 2.5 % of the ratio's distribution over seeds [1].
        high: 97.5 % likewise [1].
        level: `as simulated`, or in which way the noise differs.
    """

    quantity: Quantity
    after_s: float
    ratio: float
    low: float
    high: float
    level: Level

    @property
    def text(self) -> str:
        """What the noise is beside that of the scenario, in a sentence; empty where it is right."""
        if self.level == "as simulated":
            return ""
        more = "more" if self.level == "noisier" else "less"
        return (
            f"The {self.quantity} has {more} noise than the scenario:"
            f" {_round(self.ratio)} times as much ({_round(self.low)} to {_round(self.high)})."
        )


def _round(ratio: float) -> str:
    """Return two digits of a ratio, without an exponent."""
    return f"{float(f'{ratio:.2g}'):g}"


def compare_noise(
    quantity: Quantity, after_s: float, short: tuple[Values, Values], long: tuple[Values, Values]
) -> NoiseLevel | None:
    """Return how noisy a recorded robot is; None where too few errors tell.

    Args:
        quantity: What the errors are of.
        after_s: After which time the errors of `short` are [s].
        short: Recorded errors, shape (n,), and simulated ones, shape (seeds, n).
        long: The same after a time that is several times longer, at which a wrong model shows.
    """
    if len(short[0]) < _FEWEST or not len(long[0]):
        return None
    ratio, spread = _compare(*short)
    growth, growth_spread = _compare(*long, short)
    if not np.isfinite([ratio, spread, growth, growth_spread]).all() or spread == 0.0:
        return None
    level: Level = "as simulated"
    if abs(ratio) > np.log(_NOTED) and abs(ratio) > _SURE * spread:
        level = "noisier" if ratio > 0.0 else "quieter"
    if level == "noisier" and growth > max(np.log(_GROWTH), _GROWN * growth_spread):
        level = "as simulated"
    low, high = np.exp(ratio + np.array([-1.0, 1.0]) * _T_95 * spread)
    return NoiseLevel(
        quantity=quantity,
        after_s=after_s,
        ratio=float(np.exp(ratio)),
        low=float(low),
        high=float(high),
        level=level,
    )


def _compare(
    recorded: Values, simulated: Values, beside: tuple[Values, Values] | None = None
) -> tuple[float, float]:
    """Return the logarithm of the ratio of medians, and its standard deviation over seeds.

    With `beside` the ratio of those is divided out.
    """
    with np.errstate(divide="ignore", invalid="ignore"):  # Without noise an error may be 0.
        one = np.log(np.median(recorded))
        each = np.log(np.median(simulated, axis=1))
        if beside is not None:
            one = one - np.log(np.median(beside[0]))
            each = each - np.log(np.median(beside[1], axis=1))
        # One more draw of the same kind differs from the mean of others by this.
        spread = each.std(ddof=1) * np.sqrt(1.0 + 1.0 / len(each))
        return float(one - each.mean()), float(spread)
