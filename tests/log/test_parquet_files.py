"""Parquet files that claim much, and how they are read: counted first, and without threads."""

import struct
import threading
from collections.abc import Callable
from contextlib import suppress
from io import FileIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import turtlelog as tl
from turtlelog.errors import LogError
from turtlelog.log import parquet_file
from turtlelog.log.engine import limits
from turtlelog.log.engine.limits import MOST_ROWS
from turtlelog.log.parquet_file import ParquetFile
from turtlelog.sweep.result_table import (
    ResultColumn,
    ResultTable,
    open_result_table,
    write_result_table,
)

pa = pytest.importorskip("pyarrow")
parquet = pytest.importorskip("pyarrow.parquet")
PACKAGE = Path(tl.__file__).parent


def write(path: Path, rows: int, *, more: Any = None, **options: Any) -> Path:
    """Write a drive that stands still."""
    names = ("t [s]", "x [m]", "y [m]", "heading [rad]")
    columns = dict.fromkeys(names, np.zeros(rows)) | {"t [s]": np.arange(rows) / 50.0}
    parquet.write_table(
        pa.table(columns | (more or {})), path, **{"compression": "zstd", **options}
    )
    return path


def test_arrow_reads_parquet_in_one_place_and_without_threads() -> None:
    sources = {path.relative_to(PACKAGE): path.read_text("utf-8") for path in PACKAGE.rglob("*.py")}
    calls = ("read_table", "ParquetFile", "read_schema", "read_metadata", "ParquetDataset")
    reads = [f"parquet.{call}(" for call in calls]
    found = {path.name for path, text in sources.items() if any(one in text for one in reads)}
    assert found == {"parquet_file.py"}
    text = sources[Path("log/parquet_file.py")]
    assert text.count("use_threads=False") == text.count("file.read_row_groups(") == 1
    assert text.count("pre_buffer=False") == text.count("parquet.ParquetFile(") == 1


def test_a_stream_is_read_in_the_thread_that_asks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    readers: set[str] = set()

    class Watched(FileIO):
        def read(self, size: int | None = -1) -> bytes:
            readers.add(threading.current_thread().name)
            return super().read(-1 if size is None else size)

    monkeypatch.setattr(parquet_file, "open_file", lambda path: Watched(path))
    assert len(tl.read_run(write(tmp_path / "still.parquet", 1000)).poses) == 1000
    assert readers == {threading.current_thread().name}


@pytest.mark.parametrize("rows", [MOST_ROWS, MOST_ROWS + 1])
def test_a_small_file_has_up_to_350_000_rows(rows: int, tmp_path: Path) -> None:
    path = write(tmp_path / "still.parquet", rows)
    if rows <= 350_000:
        ParquetFile(path).require_rows()
        return
    with pytest.raises(LogError, match=r"has 350,001 rows; 350,000 are the most for a file of"):
        tl.read_run(path)


def test_a_large_file_has_a_row_for_every_8_bytes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write(tmp_path / "drive.parquet", 2000, compression="none", use_dictionary=False)
    monkeypatch.setattr(limits, "SMALL_FILE", 1000)
    monkeypatch.setattr(limits, "MOST_ROWS", 1000)
    ParquetFile(path).require_rows()
    packed = write(tmp_path / "still.parquet", 2000)
    monkeypatch.setattr(limits, "ROW_BYTES", packed.stat().st_size // 2000 + 1)
    with pytest.raises(LogError, match="write it without compression"):
        ParquetFile(packed).require_rows()


def lie_about_a_page(path: Path) -> None:
    """Let the first page of 3000 rows claim 524,287 bytes, as many as 3 bytes of Thrift can."""
    data = bytearray(path.read_bytes())
    assert data[4:6] == b"\x15\x00"  # field 1: a page of data
    assert data[6] == 0x15  # field 2: its size unpacked
    data[7:10] = b"\xfe\xff\x3f"
    path.write_bytes(data)


def test_a_page_that_claims_more_than_its_rows_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "lie.parquet", 3000, use_dictionary=False)
    assert len(tl.read_run(path).poses) == 3000
    lie_about_a_page(path)
    with pytest.raises(LogError, match=r"a page of up to 113,536 bytes, found 524,287"):
        tl.read_run(path)


TEXTS: dict[str, tuple[Any, dict[str, Any]]] = {
    "long": (["a" * 3_000_000] * 10, {"use_dictionary": False}),
    "prefixes": (
        ["a" * 3_000_000] * 10,
        {"use_dictionary": False, "column_encoding": {"when": "DELTA_BYTE_ARRAY"}},
    ),
}


@pytest.mark.parametrize("kind", TEXTS)
def test_long_texts_are_refused_before_they_are_unpacked(kind: str, tmp_path: Path) -> None:
    texts, options = TEXTS[kind]
    path = write(tmp_path / "texts.parquet", 10, more={"when": pa.array(texts)}, **options)
    with pytest.raises(LogError, match=r"the texts may take more than 25,\d{3},\d{3} bytes"):
        tl.read_run(path, columns={"t": "when"})


