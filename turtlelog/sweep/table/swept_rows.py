"""The table with the results of all chunks, and the conversion of a row to a scenario."""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path
from typing import Final

from turtlelog.errors import LogError, SweepError
from turtlelog.files.text_files import parse_toml
from turtlelog.scenario import Scenario, build_scenario
from turtlelog.sweep.plan import PlannedCells, SweepPlan, build_row_scenario
from turtlelog.sweep.simulate_rows import RowResults
from turtlelog.sweep.table.kept_parts import KeptParts
from turtlelog.sweep.table.result_table import (
    ResultColumn,
    ResultTable,
    StoredTable,
    open_result_table,
)
from turtlelog.sweep.table.row_columns import (
    Columns,
    Key,
    StoredCells,
    StoredRows,
    WindowedRows,
    build_result_columns,
)

STATUS: Final = ".status"
"""Suffix of the column next to a metric, which contains the reasons for missing values."""


_STOP_REASON: Final = Key("stop_reason")
_FAILED: Final = Key("failed")


class SweptRows:
    """Known facts of the finished rows. The rows themselves are in the partial file."""

    def __init__(self, kept: KeptParts[RowResults]) -> None:
        """Load the results of an interrupted sweep."""
        self._kept = kept
        self._parts: list[tuple[int, int, int]] = []  # first row, number of rows, and place
        self._metrics: dict[str, tuple[int, int]] = {}  # first row and place of each metric
        self._units: dict[tuple[str, str], tuple[int, int]] = {}
        self.count = self.samples = self.recorded = 0
        for place in kept.places:
            self._enter(kept.read(place), place)

    def add(self, results: RowResults) -> None:
        """Save the results of a chunk."""
        self._enter(results, self._kept.add(results))

    def _enter(self, results: RowResults, place: int) -> None:
        self._parts.append((results.first, len(results), place))
        self.count += len(results)
        self.samples += results.samples
        self.recorded += results.recorded
        for number, (name, cells) in enumerate(results.metrics.items()):
            found = results.first, number
            self._metrics[name] = min(self._metrics.get(name, found), found)
            for order, unit in enumerate(cells.units):
                first = results.first, order
                self._units[name, unit] = min(self._units.get((name, unit), first), first)

    def list_gaps(self, count: int) -> list[tuple[int, int]]:
        """Return the segments of unfinished rows: the first row, and the row after the last."""
        gaps, row = [], 0
        for first, size, _ in sorted(self._parts):
            if first > row:
                gaps.append((row, first))
            row = first + size
        return [*gaps, (row, count)] if row < count else gaps

    def list_metrics(self) -> dict[str, str]:
        """Return the metrics in the order of the rows, with their units."""
        units = sorted(self._units, key=self._units.__getitem__)
        return {
            name: " or ".join(unit for other, unit in units if other == name)
            for name in sorted(self._metrics, key=self._metrics.__getitem__)
        }

    def order(self, count: int) -> WindowedRows:
        """Return the rows in order.

        Raises:
            SweepError: If rows are missing or duplicated.
        """
        stored, row = StoredRows(), 0
        for first, size, place in sorted(self._parts):
            if first != row:
                raise SweepError(f"row {row}: expected every row once, found row {first} instead")
            row += size
            stored.add(size, partial(self._load, place))
        if row != count:
            raise SweepError(f"row {row}: expected {count} rows, found {row}")
        return WindowedRows(stored, range(count))

    def _load(self, place: int) -> Columns:
        results = self._kept.read(place)
        texts = {_STOP_REASON: results.stop_reasons, _FAILED: results.failed}
        cells = {key: StoredCells.pack("text", found) for key, found in texts.items()}
        for name, metric in results.metrics.items():
            cells[Key(name, "real")] = StoredCells.pack("real", metric.values)
            cells[Key(f"{name}{STATUS}")] = StoredCells.pack("text", metric.statuses)
        return Columns(len(results), cells)


def assemble_table(plan: SweepPlan, facts: Mapping[str, str], rows: SweptRows) -> ResultTable:
    """Return the table of a sweep, whose rows are loaded on demand.

    Args:
        plan: Plan of the rows.
        facts: Facts of the sweep.
        rows: Results of the rows.

    Raises:
        SweepError: If rows are missing or duplicated.
    """
    ordered, units = rows.order(plan.row_count), rows.list_metrics()
    keys = [
        *(key for name in units for key in (Key(name, "real"), Key(f"{name}{STATUS}"))),
        *(_STOP_REASON, _FAILED),
    ]
    columns = [
        ResultColumn(name="row", type="whole", cells=range(plan.row_count)),
        *(
            ResultColumn(
                name=key,
                type=plan.find_type(key),
                cells=PlannedCells(plan, key),
                unit=find_key_unit(key),
            )
            for key in plan.keys
        ),
        *(
            replace(column, unit=units.get(column.name, column.unit))
            for column in build_result_columns(ordered, keys)
        ),
    ]
    names = [column.name for column in columns]
    twice = next((name for number, name in enumerate(names) if name in names[:number]), None)
    if twice is not None:
        raise SweepError(f"{twice}: expected one column of a name, found a key and a metric of it")
    own = {
        "varied": json.dumps(plan.keys),
        "samples": str(rows.samples),
        "recorded": str(rows.recorded),
    }
    return ResultTable(kind="sweep", columns=tuple(columns), facts={**facts, **own})


def find_key_unit(key: str) -> str | None:
    """Return the unit at the end of a key's name; None if the name has no unit."""
    found = _UNIT.search(key)
    if found is None:
        return None
    unit = found[1].replace("_s", "/s", 1) if found[1] != "s" else "s"
    return _POWER.sub(r"^\1", unit)


_UNIT: Final = re.compile(r"_((?:m|rad)(?:_s[23]?)?|s|ticks)$")
_POWER: Final = re.compile(r"(\d)$")


def list_valueless(table: StoredTable, patterns: Sequence[str]) -> dict[str, str]:
    """Return the metrics without a value in any row, with their statuses in words."""
    found: dict[str, str] = {}
    for name in table.names:
        status = f"{name}{STATUS}"
        if status in table.names and table.count_values(name) == 0:
            had = dict.fromkeys(
                text for cells in table.iterate(status) for text in cells.unique().to_pylist()
            )
            found[name] = " or ".join(text for text in had if text) or "every such row failed"
    for pattern in patterns:
        if not any(name == pattern or fnmatchcase(name, pattern) for name in table.names):
            found[pattern] = "no loop has that name"
    return found


def find_failure(table: StoredTable) -> str:
    """Return the first row that failed, with the reason."""
    texts = (text for cells in table.iterate("failed") for text in cells.to_pylist())
    return next(f"row {row}: {text}" for row, text in enumerate(texts) if text is not None)


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
    table = open_result_table(path, kind="sweep")
    place = table.find_row(row)
    try:
        keys, tables = json.loads(table.facts["varied"]), parse_toml(table.facts["base"])
        values = table.read_row(place, keys)
    except (KeyError, ValueError) as err:
        raise LogError(f"{path}: not a table of turtlelog sweep: it has no base scenario") from err
    base = build_scenario(tables, source=f"{path}")
    return build_row_scenario(base, keys, values, row, source=f"{path}", trust_law=False)
