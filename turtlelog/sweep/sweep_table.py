"""The table of a sweep: in memory, and for charts as axes with places for its rows, and metrics."""

import json
import math
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from html import escape
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import describe_count, fit_line, format_html, format_notebook
from turtlelog.errors import LogError, SweepError, TurtlelogError, describe_unknown
from turtlelog.files.text_files import parse_toml
from turtlelog.log.file_access import name_file
from turtlelog.log.parquet_file import list_cells
from turtlelog.measure import find_metric_kind
from turtlelog.run.loops import ControlLoop
from turtlelog.run.tables import Tabular
from turtlelog.scenario import Scenario, build_scenario, parse_scenario, resolve_scenario
from turtlelog.simulate import declare_scenario
from turtlelog.sweep import result_table
from turtlelog.sweep.sweep_plan import build_row_scenario

Values = NDArray[np.float64]

SEED: Final = "seed"  # key whose values are repetitions of runs, not compared

_FIRST: Final = ("stable", "overshoot", "settling_time", "position_error")
"""Metrics that are most often requested for maps, by the last part of their id, in this order."""

_LARGEST: Final = 1e150
"""Largest value on an axis: squares of differences of larger values overflow."""

_USUAL_METRICS: Final = 4
"""Default number of panels: two rows of two panels, each as wide as a column of a paper."""

MOST_METRICS: Final = 12  # panels in one picture; with more, text would be higher than the cells


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SweptAxis:
    """One axis of a sweep: a key, or keys that vary together."""

    keys: tuple[str, ...]  # dotted keys; the first gives the axis its numbers
    values: tuple[tuple[Any, ...], ...]  # per place and key. Numbers ascend, words in row order
    places: NDArray[np.int64]  # place of each row, shape (n,)
    unit: str | None  # unit of the numbers; None if they have no unit
    is_number: bool  # whether all places have finite numbers; else they are equally spaced

    def __len__(self) -> int:
        return len(self.values)

    @property
    def name(self) -> str:
        """The name of the axis: its keys."""
        return ", ".join(self.keys)

    @property
    def label(self) -> str:
        """The label of the axis, with the unit."""
        rest = f" (with {', '.join(self.keys[1:])})" if self.keys[1:] else ""
        return f"{self.keys[0]}{f' [{self.unit}]' if self.unit else ''}{rest}"

    @property
    def numbers(self) -> Values:
        """Coordinates of the places; 0, 1, 2 ... for words."""
        if self.is_number:
            return np.array([value[0] for value in self.values], dtype=np.float64)
        return np.arange(len(self.values), dtype=np.float64)

    def tell_place(self, place: int) -> str:
        """Return the values of a place in words."""
        return ", ".join(format_key_value(value) for value in self.values[place])

    def tell_keys(self, place: int) -> str:
        """Return keys and values of a place, as in `law.kp_linear = 4`."""
        pairs = zip(self.keys, self.values[place], strict=True)
        return ", ".join(f"{key} = {format_key_value(value)}" for key, value in pairs)

    def tell_row(self, row: int) -> str:
        """Return keys and values of a row."""
        return self.tell_keys(self.places[row])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SweptMetric:
    """A metric of every row."""

    name: str  # id of the metric
    unit: str  # unit of the values
    values: Values  # value of each row, shape (n,); NaN for a missing value
    reasons: Sequence[str | None]  # reason for a missing value, per row; None for an existing value

    @property
    def is_verdict(self) -> bool:
        """Whether the values are verdicts, 0 or 1 by definition, instead of quantities."""
        kind = find_metric_kind(self.name)
        return kind is not None and kind.nature == "verdict"

    @property
    def loop(self) -> str:
        """The possible loop of the metric: the part of the id before the point."""
        return self.name.rpartition(".")[0]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SweptResults:
    """The rows of a sweep."""

    path: Path | str  # path of the table
    axes: tuple[SweptAxis, ...]  # axes in the order of the plan
    metrics: tuple[SweptMetric, ...]  # requested metrics
    others: tuple[str, ...]  # ids of all other metrics
    is_sampled: bool  # whether rows were sampled at random, so that few share a place
    failed: int  # number of rows without a run
    row_count: int  # number of rows
    row_numbers: Sequence[int]  # row number of each row, as used by `run --from`
    base: Scenario  # scenario that the rows vary

    def find_axis(self, key: str) -> SweptAxis | None:
        """Return the axis of a key; None if the key does not vary."""
        return next((axis for axis in self.axes if key in axis.keys), None)

    def build_scenario(self, row: int) -> Scenario:
        """Return a row's scenario without loading code or trust; ScenarioError if it is invalid."""
        keys = [key for axis in self.axes for key in axis.keys]
        values = [value for axis in self.axes for value in axis.values[axis.places[row]]]
        number, source = self.row_numbers[row], f"{self.path}"
        return build_row_scenario(self.base, keys, values, number, source=source, trust_law=False)

    def tell_row(self, row: int) -> str:
        """Return the values of all varied keys in a row, in words."""
        return ", ".join(axis.tell_row(row) for axis in self.axes)


