"""Conversion of table cells to numbers in standard units, with notes on assumed units."""

import math
import re
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime, timedelta
from decimal import Decimal, InvalidOperation
from typing import Any, Final, NoReturn

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import LogError
from turtlelog.log.importers.table_columns import QUANTITIES, Choice
from turtlelog.log.importers.table_text import PlainTable

Values = NDArray[np.float64]
Times = NDArray[np.int64]

_LONGEST_STEP_S: Final = 1000.0
"""Largest usual step between rows that is read as seconds if the unit is unknown [s]: nobody
records a drive every quarter of an hour."""

_WRAPS_DEG: Final = (330.0, 361.0)
"""Steps of a wrapped heading that indicate degrees if the unit is unknown: a turn, minus up to 30
deg of rotation between two rows. In radians, these steps would be at least 52 turns."""

_EPOCHS: Final = ((1e18, "ns"), (1e15, "us"), (1e12, "ms"), (1e9, "s"))
"""Smallest time since 1970 in each unit. The ranges last from 2001 to 2286."""

_POWERS: Final = {"s": 9, "ms": 6, "us": 3, "ns": 0}
_LATEST_NS: Final = 2**62
_MOST_DIGITS: Final = 20  # digits before the point; nanoseconds of 64 bits have no more
_ENDS: Final = re.compile(r"[\])]$")
_DATE: Final = re.compile(
    r"\s*+(\d{4}-\d\d-\d\d)[T ](\d\d:\d\d:\d\d)(?:[.,](\d++))?"
    r"\s*+(Z|[+-]\d\d:?\d\d)?\s*+\Z",
    re.ASCII,
)


class Cells:
    """The chosen columns of a table, as numbers in standard units.

    Attributes:
        table: Table as in its file.
        chosen: Chosen columns by quantity.
        time_ns: Times [ns], since 1970 or from another start, shape (n,).
    """

    def __init__(self, table: PlainTable, chosen: Mapping[str, Choice]) -> None:
        self.table, self.chosen = table, chosen
        self._guesses: dict[str, str] = {}
        found = table.columns.read([choice.column for choice in chosen.values()])
        self._cells = dict(zip(chosen, found, strict=True))
        self.time_ns = self._read_times()

    def read(self, field: str) -> Values | None:
        """Return the numbers of a column, NaN if a cell is empty; None without such a column."""
        if field not in self.chosen:
            return None
        choice = self.chosen[field]
        numbers = self._parse(choice)
        return numbers * choice.units[choice.unit or self._assume_unit(choice, numbers)]

    def require(self, field: str) -> Values:
        """Return the numbers of an existing column."""
        values = self.read(field)
        assert values is not None
        return values

    def describe(self) -> str:
        """Return a description of the columns: quantities, units, and unread columns."""
        told = []
        for field, choice in self.chosen.items():
            unit = self._guesses.get(field, choice.unit)
            # The unit is not repeated if the column's name ends with it.
            is_said = QUANTITIES[field] == "number" or (
                unit == choice.unit and _ENDS.search(choice.name)
            )
            told.append(f"{field} from {choice.name}" + ("" if is_said else f" [{unit}]"))
        used = {choice.column for choice in self.chosen.values()}
        rest = [name for place, name in enumerate(self.table.names) if place not in used]
        text = ", ".join(told)
        if rest:
            text += f"; not read: {', '.join(rest)[:160]}"
        if self._guesses:
            field = [*self._guesses][-1]
            text += f"; --column {field}='{self.chosen[field].name} [UNIT]' names another unit"
        return text

    def refuse(self, field: str, row: int, expected: str = "a number") -> NoReturn:
        """Raise an error for an invalid cell."""
        table, choice = self.table, self.chosen[field]
        found = repr(str(self._cells[field][row])[:40])
        place = f"{table.word} {table.columns.lines[row]}, column {choice.name}"
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
        """Return the assumed unit of a column without a given unit."""
        usual = next(iter(choice.units))
        if QUANTITIES[choice.field] == "number":
            return usual
        if choice.field == "heading" and _steps_by_turns(numbers):
            self._guesses["heading"] = "deg, as it steps by a turn of these"
            return "deg"
        self._guesses[choice.field] = f"{usual}, assumed"
        return usual

    def _read_times(self) -> Times:
        """Return times [ns], since 1970 or from another start.

        Raises:
            LogError: If a cell is not a time, or the unit cannot be determined.
        """
        choice = self.chosen["t"]
        cells = self._cells[choice.field]
        if isinstance(cells[0], str) and _DATE.match(cells[0]):
            self._guesses["t"] = "date"
            found: Iterable[int | None] = map(_read_date, cells)
        else:
            power = _POWERS[choice.unit or self._guess_time_unit(choice)]
            found = (read_time(cell, power) for cell in cells)
        times = np.empty(len(cells), dtype=np.int64)
        for row, time_ns in enumerate(found):
            if time_ns is None:
                self.refuse("t", row, "a time")
            times[row] = time_ns
        more = self.chosen.get("t_nanosec")
        return times if more is None else times + self._parse(more).astype(np.int64)

    def _guess_time_unit(self, choice: Choice) -> str:
        numbers = self._parse(choice)
        for least, unit in _EPOCHS:
            if least <= numbers[0] < 10 * least:
                self._guesses["t"] = f"{unit} since 1970"
                return unit
        step = float(np.median(np.abs(np.diff(numbers)))) if len(numbers) > 1 else 0.0
        if step > _LONGEST_STEP_S:
            raise LogError(
                f"column {choice.name}: expected a time with its unit, found steps of {step:g},"
                f" which are no seconds: --column t='{choice.name} [ns]' names the unit (s, ms, us,"
                " ns)"
            )
        self._guesses["t"] = "s, assumed"
        return "s"


def _steps_by_turns(heading: Values) -> bool:
    """Return whether the steps of headings show that they are not in radians."""
    step = np.abs(np.diff(heading))
    return bool(((step > _WRAPS_DEG[0]) & (step < _WRAPS_DEG[1])).any())


def read_time(cell: Any, power: int) -> int | None:
    """Return a time as exact nanoseconds; None if the cell is not a number.

    Args:
        cell: A text or a number.
        power: Power of ten of the unit in nanoseconds.
    """
    try:
        number = Decimal(str(cell))
    except InvalidOperation:
        return None
    if not number.is_finite() or number.adjusted() > _MOST_DIGITS:
        return None
    time_ns = round(number.scaleb(power))
    return time_ns if abs(time_ns) <= _LATEST_NS else None


def _read_date(cell: str) -> int | None:
    """Return an ISO 8601 time as nanoseconds since 1970; None for other texts.

    The default time zone is UTC.
    """
    match = _DATE.match(cell)
    if match is None:
        return None
    try:
        at = datetime.fromisoformat(f"{match[1]}T{match[2]}{match[4] or '+00:00'}")
    except ValueError:
        return None
    seconds = (at - datetime(1970, 1, 1, tzinfo=UTC)) // timedelta(seconds=1)
    return seconds * 1_000_000_000 + int((match[3] or "0")[:9].ljust(9, "0"))
