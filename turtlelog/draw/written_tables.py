"""Tables as text for a terminal, Markdown, CSV and LaTeX; and the tables on runs as documents.

No library is used, so that printed and stored tables do not change with its version. A document is
Markdown text next to pictures.
"""

import io
import re
import textwrap
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby, zip_longest
from typing import TYPE_CHECKING, Final

from turtlelog import compare, measure
from turtlelog.compare import Cell, Column, Mark, Table, format_cell
from turtlelog.compare.table import put_ends_first
from turtlelog.display import describe_count
from turtlelog.errors import ShowError
from turtlelog.escapes import escape_controls, escape_latex, escape_markdown, guard_cell
from turtlelog.run.loops import PAUSE

if TYPE_CHECKING:
    # Tables of theory are printed without runs.
    from turtlelog.measure import Metric
    from turtlelog.run import Parameter, Run

_NOTE_WIDTH: Final = 96
_GAP: Final = "  "
_LEAST_TEXT: Final = 16
_LEAST_NUMBER: Final = 8
_MOST_IN_BLOCKS: Final = 32


@dataclass(frozen=True, slots=True, kw_only=True)
class _Column:
    """A column as text."""

    titles: tuple[str, ...]  # lines of the column's title
    unit: str  # unit in brackets; empty without a unit
    cells: tuple[str, ...]  # text of each row
    is_numeric: bool  # whether the column is aligned to the right
    is_joined: bool  # whether the column must stay next to the previous column
    width: int  # available width [characters]; longer text is broken into lines

    @property
    def least_width(self) -> int:
        """Smallest possible width [characters]. Values stay complete, names may be broken."""
        if not self.is_numeric:
            return min(self.width, _LEAST_TEXT)
        return min(self.width, max(_LEAST_NUMBER, len(self.unit), *map(len, self.cells)))


def format_text(table: Table, width: int | None = None) -> str:
    """Return a table for a terminal: aligned columns, units in the second line, notes below.

    If the table is wider than `width`, names are broken into lines. If that is not sufficient, the
    columns are split into several blocks, and each block begins with the text columns.
    """
    columns = [_build_column(table, index) for index in range(len(table.columns))]
    blocks = [columns] if width is None else _fit(columns, width)
    lines = [escape_controls(table.title)]
    for block in blocks:
        lines += ["", *_format_block(block, table.breaks)]
    notes = [*([_LEGENDS["txt"]] if table.marks else []), *table.notes]
    longest = min(width or _NOTE_WIDTH, _NOTE_WIDTH)
    for number, note in enumerate(notes):
        lines += [] if number else [""]
        lines += textwrap.wrap(escape_controls(note), longest, break_on_hyphens=False)
    return "\n".join(lines) + "\n"


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
    """Return a table as CSV with full precision and units in titles; missing values are empty."""
    import csv

    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([guard_cell(_join_title(column)) for column in table.columns])
    writer.writerows(
        [["" if cell is None else guard_cell(cell) for cell in row] for row in table.rows]
    )
    return text.getvalue()


