"""Import of the paper's logs: JSON with `metadata` and `data`, or CSV with the same lists."""

import csv
import json
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from sys import intern
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import LATEST_S, parse_utc
from turtlelog.errors import LogError
from turtlelog.files.text_files import describe_csv_error, iterate_lines
from turtlelog.files.urls import make_path
from turtlelog.laws.sequential_p import DECLARATION
from turtlelog.log.file_access import MCAP0_MAGIC, decode_text, name_file, open_file
from turtlelog.log.planar_poses import note_changes
from turtlelog.log.table_files import read_header
from turtlelog.run import CommandColumns, Origin, PoseColumns, Run, SampleColumns
from turtlelog.run.loops import DONE
from turtlelog.run.stop_reasons import FINISHED

_Columns = dict[str, NDArray[np.float64]]
_Whole = NDArray[np.int64]

_PHASES: Final = {name: number for number, name in enumerate(DECLARATION.phase_names)}

_STATES: Final = {
    "ROTACIONAR": _PHASES["rotate"],
    "TRANSLADAR": _PHASES["translate"],
    "FINALIZADO": _PHASES[DONE],
}
"""Phase number by the name of a state, which is the state AFTER the callback."""

_NUMBERS: Final = (
    *("time", "pos_x", "pos_y", "pos_theta", "target_angle_rad", "error_angle", "error_x"),
    *("error_y", "error_distance", "vel_linear_x", "vel_angular_z", "vel_x_global"),
    "vel_y_global",
)
"""The lists of numbers, named as in the JSON layout."""

_POSE_TIMES: Final = "of the callbacks that read them: in a burst they are later than the poses"

_MARKS: Final = frozenset({"target_angle_rad", "error_angle_rad", "vel_x_global"})
"""CSV columns that distinguish this layout from other tables."""

_NEVER_LOGGED: Final = (
    *("poses.speed_m_s", "poses.turn_rate_rad_s"),
    *("samples.wanted_speed_m_s", "samples.wanted_turn_rate_rad_s", "stop_reason", "events"),
)


def is_papers(path: Path) -> bool:
    """Return whether a CSV file has the columns of the paper's logs."""
    return path.suffix.lower() == ".csv" and not _MARKS.isdisjoint(read_header(path))


def import_log(path: str | Path, *, sort: bool = False) -> Run:
    """Return the run in a log of the paper's controller, JSON or CSV.

    Args:
        path: Path of the log; for other suffixes the content determines the format.
        sort: Whether to sort rows by time and drop exact duplicates; notes give both counts.

    Raises:
        LogError: If the log is invalid; one line with the file, the list and the index.
    """
    path = make_path(path)
    with name_file(path, expected="a log of the paper's layout, .json or .csv"):
        with open_file(path) as stream:
            data = stream.read()
        if data.startswith(MCAP0_MAGIC):
            raise LogError("expected a log in JSON or CSV, found MCAP, which is read as it is")
        text, suffix = decode_text(data), path.suffix.lower()
        if not text.strip():
            raise LogError("expected a log, found an empty file")
        is_json = suffix == ".json" or (suffix != ".csv" and text.lstrip().startswith(("{", "[")))
        return (parse_paper_json if is_json else _parse_paper_csv)(text, path, sort=sort)


def _require_number(place: str, value: object) -> float:
    if not isinstance(value, int | float) or isinstance(value, bool):
        raise LogError(f"{place}: expected a number, found {_shorten(value)}")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise LogError(f"{place}: expected a finite number, found {_shorten(value)}")
    return number


def _build_columns(
    lists: Mapping[str, Sequence[object]], places: Mapping[str, str]
) -> tuple[_Columns, _Whole]:
    """Return the numeric columns and the states; `places` are the names of lists in messages."""
    if not lists["time"]:
        raise LogError(f"{places['time']}: no rows")
    columns = {}
    for name in _NUMBERS:
        place = places[name]
        values = [_require_number(f"{place}[{i}]", value) for i, value in enumerate(lists[name])]
        columns[name] = np.array(values, dtype=np.float64)
    states = []
    for i, value in enumerate(lists["state"]):
        if not isinstance(value, str) or value not in _STATES:
            known, found = ", ".join(_STATES), _shorten(value)
            raise LogError(f"{places['state']}[{i}]: expected one of {known}, found {found}")
        states.append(_STATES[value])
    return columns, np.array(states, dtype=np.int64)


