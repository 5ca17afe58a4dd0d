"""Tables for a terminal: aligned columns, as wide as they need or as wide as there is room."""

import re
import textwrap
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest
from typing import Final

from turtlelog.compare import Table, format_cell
from turtlelog.escapes import escape_controls

_NOTE_WIDTH: Final = 96
_GAP: Final = "  "
_LEAST_TEXT: Final = 16
_LEAST_NUMBER: Final = 8
_MOST_IN_BLOCKS: Final = 32

_MARKS: Final = {"best": "*", "worst": "!"}
_LEGEND: Final = "* best, ! worst of a column."


@dataclass(frozen=True, slots=True, kw_only=True)
class _Column:
    """A column as text.

    Attributes:
        titles: Its head, line by line.
        unit: In brackets, or empty.
        cells: Row by row.
        is_numeric: Whether it stands to the right.
        is_joined: Whether it stays beside the column before it.
        width: Characters that it is given; what is longer is broken into lines.
    """

    titles: tuple[str, ...]
    unit: str
    cells: tuple[str, ...]
    is_numeric: bool
    is_joined: bool
    width: int

    @property
    def least_width(self) -> int:
        """What it cannot do with less: figures stay whole, names may be broken."""
        if not self.is_numeric:
            return min(self.width, _LEAST_TEXT)
        return min(self.width, max(_LEAST_NUMBER, len(self.unit), *map(len, self.cells)))

    def place(self, line: str) -> str:
        return f"{line:>{self.width}}" if self.is_numeric else f"{line:<{self.width}}"


def format_text(table: Table, width: int | None = None) -> str:
    """Return a table for a terminal: aligned columns, units in the second line, notes below.

    Where it is wider than `width` names are broken into lines; where that is not enough, the
    columns stand in several blocks, each with the columns of text that the rows begin with.
    """
    columns = [_build_column(table, index) for index in range(len(table.columns))]
    blocks = [columns] if width is None else _fit(columns, width)
    lines = [escape_controls(table.title)]
    for block in blocks:
        lines += ["", *_format_block(block, table.breaks)]
    notes = [*([_LEGEND] if table.marks else []), *table.notes]
    if notes:
        lines += ["", *_wrap_notes(notes, min(width or _NOTE_WIDTH, _NOTE_WIDTH))]
    return "\n".join(lines) + "\n"


def _build_column(table: Table, index: int) -> _Column:
    column = table.columns[index]
    marks = {row: _MARKS[mark] for (row, place), mark in table.marks.items() if place == index}
    # Figures stand below figures and marks below marks.
    room = " " if marks else ""
    cells = tuple(
        escape_controls(format_cell(cells[index], column)) + marks.get(row, room)
        for row, cells in enumerate(table.rows)
    )
    titles = tuple(escape_controls(line) + room for line in column.lines or (column.title,))
    unit = f"[{column.unit}]{room}" if column.unit else ""
    return _Column(
        titles=titles,
        unit=unit,
        cells=cells,
        is_numeric=any(isinstance(row[index], float | int) for row in table.rows),
        is_joined=column.joined,
        width=max(map(len, (*titles, unit, *cells))),
    )


def _fit(columns: Sequence[_Column], width: int) -> list[list[_Column]]:
    """Return blocks of columns that are no wider than `width`, where that can be."""
    if _measure([replace(column, width=column.least_width) for column in columns]) <= width:
        return [_shrink(columns, width)]
    capped = [
        replace(column, width=min(column.width, max(column.least_width, _MOST_IN_BLOCKS)))
        for column in columns
    ]
    texts = next((i for i, column in enumerate(capped) if column.is_numeric), len(capped))
    leading = capped[: texts if texts < len(capped) else 1]
    blocks: list[list[_Column]] = []
    for group in _group(capped[len(leading) :]):
        if not blocks or _measure([*blocks[-1], *group]) > width:
            blocks.append([*leading])
        blocks[-1] += group
    return [_shrink(block, width) for block in blocks or [leading]]


def _group(columns: Sequence[_Column]) -> Iterator[list[_Column]]:
    group: list[_Column] = []
    for column in columns:
        if group and not column.is_joined:
            yield group
            group = []
        group.append(column)
    if group:
        yield group


def _shrink(columns: Sequence[_Column], width: int) -> list[_Column]:
    """Take from the widest columns that can be broken until all fit, or none is left."""
    shrunk = list(columns)
    while _measure(shrunk) > width:
        wide = [i for i, column in enumerate(shrunk) if column.width > column.least_width]
        if not wide:
            break
        index = max(wide, key=lambda i: shrunk[i].width)
        shrunk[index] = replace(shrunk[index], width=shrunk[index].width - 1)
    return shrunk


def _measure(columns: Sequence[_Column]) -> int:
    return sum(column.width for column in columns) + len(_GAP) * (len(columns) - 1)


def _format_block(columns: Sequence[_Column], breaks: Collection[int]) -> list[str]:
    titles = [
        [part for line in column.titles for part in _break(line, column.width)]
        for column in columns
    ]
    height = max(map(len, titles))
    # The last line of a title stands above its unit.
    heads = [[*[""] * (height - len(title)), *title] for title in titles]
    units = [[column.unit] for column in columns]
    rule = "-" * _measure(columns)
    lines = [*_join(columns, heads), *(_join(columns, units) if any(map(any, units)) else ()), rule]
    for number, row in enumerate(zip(*(column.cells for column in columns), strict=True)):
        if number in breaks:
            lines.append("")
        cells = [_break(cell, column.width) for cell, column in zip(row, columns, strict=True)]
        lines += _join(columns, cells)
    return lines


def _join(columns: Sequence[_Column], cells: Sequence[Sequence[str]]) -> Iterator[str]:
    """Yield the lines of a row from the lines of its cells."""
    for parts in zip_longest(*cells, fillvalue=""):
        placed = (column.place(part) for column, part in zip(columns, parts, strict=True))
        yield _GAP.join(placed).rstrip()


def _break(text: str, width: int) -> list[str]:
    """Return the lines of a name: broken behind a sign where there is one, else anywhere."""
    lines = [""]
    for part in re.findall(r"[^\s_./-]*[\s_./-]*", text):
        if len(lines[-1]) + len(part.rstrip()) > width and lines[-1]:
            lines.append("")
        lines[-1] += part
        while len(lines[-1].rstrip()) > width:
            lines[-1:] = [lines[-1][:width], lines[-1][width:]]
    # Room for a mark is part of a figure.
    return [text] if len(text) <= width else [line.rstrip() for line in lines]


def _wrap_notes(notes: Sequence[str], width: int) -> Iterator[str]:
    for note in notes:
        yield from textwrap.wrap(escape_controls(note), width, break_on_hyphens=False)
