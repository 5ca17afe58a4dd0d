import sys
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import IndexType, Writer

from tests.log.engine.files import POINT, pack, write_points
from turtlelog.errors import LogError
from turtlelog.log import read_columns
from turtlelog.log.engine.decode import LOG_TIME, SEQUENCE, FixedColumns, Selection
from turtlelog.log.engine.message_types import Layout, read_type
from turtlelog.log.engine.opening import open_source
from turtlelog.log.engine.topic_columns import _SHARE, _SPARE, _set_aside, count_rows

INDEXED = IndexType.CHUNK | IndexType.MESSAGE
POINT_RECORD = 31 + 4 + 16  # bytes


def write_promise(path: Path, promise: int, index_types: IndexType) -> Path:
    """Write three points, and statistics that promise another number of them."""
    with path.open("wb") as stream:
        writer = Writer(stream, index_types=index_types)
        writer.start(profile="ros2")
        schema = writer.register_schema("t/msg/Point", "ros2msg", POINT.encode())
        channel = writer.register_channel("/p", "cdr", schema)
        for number in range(3):
            data = pack([("float64", number), ("float64", 0)])
            writer.add_message(channel, number, data, number, number)
        statistics = writer._Writer__statistics  # type: ignore[attr-defined]
        statistics.channel_message_counts[channel] = promise
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def lay_out() -> Layout:
    layout = read_type("test/Point", POINT).layout
    assert layout is not None
    return layout


@pytest.mark.parametrize("index_types", [INDEXED, IndexType.NONE])
@pytest.mark.parametrize("promise", [1, 4, 2**62])
def test_a_wrong_promise_is_damage(promise: int, index_types: IndexType, tmp_path: Path) -> None:
    path = write_promise(tmp_path / "a.mcap", promise, index_types)
    expected = rf"expected {promise} messages as the statistics say, found 3"
    with pytest.raises(LogError, match=expected):
        read_columns(path)


@pytest.mark.parametrize(("more", "is_believed"), [(0, True), (1, False)])
def test_only_what_the_file_may_hold_is_set_aside(
    more: int, tmp_path: Path, *, is_believed: bool
) -> None:
    path = write_promise(tmp_path / "a.mcap", 0, IndexType.NONE)
    most = _SHARE * path.stat().st_size + _SPARE
    write_promise(path, most // POINT_RECORD + more, IndexType.NONE)
    with open_source(path) as source:
        found = _set_aside(source, Selection(), count_rows(source, Selection()))
    assert [*found] == ["/p"] * is_believed


@pytest.mark.parametrize(("count", "is_alone"), [(2**19, True), (2**19 - 1, False)])
def test_columns_of_four_mebibytes_stand_alone(count: int, *, is_alone: bool) -> None:
    columns = FixedColumns(lay_out(), count)
    columns.fill(b"", np.empty(0, np.int64), count)
    rows = columns.finish()
    buffers = {name: np.asarray(column.base) for name, column in rows.items()}
    assert (buffers["x"].nbytes == 2**22) == is_alone
    assert np.shares_memory(buffers["x"], rows["y"]) != is_alone
    assert buffers[SEQUENCE].nbytes > rows[SEQUENCE].nbytes or is_alone
    assert all(column.ctypes.data % column.itemsize == 0 for column in rows.values())


def test_what_has_no_room_is_left_to_others() -> None:
    data = b"".join(
        b"\5" + (22 + 20).to_bytes(8, "little") + bytes(22) + pack([("float64", 7), ("float64", 8)])
        for _ in range(3)
    )
    starts = np.arange(0, len(data), POINT_RECORD)
    columns = FixedColumns(lay_out(), 4)
    assert columns.fill(data, starts, 0)
    assert not columns.fill(data, starts, 3)
    rows = columns.finish()
    assert (len(rows[LOG_TIME]), rows["x"].tolist()) == (3, [7, 7, 7])


@pytest.mark.parametrize("index_types", [INDEXED, IndexType.NONE])
def test_points_stand_in_the_order_of_the_file(index_types: IndexType, tmp_path: Path) -> None:
    path = write_points(
        tmp_path / "a.mcap", range(0, 1000, 10), chunk_size=200, index_types=index_types
    )
    assert read_columns(path)["/p"].fields["x"].tolist() == [*range(100)]


def test_threads_that_fill_at_once_lose_no_row() -> None:
    message = b"\5" + (22 + 20).to_bytes(8, "little") + bytes(22)
    data = message + pack([("float64", 7), ("float64", 8)])
    former = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(4) as pool:
            for _ in range(400):
                columns = FixedColumns(lay_out(), 16)
                fill = partial(columns.fill, data, np.zeros(1, np.int64))
                assert all(pool.map(fill, range(16)))
                assert len(columns.finish()[LOG_TIME]) == 16
    finally:
        sys.setswitchinterval(former)
