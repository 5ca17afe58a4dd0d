"""Figures of the sampled loops of runs: Bode, Nyquist, root locus, step response.

All curves belong to the exact discretisation including dead time, and end at pi / T.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
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
from turtlelog.draw.figures.page import REFERENCE, STROKES, fix_style
from turtlelog.draw.figures.run_styles import choose_run_lines, label_runs
from turtlelog.measure import model_run_loops
from turtlelog.plants import LAGGED, find_plant
from turtlelog.run import Run

_POINTS: Final = 600
"""Number of points of each frequency response: 3 per millimetre of a column."""

_GAINS: Final = 160
"""Number of gains at which the poles of a root locus are computed."""

_MOST_LOCI: Final = 6
"""Largest number of root locus panels: three rows of two panels."""

_FAR: Final = 2.5
"""Largest visible distance from 0 in Nyquist's plane, and from 1 in a step response. An open loop
with an integrator, and an unstable response, have no bound."""

_BESIDE: Final = 0.4
"""Smallest visible part of Nyquist's plane above 0 and to the right of 0."""

_NO_OVERSHOOT: Final = 0.05
"""Smallest overshoot in the shown digits [%]."""

_DECADES_BELOW: Final = 2.0
"""Number of decades below the crossover at which a frequency response begins."""

_WIDER: Final = 1.2
"""Additional width of each loop of a run below the other loops [points]. If two loops coincide, the
lower one is visible on both sides."""

_DASH_POINTS: Final = 1.6
"""Width of a line to which dashes are scaled [points]."""

_LARGER: Final = 2.2
"""Additional size of the lower loops' marks [points]."""

_MOST_TOLD: Final = 6

_PLANE_INCH: Final = 2.1
"""Smallest width of a plane of poles with its text [inch]; three such planes fit into a row of a
page."""
_LINE_SHARE: Final = 0.45
"""Height of the axis of ideal poles, as a share of the height of a plane."""
_ROOM_INCH: Final = 0.42
"""Height of the text above and below a plane [inch]."""

_MIRRORED: Final = fix_style(linewidth=0.5, linestyle=":")

_MOST_SAMPLES: Final = 20_000
"""Largest number of samples of a step response: more than a page resolves."""

_LONGEST: Final = 5.0
"""Largest length of the axis of step responses, as a multiple of their median. One loop near its
limit of stability would hide the others. The slowest of the paper's gains takes less."""

_UNSTABLE_LENGTH: Final = 40.0
"""Drawn length of an unstable response, as a multiple of dead time plus sampling period."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _LoopCurve:
    """One loop to draw."""

    run: str  # name of the run; empty if there is only one
    is_many: bool  # whether a colour bar names the runs, because there are many
    layer: int  # index of the loop in its law; loop 0 is on top
    model: theory.LoopModel  # model of the loop in theory
    found: theory.PidLoop  # properties of the loop
    run_looks: Mapping[str, Any]  # colour and marker of the run

    @property
    def color(self) -> Any:
        """Colour of the loop's run."""
        return self.run_looks["color"]

    @property
    def looks(self) -> dict[str, Any]:
        """Colour and marker of the run, dashes and width of the loop."""
        width = (0.8 if self.is_many else 1.1) + _WIDER * self.layer
        order = 2.6 - 0.3 * self.layer
        dashes = STROKES[LOOP_DASHES[self.layer % len(LOOP_DASHES)]]
        if self.layer % len(LOOP_DASHES):
            # matplotlib scales dashes by the line's width: two dashes must fit into a legend.
            dashes = (0, tuple(_DASH_POINTS / width * part for part in dashes[1]))
        own = {"linestyle": dashes, "linewidth": width, "zorder": order}
        return {**self.run_looks, **own}

    @property
    def mark(self) -> dict[str, Any]:
        """Style of a single point; a ring for a lower loop."""
        looks: dict[str, Any] = {"color": self.color, "ms": 3.5 + _LARGER * self.layer, "zorder": 3}
        return looks | ({"mfc": "none", "mew": 0.9} if self.layer else {})

    def tell_gain(self) -> str:
        """Return Kp as text, and whether theory's loop is unstable with this Kp."""
        verdict = "" if self.found.stable else " (unstable)"
        return f"Kp = {self.found.gains.kp:g}{verdict}"

    def label(self, tell: Callable[[theory.PidLoop], str]) -> str:
        """Return a legend entry: the run, the loop, and the text of `tell`."""
        if self.is_many:
            return self.run
        return f"{self.run} {self.model.loop.name}".strip() + f": {tell(self.found)}"


