"""Metrics against the gain, with theory's limits for the dead times of the runs."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from turtlelog import theory
from turtlelog.charts.curves import Values, find_steps
from turtlelog.charts.many_runs import cut_alike
from turtlelog.charts.palette import OVERSHOOT, OVERSHOOTING, UNSTABLE, to_hex
from turtlelog.draw.figures import strip_figure
from turtlelog.draw.figures.figure_curves import choose_colors, label_runs
from turtlelog.draw.figures.figure_needs import GAIN
from turtlelog.draw.figures.page import NOTE, STROKES, fix_style
from turtlelog.errors import ShowError
from turtlelog.measure import model_run_loops
from turtlelog.run import Run
from turtlelog.theory.loop_design import LoopDesign, find_p_without_overshoot

_MOST_LINES: Final = 3  # dead times with a line each; more become a band between their limits
_MOST_LOOPS: Final = 4  # loops of several laws; with more, the figure would be higher than a page

_FAR: Final = 2.5
"""Largest drawn limit, in largest gains; a larger one would crowd all runs at the left."""

_MOST_NAMED: Final = 8  # runs with a name at each point; more names would hide the points
_RATIO: Final = 4.0  # ratio of largest to smallest gain from which the gain axis is logarithmic
_GAINS: Final = 48  # number of gains of a theoretical curve: one per millimetre of a panel

_COLUMN_INCH: Final = 1.5
"""Smallest width of a panel side by side [inch]; below, the values of two limits touch."""

_ROW_INCH: Final = 1.45

_OVERSHOOT: Final = fix_style(color=to_hex(OVERSHOOT), linewidth=0.9, linestyle=STROKES["dashed"])
_UNSTABLE: Final = fix_style(color=to_hex(UNSTABLE), linewidth=1.0)
_BEYOND: Final = fix_style(color=to_hex(UNSTABLE), alpha=0.09, linewidth=0.0, zorder=0.6)
_OVERSHOOTING: Final = fix_style(color=to_hex(OVERSHOOTING), alpha=0.10, linewidth=0.0, zorder=0.5)
_THEORY: Final = fix_style(color="0.35", linewidth=0.9, linestyle=STROKES["dotted"], zorder=1.8)
_LIMITED: Final = {**_THEORY, "linestyle": STROKES["dashed"]}
_SAMPLED: Final = {**_THEORY, "linestyle": "-", "linewidth": 0.6}


def draw_gains(
    figure: Figure, runs: Sequence[Run], *, metrics: Sequence[str] | None = None
) -> None:
    """Draw metrics against the gain of each loop, with theory's limits.

    The metrics are as in `strip_figure.measure_for_figure`. Runs without a known gain are left out.
    ShowError if no gain is known, or no run has a value.
    """
    loops = find_loop_gains(runs)
    if not loops:
        raise ShowError(f"figure gains needs {GAIN.words}")
    found = strip_figure.measure_for_figure("gains", runs, metrics)
    columns = [loop for loop in loops if any(one.loop in ("", loop.name) for one in found)]
    own = {one.loop for one in found} - {""}
    columns = [loop for loop in columns if loop.name in own] or columns[:1] if own else columns[:1]
    notes = []
    constant = [loop for loop in columns if len({*loop.gains[np.isfinite(loop.gains)]}) < 2]
    if metrics is None and len(constant) < len(columns):
        # Of a constant gain, there would be one place.
        columns = [loop for loop in columns if loop not in constant]
        notes = [f"Kp of {one.name} is always {np.nanmax(one.gains):g} 1/s" for one in constant]
    if len(columns) > _MOST_LOOPS:
        notes += [f"the first {_MOST_LOOPS} of {len(columns)} loops; --metric LOOP.METRIC chooses"]
        columns = columns[:_MOST_LOOPS]
    figure.supxlabel("\n".join(notes), **NOTE)
    shown_loops = {"", *(loop.name for loop in columns)}
    rows = list(dict.fromkeys(one.name for one in found if one.loop in shown_loops))
    width = figure.get_figwidth()
    is_stacked = width < _COLUMN_INCH * len(columns)
    shape = (len(rows) * len(columns), 1) if is_stacked else (len(rows), len(columns))
    figure.set_size_inches(width, 0.55 + _ROW_INCH * shape[0])
    grid = figure.subplots(*shape, squeeze=False)
    for column, loop in enumerate(columns):
        own_axes = grid[column * len(rows) :, 0] if is_stacked else grid[:, column]
        # A metric of the whole run is shown once, over the first gain.
        allowed = (loop.name, "") if column == 0 else (loop.name,)
        own_values = {one.name: one for one in reversed(found) if one.loop in allowed}
        shown = [own_values.get(name) for name in rows]
        last = max(row for row, one in enumerate(shown) if one is not None)
        for row, (axes, one) in enumerate(zip(own_axes, shown, strict=False)):
            if one is None:
                axes.set_axis_off()
                continue
            _draw_panel(axes, runs, loop, one, is_first=row == 0)
            axes.tick_params(labelbottom=row == last)
            axes.set_ylabel(one.label)
        own_axes[last].set_xlabel(f"Kp of {loop.name} [1/s]")
        own_axes[0].set_title(_name_loop(loop), pad=12.0)
    figure.align_ylabels()


@dataclass(frozen=True, slots=True, kw_only=True)
class GainLimits:
    """Theory's limits of Kp for one timing."""

    dead_time_s: float  # total dead time of the loop [s]
    overshoot: float | None  # Kp above which it overshoots [1/s]; None: not proportional
    stability: float | None  # Kp above which it is unstable [1/s]; None: no Kp is stable
    design: LoopDesign  # loop for computing responses
    gains: theory.PidGains  # gains of one of the runs, for which the limits of Kp are valid


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopGains:
    """A loop's gain in each run.

    The step is None if it differs between runs, or theory does not know the loop.
    """

    name: str  # name of the loop
    gains: Values  # Kp of each run [1/s]; NaN if unknown
    limits: tuple[GainLimits, ...]  # limits from theory, one for each timing, in order of dead time
    step: tuple[float, float] | None = None  # size [rad or m], limit of the command [rad/s or m/s]