def read_swept_results(path: str | Path, patterns: Sequence[str] | None = None) -> SweptResults:
    """Return the rows of a table from `turtlelog sweep`, prepared for charts.

    Args:
        path: Path of the table.
        patterns: Metric ids or patterns. Default: up to four metrics, common ones first.

    Raises:
        LogError: If the file is not a table of a sweep, or has no rows.
        SweepError: If a metric does not exist, or the patterns match too many metrics.
        LibraryError: If pyarrow is not installed.
    """
    stored = result_table.open_result_table(path, kind="sweep")
    axes, is_sampled, base = _parse_facts(path, stored)
    known = [name for name in stored.names if f"{name}{result_table.STATUS}" in stored.names]
    asked = known if patterns is None else _match(path, patterns, known)
    wanted = [*(key for keys in axes for key in keys), *asked]
    wanted += [*(f"{name}{result_table.STATUS}" for name in asked), "failed"]
    wanted += [result_table.ROW] if result_table.ROW in stored.names else []
    columns = {one.name: one for one in stored.read(list(dict.fromkeys(wanted)))}
    count = stored.row_count
    if not count:
        raise LogError(f"{path}: the table has no rows")
    has_failed = np.zeros(count, dtype=bool)
    if "failed" in columns:
        failures: Any = columns["failed"].cells
        has_failed = np.asarray(failures.is_valid().to_numpy(), dtype=bool)
    with name_file(path, expected="a table of a sweep"):
        metrics = [_build_metric(columns, name, has_failed) for name in asked]
    if patterns is None:
        metrics = _choose_usual(metrics)
    shown = [metric.name for metric in metrics]
    results = SweptResults(
        path=path,
        axes=tuple(_build_axis([columns[key] for key in keys]) for keys in axes),
        metrics=tuple(metrics),
        others=tuple(name for name in known if name not in shown),
        is_sampled=is_sampled,
        failed=int(has_failed.sum()),
        row_count=count,
        row_numbers=_list_row_numbers(columns.get(result_table.ROW), count),
        base=base,
    )
    units = {loop.gain: loop.gain_unit for loop in list_declared_loops(results)}
    with_units = (replace(axis, unit=axis.unit or units.get(axis.keys[0])) for axis in results.axes)
    return replace(results, axes=tuple(with_units))


def list_declared_loops(results: SweptResults) -> Sequence[ControlLoop]:
    """Return the declared loops of the first row's law; empty if the law's code is not loaded."""
    try:
        return declare_scenario(resolve_scenario(results.build_scenario(0))).loops
    except TurtlelogError:
        return ()


def format_key_value(value: Any) -> str:
    """Return a key's value as text."""
    if isinstance(value, bool):
        return "true" if value else "false"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def load_row_scenario(path: str | Path, row: int) -> Scenario:
    """Return the scenario of a row in a result table. No code is loaded; its law is not trusted.

    Args:
        path: Path of the table.
        row: Row number, as in the column `row`.

    Raises:
        LogError: If the file is not a table of a sweep.
        SweepError: If the table has no such row.
        ScenarioError: If the row's values are not a valid scenario, and the row failed for this
            reason.
    """
    table = result_table.open_result_table(path, kind="sweep")
    place = table.find_row(row)
    try:
        keys, tables = json.loads(table.facts["varied"]), parse_toml(table.facts["base"])
        values = table.read_row(place, keys)
    except (KeyError, ValueError) as err:
        raise LogError(f"{path}: not a table of turtlelog sweep: it has no base scenario") from err
    base = build_scenario(tables, source=f"{path}")
    return build_row_scenario(base, keys, values, row, source=f"{path}", trust_law=False)


