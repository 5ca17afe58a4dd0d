import numpy as np
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from turtlelog.show.shared_curves import choose_rows

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


def test_ten_million_rows_are_thinned_at_once() -> None:
    values = np.sin(np.linspace(0.0, 100.0, 10_000_000))
    values[1_234_567] = 7.0
    rows = choose_rows(values, most=1000)
    assert rows is not None
    assert len(rows) <= 1001
    assert 1_234_567 in rows