def _build_run(
    columns: _Columns, states: _Whole, *, sort: bool, parameters: Mapping[str, float], **facts: Any
) -> Run:
    """Return the run in a log; its name, source, absent fields, notes and origin are `facts`."""
    notes, absent = {**facts.pop("notes", {}), "pose_times": _POSE_TIMES}, facts.pop("absent")
    origin = facts.pop("origin", Origin())
    if sort:
        columns, states, origin = _sort_rows(columns, states, origin)
        notes |= note_changes(origin)
    _require_rising(columns["time"], is_sorted=sort)
    time_ns = np.rint((columns["time"] - columns["time"][0]) * 1e9).astype(np.int64)
    goal_xy_m = _find_goal(parameters, columns)
    is_finished = states[-1] == _PHASES[DONE]
    return Run(
        **facts,
        poses=PoseColumns(
            time_ns=time_ns,
            xy_m=np.column_stack([columns["pos_x"], columns["pos_y"]]),
            heading_rad=columns["pos_theta"],
        ),
        commands=CommandColumns(
            time_ns=time_ns,
            speed_m_s=columns["vel_linear_x"],
            lateral_speed_m_s=np.zeros(len(time_ns)),
            turn_rate_rad_s=columns["vel_angular_z"],
        ),
        samples=_build_samples(time_ns, columns, states),
        goal_xy_m=goal_xy_m,
        declaration=DECLARATION,
        parameters=parameters,
        stop_reason=FINISHED if is_finished else None,
        absent=(*_NEVER_LOGGED, *absent, *(() if goal_xy_m else ("goal_xy_m",))),
        origin=origin,
        notes=notes,
    )


def _build_samples(time_ns: _Whole, columns: _Columns, states: _Whole) -> SampleColumns:
    rows = np.arange(len(time_ns))
    return SampleColumns(
        time_ns=time_ns,
        sequence=rows,
        pose_sequence=rows,
        # A command was computed in the state after the previous callback.
        phase=np.array([_PHASES["rotate"], *states[:-1]], dtype=np.int64),
        bearing_rad=columns["target_angle_rad"],
        heading_error_rad=columns["error_angle"],
        error_xy_m=np.column_stack([columns["error_x"], columns["error_y"]]),
        distance_m=columns["error_distance"],
        speed_m_s=columns["vel_linear_x"],
        turn_rate_rad_s=columns["vel_angular_z"],
        world_velocity_m_s=np.column_stack([columns["vel_x_global"], columns["vel_y_global"]]),
    )


def _find_goal(parameters: Mapping[str, float], columns: _Columns) -> tuple[float, float] | None:
    """Return the given goal, or else position plus error if the sum is equal in every row."""
    if "goal.x_m" in parameters and "goal.y_m" in parameters:
        return parameters["goal.x_m"], parameters["goal.y_m"]
    goal = np.column_stack(
        [columns["pos_x"] + columns["error_x"], columns["pos_y"] + columns["error_y"]]
    )
    return (float(goal[0, 0]), float(goal[0, 1])) if (goal == goal[0]).all() else None


def _sort_rows(
    columns: _Columns, states: _Whole, origin: Origin
) -> tuple[_Columns, _Whole, Origin]:
    rows = zip(*(columns[name].tolist() for name in _NUMBERS), states.tolist(), strict=True)
    firsts = np.array(sorted({row: i for i, row in reversed(list(enumerate(rows)))}.values()))
    time = columns["time"][firsts]
    late = int((time < np.maximum.accumulate(time)).sum())
    order = firsts[np.argsort(time, kind="stable")]
    origin = replace(origin, sorted_rows=late, dropped_duplicates=len(states) - len(firsts))
    return {name: values[order] for name, values in columns.items()}, states[order], origin


def _require_rising(time: NDArray[np.float64], *, is_sorted: bool) -> None:
    if abs(time).max() > LATEST_S:
        row = int(abs(time).argmax())
        raise LogError(f"time[{row}]: expected up to {LATEST_S:g} s, found {time[row]}")
    wrong = np.diff(time) <= 0
    if wrong.any():
        row = int(wrong.argmax()) + 1
        advice = "importing with --sort puts rows in order"
        advice = "two rows of one time differ" if is_sorted else advice
        raise LogError(
            f"time[{row}]: expected more than {time[row - 1]}, found {time[row]}: {advice}"
        )


def _shorten(value: object) -> str:
    try:
        text = repr(value)
    except ValueError:
        return "a number of thousands of digits"
    return text if len(text) <= 60 else f"{text[:57]}..."


