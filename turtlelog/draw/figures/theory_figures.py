"""Figures of theory: the plant, ideal loops, and the sampled loops of runs.

Curves of sampled loops are exact, with their dead time, and end at pi / T.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import cycle
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator
from numpy.typing import NDArray

from turtlelog import theory
from turtlelog.charts.curves import Values
from turtlelog.charts.many_runs import MANY
from turtlelog.charts.palette import LOOP_DASHES
from turtlelog.draw.figures import figure_curves
from turtlelog.draw.figures.figure_curves import choose_lines, choose_run_lines, label_runs
from turtlelog.draw.figures.page import NOTE, REFERENCE, STROKES, fix_style
from turtlelog.measure import model_run_loops
from turtlelog.plants import find_plant
from turtlelog.run import Run

_POINTS: Final = 600  # number of points of each frequency response: 3 per millimetre of a column
_GAINS: Final = 160  # number of gains at which the poles of a root locus are computed
_MOST_LOCI: Final = 6  # root locus panels: three rows of two panels

_FAR: Final = 2.5
"""Largest visible distance from 0 in Nyquist's plane, and from 1 in a step response. An open loop
with an integrator, and an unstable response, have no bound."""

_BESIDE: Final = 0.4  # smallest visible part of Nyquist's plane above 0 and to the right of 0
_NO_OVERSHOOT: Final = 0.05  # smallest overshoot in the shown digits [%]
_DECADES_BELOW: Final = 2.0  # decades below the crossover at which a frequency response begins

_WIDER: Final = 1.2  # additional width of each lower loop [points], visible if two coincide
_DASH_POINTS: Final = 1.6  # width of a line to which dashes are scaled [points]
_LARGER: Final = 2.2  # additional size of the lower loops' marks [points]
_MOST_TOLD: Final = 6

_PLANE_INCH: Final = 2.1
"""Smallest width of a plane of poles with its text [inch]; three fit into a page's row."""
_LINE_SHARE: Final = 0.45  # height of the axis of ideal poles, as a share of the height of a plane
_ROOM_INCH: Final = 0.42  # height of the text above and below a plane [inch]
_BAND: Final = fix_style(color="0.92", zorder=0.5, label="2 % band")
_MIRRORED: Final = fix_style(linewidth=0.5, linestyle=":")
_MOST_SAMPLES: Final = 20_000  # samples of a step response: more than a page resolves

_LONGEST: Final = 5.0
"""Largest length of the axis of step responses, as a multiple of their median. One loop near its
limit of stability would hide the others. The slowest of the paper's gains takes less."""

