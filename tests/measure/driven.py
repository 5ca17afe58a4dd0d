"""Runs of a robot with a dead time and a lag, in closed form, as bags hold them."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from turtlelog.run import CommandColumns, PoseColumns, Run, SampleColumns
from turtlelog.run.angles import wrap_angle

Values = NDArray[np.float64]
_NONE = np.zeros(0)


def respond(
    time_s: Values, steps: list[tuple[float, float]], lag_s: float, dead_s: float = 0.0
) -> tuple[Values, Values]:
    """Return rate and way at each time of a first-order lag under held commands, from rest."""
    rate, way = np.zeros(len(time_s)), np.zeros(len(time_s))
    at_s, start, travelled = -np.inf, 0.0, 0.0
    asked = 0.0
    for begin_s, value in [*steps, (np.inf, 0.0)]:
        end_s = begin_s + dead_s
        inside = (time_s >= at_s) & (time_s < end_s)
        since_s = np.where(np.isfinite(at_s), time_s[inside] - at_s, 0.0)
        rate[inside], moved = _relax(since_s, start, asked, lag_s)
        way[inside] = travelled + moved
        if np.isfinite(end_s):
            length_s = np.array([end_s - at_s if np.isfinite(at_s) else 0.0])
            last, moved = _relax(length_s, start, asked, lag_s)
            start, travelled = float(last[0]), travelled + float(moved[0])
        at_s, asked = end_s, value
    return rate, way


def _relax(since_s: Values, start: float, asked: float, lag_s: float) -> tuple[Values, Values]:
    if lag_s == 0.0:
        return np.full(len(since_s), asked), asked * since_s
    decayed = np.exp(-since_s / lag_s)
    rate = asked + (start - asked) * decayed
    return rate, asked * since_s + (start - asked) * lag_s * (1.0 - decayed)


def make_driven_run(
    time_s: Values,
    *,
    speed: tuple[Values, Values] | None = None,
    turn: tuple[Values, Values] | None = None,
    commands: tuple[Values, Values, Values] | None = None,
    reports: bool = False,
    noise_m: float = 0.0,
    **changes: Any,
) -> Run:
    """Return a robot that drives along +x or turns in place.

    Args:
        time_s: Of the poses.
        speed: Rate and way along x.
        turn: Rate and heading, with its turns.
        commands: Times, speeds and turn rates.
        reports: Whether the poses hold the measured rates.
        noise_m: Standard deviation of the noise on each coordinate [m, rad].
        **changes: Other fields of the run.
    """
    still = np.zeros(len(time_s)), np.zeros(len(time_s))
    rates = speed or still, turn or still
    random = np.random.default_rng(1)
    noise = random.normal(0.0, noise_m, (3, len(time_s))) if noise_m else np.zeros((3, 1))
    at_s, speeds, turns = commands or (_NONE, _NONE, _NONE)
    return Run(
        name="driven",
        source="rosbag2: driven",
        poses=PoseColumns(
            time_ns=np.asarray(np.round(time_s * 1e9), dtype=np.int64),
            xy_m=np.column_stack([rates[0][1] + noise[0], np.zeros(len(time_s)) + noise[1]]),
            heading_rad=np.asarray(wrap_angle(rates[1][1] + noise[2])),
            measured_speed_m_s=rates[0][0].copy() if reports else None,
            measured_turn_rate_rad_s=rates[1][0].copy() if reports else None,
        ),
        commands=CommandColumns(
            time_ns=np.asarray(np.round(at_s * 1e9), dtype=np.int64),
            speed_m_s=speeds.copy(),
            lateral_speed_m_s=np.zeros(len(at_s)),
            turn_rate_rad_s=turns.copy(),
        ),
        samples=make_no_samples(),
        absent=("samples", "goal_xy_m", "goal_heading_rad", "parameters", "stop_reason"),
        **changes,
    )


def publish(steps: list[tuple[float, float]], until_s: float, rate_hz: float = 10.0) -> Values:
    """Return times and values of commands that are repeated, and sent at once where they change."""
    beats = np.arange(steps[0][0], until_s, 1.0 / rate_hz)
    at_s = np.unique(np.round(np.concatenate([beats, [begin for begin, _ in steps]]), 9))
    starts = np.round([begin for begin, _ in steps], 9)
    row = np.searchsorted(starts, at_s, side="right") - 1
    return np.array([at_s, np.array([value for _, value in steps])[row]])


def make_no_samples() -> SampleColumns:
    """Return samples of a controller that there are none of."""
    none = np.zeros(0, dtype=np.int64)
    return SampleColumns(
        time_ns=none.copy(),
        sequence=none.copy(),
        pose_sequence=none.copy(),
        phase=none.copy(),
        bearing_rad=_NONE.copy(),
        heading_error_rad=_NONE.copy(),
        error_xy_m=np.zeros((0, 2)),
        distance_m=_NONE.copy(),
        speed_m_s=_NONE.copy(),
        turn_rate_rad_s=_NONE.copy(),
        world_velocity_m_s=np.zeros((0, 2)),
        wanted_speed_m_s=_NONE.copy(),
        wanted_turn_rate_rad_s=_NONE.copy(),
    )
