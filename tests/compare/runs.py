"""Runs made of columns, for tests of comparison."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

import turtlelog as tl
from turtlelog.laws.sequential_p import DECLARATION
from turtlelog.run import CommandColumns, PoseColumns, SampleColumns


def make_run(
    *,
    x_m: ArrayLike = (5.0, 5.0),
    time_s: ArrayLike = (0.0, 1.0),
    heading_rad: ArrayLike | None = None,
    speed_m_s: ArrayLike = (),
    sample_time_s: ArrayLike = (),
    phase: ArrayLike | None = None,
    name: str = "made",
) -> tl.Run:
    """Return a run that moves along x, with samples where speeds are given."""
    time_ns, sample_ns = to_ns(time_s), to_ns(sample_time_s)
    x = np.asarray(x_m, dtype=float)
    speed = np.asarray(speed_m_s, dtype=float)
    count, zeros = len(speed), np.zeros(len(speed))
    heading = np.zeros(len(x)) if heading_rad is None else np.asarray(heading_rad, dtype=float)
    samples = SampleColumns(
        time_ns=sample_ns,
        sequence=np.arange(count),
        pose_sequence=np.zeros(count, dtype=np.int64),
        phase=np.full(count, 2) if phase is None else np.asarray(phase, dtype=np.int64),
        bearing_rad=zeros.copy(),
        heading_error_rad=zeros.copy(),
        error_xy_m=np.ones((count, 2)),
        distance_m=zeros.copy(),
        speed_m_s=speed,
        turn_rate_rad_s=zeros.copy(),
        world_velocity_m_s=np.zeros((count, 2)),
    )
    commands = CommandColumns(
        time_ns=sample_ns.copy(),
        speed_m_s=speed.copy(),
        lateral_speed_m_s=zeros.copy(),
        turn_rate_rad_s=zeros.copy(),
    )
    return tl.Run(
        name=name,
        source="test",
        poses=PoseColumns(
            time_ns=time_ns, xy_m=np.stack([x, np.full(len(x), 5.0)], axis=1), heading_rad=heading
        ),
        commands=commands,
        samples=samples,
        declaration=DECLARATION,
    )


def to_ns(time_s: ArrayLike) -> NDArray[np.int64]:
    return np.round(np.asarray(time_s, dtype=float) * 1e9).astype(np.int64)


def get_difference(comparison: tl.compare.RunComparison, signal: str) -> float:
    return {found.signal: found.largest for found in comparison.signals}[signal]


def change_rows(run: tl.Run, signal: str, rows: Sequence[int], by: float) -> tl.Run:
    """Return the run with rows of one signal's own column changed."""
    poses, samples = run.poses, run.samples
    if signal in {"x", "y", "heading"}:
        xy_m, heading = poses.xy_m.copy(), poses.heading_rad.copy()
        column = heading if signal == "heading" else xy_m[:, "xy".index(signal)]
        column[list(rows)] += by
        poses = dataclasses.replace(poses, xy_m=xy_m, heading_rad=heading)
    else:
        field = {"speed": "speed_m_s", "turn_rate": "turn_rate_rad_s", "phase": "phase"}
        field |= {f"wanted_{name}": f"wanted_{field[name]}" for name in ("speed", "turn_rate")}
        values = getattr(samples, field[signal]).copy()
        values[list(rows)] += type(values[0])(by)
        samples = dataclasses.replace(samples, **{field[signal]: values})
    return dataclasses.replace(run, poses=poses, samples=samples)