_UNSTABLE_LENGTH: Final = 40.0
"""Drawn length of an unstable response, as a multiple of dead time plus sampling period."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _LoopCurve:
    run: str  # name of the run; empty if there is only one
    is_many: bool  # whether a colour bar names the runs, because there are many
    layer: int  # index of the loop in its law; loop 0 is on top
    model: theory.LoopModel  # model of the loop in theory
    found: theory.PidLoop  # properties of the loop
    run_looks: Mapping[str, Any]  # colour and marker of the run

    @property
    def looks(self) -> dict[str, Any]:
        """Colour and marker of the run, dashes and width of the loop."""
        width = (0.8 if self.is_many else 1.1) + _WIDER * self.layer
        dashes = STROKES[LOOP_DASHES[self.layer % len(LOOP_DASHES)]]
        if self.layer % len(LOOP_DASHES):
            # matplotlib scales dashes by the line's width: two dashes must fit into a legend.
            dashes = (0, tuple(_DASH_POINTS / width * part for part in dashes[1]))
        return {
            **self.run_looks,
            "linestyle": dashes,
            "linewidth": width,
            "zorder": 2.6 - 0.3 * self.layer,
        }

    @property
    def mark(self) -> dict[str, Any]:
        """Style of a single point; a ring for a lower loop."""
        looks = {"color": self.run_looks["color"], "ms": 3.5 + _LARGER * self.layer, "zorder": 3}
        return looks | ({"mfc": "none", "mew": 0.9} if self.layer else {})

    def label(self, tell: Callable[[theory.PidLoop], str]) -> str:
        """Return a legend entry: the run, the loop, and the text of `tell`."""
        told = f"{self.run} {self.model.loop.name}".strip() + f": {tell(self.found)}"
        return self.run if self.is_many else told


def draw_bode(figure: Figure, runs: Sequence[Run]) -> None:
    """Draw magnitude and phase of the open loops, with their margins marked."""
    size, phase = figure.subplots(2, 1, sharex=True)
    size.axhline(0.0, **REFERENCE)
    phase.axhline(-180.0, **REFERENCE)
    curves = _style_loops(runs)
    for curve, label in zip(curves, _name_loops(size, curves, _tell_margins), strict=True):
        frequencies, values = _respond(curve)
        turned = np.degrees(np.unwrap(np.angle(values)))
        turned -= 360.0 * np.ceil(turned[0] / 360.0)  # begins between -360 and 0 deg
        size.semilogx(frequencies, _to_db(np.abs(values)), label=label, **curve.looks)
        phase.semilogx(frequencies, turned, **curve.looks)
        _mark_margins(size, phase, curve, frequencies, turned)
    looks = {**REFERENCE, "linestyle": STROKES["dotted"], "label": "π / T, the highest frequency"}
    for frequency in sorted({math.pi / curve.found.period_s for curve in curves}):
        for axes in (size, phase):
            axes.axvline(frequency, **looks, zorder=1.2)
    _name_margins(size)
    size.set_ylabel("magnitude [dB]")
    phase.set(xlabel="frequency [rad/s]", ylabel="phase [deg]")
    phase.set_ylim(max(phase.get_ylim()[0], -450.0), None)
    phase.yaxis.set_major_locator(MultipleLocator(90.0))
    # Kp alone does not change the phase.
    told = [
        f"{len(group)} runs have one phase of {group[0].model.loop.name}"
        f" ({1e3 * group[0].found.dead_time_s:.4g} ms)"
        for group in _group_loci(curves)
        if len(group) > 1
    ]
    note = phase.text(0.01, 0.03, "\n".join(told[:_MOST_TOLD]), transform=phase.transAxes)
    note.set(fontsize=7.0, color="0.35", va="bottom")


def draw_nyquist(figure: Figure, runs: Sequence[Run]) -> None:
    """Draw the open loops in the complex plane, with the unit circle and the point -1."""
    axes = figure.subplots()
    _draw_unit_circle(axes)
    curves = _style_loops(runs)
    furthest = np.zeros(2)
    for curve, label in zip(curves, _name_loops(axes, curves, _tell_margins), strict=True):
        _, values = _respond(curve)
        furthest = np.maximum(furthest, [values.real.max(), values.imag.max()])
        axes.plot(values.real, values.imag, label=label, **curve.looks)
        axes.plot(values.real, -values.imag, color=curve.run_looks["color"], **_MIRRORED)
        margins = curve.found.margins
        if margins is not None and margins.phase_margin_rad is not None:
            at = -np.exp(1j * margins.phase_margin_rad)
            axes.plot(at.real, at.imag, "o", **curve.mark)
        if margins is not None and margins.gain_margin is not None:
            axes.plot(-1.0 / margins.gain_margin, 0.0, "s", **curve.mark)
    axes.plot([-1.0], [0.0], "x", color="black", ms=6.0, mew=1.4, label="-1", zorder=3)
    axes.plot([], [], color="0.35", **_MIRRORED, label="frequencies below 0")
    _name_margins(axes)
    axes.set(xlabel="real part", ylabel="imaginary part", aspect="equal")
    crossings = [curve.found.margins.gain_margin for curve in curves if curve.found.margins]
    left = min(-1.0, *(-1.0 / margin for margin in crossings if margin is not None), -1.0)
    # Above and to the right there are only mirrored curves and the circle.
    right, top = np.clip(1.2 * furthest, _BESIDE, 1.2)
    axes.set(xlim=(max(1.25 * left, -_FAR), right), ylim=(-1.3, top))


def draw_root_locus(figure: Figure, runs: Sequence[Run]) -> None:
    """Draw the poles of the closed loops against Kp, with those of the runs marked.

    A first panel shows ideal proportional loops of 1/s in the s plane, others sampled loops in z.
    """
    curves = _style_loops(runs)
    names = _name_poles(runs, curves)
    styled = zip(runs, names.values(), choose_run_lines(runs), strict=True)
    ideal: list[_Poles] = [
        (np.array([-kp]), looks, name)
        for run, name, looks in styled
        for kp in (find_gains([run]) if find_plant(run).dynamics == "integrator" else ())
    ]
    if not runs:
        gains = zip(PAPER_GAINS, choose_lines(len(PAPER_GAINS)), strict=True)
        ideal = [(np.array([-kp]), looks, f"Kp = {kp:g}") for kp, looks in gains]
    draw = [partial(_draw_ideal_locus, poles=ideal)] if ideal else []
    draw += [partial(_draw_locus, group=group, names=names) for group in _group_loci(curves)]
    if len(draw) > _MOST_LOCI:
        note = f"the first {_MOST_LOCI} of {len(draw)} loci, by dead time"
        figure.supxlabel(note, **NOTE)
        draw = draw[:_MOST_LOCI]
    planes = draw[bool(ideal) :]
    columns = min(len(planes), int(figure.get_figwidth() / _PLANE_INCH)) or 1
    rows = -(-len(planes) // columns)
    heights = [_LINE_SHARE] * bool(ideal) + [1.0] * rows
    width, high = float(figure.get_figwidth()), sum(heights)
    plane_inch = min(width / columns, 0.5 * width)
    figure.set_size_inches(width, plane_inch * high + _ROOM_INCH * (high + 0.5))
    grid = figure.add_gridspec(len(heights), columns, height_ratios=heights)
    if ideal:
        draw[0](figure.add_subplot(grid[0, :]))
    for number, draw_plane in enumerate(planes):
        axes = figure.add_subplot(grid[number // columns + bool(ideal), number % columns])
        draw_plane(axes)
        if number % columns:
            axes.set_ylabel("")


def _name_poles(runs: Sequence[Run], curves: Sequence[_LoopCurve]) -> dict[str, str]:
    """Return the legend text of each run's poles by the name of the run: its gains."""
    found: dict[str, str] = {}
    for name in _name_styled(runs):
        own = ((one.model.loop.name, one.found) for one in curves if one.run == name)
        told = [
            (loop, f"Kp = {a.gains.kp:g}{'' if a.stable else ' (unstable)'}") for loop, a in own
        ]
        gains = {gain for _, gain in told}
        words = ", ".join([*gains] if len(gains) == 1 else [f"{loop} {kp}" for loop, kp in told])
        is_short = len(runs) > MANY or not words
        found[name] = name if is_short else f"{name}: {words}" if name else words
    return found


