"""Notes on the poses of a robot: what its metrics contain besides the motion."""

import math
from collections.abc import Mapping
from typing import Final

from turtlelog.display import format_short
from turtlelog.measure import MeasureSettings, Metric, Missing
from turtlelog.measure.breaks import describe_breaks, find_gaps, find_jumps
from turtlelog.measure.metric_kinds import RunContext
from turtlelog.measure.metrics.travel import judge_rest_of
from turtlelog.measure.pose_noise import find_scatter, measure_speed_noise
from turtlelog.measure.rates import AXES, describe_repetition, space_poses
from turtlelog.measure.reductions import compute_median, subtract_neighbours
from turtlelog.measure.rest import AT_REST_M_S
from turtlelog.measure.travel_direction import describe_sideways, describe_travel
from turtlelog.run import Run

_SHOWN: Final = 5e-4
"""Share of a path length below which jumps do not change its three printed digits."""

_COUNTED: Final = 5e-3
"""Share of the time below which gaps do not change the share at rest, in whole per cent."""

_NOISY: Final = 0.03
"""Share of the largest measured speed from which noise is told: three standard deviations of it are
a tenth."""

_CREPT_M: Final = 0.02
"""Distance at rest that is told: more than a robot that brakes and stops four times."""

_LARGE: Final = 0.05
"""Share of a path length from which jumps are told beside it, and of a duration from which gaps
are. Wheel odometry is as wrong itself."""


def describe_poses(run: Run, metrics: Mapping[str, Metric]) -> dict[str, str]:
    """Return notes on motion to the side, and on what metrics contain besides motion.

    Of a simulation there are none; without a path length among the metrics, only the resolution of
    lags and rise times.
    """
    if run.poses.speed_m_s is not None:
        return {}
    resolution = _describe_resolution(run, metrics)
    path_m = _get(metrics, "run.path_length")
    if path_m is None:
        return resolution
    sideways = describe_sideways(run)
    return {
        **resolution,
        **describe_travel(run),
        **({"sideways": sideways} if sideways else {}),
        **_describe_times(run),
        **_describe_noise(run, metrics),
        **_describe_rest(run, metrics, path_m),
        **_describe_jumps(run, path_m),
    }


def _get(metrics: Mapping[str, Metric], name: str) -> float | None:
    metric = metrics.get(name)
    return None if metric is None else metric.value


def _describe_resolution(run: Run, metrics: Mapping[str, Metric]) -> dict[str, str]:
    known = [_get(metrics, f"run.{axis}_{name}") for axis in AXES for name in ("lag", "rise_time")]
    if all(value is None for value in known) or len(run.poses) < 2:
        return {}
    time_s = run.poses.time_ns / 1e9
    if run.poses.measured_speed_m_s is None:
        time_s = space_poses(run).time_s
    return {"rate_step": f"{1e3 * compute_median(subtract_neighbours(time_s)):.3g} ms"}


def _describe_times(run: Run) -> dict[str, str]:
    notes = {}
    if changes := describe_repetition(run.poses):
        notes["changes"] = changes
    gaps_s = sum(gap.end_ns - gap.start_ns for gap in find_gaps(run)) / 1e9
    if gaps_s > _COUNTED * run.duration_s:
        notes["gaps"] = format_short(gaps_s, "s")
    if gaps_s > _LARGE * run.duration_s:
        notes["large_gaps"] = notes["gaps"]
    return notes


def _describe_noise(run: Run, metrics: Mapping[str, Metric]) -> dict[str, str]:
    notes, scatter = {}, find_scatter(run)
    if scatter.path_m is not None:
        notes["path_without_scatter"] = format_short(scatter.path_m, "m")
    if scatter.turning_rad is not None:
        notes["turning_without_scatter"] = format_short(math.degrees(scatter.turning_rad), "deg")
    fastest_m_s = _get(metrics, "run.measured_speed_max")
    if fastest_m_s is not None and run.poses.measured_speed_m_s is None:
        noise_m_s = measure_speed_noise(run)
        if noise_m_s > _NOISY * fastest_m_s:
            notes["speed_noise"] = f"{noise_m_s:.1g} m/s"
    return notes


def _describe_rest(run: Run, metrics: Mapping[str, Metric], path_m: float) -> dict[str, str]:
    if not _get(metrics, "run.rest_share"):
        return {}
    rest = judge_rest_of(RunContext(run, MeasureSettings()))
    if isinstance(rest, Missing) or rest.way_m <= max(_CREPT_M, _LARGE * path_m):
        return {}
    if rest.way_m > AT_REST_M_S * rest.time_s:  # it swings, and does not creep
        return {}
    return {"crept": format_short(rest.way_m, "m")}


def _describe_jumps(run: Run, path_m: float) -> dict[str, str]:
    share = sum(jump.excess_m for jump in find_jumps(run)) / (path_m or math.inf)
    if share <= _SHOWN:
        return {}
    notes = {"jumps": describe_breaks(run)["jumps"]}
    if share >= _LARGE:
        notes["jumped_share"] = f"{100.0 * share:.0f} %"
    return notes
