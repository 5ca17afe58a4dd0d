"""Curves of figures, of runs (thinned) and of theory alone, and the legend that names them."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle
from math import ceil
from typing import Any, Final

import numpy as np
from matplotlib import rcParams
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.lines import Line2D
from matplotlib.textpath import text_to_path
from numpy.typing import NDArray

from turtlelog import theory
from turtlelog.charts import curves
from turtlelog.charts.many_runs import find_color_scale
from turtlelog.charts.palette import FEW, LOOP_DASHES
from turtlelog.draw.figures import page, run_styles
from turtlelog.run import Run

_MOST_SWINGS: Final = 8.0
"""Largest path of a curve up and down, relative to its height. Along a longer path, the marks would
hide the curve."""

_RING_POINTS: Final = 2.4
"""Half the width of rings, for poles of several loops at one place [points]."""
_MOST_RINGS: Final = 4
_LARGER: Final = 1.0
"""Additional size of poles over the markers of curves [points]."""

PAPER_GAINS: Final = (1.0, 2.0, 4.0, 10.0)
_LAST_S: Final = 5.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pole:
    """The poles of a closed loop, drawn as dots."""

    values: NDArray[np.complex128]  # poles in the s plane [1/s] or the z plane, shape (n,)
    looks: Mapping[str, Any]  # colour and marker of the run
    label: str  # label in the legend


def draw_curve(axes: Axes, curve: curves.Curve, **looks: Any) -> None:
    """Draw a curve, as steps if its values are held. A long curve is thinned."""
    drawstyle = "steps-post" if curve.holds else "default"
    draw_thinned(axes, curve.time_s, curve.values, curve.values, drawstyle=drawstyle, **looks)


def draw_thinned(
    axes: Axes, across: curves.Values, up: curves.Values, kept: curves.Values, **looks: Any
) -> None:
    """Draw a line. If points are left out, extremes of `kept` remain and a note is added."""
    across, up = _thin(axes, across, up, kept)
    if len(up) == 1:  # a line needs two points
        looks |= {"marker": "o", "ms": 3.0, "markevery": None}
    if "markevery" in looks:
        looks["markevery"] = _space_marks(up, looks["markevery"])
    axes.plot(across, up, **looks)


def _space_marks(up: curves.Values, every: Any) -> Any:
    """Return the positions of marks on a curve: along its length, or by rows if it oscillates."""
    known = up[np.isfinite(up)]
    if every is None or np.abs(np.diff(known)).sum() <= _MOST_SWINGS * np.ptp(known):
        return every
    first, apart = (math.ceil(share * len(up)) for share in every)
    return first, apart


def draw_points(axes: Axes, across: curves.Values, up: curves.Values, **looks: Any) -> None:
    """Draw points without a joining line, thinned like lines."""
    across, up = _thin(axes, across, up, up)
    axes.plot(across, up, **looks)


def _thin(
    axes: Axes, across: curves.Values, up: curves.Values, kept: curves.Values
) -> tuple[curves.Values, curves.Values]:
    rows = curves.choose_rows(kept)
    if rows is None:
        return across, up
    note = f"curves of over {curves.MOST_POINTS:,} points are\nthinned for drawing, extremes kept"
    axes.figure.supxlabel(note, fontsize=7.0, color="0.4")
    return across[rows], up[rows]


def draw_level(axes: Axes, levels: Sequence[float], **looks: Any) -> None:
    """Draw level lines with one label."""
    for index, level in enumerate(levels):
        shown = dict(looks)
        if index:
            shown.pop("label", None)
        axes.axhline(level, zorder=1.5, **shown)


def draw_plant_responses(figure: Figure, runs: Sequence[Run]) -> None:  # noqa: ARG001
    """Draw the response of the plant 1/s to an impulse, a step and a ramp."""
    time_s = np.linspace(0.0, _LAST_S, 201)
    for axes, kind in zip(figure.subplots(1, 3), theory.PLANT_INPUTS, strict=True):
        axes.plot(
            time_s, theory.compute_plant_response(kind, time_s), **run_styles.choose_lines(1)[0]
        )
        end = "unbounded" if theory.find_plant_final_value(kind).value is None else "bounded"
        axes.set(xlabel="time [s]", title=f"{kind}: {end}", xlim=(0.0, _LAST_S), ylim=(0.0, None))
    figure.axes[0].set(ylabel="response of 1/s", ylim=(0.0, 1.25))


def draw_step_responses(figure: Figure, runs: Sequence[Run]) -> None:
    """Draw the closed loop's step response for each gain, with the 2 % band and 4 tau marked."""
    axes, gains = figure.subplots(), find_gains(runs)
    last_s = 1.25 * theory.compute_settling_time(min(gains))
    time_s = np.linspace(0.0, last_s, 601)
    axes.axhspan(0.98, 1.02, color="0.92", zorder=0.5, label="2 % band")
    axes.axhline(1.0, **page.REFERENCE)
    names = name_some(axes, [f"Kp = {gain:g}" for gain in gains])
    styled = (
        _style_gains(runs)
        if runs
        else dict(zip(gains, run_styles.choose_lines(len(gains)), strict=True))
    )
    for gain, name in zip(gains, names, strict=True):
        looks = styled[gain]
        values = theory.compute_closed_loop_response(gain, time_s)
        axes.plot(time_s, values, label=name, **looks)
        settled_s = theory.compute_settling_time(gain)
        level = theory.compute_closed_loop_response(gain, [0.0, settled_s])[-1]
        axes.plot(settled_s, level, "o", ms=3.5, color=looks["color"])
    axes.plot([], [], "o", ms=3.5, color="0.35", label="4 τ")
    axes.set(xlabel="time [s]", ylabel="response to a unit step", xlim=(0.0, last_s), ylim=(0, 1.1))