def _parse_facts(
    path: str | Path, stored: result_table.StoredTable
) -> tuple[list[tuple[str, ...]], bool, Scenario]:
    """Return the keys of each axis, whether rows were sampled at random, and the base scenario."""
    try:
        plan, tables = json.loads(stored.facts["plan"]), parse_toml(stored.facts["base"])
        axes = [*((key,) for key in plan["grid"]), *([tuple(plan["zip"])] if plan["zip"] else [])]
        is_sampled = plan["sample"] is not None
    except (KeyError, TypeError, ValueError, RecursionError) as err:
        raise LogError(f"{path}: not a table of turtlelog sweep: it has no plan") from err
    missing = [key for keys in axes for key in keys if key not in stored.names]
    if missing:
        raise LogError(f"{path}: expected a column of every key that varies, found no {missing[0]}")
    try:
        return axes, is_sampled, build_scenario(tables, source=f"{path}")
    except TurtlelogError as err:
        raise LogError(f"{path}: expected the base scenario of a sweep, found: {err}") from err


def _match(path: str | Path, patterns: Sequence[str], known: Sequence[str]) -> list[str]:
    found: dict[str, None] = {}
    for pattern in patterns:
        own = [name for name in known if name == pattern or fnmatchcase(name, pattern)]
        if not own:
            raise SweepError(f"{path}: {describe_unknown('metric', pattern, known)}")
        found |= dict.fromkeys(own)
    if len(found) > MOST_METRICS:
        raise SweepError(f"--metric: expected at most {MOST_METRICS} metrics, found {len(found)}")
    return [*found]


def _choose_usual(metrics: Sequence[SweptMetric]) -> list[SweptMetric]:
    """Return the most common metrics, varying ones first; without common ones, the first."""
    valued = [metric for metric in metrics if np.isfinite(metric.values).any()]

    def rank(metric: SweptMetric) -> tuple[bool, int]:
        last = metric.name.rpartition(".")[2]
        known = metric.values[np.isfinite(metric.values)]
        is_constant = not len(known) or bool(known.min() == known.max())
        return is_constant, _FIRST.index(last) if last in _FIRST else len(_FIRST)

    return sorted(valued or metrics[:1], key=rank)[:_USUAL_METRICS]


def _list_row_numbers(column: result_table.ResultColumn | None, count: int) -> Sequence[int]:
    if column is None:
        return range(count)
    cells: Any = column.cells
    is_whole = column.type == "whole" and not cells.null_count
    if is_whole and np.array_equal(cells.to_numpy(), np.arange(count)):
        return range(count)
    return result_table.list_row_numbers(list_cells(column.cells), count)


def _build_metric(
    columns: Mapping[str, result_table.ResultColumn], name: str, has_failed: NDArray[np.bool_]
) -> SweptMetric:
    column, statuses = columns.get(name), columns.get(f"{name}{result_table.STATUS}")
    if column is None or statuses is None or column.type != "real":
        raise LogError(f"{name}: no column of numbers with statuses")
    cells: Any = column.cells
    codes: Any = statuses.cells
    values = np.array(cells.to_numpy(), np.float64)
    reasons: list[str | None] = [None] * len(values)
    with np.errstate(invalid="ignore"):
        is_drawn = np.abs(values) <= _LARGEST
    without = np.flatnonzero(~is_drawn)
    told = list_cells(codes.take(without)) if len(without) else []
    for row, status in zip(without.tolist(), told, strict=True):
        why = "no such loop" if status is None else status.replace("_", " ")
        why = (
            "beyond 1e150"
            if not math.isnan(values[row])
            else "not a number"
            if why == "ok"
            else why
        )
        reasons[row] = "failed" if has_failed[row] else why
    values[~is_drawn] = math.nan
    return SweptMetric(name=name, unit=column.unit or "", values=values, reasons=reasons)


def _build_axis(columns: Sequence[result_table.ResultColumn]) -> SweptAxis:
    found, places = _list_distinct(columns[0])
    distinct = [(value,) for value in found]
    for column in columns[1:]:
        others, theirs = _list_distinct(column)
        pairs = places * len(others) + theirs
        rows, places = _number_by_first_row(pairs)
        both = (divmod(pair, len(others)) for pair in pairs[rows].tolist())
        distinct = [(*distinct[one], others[other]) for one, other in both]
    is_number = columns[0].type in {"whole", "real"} and all(
        value[0] is not None and math.isfinite(value[0]) for value in distinct
    )
    is_number = is_number and len({value[0] for value in distinct}) == len(distinct)
    if is_number:
        order = sorted(range(len(distinct)), key=lambda place: distinct[place][0])
        distinct, places = [distinct[place] for place in order], np.argsort(order)[places]
    return SweptAxis(
        keys=tuple(column.name for column in columns),
        values=tuple(distinct),
        places=places,
        unit=columns[0].unit,
        is_number=is_number,
    )


