"""Long runs for benchmarks: a short one, stretched."""

from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import turtlelog as tl


def lengthen_run(run: tl.Run, rows: int) -> tl.Run:
    """Return a run of that many samples, each phase as much longer."""
    chosen = np.arange(rows) * len(run.samples) // rows
    time_ns = np.arange(rows, dtype=np.int64) * 16_000_000
    number = np.arange(rows, dtype=np.int64)
    poses = take(run.poses, run.samples.pose_sequence[chosen], {"time_ns": time_ns})
    commands = take(run.commands, chosen, {"time_ns": time_ns})
    changed = {"time_ns": time_ns, "sequence": number, "pose_sequence": number}
    samples = take(run.samples, chosen, changed)
    return replace(run, poses=poses, samples=samples, commands=commands, events=())


def take(columns: Any, rows: NDArray[np.int64], changed: Mapping[str, NDArray[np.int64]]) -> Any:
    """Return rows of all columns, some of them changed."""
    taken = {column.name: getattr(columns, column.name) for column in fields(columns)}
    taken = {name: None if found is None else found[rows] for name, found in taken.items()}
    return type(columns)(**{**taken, **changed})


def write_long_recording(path: Path, rows: int, preset: str = "paper-kp1") -> None:
    """Write a recording of that many samples as the program does."""
    tl.write_recording(lengthen_run(tl.simulate_run(tl.load_scenario(preset)), rows), path)
