"""Tables as values, before formatting, and the order of metrics of several laws in them.

Loops with the same name share rows. Other loops are equivalent if they control the same quantity
with the same command. Quantities are the heading, the distance to the goal and the offset from the
line. In addition, both must answer a step, or both follow a reference. Loops of one law are never
merged, because a run has both.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, Literal

from turtlelog.display import (
    describe_count,
    fit_line,
    format_html,
    format_notebook,
    format_number,
    join_words,
)
from turtlelog.measure import Metric, Status
from turtlelog.parts import split_key_unit
from turtlelog.run.loops import RESERVED, ControlLoop, Declaration
from turtlelog.run.tables import Tabular

if TYPE_CHECKING:
    from turtlelog.compare.run_summary import RunSummary

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
        rows: Rows, each as long as `columns`; None: no value. A Status is shown in words.
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
        rows = [[one.words if isinstance(one, Status) else one for one in row] for row in self.rows]
        from html import escape  # a notebook alone needs it

        notes = [f"<p>{escape(note)}</p>" for note in self.notes]
        return format_notebook(self.title, format_html(rows, heads=heads), *notes)


def format_cell(cell: Cell, column: Column) -> str:
    """Return a cell as text; `-` if there is no value."""
    if cell is None:
        return "-"
    if isinstance(cell, Status):
        return cell.words
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


_Kind = tuple[str, str, bool]


def head_column(name: str, units: Sequence[str]) -> Column:
    """Return the column of a metric or a parameter with the units of its values."""
    title, unit = split_key_unit(name) if not units else (name, units[0])
    lines = tuple(title.replace(".", "_").split("_"))
    has_unit = len(units) < 2 and unit != "1"
    return Column(title=name, unit=unit if has_unit else "", lines=lines)


def get_metric_cell(metric: Metric | None, *, has_one_unit: bool) -> Cell:
    """Return a value, with a unit if the metric has several units, or why the value is missing."""
    if metric is None:
        return None
    if metric.value is None:
        return metric.status
    return metric.value if has_one_unit else format_number(metric.value, metric.unit)


def put_ends_first(table: Table) -> Table:
    """Return a table with final errors next to the gains: pictures leave room for half of it."""
    titles = [column.title for column in table.columns]
    ends = [place for place, title in enumerate(titles) if title.startswith("final.")]
    first = next((place for place, title in enumerate(titles) if "." in title), len(titles))
    rest = [place for place in range(first, len(titles)) if place not in ends]
    order = [*range(first), *reversed(ends), *rest]
    return replace(
        table,
        columns=tuple(table.columns[place] for place in order),
        rows=tuple(tuple(row[place] for place in order) for row in table.rows),
        marks={(row, order.index(place)): mark for (row, place), mark in table.marks.items()},
    )


def name_best(names: Sequence[str], marks: Mapping[str, Mapping[int, Mark]]) -> str:
    """Return which run is the best in all compared metrics; empty if no run is marked."""
    marked = {name: found for name, found in marks.items() if found}
    if not marked:
        return ""
    best = [{row for row, mark in found.items() if mark == "best"} for found in marked.values()]
    common = set.intersection(*best)
    if not common:
        return "no run is best at everything"
    what = next(iter(marked)) if len(best) == 1 else "every metric shown"
    who = join_words([names[row] for row in sorted(common)])
    return f"{who} {'is' if len(common) == 1 else 'are'} best at {what}"


def drop_absent(summaries: "Sequence[RunSummary]", ids: Collection[str]) -> tuple[str, ...]:
    """Return the metrics for which at least one run has the data.

    If every run has a law, all metrics are returned, so that tables do not depend on the data.
    """
    if not any(found.is_lawless for found in summaries):
        return tuple(ids)
    held = {
        name
        for found in summaries
        for name, metric in found.metrics.items()
        if metric.status is not Status.ABSENT
    }
    return tuple(name for name in ids if name in held)


def order_ids(ids: Iterable[str], declarations: Iterable[Declaration] = ()) -> tuple[str, ...]:
    """Return the ids of several laws without duplicates: loop by loop, then end and run.

    Equivalent loops in the laws' declarations alternate, metric by metric.
    """
    return tuple(name for group in group_ids(ids, declarations) for name in group)


def group_ids(
    ids: Iterable[str], declarations: Iterable[Declaration] = ()
) -> tuple[tuple[str, ...], ...]:
    """Return the ids in groups, in the order of `order_ids`."""
    by_loop: dict[str, list[str]] = {}
    for name in dict.fromkeys(ids):
        by_loop.setdefault(name.rpartition(".")[0], []).append(name)
    loops = [loop for loop in by_loop if loop not in RESERVED]
    groups = [*group_loops(loops, declarations), *((name,) for name in by_loop if name in RESERVED)]
    return tuple(_take_turns([by_loop[loop] for loop in group]) for group in groups)


def group_loops(
    names: Iterable[str], declarations: Iterable[Declaration]
) -> tuple[tuple[str, ...], ...]:
    """Return the names of equivalent loops in groups, with groups of one kind side by side."""
    declared = tuple(dict.fromkeys(declarations))
    kinds: dict[str, _Kind] = {}
    for loop in (loop for declaration in declared for loop in declaration.loops):
        kinds.setdefault(loop.name, _find_kind(loop))
    together = [{loop.name for loop in declaration.loops} for declaration in declared]
    groups: list[list[str]] = []
    for name in names:
        kind = kinds.get(name)
        alike = [group for group in groups if kind is not None and kinds.get(group[0]) == kind]
        for group in alike:
            if not any(name in law and not law.isdisjoint(group) for law in together):
                group.append(name)
                break
        else:
            place = groups.index(alike[-1]) + 1 if alike else len(groups)
            groups.insert(place, [name])
    return tuple(map(tuple, groups))


def _find_kind(loop: ControlLoop) -> _Kind:
    is_way = loop.signal in ("along_track", "distance")
    return ("way" if is_way else loop.signal, loop.command, loop.moves)


def _take_turns(columns: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """Return the ids of several loops metric by metric, in order of first appearance."""
    by_metric: dict[str, list[str]] = {}
    for name in (name for column in columns for name in column):
        by_metric.setdefault(name.rpartition(".")[2], []).append(name)
    return tuple(name for names in by_metric.values() for name in names)


_MOST_NAMED: Final = 3
"""Largest number of metrics named beside the reason for their missing values."""


def list_reasons(measured: Iterable[Mapping[str, Metric]]) -> tuple[str, ...]:
    """Return the reasons for missing values without duplicates.

    If a status has several reasons, a cell does not show which one applies; then the reasons name
    the metrics.
    """
    named: dict[Status, dict[str, dict[str, None]]] = {}
    for metrics in measured:
        for name, metric in metrics.items():
            if metric.reason:
                reasons = named.setdefault(metric.status, {})
                reasons.setdefault(metric.reason, {})[name] = None
    return tuple(
        f"{status.words}{_name_some([*names]) if len(reasons) > 1 else ''}: {reason}."
        for status, reasons in named.items()
        for reason, names in reasons.items()
    )


def _name_some(names: Sequence[str]) -> str:
    rest = len(names) - _MOST_NAMED
    shown = names if rest < 2 else [*names[:_MOST_NAMED], f"{rest} more"]
    return f" ({join_words(shown)})"
