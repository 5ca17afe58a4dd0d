"""Recordings read back by column, with Rerun's own reader."""

import subprocess
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rerun.chunk import RrdReader

from turtlelog.draw.rerun.viewer import find_viewer
from turtlelog.explain import Attribution, Contribution, Resolution, ResolutionReason
from turtlelog.measure import measure_run, read_signal
from turtlelog.run import CommandColumns, PoseColumns, Run, SampleColumns
from turtlelog.run.loops import Declaration
from turtlelog.scenario import get_preset
from turtlelog.simulate import simulate_run

NOTHING_NS = np.zeros(0, dtype=np.int64)


@cache
def simulate_preset(name: str) -> Run:
    return simulate_run(get_preset(name))


def make_attribution(
    run: Run, shares: Mapping[str, float], metric: str = "final.position_error"
) -> Attribution:
    """Return what says that a run's value has these shares."""
    measured = measure_run(run, only=[metric])[metric]
    value = measured.value or 0.0
    return Attribution(
        metric=metric,
        unit=measured.unit,
        as_logged=value,
        resimulated=value,
        without_all=value - sum(shares.values()),
        causes=tuple(shares),
        contributions=tuple(
            Contribution(cause=name, contribution=share, alone=None, meaning="none of it")
            for name, share in shares.items()
        ),
        others=(),
        resolution=Resolution(size=0.001, reason=ResolutionReason.COUNT),
    )


def make_foreign_run(rows: int) -> Run:
    """Return what a bag of another robot holds: poses, and commands without a controller's view."""
    time_ns = np.arange(rows, dtype=np.int64) * 33_000_000 + 5_000
    turn_rad = time_ns / 3e9
    values = np.linspace(-0.5, 0.5, rows)
    run = simulate_preset("paper-kp10")
    return replace(
        run,
        name="bag",
        source="rosbag2",
        poses=PoseColumns(
            time_ns=time_ns,
            xy_m=np.column_stack([np.cos(turn_rad), np.sin(turn_rad)]),
            heading_rad=np.zeros(rows),
        ),
        commands=CommandColumns(
            time_ns=time_ns, speed_m_s=values, lateral_speed_m_s=values, turn_rate_rad_s=-values
        ),
        samples=SampleColumns(
            time_ns=NOTHING_NS,
            sequence=NOTHING_NS,
            pose_sequence=NOTHING_NS,
            phase=NOTHING_NS,
            speed_m_s=np.zeros(0),
            turn_rate_rad_s=np.zeros(0),
        ),
        goal_xy_m=None,
        declaration=Declaration(),
        parameters={},
        stop_reason=None,
        events=(),
    )


def read_values(name: str) -> NDArray[np.float64]:
    """Return a signal of the run that most tests are of."""
    signal = read_signal(simulate_preset("paper-kp10"), name)
    return signal.values


def join_strips(path: Path, entity: str) -> NDArray[np.float64]:
    """Return the points of strips that begin where the last one ended."""
    strips = [np.array(strip) for strip in read_static(path, entity, "LineStrips2D:strips")]
    for before, after in pairwise(strips):
        np.testing.assert_array_equal(before[-1], after[0])
    return np.concatenate([strips[0], *(strip[1:] for strip in strips[1:])])


def read_times(
    path: Path, entity: str, timeline: str = "sim_time", component: str | None = None
) -> NDArray[np.int64]:
    return np.concatenate(
        [
            batch.column(batch.schema.get_field_index(timeline)).cast("int64").to_numpy()
            for batch in _read_batches(path, entity, is_static=False)
            if component is None or component in batch.schema.names
        ]
    )


def read_rows(path: Path, entity: str, component: str) -> list[list[Any]]:
    return [
        row
        for batch in _read_batches(path, entity, is_static=False)
        if component in batch.schema.names
        for row in batch.column(batch.schema.get_field_index(component)).to_pylist()
    ]


def read_static(path: Path, entity: str, component: str) -> list[Any]:
    values = [
        batch.column(batch.schema.get_field_index(component)).to_pylist()[0]
        for batch in _read_batches(path, entity, is_static=True)
        if component in batch.schema.names
    ]
    assert len(values) == 1
    return list(values[0])


def list_entities(path: Path) -> set[str]:
    return {chunk.entity_path for chunk in RrdReader(path).stream()}


def count_chunks(path: Path, entity: str) -> int:
    return len(_read_batches(path, entity, is_static=False))


def list_timelines(path: Path) -> set[str]:
    return {
        field.name
        for chunk in RrdReader(path).stream()
        for field in chunk.to_record_batch().schema
        if (field.metadata or {}).get(b"rerun:kind") == b"index"
    }


def read_layout(path: Path) -> dict[str, list[str]]:
    """Return the views of the embedded layout: name to what it shows."""
    reader = RrdReader(path)
    names: dict[str, str] = {}
    contents: dict[str, list[str]] = {}
    for chunk in reader.stream(store=reader.blueprints()[0]):
        batch = chunk.to_record_batch()
        columns = dict(zip(batch.schema.names, batch.columns, strict=True))
        view = "/".join(chunk.entity_path.split("/")[:3])
        if "ViewBlueprint:display_name" in columns:
            names[view] = columns["ViewBlueprint:display_name"].to_pylist()[0][0]
        if "ViewContents:query" in columns:
            contents[view] = columns["ViewContents:query"].to_pylist()[0]
    return {name: contents.get(view, []) for view, name in names.items()}


def read_blueprint(path: Path, entity: str) -> dict[str, Any]:
    """Return the components of one part of the embedded layout, by name."""
    reader = RrdReader(path)
    chunks = reader.stream(store=reader.blueprints()[0])
    batches = [chunk.to_record_batch() for chunk in chunks if chunk.entity_path == entity]
    return {
        name: batch.column(name).to_pylist()[0]
        for batch in batches
        for name in batch.schema.names
        if ":" in name and not name.startswith("rerun")
    }


def read_blueprint_parts(path: Path, component: str) -> list[Any]:
    """Return the values of a component in all parts of the embedded layout."""
    reader = RrdReader(path)
    batches = [chunk.to_record_batch() for chunk in reader.stream(store=reader.blueprints()[0])]
    found = [batch.column(component) for batch in batches if component in batch.schema.names]
    return [value for column in found for value in column.to_pylist()[0]]


def verify(path: Path) -> None:
    command = [str(find_viewer()), "rrd", "verify", str(path)]
    answer = subprocess.run(command, capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stderr


def _read_batches(path: Path, entity: str, *, is_static: bool) -> list[Any]:
    chunks = RrdReader(path).stream().filter(content=entity, is_static=is_static)
    return [chunk.to_record_batch() for chunk in chunks]
