"""Runs of a turtle that answers a step, made from columns."""

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

import turtlelog as tl
from tests.sequential import DECLARATION, TRANSLATE
from turtlelog.run import CommandColumns, PoseColumns, Run, SampleColumns

Values = NDArray[np.float64]
PERIOD_NS = 16_000_000
GOAL_M = 5.0


def make_straight_run(along_m: Values, speed_m_s: Values | None = None, **changes: Any) -> Run:
    """Return a run that translates along +x to a goal at (6, 5), 5 m away, a sample a pose."""
    rows = len(along_m)
    time_ns = np.arange(rows) * PERIOD_NS
    speed = np.zeros(rows) if speed_m_s is None else speed_m_s
    zeros = np.zeros(rows)
    error_m = GOAL_M - along_m
    run = Run(
        name="straight",
        source="test",
        poses=PoseColumns(
            time_ns=time_ns,
            xy_m=np.column_stack([1.0 + along_m, zeros + 5.0]),
            heading_rad=zeros.copy(),
        ),
        commands=CommandColumns(
            time_ns=time_ns,
            speed_m_s=speed,
            lateral_speed_m_s=zeros.copy(),
            turn_rate_rad_s=zeros.copy(),
        ),
        samples=SampleColumns(
            time_ns=time_ns,
            sequence=np.arange(rows),
            pose_sequence=np.arange(rows),
            phase=np.full(rows, TRANSLATE),
            bearing_rad=zeros.copy(),
            heading_error_rad=zeros.copy(),
            error_xy_m=np.column_stack([error_m, zeros]),
            distance_m=np.abs(error_m),
            speed_m_s=speed,
            turn_rate_rad_s=zeros.copy(),
            world_velocity_m_s=np.zeros((rows, 2)),
        ),
        goal_xy_m=(1.0 + GOAL_M, 5.0),
        declaration=DECLARATION,
        parameters={"law.kp_linear": 1.0, "limits.speed_m_s": 1.0},
        stop_reason="standstill",
    )
    return dataclasses.replace(run, **changes)


def make_foreign_run(poses: int = 4, commands: int = 3) -> Run:
    """Return what a bag of somebody else's may hold: poses and commands, no samples, no goal."""
    none = np.zeros(0)
    return Run(
        name="foreign",
        source="rosbag2: foreign",
        poses=PoseColumns(
            time_ns=np.arange(poses) * PERIOD_NS,
            xy_m=np.column_stack([np.arange(poses) * 0.1, np.zeros(poses)]),
            heading_rad=np.zeros(poses),
        ),
        commands=CommandColumns(
            time_ns=np.arange(commands) * PERIOD_NS,
            speed_m_s=np.ones(commands),
            lateral_speed_m_s=np.zeros(commands),
            turn_rate_rad_s=np.zeros(commands),
        ),
        samples=SampleColumns(
            time_ns=np.zeros(0, dtype=np.int64),
            sequence=np.zeros(0, dtype=np.int64),
            pose_sequence=np.zeros(0, dtype=np.int64),
            phase=np.zeros(0, dtype=np.int64),
            bearing_rad=none,
            heading_error_rad=none.copy(),
            error_xy_m=np.zeros((0, 2)),
            distance_m=none.copy(),
            speed_m_s=none.copy(),
            turn_rate_rad_s=none.copy(),
            world_velocity_m_s=np.zeros((0, 2)),
        ),
    )


def take_rows(run: Run, rows: int) -> Run:
    """Return a run's first rows."""

    def cut(columns: Any) -> Any:
        values = {field.name: getattr(columns, field.name) for field in dataclasses.fields(columns)}
        kept = {name: value[:rows] for name, value in values.items() if value is not None}
        return dataclasses.replace(columns, **kept)

    return dataclasses.replace(
        run, poses=cut(run.poses), commands=cut(run.commands), samples=cut(run.samples)
    )


def shift_time(run: Run, shift_ns: int) -> Run:
    """Return a run that happens later."""
    poses, commands, samples = run.poses, run.commands, run.samples
    return dataclasses.replace(
        run,
        poses=dataclasses.replace(poses, time_ns=poses.time_ns + shift_ns),
        commands=dataclasses.replace(commands, time_ns=commands.time_ns + shift_ns),
        samples=dataclasses.replace(samples, time_ns=samples.time_ns + shift_ns),
    )


def set_times(run: Run, time_ns: list[int]) -> Run:
    """Return a run of a sample a pose whose rows have other times."""
    times = np.array(time_ns)
    return dataclasses.replace(
        run,
        poses=dataclasses.replace(run.poses, time_ns=times),
        commands=dataclasses.replace(run.commands, time_ns=times),
        samples=dataclasses.replace(run.samples, time_ns=times),
    )


TIME_S = np.arange(1000) * PERIOD_NS / 1e9
EXPONENTIAL = make_straight_run(-GOAL_M * np.expm1(-TIME_S), GOAL_M * np.exp(-TIME_S))


def read(run: Run, name: str, settings: tl.MeasureSettings | None = None) -> float:
    metric = tl.measure_run(run, settings, only=[name])[name]
    assert metric.value is not None, metric.reason
    return metric.value