def format_latex(table: Table) -> str:
    """Return a table as LaTeX for the booktabs package. A wide table spans two columns."""
    alignment = "".join("r" if _is_numeric(table, i) else "l" for i in range(len(table.columns)))
    rows = _format_rows(table, "tex")
    size, star = (r"\footnotesize", "*") if _is_wide(table) else (r"\small", "")
    # LaTeX adds the number of a table to its caption.
    title = _NUMBERED.sub("", table.title)
    title = table.title if title == table.title else title.capitalize()
    lines = [
        rf"\begin{{table{star}}}",
        rf"  \centering{size}\setlength{{\tabcolsep}}{{4pt}}",
        rf"  \caption{{{escape_latex(title)}}}",
        *([rf"  \label{{{table.label}}}"] if table.label else []),
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


_FORMATS: Final[Mapping[str, Callable[[Table], str]]] = {
    "txt": format_text,
    "md": format_markdown,
    "csv": format_csv,
    "tex": format_latex,
}

TABLE_FORMATS: Final = tuple(_FORMATS)  # formats of tables, named as the suffixes of their files


def format_table(table: Table, kind: str = "txt", *, width: int | None = None) -> str:
    """Return a table as `txt`, `md` (Markdown), `csv` or `tex` (LaTeX).

    Args:
        table: Table to format.
        kind: Name of the format.
        width: Line length for `txt` [characters]. In a table that is too wide, names are broken
            into lines, and columns are split into blocks. Default: unlimited.

    Raises:
        ShowError: If there is no such format.
    """
    if kind not in _FORMATS:
        raise ShowError(f"format: expected one of {', '.join(_FORMATS)}, found {kind!r}")
    return format_text(table, width) if kind == "txt" else _FORMATS[kind](table)


def _format_rows(table: Table, kind: str) -> list[list[str]]:
    return [
        [
            _mark(table, row, index, _format(cell, column, kind), kind)
            for index, (cell, column) in enumerate(zip(cells, table.columns, strict=True))
        ]
        for row, cells in enumerate(table.rows)
    ]


def _format(cell: Cell, column: Column, kind: str) -> str:
    text = format_cell(cell, column)
    if not isinstance(cell, float | int):
        return escape_markdown(text) if kind == "md" else escape_latex(text)
    mantissa, _, power = text.partition("e")
    if kind == "tex" and power:
        return rf"${mantissa} \times 10^{{{int(power)}}}$"
    # A minus sign instead of a hyphen.
    return f"${text}$" if kind == "tex" and text.startswith("-") else text


def _mark(table: Table, row: int, index: int, text: str, kind: str) -> str:
    return _MARKS[kind].get(table.marks.get((row, index)), "{}").format(text)


def _list_notes(table: Table, kind: str) -> list[str]:
    legend = [_LEGENDS[kind]] if table.marks else []
    escape = partial(escape_markdown, starts_line=True) if kind == "md" else escape_latex
    return [*legend, *map(escape, table.notes)]


def _is_numeric(table: Table, index: int) -> bool:
    return any(isinstance(row[index], float | int) for row in table.rows)


def _join_title(column: Column) -> str:
    return f"{column.title} [{column.unit}]" if column.unit else column.title


def _is_wide(table: Table) -> bool:
    """Return whether a row is too long for one of two columns of a page."""
    rows = [list(map(format_cell, row, table.columns)) for row in table.rows]
    titles = [max(column.lines or (column.title,), key=len) for column in table.columns]
    columns = zip(titles, *rows, strict=True)
    return sum(max(map(len, column)) for column in columns) > _NARROW_LETTERS


def _list_heads(table: Table) -> list[list[str]]:
    """Return the title lines of a table: long titles are broken, and units are below."""
    titles = [list(map(escape_latex, column.lines or (column.title,))) for column in table.columns]
    height = max(map(len, titles))
    heads = [[*[""] * (height - len(title)), *title] for title in titles]
    units = [f"[{escape_latex(column.unit)}]" if column.unit else "" for column in table.columns]
    return [*map(list, zip(*heads, strict=True)), *([units] if any(units) else [])]


_NUMBERED: Final = re.compile(r"^Table \d+: ")


def _join_latex(cells: list[str]) -> str:
    # After a rule or the end of a row LaTeX would read `[` or `*` as an argument.
    guard = "{}" if cells[0][:1] in {"[", "*"} else ""
    return f"    {guard}{' & '.join(cells)} \\\\"


def _build_column(table: Table, index: int) -> _Column:
    column = table.columns[index]
    # Numbers are aligned with numbers, and marks with marks.
    marked = {row for row, place in table.marks if place == index}
    room = " " if marked else ""
    cells = tuple(
        _mark(table, row, index, escape_controls(format_cell(cells[index], column)), "txt")
        + ("" if row in marked else room)
        for row, cells in enumerate(table.rows)
    )
    titles = tuple(escape_controls(line) + room for line in column.lines or (column.title,))
    unit = f"[{column.unit}]{room}" if column.unit else ""
    return _Column(
        titles=titles,
        unit=unit,
        cells=cells,
        is_numeric=_is_numeric(table, index),
        is_joined=column.joined,
        width=max(map(len, (*titles, unit, *cells))),
    )


def _fit(columns: Sequence[_Column], width: int) -> list[list[_Column]]:
    """Return blocks of columns that are not wider than `width`, if possible."""
    if _measure([replace(column, width=column.least_width) for column in columns]) <= width:
        return [_shrink(columns, width)]
    capped = [
        replace(column, width=min(column.width, max(column.least_width, _MOST_IN_BLOCKS)))
        for column in columns
    ]
    texts = next((i for i, column in enumerate(capped) if column.is_numeric), len(capped))
    leading = capped[: texts if texts < len(capped) else 1]
    groups: list[list[_Column]] = []
    for column in capped[len(leading) :]:
        if groups and column.is_joined:
            groups[-1].append(column)
        else:
            groups.append([column])
    blocks: list[list[_Column]] = []
    for group in groups:
        if not blocks or _measure([*blocks[-1], *group]) > width:
            blocks.append([*leading])
        blocks[-1] += group
    return [_shrink(block, width) for block in blocks or [leading]]


def _shrink(columns: Sequence[_Column], width: int) -> list[_Column]:
    """Narrow the widest columns that can be broken, until all fit or no such column is left."""
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
    # The last line of a title is directly above its unit.
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
    for parts in zip_longest(*cells, fillvalue=""):
        named = zip(columns, parts, strict=True)
        placed = (f"{part:{'>' if one.is_numeric else '<'}{one.width}}" for one, part in named)
        yield _GAP.join(placed).rstrip()


_PART: Final = re.compile(r"(?:[^\s_./-]|(?<=\d)\.(?=\d))*(?:[\s_/-]|\.(?!\d)|(?<!\d)\.)*")
"""A part of a name with its punctuation; a decimal point divides no number."""


def _break(text: str, width: int) -> list[str]:
    """Return the lines of a name, broken after punctuation if possible, else anywhere."""
    if len(text) <= width:  # unchanged: room for a mark is part of a number
        return [text]
    lines = [""]
    for part in _PART.findall(text):
        if len(lines[-1]) + len(part.rstrip()) > width and lines[-1]:
            lines.append("")
        lines[-1] += part
        while len(lines[-1].rstrip()) > width:
            lines[-1:] = [lines[-1][:width], lines[-1][width:]]
    return [line.rstrip() for line in lines]


_NARROW_LETTERS: Final = 42  # longest row of one of two columns [letters]

_MARKS: Final[Mapping[str, Mapping[Mark | None, str]]] = {
    "txt": {"best": "{}*", "worst": "{}!"},
    "md": {"best": "**{}**", "worst": "*{}*"},
    "tex": {"best": r"\textbf{{{}}}", "worst": r"\textit{{{}}}"},
}
"""Marks of the best and worst values of a column, by format."""

_LEGENDS: Final[Mapping[str, str]] = {
    "txt": "* best, ! worst of a column.",
    "md": "**best**, *worst* of a column.",
    "tex": r"\textbf{best}, \textit{worst} of a column.",
}

_HEADS: Final[Mapping[str, str]] = {"final": "At the end", "run": "The whole run"}


def document_run(run: "Run", *, metrics: Mapping[str, "Metric"] | None = None) -> Mapping[str, str]:
    """Return the documents of one run by title: metrics, and the known part of the scenario."""
    metrics = measure.measure_run(run) if metrics is None else metrics
    texts = {"Metrics": _list_metrics(run, metrics), "Scenario": _list_scenario(run)}
    return {title: "\n".join(lines) + "\n" for title, lines in texts.items()}


def document_runs(
    runs: Sequence["Run"], *, metrics: Sequence[Mapping[str, "Metric"]] | None = None
) -> Mapping[str, str]:
    """Return the documents of a comparison by title: table of runs, metrics, Table 1."""
    metrics = [measure.measure_run(run) for run in runs] if metrics is None else metrics
    pairs = zip(runs, metrics, strict=True)
    summaries = [compare.summarise_run(run, metrics=measured) for run, measured in pairs]
    tables = {
        "Side by side": (put_ends_first(compare.tabulate_runs(summaries)),),
        "Metrics": (
            compare.tabulate_measured(
                compare.name_runs(runs),
                choose_essentials(runs, metrics),
                declarations=[run.declaration for run in runs],
            ),
        ),
        "Table 1": (compare.tabulate_whole_runs(runs), compare.tabulate_table1(runs)),
    }
    return {title: "\n".join(map(format_markdown, found)) for title, found in tables.items()}


def choose_essentials(
    runs: Sequence["Run"], metrics: Sequence[Mapping[str, "Metric"]]
) -> list[dict[str, "Metric"]]:
    """Return the metrics of each run to look at first; loop metrics only for declared loops."""
    ids = measure.list_essential_metrics(*(run.declaration for run in runs))
    return [{name: known[name] for name in ids if name in known} for known in metrics]


def _list_metrics(run: "Run", metrics: Mapping[str, "Metric"]) -> Iterable[str]:
    """Yield the lines of the metrics: a table for each group, and missing values below."""
    yield escape_markdown(run.name, starts_line=True)
    groups = groupby(metrics.values(), lambda metric: metric.id.partition(".")[0])
    tables = [(group, list(found)) for group, found in groups]
    if not len(run.samples):  # of a robot's recording, `metrics` lists all reasons
        missing = [one for one in metrics.values() if one.value is None]
        if missing:
            first, *others = dict.fromkeys(metric.reason for metric in missing)
            more = f", and {describe_count(len(others), 'other reason')}" if others else ""
            told = f"{describe_count(len(missing), 'metric')} without a value: {first}{more}."
            yield from ("", escape_markdown(told))
        held = [(group, [one for one in found if one.value is not None]) for group, found in tables]
        tables = [(group, found) for group, found in held if found]
    for group, listed in tables:
        known = [metric for metric in listed if metric.value is not None]
        yield from ("", f"**{_HEADS.get(group) or _head_loop(run, group)}**", "")
        if known:
            yield from ("| metric | value | unit | at [s] |", "| --- | ---: | --- | ---: |")
            yield from map(_format_metric, known)
        missing = [metric for metric in listed if metric.value is None]
        reasons = sorted({metric.reason for metric in missing})
        for reason in reasons:
            names = [_shorten(metric.id) for metric in missing if metric.reason == reason]
            yield from ("", f"No {', '.join(names)}: {escape_markdown(reason)}.")


def _head_loop(run: "Run", name: str) -> str:
    """Return the heading of a loop's metrics, with a note if they include its pause."""
    loop = run.declaration.find_loop(name)
    stretch = [] if loop is None else measure.find_first_stretch(run, loop)
    has_pause = any(span.phase == PAUSE for span in stretch)
    head = f"{name[0].upper()}{name[1:]}"
    return escape_markdown(f"{head}, its pause included" if has_pause else head)


def _format_metric(metric: "Metric") -> str:
    value = format_cell(metric.value, Column(title=""))
    unit = "" if metric.unit == "1" else metric.unit
    at = "" if metric.at_s is None else f"{metric.at_s:.3f}"
    return f"| {_shorten(metric.id)} | {value} | {unit} | {at} |"


def _shorten(metric_id: str) -> str:
    return metric_id.partition(".")[2].replace("_", " ")


def _list_scenario(run: "Run") -> Iterable[str]:
    """Yield the lines on a run and its scenario, a table for each section."""
    head = f"{run.name}: {run.source}, {run.stop_reason or 'end not recorded'}."
    yield escape_markdown(head, starts_line=True)
    sections = sorted(run.parameters.items(), key=lambda item: item[0].rpartition(".")[0])
    for section, values in groupby(sections, lambda item: item[0].rpartition(".")[0]):
        yield from _tabulate(section, values)
    yield from _tabulate("Notes of the importer", run.notes.items())
    if run.absent:
        yield from ("", escape_markdown(f"Not recorded: {', '.join(run.absent)}."))


def _tabulate(title: str, values: Iterable[tuple[str, "Parameter"]]) -> Iterable[str]:
    rows = [
        f"| {escape_markdown(key.rpartition('.')[2])} | {escape_markdown(str(value))} |"
        for key, value in values
    ]
    if rows:
        heading = [f"**{escape_markdown(title)}**", ""] if title else []
        yield from ("", *heading, "| key | value |", "| --- | --- |", *rows)