def _name_loop(loop: LoopGains) -> str:
    if not loop.limits:
        return f"{loop.name}: no theory"
    times_ms = sorted({round(1e3 * one.dead_time_s, 1) for one in loop.limits})
    if len(times_ms) > _MOST_LINES:
        return f"{loop.name}\ndead time {times_ms[0]:g} to {times_ms[-1]:g} ms"
    return f"{loop.name}\ndead time {', '.join(f'{time:g}' for time in times_ms)} ms"


def _draw_panel(
    axes: Axes,
    runs: Sequence[Run],
    loop: LoopGains,
    found: strip_figure.MetricValues,
    *,
    is_first: bool,
) -> None:
    gains = loop.gains
    known = gains[np.isfinite(gains)]
    _set_gain_axis(axes, loop, known)
    strip_figure.set_value_scale(axes, found)
    _draw_limits(axes, loop, is_first=is_first)
    _draw_theory(axes, loop, found)
    asked = np.isfinite(gains)
    places = np.unique(gains[asked])
    if len(places) == asked.sum():
        order = np.argsort(gains[asked], kind="stable")
        # NaN interrupts the line if a run has no value.
        line: dict[str, Any] = {"color": "0.75", "linewidth": 0.7, "zorder": 1.7}
        axes.plot(gains[asked][order], found.values[asked][order], **line)
    small = 4.5 if len(runs) <= _MOST_NAMED else 3.4 if len(runs) <= 3 * _MOST_NAMED else 2.4
    for place, color in zip(places, choose_colors(len(places)), strict=True):
        there = gains == place
        values = found.values[there]
        known = values[np.isfinite(values)]
        look: dict[str, Any] = {"ms": small, "color": color, "zorder": 3}
        axes.plot(np.full(len(known), place), known, "o", **look)
        if len(known) < len(values):
            look = {"ms": 5.0, "mew": 1.2, "color": to_hex(UNSTABLE), "label": "no value"}
            axes.plot(place, 0.95, "x", transform=axes.get_xaxis_transform(), **look)
    named = cut_alike(label_runs(runs)) if is_first and 1 < len(runs) <= _MOST_NAMED else ()
    for name, gain, value in zip(named, gains, found.values, strict=False):
        if np.isfinite(gain) and np.isfinite(value):
            text = axes.annotate(name, (gain, value), (0.0, 4.0), textcoords="offset points")
            text.set(fontsize=6.5, ha="center", va="bottom", color="0.25", zorder=3.5)
            text.set_bbox({"facecolor": "white", "edgecolor": "none", "pad": 0.3, "alpha": 0.75})


