"""Rows of texts and numbers in columns: most parts are on disk, a few in memory."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from turtlelog.libraries import load_library
from turtlelog.sweep.table.result_table import ResultColumn

Cell = str | int | float | None
CellType = Literal["text", "real", "whole"]


class Key(NamedTuple):
    """Key of a column.

    Attributes:
        name: Name of the column. If a name has several units, each unit gets its own column.
        type: Type of the cells.
        unit: Unit of the numbers; empty if they have no unit.
    """

    name: str
    type: CellType = "text"
    unit: str = ""


Row = Mapping[Key, Cell]
_NONES: Final[Mapping[str, Any]] = {"text": -1, "real": np.nan, "whole": -(2**63)}
_NUMBERS: Final = {"text": np.int32, "real": np.float64, "whole": np.int64}


class StoredCells(Sequence[Any]):
    """The cells of one column: 8 bytes per number, 4 per text. Repeated texts are mostly shared."""

    def __init__(self, kind: CellType, numbers: NDArray[Any], texts: Sequence[str] = ()) -> None:
        """Store numbers, or for texts the indices into the list of texts."""
        self._kind, self._numbers, self._texts = kind, numbers, list(texts)

    @classmethod
    def pack(cls, kind: CellType, cells: Iterable[Any]) -> "StoredCells":
        """Return cells from Python values."""
        none = _NONES[kind]
        if kind != "text":
            numbers = [none if cell is None else cell for cell in cells]
            return cls(kind, np.array(numbers, _NUMBERS[kind]))
        codes: dict[str, int] = {}
        found = [none if cell is None else codes.setdefault(cell, len(codes)) for cell in cells]
        return cls(kind, np.array(found, _NUMBERS[kind]), list(codes))

    @classmethod
    def pack_arrow(cls, kind: CellType, cells: Any) -> "StoredCells":
        """Return cells from an Arrow array."""
        texts: Sequence[str] = ()
        if kind == "text":
            encoded = cells.combine_chunks().dictionary_encode()
            cells, texts = encoded.indices, encoded.dictionary.to_pylist()
        if kind != "real":
            cells = load_library("pyarrow.compute").fill_null(cells, _NONES[kind])
        return cls(kind, cells.to_numpy(zero_copy_only=False).astype(_NUMBERS[kind]), texts)

    @classmethod
    def fill(cls, kind: CellType, count: int) -> "StoredCells":
        """Return a number of cells without a value."""
        return cls(kind, np.full(count, _NONES[kind], _NUMBERS[kind]))

    def take(self, rows: NDArray[np.intp]) -> "StoredCells":
        """Return the cells of some rows."""
        return StoredCells(self._kind, self._numbers[rows], self._texts)

    def put(self, places: NDArray[np.intp], other: "StoredCells", rows: NDArray[np.intp]) -> None:
        """Copy cells of another column of the same kind to given rows of this column."""
        numbers = other._numbers[rows]
        if other._texts:
            numbers = np.where(numbers < 0, -1, numbers + len(self._texts))
            self._texts += other._texts
        self._numbers[places] = numbers

    def __len__(self) -> int:
        return len(self._numbers)

    def __getitem__(self, place: Any) -> Any:
        if isinstance(place, slice):
            return StoredCells(self._kind, self._numbers[place], self._texts)
        number = self._numbers[place].item()
        if number == _NONES[self._kind] or number != number:  # noqa: PLR0124 - of a NaN it is
            return None
        return self._texts[number] if self._kind == "text" else number

    @property
    def has_value(self) -> NDArray[np.bool_]:
        """Return for each row whether its cell has a value."""
        has: NDArray[np.bool_] = self._numbers != _NONES[self._kind]
        return has & ~np.isnan(self._numbers) if self._kind == "real" else has

    def __arrow_array__(self, type: Any = None) -> Any:  # noqa: A002 - as Arrow calls it
        pa, lacks = load_library("pyarrow"), ~self.has_value
        if self._kind != "text":
            return pa.array(self._numbers, type, mask=lacks)
        used, places = np.unique(self._numbers, return_inverse=True)
        texts = [None if number < 0 else self._texts[number] for number in used.tolist()]
        return pa.array(texts, type).take(pa.array(places))


@dataclass(frozen=True, slots=True)
class Columns:
    """Rows stored as columns; cells of missing keys are None."""

    count: int
    cells: Mapping[Key, StoredCells]


def gather_rows(rows: Sequence[Row]) -> dict[Key, list[Cell]]:
    """Return rows as columns."""
    keys = dict.fromkeys(key for row in rows for key in row)
    return {key: [row.get(key) for row in rows] for key in keys}


@dataclass(slots=True)
class StoredRows:
    """Rows in parts that are loaded on demand."""

    _ends: list[int] = field(default_factory=lambda: [0])
    _loads: list[Callable[[], Columns]] = field(default_factory=list)

    def add(self, count: int, load: Callable[[], Columns]) -> int:
        """Add a part, and return the number of its first row."""
        self._loads.append(load)
        self._ends.append(self._ends[-1] + count)
        return self._ends[-2]

    def gather(self, rows: NDArray[np.intp]) -> Columns:
        """Return rows by number; each part is loaded once."""
        ends = np.array(self._ends)
        parts = np.searchsorted(ends, rows, "right") - 1
        found: dict[Key, StoredCells] = {}
        for part in np.unique(parts).tolist():
            places = np.flatnonzero(parts == part)
            for key, cells in self._loads[part]().cells.items():
                if key not in found:
                    found[key] = StoredCells.fill(key.type, len(rows))
                found[key].put(places, cells, rows[places] - ends[part])
        return Columns(len(rows), found)


class WindowedRows:
    """Stored rows in a given order, with one segment in memory."""

    def __init__(self, stored: StoredRows, order: NDArray[np.intp] | range) -> None:
        """Store the rows and their order.

        Args:
            stored: Stored rows.
            order: Row numbers in order.
        """
        self._stored, self._order = stored, order
        self._stretch, self._held = (0, 0), Columns(0, {})

    def __len__(self) -> int:
        return len(self._order)

    def load(self, rows: slice) -> Columns:
        """Return a segment of the rows."""
        begin, end, _ = rows.indices(len(self))
        if (begin, end) != self._stretch:
            self._held = self._stored.gather(np.asarray(self._order[begin:end], np.intp))
            self._stretch = begin, end
        return self._held


class _Column(Sequence[Any]):
    """The cells of a key, for rows in a given order."""

    def __init__(self, rows: WindowedRows, key: Key) -> None:
        self._rows, self._key = rows, key

    def __len__(self) -> int:
        return len(self._rows)

    def __getitem__(self, place: Any) -> Any:
        if not isinstance(place, slice):
            return self[place : place + 1][0]
        found = self._rows.load(place)
        return found.cells.get(self._key) or StoredCells.fill(self._key.type, found.count)


def build_result_columns(rows: WindowedRows, keys: Sequence[Key]) -> Iterator[ResultColumn]:
    """Yield the columns of keys. If a name has several units, the unit is appended to the name."""
    names = [key.name for key in keys]
    for key in keys:
        is_alone = names.count(key.name) == 1
        yield ResultColumn(
            name=key.name if is_alone else f"{key.name} [{key.unit}]",
            type=key.type,
            cells=_Column(rows, key),
            unit=key.unit or None,
        )


def parse_key(column: ResultColumn) -> Key:
    """Return the key of a column that `build_result_columns` created."""
    unit = column.unit or ""
    name = column.name.removesuffix(f" [{unit}]") if unit else column.name
    return Key(name, "text" if column.type == "truth" else column.type, unit)
