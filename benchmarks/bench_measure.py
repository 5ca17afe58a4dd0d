"""Measuring a million samples, against python-control's step_info on one response of them.

The run is made from columns: a rotation and a translation, a pose and a sample per tick. The bound
is to read every value of its columns once: the greatest of each.
"""

from collections.abc import Iterator

import control
import numpy as np

from benchmarks.table import Cost, Row, run_alone, time_calls
from turtlelog.measure import MeasureSettings, Metric, measure_run
from turtlelog.run import CommandColumns, PoseColumns, Run, SampleColumns
from turtlelog.scenario import load_scenario
from turtlelog.simulate import declare_scenario

ROWS = 1_000_000
ROTATING = 0.3  # of them
PERIOD_NS = 16_000_000
BEARING_RAD = 2.2
DISTANCE_M = 5.0
GAINS = (1 / 600.0, 1 / 1500.0)
STEP = ("rise_time", "settling_time", "overshoot", "peak", "peak_time", "final_error")


def make_run(rows: int) -> Run:
    """Return a run whose responses last as long as a million samples, 4.4 hours, would."""
    rotating, faster = round(rows * ROTATING), ROWS / rows
    time_ns = np.arange(rows) * PERIOD_NS
    time_s = time_ns / 1e9 * faster
    turning = np.arange(rows) < rotating
    swing = np.exp(-GAINS[0] * time_s) * np.cos(time_s / 300.0)
    heading = np.where(turning, BEARING_RAD * (1.0 - swing), BEARING_RAD)
    driving_s = np.clip(time_s - time_s[rotating], 0.0, None)
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
            lateral_speed_m_s=np.zeros(rows),
            turn_rate_rad_s=turn_rate,
        ),
        samples=SampleColumns(
            time_ns=time_ns,
            sequence=np.arange(rows),
            pose_sequence=np.arange(rows),
            phase=np.where(turning, 0, 2),
            bearing_rad=np.full(rows, BEARING_RAD),
            heading_error_rad=BEARING_RAD - heading,
            error_xy_m=error,
            distance_m=DISTANCE_M - along,
            speed_m_s=speed,
            turn_rate_rad_s=turn_rate,
            world_velocity_m_s=np.zeros((rows, 2)),
            wanted_speed_m_s=wanted_m_s,
            wanted_turn_rate_rad_s=wanted_rad_s,
        ),
        goal_xy_m=(float(DISTANCE_M * direction[0]), float(DISTANCE_M * direction[1])),
        parameters={
            "law.kp_angular": GAINS[0] * faster,
            "law.kp_linear": GAINS[1] * faster,
            "limits.speed_m_s": 1.0,
            "limits.turn_rate_rad_s": 1.0,
        },
        declaration=declare_scenario(load_scenario("paper")),
        stop_reason="standstill",
    )


def read_columns_once(run: Run) -> None:
    """Find the greatest value of every column that some metric needs."""
    poses, samples = run.poses, run.samples
    for values in (poses.time_ns, poses.xy_m, poses.heading_rad):
        values.max()
    for name in ("time_ns", "speed_m_s", "turn_rate_rad_s", "wanted_speed_m_s"):
        getattr(samples, name).max()


def measure_step(run: Run) -> dict[str, Metric]:
    """Measure of the rotation what step_info measures."""
    return dict(measure_run(run, only=[f"rotate.{name}" for name in STEP]))


def measure(share: float = 1.0) -> Iterator[Row]:
    run = make_run(round(ROWS * share))
    settings = MeasureSettings(dead_time_ticks=6)
    turning = round(len(run.poses) * ROTATING)
    heading, time_s = run.poses.heading_rad[:turning], run.poses.time_ns[:turning] / 1e9
    assert all(found.value is not None for found in measure_step(run).values())
    complete, bound, one, step_info = time_calls(
        lambda: measure_run(run, settings),
        lambda: read_columns_once(run),
        lambda: measure_step(run),
        lambda: control.step_info(heading, time_s, yfinal=BEARING_RAD),
    )
    yield Row(job="measure all metrics", value=complete, bound=Cost("read once", bound))
    yield Row(
        job=f"measure a step, {len(STEP)} metrics", value=one, peer=Cost("control", step_info)
    )


if __name__ == "__main__":
    run_alone(measure)