def _set_gain_axis(axes: Axes, loop: LoopGains, known: Values) -> None:
    low, high = float(known.min()), float(known.max())
    if high > _RATIO * low:
        axes.set_xscale("log")
    ends = [one for limit in loop.limits for one in (limit.overshoot, limit.stability) if one]
    near = [one for one in ends if one < _FAR * high]
    left, right = min([low, *(one for one in near if one > low / _FAR)]), max([high, *near])
    if axes.get_xscale() == "log":
        axes.set_xlim(left / 1.35, right * 1.35)
    else:
        room = 0.12 * (right - left) or 0.3 * right
        axes.set_xlim(max(left - room, 0.0), right + room)
    strip_figure.set_ticks_at(axes, known.tolist())


def _draw_limits(axes: Axes, loop: LoopGains, *, is_first: bool) -> None:
    """Draw the gains above which theory's loop overshoots or is unstable."""
    left, right = axes.get_xlim()
    starts: dict[str, float] = {}
    beyond = []
    for kind, looks, name in (
        ("overshoot", _OVERSHOOT, "overshoot begins (theory)"),
        ("stability", _UNSTABLE, "instability (theory)"),
    ):
        limits = sorted({float(value) for one in loop.limits if (value := getattr(one, kind))})
        if not limits:
            continue
        starts[kind] = min(max(limits[0], left), right)
        shown = [limit for limit in limits if left < limit < right]
        if shown:
            is_left = kind == "overshoot"
            _draw_shown(axes, shown, {**looks, "label": name}, is_left=is_left, is_told=is_first)
        else:
            beyond.append((kind, limits[0], looks["color"]))
    if "stability" in starts:
        axes.axvspan(starts["stability"], right, **_BEYOND)
    if "overshoot" in starts:
        axes.axvspan(starts["overshoot"], starts.get("stability", right), **_OVERSHOOTING)
    if is_first:
        _tell_beyond(axes, beyond)


def _draw_shown(
    axes: Axes, limits: Sequence[float], looks: Mapping[str, Any], *, is_left: bool, is_told: bool
) -> None:
    """Draw a line for each limit, or a band for many, with the values above if they are told."""
    color = looks["color"]
    if len(limits) > _MOST_LINES:
        band = {"color": color, "alpha": 0.25, "linewidth": 0.0, "label": looks["label"]}
        axes.axvspan(limits[0], limits[-1], **band)
    else:
        for limit in limits:
            axes.axvline(limit, **looks, zorder=1.5)
    if is_told:
        told = "-".join(dict.fromkeys(f"{limit:.3g}" for limit in (limits[0], limits[-1])))
        # In a column, several limits of overshoot would touch those of stability above the middle.
        ends = is_left and limits[0] < limits[-1]
        at = limits[-1] if ends else math.sqrt(limits[0] * limits[-1])
        ha = "right" if ends else "center"
        text = axes.text(at, 1.02, told, fontsize=6.2, color=color, ha=ha, va="bottom")
        text.set_transform(axes.get_xaxis_transform())


def _tell_beyond(axes: Axes, beyond: Sequence[tuple[str, float, str]]) -> None:
    words = {"overshoot": "overshoots", "stability": "unstable"}
    for number, (kind, limit, color) in enumerate(beyond):
        is_right = limit >= axes.get_xlim()[1]
        side, at, arrow = ("right", 0.99, " →") if is_right else ("left", 0.01, "")
        told = f"{words[kind]} from {limit:.3g}{arrow}"
        text = axes.text(at, 0.97 - 0.11 * number, told, fontsize=6.5, color=color)
        text.set(transform=axes.transAxes, ha=side, va="top")