def draw_step(figure: Figure, runs: Sequence[Run]) -> None:
    """Draw the sampled loops' responses to a reference step, without limits."""
    axes, curves = figure.subplots(), _style_loops(runs)
    lasting_s = []
    for found in (curve.found for curve in curves):
        unstable_s = _UNSTABLE_LENGTH * (found.dead_time_s + found.period_s)
        lasts_s = 1000.0 * found.period_s if found.stable else unstable_s
        settled_s = found.settling_time_s
        lasting_s.append(lasts_s if settled_s is None else 1.4 * settled_s)
    last_s = min(max(lasting_s), _LONGEST * float(np.median(lasting_s)))
    axes.axhspan(0.98, 1.02, **_BAND)
    axes.axhline(1.0, **REFERENCE)
    lowest, highest = 0.0, 1.0
    for curve, label in zip(curves, _name_loops(axes, curves, _tell_step), strict=True):
        gains, settings = curve.model.require()
        count = min(math.ceil(last_s / curve.found.period_s) + 2, _MOST_SAMPLES)
        values = theory.compute_pid_step_response(gains, count, **settings)
        beyond = np.abs(values - 1.0) > _FAR
        values = np.where(np.cumsum(beyond) > beyond, np.nan, values)  # cut outside the axes
        time_s = np.arange(count) * curve.found.period_s
        axes.plot(time_s, values, label=label, **curve.looks)
        highest = max(highest, min(float(np.nanmax(values)), 1.0 + _FAR))
        lowest = min(lowest, max(float(np.nanmin(values)), 1.0 - _FAR))
    axes.set(xlim=(0.0, last_s), ylim=(lowest - 0.05, highest + 0.1))
    axes.set(xlabel="time [s]", ylabel="response to a unit step")


