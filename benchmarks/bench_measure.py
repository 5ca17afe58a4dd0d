"""Measuring a million samples completely, as a multiple of reading its columns once.

The run is made from columns: a rotation and a translation, a pose and a sample per tick. All times
are the best of several on one machine in one run.
"""

import time
from collections.abc import Callable

import numpy as np

from turtlelog.measure import METRICS, MeasureSettings, measure_run
from turtlelog.run import CommandColumns, PoseColumns, Run, SampleColumns

ROWS = 1_000_000
ROTATING = 300_000
PERIOD_NS = 16_000_000
BEARING_RAD = 2.2
DISTANCE_M = 5.0
GAINS = (1 / 600.0, 1 / 1500.0)
REPEATS = 7


def make_run() -> Run:
    """Return a run of 4.4 hours whose responses last as long."""
    time_ns = np.arange(ROWS) * PERIOD_NS
    time_s = time_ns / 1e9
    turning = np.arange(ROWS) < ROTATING
    swing = np.exp(-GAINS[0] * time_s) * np.cos(time_s / 300.0)
    heading = np.where(turning, BEARING_RAD * (1.0 - swing), BEARING_RAD)
    driving_s = np.clip(time_s - time_s[ROTATING], 0.0, None)
    along = -DISTANCE_M * np.expm1(-GAINS[1] * driving_s)
    direction = np.array([np.cos(BEARING_RAD), np.sin(BEARING_RAD)])
    wanted_rad_s = 5.0 * (BEARING_RAD - heading)
    wanted_m_s = np.where(turning, 0.0, 5.0 * (DISTANCE_M - along))
    turn_rate, speed = np.clip(wanted_rad_s, -1.0, 1.0), np.clip(wanted_m_s, -1.0, 1.0)
    error = (DISTANCE_M - along)[:, None] * direction
    return Run(
        name="million",
        source="benchmark",
        poses=PoseColumns(
            time_ns=time_ns, xy_m=along[:, None] * direction, heading_rad=np.clip(heading, -3, 3)
        ),
        commands=CommandColumns(
            time_ns=time_ns,
            speed_m_s=speed,
            lateral_speed_m_s=np.zeros(ROWS),
            turn_rate_rad_s=turn_rate,
        ),
        samples=SampleColumns(
            time_ns=time_ns,
            sequence=np.arange(ROWS),
            pose_sequence=np.arange(ROWS),
            phase=np.where(turning, 0, 2),
            bearing_rad=np.full(ROWS, BEARING_RAD),
            heading_error_rad=BEARING_RAD - heading,
            error_xy_m=error,
            distance_m=DISTANCE_M - along,
            speed_m_s=speed,
            turn_rate_rad_s=turn_rate,
            world_velocity_m_s=np.zeros((ROWS, 2)),
            wanted_speed_m_s=wanted_m_s,
            wanted_turn_rate_rad_s=wanted_rad_s,
        ),
        goal_xy_m=(float(DISTANCE_M * direction[0]), float(DISTANCE_M * direction[1])),
        parameters={
            "law.kp_angular": GAINS[0],
            "law.kp_linear": GAINS[1],
            "limits.speed_m_s": 1.0,
            "limits.turn_rate_rad_s": 1.0,
        },
        stop_reason="standstill",
    )


def time_best(work: Callable[[], object]) -> float:
    times = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)


def main() -> None:
    run = make_run()
    unwrapping = time_best(lambda: np.unwrap(run.poses.heading_rad))
    settings = MeasureSettings(dead_time_ticks=6)
    complete = time_best(lambda: measure_run(run, settings))
    one = time_best(lambda: measure_run(run, only=["rotate.overshoot"]))
    print(f"{len(METRICS)} metrics of a run of {ROWS:,} samples and poses")
    print(f"  all of them         {complete:6.3f} s  {complete / unwrapping:5.1f} x np.unwrap")
    print(f"  rotate.overshoot    {one:6.3f} s  {one / unwrapping:5.1f} x np.unwrap")
    print(f"  np.unwrap, a column {unwrapping:6.3f} s")


if __name__ == "__main__":
    main()
