"""Tables as values: what they say, not how they are printed."""

from dataclasses import dataclass

Cell = str | float | int | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Column:
    """One column of a table.

    Attributes:
        title: Head of the column.
        unit: Of its figures, empty where they have none.
        digits: Decimals of its figures; None: five significant digits.
        joined: Whether it makes sense only beside the column before it.
    """

    title: str
    unit: str = ""
    digits: int | None = None
    joined: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """A table with its notes.

    Attributes:
        title: One line.
        columns: At least one.
        rows: Each as long as `columns`; None: there is no such value.
        notes: Sentences to stand below.
    """

    title: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    notes: tuple[str, ...] = ()


def format_cell(cell: Cell, column: Column) -> str:
    """Return a cell as text; `-` where there is no value."""
    if cell is None:
        return "-"
    if isinstance(cell, float) and column.digits is not None:
        return f"{cell:.{column.digits}f}"
    return f"{cell:.5g}" if isinstance(cell, float) else str(cell)
