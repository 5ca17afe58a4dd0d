"""A sweep in one call: a table in memory, and errors that name the argument."""

import math
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pyarrow as pa
import pytest

import turtlelog as tl
from turtlelog.sweep import SweepTable, read_sweep_table

GRID = {"law.kp_linear": np.linspace(2, 4, 3), "law.kp_angular": np.array([1, 2])}
METRICS = ["run.duration", "final.position_error"]


@pytest.fixture(scope="module")
def table() -> SweepTable:
    return tl.sweep_scenario("textbook", GRID, metrics=METRICS)


def test_a_sweep_is_a_table_in_memory(table: SweepTable) -> None:
    frame = table.to_pandas()
    assert frame["law.kp_linear"].tolist() == [2.0, 2.0, 3.0, 3.0, 4.0, 4.0]
    assert frame["law.kp_angular"].tolist() == [1.0, 2.0] * 3
    assert frame.attrs["units"]["run.duration"] == "s"
    assert (len(table), table.failed) == (6, 0)
    assert pl.DataFrame(table).columns == list(frame.columns)
    assert pa.table(table).schema.field("failed").type == pa.string()


def test_rows_are_single_runs(table: SweepTable) -> None:
    run = tl.simulate_run("textbook", changes={"law.kp_linear": 3.0, "law.kp_angular": 2.0})
    row = table.to_pandas().iloc[3]
    assert [row[name] for name in METRICS] == [tl.measure_run(run)[name] for name in METRICS]


def test_a_file_has_the_same_table_and_goes_on(table: SweepTable, tmp_path: Path) -> None:
    file = tmp_path / "sweep.parquet"
    kept = tl.sweep_scenario("textbook", GRID, metrics=METRICS, output=file)
    written = file.stat().st_mtime_ns
    again = tl.sweep_scenario("textbook", GRID, metrics=METRICS, output=file)
    assert file.stat().st_mtime_ns == written
    assert kept.to_arrow().equals(table.to_arrow())
    assert again.to_arrow().equals(read_sweep_table(file).to_arrow())
    with pytest.raises(tl.errors.SweepError, match=r"sweep\.parquet"):
        tl.sweep_scenario("textbook", {"seed": [1]}, metrics=METRICS, output=file)


def test_a_row_that_fails_says_why_by_the_argument() -> None:
    grid = {"law.kp_linear": [-1.0, 2.0]}
    table = tl.sweep_scenario("textbook", grid, metrics=["run.duration"])
    frame = table.to_pandas()
    assert frame["failed"][0] == "grid: law.kp_linear: expected a number > 0, found -1.0"
    assert math.isnan(frame["run.duration"][0])
    assert repr(table) == "<SweepTable of textbook: 2 rows over law.kp_linear, 1 failed>"


@pytest.mark.parametrize(
    ("grid", "match"),
    [
        ({}, "grid: expected values by key, as in"),
        ([1.0], "grid: expected values by key, as in"),
        ({"law.kp": [1.0]}, "grid: law.kp: unknown key; did you mean"),
        ({"law.kp_linear": 1.0}, "grid: law.kp_linear: expected values, as in"),
        ({"law.kp_linear": "1:4"}, "grid: law.kp_linear: expected values, as in .* found '1:4'"),
        ({"law.kp_linear": []}, "grid: law.kp_linear: has no values; give them as in"),
        ({"law.kp_linear": [1.0, "a"]}, "expected numbers, texts or truths alone"),
        ({"law.kp_linear": [None]}, "expected numbers, texts or truths alone"),
        ({"law.kp_linear": [math.nan]}, "grid: law.kp_linear: expected a finite number"),
    ],
    ids=["empty", "list", "key", "number", "text", "none", "mixed", "null", "nan"],
)
def test_a_grid_that_is_none_is_refused(grid: Any, match: str) -> None:
    with pytest.raises(tl.TurtlelogError, match=match):
        tl.sweep_scenario("textbook", grid)


def test_a_table_shows_itself_and_is_pickled(table: SweepTable) -> None:
    assert repr(table) == "<SweepTable of textbook: 6 rows over law.kp_linear, law.kp_angular>"
    html = table._repr_html_()
    assert "run.duration [s]" in html
    assert html.count("<tr>") == 7
    assert pickle.loads(pickle.dumps(table)).to_arrow().equals(table.to_arrow())


def test_a_map_of_it_is_a_figure_that_shows_itself(table: SweepTable) -> None:
    """Draws with matplotlib: 3 s."""
    figure: Any = tl.draw_map(table, ["run.duration"])
    data, size = figure._repr_png_()
    assert data.startswith(b"\x89PNG")
    assert 300 < size["width"] < 1000
    with pytest.raises(tl.errors.SweepError, match="seed"):
        tl.draw_map(table, x="seed")
