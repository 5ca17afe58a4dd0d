"""Metrics of several runs in figures, and strips: each run is a point, of many there is a box."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, LogLocator, NullFormatter, NullLocator

from turtlelog.charts.attribution_steps import choose_unit
from turtlelog.charts.curves import Values
from turtlelog.charts.many_runs import find_gain_unit
from turtlelog.charts.palette import UNSTABLE, to_hex
from turtlelog.compare.run_selection import has_one_gain, list_differing
from turtlelog.compare.run_summary import complete_parameters
from turtlelog.display import cut_name
from turtlelog.draw.figures.figure_curves import choose_colors
from turtlelog.draw.figures.page import fix_style
from turtlelog.draw.figures.placed_words import measure_text_mm
from turtlelog.errors import ShowError
from turtlelog.measure import Metric, choose_metrics, find_metric_kind, measure_run
from turtlelog.run import Parameter, Run

_MOST_GROUPS: Final = 12  # groups side by side; in a column, each group has 6 mm
_MOST_KEYS: Final = 2  # keys in the name of a group; more keys would have no room below it

_MOST_LETTERS: Final = 22

_BOX_FROM: Final = 10
"""Number of values from which quartiles are useful; of fewer, each is about one of the points."""

_HALF_WIDTH: Final = 0.17
"""Half the width of a group's points, as a share of the distance between groups."""

_PANEL_INCH: Final = 1.75
_NARROW_INCH: Final = 2.3
"""Smallest width of each of several panels [inch]; the groups have names below."""

_SIDE_INCH: Final = 0.65
"""Width of a panel for the numbers and the two lines next to its axis [inch]."""

_BOX: Final = fix_style(
    widths=0.26,
    manage_ticks=False,
    showfliers=False,
    patch_artist=True,
    medianprops={"color": "black", "linewidth": 1.2},
    whiskerprops={"linewidth": 0.7, "color": "0.35"},
    capprops={"linewidth": 0.7, "color": "0.35"},
)
_NONE: Final = to_hex(UNSTABLE)


@dataclass(frozen=True, slots=True, kw_only=True)
class MetricValues:
    """A metric of several runs."""

    id: str  # id of the metric
    label: str  # label of an axis, with the unit
    values: Values  # value of each run in this unit; NaN for a missing value

    @property
    def loop(self) -> str:
        """Name of the metric's loop; empty for the whole run."""
        loop = self.id.rpartition(".")[0]
        return "" if loop in {"final", "run"} else loop

    @property
    def name(self) -> str:
        """Name of the metric without its loop."""
        return self.id.rpartition(".")[2] if self.loop else self.id


@dataclass(frozen=True, slots=True, kw_only=True)
class RunGroups:
    """Runs in groups."""

    label: str  # differing quantity, for an axis
    names: tuple[str, ...]  # name of each group
    rows: tuple[tuple[int, ...], ...]  # indices of the runs of each group


def group_runs(runs: Sequence[Run]) -> RunGroups:
    """Return runs by gain, or by other differences except seeds; ShowError for too many groups."""
    keys = [key for key in list_differing(runs) if not key.endswith("seed")]
    gains = [key for run in runs for key in run.declaration.list_gains()]
    of_gain = [key for key in keys if key in gains]
    by = of_gain or keys
    more = len(by) - _MOST_KEYS
    if more > 0:
        by = ["law.kind"] if "law.kind" in keys else by[:_MOST_KEYS]
        more = len(keys) - len(by)
    known = [complete_parameters(run) for run in runs]
    cells = [tuple(parameters.get(key) for key in by) for parameters in known]
    is_one_gain = bool(of_gain) and all(has_one_gain(run) for run in runs)
    if is_one_gain:
        by, cells = ["Kp"], [cell[:1] for cell in cells]
    found: dict[tuple[Parameter | None, ...], list[int]] = {}
    for row, cell in enumerate(cells):
        found.setdefault(cell, []).append(row)
    # A key has the unit of a gain; other keys contain their unit.
    units = [find_gain_unit(runs, key) for key in by]
    named = [
        f"{key.rpartition('.')[2]}{f' [{unit}]' if unit else ''}"
        for key, unit in zip(by, units, strict=True)
    ]
    label = "Kp [1/s]" if is_one_gain else ", ".join(named)
    if more > 0 and not is_one_gain:
        label += f" ({more} more keys differ)"
    if len(found) > _MOST_GROUPS:
        raise ShowError(
            f"figure strips: expected at most {_MOST_GROUPS} groups, found {len(found)} by"
            f" {label or 'what differs'}; the figure gains draws metrics against gains"
        )

    def tell(value: Parameter | None) -> str:
        told = f"{value:g}" if isinstance(value, float) else str(value).replace("_", " ")
        return "unknown" if value is None else told

    order = sorted(found, key=lambda cell: [*map(_rank, cell)])
    return RunGroups(
        label=label,
        names=tuple(cut_name(", ".join(map(tell, cell)), _MOST_LETTERS) for cell in order),
        rows=tuple(tuple(found[cell]) for cell in order),
    )


