"""`turtlelog plot TABLE`: maps, curves and sensitivities of a sweep."""

import shlex
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

from cyclopts import Group, Parameter

import turtlelog as tl
from turtlelog.cli import console
from turtlelog.cli.list_names import complete_keys
from turtlelog.cli.options import PICTURES, refuse_given, require_new_target
from turtlelog.cli.usage import find_command_name
from turtlelog.cli.work import show_progress
from turtlelog.display import describe_count, format_number, join_words
from turtlelog.errors import TurtlelogError, UsageError

if TYPE_CHECKING:
    from turtlelog.cli.plot import PageOptions
    from turtlelog.sweep import (
        BestRow,
        Border,
        LoopLimits,
        Sensitivity,
        SweptAxis,
        SweptMetric,
        SweptView,
    )


Kind = Literal["map", "curves", "tornado"]


@Parameter(name="*", group=Group("Tables of sweeps", sort_key=2))
@dataclass(frozen=True, slots=True, kw_only=True)
class ViewOptions:
    """View of a sweep's table.

    Attributes:
        kind: Maps over two keys (curves if only one varies), curves over one key with a line for
            each value of a second, or the change of each metric along each key (tornado). Default:
            map.
        x: Key at the bottom.
        y: Key at the side.
        at: Fix a varied key at a value. Example: loop.transport_delay_ticks=4. Can be repeated.
    """

    kind: Kind | None = None
    x: Annotated[str | None, Parameter(metavar="KEY", completer=complete_keys)] = None
    y: Annotated[str | None, Parameter(metavar="KEY", completer=complete_keys)] = None
    at: Annotated[list[str] | None, Parameter(metavar="KEY=VALUE", completer=complete_keys)] = None

    def list_words(self) -> list[str]:
        """Return the options as given."""
        given = (("--x", self.x), ("--y", self.y))
        words = [word for name, text in given if text is not None for word in (name, text)]
        return words + [word for text in self.at or [] for word in ("--at", text)]


def find_sweep_table(
    files: Sequence[Path], view: ViewOptions, figures: Mapping[str, object]
) -> Path | None:
    """Return the table of a sweep among the files, which is then alone; None without a table.

    `figures` are the options of figures of recordings, which a table does not take.
    """
    tables = []
    for path in files:
        with suppress(TurtlelogError):
            facts = tl.sweep.read_result_facts(path) if path.suffix.lower() == ".parquet" else None
            tables += [path] if facts is not None and facts.get("kind") == "sweep" else []
    if not tables and view == ViewOptions():
        return None
    if not tables:
        what = f"{files[0]} is a recording; " if files else ""
        need = "--kind, --x, --y and --at need one table written by turtlelog sweep"
        raise UsageError(f"{what}{need}")
    if len(files) > 1:
        raise UsageError(f"{tables[0]} is the table of a sweep, which is plotted alone")
    refuse_given(figures, f"leave it out, {tables[0]} is the table of a sweep")
    return tables[0]


def draw_table(
    table: Path,
    output: Path | None,
    view: ViewOptions,
    where: "PageOptions",
    patterns: list[str] | None,
    *,
    json: bool,
) -> None:
    """Draw the table of a sweep (None: nothing is drawn), and print its best rows."""
    kind = view.kind or "map"
    _require_output(output, table, kind, where)
    results = tl.sweep.read_swept_results(table, patterns)
    gains = tl.sweep.list_gain_keys(results)
    held = tl.scenario.parse_assignments(view.at or [], source="--at")
    shown = tl.sweep.choose_view(results, x=view.x, y=view.y, at=held, gains=gains)
    tl.sweep.require_values(shown)
    if kind == "tornado" and not tl.sweep.list_varied(results):
        raise UsageError(f"--kind tornado: no key varies in {table}")
    limits = tl.sweep.find_loop_limits(shown)
    if output is not None:
        with show_progress("drawing"):
            words = [*view.list_words(), *(["--metric", ",".join(patterns)] if patterns else [])]
            if output.suffix.lower() == ".html":
                command = shlex.join(["turtlelog", "plot", str(table), *words, "-o", str(output)])
                tl.draw.write_map_report(shown, limits, output, command=command)
            else:
                page = where.build_page([output.suffix[1:].lower()], None, usual="page")
                tl.draw.write_map_figure(shown, limits, output, kind=kind, page=page)
    told = build_map_answer(shown, limits, output)
    for note in told.notes:
        console.print_note(f"plot: {note}")
    if json:
        console.print_json(told)
        return
    lines = list_map_lines(shown, limits, told)
    if kind == "tornado":
        lines = [lines[0], *list_sensitivity_lines(shown)]
    lines += console.list_written([] if output is None else [output])
    console.print_text("\n".join(lines))


