"""Tables as text, Markdown, CSV and LaTeX."""

import csv
import io
import re
from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType
from typing import Final

from turtlelog.compare import Column, Mark, Table, format_cell
from turtlelog.compare.run_table import Cell
from turtlelog.errors import ShowError
from turtlelog.escapes import escape_controls, escape_markdown, guard_cell
from turtlelog.show.text_tables import format_text


def format_markdown(table: Table) -> str:
    """Return a table as GitHub-flavoured Markdown."""
    titles = [escape_markdown(_join_title(column)) for column in table.columns]
    rules = [" ---: " if _is_numeric(table, i) else " --- " for i in range(len(titles))]
    rows = _format_rows(table, "md")
    lines = [
        f"**{escape_markdown(table.title)}**",
        "",
        "| " + " | ".join(titles) + " |",
        "|" + "|".join(rules) + "|",
        *("| " + " | ".join(row) + " |" for row in rows),
        *(line for note in _list_notes(table, "md") for line in ("", note)),
    ]
    return "\n".join(lines) + "\n"


def format_csv(table: Table) -> str:
    """Return a table as CSV with full precision, units in the head; empty where no value is."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([guard_cell(_join_title(column)) for column in table.columns])
    writer.writerows(
        [["" if cell is None else guard_cell(cell) for cell in row] for row in table.rows]
    )
    return text.getvalue()


def format_latex(table: Table, *, label: str = "") -> str:
    """Return a table as LaTeX for the booktabs package; a wide one spans both of two columns.

    Args:
        table: What to format.
        label: Of LaTeX, to refer to it by; none where empty.
    """
    alignment = "".join("r" if _is_numeric(table, i) else "l" for i in range(len(table.columns)))
    rows = _format_rows(table, "tex")
    size = r"\footnotesize" if _is_wide(table) else r"\small"
    star = "*" if _is_wide(table) else ""
    lines = [
        rf"\begin{{table{star}}}",
        rf"  \centering{size}\setlength{{\tabcolsep}}{{4pt}}",
        rf"  \caption{{{_escape_latex(table.title)}}}",
        *([rf"  \label{{{label}}}"] if label else []),
        rf"  \begin{{tabular}}{{{alignment}}}",
        r"    \toprule",
        *(_join_latex(head) for head in _list_heads(table)),
        r"    \midrule",
        *(
            (r"    \addlinespace" "\n" if row in table.breaks else "") + _join_latex(cells)
            for row, cells in enumerate(rows)
        ),
        r"    \bottomrule",
        r"  \end{tabular}",
        *(rf"  \par {note}" for note in _list_notes(table, "tex")),
        rf"\end{{table{star}}}",
    ]
    return "\n".join(lines) + "\n"


_FORMATS: Final[Mapping[str, Callable[[Table], str]]] = MappingProxyType(
    {"txt": format_text, "md": format_markdown, "csv": format_csv, "tex": format_latex}
)

TABLE_FORMATS: Final = tuple(_FORMATS)
"""The formats of tables, named as the suffixes of their files."""


def format_table(table: Table, kind: str = "txt", *, width: int | None = None) -> str:
    """Return a table as `txt`, `md` (Markdown), `csv` or `tex` (LaTeX).

    Args:
        table: What to format.
        kind: The format.
        width: Room for `txt` [characters]: names are broken into lines, and columns put below each
            other in blocks, where it is too wide; None: as wide as it needs.

    Raises:
        ShowError: Where there is no such format.
    """
    if kind not in _FORMATS:
        raise ShowError(f"format: expected one of {', '.join(_FORMATS)}, found {kind!r}")
    return format_text(table, width) if kind == "txt" else _FORMATS[kind](table)


def _format_rows(table: Table, kind: str) -> list[list[str]]:
    """Return the cells as a format writes them, escaped and marked."""
    marks = _MARKS[kind]
    return [
        [
            marks.get(table.marks.get((row, index)), "{}").format(_format(cell, column, kind))
            for index, (cell, column) in enumerate(zip(cells, table.columns, strict=True))
        ]
        for row, cells in enumerate(table.rows)
    ]


def _format(cell: Cell, column: Column, kind: str) -> str:
    text = format_cell(cell, column)
    if isinstance(cell, float | int):
        return _typeset_number(text) if kind == "tex" else text
    return _ESCAPES[kind](text)


def _list_notes(table: Table, kind: str) -> list[str]:
    """Return the notes below a table, the legend of its marks first."""
    legend = [_LEGENDS[kind]] if table.marks else []
    escape = partial(escape_markdown, starts_line=True) if kind == "md" else _escape_latex
    return [*legend, *map(escape, table.notes)]


def _is_numeric(table: Table, index: int) -> bool:
    return any(isinstance(row[index], float | int) for row in table.rows)


def _join_title(column: Column) -> str:
    return f"{column.title} [{column.unit}]" if column.unit else column.title


def _is_wide(table: Table) -> bool:
    """Return whether the cells of a row are more than one of two columns has room for."""
    rows = [list(map(format_cell, row, table.columns)) for row in table.rows]
    titles = [max(column.lines or (column.title,), key=len) for column in table.columns]
    columns = zip(titles, *rows, strict=True)
    return sum(max(map(len, column)) for column in columns) > _NARROW_LETTERS


def _list_heads(table: Table) -> list[list[str]]:
    """Return the lines of the head: titles, broken where they are long, and the units below."""
    titles = [list(map(_escape_latex, column.lines or (column.title,))) for column in table.columns]
    height = max(map(len, titles))
    heads = [[*[""] * (height - len(title)), *title] for title in titles]
    units = [f"[{_escape_latex(column.unit)}]" if column.unit else "" for column in table.columns]
    return [*map(list, zip(*heads, strict=True)), *([units] if any(units) else [])]


def _join_latex(cells: list[str]) -> str:
    # After a rule or the end of a row LaTeX would take `[` or `*` for its own.
    guard = "{}" if cells[0][:1] in {"[", "*"} else ""
    return f"    {guard}{' & '.join(cells)} \\\\"


def _typeset_number(text: str) -> str:
    """Return a number with a minus that is none of a hyphen, and its power of ten."""
    mantissa, _, power = text.partition("e")
    if power:
        return rf"${mantissa} \times 10^{{{int(power)}}}$"
    return f"${text}$" if text.startswith("-") else text


def _escape_latex(text: str) -> str:
    special = {character: f"\\{character}" for character in "&%$#_{}"}
    special |= {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
    special |= {"<": r"\textless{}", ">": r"\textgreater{}", "|": r"\textbar{}"}
    line = " ".join(text.splitlines())
    escaped = "".join(special.get(letter, letter) for letter in escape_controls(line))
    return re.sub(r"\\textasciicircum{}(\d+)", r"\\textsuperscript{\1}", escaped)


_NARROW_LETTERS: Final = 42
"""What one of two columns holds in a row [letters]."""

_MARKS: Final[Mapping[str, Mapping[Mark | None, str]]] = MappingProxyType(
    {
        "md": {"best": "**{}**", "worst": "*{}*"},
        "tex": {"best": r"\textbf{{{}}}", "worst": r"\textit{{{}}}"},
    }
)
"""How the best and the worst of a column are marked."""

_LEGENDS: Final[Mapping[str, str]] = MappingProxyType(
    {
        "md": "**best**, *worst* of a column.",
        "tex": r"\textbf{best}, \textit{worst} of a column.",
    }
)

_ESCAPES: Final[Mapping[str, Callable[[str], str]]] = MappingProxyType(
    {"md": escape_markdown, "tex": _escape_latex}
)
