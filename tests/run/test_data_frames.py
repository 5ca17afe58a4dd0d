"""What Python's data libraries make of runs, signals, metrics and tables: right, or an error."""

from typing import Any

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pytest

import turtlelog as tl
from turtlelog.run.tables import Tabular

FILE = "recordings/paper/kp10.mcap"
RUN = tl.read_recording(FILE)
METRICS = tl.measure_run(RUN)
SIGNAL = tl.read_signal(RUN, "heading")
TABLE = tl.tabulate_runs([tl.summarise_run(RUN)])
TOPIC = tl.read_columns(FILE)["/turtle1/pose"]


def test_a_signal_is_an_array() -> None:
    assert SIGNAL is not None
    np.testing.assert_array_equal(np.asarray(SIGNAL), SIGNAL.values)
    assert np.asarray(SIGNAL, dtype=np.float32).dtype == np.float32
    assert np.array(SIGNAL).flags.writeable
    assert (len(SIGNAL), SIGNAL[-1], list(SIGNAL)[3]) == (
        len(SIGNAL.values),
        SIGNAL.values[-1],
        SIGNAL.values[3],
    )
    np.testing.assert_array_equal(pd.Series(SIGNAL), SIGNAL.values)


def test_a_signal_as_a_series_has_time_as_its_index() -> None:
    assert SIGNAL is not None
    series = SIGNAL.to_pandas()
    assert (series.name, series.index.name, series.attrs) == ("heading", "time_s", {"unit": "rad"})
    assert series.index[-1] == RUN.duration_s
    assert series[series.index == 0.0].iloc[0] == SIGNAL.values[4]  # four poses came before


def test_metrics_are_a_table() -> None:
    frame = METRICS.to_pandas().set_index("id")
    assert frame.loc["run.duration", "value"] == 12.608
    assert frame.loc["final.goal_heading_error", "reason"] == "the goal asks for no heading"
    assert len(frame) == len(METRICS) == 135
    assert frame["value"].dtype == np.float64
    assert pl.DataFrame(METRICS).columns == list(METRICS.to_pandas().columns)


@pytest.mark.parametrize("build", [pd.DataFrame, pd.Series, np.asarray])
def test_metrics_where_only_their_names_would_be_taken_are_refused(build: Any) -> None:
    with pytest.raises(TypeError, match=r"Metrics is a table, not an array: to_pandas\(\)"):
        build(METRICS)


def test_metrics_without_a_value_are_a_table_of_numbers_too() -> None:
    metrics = tl.measure_run(RUN, only=["final.goal_heading_error"])
    assert metrics.to_arrow().schema.field("value").type == pa.float64()
    assert tl.measure_run(RUN, only=["none_of_it.*"] * 0).to_pandas().empty


@pytest.mark.parametrize("value", [METRICS, TABLE, TOPIC], ids=["metrics", "table", "topic"])
def test_tables_are_the_same_in_pandas_polars_and_arrow(value: Tabular) -> None:
    frame, arrow = value.to_pandas(), pa.table(value)
    assert list(frame.columns) == arrow.column_names == pl.DataFrame(value).columns
    for name in arrow.column_names:
        assert arrow[name].to_pandas().equals(pd.DataFrame.from_arrow(value)[name])
    units = {
        field.name: field.metadata[b"unit"].decode() for field in arrow.schema if field.metadata
    }
    assert frame.attrs["units"] == units


def test_a_run_is_its_poses_for_polars_and_arrow() -> None:
    assert pl.DataFrame(RUN).equals(pl.DataFrame(RUN.to_arrow("poses")))
    with pytest.raises(ValueError, match="not properly called"):
        pd.DataFrame(RUN)


def test_fields_of_a_topic_are_a_frame() -> None:
    frame = pd.DataFrame(TOPIC.fields)
    assert list(frame.columns) == [*TOPIC.fields]
    np.testing.assert_array_equal(frame["theta"], TOPIC.fields["theta"])


def test_a_table_of_texts_and_numbers_in_one_column_is_one_of_texts() -> None:
    columns = tuple(tl.compare.Column(title=title) for title in ("value", "value"))
    table = tl.compare.Table(title="", columns=columns, rows=((1.5, 2), ("none", None)))
    assert table.to_arrow().to_pydict() == {"value": ["1.5", "none"], "value_2": [2, None]}


def test_rows_that_are_arrays_are_lists_in_a_table() -> None:
    class Wide(Tabular):
        def _tabulate(self) -> dict[str, Any]:
            return {"a": np.arange(4).reshape(2, 2)}

    assert pl.DataFrame(Wide())["a"].to_list() == [[0, 1], [2, 3]]
    assert [*Wide().to_pandas()["a"][1]] == [2, 3]


def test_xarray_gets_times_units_and_facts() -> None:
    found = RUN.to_xarray("samples")
    assert (found.distance_m.dims, found.distance_m.attrs) == (("time_s",), {"units": "m"})
    np.testing.assert_array_equal(found.distance_m, RUN.samples.distance_m)
    assert found.time_s[0] == 0.0
    assert found.attrs["name"] == RUN.name
    poses = RUN.to_xarray()
    at = poses.sel(time_s=float(poses.time_s[1]) + 1e-4, method="nearest")
    assert at.x_m == RUN.poses.xy_m[1, 0]
