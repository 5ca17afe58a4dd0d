import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from turtlelog.errors import LogError
from turtlelog.sweep import (
    ResultColumn,
    ResultTable,
    read_result_table,
    result_table,
    write_result_table,
)
from turtlelog.sweep.result_table import choose_type, read_result_facts


def make_table(rows: int = 3, **facts: str) -> ResultTable:
    whole = list(range(rows))
    return ResultTable(
        kind="sweep",
        columns=(
            ResultColumn(name="row", type="whole", cells=whole),
            ResultColumn(
                name="rotate.overshoot",
                type="real",
                cells=[None if row % 2 else row / 3 for row in whole],
                unit="%",
            ),
            ResultColumn(name="failed", type="text", cells=[f"é{row}" for row in whole]),
            ResultColumn(name="law.wrap_error", type="truth", cells=[row > 1 for row in whole]),
        ),
        facts=facts,
    )


def test_table_is_read_back_whole(tmp_path: Path) -> None:
    table = make_table(base="name = 'ä'\n")
    write_result_table(table, tmp_path / "t.parquet")
    assert read_result_table(tmp_path / "t.parquet", kind="sweep") == table
    assert read_result_facts(tmp_path / "t.parquet") == {
        "base": "name = 'ä'\n",
        "kind": "sweep",
        "format": "1",
        "version": table.version,
    }


def test_columns_are_read_by_name(tmp_path: Path) -> None:
    write_result_table(make_table(), tmp_path / "t.parquet")
    found = read_result_table(tmp_path / "t.parquet", kind="sweep", columns=["rotate.overshoot"])
    assert [column.name for column in found.columns] == ["rotate.overshoot"]
    assert found.find("row") is None


def test_same_table_gives_same_bytes_over_several_row_groups(tmp_path: Path) -> None:
    from pyarrow import parquet

    rows = result_table._MOST_GROUPED + 1
    for name in ("a", "b"):
        write_result_table(make_table(rows), tmp_path / name)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    assert parquet.ParquetFile(tmp_path / "a").num_row_groups == 2
    assert read_result_table(tmp_path / "a", kind="sweep") == make_table(rows)


def test_table_without_rows_is_read_back(tmp_path: Path) -> None:
    write_result_table(make_table(0), tmp_path / "t.parquet")
    assert read_result_table(tmp_path / "t.parquet", kind="sweep") == make_table(0)


def test_units_stand_where_others_read_them(tmp_path: Path) -> None:
    from pyarrow import parquet

    write_result_table(make_table(), tmp_path / "t.parquet")
    schema = parquet.read_schema(tmp_path / "t.parquet")
    assert schema.field("rotate.overshoot").metadata == {b"unit": b"%"}
    assert schema.field("row").metadata is None


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ([1, 2], "whole"),
        ([1, 2.5, None], "real"),
        ([True], "truth"),
        ([True, 1], "text"),
        (["newest"], "text"),
        ([2**63 - 1], "whole"),
        ([2**63], "text"),
        ([], "text"),
    ],
)
def test_type_of_values(values: list[object], expected: str) -> None:
    assert choose_type(values) == expected