def test_a_text_that_repeats_is_in_memory_once(tmp_path: Path) -> None:
    texts = pa.array(["b" * 1_000_000]).take(pa.array([0] * 200))
    path = write(tmp_path / "texts.parquet", 200, more={"when": texts})
    cells = parquet_file.list_cells(ParquetFile(path).read(["when"])["when"])
    assert [*map(len, cells)] == [1_000_000] * 200
    assert len({id(cell) for cell in cells}) == 1


@pytest.mark.parametrize("encoding", ["PLAIN", "DELTA_LENGTH_BYTE_ARRAY", "DELTA_BYTE_ARRAY"])
def test_texts_of_every_encoding_are_read(encoding: str, tmp_path: Path) -> None:
    options = {"use_dictionary": False, "column_encoding": {"when": encoding}}
    times = [f"2026-11-24 10:00:{second:02}" for second in range(50)]
    path = write(tmp_path / "dates.parquet", 50, more={"when": times}, **options)
    run = tl.read_run(path, columns={"t": "when"})
    assert run.poses.time_ns.tolist() == [second * 10**9 for second in range(50)]


def nest(depth: int) -> Any:
    inner = pa.array([0.0] * 3)
    for _ in range(depth - 1):
        inner = pa.StructArray.from_arrays([inner], ["inner"])
    return inner


@pytest.mark.parametrize("depth", [32, 33])
def test_columns_lie_up_to_32_deep(depth: int, tmp_path: Path) -> None:
    path = write(tmp_path / "deep.parquet", 3, more={"deep": nest(depth)})
    if depth <= 32:
        assert len(tl.read_run(path).poses) == 3
        return
    with pytest.raises(LogError, match="columns lie 33 deep in each other"):
        tl.read_run(path)


def varint(number: int) -> bytes:
    return bytes([number & 127 | 128]) + varint(number >> 7) if number > 127 else bytes([number])


def make_footer(columns: int, length: int | None = None) -> bytes:
    """Return a file of one group whose columns say nothing but that they are there."""
    leaf = b"\x48\x01r\x15\x02\x00" + b"\x15\x0a\x25\x00\x18\x01a\x00"
    chunks = b"\x19\xfc" + varint(columns) + b"\x26\x00\x00" * columns
    group = b"\x19\x1c" + chunks + b"\x16\x00\x16\x00\x00"
    footer = b"\x15\x02\x19\x2c" + leaf + b"\x16\x00" + group + b"\x00"
    return b"PAR1" + footer + struct.pack("<I", length or len(footer)) + b"PAR1"


FOOTERS: dict[str, tuple[Callable[[], bytes], str]] = {
    "columns": (lambda: make_footer(300_000), "up to 72,567 columns, groups and other parts"),
    "long": (lambda: make_footer(900_000), "expected a footer of up to 2,265,904 bytes"),
    "cut": (lambda: make_footer(10, 2**31), "expected a complete Parquet file, found 73 bytes"),
    "list": (lambda: make_footer(10)[:28] + b"\xff" * 30 + make_footer(10)[58:], "complete"),
}


def test_a_damaged_footer_is_one_error_whatever_it_says(tmp_path: Path) -> None:
    sound = write(tmp_path / "sound.parquet", 5).read_bytes()
    path, start = tmp_path / "harmed.parquet", len(sound) - 1200
    for place in range(start, len(sound), 23):
        for bit in (1, 8, 64):
            harmed = bytearray(sound)
            harmed[place] ^= bit
            path.write_bytes(harmed)
            with suppress(LogError):
                tl.read_run(path)


@pytest.mark.parametrize("kind", FOOTERS)
def test_a_footer_is_counted_before_arrow_reads_it(kind: str, tmp_path: Path) -> None:
    build, expected = FOOTERS[kind]
    path = tmp_path / "footer.parquet"
    path.write_bytes(build())
    with pytest.raises(LogError, match=expected):
        tl.read_run(path)


def test_a_table_of_many_columns_is_read_by_those_that_are_used(tmp_path: Path) -> None:
    more = {f"c{number}": np.zeros(2) for number in range(1000)}
    assert len(tl.read_run(write(tmp_path / "wide.parquet", 2, more=more)).poses) == 2


def test_lists_are_refused_by_name(tmp_path: Path) -> None:
    path = write(tmp_path / "lists.parquet", 2, more={"r": pa.array([[1.0], [2.0]])})
    assert len(tl.read_run(path).poses) == 2
    with pytest.raises(LogError, match="found lists"):
        ParquetFile(path).read(["r"])


def test_a_table_of_results_may_have_more_rows_and_is_read_in_groups(tmp_path: Path) -> None:
    count = MOST_ROWS + 1
    rows = ResultColumn(name="row", type="whole", cells=range(count))
    path = tmp_path / "sweep.parquet"
    write_result_table(ResultTable(kind="sweep", columns=(rows,)), path)
    assert open_result_table(path, kind="sweep").row_count == count
    table = ParquetFile(path)
    table.require_cells(columns=16, rows=MOST_ROWS)
    with pytest.raises(LogError, match="17 columns of 350,000 rows; 5,600,000 cells are the most"):
        table.require_cells(columns=17, rows=MOST_ROWS)