def _list_distinct(column: result_table.ResultColumn) -> tuple[list[Any], NDArray[np.int64]]:
    """Return the distinct values of a column in row order, and the index of each row's value.

    Only distinct cells are converted to Python values, because there may be a million rows.
    """
    cells: Any = column.cells
    if column.type == "real":
        numbers = (cells.fill_null(math.nan) if cells.null_count else cells).to_numpy()
        rows, places = _number_by_first_row(numbers)
        return [None if math.isnan(one) else one for one in numbers[rows].tolist()], places
    plain = cells.cast("string") if column.type == "text" else cells
    encoded = plain.combine_chunks().dictionary_encode(null_encoding="encode")
    return encoded.dictionary.to_pylist(), encoded.indices.to_numpy().astype(np.int64)


def _number_by_first_row(cells: NDArray[Any]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the first row of each distinct cell, ascending, and the index for every cell."""
    _, first, inverse = np.unique(cells, return_index=True, return_inverse=True)
    order = np.argsort(first)
    return first[order], np.argsort(order)[inverse]


_SHOWN_ROWS: Final = 20
"""Number of rows of the table shown in a notebook; the frame contains all rows."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class SweepTable(Tabular):
    """The results of a sweep: a table for pandas, polars and Arrow.

    The columns are the row number, the varied keys, each metric with its status, the stop reason,
    and the reason of a failure.

    Attributes:
        name: Name of the scenario that the rows vary.
        keys: Varied keys.
        table: All columns and the facts of the table.
        notes: Notes on laws that were not compiled or exceeded the step budget, one line each.
    """

    name: str
    keys: tuple[str, ...]
    table: result_table.ResultTable
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return self.table.row_count

    @property
    def failed(self) -> int:
        """Number of failed rows."""
        column = self.table.find("failed")
        return 0 if column is None else sum(cell is not None for cell in column.cells)

    def _tabulate(self) -> Mapping[str, Any]:
        return {one.name: one.cells for one in self.table.columns}

    def _list_units(self) -> Mapping[str, str]:
        return {one.name: one.unit for one in self.table.columns if one.unit}

    def to_arrow(self) -> Any:
        """Return the table as the `pyarrow.Table` that its file contains."""
        return result_table.build_result_arrow(self.table)

    def __repr__(self) -> str:
        return fit_line(f"<SweepTable of {self._describe()}>")

    def _describe(self) -> str:
        rows, failed = describe_count(len(self), "row"), self.failed
        more = f", {failed} failed" if failed else ""
        return f"{self.name}: {rows} over {', '.join(self.keys)}{more}"

    def _repr_html_(self) -> str:
        shown = [one for one in self.table.columns if one.name in self.keys or one.type == "real"]
        heads = [f"{one.name} [{one.unit}]" if one.unit else one.name for one in shown]
        rows = [[one.cells[row] for one in shown] for row in range(min(len(self), _SHOWN_ROWS))]
        rest = len(self) - len(rows)
        more = f"<p>{describe_count(rest, 'more row')}: to_pandas()</p>" if rest else ""
        notes = [f"<p>{escape(note)}</p>" for note in self.notes]
        return format_notebook(self._describe(), format_html(rows, heads=heads), more, *notes)


def read_sweep_table(path: str | Path) -> SweepTable:
    """Return the table of a sweep in a file; LogError for another file."""
    table = result_table.open_result_table(path, kind="sweep").load()
    name = parse_scenario(table.facts["base"]).name
    plan = json.loads(table.facts["plan"])
    return SweepTable(name=name, keys=(*plan["grid"], *plan["zip"]), table=table)


def read_table_results(table: SweepTable, patterns: Sequence[str] | None = None) -> SweptResults:
    """Return the rows of a table in memory for charts, as `read_swept_results` does."""
    with tempfile.TemporaryDirectory(prefix="turtlelog-") as folder:
        file = Path(folder, "sweep.parquet")
        result_table.write_result_table(table.table, file)
        return replace(read_swept_results(file, patterns), path=f"sweep of {table.name}")