def _draw_theory(axes: Axes, loop: LoopGains, found: strip_figure.MetricValues) -> None:
    left, right = axes.get_xlim()
    gains = np.geomspace(max(left, 1e-3 * right), right, _GAINS)
    if found.name == "settling_time":
        if loop.limits and not (loop.limits[0].gains.ki or loop.limits[0].gains.kd):
            times_s = [theory.compute_settling_time(float(gain)) for gain in gains]
            axes.plot(gains, times_s, **_THEORY, label="ideal loop: 4 τ")
        if loop.step is not None:
            size, limit = loop.step
            settle = partial(theory.compute_saturated_settling_time, step=size, limit=limit)
            times_s = [settle(float(gain)) for gain in gains]
            axes.plot(gains, times_s, **_LIMITED, label="ideal loop, limited")
    elif found.name == "overshoot":
        for one in loop.limits[:_MOST_LINES]:
            values = [_overshoot(one, float(gain)) for gain in gains]
            axes.plot(gains, values, **_SAMPLED, label="sampled loop, no limit")


def _overshoot(limit: GainLimits, kp: float) -> float:
    """Return the overshoot of the linear sampled loop [%]; NaN for none, or if unstable."""
    if limit.stability is None or kp >= limit.stability or limit.design.is_slow:
        return math.nan
    return max(limit.design.measure_overshoot(replace(limit.gains, kp=kp)), 0.0)


_ALIKE: Final = 0.02
"""Share by which steps may differ to share a curve of settling times. The curve's error has the
same size.

The share is half the width of the settling band."""


def find_loop_gains(runs: Sequence[Run]) -> list[LoopGains]:
    """Return the loops of runs with a known gain, with theory's limits for each loop."""
    names = dict.fromkeys(loop.name for run in runs for loop in run.declaration.loops)
    found = [_find_loop(name, runs) for name in names]
    return [loop for loop in found if np.isfinite(loop.gains).any()]


def _find_loop(name: str, runs: Sequence[Run]) -> LoopGains:
    gains: list[float] = []
    limits: dict[object, GainLimits] = {}
    for run in runs:
        own = run.declaration.find_loop(name)
        gain = (own and own.read_gain(run.parameters)) or 0.0
        gains.append(float(gain) if gain > 0.0 else math.nan)
        for model in model_run_loops(run):
            if model.loop.name != name or model.reason or not math.isfinite(gains[-1]):
                continue
            pid, settings = model.require()
            process, period_s = settings["process"], settings["period_s"]
            # Rounded, because times of a real loop are not known more precisely.
            key = (round(process.dead_time_s, 4), round(period_s, 4), replace(pid, kp=1.0))
            if key not in limits:
                limits[key] = _compute_limits(pid, process, period_s)
    order = sorted(limits.values(), key=lambda one: (one.dead_time_s, one.design.period_s))
    return LoopGains(
        name=name, gains=np.array(gains), limits=tuple(order), step=_find_step(name, runs)
    )


def _find_step(name: str, runs: Sequence[Run]) -> tuple[float, float] | None:
    """Return the common step of all runs, and the limit of their command."""
    found = []
    for run in runs:
        loop = run.declaration.find_loop(name)
        for step in () if loop is None else find_steps(run, loop.signal):
            limit = run.parameters.get(step.loop.limit_key)
            size = abs(step.reference - step.initial)
            size = math.radians(size) if step.loop.signal == "heading" else size
            if step.loop.name == name and isinstance(limit, int | float) and limit > 0 < size:
                found.append((size, float(limit)))
    if not found or any(not np.allclose(one, found[0], rtol=_ALIKE) for one in found):
        return None
    return found[0]


def _compute_limits(pid: theory.PidGains, process: theory.Process, period_s: float) -> GainLimits:
    design = LoopDesign(process=process, period_s=period_s, filter_s=pid.filter_s)
    is_proportional = not pid.ki and not pid.kd
    overshoot = find_p_without_overshoot(design) if is_proportional else None
    if is_proportional:
        stability: float | None = design.find_ultimate_gain()
    else:
        ranges = theory.find_stable_gains(pid, period_s=period_s, process=process)
        stability = ranges[-1][1] if ranges else None
    return GainLimits(
        dead_time_s=process.dead_time_s,
        overshoot=overshoot,
        stability=stability,
        design=design,
        gains=pid,
    )
