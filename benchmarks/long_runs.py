"""Long runs for benchmarks: a short one, stretched."""

from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray

import turtlelog as tl
from turtlelog.log.engine.channels import find_definition


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


def write_long_bag(path: Path, rows: int) -> None:
    """Write a bag of a robot that drives in circles: poses with stamps at 50 Hz, nothing else."""
    number = np.arange(rows)
    time_ns = number * 20_000_000 + 1_700_000_000_000_000_000
    turned = number * 0.002
    messages = np.zeros(rows, _STAMPED)
    messages["encapsulation"] = 0x0100
    messages["sec"], messages["nanosec"] = np.divmod(time_ns, 1_000_000_000)
    messages["length"], messages["frame"] = 5, b"odom"
    messages["position"] = np.stack([np.sin(turned), 1 - np.cos(turned), 0 * turned], axis=1)
    messages["orientation"][:, 2:] = np.stack([np.sin(turned / 2), np.cos(turned / 2)], axis=1)
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE)
        writer.start(profile="ros2", library="bench")
        name = "geometry_msgs/msg/PoseStamped"
        schema = writer.register_schema(name, "ros2msg", (find_definition(name) or "").encode())
        channel = writer.register_channel("/pose", "cdr", schema)
        for at_ns, message in zip(time_ns.tolist(), messages, strict=True):
            writer.add_message(channel, log_time=at_ns, data=message.tobytes(), publish_time=at_ns)
        writer.finish()  # type: ignore[no-untyped-call]


_STAMPED = np.dtype(
    [
        *(("encapsulation", "<u2"), ("options", "<u2"), ("sec", "<i4"), ("nanosec", "<u4")),
        *(("length", "<u4"), ("frame", "S5"), ("gap", "V7")),
        *(("position", "<f8", 3), ("orientation", "<f8", 4)),
    ]
)
"""A geometry_msgs/msg/PoseStamped in CDR, whose numbers of 64 bits are aligned."""
