import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.log.ros2.bags import START_NS, make_command, make_poses, write_mcap
from turtlelog.log.engine.topic_columns import TopicColumns
from turtlelog.log.ros2 import read_bag
from turtlelog.log.ros2.bag_rows import OrderedRows, order_rows

ROWS = 50_000


def order(values: list[float], time_ns: list[int]) -> OrderedRows:
    times = np.array(time_ns)
    columns = TopicColumns(
        topic="/pose",
        type="turtlesim/msg/Pose",
        log_time_ns=times,
        publish_time_ns=times,
        sequence=np.zeros(len(times), np.uint32),
        fields={},
    )
    return order_rows([columns], [{"x": np.array(values), "y": np.zeros(len(values))}])


@pytest.mark.parametrize(
    ("values", "time_ns", "kept"),
    [
        ([1.0, 2.0, 1.0, 2.0, 3.0], [5] * 5, [1.0, 2.0, 3.0]),
        ([1.0, 1.0, 1.0], [5, 5, 6], [1.0, 1.0]),
        ([0.0, -0.0], [5, 5], [0.0, -0.0]),
        ([3.0, 1.0, 3.0], [6, 5, 6], [1.0, 3.0]),
        ([1.0], [5], [1.0]),
    ],
)
def test_a_row_that_repeats_an_earlier_one_of_its_time_goes(
    values: list[float], time_ns: list[int], kept: list[float]
) -> None:
    rows = order(values, time_ns)
    assert rows.columns["x"].tolist() == kept
    assert rows.duplicates == len(values) - len(kept)


def test_a_number_that_is_none_repeats_itself() -> None:
    assert order([np.nan, np.nan], [5, 5]).duplicates == 1


def test_rows_of_one_time_take_less_than_100_bytes_each() -> None:
    times, values = [5] * ROWS, [float(row // 2) for row in range(ROWS)]
    tracemalloc.start()
    rows = order(values, times)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert rows.duplicates == ROWS // 2
    assert peak < 100 * ROWS


@pytest.mark.parametrize(("step_ns", "is_told"), [(0, True), (9_900, True), (10_100, False)])
def test_times_that_no_sensor_has_are_told(tmp_path: Path, step_ns: int, *, is_told: bool) -> None:
    said = [
        replace(one, time_ns=START_NS + row * step_ns, values={**one.values, "x": float(row)})
        for row, one in enumerate(make_poses(50))
    ]
    run = read_bag(write_mcap(tmp_path / "bag.mcap", said))
    assert ("crowded" in run.notes) is is_told
    if is_told:
        assert run.notes["crowded"].startswith("all 50 poses lie within ")


@pytest.mark.parametrize("count", [2, 3, 5])
def test_messages_of_one_time_give_no_doubt_about_units(tmp_path: Path, count: int) -> None:
    said = [
        replace(one, sequence=row, values={**one.values, "x": 0.01 * row})
        for row, one in enumerate(make_poses(count))
    ]
    for row in range(1, count, 2):
        said[row] = replace(said[row], time_ns=said[row - 1].time_ns)
    run = read_bag(write_mcap(tmp_path / "bag.mcap", said))
    assert len(run.poses) == count
    assert "unlikely_units" not in run.notes


@pytest.mark.parametrize(("value", "kept"), [(0.9e30, 3), (1.1e30, 2), (-1e308, 2)])
def test_values_of_unset_memory_are_dropped(tmp_path: Path, value: float, kept: int) -> None:
    said = [*make_poses(3, kind="geometry_msgs/msg/Pose2D", x=1.0, y=2.0, theta=0.5)]
    said = [
        replace(one, values={name: one.values[name] for name in ("x", "y", "theta")})
        for one in said
    ]
    said[1].values["x"] = value
    run = read_bag(write_mcap(tmp_path / "bag.mcap", said))
    assert len(run.poses) == kept
    assert run.notes.get("dropped_nan") == (None if kept == 3 else "1 pose")


def test_commands_of_unset_memory_are_dropped(tmp_path: Path) -> None:
    said = [*make_poses(20), make_command(1.0), make_command(1e308, number=1)]
    run = read_bag(write_mcap(tmp_path / "bag.mcap", said))
    assert run.commands.speed_m_s.tolist() == [1.0]
    assert run.notes["dropped_nan"] == "1 command"
