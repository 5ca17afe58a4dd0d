"""Runs as others log them."""

from dataclasses import fields, replace
from typing import Any

import numpy as np

from turtlelog.explain import Identification
from turtlelog.plants.turtlesim import TICK_NS
from turtlelog.run import CommandColumns, PoseColumns, Run, SampleColumns
from turtlelog.run.angles import wrap_angle
from turtlelog.scenario import get_preset, override_scenario
from turtlelog.simulate import simulate_run


def simulate(name: str, **changes: Any) -> Run:
    values = {key.replace("__", "."): value for key, value in changes.items()}
    return simulate_run(override_scenario(get_preset(name), values))


def add_noise(run: Run, size: float, seed: int) -> Run:
    """Return a run whose poses are off by normal noise [m, rad]."""
    rng = np.random.default_rng(seed)
    poses = run.poses
    noisy = replace(
        poses,
        xy_m=poses.xy_m + rng.normal(0.0, size, poses.xy_m.shape),
        heading_rad=wrap_angle(poses.heading_rad + rng.normal(0.0, size, len(poses))),
    )
    return replace(run, poses=noisy)


def as_log(run: Run, *, jitter_ns: int = 0, hides_start: bool = False, seed: int = 0) -> Run:
    """Return a run as its controller logs it: a pose per sample, times of its callbacks.

    The samples of a burst are about a millisecond apart; with `hides_start` the first burst's are a
    tick apart, as all others.
    """
    rng = np.random.default_rng(seed)
    samples, read = run.samples, run.samples.pose_sequence
    time_ns = samples.time_ns + rng.integers(-jitter_ns, jitter_ns + 1, len(samples))
    for row in range(1, len(samples)):
        if samples.time_ns[row] == samples.time_ns[row - 1]:
            time_ns[row] = time_ns[row - 1] + int(rng.integers(300_000, 1_500_000))
        time_ns[row] = max(time_ns[row], time_ns[row - 1] + 100_000)
    if hides_start:
        backlog = int((samples.time_ns == samples.time_ns[0]).sum())
        time_ns += np.minimum(np.arange(len(samples)), backlog - 1) * TICK_NS
    time_ns -= time_ns[0]
    absent = {"wanted_speed_m_s": None, "wanted_turn_rate_rad_s": None}
    columns = {
        found.name: getattr(samples, found.name).copy()
        for found in fields(samples)
        if found.name not in absent and getattr(samples, found.name) is not None
    }
    rows = np.arange(len(samples))
    return replace(
        run,
        source="a log",
        poses=PoseColumns(
            time_ns=time_ns,
            xy_m=run.poses.xy_m[read].copy(),
            heading_rad=run.poses.heading_rad[read].copy(),
        ),
        commands=CommandColumns(
            time_ns=time_ns,
            speed_m_s=samples.speed_m_s.copy(),
            lateral_speed_m_s=np.zeros(len(samples)),
            turn_rate_rad_s=samples.turn_rate_rad_s.copy(),
        ),
        samples=SampleColumns(
            **(columns | {"time_ns": time_ns, "sequence": rows, "pose_sequence": rows})
        ),
        parameters={},
        scenario_is_complete=False,
        stop_reason=None,
        events=(),
    )


def read_values(found: Identification, *keys: str) -> tuple[Any, ...]:
    return tuple(found.findings[key].value for key in keys)


def forget(run: Run) -> Run:
    """Return a run that knows nothing of its scenario."""
    return replace(run, parameters={}, scenario_is_complete=False, stop_reason=None, events=())
