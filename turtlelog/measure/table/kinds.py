"""What the table of metrics says about each of them."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from turtlelog.measure.context import RunContext
from turtlelog.measure.metric import Result


@dataclass(frozen=True, slots=True, kw_only=True)
class MetricKind:
    """What a metric is.

    Attributes:
        unit: Of its value.
        compute: From a run, read once, to the value or the reason why there is none.
        meaning: One sentence.
        better: `lower`, `higher`, or None where neither is better.
        floor: Where lower is better, the value below which nothing is gained: an overshoot of
            -2 % is no better than one of -1 %, for both are none. None: there is no such value.
    """

    unit: str
    compute: Callable[[RunContext], Result]
    meaning: str
    better: Literal["lower", "higher"] | None = "lower"
    floor: float | None = None

    def compute_loss(self, value: float, reference: float) -> float:
        """Return by how much a value is worse than a reference, in the metric's unit.

        Negative where it is better, 0 where both are equal or under the floor. Of a metric that has
        no better direction every change is a loss.
        """
        if self.better is None:
            return abs(value - reference)
        if self.floor is not None:
            value, reference = max(value, self.floor), max(reference, self.floor)
        return value - reference if self.better == "lower" else reference - value
