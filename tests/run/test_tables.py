"""A run as tables of Arrow, pandas and polars."""

import json
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import polars as pl
import pytest
from pyarrow import parquet

import turtlelog as tl
from tests.strange_law import simulate_strange
from turtlelog.errors import LibraryError, RunError
from turtlelog.run import TABLES, Run

RUN = tl.read_recording("recordings/paper/kp10.mcap")


@pytest.mark.parametrize("table", TABLES)
def test_tables_are_the_same_in_arrow_and_pandas(table: str) -> None:
    arrow, frame = RUN.to_arrow(table), RUN.to_pandas(table)
    assert arrow.column_names == list(frame.columns)
    assert arrow.num_rows == len(frame) == len(getattr(RUN, table))
    for name in arrow.column_names:
        np.testing.assert_array_equal(arrow[name].to_numpy(), frame[name].to_numpy())


def test_columns_carry_their_units() -> None:
    units = {
        field.name: (field.metadata or {}).get(b"unit") for field in RUN.to_arrow("samples").schema
    }
    assert units["time_ns"] == b"ns"
    assert units["heading_error_rad"] == b"rad"
    assert units["error_x_m"] == units["distance_m"] == b"m"
    assert units["speed_m_s"] == units["world_velocity_x_m_s"] == b"m/s"
    assert units["wanted_turn_rate_rad_s"] == b"rad/s"
    assert units["sequence"] is units["phase"] is None
    named = {name: unit.decode() for name, unit in units.items() if unit}
    assert RUN.to_pandas("samples").attrs["units"] == named


def test_table_carries_name_goal_and_scenario() -> None:
    metadata = RUN.to_arrow().schema.metadata
    assert metadata[b"turtlelog.name"] == b"paper-kp10"
    assert json.loads(metadata[b"turtlelog.goal_m_m_rad"]) == [2.0, 10.0, None]
    assert json.loads(metadata[b"turtlelog.scenario"]) == dict(RUN.parameters)
    assert json.loads(metadata[b"turtlelog.stop_reason"]) == "standstill"
    assert RUN.to_pandas().attrs["turtlelog"]["name"] == "paper-kp10"


def test_parquet_carries_what_arrow_does(tmp_path: Path) -> None:
    tl.log.export_parquet(RUN, tmp_path / "run.parquet", table="samples")
    read = parquet.read_table(tmp_path / "run.parquet")
    assert read.equals(RUN.to_arrow("samples"), check_metadata=False)
    assert read.schema.metadata == RUN.to_arrow("samples").schema.metadata
    assert read.schema.field("distance_m").metadata[b"unit"] == b"m"


def test_tables_written_from_arrow_are_the_run_with_its_loops(tmp_path: Path) -> None:
    for table in TABLES:
        parquet.write_table(RUN.to_arrow(table), tmp_path / f"{table}.parquet")
    read = tl.read_run(tmp_path)
    assert read.declaration == RUN.declaration
    assert tl.measure_run(read) == tl.measure_run(RUN)


def test_polars_reads_the_arrow_table() -> None:
    frame = pl.from_arrow(RUN.to_arrow("poses"))
    assert isinstance(frame, pl.DataFrame)
    np.testing.assert_array_equal(frame["x_m"].to_numpy(), RUN.poses.xy_m[:, 0])


def test_states_of_a_law_have_no_unit_that_nobody_gave() -> None:
    run = simulate_strange()
    frame = run.to_pandas("samples")
    for name in run.declaration.states:
        assert name in frame or f"state_{name}" in frame
        assert name not in frame.attrs["units"]


def test_table_that_is_none_is_refused() -> None:
    for build in (Run.to_arrow, Run.to_pandas):
        with pytest.raises(RunError, match=r"table: expected one of poses, .* found pose"):
            build(RUN, "pose")


def test_pandas_that_is_missing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(LibraryError, match="pandas: needed for data frames, and not installed"):
        RUN.to_pandas()
    monkeypatch.undo()
    assert isinstance(RUN.to_pandas(), pd.DataFrame)