def _style_gains(runs: Sequence[Run]) -> dict[float, Mapping[str, Any]]:
    """Return the style of each gain: the colour of its first run, and dashes for others."""
    styled: dict[float, Mapping[str, Any]] = {}
    for run, looks in zip(runs, run_styles.choose_run_lines(runs), strict=True):
        for gain, dash in zip(find_gains([run]), cycle(LOOP_DASHES), strict=False):
            styled.setdefault(gain, {**looks, "linestyle": page.STROKES[dash]})
    return styled


def draw_ideal_locus(axes: Axes, poles: Sequence[Pole]) -> None:
    """Draw the poles s = -Kp of the ideal closed loops, from the plant's pole at 0 to the left."""
    left = 1.25 * min(float(pole.values.real.min()) for pole in poles)
    axes.axvspan(0.0, -0.24 * left, color="0.94", zorder=0.5)
    axes.text(-0.12 * left, 0.6, "unstable", ha="center", fontsize=7.0, color="0.4")
    branch = theory.compute_root_locus([0.0, -left])
    axes.plot(branch.real, branch.imag, color="0.3", label="s = -Kp")
    axes.plot([0.0], [0.0], "x", color="black", ms=6.0, mew=1.4, label="pole of 1/s", zorder=3)
    draw_poles(axes, poles)
    axes.set(xlabel="real part [1/s]", ylabel="imaginary part [1/s]", xlim=(left, -0.24 * left))
    axes.set_ylim(-1.0, 1.0)


def list_paper_poles() -> list[Pole]:
    """Return the poles of the ideal loops for the gains of the paper."""
    styled = zip(PAPER_GAINS, run_styles.choose_lines(len(PAPER_GAINS)), strict=True)
    return [
        Pole(values=theory.compute_root_locus([kp]), looks=looks, label=f"Kp = {kp:g}")
        for kp, looks in styled
    ]


def draw_poles(axes: Axes, poles: Sequence[Pole]) -> None:
    """Draw poles. Of equal poles, the first are larger discs below the others."""
    for number, pole in enumerate(poles):
        later = sum(np.array_equal(pole.values, other.values) for other in poles[number + 1 :])
        looks = {"marker": "o", "ms": 4.5, **pole.looks, "markevery": None, "linestyle": ""}
        looks["ms"] += _LARGER + _RING_POINTS * min(later, _MOST_RINGS)
        looks["zorder"] = 2.9 - 0.001 * later
        axes.plot(pole.values.real, pole.values.imag, label=pole.label, **looks)


def find_gains(runs: Sequence[Run]) -> tuple[float, ...]:
    """Return the gains of loops known to theory, increasing; without runs, the paper's gains."""
    if not runs:
        return PAPER_GAINS
    found = {
        loop.read_gain(run.parameters)
        for run in runs
        for loop in run.declaration.loops
        if loop.has_theory
    }
    return tuple(sorted(gain for gain in found if gain is not None))


_LINE_HEIGHT: Final = 1.45
_POINTS_PER_INCH: Final = 72.0

_OF_ALL_RUNS: Final = frozenset({"ideal", page.IDEAL_ENDS, curves.REFERENCE, curves.BEARING_NOW})
"""Labels of lines that have each run's colour, and are therefore colourless in a legend."""

_ALIKE: Final = (
    ("goal bearing", "goal heading", "goal", "zero"),
    ("tolerance", "limit"),
    ("applied", "|applied|"),
)
"""Labels that share a style in different panels; each panel shows its own label."""

_CURVES: Final = 2.0
"""Order in which matplotlib draws lines by default; references are below."""

_MOST_NAMED: Final = 12
"""Largest number of theoretical lines with an entry each: six rows of two entries in a column."""
_SOME: Final = 7
"""Number of entries if there are more lines, in even steps. Colours identify the lines in
between."""


