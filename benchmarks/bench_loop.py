"""The closed loop in samples per second, against the barest loop that Python can run."""

import math
import time
from collections.abc import Callable

import turtlelog as tl
from turtlelog.plants.turtlesim import TICK_S
from turtlelog.simulate import iterate_ticks

REPEATS = 5
SECONDS = 1600.0  # of simulated time: 100,000 samples


def run_bare_loop(samples: int) -> None:
    """Move the turtle and compute the law with local floats alone: no queue, object or record."""
    x, y, heading, turn_rate, speed = 5.5, 5.5, 0.0, 0.0, 0.0
    for _ in range(samples):
        heading += turn_rate * TICK_S
        heading -= 6.2831853 * math.floor((heading + 3.14159265) / 6.2831853)
        x += math.cos(heading) * speed * TICK_S
        y += math.sin(heading) * speed * TICK_S
        turn_rate = min(max(0.0001 * (2.24 - heading), -1.0), 1.0)


def measure_rate(samples: int, call: Callable[[], object]) -> float:
    """Return the best rate of several calls [samples/s of one core]."""
    best = math.inf
    for _ in range(REPEATS):
        start = time.process_time()
        call()
        best = min(best, time.process_time() - start)
    return samples / best


def main() -> None:
    # A gain this small keeps the turtle rotating to the end.
    changes = {"law.kp_angular": 0.0001, "max_duration_s": SECONDS}
    scenario = tl.override_scenario(tl.load_scenario("paper"), changes)
    samples = len(tl.simulate_run(scenario).samples)
    bare = measure_rate(samples, lambda: run_bare_loop(samples))
    loop = measure_rate(samples, lambda: sum(1 for _ in iterate_ticks(scenario)))
    run = measure_rate(samples, lambda: tl.simulate_run(scenario))
    recorded = tl.simulate_run(scenario)
    law = measure_rate(samples, lambda: tl.replay_law(recorded))
    again = measure_rate(samples, lambda: tl.replay_loop(recorded))
    print(f"bare loop, no objects   {bare:11,.0f} samples/s")
    print(f"iterate_ticks           {loop:11,.0f} samples/s, {bare / loop:.1f} times the bare time")
    print(f"simulate_run (columns)  {run:11,.0f} samples/s, {bare / run:.1f} times the bare time")
    print(f"replay_law              {law:11,.0f} samples/s, {bare / law:.1f} times the bare time")
    print(
        f"replay_loop             {again:11,.0f} samples/s, {bare / again:.1f} times the bare time"
    )


if __name__ == "__main__":
    main()
