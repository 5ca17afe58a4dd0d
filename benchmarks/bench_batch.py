"""Rows of a sweep in the compiled batch against the interpreted loop; a map of 100 x 100 rows.

Both measure the same metrics of the same mixed scenarios; what is compared is processor time.
"""

import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import turtlelog as tl
from benchmarks.table import Cost, Row, run_alone, time_commands
from turtlelog.measure import measure_run
from turtlelog.scenario import Scenario
from turtlelog.sweep.batch import MeasuredRows, find_batch, measure_rows

METRICS = (
    *("rotate.settling_time", "translate.settling_time", "translate.overshoot"),
    *("final.position_error", "run.duration"),
)
NOISE = {"sensing.noise_position_m": 0.01, "sensing.noise_heading_rad": 0.01}
LOSS = {"loop.loss_probability": 0.05, "loop.jitter_s": 0.02}
LIMITED = {"limits.acceleration_m_s2": 1.0, "limits.turn_acceleration_rad_s2": 2.0}
MIXED: Mapping[str, Mapping[str, Any]] = {
    "as built": {},
    "noise": NOISE,
    "losses": LOSS,
    "limits": LIMITED,
    "all": {**NOISE, **LOSS, **LIMITED},
}
ROWS = 400  # of each of the mixed scenarios
SIDE = 100  # of the map
ALONE = 20  # rows of each that the interpreted loop simulates


SWEEP = (sys.executable, "-m", "turtlelog", "sweep", "paper", "--metric", ",".join(METRICS))
MAP_S = 3.0
"""Processor time of two cores that are busy for the 1.5 s that are wanted."""


def list_grid(side: int) -> list[str]:
    """Return the options of a map of gains and dead times."""
    gains, ticks = f"0.12:{0.12 * side:g}:0.12", f"0:{side - 1}"
    return ["--grid", f"law.kp_linear={gains}", "--grid", f"loop.transport_delay_ticks={ticks}"]


def list_bases() -> list[Scenario]:
    """Return the mixed scenarios."""
    return [tl.override_scenario(tl.load_scenario("paper"), dict(MIXED[name])) for name in MIXED]


def interpret(base: Scenario, gains: Sequence[float]) -> int:
    """Simulate and measure rows by the interpreted loop, and return their samples."""
    samples = 0
    for gain in gains:
        run = tl.simulate_run(tl.override_scenario(base, {"law.kp_linear": gain}))
        measure_run(run, only=METRICS)
        samples += len(run.samples)
    return samples


def run_rows(base: Scenario, columns: Mapping[str, Sequence[Any]]) -> MeasuredRows:
    """Simulate and measure rows, all of them compiled."""
    rows = measure_rows(base, columns, METRICS, ahead=10**9)
    assert rows.interpreted == 0, rows.interpreted
    return rows


def measure(share: float = 1.0) -> Iterator[Row]:
    bases = list_bases()
    loops = find_batch(bases[0])
    if loops is None or loops.load() is None:
        return
    gains = np.linspace(0.5, 12.0, max(round(ROWS * share), ALONE)).tolist()
    some = gains[:: max(len(gains) // ALONE, 1)]
    # The first row of a process is interpreted, as it says what the others are worth.
    measure_rows(bases[0], {"law.kp_linear": [1.0, 2.0]}, METRICS, ahead=10**9)
    began_s = time.process_time()
    samples = sum(interpret(base, some) for base in bases)
    interpreted_s = (time.process_time() - began_s) / samples
    began_s = time.process_time()
    found = [run_rows(base, {"law.kp_linear": gains}) for base in bases]
    compiled_s = time.process_time() - began_s
    compiled_s /= sum(int(rows.samples.sum()) for rows in found)
    yield Row(
        job="sweep compiled, a sample",
        value=compiled_s,
        peer=Cost("interpreted", interpreted_s, is_yardstick=True),
        aim=1 / 100,
    )
    side = max(round(SIDE * share), 2)
    with TemporaryDirectory() as folder:
        (map_s,) = time_commands(
            [*SWEEP, *list_grid(side), "-o", f"{folder}/map.parquet"], repeats=1
        )
    yield Row(job=f"sweep of {side} x {side} rows", value=map_s, aim=MAP_S, aim_of="value")


if __name__ == "__main__":
    run_alone(measure)