def _rank(value: Parameter | None) -> tuple[int, float, str]:
    if isinstance(value, int | float):
        return (0, float(value), "")
    return (1 + (value is None), 0.0, str(value))


def draw_strips(
    figure: Figure, runs: Sequence[Run], *, metrics: Sequence[str] | None = None
) -> None:
    """Draw a panel for each metric: runs of each group as points, with a box if there are many.

    The metrics are as in `measure_for_figure`. Too many groups are refused.
    """
    groups = group_runs(runs)
    found = measure_for_figure("strips", runs, metrics)
    width = figure.get_figwidth()
    most, widest = max(1, int(width / _NARROW_INCH)), _measure_widest(_name_groups(groups))
    most = min(len(found), most)
    # Fewer columns if names would be slanted.
    fitting = (n for n in range(most, 0, -1) if widest <= _find_room(groups, width / n))
    columns = next(fitting, most)
    rows = -(-len(found) // columns)
    figure.set_size_inches(width, rows * _PANEL_INCH + 0.2)
    grid = figure.subplots(rows, columns, squeeze=False)
    for axes in grid.flat[len(found) :]:
        axes.remove()
    room_mm = _find_room(groups, width / columns)
    for number, (axes, one) in enumerate(zip(grid.flat, found, strict=False)):
        _draw_strip(axes, groups, one, room_mm)
        axes.tick_params(labelbottom=number + columns >= len(found))
        if number + columns >= len(found):
            axes.set_xlabel("; ".join(filter(None, [groups.label, _tell_sizes(groups)])))
    figure.align_ylabels()


def _find_room(groups: RunGroups, panel_inch: float) -> float:
    """Return the width for a group's name below a panel [mm]."""
    return 0.95 * 25.4 * (panel_inch - _SIDE_INCH) / len(groups.names)


def _measure_widest(names: Sequence[str]) -> float:
    return max(measure_text_mm(line) for name in names for line in name.split("\n"))


def _name_groups(groups: RunGroups) -> list[str]:
    """Return names below a panel, with the number of runs unless all groups are equal in size."""
    if _tell_sizes(groups):
        return [*groups.names]
    named = zip(groups.names, groups.rows, strict=True)
    return [f"{name}\nn = {len(rows)}".lstrip("\n") for name, rows in named]


def _tell_sizes(groups: RunGroups) -> str:
    sizes = {len(rows) for rows in groups.rows}
    if len(sizes) > 1 or len(groups.rows) == 1:
        return ""
    (size,) = sizes
    return "one run each" if size == 1 else f"n = {size} each"


def _draw_strip(axes: Axes, groups: RunGroups, found: MetricValues, room_mm: float) -> None:
    set_value_scale(axes, found)
    is_boxed = any(np.isfinite(found.values[list(rows)]).sum() >= _BOX_FROM for rows in groups.rows)
    colors = choose_colors(len(groups.rows))
    for place, (rows, color) in enumerate(zip(groups.rows, colors, strict=True)):
        values = found.values[list(rows)]
        known = values[np.isfinite(values)]
        _draw_group(axes, place, known, color, is_boxed=is_boxed)
        if len(known) < len(values):
            count = f"{len(values) - len(known)} without"
            text = axes.text(place, 0.99, count, fontsize=6.0, color=_NONE, ha="center", va="top")
            text.set_transform(axes.get_xaxis_transform())
    names = _name_groups(groups)
    if _measure_widest(names) > room_mm:
        axes.set_xticks(range(len(names)), [name.replace("\n", ", ") for name in names])
        axes.tick_params(axis="x", labelrotation=35.0)
        for text in axes.get_xticklabels():
            text.set(ha="right", rotation_mode="anchor")
    else:
        axes.set_xticks(range(len(names)), names)
    axes.set_xlim(-0.6, len(names) - 0.4)
    axes.grid(visible=False, axis="x")
    axes.set_ylabel(f"{found.loop}:\n{found.label}" if found.loop else found.label)


def _draw_group(axes: Axes, place: int, known: Values, color: Any, *, is_boxed: bool) -> None:
    """Draw a group's values, spread sideways if there are many, and a box or the median."""
    if not len(known):
        return
    beside = 0.2 if is_boxed else 0.0
    across = place + beside + _spread(known)
    size = (5.0, 3.6, 2.4, 1.5)[sum(len(known) > most for most in (1, 40, 200))]
    faint = 0.9 if len(known) <= 40 else 0.55
    axes.plot(across, known, "o", ms=size, mew=0.0, color=color, alpha=faint, zorder=2.5)
    if len(known) >= _BOX_FROM:
        for patch in axes.boxplot([known], positions=[place - 0.2], **_BOX)["boxes"]:
            patch.set(facecolor=(*color, 0.35), edgecolor=color, linewidth=0.8)
    elif len(known) > 2:
        median, half = float(np.median(known)), _HALF_WIDTH + 0.06
        ends = [place + beside - half, place + beside + half]
        axes.plot(ends, [median, median], color="black", lw=1.0, zorder=2.4)


def _spread(values: Values) -> Values:
    """Return sideways offsets of points, so that close values do not hide each other."""
    if len(values) < 3:
        return np.zeros(len(values))
    # By the golden ratio, neighbouring values are far apart, and equal runs give equal pictures.
    ranks = np.argsort(np.argsort(values, kind="stable"), kind="stable")
    golden = (np.sqrt(5.0) - 1.0) / 2.0
    return np.asarray(_HALF_WIDTH * (2.0 * ((ranks * golden) % 1.0) - 1.0))


USUAL: Final = ("*.overshoot", "*.settling_time", "final.position_error")
OF_TRACKING: Final = ("*.rms_error", "*.largest_error")
"""Default metrics if no loop responds to a step: errors of loops with a moving reference."""

_LOGARITHMIC: Final = 30.0
"""Ratio from which a scale is logarithmic: on 30 mm, the smallest value is within 1 mm of 0."""

_LEAST_PERCENT: Final = 0.5
"""Smallest height of an axis [%]; below, last digits would look like an overshoot."""

_LETTER_WIDTH: Final = 0.65
"""Width of a digit as a share of the font size. DejaVu Sans, the widest font in use, has 0.636."""


def measure_for_figure(
    figure: str, runs: Sequence[Run], names: Sequence[str] | None
) -> list[MetricValues]:
    """Return metrics with a value in at least one run; ShowError, with a reason, if there are none.

    The names are ids, patterns, or names of metrics of any loop (`overshoot`); by default the usual
    metrics.
    """
    for patterns in [[*map(complete_name, names)]] if names else [USUAL, OF_TRACKING]:
        chosen = [choose_metrics(patterns, run.declaration) for run in runs]
        measured = [measure_run(run, only=only) for run, only in zip(runs, chosen, strict=True)]
        ids = dict.fromkeys(name for metrics in measured for name in metrics)
        built = [_build(name, [one.get(name) for one in measured]) for name in ids]
        found = [one for one in built if one is not None]
        if found:
            break
    else:
        reasons = [one.reason for metrics in measured for one in metrics.values() if one.reason]
        reason = f": {reasons[0]}" if reasons else ""
        wanted = ", ".join(names or USUAL)
        raise ShowError(f"figure {figure} needs a value of {wanted}{reason}")
    return found


def complete_name(name: str) -> str:
    """Return an id or pattern unchanged, and `overshoot` as the overshoot of any loop."""
    is_bare = "." not in name and find_metric_kind(name) is None
    return f"*.{name}" if is_bare else name


def _build(name: str, metrics: Sequence[Metric | None]) -> MetricValues | None:
    values = np.array(
        [np.nan if one is None or one.value is None else one.value for one in metrics]
    )
    known = ~np.isnan(values)
    if not known.any():
        return None
    measured = next(one for one in metrics if one is not None and one.value is not None)
    factor, unit = choose_unit(float(np.abs(values[known]).max()), measured.unit)
    loop, _, last = name.rpartition(".")
    words = last if loop != "final" or last.startswith("final") else f"final {last}"
    label = words.replace("_", " ") + (f" [{unit}]" if unit else "")
    return MetricValues(id=name, label=label, values=factor * values)


def set_value_scale(axes: Axes, found: MetricValues) -> None:
    """Set the scale of an axis for a metric, with room for its values."""
    known = found.values[np.isfinite(found.values)]
    low, high = float(known.min()), float(known.max())
    if 0.0 < _LOGARITHMIC * low < high:
        axes.set_yscale("log")
        axes.set_ylim(low / 1.6, high * 1.9)
        few = high < 100.0 * low
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if few else (1.0,)))
        axes.yaxis.set_major_formatter("{x:g}")
        axes.yaxis.set_minor_formatter(NullFormatter())
        return
    if found.label.endswith("[%]"):
        high = max(high, low + _LEAST_PERCENT, _LEAST_PERCENT)
    # The room is a share of the axis, which includes 0; nearly equal values would be at the edge.
    room = 0.14 * (max(high, 0.0) - min(low, 0.0)) or 1.0
    axes.set_ylim(min(low - room, 0.0), max(high + room, 0.0))


def set_ticks_at(axes: Axes, values: Sequence[float]) -> None:
    """Place ticks at the smallest and largest values, and between them where labels have room."""
    values = sorted({*values})
    points = axes.get_xaxis_transform().transform([(value, 0.0) for value in values])[:, 0]
    points = points * 72.0 / axes.figure.dpi
    size: Any = axes.xaxis.get_major_ticks()[0].label1.get_fontsize()
    halves = [_LETTER_WIDTH * size * (len(f"{value:.4g}") + 1) / 2.0 for value in values]
    last = len(values) - 1
    chosen: list[int] = []
    for row in [0, last, *range(1, last)]:
        if all(abs(points[row] - points[one]) >= halves[row] + halves[one] for one in chosen):
            chosen.append(row)
    axes.xaxis.set_major_locator(FixedLocator([values[row] for row in sorted(chosen)]))
    axes.xaxis.set_minor_locator(NullLocator())
    formatter: Any = "{x:.4g}"
    axes.xaxis.set_major_formatter(formatter)
