"""Rows of texts and numbers in columns: those of a hundred thousand files fit into memory."""

import math
from array import array
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from turtlelog.sweep.result_table import ResultColumn, ResultTable

Cell = str | int | float | None
CellType = Literal["text", "real", "whole"]


class Key(NamedTuple):
    """What a column holds.

    Attributes:
        name: Of the column; keys of one name and several units get a column for each.
        type: Of its cells.
        unit: Of its numbers, empty where they have none.
    """

    name: str
    type: CellType = "text"
    unit: str = ""


Row = Mapping[Key, Cell]
_NO_WHOLE: Final = -(2**63)
_CODES: Final = {"text": "i", "real": "d", "whole": "q"}


class _Cells:
    """The cells of one column: 8 bytes for each number, 4 for a text, and each text once."""

    def __init__(self, kind: str, count: int) -> None:
        self.texts: list[str] = []
        self._codes: dict[str, int] = {}
        self._kind = kind
        self._none = {"text": -1, "real": np.nan, "whole": _NO_WHOLE}[kind]
        self.numbers = array(_CODES[kind], [self._none]) * count

    def add(self, cell: Any) -> None:
        if cell is None:
            self.numbers.append(self._none)
        elif self._kind == "text":
            code = self._codes.setdefault(cell, len(self.texts))
            if code == len(self.texts):
                self.texts.append(cell)
            self.numbers.append(code)
        else:
            self.numbers.append(cell)


@dataclass(slots=True)
class RowColumns:
    """Rows that grow at their end; a cell of a key that a row lacks is None."""

    count: int = 0
    cells: dict[Key, _Cells] = field(default_factory=dict)

    def add(self, row: Row) -> None:
        """Add a row."""
        for key in row.keys() - self.cells.keys():
            self.cells[key] = _Cells(key.type, self.count)
        for key, cells in self.cells.items():
            cells.add(row.get(key))
        self.count += 1

    def add_table(self, table: ResultTable) -> None:
        """Add the columns of a table as new columns: those without rows, or of as many."""
        for column in table.columns:
            key = _parse_key(column)
            cells = self.cells[key] = _Cells(key.type, 0)
            for cell in column.cells:
                cells.add(cell)
            self.count = len(column.cells)

    def iterate(self, key: Key) -> Iterator[Any]:
        """Yield the cells of a column, of one that is not there None."""
        return iter(GatheredCells([self], key, np.arange(self.count))[:])


def _parse_key(column: ResultColumn) -> Key:
    unit = column.unit or ""
    name = column.name.removesuffix(f" [{unit}]") if unit else column.name
    return Key(name, "text" if column.type == "truth" else column.type, unit)


class GatheredCells(Sequence[Any]):
    """Cells of a key from several stores in an order; taken from there when they are asked for."""

    def __init__(self, stores: Sequence[RowColumns], key: Key, order: NDArray[np.intp]) -> None:
        self._key, self._order = key, order
        self._cells = [store.cells.get(key) or _Cells(key.type, store.count) for store in stores]

    def __len__(self) -> int:
        return len(self._order)

    def __getitem__(self, place: Any) -> Any:
        if not isinstance(place, slice):
            return self[place : place + 1][0]
        texts = list(chain.from_iterable(cells.texts for cells in self._cells))
        return [self._make(number, texts) for number in self._gather()[place]]

    def _gather(self) -> NDArray[Any]:
        parts, count = [], 0
        for cells in self._cells:
            numbers = np.array(cells.numbers)
            parts.append(np.where(numbers < 0, -1, numbers + count) if cells.texts else numbers)
            count += len(cells.texts)
        found: NDArray[Any] = np.concatenate(parts)[self._order]
        return found

    def _make(self, number: Any, texts: Sequence[str]) -> Cell:
        if self._key.type == "text":
            return None if number < 0 else texts[number]
        if self._key.type == "real":
            return None if math.isnan(number) else float(number)
        return None if number == _NO_WHOLE else int(number)

    @property
    def has_some(self) -> bool:
        """Whether any cell is not None."""
        numbers = self._gather()
        if self._key.type == "real":
            return bool((~np.isnan(numbers)).any())
        return bool((numbers != (-1 if self._key.type == "text" else _NO_WHOLE)).any())


def build_columns(
    stores: Sequence[RowColumns], keys: Sequence[Key], order: NDArray[np.intp]
) -> Iterator[ResultColumn]:
    """Yield the columns of keys; the name of one that has several units ends in the unit."""
    names = [key.name for key in keys]
    for key in keys:
        is_alone = names.count(key.name) == 1
        yield ResultColumn(
            name=key.name if is_alone else f"{key.name} [{key.unit}]",
            type=key.type,
            cells=GatheredCells(stores, key, order),
            unit=key.unit or None,
        )
