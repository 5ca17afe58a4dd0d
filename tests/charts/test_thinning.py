import numpy as np
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from turtlelog.charts.curves import choose_rows

COLUMNS = arrays(np.float64, st.integers(50, 400), elements=st.floats(-1e6, 1e6))


def test_few_rows_stay_as_they_are() -> None:
    assert choose_rows(np.arange(10.0), most=10) is None


@given(COLUMNS)
def test_extremes_and_ends_stay(values: np.ndarray) -> None:
    rows = choose_rows(values, most=30)
    assert rows is not None
    assert (rows[0], rows[-1]) == (0, len(values) - 1)
    assert (values[rows].min(), values[rows].max()) == (values.min(), values.max())


@given(COLUMNS, st.integers(0, 49))
def test_a_lone_spike_stays(values: np.ndarray, place: int) -> None:
    values = values.copy()
    values[place] = 1e7
    rows = choose_rows(values, most=30)
    assert rows is not None
    assert place in rows


@given(COLUMNS)
def test_rows_rise_and_are_few(values: np.ndarray) -> None:
    rows = choose_rows(np.column_stack([values, -values]), most=40)
    assert rows is not None
    assert (np.diff(rows) > 0).all()
    assert len(rows) <= 41


@given(COLUMNS)
def test_gaps_hide_no_extremes(values: np.ndarray) -> None:
    values = values.copy()
    values[::3] = np.nan
    rows = choose_rows(values, most=30)
    assert rows is not None
    kept = values[rows]
    assert (np.nanmin(kept), np.nanmax(kept)) == (np.nanmin(values), np.nanmax(values))


def test_a_gap_of_one_row_stays_a_gap() -> None:
    values = np.arange(400.0)
    values[7] = np.nan
    rows = choose_rows(values, most=30)
    assert rows is not None
    assert 7 in rows


@given(COLUMNS)
def test_with_gaps_rows_are_as_few(values: np.ndarray) -> None:
    values = values.copy()
    values[1::2] = np.nan
    rows = choose_rows(np.column_stack([values, -values]), most=42)
    assert rows is not None
    assert len(rows) <= 43


@given(COLUMNS, st.lists(st.integers(0, 49), max_size=5))
def test_rows_that_are_asked_for_stay(values: np.ndarray, asked: list[int]) -> None:
    rows, usual = choose_rows(values, most=30, always=np.array(asked, int)), choose_rows(values, 30)
    assert rows is not None
    assert usual is not None
    np.testing.assert_array_equal(rows, np.union1d(usual, np.array(asked, int)))


def test_ten_million_rows_are_thinned_at_once() -> None:
    values = np.sin(np.linspace(0.0, 100.0, 10_000_000))
    values[1_234_567] = 7.0
    rows = choose_rows(values, most=1000)
    assert rows is not None
    assert len(rows) <= 1001
    assert 1_234_567 in rows
