"""Tables as values: the content of a printed table or of a file, before formatting."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, Final, Literal

from turtlelog.display import describe_count, fit_line, format_html, format_notebook, format_number
from turtlelog.run.tables import Tabular

Cell = str | float | int | None
Mark = Literal["best", "worst"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Column:
    """One column of a table.

    Attributes:
        title: Head of the column.
        unit: Unit of the values; empty if the values have no unit.
        digits: Decimals of the values; None: five significant digits.
        joined: Whether the column is meaningful only next to the previous column.
        lines: Title broken into lines, for narrow terminals.
    """

    title: str
    unit: str = ""
    digits: int | None = None
    joined: bool = False
    lines: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Table(Tabular):
    """A table with its notes.

    Attributes:
        title: Title in one line. LaTeX numbers tables itself, and leaves out a leading `Table 1: `.
        columns: Columns, at least one.
        rows: Rows, each as long as `columns`; None: no value.
        notes: Sentences below the table.
        breaks: First rows of new groups; a terminal shows an empty line before each.
        marks: Marks of the best and the worst cells of a column, by row and column.
        label: Label for references in LaTeX; empty: no label.
    """

    title: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    notes: tuple[str, ...] = ()
    breaks: tuple[int, ...] = ()
    marks: Mapping[tuple[int, int], Mark] = field(default_factory=lambda: MappingProxyType({}))
    label: str = ""

    def _tabulate(self) -> Mapping[str, Any]:
        names = [self._name(place) for place in range(len(self.columns))]
        columns = {name: [row[place] for row in self.rows] for place, name in enumerate(names)}
        # A column of texts and numbers is one of texts.
        return {
            name: [None if one is None else str(one) for one in cells]
            if any(isinstance(one, str) for one in cells)
            else cells
            for name, cells in columns.items()
        }

    def _name(self, place: int) -> str:
        title = self.columns[place].title
        same = sum(one.title == title for one in self.columns[:place])
        return f"{title}_{same + 1}" if same else title

    def _list_units(self) -> Mapping[str, str]:
        return {self._name(place): one.unit for place, one in enumerate(self.columns) if one.unit}

    def __repr__(self) -> str:
        rows = describe_count(len(self.rows), "row")
        columns = describe_count(len(self.columns), "column")
        return fit_line(f"<Table {self.title}: {rows} of {columns}>")

    def _repr_html_(self) -> str:
        heads = [f"{one.title} [{one.unit}]" if one.unit else one.title for one in self.columns]
        from html import escape  # a notebook alone needs it

        notes = [f"<p>{escape(note)}</p>" for note in self.notes]
        return format_notebook(self.title, format_html(self.rows, heads=heads), *notes)


def format_cell(cell: Cell, column: Column) -> str:
    """Return a cell as text; `-` if there is no value."""
    if cell is None:
        return "-"
    if isinstance(cell, float) and column.digits is not None:
        return f"{cell:.{column.digits}f}"
    return format_number(cell) if isinstance(cell, float) else str(cell)


def narrow_table(table: Table, width: int, ranks: Sequence[int | None]) -> Table:
    """Return a table with as many columns as fit into a line of text.

    Args:
        table: Table to narrow; each of its marks takes one character.
        width: Number of characters in a line.
        ranks: Rank of each column. Columns with None always stay; the others are added in rising
            order while they fit.
    """
    cells = [
        [format_cell(row[place], column) for row in table.rows]
        for place, column in enumerate(table.columns)
    ]
    marked = {column for _, column in table.marks}
    room = width + _GAP
    kept = []
    for place in sorted(
        range(len(ranks)), key=lambda place: (ranks[place] is not None, ranks[place] or 0)
    ):
        column = table.columns[place]
        heads = (*(column.lines or (column.title,)), f"[{column.unit}]" if column.unit else "")
        room -= _GAP + max(map(len, (*heads, *cells[place]))) + (place in marked)
        if ranks[place] is not None and room < 0:
            break
        kept.append(place)
    kept.sort()
    return replace(
        table,
        columns=tuple(table.columns[place] for place in kept),
        rows=tuple(tuple(row[place] for place in kept) for row in table.rows),
        marks=MappingProxyType(
            {(row, kept.index(at)): mark for (row, at), mark in table.marks.items() if at in kept}
        ),
    )


_GAP: Final = 2
"""Number of blanks between columns."""
