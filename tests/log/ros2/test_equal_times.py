import tracemalloc

import numpy as np
import pytest

from turtlelog.log.engine.topic_columns import TopicColumns
from turtlelog.log.ros2.bag_columns import OrderedRows, order_rows

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