def _style_loops(runs: Sequence[Run]) -> list[_LoopCurve]:
    """Return the loops of runs that theory knows. Runs differ in colour, loops in dashes."""
    known = [theory.list_known(model_run_loops(run)) for run in runs]
    loops = dict.fromkeys(model.loop.name for models in known for model in models)
    layers = {name: layer for layer, name in enumerate(loops)}
    styled = zip(_name_styled(runs), known, choose_run_lines(runs), strict=True)
    return [
        _LoopCurve(
            run=name,
            is_many=len(runs) > MANY,
            layer=layers[model.loop.name],
            model=model,
            found=model.analyse(),
            run_looks=looks,
        )
        for name, models, looks in styled
        for model in models
    ]


def _name_styled(runs: Sequence[Run]) -> list[str]:
    return label_runs(runs) if len(runs) > 1 else [""] * len(runs)


def _name_loops(
    axes: Axes, curves: Sequence[_LoopCurve], tell: Callable[[theory.PidLoop], str]
) -> list[str | None]:
    """Return the legend text of each loop; for many runs, only the dashes of each loop."""
    labels = [curve.label(tell) for curve in curves]
    if not any(curve.is_many for curve in curves):
        return figure_curves.name_some(axes, labels)
    for curve in {curve.layer: curve for curve in curves}.values():
        axes.plot([], [], **{**curve.looks, "color": "0.35"}, label=curve.model.loop.name)
    return list(labels)


def _tell_margins(found: theory.PidLoop) -> str:
    margins = found.margins
    if margins is None:
        return "unstable"
    factor, phase_rad = margins.gain_margin, margins.phase_margin_rad
    words = [] if factor is None else [f"GM {_to_db(factor):.1f} dB"]
    words += [] if phase_rad is None else [f"PM {math.degrees(phase_rad):.1f}°"]
    return ", ".join(words) or "stable"


def _tell_step(found: theory.PidLoop) -> str:
    if not found.stable:
        return "unstable"
    if found.overshoot_percent is None or found.settling_time_s is None:
        return "stable"
    percent = found.overshoot_percent
    overshoot = f"overshoot {percent:.1f} %" if percent >= _NO_OVERSHOOT else "no overshoot"
    return f"{overshoot}, settles in {found.settling_time_s:.3g} s"


def _respond(curve: _LoopCurve) -> tuple[Values, NDArray[np.complex128]]:
    """Return frequencies around the crossover, up to pi / T [rad/s], and the open loop at them."""
    found, (gains, settings) = curve.found, curve.model.require()
    margins, highest = found.margins, math.pi / found.period_s
    crossover = (margins and margins.crossover_rad_s) or found.gains.kp * found.process.gain
    lowest = min(crossover, highest) / 10.0**_DECADES_BELOW
    frequencies = np.geomspace(lowest, highest, _POINTS)
    return frequencies, theory.compute_open_loop(gains, frequencies, **settings)


def _to_db(size: Any) -> Any:
    return 20.0 * np.log10(size)


def _name_margins(axes: Axes) -> None:
    for marker, name in (("o", "phase margin (PM)"), ("s", "gain margin (GM)")):
        axes.plot([], [], marker, ms=3.5, color="0.35", label=name)


