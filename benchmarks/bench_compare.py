"""Comparing two runs of a million samples with a tube, against np.interp on the same rows.

Processor times, the best of several in one run; ratios are what to compare over time.
"""

import time
from collections.abc import Callable

import numpy as np

import turtlelog as tl
from turtlelog.run import CommandColumns, PoseColumns, SampleColumns

ROWS = 1_000_000
REPEATS = 3
PERIOD_NS = 16_000_000


def make_run(seed: int, late_ns: int) -> tl.Run:
    """Return a run of a million poses and samples: slow curves with noise."""
    rng = np.random.default_rng(seed)
    time_ns = np.arange(ROWS) * PERIOD_NS + late_ns
    curve = 5.0 + 3.0 * np.sin(np.arange(ROWS) / 1000.0) + rng.normal(0.0, 1e-4, ROWS)
    speed = np.sign(np.sin(np.arange(ROWS) / 3.0)) + rng.normal(0.0, 1e-4, ROWS)
    rows, zeros = np.arange(ROWS), np.zeros(ROWS)
    return tl.Run(
        name=f"run-{seed}",
        source="benchmark",
        poses=PoseColumns(
            time_ns=time_ns, xy_m=np.stack([curve, curve], axis=1), heading_rad=curve % 3.0
        ),
        commands=CommandColumns(
            time_ns=time_ns.copy(),
            speed_m_s=speed.copy(),
            lateral_speed_m_s=zeros.copy(),
            turn_rate_rad_s=zeros.copy(),
        ),
        samples=SampleColumns(
            time_ns=time_ns.copy(),
            sequence=rows,
            pose_sequence=rows.copy(),
            phase=np.full(ROWS, 2),
            bearing_rad=zeros.copy(),
            heading_error_rad=zeros.copy(),
            error_xy_m=np.ones((ROWS, 2)),
            distance_m=zeros.copy(),
            speed_m_s=speed,
            turn_rate_rad_s=zeros.copy(),
            world_velocity_m_s=np.zeros((ROWS, 2)),
        ),
    )


def measure(call: Callable[[], object]) -> float:
    """Return the best time of a call [s]: other programs only ever add."""
    times = []
    for _ in range(REPEATS):
        start = time.process_time()
        call()
        times.append(time.process_time() - start)
    return min(times)


def main() -> None:
    reference, run = make_run(1, 0), make_run(2, 5_000_000)
    from turtlelog.compare.alignment import align_runs
    from turtlelog.compare.difference import _compare_signals, _measure_rows
    from turtlelog.compare.tube import lay_grid, read_rows

    clock = align_runs(reference, run, "recorded")
    at = np.sort(np.concatenate([reference.poses.time_ns, run.poses.time_ns]), kind="stable")
    xp, fp = reference.poses.time_ns, reference.poses.xy_m[:, 0].copy()
    interp_s = measure(lambda: np.interp(at, xp, fp))
    read_s = measure(lambda: [tl.read_signal(run, name) for name in tl.SIGNALS])
    print(f"np.interp at both runs' rows      {interp_s:7.3f} s")
    print(f"reading all signals of one run    {read_s:7.3f} s")
    for name, time_s in (("x", 0.032), ("speed", 0.032), ("speed", 1.0), ("speed", 100.0)):
        tolerance = tl.Tolerance(abs=1e-3, time_s=time_s)
        signals = [tl.read_signal(found, name) for found in (reference, run)]
        assert signals[0] is not None
        assert signals[1] is not None
        placed = [
            clock.place_signal(signals[0], reference),
            clock.place_signal(signals[1], run),
        ]

        def compare(
            pair: list[tl.measure.Signal] = placed, limit: tl.Tolerance = tolerance
        ) -> object:
            grid = lay_grid(pair[0].time_ns, pair[1].time_ns, clock.span)
            return _measure_rows(pair[0], read_rows(pair[1], grid), limit, clock, [])

        took = measure(compare)
        print(f"tube of {name:5} within {time_s:7.3f} s    {took:7.3f} s, {took / interp_s:5.1f} x")
    close = tl.Tolerance(abs=1e-3, time_s=0.032)
    tolerances = {
        name: close if name in {"x", "y", "speed"} else tl.Tolerance() for name in tl.SIGNALS
    }
    took = measure(lambda: _compare_signals(reference, run, clock, tolerances))
    print(f"whole comparison, all signals     {took:7.3f} s, {took / read_s:5.1f} x reading them")


if __name__ == "__main__":
    main()