_PARAMETERS: Final = {
    "law.kp_angular": ("controller_gains", "Kp_angular"),
    "law.kp_linear": ("controller_gains", "Kp_linear"),
    "law.heading_tolerance_rad": ("tolerances", "angle"),
    "law.position_tolerance_m": ("tolerances", "linear"),
    "limits.speed_m_s": ("speed_limits", "max_linear_speed"),
    "limits.turn_rate_rad_s": ("speed_limits", "max_angular_speed"),
    "goal.x_m": ("target_position", "x"),
    "goal.y_m": ("target_position", "y"),
}
"""Section and name in the metadata, by scenario key."""

_PLACES: Final = {name: f"data.{name}" for name in (*_NUMBERS, "state")}

_MOST_SIGNS: Final = 2**17
"""Largest number of lists, objects and keys of a JSON text: thousands of times the number in a
log."""

_HEADINGS: Final = {name: name for name in (*_NUMBERS, "state")} | {
    "error_angle": "error_angle_rad"
}
"""Name of each list in the CSV layout."""


def parse_paper_json(text: str, path: Path, *, sort: bool) -> Run:
    """Return the run in a JSON text, as `import_log` does; the path names it."""
    tables = _require_table("the file", _parse_json(text))
    data = _require_table("data", tables.get("data"))
    lists: dict[str, list[object]] = {}
    for name in _PLACES:
        values = data.get(name)
        if not isinstance(values, list):
            found = type(values).__name__ if name in data else "no value"
            raise LogError(f"data.{name}: expected a list, found {found}")
        lists[name] = values
    for name, values in lists.items():
        if len(values) != len(lists["time"]):
            expected = f"{len(lists['time'])} values as in data.time"
            raise LogError(f"data.{name}: expected {expected}, found {len(values)}")
    columns, states = _build_columns(lists, _PLACES)
    metadata = _require_table("metadata", tables.get("metadata"))
    parameters = _read_parameters(metadata)
    timestamp = _read_text(metadata, "timestamp")
    return _build_run(
        columns,
        states,
        sort=sort,
        name=_read_text(metadata, "experiment_name") or path.stem,
        source=f"paper-json: {path.name}",
        parameters=parameters,
        absent=tuple(f"parameters.{key}" for key in _PARAMETERS if key not in parameters),
        origin=Origin(began_ns=parse_utc(timestamp or "")),
        notes={} if timestamp is None else {"original_timestamp": timestamp},
    )


def _parse_json(text: str) -> object:
    # An empty list of two letters takes 64 bytes in memory, a key of five letters 200.
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
            f"{place}: expected a JSON object, as the paper's logs have it, found {found}; other"
            " data are read from CSV with a header"
        )
    return value


def _read_parameters(metadata: Mapping[str, Any]) -> dict[str, float]:
    parameters: dict[str, float] = {}
    for key, (table, name) in _PARAMETERS.items():
        values = _require_table(f"metadata.{table}", metadata.get(table, {}))
        if name in values:
            place = f"metadata.{table}.{name}"
            parameters[key] = _require_number(place, values[name])
            if table != "target_position" and parameters[key] <= 0.0:
                raise LogError(f"{place}: expected a number > 0, found {values[name]}")
    return parameters


def _read_text(metadata: Mapping[str, Any], key: str) -> str | None:
    value = metadata.get(key)
    if value is not None and not isinstance(value, str):
        raise LogError(f"metadata.{key}: expected text, found {type(value).__name__}")
    return value


def _parse_paper_csv(text: str, path: Path, *, sort: bool) -> Run:
    rows = _iterate_rows(text)
    heading = next(rows, [])
    for name in _HEADINGS.values():
        if heading.count(name) != 1:
            found = f"{heading.count(name)} in {','.join(heading)[:80]!r}"
            raise LogError(f"line 1: expected a column {name}, found {found}")
    columns, states = _build_columns(_read_lists(heading, rows), _HEADINGS)
    return _build_run(
        columns,
        states,
        sort=sort,
        name=path.stem,
        source=f"paper-csv: {path.name}",
        parameters={},
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
            try:
                values.append(intern(row[place]) if is_state else float(row[place]))
            except ValueError:  # a later check reports the place of the text
                values.append(row[place])
    return lists


def _iterate_rows(text: str) -> Iterator[list[str]]:
    try:
        lines = (line for _, line in iterate_lines(text))
        yield from filter(None, csv.reader(lines, strict=True))
    except csv.Error as err:
        raise LogError(f"expected CSV, found {describe_csv_error(err)}") from err
