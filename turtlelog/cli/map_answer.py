"""Text of `turtlelog plot` on a sweep: best rows, and borders compared with theory."""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import turtlelog as tl
from turtlelog.cli.output import find_command_name
from turtlelog.display import describe_count, format_number, join_words

if TYPE_CHECKING:
    from turtlelog.sweep import (
        Border,
        LoopLimits,
        Sensitivities,
        Sensitivity,
        SweptAxis,
        SweptMetric,
        SweptView,
    )


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
        axes=[_describe_axis(axis) for axis in view.axes],
        held={
            key: value
            for axis, place in view.held.items()
            for key, value in zip(axis.keys, axis.values[place], strict=True)
        },
        seeds=view.seeds,
        metrics=[_describe_metric(view, metric, limits) for metric in results.metrics],
        theory=[_describe_limits(view, one) for one in limits],
        notes=notes,
        output=None if output is None else str(output),
    )


def _describe_axis(axis: Any) -> SweptAxisAnswer:
    return SweptAxisAnswer(
        keys=list(axis.keys), unit=axis.unit, values=[list(v) for v in axis.values]
    )


def _describe_limits(view: "SweptView", limits: "LoopLimits") -> LimitsAnswer:
    other = next((axis for axis in view.axes if axis is not limits.gain), None)
    return LimitsAnswer(
        loop=limits.loop,
        gain=list(limits.gain.keys),
        columns=[
            LimitsAt(
                at=None if other is None else list(other.values[place]),
                limits=tl.sweep.describe_limits(limit),
            )
            for place, limit in enumerate(limits.columns)
        ],
    )


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
            KeySensitivity(
                keys=list(one.axis.keys),
                least=one.least,
                most=one.most,
                at_least=_find_values(one.axis, one.least_place),
                at_most=_find_values(one.axis, one.most_place),
                correlation=one.correlation,
                left_out=one.left_out,
                range_elsewhere=one.others and list(one.others),
            )
            for one in found.keys
        ],
        notes=list(found.notes),
    )


def _find_values(axis: "SweptAxis", place: int | None) -> list[Any] | None:
    return None if place is None else list(axis.values[place])


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
    row, axes = found[0], view.results.axes
    rows, values = tl.sweep.list_shown_values(view, metric)
    return BestRow(
        row=view.results.row_numbers[row],
        value=float(values[rows == row][0]),
        as_good=len(found),
        keys={
            key: value
            for axis in axes
            for key, value in zip(axis.keys, axis.values[axis.places[row]], strict=True)
        },
    )


def _describe_borders(
    view: "SweptView", metric: "SweptMetric", limits: "Sequence[LoopLimits]"
) -> list[BorderAnswer] | None:
    borders = tl.sweep.find_borders(view, metric, limits)
    own = next((one for one in limits if one.loop == metric.loop), None)
    if borders is None or own is None:
        return None
    other = next((axis for axis in view.axes if axis is not own.gain), None)
    return [
        BorderAnswer(
            at=None if other is None else list(other.values[border.place]),
            last_stable=border.last_stable,
            first_unstable=border.first_unstable,
            theory=border.theory,
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
