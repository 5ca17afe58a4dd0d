"""Import of plain tables as runs: cells as numbers, and what in a table contradicts itself."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import compress, islice
from pathlib import Path
from typing import Final, NoReturn

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import format_seconds, format_utc
from turtlelog.errors import LogError
from turtlelog.files.urls import make_path
from turtlelog.log import planar_poses, table_columns, units
from turtlelog.log.file_access import name_file
from turtlelog.log.planar_poses import Values
from turtlelog.log.read_choice import CHOSEN, RESTARTS, UNREAD_COMMANDS
from turtlelog.log.ros2.bag_rows import LARGEST
from turtlelog.log.ros2.computed_poses import take_asked_courses
from turtlelog.log.ros2.reported_motion import describe_speed, describe_turning
from turtlelog.log.ros2.set_clocks import DAY_NS, count_midnights, describe_restart, find_runs
from turtlelog.log.ros2.stamps import note_crowded
from turtlelog.log.table_columns import (
    COURSE,
    QUATERNION,
    Choice,
    has_quaternion,
    offer_robots,
    require_columns,
    show_column,
)
from turtlelog.log.table_files import PlainTable, read_plain_table
from turtlelog.log.units import EPOCHS, QUANTITIES, describe_units
from turtlelog.run import CommandColumns, PoseColumns, Run, SampleColumns, SourceKind

_NEVER: Final = (
    *("poses.speed_m_s", "poses.turn_rate_rad_s", "samples", "goal_xy_m", "goal_heading_rad"),
    *("parameters", "stop_reason", "events"),
)

_MOST_UNREAD: Final = 160
"""Largest number of letters that list the columns which are not read, at least one each."""

_COMMANDS: Final = {"command_speed": "speed_m_s", "command_turn_rate": "turn_rate_rad_s"}
_OTHERS: Final = ("z", "speed", "turn_rate", *_COMMANDS)


def import_plain_table(
    path: str | Path,
    columns: Mapping[str, str] | None = None,
    *,
    robot: str | None = None,
    allow_partial: bool = False,
) -> Run:
    """Return the run in a table with a header, or in a TUM trajectory.

    Column names or `columns` determine quantities and units; the note `columns` lists the result.
    Rows are sorted by time, and duplicate rows are dropped. If several poses have the same time,
    the later poses are moved by 1 ns each. The notes give the counts.

    Args:
        path: Text file with commas, semicolons, tabs or blanks between cells, or a Parquet file.
        columns: Columns by quantity, if names are not clear, as in `{"heading": "psi [deg]"}`.
        robot: Name of one of several robots, as in `robot1_x` or in a column `robot`.
        allow_partial: Whether to leave out a last row with too few cells.

    Raises:
        LogError: If the table is invalid; one line with the file, the row and the column.
    """
    path = make_path(path)
    with name_file(path, expected="a table"):
        table = read_plain_table(path, allow_partial=allow_partial)
        robots = table_columns.find_table_robots(table.names)
        asked = {**robots.get(robot or "", {}), **(columns or {})}
        if has_courses := asked.get("heading") == COURSE and COURSE not in table.names:
            del asked["heading"]
        chosen = table_columns.assign_columns(table.names, asked, table.units)
        if has_courses:
            turns = {"heading", *QUATERNION}
            chosen = {name: choice for name, choice in chosen.items() if name not in turns}
        require_columns(table, chosen, [*robots], has_courses=has_courses)
        cells = Cells(table, chosen, robot)
        run = _build_run(path, cells)
        if robot not in {*robots, *cells.robots}:
            return run
        origin = replace(run.origin, robot=robot)
        name = f"{run.name}:{robot}"
        return replace(run, name=name, origin=origin, notes={**run.notes, "robot": robot})


def _build_run(path: Path, cells: "Cells") -> Run:
    values = {
        "x": cells.require("x"),
        "y": cells.require("y"),
        **_read_rotation(cells),
        **{name: found for name in _OTHERS if (found := cells.read(name)) is not None},
    }
    time_ns, values, changed = planar_poses.sort_rows(cells.time_ns, values)
    has_courses, courses = "heading" not in values, dict[str, str]()
    if has_courses:
        values["heading"], courses = take_asked_courses(time_ns, values["x"], values["y"])
    places = np.column_stack([values[name] for name in ("x", "y", "heading")])
    has_pose = np.asarray(np.isfinite(places).all(axis=1))
    if not has_pose.any():
        raise LogError("no row has x, y and heading")
    commands = _build_commands(time_ns, values)
    start_ns = int(min([time_ns[has_pose][0], *commands.time_ns[:1]]))
    poses = {name: column[has_pose] for name, column in values.items()}
    whole = {name: column for name, column in poses.items() if not np.isnan(column).any()}
    lacks = [f"commands.{column}" for name, column in _COMMANDS.items() if name not in values]
    absent = [*_NEVER, *(lacks if len(commands) else ("commands",))]
    is_dated = start_ns >= EPOCHS[0][0]
    start = format_utc(start_ns) if is_dated else f"{format_seconds(start_ns)} s"
    pose_time_ns, moved = planar_poses.separate_times(time_ns[has_pose] - start_ns)
    heading_rad, wrapped = planar_poses.wrap_far_headings(poses["heading"])
    plane = planar_poses.describe_height(poses.get("z"), poses.get("tilt"))
    mixed = table_columns.describe_mixed_topics(cells.chosen)
    notes = {
        CHOSEN: cells.describe(),
        **({"mixed_topics": mixed} if mixed else {}),
        "columns": cells.describe(),
        **({UNREAD_COMMANDS: unread} if (unread := cells.describe_unread_commands()) else {}),
        **({"original_timestamp": start} if start_ns else {}),
        **planar_poses.note_changes(changed),
        "moved_rows": str(moved),
        "wrapped_headings": str(wrapped),
        **cells.notes,
        **courses,
        **_describe_gaps(values, has_pose, commands),
        **({} if plane is None else {"plane": plane}),
        **_list_contradictions(cells, pose_time_ns, poses, whole, is_flat=plane is None),
    }
    kind = SourceKind.TABLE if cells.table.has_header else SourceKind.TRAJECTORY
    return Run(
        name=path.stem,
        source=kind.describe(path.name),
        poses=PoseColumns(
            time_ns=pose_time_ns,
            xy_m=np.column_stack([poses["x"], poses["y"]]),
            heading_rad=heading_rad,
            measured_speed_m_s=whole.get("speed"),
            measured_turn_rate_rad_s=whole.get("turn_rate"),
            **planar_poses.lift_poses(poses.get("z"), poses.get("tilt")),
        ),
        commands=replace(commands, time_ns=commands.time_ns - start_ns),
        samples=SampleColumns.build_empty(),
        absent=tuple(absent),
        origin=replace(
            changed,
            began_ns=start_ns if is_dated else None,
            start_ns=start_ns,
            table_run=cells.table_run,
            lost=cells.table.columns.lost,
            has_courses=has_courses,
        ),
        notes=notes,
    )


def _list_contradictions(
    cells: "Cells",
    time_ns: NDArray[np.int64],
    poses: Mapping[str, Values],
    whole: Mapping[str, Values],
    *,
    is_flat: bool,
) -> dict[str, str]:
    used = [poses["x"], poses["y"], poses["heading"]]
    used += [whole[name] for name in ("speed", "turn_rate") if name in whole]
    if max(float(np.abs(column).max()) for column in used) > LARGEST:
        return {}
    if notes := note_crowded(time_ns, may_be_rounded=True):
        return notes
    xy_m, heading_rad = np.column_stack([poses["x"], poses["y"]]), poses["heading"]
    if doubt := describe_units(time_ns, xy_m, cells.find_assumed("t", "x", "y")):
        return {"unlikely_units": doubt}
    column = cells.chosen["heading"].name if "heading" in cells.chosen else ""
    is_assumed = bool(cells.find_assumed("heading"))
    found = {}
    if is_flat:  # tilted robots move along their own axes
        found["heading_and_travel"] = units.describe_headings(
            xy_m, heading_rad, column=column, is_assumed=is_assumed
        )
        assumed = cells.find_assumed("x", "y", "speed", "turn_rate")
        if (speed := whole.get("speed")) is not None:
            found["path_by_speed"] = describe_speed(time_ns, xy_m, speed, assumed)
        if (rate := whole.get("turn_rate")) is not None:
            name = assumed.get("turn_rate", "")
            found["turning_by_rate"] = describe_turning(time_ns, heading_rad, rate, name)
    return {name: text for name, text in found.items() if text}


def _read_rotation(cells: "Cells") -> dict[str, Values]:
    """Return headings, and the tilt if the rotations are quaternions; nothing for courses."""
    heading = cells.read("heading")
    if heading is not None:
        return {"heading": heading}
    if not has_quaternion(cells.chosen):
        return {}
    x, y, z, w = cells.require_turns()
    if {*QUATERNION} <= {*cells.chosen}:
        names = [cells.chosen[name].name for name in QUATERNION]
        cells.notes |= planar_poses.describe_order(x, y, z, w, names=names)
    return {
        "heading": planar_poses.compute_heading(x, y, z, w),
        "tilt": planar_poses.compute_tilt(x, y, z, w),
    }


def _build_commands(time_ns: NDArray[np.int64], values: Mapping[str, Values]) -> CommandColumns:
    """Return a command for each row that contains one; missing columns are 0, and absent."""
    zeros = np.zeros(len(time_ns))
    found = [values.get(name, zeros) for name in _COMMANDS]
    is_given = not _COMMANDS.keys().isdisjoint(values)
    has = np.isfinite(found).all(axis=0) & is_given
    return CommandColumns(
        time_ns=time_ns[has],
        speed_m_s=found[0][has],
        lateral_speed_m_s=zeros[has],
        turn_rate_rad_s=found[1][has],
    )


def _describe_gaps(
    values: Mapping[str, Values], has_pose: NDArray[np.bool_], commands: CommandColumns
) -> dict[str, str]:
    notes, rows = {}, len(has_pose)
    is_used = has_pose.copy()  # rows of commands may stand between those of poses
    for name in ("command_speed", "command_turn_rate"):
        if name in values:
            is_used |= ~np.isnan(values[name])
    if missing := rows - int(is_used.sum()):
        notes["rows_without_pose"] = f"{missing} of {rows}"
    if len(commands) and (missing := rows - len(commands)):
        notes["rows_without_command"] = f"{missing} of {rows}"
    for name in ("speed", "turn_rate"):
        gaps = int(np.isnan(values[name][has_pose]).sum()) if name in values else 0
        if gaps:
            notes[f"measured_{name}"] = f"not read: {gaps} of {int(has_pose.sum())} poses lack it"
    return notes


_WRAPS_DEG: Final = (330.0, 361.0)
"""Steps of a wrapped heading that indicate degrees if the unit is unknown: a turn, minus up to 30
deg of rotation between two rows. In radians, these steps would be at least 52 turns."""


class Cells:
    """The chosen columns of a table, as numbers in standard units.

    Attributes:
        table: Table as in its file.
        chosen: Chosen columns by quantity.
        time_ns: Times [ns], since 1970 or from another start, shape (n,).
        notes: Notes on rows that are left out.
        table_run: Number of the run that is read, and number of runs; None for one run.
        robots: Robots whose rows alternate; empty for one robot.
    """

    def __init__(
        self, table: PlainTable, chosen: Mapping[str, Choice], robot: str | None = None
    ) -> None:
        self.table, self.chosen = table, chosen
        self._guesses: dict[str, str] = {}
        self._assumed: set[str] = set()
        taken = [choice.column for choice in chosen.values()]
        named = table_columns.find_robot_column(table.names, {*taken})
        found = table.columns.read([*taken, *named])
        self._cells = dict(zip(chosen, found, strict=False))
        self._lines, self.robots = table.columns.lines, list[str]()
        time_ns = self._read_times()
        if named:
            placed = np.isfinite(self._parse(self.chosen["x"]))
            self.robots = table_columns.list_row_robots(
                [*compress(found[-1], placed)], time_ns[placed]
            )
        if self.robots:
            if robot not in self.robots:
                raise LogError(f"rows of several robots alternate: {offer_robots(self.robots)}")
            rows = np.flatnonzero([str(name) == robot for name in found[-1]])
            time_ns = time_ns[rows]
            self._take_robot(rows)
        runs = self._find_runs(time_ns)
        self._rows = max(runs, key=lambda rows: rows.stop - rows.start)
        self.time_ns = time_ns[self._rows]
        self.notes = dict(table.columns.notes)
        self.table_run: tuple[int, int] | None = None
        if len(runs) > 1:
            number = runs.index(self._rows) + 1
            self.table_run = number, len(runs)
            self.notes[RESTARTS] = describe_restart(runs, number, table.word, self._lines)

    def read(self, field: str) -> Values | None:
        """Return the numbers of a column, NaN if a cell is empty; None without such a column."""
        if field not in self.chosen:
            return None
        choice = self.chosen[field]
        numbers = self._parse(choice)
        unit = choice.unit or self._assume_unit(choice, numbers)
        values = numbers[self._rows] * choice.units[unit]
        return units.NORTH_RAD + values if unit == "compass" else values

    def require(self, field: str) -> Values:
        """Return the numbers of an existing column."""
        values = self.read(field)
        assert values is not None
        return values

    def find_assumed(self, *fields: str) -> dict[str, str]:
        """Return the names of columns in assumed standard units, by quantity."""
        return {field: self.chosen[field].name for field in fields if field in self._assumed}

    def _take_robot(self, rows: NDArray[np.int64]) -> None:
        self._cells = {
            field: cells[rows] if isinstance(cells, np.ndarray) else [cells[row] for row in rows]
            for field, cells in self._cells.items()
        }
        self._lines = [self._lines[row] for row in rows]

    def _find_runs(self, time_ns: NDArray[np.int64]) -> list[slice]:
        """Return the rows of each run, judged by positions: commands may stand below poses."""
        if "x" not in self.chosen or not (np.diff(time_ns) < 0).any():
            return [slice(0, len(time_ns))]
        placed = np.flatnonzero(np.isfinite(self._parse(self.chosen["x"])))
        runs = find_runs(time_ns[placed]) if len(placed) else []
        edges = [0, *(int(placed[run.start]) for run in runs[1:]), len(time_ns)]
        return [*map(slice, edges[:-1], edges[1:])]

    def describe(self) -> str:
        """Return a description of the columns: quantities, units, and unread columns."""
        told = []
        for field, choice in self.chosen.items():
            unit = self._guesses.get(field, choice.unit or "ns")  # of nanoseconds without a unit
            # The unit is not repeated if the column's name ends with it.
            is_said = QUANTITIES[field] == "number" or (
                unit == choice.unit and choice.name.endswith(("]", ")"))
            )
            told.append(f"{field} from {choice.name}" + ("" if is_said else f" [{unit}]"))
        used = {choice.column for choice in self.chosen.values()}
        names = self.table.names
        rest = (show_column(names, place) for place in range(len(names)) if place not in used)
        text = ", ".join(told)
        if unread := ", ".join(islice(rest, _MOST_UNREAD))[:_MOST_UNREAD]:
            text += f"; not read: {unread}"
        if self._guesses:
            field = [*self._guesses][-1]
            text += f"; --column {field}='{self.chosen[field].name} [UNIT]' names another unit"
        return text

    def describe_unread_commands(self) -> str:
        """Return which unread columns look like commands; empty without such columns."""
        return table_columns.describe_unread_commands(self.table.names, self.chosen)

    def require_turns(self) -> Sequence[Values]:
        """Return the columns of quaternions x, y, z, w. A length of 0 is refused."""
        zeros = np.zeros(len(self.time_ns))
        columns = [zeros if (one := self.read(name)) is None else one for name in QUATERNION]
        with np.errstate(over="ignore"):
            empty = np.square(columns).sum(axis=0) == 0.0
        if empty.any():
            row = self._rows.start + int(empty.argmax())
            self.refuse("qw", row, "a rotation of a length other than 0")
        return columns

    def refuse(self, field: str, row: int, expected: str = "a number") -> NoReturn:
        """Raise an error for an invalid cell."""
        table, choice = self.table, self.chosen[field]
        found = repr(str(self._cells[field][row])[:40])
        place = f"{table.word} {self._lines[row]}, column {choice.name}"
        raise LogError(f"{place}: expected {expected}, found {found}")

    def _parse(self, choice: Choice) -> Values:
        cells = self._cells[choice.field]
        if isinstance(cells, np.ndarray):
            numbers = cells.astype(np.float64)
        else:
            numbers = np.empty(len(cells))
            for row, cell in enumerate(cells):
                try:
                    numbers[row] = float(cell) if cell else math.nan
                except ValueError:
                    self.refuse(choice.field, row)
        if np.isinf(numbers).any():
            self.refuse(choice.field, int(np.isinf(numbers).argmax()), "a finite number")
        return numbers

    def _assume_unit(self, choice: Choice, numbers: Values) -> str:
        usual = next(iter(choice.units))
        if QUANTITIES[choice.field] == "number":
            return usual
        step = np.abs(np.diff(numbers))
        is_wrapped = ((step > _WRAPS_DEG[0]) & (step < _WRAPS_DEG[1])).any()
        if choice.field == "heading" and is_wrapped:
            self._guesses["heading"] = "deg, as it steps by a turn of these"
            return "deg"
        if choice.field == "heading" and {"x", "y"} <= {*self.chosen}:
            xy_m = np.column_stack([self.require("x"), self.require("y")])
            if units.fits_degrees(xy_m, numbers[self._rows]):
                self._guesses["heading"] = "deg, as the direction of travel shows"
                return "deg"
        self._guesses[choice.field] = f"{usual}, assumed"
        self._assumed.add(choice.field)
        return usual

    def _read_times(self) -> NDArray[np.int64]:
        """Return times [ns], since 1970 or from another start."""
        choice = self.chosen["t"]
        cells = self._cells[choice.field]
        is_text = isinstance(cells[0], str)
        kinds = [kind for kind in units.TIMES if is_text and kind[0].match(cells[0])]
        if kinds:
            _, read, self._guesses["t"] = kinds[0]
            found: Iterable[int | None] = map(read, cells)
        else:
            unit = choice.unit
            if unit is None:
                unit, is_dated = units.guess_time_unit(choice.name, self._parse(choice))
                self._guesses["t"] = f"{unit} since 1970" if is_dated else f"{unit}, assumed"
                if not is_dated:
                    self._assumed.add("t")
            power = units.TIME_POWERS[unit]
            found = (units.read_time(cell, power) for cell in cells)
        times = np.empty(len(cells), dtype=np.int64)
        for row, time_ns in enumerate(found):
            if time_ns is None:
                self.refuse("t", row, "a time")
            times[row] = time_ns
        if (more := self.chosen.get("t_nanosec")) is not None:
            factor = np.int64(10 ** units.TIME_POWERS[more.unit or "ns"])
            times += self._parse(more).astype(np.int64) * factor
        days = count_midnights(times)
        if days.any():
            unit = self._guesses.get("t", choice.unit or "ns")
            self._guesses["t"] = f"{unit}, over midnight"
        return times + DAY_NS * days