def _require_output(output: Path | None, table: Path, kind: str, where: "PageOptions") -> None:
    suffix = "" if output is None else output.suffix.lower()
    if suffix == ".rrd":
        need = "view shows the recordings of rows, which sweep --record keeps"
        raise UsageError(f"--output {output}: a table becomes a figure or a report (.html); {need}")
    if suffix not in PICTURES and not where.is_usual:
        raise UsageError("--for, --text-width and --dpi need a figure to write: -o NAME.png")
    if output is None:
        return
    figures = ".pdf, .png or .svg"
    if suffix not in {*PICTURES, ".html"}:
        raise UsageError(
            f"--output {output}: must be a name that ends in .pdf, .png, .svg or .html"
        )
    if suffix == ".html" and kind != "map":
        raise UsageError(f"--kind {kind}: {output} is no figure; end its name in {figures}")
    require_new_target(output, [table], suffix=suffix)


@dataclass(frozen=True, slots=True, kw_only=True)
class SweptAxisAnswer:
    """Keys that vary together, with their values."""

    keys: tuple[str, ...]
    unit: str | None
    values: tuple[tuple[Any, ...], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class BorderAnswer:
    """Border of stability along a gain, with theory's limit."""

    at: tuple[Any, ...] | None
    last_stable: float | None
    first_unstable: float | None
    theory: float | None
    within_one_cell: bool | None


@dataclass(frozen=True, slots=True, kw_only=True)
class KeySensitivity:
    """Range of a metric along one key alone."""

    keys: tuple[str, ...]
    least: float | None
    most: float | None
    at_least: tuple[Any, ...] | None
    at_most: tuple[Any, ...] | None
    correlation: float | None
    left_out: int
    range_elsewhere: tuple[float, float] | None


@dataclass(frozen=True, slots=True, kw_only=True)
class SensitivityAnswer:
    """Ranges of a metric along each key, and its value in the middle."""

    held: Mapping[str, Any] | str | None
    value: float | None
    chance: float | None
    explained: float | None
    keys: list[KeySensitivity]
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class MetricOfTable:
    """A metric over the shown rows."""

    id: str
    unit: str
    values: int
    least: float | None
    most: float | None
    no_value: Mapping[str, int]
    best: "tl.sweep.BestRow | None"
    borders: list[BorderAnswer] | None
    sensitivities: SensitivityAnswer


@dataclass(frozen=True, slots=True, kw_only=True)
class LimitsAt:
    """Limits from theory at values of the other key."""

    at: tuple[Any, ...] | None
    limits: Any


@dataclass(frozen=True, slots=True, kw_only=True)
class LimitsAnswer:
    """Limits from theory for a loop's gain."""

    loop: str
    gain: tuple[str, ...]
    columns: list[LimitsAt]


@dataclass(frozen=True, slots=True, kw_only=True)
class MapAnswer:
    """The drawn table of a sweep.

    Attributes:
        file: Path of the table.
        rows: Number of rows.
        failed: Number of failed rows.
        shown: Number of shown rows.
        axes: Keys that vary in the shown rows.
        held: Values of the other keys.
        seeds: Number of seeds that values are averaged over.
        metrics: Metrics that are shown.
        theory: Limits of the gains from theory.
        notes: Remarks.
        output: Written file; None if no file was written.
    """

    file: str
    rows: int
    failed: int
    shown: int
    axes: list[SweptAxisAnswer]
    held: Mapping[str, Any]
    seeds: int
    metrics: list[MetricOfTable]
    theory: list[LimitsAnswer]
    notes: list[str]
    output: str | None


def build_map_answer(
    view: "SweptView", limits: "Sequence[LoopLimits]", output: Path | None
) -> MapAnswer:
    """Return the answer as data."""
    results = view.results
    notes = [*view.notes, *(note for one in limits for note in one.notes)]
    if results.others:
        shown, all_ = len(results.metrics), len(results.metrics) + len(results.others)
        notes.insert(0, f"{shown} of {all_} metrics; --metric chooses")
    return MapAnswer(
        file=str(results.path),
        rows=results.row_count,
        failed=results.failed,
        shown=len(view.rows),
        axes=[console.copy_fields(SweptAxisAnswer, axis) for axis in view.axes],
        held=tl.sweep.name_values(view.held),
        seeds=view.seeds,
        metrics=[_describe_metric(view, metric, limits) for metric in results.metrics],
        theory=[
            LimitsAnswer(
                loop=one.loop,
                gain=one.gain.keys,
                columns=[
                    LimitsAt(
                        at=_find_values(_find_other(view, one), place),
                        limits=tl.sweep.describe_limits(limit),
                    )
                    for place, limit in enumerate(one.columns)
                ],
            )
            for one in limits
        ],
        notes=notes,
        output=None if output is None else str(output),
    )


def _find_other(view: "SweptView", limits: "LoopLimits") -> "SweptAxis | None":
    """Return the axis that is not the gain's; None if only the gain varies."""
    return next((axis for axis in view.axes if axis is not limits.gain), None)


def _describe_metric(
    view: "SweptView", metric: "SweptMetric", limits: "Sequence[LoopLimits]"
) -> MetricOfTable:
    import numpy as np

    values = tl.sweep.list_shown_values(view, metric)[1]
    known = values[np.isfinite(values)]
    valueless = view.rows[~np.isfinite(metric.values[view.rows])]
    found = tl.sweep.find_sensitivities(view.results, metric, dict(view.held))
    return MetricOfTable(
        id=metric.name,
        unit=metric.unit,
        values=len(known),
        least=float(known.min()) if len(known) else None,
        most=float(known.max()) if len(known) else None,
        no_value=Counter(str(metric.reasons[row]) for row in valueless.tolist()),
        best=tl.sweep.find_best_row(view, metric),
        borders=_describe_borders(view, metric, limits),
        sensitivities=SensitivityAnswer(
            held=found.held or None,
            value=found.center,
            chance=found.chance,
            explained=found.explained,
            keys=[
                console.copy_fields(
                    KeySensitivity,
                    one,
                    keys=one.axis.keys,
                    at_least=_find_values(one.axis, one.least_place),
                    at_most=_find_values(one.axis, one.most_place),
                    range_elsewhere=one.others,
                )
                for one in found.keys
            ],
            notes=found.notes,
        ),
    )


def _find_values(axis: "SweptAxis | None", place: int | None) -> tuple[Any, ...] | None:
    return None if axis is None or place is None else axis.values[place]


def list_sensitivity_lines(view: "SweptView") -> list[str]:
    """Return sentences on the change of each metric along each key."""
    lines = []
    for metric in view.results.metrics:
        found = tl.sweep.find_sensitivities(view.results, metric, dict(view.held))
        lines += [f"{metric.name}: {_tell_sensitivity(metric, one)}" for one in found.keys]
        lines += found.notes
    return [console.fill_lines([line], indent=2) for line in lines]


def _tell_sensitivity(metric: "SweptMetric", one: "Sensitivity") -> str:
    name, axis, unit = one.axis.name, one.axis, metric.unit
    if one.correlation is not None:
        return f"{name} has the rank correlation {one.correlation:.2f}"
    if one.least is None or one.most is None:
        return f"{name} has no value to compare"
    ends = [
        f"{format_number(value, unit)} at {axis.tell_place(place or 0)}"
        for value, place in ((one.least, one.least_place), (one.most, one.most_place))
    ]
    text = f"{name} moves it by {format_number(one.size, unit)}, from {' to '.join(ends)}"
    if not one.size:
        text = f"{name} makes no difference"
    if one.others == (0.0, 0.0):
        text += ", whatever the other keys are"
    elif one.others is not None:
        low, high = (format_number(value, unit) for value in one.others)
        text += f"; over all values of the other keys by {low} to {high}"
    return text


def _describe_borders(
    view: "SweptView", metric: "SweptMetric", limits: "Sequence[LoopLimits]"
) -> list[BorderAnswer] | None:
    borders = tl.sweep.find_borders(view, metric, limits)
    own = next((one for one in limits if one.loop == metric.loop), None)
    if borders is None or own is None:
        return None
    other = _find_other(view, own)
    return [
        console.copy_fields(
            BorderAnswer,
            border,
            at=_find_values(other, border.place),
            within_one_cell=border.is_near,
        )
        for border in borders
    ]


_FIRST: Final = ("final.position_error", "run.duration")
"""Metrics in the first lines, if they are shown."""


def list_map_lines(view: "SweptView", limits: "Sequence[LoopLimits]", told: MapAnswer) -> list[str]:
    """Return the printed lines of a view."""
    results = view.results
    sides = " by ".join(axis.name for axis in view.axes)
    rows = describe_count(told.rows, "row")
    rows += f", {told.failed} failed" if told.failed else ""
    held = view.tell_held()
    seeds = f", means over {view.seeds} seeds" if view.seeds > 1 else ""
    lines = [f"{rows}; {sides}{f' at {held}' if held else ''}{seeds}"]
    best: dict[int, list[str]] = {}
    for metric, one in zip(results.metrics, told.metrics, strict=True):
        borders = tl.sweep.find_borders(view, metric, limits)
        lines.append(_tell_metric(view, one, borders))
        if one.best is not None and not one.best.is_open:
            best.setdefault(one.best.row, []).append(one.id)
    ids = [one.id for one in told.metrics]
    first = next((ids.index(name) for name in _FIRST if name in ids), 0)
    lines.insert(0, f"{results.path}: {lines.pop(first + 1)}")
    lines = [console.fill_lines([line], indent=2) for line in lines]
    command, path = find_command_name(), shlex.quote(str(results.path))
    for row, names in best.items():
        again = f"{command} run --from {path} --row {row}"
        lines.append(f"best {join_words(names)}: {again}")
    return lines


def _tell_metric(view: "SweptView", one: MetricOfTable, borders: "Sequence[Border] | None") -> str:
    name, unit = one.id, one.unit
    missing = ", ".join(
        f"{describe_count(count, 'row')} {reason}" for reason, count in one.no_value.items()
    )
    tail = f"; no value: {missing}" if missing else ""
    if not one.values:
        return f"{name}: {tail.removeprefix('; ')}"
    if borders is not None:
        return f"{name}: {tl.sweep.tell_borders(borders)}{tail}"
    text = f"{name}: {format_number(one.least, unit)} to {format_number(one.most, unit)}"
    best = "" if one.best is None else _tell_best(view, one.best)
    if best and name.endswith(".overshoot") and one.best is not None and one.best.value < 0.0:
        best += "; below 0, the reference is never reached"
    return text + best + tail


def _tell_best(view: "SweptView", best: "BestRow") -> str:
    more = f" and {best.as_good - 1} more" if best.as_good > 1 else ""
    place = view.results.row_numbers.index(best.row)
    if best.others is None:
        return f", best in row {best.row}{more} ({view.results.tell_row(place)})"
    seeds = describe_count(view.seeds, "seed")
    if best.is_open:
        return f"; no clear best: over {seeds}, all differences of these means may be chance"
    axes = (*view.axes, *view.held)
    keys = ", ".join(axis.tell_keys(axis.places[place]) for axis in axes)
    text = f", best mean with {keys}{more} (seeds from row {best.row} on)"
    if best.within_chance:
        text += f"; {best.within_chance} of {best.others} worse means may be as good by chance"
    return text