def add_legend(figure: Figure, without: Collection[str] = ()) -> None:
    """Add a legend above the panels, which makes the figure higher.

    Labels shown elsewhere are left out. If nothing else is left out, a single entry is left out
    too. Curves come first; curves with the same style in several panels share an entry.
    """
    named: dict[tuple[str, bool], Any] = {}
    for axes in figure.axes:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            if label not in without:
                # A goal is a cross in the plane, and a line over time.
                is_mark = isinstance(handle, Line2D) and handle.get_linestyle() == "None"
                named.setdefault((label, is_mark), handle)
    if len(named) < 2 and not (named and without):
        return
    labels, handles = zip(*_join_alike(named), strict=True)
    width, height = figure.get_size_inches()
    columns = count_legend_columns(labels, width * _POINTS_PER_INCH)
    lines = ceil(len(labels) / columns)
    line_points = _LINE_HEIGHT * rcParams["legend.fontsize"]
    figure.set_size_inches(width, height + (lines + 0.5) * line_points / _POINTS_PER_INCH)
    legend = figure.legend(
        handles,
        labels,
        loc="outside upper center",
        ncols=ceil(len(labels) / lines),
    )
    for label, entry in zip(labels, legend.legend_handles, strict=True):
        if label in _OF_ALL_RUNS and entry is not None:
            entry.set(color="0.35")


def name_some(axes: Axes, labels: Sequence[str]) -> list[str | None]:
    """Return labels of lines for a legend. Of many lines, only some, with a note in the legend."""
    if len(labels) <= _MOST_NAMED:
        return list(labels)
    shown = {*np.linspace(0, len(labels) - 1, _SOME).round().astype(int).tolist()}
    axes.plot([], [], " ", zorder=0.0, label=f"{len(shown)} of {len(labels)} are named")
    return [label if number in shown else None for number, label in enumerate(labels)]


def _join_alike(named: Mapping[tuple[str, bool], Any]) -> list[tuple[str, Any]]:
    """Return the entries of a legend: curves first, then the layers below them."""
    groups: dict[Any, list[tuple[str, bool]]] = {}
    for key in sorted(named, key=lambda key: named[key].get_zorder() < _CURVES):
        groups.setdefault(_describe_looks(key[0], named[key]), []).append(key)
    return [(", ".join(label for label, _ in keys), named[keys[0]]) for keys in groups.values()]


def _describe_looks(label: str, handle: Any) -> Any:
    """Return the key that merged entries share: the style, and for dashed lines also the name."""
    if not isinstance(handle, Line2D):
        return label
    alike = next((names for names in _ALIKE if label in names), label)
    if handle.get_linestyle() == "-":
        alike = ""
    return (alike, handle.get_color(), handle.get_linewidth(), handle.get_marker())


def count_legend_columns(labels: Sequence[str], width_points: float) -> int:
    """Return the number of legend columns that fit, each as wide as the widest entry."""
    size = rcParams["legend.fontsize"]
    font = FontProperties(family=rcParams["font.family"], size=size)
    widest = max(
        text_to_path.get_text_width_height_descent(label, font, ismath=False)[0] for label in labels
    )
    around = ("handlelength", "handletextpad", "columnspacing")
    entry_points = widest + size * sum(rcParams[f"legend.{name}"] for name in around)
    return min(len(labels), max(1, int(width_points / entry_points)))


_BAR_INCH: Final = 0.42
"""Height of a bar with its numbers and its name [inch]."""
_MOST_TICKS: Final = 7
"""Largest number of labels with three digits that fit a column."""


def add_gain_bar(figure: Figure, runs: Sequence[Run]) -> frozenset[str]:
    """Add a colour bar if a figure has more runs than distinct hues.

    Returns:
        Labels in the bar, which the legend need not repeat.
    """
    names = run_styles.label_runs(runs)
    named = [{*names} & {*axes.get_legend_handles_labels()[1]} for axes in figure.axes]
    if len(runs) <= len(FEW) or all(len(found) <= len(FEW) for found in named):
        return frozenset()
    count = len(runs)
    colors = ListedColormap(run_styles.color_runs(runs))
    norm = BoundaryNorm(np.arange(count + 1) - 0.5, count)
    width, height = figure.get_size_inches()
    figure.set_size_inches(width, height + _BAR_INCH)
    bar = figure.colorbar(
        ScalarMappable(norm, colors),
        ax=figure.axes,
        location="top",
        fraction=0.04,
        aspect=width / 0.09,
        pad=0.02,
    )
    bar.outline.set_visible(False)
    bar.ax.minorticks_off()
    scale = find_color_scale(runs)
    if scale is None:
        bar.set_ticks([])
        bar.set_label(f"{count} runs, from {names[0]} to {names[-1]}")
    else:
        places, labels = zip(*scale.list_ticks(_MOST_TICKS), strict=True)
        bar.set_ticks(places, labels=labels)
        bar.set_label(f"{scale.word} of {count} runs{f' [{scale.unit}]' if scale.unit else ''}")
    return frozenset(names)