def list_damaged(folder: Path) -> Iterator[tuple[str, str]]:
    import pyarrow
    from pyarrow import parquet

    write_result_table(make_table(), folder / "whole.parquet")
    whole = (folder / "whole.parquet").read_bytes()
    for name, content in {
        "empty": b"",
        "cut": whole[: len(whole) // 2],
        "headless": whole[len(whole) // 2 :],
        "text": b"a,b\n1,2\n",
    }.items():
        (folder / name).write_bytes(content)
        yield name, "expected a complete Parquet file, found"
    (folder / "folder").mkdir()
    yield "folder", "expected a complete Parquet file, found: Is a directory"
    yield "missing", "no such file"
    parquet.write_table(pyarrow.table({"a": [1]}), folder / "other")
    yield "other", "expected a table of sweep, found another Parquet file"
    write_result_table(
        ResultTable(kind="metrics", columns=make_table().columns), folder / "metrics"
    )
    yield "metrics", "expected a table of sweep, found a table of metrics"
    if hasattr(os, "mkfifo"):
        os.mkfifo(folder / "pipe")
        yield "pipe", "expected a file, found a pipe"


def test_what_is_no_such_table_is_one_line(tmp_path: Path) -> None:
    for name, message in list_damaged(tmp_path):
        with pytest.raises(LogError) as caught:
            read_result_table(tmp_path / name, kind="sweep")
        assert str(caught.value).startswith(f"{tmp_path / name}: {message}")
        assert "\n" not in str(caught.value)


def test_table_of_a_newer_format_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(result_table, "FORMAT", "2")
        write_result_table(make_table(), tmp_path / "t.parquet")
    with pytest.raises(LogError, match="expected a table of format 1, found format 2"):
        read_result_table(tmp_path / "t.parquet", kind="sweep")


def rewrite(path: Path, *types: tuple[pa.DataType, pa.DataType]) -> None:
    """Write a table as another tool does, whose columns have other types."""
    table, others = pq.read_table(path), dict(types)
    fields = [pa.field(one.name, others.get(one.type, one.type)) for one in table.schema]
    columns = [column.cast(others.get(column.type, column.type)) for column in table.columns]
    schema = pa.schema(fields, metadata=table.schema.metadata)
    pq.write_table(pa.table(columns, schema=schema), path)


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (pa.string(), pa.large_string()),
        (pa.string(), pa.dictionary(pa.int32(), pa.string())),
        (pa.int64(), pa.int16()),
        (pa.float64(), pa.float32()),
    ],
    ids=str,
)
def test_a_table_may_have_the_types_of_another_tool(
    before: pa.DataType, after: pa.DataType, tmp_path: Path
) -> None:
    path = tmp_path / "t.parquet"
    write_result_table(make_table(), path)
    expected = read_result_table(path, kind="sweep")
    rewrite(path, (before, after))
    found = read_result_table(path, kind="sweep")
    assert [one.type for one in found.columns] == [one.type for one in expected.columns]
    for one, other in zip(found.columns, expected.columns, strict=True):
        if one.type == "real":
            cells = np.array(one.cells, float), np.array(other.cells, float)
            np.testing.assert_allclose(*cells, rtol=1e-6)
        else:
            assert one.cells == other.cells


def test_columns_of_other_types_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "t.parquet"
    write_result_table(make_table(), path)
    rewrite(path, (pa.float64(), pa.decimal128(9, 3)))
    with pytest.raises(LogError, match="expected numbers, texts or truths, found decimal"):
        read_result_table(path, kind="sweep")


def test_a_table_without_its_metadata_says_what_lost_it(tmp_path: Path) -> None:
    path = tmp_path / "t.parquet"
    table = pa.table({"row": [0], "law.kp": [1.0], "failed": pa.nulls(1, pa.string())})
    pq.write_table(table, path)
    with pytest.raises(LogError, match="without its metadata, which pandas and polars do not"):
        read_result_table(path, kind="sweep")


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such limit")
def test_full_disk_leaves_the_file_that_was_there(tmp_path: Path) -> None:
    path = tmp_path / "t.parquet"
    write_result_table(make_table(), path)
    before = path.read_bytes()
    code = (
        "import resource, signal, sys\n"
        "from turtlelog.errors import LogError\n"
        "from turtlelog.sweep import ResultColumn, ResultTable, write_result_table\n"
        "import pyarrow.parquet, random\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, 10_000))\n"
        "cells = [random.random() for _ in range(100_000)]\n"
        "column = ResultColumn(name='a', type='real', cells=cells)\n"
        "try:\n"
        "    write_result_table(ResultTable(kind='sweep', columns=(column,)), sys.argv[1])\n"
        "except LogError as err:\n"
        "    print(err)\n"
    )

    done = subprocess.run(
        [sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=False
    )
    assert done.stdout == f"{path}: cannot be written: File too large\n"
    assert done.stderr == ""
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]