def find_lack_of_theory(runs: Sequence[Run]) -> str:
    """Return why theory has no loop; empty if it has a loop."""
    models = [model for run in runs for model in model_run_loops(run)]
    if theory.list_known(models):
        return ""
    reasons = [model.reason for model in models]
    return f"a loop that theory knows ({reasons[0]})" if reasons else "a law that declares a loop"


def draw_bode(figure: Figure, runs: Sequence[Run]) -> None:
    """Draw magnitude and phase of the open loops, with their margins marked."""
    size, phase = figure.subplots(2, 1, sharex=True)
    size.axhline(0.0, **REFERENCE)
    phase.axhline(-180.0, **REFERENCE)
    curves = _style_loops(runs)
    for curve, label in zip(curves, _name_loops(size, curves, _tell_margins), strict=True):
        frequencies = _list_frequencies(curve.found)
        values = _respond(curve.model, frequencies)
        turned = _unwrap_degrees(values)
        size.semilogx(frequencies, _to_db(np.abs(values)), label=label, **curve.looks)
        phase.semilogx(frequencies, turned, **curve.looks)
        _mark_margins(size, phase, curve, frequencies, turned)
    ends = sorted({math.pi / curve.found.period_s for curve in curves})
    for axes in (size, phase):
        _draw_ends(axes, ends)
    _name_margins(size)
    size.set_ylabel("magnitude [dB]")
    phase.set(xlabel="frequency [rad/s]", ylabel="phase [deg]")
    phase.set_ylim(max(phase.get_ylim()[0], -450.0), None)
    phase.yaxis.set_major_locator(MultipleLocator(90.0))
    _tell_equal_phases(phase, curves)


def _tell_equal_phases(axes: Axes, curves: Sequence[_LoopCurve]) -> None:
    """Write which runs have the same curve, because Kp alone does not change the phase."""
    told = [
        f"{len(group)} runs have one phase of {group[0].model.loop.name}"
        f" ({1e3 * group[0].found.dead_time_s:.4g} ms)"
        for group in _group_loci(curves)
        if len(group) > 1
    ]
    looks: dict[str, Any] = {"fontsize": 7.0, "color": "0.35", "va": "bottom"}
    axes.text(0.01, 0.03, "\n".join(told[:_MOST_TOLD]), transform=axes.transAxes, **looks)


def draw_nyquist(figure: Figure, runs: Sequence[Run]) -> None:
    """Draw the open loops in the complex plane, with the unit circle and the point -1."""
    axes = figure.subplots()
    _draw_unit_circle(axes)
    curves = _style_loops(runs)
    furthest = np.zeros(2)
    for curve, label in zip(curves, _name_loops(axes, curves, _tell_margins), strict=True):
        values = _respond(curve.model, _list_frequencies(curve.found))
        furthest = np.maximum(furthest, [values.real.max(), values.imag.max()])
        axes.plot(values.real, values.imag, label=label, **curve.looks)
        axes.plot(values.real, -values.imag, color=curve.color, **_MIRRORED)
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

    The first panel shows the ideal loop in the s plane, if the plant is 1/s and the law
    proportional. The others show the sampled loops in the z plane.
    """
    curves = _style_loops(runs)
    names = _name_poles(runs, curves)
    ideal = _list_ideal_poles(runs, names)
    draw = [partial(figure_curves.draw_ideal_locus, poles=ideal)] if ideal else []
    draw += [partial(_draw_locus, group=group, names=names) for group in _group_loci(curves)]
    if len(draw) > _MOST_LOCI:
        note = f"the first {_MOST_LOCI} of {len(draw)} loci, by dead time"
        figure.supxlabel(note, fontsize=7.0, color="0.4")
        draw = draw[:_MOST_LOCI]
    planes = draw[bool(ideal) :]
    columns = min(len(planes), int(figure.get_figwidth() / _PLANE_INCH)) or 1
    rows = -(-len(planes) // columns)
    heights = [_LINE_SHARE] * bool(ideal) + [1.0] * rows
    _set_height(figure, sum(heights), columns)
    grid = figure.add_gridspec(len(heights), columns, height_ratios=heights)
    if ideal:
        draw[0](figure.add_subplot(grid[0, :]))
    for number, draw_plane in enumerate(planes):
        axes = figure.add_subplot(grid[number // columns + bool(ideal), number % columns])
        draw_plane(axes)
        if number % columns:
            axes.set_ylabel("")


def _set_height(figure: Figure, rows: float, columns: int) -> None:
    """Set the height of a figure for square planes."""
    width = float(figure.get_figwidth())
    plane_inch = min(width / columns, 0.5 * width)
    figure.set_size_inches(width, plane_inch * rows + _ROOM_INCH * (rows + 0.5))


def find_ideal_gains(runs: Sequence[Run]) -> tuple[float, ...]:
    """Return the gains of proportional loops on a plant 1/s; without runs, the paper's gains."""
    ideal = [run for run in runs if find_plant(run).name != LAGGED]
    return figure_curves.find_gains(ideal) if ideal or not runs else ()