def _mark_margins(
    size: Axes, phase: Axes, curve: _LoopCurve, frequencies: Values, turned: Values
) -> None:
    """Mark the phase margin from -180 deg upward, and the gain margin from 0 dB downward."""
    margins, looks = curve.found.margins, curve.looks
    if margins is None:
        return
    if margins.phase_margin_rad is not None and margins.crossover_rad_s is not None:
        at = margins.crossover_rad_s
        level = float(np.interp(at, frequencies, turned))
        size.plot(at, 0.0, "o", **curve.mark)
        phase.plot(at, level, "o", **curve.mark)
        phase.plot([at, at], [level - math.degrees(margins.phase_margin_rad), level], **looks)
    if margins.gain_margin is not None and margins.gain_frequency_rad_s is not None:
        at, level = margins.gain_frequency_rad_s, -float(_to_db(margins.gain_margin))
        size.plot([at, at], [level, 0.0], **looks)
        size.plot(at, level, "s", **curve.mark)
        phase.plot(at, float(np.interp(at, frequencies, turned)), "s", **curve.mark)


def _draw_unit_circle(axes: Axes) -> None:
    angles = np.linspace(0.0, 2.0 * math.pi, 361)
    axes.plot(np.cos(angles), np.sin(angles), **REFERENCE, label="unit circle")


def _group_loci(curves: Sequence[_LoopCurve]) -> list[list[_LoopCurve]]:
    """Return groups of loops that differ only in Kp."""
    groups: dict[Any, list[_LoopCurve]] = {}
    for curve in curves:
        held = replace(curve.found.gains, kp=1.0), curve.found.process, curve.found.period_s
        groups.setdefault((held, curve.model.loop.name), []).append(curve)
    return list(groups.values())


def _draw_locus(axes: Axes, group: Sequence[_LoopCurve], names: Mapping[str, str]) -> None:
    first = group[0]
    gains, settings = first.model.require()
    limit = first.found.stable_gains[-1][1] if first.found.stable_gains else 0.0
    highest = 1.5 * max(limit, *(curve.found.gains.kp for curve in group))
    _draw_unit_circle(axes)
    rising = np.geomspace(1e-3 * highest, highest, _GAINS).tolist()
    locus = theory.compute_pid_locus(gains, rising, **settings)
    axes.plot(locus.real, locus.imag, ".", color="0.55", ms=1.2, zorder=1.6)
    for end in {end for ends in first.found.stable_gains for end in ends if end > 0.0}:
        poles = theory.compute_pid_poles(replace(gains, kp=end), **settings)
        at = poles[np.abs(np.abs(poles) - 1.0) < 1e-6]
        axes.plot(at.real, at.imag, "s", ms=4.0, mfc="none", color="black", label="limit of Kp")
    _draw_poles(axes, [(one.found.poles, one.run_looks, names[one.run]) for one in group])
    axes.set_title(f"{first.model.loop.name}\ndead time {1e3 * first.found.dead_time_s:.4g} ms")
    axes.set(xlabel="real part of z", ylabel="imaginary part of z", aspect="equal")
    axes.set(xlim=(-1.2, 1.2), ylim=(-1.2, 1.2))


_RING_POINTS: Final = 2.4  # half the width of rings, for poles at one place [points]
_MOST_RINGS: Final = 4
_POLE_LARGER: Final = 1.0  # additional size of poles over the markers of curves [points]
PAPER_GAINS: Final = (1.0, 2.0, 4.0, 10.0)

_Poles = tuple[NDArray[np.complex128], Mapping[str, Any], str]
"""Poles of a closed loop in the s plane [1/s] or the z plane, shape (n,), their style and label."""


def draw_plant_responses(figure: Figure, runs: Sequence[Run]) -> None:  # noqa: ARG001
    """Draw the response of the plant 1/s to an impulse, a step and a ramp."""
    time_s = np.linspace(0.0, 5.0, 201)
    for axes, kind in zip(figure.subplots(1, 3), theory.PLANT_INPUTS, strict=True):
        axes.plot(time_s, theory.compute_plant_response(kind, time_s), **choose_lines(1)[0])
        end = "unbounded" if theory.find_plant_final_value(kind).value is None else "bounded"
        axes.set(xlabel="time [s]", title=f"{kind}: {end}", xlim=(0.0, 5.0), ylim=(0.0, None))
    figure.axes[0].set(ylabel="response of 1/s", ylim=(0.0, 1.25))


