"""Figures of the ideal loop: the plant's responses, the closed loop's, its root locus."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from matplotlib.figure import Figure

from turtlelog.run import Run
from turtlelog.show.aims import find_gain, has_response
from turtlelog.show.figures.page import REFERENCE, choose_lines
from turtlelog.theory import (
    PLANT_INPUTS,
    compute_closed_loop_response,
    compute_plant_response,
    compute_root_locus,
    compute_settling_time,
    compute_step_response,
    find_plant_final_value,
)

PAPER_GAINS: Final = (1.0, 2.0, 4.0, 10.0)
_LAST_S: Final = 5.0


def draw_plant_responses(figure: Figure, runs: Sequence[Run]) -> None:  # noqa: ARG001
    """Draw the plant 1/s answering an impulse, a step and a ramp."""
    time_s = np.linspace(0.0, _LAST_S, 201)
    for axes, kind in zip(figure.subplots(1, 3), PLANT_INPUTS, strict=True):
        axes.plot(time_s, compute_plant_response(kind, time_s), **choose_lines(1)[0])
        end = "unbounded" if find_plant_final_value(kind).value is None else "bounded"
        axes.set(xlabel="time [s]", title=f"{kind}: {end}", xlim=(0.0, _LAST_S), ylim=(0.0, None))
    figure.axes[0].set(ylabel="response of 1/s", ylim=(0.0, 1.25))


def draw_step_responses(figure: Figure, runs: Sequence[Run]) -> None:
    """Draw the closed loop's step response for each gain, with the 2 % band and 4 tau marked."""
    axes, gains = figure.subplots(), find_gains(runs)
    last_s = 1.25 * compute_settling_time(min(gains))
    time_s = np.linspace(0.0, last_s, 601)
    axes.axhspan(0.98, 1.02, color="0.92", zorder=0.5, label="2 % band")
    axes.axhline(1.0, **REFERENCE)
    for gain, looks in zip(gains, choose_lines(len(gains)), strict=True):
        values = compute_closed_loop_response(gain, time_s)
        axes.plot(time_s, values, label=f"Kp = {gain:g}", **looks)
        settled_s = compute_settling_time(gain)
        level = compute_step_response(gain, np.array([settled_s]))
        label = "4 τ" if gain == gains[-1] else None
        axes.plot(settled_s, level, "o", ms=3.5, color=looks["color"], label=label)
    axes.set(xlabel="time [s]", ylabel="response to a unit step", xlim=(0.0, last_s), ylim=(0, 1.1))


def draw_root_locus(figure: Figure, runs: Sequence[Run]) -> None:
    """Draw the closed loop's pole s = -Kp, from the plant's at the origin leftward."""
    axes, gains = figure.subplots(), find_gains(runs)
    left = -1.25 * max(gains)
    axes.axvspan(0.0, -0.24 * left, color="0.94", zorder=0.5)
    axes.text(-0.12 * left, 0.82, "unstable", ha="center", fontsize=7.0, color="0.4")
    axes.plot([0.0, left], [0.0, 0.0], color="0.3", label="s = -Kp")
    axes.plot([0.0], [0.0], "x", color="black", ms=6.0, mew=1.4, label="pole of 1/s", zorder=3)
    poles = compute_root_locus(gains)
    for gain, pole, looks in zip(gains, poles, choose_lines(len(gains)), strict=True):
        axes.plot(
            [pole.real], [pole.imag], "o", ms=4.5, color=looks["color"], label=f"Kp = {gain:g}"
        )
    axes.set(xlabel="real part [1/s]", ylabel="imaginary part [1/s]", xlim=(left, -0.24 * left))
    axes.set_ylim(-1.0, 1.0)


def find_gains(runs: Sequence[Run]) -> tuple[float, ...]:
    """Return the gains of the loops that are theory's in rising order; without runs the paper's."""
    if not runs:
        return PAPER_GAINS
    found = {
        find_gain(run, loop) for run in runs for loop in run.declaration.loops if has_response(loop)
    }
    return tuple(sorted(gain for gain in found if gain is not None))
