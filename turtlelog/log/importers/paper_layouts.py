"""The two layouts of the paper's logs: JSON with `metadata` and `data`; CSV with its lists."""

import csv
import json
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from sys import intern
from types import MappingProxyType
from typing import Any, Final

from turtlelog.errors import LogError
from turtlelog.files.text_files import describe_csv_error, iterate_lines
from turtlelog.log.importers.paper_log import NUMBERS, PaperLog, build_columns, require_number

_PARAMETERS: Final = MappingProxyType(
    {
        "law.kp_angular": ("controller_gains", "Kp_angular"),
        "law.kp_linear": ("controller_gains", "Kp_linear"),
        "law.heading_tolerance_rad": ("tolerances", "angle"),
        "law.position_tolerance_m": ("tolerances", "linear"),
        "limits.speed_m_s": ("speed_limits", "max_linear_speed"),
        "limits.turn_rate_rad_s": ("speed_limits", "max_angular_speed"),
        "goal.x_m": ("target_position", "x"),
        "goal.y_m": ("target_position", "y"),
    }
)
"""Where the metadata holds a key of a scenario."""

_PLACES: Final = MappingProxyType({name: f"data.{name}" for name in (*NUMBERS, "state")})

_MOST_SIGNS: Final = 2**17
"""Lists, objects and keys of a JSON text: thousands of times what a log has."""

_HEADINGS: Final = MappingProxyType(
    {name: name for name in (*NUMBERS, "state")} | {"error_angle": "error_angle_rad"}
)
"""What a list is called in this layout."""

PAPER_MARKS: Final = frozenset({"target_angle_rad", "error_angle_rad", "vel_x_global"})
"""Columns of a CSV that tell this layout from other tables."""


def parse_paper_json(text: str, path: Path) -> PaperLog:
    """Return the log in a JSON text.

    Raises:
        LogError: Where it is no JSON, or not of this layout.
    """
    tables = _require_table("the file", _parse_json(text))
    data = _require_table("data", tables.get("data"))
    lists = {name: _require_list(name, data) for name in _PLACES}
    for name, values in lists.items():
        if len(values) != len(lists["time"]):
            expected = f"{len(lists['time'])} values as in data.time"
            raise LogError(f"data.{name}: expected {expected}, found {len(values)}")
    columns, states = build_columns(lists, _PLACES)
    metadata = _require_table("metadata", tables.get("metadata"))
    parameters = _read_parameters(metadata)
    timestamp = _read_text(metadata, "timestamp")
    return PaperLog(
        name=_read_text(metadata, "experiment_name") or path.stem,
        source=f"paper-json: {path.name}",
        columns=columns,
        states=states,
        parameters=parameters,
        absent=tuple(f"parameters.{key}" for key in _PARAMETERS if key not in parameters),
        notes={} if timestamp is None else {"original_timestamp": timestamp},
    )


def _parse_json(text: str) -> object:
    # An empty list of two letters takes 64 bytes in memory, a key of five 200.
    for sign, noun in (("[", "lists"), ("{", "objects"), (":", "keys")):
        if text.count(sign) > _MOST_SIGNS:
            raise LogError(
                f"the JSON text has more than {_MOST_SIGNS:,} {noun}; a log of the paper's layout"
                " has 13 lists of numbers and some 30 keys. Convert it to CSV with a header"
            )
    try:
        return json.loads(text, object_pairs_hook=_refuse_duplicates)
    except RecursionError as err:
        raise LogError("expected a log, found JSON that is nested too deeply") from err
    except ValueError as err:
        raise LogError(f"expected JSON, found: {err}") from err


def _refuse_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    table = dict(pairs)
    if len(table) != len(pairs):
        counts = Counter(key for key, _ in pairs)
        twice = next(key for key, count in counts.items() if count > 1)
        raise LogError(f"{twice}: expected one list of that name, found several")
    return table


def _require_table(place: str, value: object) -> Mapping[str, Any]:
    if not isinstance(value, dict):
        found = "no value" if value is None else type(value).__name__
        raise LogError(
            f"{place}: expected a JSON object, as the paper's logs have it, found {found}"
        )
    return value


def _require_list(name: str, data: Mapping[str, Any]) -> list[object]:
    values = data.get(name)
    if not isinstance(values, list):
        found = type(values).__name__ if name in data else "no value"
        raise LogError(f"data.{name}: expected a list, found {found}")
    return values


def _read_parameters(metadata: Mapping[str, Any]) -> dict[str, float]:
    parameters: dict[str, float] = {}
    for key, (table, name) in _PARAMETERS.items():
        values = _require_table(f"metadata.{table}", metadata.get(table, {}))
        if name in values:
            place = f"metadata.{table}.{name}"
            parameters[key] = require_number(place, values[name])
            if table != "target_position" and parameters[key] <= 0.0:
                raise LogError(f"{place}: expected a number > 0, found {values[name]}")
    return parameters


def _read_text(metadata: Mapping[str, Any], key: str) -> str | None:
    value = metadata.get(key)
    if value is not None and not isinstance(value, str):
        raise LogError(f"metadata.{key}: expected text, found {type(value).__name__}")
    return value


def parse_paper_csv(text: str, path: Path) -> PaperLog:
    """Return the log in a CSV text.

    Raises:
        LogError: Where it is no CSV, or not of this layout.
    """
    rows = _iterate_rows(text)
    heading = next(rows, [])
    for name in _HEADINGS.values():
        if heading.count(name) != 1:
            found = f"{heading.count(name)} in {','.join(heading)[:80]!r}"
            raise LogError(f"line 1: expected a column {name}, found {found}")
    columns, states = build_columns(_read_lists(heading, rows), _HEADINGS)
    return PaperLog(
        name=path.stem,
        source=f"paper-csv: {path.name}",
        columns=columns,
        states=states,
        absent=("parameters",),
    )


def _read_lists(heading: Sequence[str], rows: Iterable[Sequence[str]]) -> dict[str, list[object]]:
    lists: dict[str, list[object]] = {name: [] for name in _HEADINGS}
    places = [
        (heading.index(column), name == "state", lists[name]) for name, column in _HEADINGS.items()
    ]
    for number, row in enumerate(rows):
        if len(row) != len(heading):
            raise LogError(f"row {number}: expected {len(heading)} values, found {len(row)}")
        for place, is_state, values in places:
            values.append(intern(row[place]) if is_state else _parse(row[place]))
    return lists


def _iterate_rows(text: str) -> Iterator[list[str]]:
    try:
        lines = (line for _, line in iterate_lines(text))
        yield from filter(None, csv.reader(lines, strict=True))
    except csv.Error as err:
        raise LogError(f"expected CSV, found {describe_csv_error(err)}") from err


def _parse(value: str) -> object:
    """Return a number, or the text where it is none: the check that follows names its place."""
    try:
        return float(value)
    except ValueError:
        return value
