"""Checking formulas over a million samples, against one running minimum of numpy over the same.

The signal is a random walk, sampled every 16 ms, and once at uneven times. Times are the best of
several calls, of one core.
"""

import math
import time
from collections.abc import Callable

import numpy as np

import turtlelog as tl

SAMPLES = 1_000_000
PERIOD_NS = 16_000_000
REPEATS = 7
FORMULAS = (
    "always(x > 0.5)",
    "always(eventually[0, 5](x > 0.5))",
    "always(eventually[1, 5](x > 0.5))",
    "always(eventually[0, 5000](x > 0.5))",
    "always(x > 0.5 implies eventually[0, 5](always[0, 1](x < 0.5)))",
    "x > -1e9 until x > 1e9",
    "always(x > 0.5 until[0, 5] x < 0.5)",
)


def measure_time(call: Callable[[], object]) -> float:
    """Return the best time of several calls [s]."""
    best = math.inf
    for _ in range(REPEATS):
        start = time.process_time()
        call()
        best = min(best, time.process_time() - start)
    return best


def main() -> None:
    rng = np.random.default_rng(0)
    values = np.cumsum(rng.normal(size=SAMPLES)) / 100.0
    even_ns = np.arange(SAMPLES) * PERIOD_NS
    uneven_ns = np.cumsum(rng.integers(1, 2 * PERIOD_NS, SAMPLES))
    bound = measure_time(lambda: np.minimum.accumulate(values))
    print(f"np.minimum.accumulate over {SAMPLES:,} samples: {1e3 * bound:.1f} ms")
    for text in FORMULAS:
        formula = tl.expressions.parse_expression(text)
        for name, time_ns in (("even", even_ns), ("uneven", uneven_ns)):
            signals = {"x": (time_ns, values)}
            took = measure_time(lambda: tl.check_formula(signals, formula))  # noqa: B023
            print(f"{text:<65} {name:<6} {1e3 * took:6.0f} ms, {took / bound:5.0f} times")


if __name__ == "__main__":
    main()