def draw_step_responses(figure: Figure, runs: Sequence[Run]) -> None:
    """Draw the closed loop's step response for each gain, with the 2 % band and 4 tau marked."""
    axes, gains = figure.subplots(), find_gains(runs)
    last_s = 1.25 * theory.compute_settling_time(min(gains))
    time_s = np.linspace(0.0, last_s, 601)
    axes.axhspan(0.98, 1.02, **_BAND)
    axes.axhline(1.0, **REFERENCE)
    names = figure_curves.name_some(axes, [f"Kp = {gain:g}" for gain in gains])
    # A gain has the colour of its first run, and dashes if it is not the first gain of that run.
    styled: dict[float, Mapping[str, Any]] = {}
    for run, looks in zip(runs, choose_run_lines(runs), strict=True):
        for gain, dash in zip(find_gains([run]), cycle(LOOP_DASHES), strict=False):
            styled.setdefault(gain, {**looks, "linestyle": STROKES[dash]})
    for gain, name, plain in zip(gains, names, choose_lines(len(gains)), strict=True):
        looks = styled.get(gain, plain)
        values = theory.compute_closed_loop_response(gain, time_s)
        axes.plot(time_s, values, label=name, **looks)
        settled_s = theory.compute_settling_time(gain)
        level = theory.compute_closed_loop_response(gain, [0.0, settled_s])[-1]
        axes.plot(settled_s, level, "o", ms=3.5, color=looks["color"])
    axes.plot([], [], "o", ms=3.5, color="0.35", label="4 τ")
    axes.set(xlabel="time [s]", ylabel="response to a unit step", xlim=(0.0, last_s), ylim=(0, 1.1))


def _draw_ideal_locus(axes: Axes, poles: Sequence[_Poles]) -> None:
    """Draw the poles s = -Kp of the ideal closed loops, from the plant's pole at 0 to the left."""
    left = 1.25 * min(float(values.real.min()) for values, _, _ in poles)
    axes.axvspan(0.0, -0.24 * left, color="0.94", zorder=0.5)
    axes.text(-0.12 * left, 0.6, "unstable", ha="center", fontsize=7.0, color="0.4")
    branch = theory.compute_root_locus([0.0, -left])
    axes.plot(branch.real, branch.imag, color="0.3", label="s = -Kp")
    axes.plot([0.0], [0.0], "x", color="black", ms=6.0, mew=1.4, label="pole of 1/s", zorder=3)
    _draw_poles(axes, poles)
    axes.set(xlabel="real part [1/s]", ylabel="imaginary part [1/s]", xlim=(left, -0.24 * left))
    axes.set_ylim(-1.0, 1.0)
    axes.locator_params(nbins=5)  # all poles are real


def _draw_poles(axes: Axes, poles: Sequence[_Poles]) -> None:
    """Draw poles. Of equal poles, the first are larger discs below the others."""
    for number, (values, run_looks, label) in enumerate(poles):
        later = sum(np.array_equal(values, other[0]) for other in poles[number + 1 :])
        looks = {"marker": "o", "ms": 4.5, **run_looks, "markevery": None, "linestyle": ""}
        looks["ms"] += _POLE_LARGER + _RING_POINTS * min(later, _MOST_RINGS)
        looks["zorder"] = 2.9 - 0.001 * later
        axes.plot(values.real, values.imag, label=label, **looks)


def find_gains(runs: Sequence[Run]) -> tuple[float, ...]:
    """Return the gains of loops known to theory, increasing; without runs, the paper's gains."""
    if not runs:
        return PAPER_GAINS
    loops = ((loop, run) for run in runs for loop in run.declaration.loops if loop.has_theory)
    found = {loop.read_gain(run.parameters) for loop, run in loops}
    return tuple(sorted(gain for gain in found if gain is not None))