def _list_ideal_poles(runs: Sequence[Run], names: Mapping[str, str]) -> list[figure_curves.Pole]:
    """Return the poles of ideal loops, in the colours of their runs."""
    if not runs:
        return figure_curves.list_paper_poles()
    styled = zip(runs, names.values(), choose_run_lines(runs), strict=True)
    return [
        figure_curves.Pole(values=np.array([-kp]), looks=looks, label=name)
        for run, name, looks in styled
        for kp in find_ideal_gains([run])
    ]


def _name_poles(runs: Sequence[Run], curves: Sequence[_LoopCurve]) -> dict[str, str]:
    """Return the legend text of each run's poles by the name of the run: its gains."""
    found: dict[str, str] = {}
    for name in _name_styled(runs):
        own = [curve for curve in curves if curve.run == name]
        told = [(curve.model.loop.name, curve.tell_gain()) for curve in own]
        gains = {gain for _, gain in told}
        words = ", ".join([*gains] if len(gains) == 1 else [f"{loop} {kp}" for loop, kp in told])
        is_short = len(runs) > MANY or not words
        found[name] = name if is_short else f"{name}: {words}" if name else words
    return found


def draw_step(figure: Figure, runs: Sequence[Run]) -> None:
    """Draw the sampled loops' responses to a reference step, without limits."""
    axes, curves = figure.subplots(), _style_loops(runs)
    lasting_s = [_choose_duration(curve.found) for curve in curves]
    last_s = min(max(lasting_s), _LONGEST * float(np.median(lasting_s)))
    axes.axhspan(0.98, 1.02, color="0.92", zorder=0.5, label="2 % band")
    axes.axhline(1.0, **REFERENCE)
    lowest, highest = 0.0, 1.0
    for curve, label in zip(curves, _name_loops(axes, curves, _tell_step), strict=True):
        gains, settings = curve.model.require()
        count = min(math.ceil(last_s / curve.found.period_s) + 2, _MOST_SAMPLES)
        values = _cut_where_far(theory.compute_pid_step_response(gains, count, **settings))
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
    return [
        _LoopCurve(
            run=name,
            is_many=len(runs) > MANY,
            layer=layers[model.loop.name],
            model=model,
            found=model.analyse(),
            run_looks=looks,
        )
        for name, models, looks in zip(
            _name_styled(runs), known, choose_run_lines(runs), strict=True
        )
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
    """Return the margins as short legend text."""
    margins = found.margins
    if margins is None:
        return "unstable"
    words = []
    if margins.gain_margin is not None:
        words.append(f"GM {_to_db(margins.gain_margin):.1f} dB")
    if margins.phase_margin_rad is not None:
        words.append(f"PM {math.degrees(margins.phase_margin_rad):.1f}°")
    return ", ".join(words) or "stable"


def _tell_step(found: theory.PidLoop) -> str:
    """Return overshoot and settling time as short legend text."""
    if not found.stable:
        return "unstable"
    if found.overshoot_percent is None or found.settling_time_s is None:
        return "stable"
    percent = found.overshoot_percent
    overshoot = f"overshoot {percent:.1f} %" if percent >= _NO_OVERSHOOT else "no overshoot"
    return f"{overshoot}, settles in {found.settling_time_s:.3g} s"


def _list_frequencies(found: theory.PidLoop) -> Values:
    """Return frequencies [rad/s] around the crossover, up to pi / T."""
    highest = math.pi / found.period_s
    crossover = found.gains.kp * found.process.gain
    if found.margins is not None and found.margins.crossover_rad_s is not None:
        crossover = found.margins.crossover_rad_s
    lowest = min(crossover, highest) / 10.0**_DECADES_BELOW
    return np.geomspace(lowest, highest, _POINTS)


def _respond(model: theory.LoopModel, frequencies: Values) -> NDArray[np.complex128]:
    gains, settings = model.require()
    return theory.compute_open_loop(gains, frequencies, **settings)


def _unwrap_degrees(values: NDArray[np.complex128]) -> Values:
    """Return a phase [deg] that begins between -360 and 0 deg."""
    turned = np.degrees(np.unwrap(np.angle(values)))
    return np.asarray(turned - 360.0 * np.ceil(turned[0] / 360.0))


def _to_db(size: Any) -> Any:
    return 20.0 * np.log10(size)


def _draw_ends(axes: Axes, frequencies: Sequence[float]) -> None:
    """Draw the largest frequency of sampled loops."""
    for frequency in frequencies:
        looks = {**REFERENCE, "linestyle": STROKES["dotted"]}
        axes.axvline(frequency, **looks, label="π / T, the highest frequency", zorder=1.2)


def _name_margins(axes: Axes) -> None:
    """Add legend entries for the marks of all loops, without colour."""
    for marker, name in (("o", "phase margin (PM)"), ("s", "gain margin (GM)")):
        axes.plot([], [], marker, ms=3.5, color="0.35", label=name)


def _mark_margins(
    size: Axes,
    phase: Axes,
    curve: _LoopCurve,
    frequencies: Values,
    turned: Values,
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
        turned_at = float(np.interp(at, frequencies, turned))
        phase.plot(at, turned_at, "s", **curve.mark)


def _draw_unit_circle(axes: Axes) -> None:
    angles = np.linspace(0.0, 2.0 * math.pi, 361)
    axes.plot(np.cos(angles), np.sin(angles), **REFERENCE, label="unit circle")


def _group_loci(curves: Sequence[_LoopCurve]) -> list[list[_LoopCurve]]:
    """Return groups of loops that differ only in Kp."""
    groups: dict[Any, list[_LoopCurve]] = {}
    for curve in curves:
        found = curve.found
        held = replace(found.gains, kp=1.0)
        key = (held, found.process, found.period_s, curve.model.loop.name)
        groups.setdefault(key, []).append(curve)
    return list(groups.values())


def _draw_locus(axes: Axes, group: Sequence[_LoopCurve], names: Mapping[str, str]) -> None:
    """Draw the poles for increasing Kp, up to 1.5 times the largest relevant Kp."""
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
    marked = [
        figure_curves.Pole(values=curve.found.poles, looks=curve.run_looks, label=names[curve.run])
        for curve in group
    ]
    figure_curves.draw_poles(axes, marked)
    dead_time = f"{1e3 * first.found.dead_time_s:.4g} ms"
    axes.set_title(f"{first.model.loop.name}\ndead time {dead_time}")
    axes.set(xlabel="real part of z", ylabel="imaginary part of z", aspect="equal")
    axes.set(xlim=(-1.2, 1.2), ylim=(-1.2, 1.2))


def _cut_where_far(values: Values) -> Values:
    """Return a response, cut where it leaves the axes, as unstable responses do."""
    beyond = np.abs(values - 1.0) > _FAR
    if not beyond.any():
        return values
    return np.where(np.arange(len(values)) > beyond.argmax(), np.nan, values)


def _choose_duration(found: theory.PidLoop) -> float:
    """Return the drawn duration of a step response [s]."""
    if found.settling_time_s is not None:
        return 1.4 * found.settling_time_s
    if found.stable:
        return 1000.0 * found.period_s
    return _UNSTABLE_LENGTH * (found.dead_time_s + found.period_s)
