"""Tables as text, Markdown, CSV and LaTeX."""

import csv
import io
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Final

from turtlelog.compare import Column, Mark, Table, format_cell
from turtlelog.errors import ShowError
from turtlelog.show.text_tables import format_text


def format_markdown(table: Table) -> str:
    """Return a table as GitHub-flavoured Markdown."""
    titles = [_escape_markdown(_join_title(column)) for column in table.columns]
    rules = [" ---: " if _is_numeric(table, i) else " --- " for i in range(len(titles))]
    rows = _format_rows(table, "md")
    lines = [
        f"**{table.title}**",
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
    writer.writerow([_join_title(column) for column in table.columns])
    writer.writerows([["" if cell is None else cell for cell in row] for row in table.rows])
    return text.getvalue()


def format_latex(table: Table) -> str:
    """Return a table as LaTeX for the booktabs package."""
    alignment = "".join("r" if _is_numeric(table, i) else "l" for i in range(len(table.columns)))
    lines = [
        r"\begin{table}",
        rf"  \caption{{{_escape_latex(table.title)}}}",
        rf"  \begin{{tabular}}{{{alignment}}}",
        r"    \toprule",
        "    " + _join_latex([_join_title(column) for column in table.columns]),
        r"    \midrule",
        *(
            (r"    \addlinespace" "\n" if row in table.breaks else "")
            + f"    {' & '.join(cells)} \\\\"
            for row, cells in enumerate(_format_rows(table, "tex"))
        ),
        r"    \bottomrule",
        r"  \end{tabular}",
        *(rf"  \par\footnotesize {note}" for note in _list_notes(table, "tex")),
        r"\end{table}",
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
    escape, marks = _ESCAPES[kind], _MARKS[kind]
    return [
        [
            marks.get(table.marks.get((row, index)), "{}").format(escape(format_cell(cell, column)))
            for index, (cell, column) in enumerate(zip(cells, table.columns, strict=True))
        ]
        for row, cells in enumerate(table.rows)
    ]


def _list_notes(table: Table, kind: str) -> list[str]:
    """Return the notes below a table, the legend of its marks first."""
    legend = [_LEGENDS[kind]] if table.marks else []
    return [*legend, *map(_ESCAPES[kind], table.notes)]


def _is_numeric(table: Table, index: int) -> bool:
    return any(isinstance(row[index], float | int) for row in table.rows)


def _join_title(column: Column) -> str:
    return f"{column.title} [{column.unit}]" if column.unit else column.title


def _escape_markdown(text: str) -> str:
    return text.replace("|", r"\|")


def _join_latex(cells: list[str]) -> str:
    return " & ".join(map(_escape_latex, cells)) + r" \\"


def _escape_latex(text: str) -> str:
    special = {character: f"\\{character}" for character in "&%$#_{}"}
    special |= {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
    return "".join(special.get(character, character) for character in text)


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
    {"md": _escape_markdown, "tex": _escape_latex}
)
