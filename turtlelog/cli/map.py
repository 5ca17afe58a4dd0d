"""`turtlelog plot TABLE`: maps, curves and sensitivities of a sweep."""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import turtlelog as tl
from turtlelog.cli.output import (
    copy_fields,
    fill_lines,
    find_command_name,
    list_written,
    print_json,
    print_note,
    print_text,
)
from turtlelog.cli.picture_options import PageOptions
from turtlelog.cli.progress import show_progress
from turtlelog.cli.targets import PICTURES, require_new_target
from turtlelog.display import describe_count, format_number, join_words
from turtlelog.errors import UsageError

if TYPE_CHECKING:
    from turtlelog.cli.plot import Kind, ViewOptions
    from turtlelog.sweep import (
        Border,
        LoopLimits,
        Sensitivities,
        Sensitivity,
        SweptAxis,
        SweptMetric,
        SweptView,
    )


def draw_table(
    table: Path,
    output: Path | None,
    view: "ViewOptions",
    where: PageOptions,
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
            _write(shown, limits, output, kind, where, words)
    _answer(shown, limits, output, kind, json=json)


def _require_output(output: Path | None, table: Path, kind: str, where: PageOptions) -> None:
    """Refuse an output that cannot be written."""
    suffix = "" if output is None else output.suffix.lower()
    if suffix == ".rrd":
        need = "view shows the recordings of rows, which sweep --record keeps"
        raise UsageError(f"--output {output}: a table becomes a figure or a report (.html); {need}")
    if suffix not in PICTURES and where != PageOptions():
        raise UsageError("--for, --text-width and --dpi need a figure to write: -o NAME.png")
    if output is None:
        return
    if suffix not in {*PICTURES, ".html"}:
        expected = "a name that ends in .pdf, .png, .svg or .html"
        raise UsageError(f"--output {output}: must be {expected}")
    if suffix == ".html" and kind != "map":
        raise UsageError(
            f"--kind {kind}: {output} is no figure; end its name in .pdf, .png or .svg"
        )
    require_new_target(output, [table], suffix=suffix)


def _write(
    view: "SweptView",
    limits: "list[LoopLimits]",
    output: Path,
    kind: "Kind",
    where: PageOptions,
    words: Sequence[str],
) -> None:
    suffix = output.suffix.lower()
    if suffix == ".html":
        command = ["turtlelog", "plot", str(view.results.path), *words, "-o", str(output)]
        tl.draw.write_map_report(view, limits, output, command=shlex.join(command))
    else:
        page = where.build_page([suffix[1:]], None, usual="page")
        tl.draw.write_map_figure(view, limits, output, kind=kind, page=page)


def _answer(
    view: "SweptView", limits: "list[LoopLimits]", output: Path | None, kind: str, *, json: bool
) -> None:
    told = build_map_answer(view, limits, output)
    for note in told.notes:
        print_note(f"plot: {note}")
    if json:
        print_json(told)
        return
    lines = list_map_lines(view, limits, told)
    if kind == "tornado":
        lines = [lines[0], *list_sensitivity_lines(view)]
    lines = [line if " run --from " in line else fill_lines([line], indent=2) for line in lines]
    print_text("\n".join([*lines, *list_written([] if output is None else [output])]))


@dataclass(frozen=True, slots=True, kw_only=True)
class SweptAxisAnswer:
    """Keys that vary together, with their values."""

    keys: list[str]
    unit: str | None
    values: list[list[Any]]


@dataclass(frozen=True, slots=True, kw_only=True)
class BestRow:
    """The best row of a metric: number, value and keys; `as_good` counts equally good rows."""

    row: int
    value: float
    as_good: int
    keys: Mapping[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class BorderAnswer:
    """Border of stability along a gain, with theory's limit."""

    at: list[Any] | None
    last_stable: float | None
    first_unstable: float | None
    theory: float | None
    within_one_cell: bool | None


@dataclass(frozen=True, slots=True, kw_only=True)
class KeySensitivity:
    """Range of a metric along one key alone."""

    keys: list[str]
    least: float | None
    most: float | None
    at_least: list[Any] | None
    at_most: list[Any] | None
    correlation: float | None
    left_out: int
    range_elsewhere: list[float] | None


@dataclass(frozen=True, slots=True, kw_only=True)
class SensitivityAnswer:
    """Ranges of a metric along each key, and its value in the middle."""

    held: Mapping[str, Any] | str | None
    value: float | None
    chance: float | None
    explained: float | None
    keys: list[KeySensitivity]
    notes: list[str]


@dataclass(frozen=True, slots=True, kw_only=True)
class MetricOfTable:
    """A metric over the shown rows."""

    id: str
    unit: str
    values: int
    least: float | None
    most: float | None
    no_value: Mapping[str, int]
    best: BestRow | None
    borders: list[BorderAnswer] | None
    sensitivities: SensitivityAnswer


@dataclass(frozen=True, slots=True, kw_only=True)
class LimitsAt:
    """Limits from theory at values of the other key."""

    at: list[Any] | None
    limits: Any


@dataclass(frozen=True, slots=True, kw_only=True)
class LimitsAnswer:
    """Limits from theory for a loop's gain."""

    loop: str
    gain: list[str]
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
        axes=[
            copy_fields(SweptAxisAnswer, axis, keys=[*axis.keys], values=[*map(list, axis.values)])
            for axis in view.axes
        ],
        held=_name_values(view.held),
        seeds=view.seeds,
        metrics=[_describe_metric(view, metric, limits) for metric in results.metrics],
        theory=[_describe_limits(view, one) for one in limits],
        notes=notes,
        output=None if output is None else str(output),
    )


def _describe_limits(view: "SweptView", limits: "LoopLimits") -> LimitsAnswer:
    other = _find_other(view, limits)
    return LimitsAnswer(
        loop=limits.loop,
        gain=list(limits.gain.keys),
        columns=[
            LimitsAt(at=_find_values(other, place), limits=tl.sweep.describe_limits(limit))
            for place, limit in enumerate(limits.columns)
        ],
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
    reasons: dict[str, int] = {}
    for row in view.rows[~np.isfinite(metric.values[view.rows])].tolist():
        reason = str(metric.reasons[row])
        reasons[reason] = reasons.get(reason, 0) + 1
    return MetricOfTable(
        id=metric.name,
        unit=metric.unit,
        values=len(known),
        least=float(known.min()) if len(known) else None,
        most=float(known.max()) if len(known) else None,
        no_value=reasons,
        best=_describe_best(view, metric),
        borders=_describe_borders(view, metric, limits),
        sensitivities=_describe_sensitivities(
            tl.sweep.find_sensitivities(view.results, metric, dict(view.held))
        ),
    )


def _describe_sensitivities(found: "Sensitivities") -> SensitivityAnswer:
    return SensitivityAnswer(
        held=found.held or None,
        value=found.center,
        chance=found.chance,
        explained=found.explained,
        keys=[
            copy_fields(
                KeySensitivity,
                one,
                keys=list(one.axis.keys),
                at_least=_find_values(one.axis, one.least_place),
                at_most=_find_values(one.axis, one.most_place),
                range_elsewhere=one.others and list(one.others),
            )
            for one in found.keys
        ],
        notes=list(found.notes),
    )


def _find_values(axis: "SweptAxis | None", place: int | None) -> list[Any] | None:
    return None if axis is None or place is None else list(axis.values[place])


def _name_values(places: "Mapping[SweptAxis, int]") -> dict[str, Any]:
    """Return the value of each key of the axes."""
    return {
        key: value
        for axis, place in places.items()
        for key, value in zip(axis.keys, axis.values[place], strict=True)
    }


def list_sensitivity_lines(view: "SweptView") -> list[str]:
    """Return sentences on the change of each metric along each key."""
    lines = []
    for metric in view.results.metrics:
        found = tl.sweep.find_sensitivities(view.results, metric, dict(view.held))
        lines += [f"{metric.name}: {_tell_sensitivity(metric, one)}" for one in found.keys]
        lines += found.notes
    return lines


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


def _describe_best(view: "SweptView", metric: "SweptMetric") -> BestRow | None:
    """Return the best shown row; of several equally good rows, the first."""
    found = tl.sweep.find_best_rows(view, metric)
    if not found:
        return None
    row = found[0]
    rows, values = tl.sweep.list_shown_values(view, metric)
    return BestRow(
        row=view.results.row_numbers[row],
        value=float(values[rows == row][0]),
        as_good=len(found),
        keys=_name_values({axis: axis.places[row] for axis in view.results.axes}),
    )


def _describe_borders(
    view: "SweptView", metric: "SweptMetric", limits: "Sequence[LoopLimits]"
) -> list[BorderAnswer] | None:
    borders = tl.sweep.find_borders(view, metric, limits)
    own = next((one for one in limits if one.loop == metric.loop), None)
    if borders is None or own is None:
        return None
    other = _find_other(view, own)
    return [
        copy_fields(
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
        if one.best is not None:
            best.setdefault(one.best.row, []).append(one.id)
    ids = [one.id for one in told.metrics]
    first = next((ids.index(name) for name in _FIRST if name in ids), 0)
    lines.insert(0, f"{results.path}: {lines.pop(first + 1)}")
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
    best = one.best
    if best is not None:
        more = best.as_good - 1
        text += f", best in row {best.row}" + (f" and {more} more" if more else "")
        place = view.results.row_numbers.index(best.row)
        text += f" ({view.results.tell_row(place)})"
    return text + tail
