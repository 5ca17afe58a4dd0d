"""The results of all chunks as one table, however they were cut; a row of it as a scenario."""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, Final

from turtlelog.errors import LogError, SweepError
from turtlelog.scenario import Scenario, build_scenario
from turtlelog.sweep.plan import SweepPlan, build_row_scenario
from turtlelog.sweep.result_table import (
    ResultColumn,
    ResultTable,
    choose_type,
    read_result_table,
)
from turtlelog.sweep.simulate_rows import MetricCells, RowResults
from turtlelog.text_files import parse_toml

STATUS: Final = ".status"
"""Ends the name of the column beside a metric that says why it has no value."""


def assemble_table(
    plan: SweepPlan, facts: Mapping[str, str], parts: Sequence[RowResults]
) -> ResultTable:
    """Return the table of a sweep.

    Args:
        plan: Its rows.
        facts: What the sweep is of.
        parts: The results of all rows, in any order.

    Raises:
        SweepError: Where rows are missing or there twice.
    """
    parts = sorted(parts, key=lambda part: part.first)
    _require_whole(plan, parts)
    count = plan.row_count
    varied = zip(*map(plan.find_values, range(count)), strict=True)
    columns = [
        ResultColumn(name="row", type="whole", cells=range(count)),
        *(
            ResultColumn(name=key, type=choose_type(cells), cells=cells, unit=find_key_unit(key))
            for key, cells in zip(plan.keys, varied, strict=True)
        ),
        *_list_metrics(parts),
        _join_texts("stop_reason", [part.stop_reasons for part in parts]),
        _join_texts("failed", [part.failed for part in parts]),
    ]
    names = [column.name for column in columns]
    twice = next((name for number, name in enumerate(names) if name in names[:number]), None)
    if twice is not None:
        raise SweepError(f"{twice}: expected one column of a name, found a key and a metric of it")
    own = {
        "varied": json.dumps(plan.keys),
        "samples": str(sum(part.samples for part in parts)),
        "recorded": str(sum(part.recorded for part in parts)),
    }
    return ResultTable(kind="sweep", columns=tuple(columns), facts={**facts, **own})


def find_key_unit(key: str) -> str | None:
    """Return the unit with which the name of a key ends, None where it has none."""
    found = _UNIT.search(key)
    if found is None:
        return None
    unit = found[1].replace("_s", "/s", 1) if found[1] != "s" else "s"
    return _POWER.sub(r"^\1", unit)


_UNIT: Final = re.compile(r"_((?:m|rad)(?:_s[23]?)?|s|ticks)$")
_POWER: Final = re.compile(r"(\d)$")


def _require_whole(plan: SweepPlan, parts: Sequence[RowResults]) -> None:
    row = 0
    for part in parts:
        if part.first != row:
            raise SweepError(f"row {row}: expected every row once, found row {part.first} instead")
        row += len(part)
    if row != plan.row_count:
        raise SweepError(f"row {row}: expected {plan.row_count} rows, found {row}")


def _join_texts(name: str, parts: Sequence[Sequence[str | None]]) -> ResultColumn:
    return ResultColumn(name=name, type="text", cells=[cell for part in parts for cell in part])


def _list_metrics(parts: Sequence[RowResults]) -> Iterator[ResultColumn]:
    names = dict.fromkeys(name for part in parts for name in part.metrics)
    for name in names:
        values: list[float | None] = []
        statuses: list[str | None] = []
        units: dict[str, None] = {}
        for part in parts:
            none: list[Any] = [None] * len(part)
            cells = part.metrics.get(name, MetricCells(units=[], values=none, statuses=none))
            values += cells.values
            statuses += cells.statuses
            units |= dict.fromkeys(cells.units)
        yield ResultColumn(name=name, type="real", cells=values, unit=" or ".join(units))
        yield ResultColumn(name=f"{name}{STATUS}", type="text", cells=statuses)


def list_valueless(table: ResultTable, patterns: Sequence[str]) -> dict[str, str]:
    """Return the metrics of which no row has a value, and what they have instead, in words."""
    found: dict[str, str] = {}
    for column in table.columns:
        statuses = table.find(f"{column.name}{STATUS}")
        if statuses is not None and all(cell is None for cell in column.cells):
            had = dict.fromkeys(cell for cell in statuses.cells if cell is not None)
            found[column.name] = " or ".join(had) or "every such row failed"
    names = [column.name for column in table.columns]
    for pattern in patterns:
        if not any(name == pattern or fnmatchcase(name, pattern) for name in names):
            found[pattern] = "no loop has that name"
    return found


def load_row_scenario(path: str | Path, row: int) -> Scenario:
    """Return the scenario of a row in a table of results. Loads no code, and trusts none in it.

    Raises:
        LogError: Where the file is no table of a sweep.
        SweepError: Where it has no such row.
        ScenarioError: Where the row makes no scenario, which is why it failed.
    """
    whole = read_result_table(path, kind="sweep", columns=["row"])
    if not 0 <= row < whole.row_count:
        last = whole.row_count - 1
        raise SweepError(f"{path}: expected a row from 0 to {last}, found {row}")
    try:
        keys, text = json.loads(whole.facts["varied"]), whole.facts["base"]
        columns = read_result_table(path, kind="sweep", columns=keys).columns
        tables = parse_toml(text)
    except (KeyError, ValueError) as err:
        raise LogError(f"{path}: expected the base scenario of a sweep, found none") from err
    base = build_scenario(tables, source=f"{path}")
    values = [column.cells[row] for column in columns]
    return build_row_scenario(base, keys, values, row, source=f"{path}", trust_law=False)
