"""The closed loop and its replays, against a plain loop that stores the same numbers.

The plain loop has local floats alone: no queue, object, event or choice. It is a peer and no bound:
a compiled loop does better.
"""

import math
from collections.abc import Iterator
from importlib import import_module
from struct import Struct

import numpy as np
from numpy.typing import NDArray

import turtlelog as tl
from benchmarks.table import Cost, Row, run_alone, time_calls
from turtlelog.plants.turtlesim import TICK_S
from turtlelog.scenario import resolve_scenario
from turtlelog.simulate import iterate_ticks
from turtlelog.simulate.compiled_loop import CompiledRunner
from turtlelog.simulate.many import find_loop

SECONDS = 1600.0  # of simulated time: 100,000 samples
TICK_NS = 16_000_000
BEARING_RAD = 2.24
POSE, POSE_ROW, COMMAND_ROW = Struct("<5f"), Struct("<q5d"), Struct("<q2d")
SAMPLE_ROW = Struct("<4q11d")


def run_plain_loop(samples: int) -> list[NDArray[np.float64]]:
    """Move the turtle, compute the law and store poses, commands and samples as a run does."""
    x, y, heading, turn_rate, speed = 5.5, 5.5, 0.0, 0.0, 0.0
    poses, commands, rows = bytearray(), bytearray(), bytearray()
    for tick in range(samples):
        time_ns = tick * TICK_NS
        heading += turn_rate * TICK_S
        heading -= 6.2831853 * math.floor((heading + 3.14159265) / 6.2831853)
        x += math.cos(heading) * speed * TICK_S
        y += math.sin(heading) * speed * TICK_S
        read = POSE.unpack(POSE.pack(x, y, heading, speed, turn_rate))
        poses += POSE_ROW.pack(time_ns, *read)
        error_x, error_y = 2.0 - read[0], 10.0 - read[1]
        error = BEARING_RAD - read[2]
        wanted = 0.0001 * error
        turn_rate = min(max(wanted, -1.0), 1.0)
        commands += COMMAND_ROW.pack(time_ns, speed, turn_rate)
        distance = math.hypot(error_x, error_y)
        whole = time_ns, tick, tick, 0
        values = BEARING_RAD, error, error_x, error_y, distance, 0.0, wanted, speed, turn_rate
        rows += SAMPLE_ROW.pack(*whole, *values, error_x, error_y)
    sizes = (poses, 6), (commands, 3), (rows, 15)
    return [np.frombuffer(packed).reshape(-1, width).T.copy() for packed, width in sizes]


def run_bare_loop(rows: NDArray[np.float64]) -> None:
    """Move the turtle and compute the law, storing the same numbers; for numba to compile."""
    x, y, heading, turn_rate, speed = 5.5, 5.5, 0.0, 0.0, 0.0
    for tick in range(len(rows)):
        heading += turn_rate * TICK_S
        heading -= 6.2831853 * np.floor((heading + 3.14159265) / 6.2831853)
        x += math.cos(heading) * speed * TICK_S
        y += math.sin(heading) * speed * TICK_S
        read_x, read_y, read_heading = np.float32(x), np.float32(y), np.float32(heading)
        error_x, error_y = 2.0 - read_x, 10.0 - read_y
        error = BEARING_RAD - read_heading
        wanted = 0.0001 * error
        turn_rate = -1.0 if wanted < -1.0 else 1.0 if wanted > 1.0 else float(wanted)
        row = rows[tick]
        row[0], row[1], row[2], row[3], row[4] = read_x, read_y, read_heading, speed, turn_rate
        row[5], row[6], row[7], row[8], row[9] = BEARING_RAD, error, error_x, error_y, wanted
        row[10] = math.sqrt(error_x * error_x + error_y * error_y)


def measure_compiled(scenario: tl.scenario.Scenario) -> Iterator[Row]:
    """Yield the row of many runs; none without numba."""
    scenario = resolve_scenario(scenario)
    plant, runner = scenario.plant.facts, CompiledRunner()
    loops = find_loop(scenario, plant)
    kernel = None if loops is None else loops.load()
    if kernel is None:
        return
    samples = len(tl.simulate_run(scenario).samples)
    bare_loop = import_module("numba").njit(run_bare_loop, cache=False)
    rows = np.empty((samples, 11))
    interpreted, compiled, bare = time_calls(
        lambda: tl.simulate_run(scenario),
        lambda: runner.simulate(kernel, scenario, plant),
        lambda: bare_loop(rows),
    )
    yield Row(
        job="simulate compiled, a sample",
        value=compiled / samples,
        peer=Cost("interpreted", interpreted / samples),
        bound=Cost("bare loop", bare / samples),
    )


def measure(share: float = 1.0) -> Iterator[Row]:
    # A gain this small keeps the turtle rotating to the end.
    changes = {"law.kp_angular": 0.0001, "max_duration_s": SECONDS * share}
    scenario = tl.override_scenario(tl.load_scenario("paper"), changes)
    recorded = tl.simulate_run(scenario)
    samples = len(recorded.samples)
    plain, *times = time_calls(
        lambda: run_plain_loop(samples),
        lambda: tl.simulate_run(scenario),
        lambda: sum(1 for _ in iterate_ticks(scenario)),
        lambda: tl.replay_law(recorded),
        lambda: tl.replay_loop(recorded),
    )
    simulate, ticks, law, loop = (time_s / samples for time_s in times)
    peer = Cost("plain loop", plain / samples, is_yardstick=True)
    yield Row(job="simulate, a sample", value=simulate, peer=peer)
    yield Row(job="replay the loop, a sample", value=loop, peer=peer)
    # These do less than the plain loop: the first stores nothing, the second moves no turtle.
    yield Row(job="simulate live, a tick", value=ticks)
    yield Row(job="replay the law, a sample", value=law)
    yield from measure_compiled(scenario)


if __name__ == "__main__":
    run_alone(measure)
