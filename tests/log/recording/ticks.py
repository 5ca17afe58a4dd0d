"""Scenarios whose ticks a test records, and two recordings held against each other."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, BinaryIO

from tests.log.runs import assert_same
from turtlelog.log.engine.topic_columns import read_columns
from turtlelog.log.file_access import create_file
from turtlelog.log.recording.recorder import Recorder
from turtlelog.scenario import Scenario, get_preset, override_scenario
from turtlelog.simulate import Tick, iterate_ticks

POSE = 2
"""Number of the channel of poses."""


def make_scenario(preset: str = "paper", **values: Any) -> Scenario:
    changes = {key.replace("__", "."): value for key, value in values.items()}
    return override_scenario(get_preset(preset), changes)


def record(
    path: Path, scenario: Scenario, create: Callable[[Path], BinaryIO] = create_file
) -> None:
    record_ticks(path, scenario, iterate_ticks(scenario), create)


def record_ticks(
    path: Path,
    scenario: Scenario,
    ticks: Iterable[Tick],
    create: Callable[[Path], BinaryIO] = create_file,
) -> None:
    with Recorder(path, scenario, create=create) as recorder:
        for tick in ticks:
            recorder.receive(tick)


def assert_same_columns(found: Path, expected: Path) -> None:
    one, two = read_columns(found), read_columns(expected)
    assert one.keys() == two.keys()
    for topic, columns in two.items():
        for name in ("log_time_ns", "publish_time_ns", "sequence"):
            assert_same(getattr(one[topic], name), getattr(columns, name), f"{topic} {name}")
        for name, values in columns.fields.items():
            columns_found, place = one[topic].fields[name], f"{topic} {name}"
            if values.dtype.kind == "O":
                assert_same(columns_found.tolist(), values.tolist(), place)
            else:
                assert_same(columns_found, values, place)
