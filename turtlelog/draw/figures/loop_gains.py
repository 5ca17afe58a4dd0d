"""The gain of each loop in runs, and theory's limits of it for the dead time that they show."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.charts.ideal_curves import find_steps
from turtlelog.measure import model_run_loops
from turtlelog.run import Run
from turtlelog.run.loops import ControlLoop
from turtlelog.theory import PidGains, Process, find_stable_gains
from turtlelog.theory.exact_gains import LoopDesign, find_p_without_overshoot

Values = NDArray[np.float64]

_ALIKE: Final = 0.02
"""Share by which steps may differ to have one curve of settling times: it would be off by as much,
which is the half-width of the settling band."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GainLimits:
    """Theory's limits of Kp for one timing.

    Attributes:
        dead_time_s: All dead time of the loop [s].
        period_s: Its sampling period [s].
        overshoot: Kp from which it overshoots [1/s]; None where the loop is not proportional.
        stability: Kp from which it is unstable [1/s]; None where no Kp is stable.
        design: To compute responses with.
        gains: Of one of its runs, at which the limits hold besides Kp.
    """

    dead_time_s: float
    period_s: float
    overshoot: float | None
    stability: float | None
    design: LoopDesign
    gains: PidGains


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopGains:
    """A loop's gain in each run.

    Attributes:
        name: Of the loop.
        gains: Kp [1/s], one for each run; NaN where it is not known.
        limits: Of theory, one for each timing, in the order of dead times.
        step: Size of the step and limit of the command, in rad or m and per second; None where
            runs differ in them, or theory does not know the loop.
    """

    name: str
    gains: Values
    limits: tuple[GainLimits, ...]
    step: tuple[float, float] | None = None


def find_loop_gains(runs: Sequence[Run]) -> list[LoopGains]:
    """Return the loops of runs that have a known gain, with theory's limits for each."""
    names = dict.fromkeys(loop.name for run in runs for loop in run.declaration.loops)
    found = [_find_loop(name, runs) for name in names]
    return [loop for loop in found if np.isfinite(loop.gains).any()]


def _find_loop(name: str, runs: Sequence[Run]) -> LoopGains:
    gains: list[float] = []
    limits: dict[object, GainLimits] = {}
    for run in runs:
        gains.append(_read_gain(run.declaration.find_loop(name), run))
        for model in model_run_loops(run):
            if model.loop.name != name or not math.isfinite(gains[-1]):
                continue
            if model.reason:
                continue
            pid, settings = model.require()
            process, period_s = settings["process"], settings["period_s"]
            # Times of a real loop differ by less than is known of them.
            key = (round(process.dead_time_s, 4), round(period_s, 4), replace(pid, kp=1.0))
            if key not in limits:
                limits[key] = _compute_limits(pid, process, period_s)
    order = sorted(limits.values(), key=lambda one: (one.dead_time_s, one.period_s))
    return LoopGains(
        name=name, gains=np.array(gains), limits=tuple(order), step=_find_step(name, runs)
    )


def _find_step(name: str, runs: Sequence[Run]) -> tuple[float, float] | None:
    """Return the step that all runs answer, and the limit of its command."""
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


def _read_gain(loop: ControlLoop | None, run: Run) -> float:
    gain = None if loop is None else loop.read_gain(run.parameters)
    return math.nan if gain is None or gain <= 0.0 else float(gain)


def _compute_limits(pid: PidGains, process: Process, period_s: float) -> GainLimits:
    design = LoopDesign(process=process, period_s=period_s, filter_s=pid.filter_s)
    is_proportional = not pid.ki and not pid.kd
    overshoot = find_p_without_overshoot(design) if is_proportional else None
    if is_proportional:
        stability: float | None = design.find_ultimate_gain()
    else:
        ranges = find_stable_gains(pid, period_s=period_s, process=process)
        stability = ranges[-1][1] if ranges else None
    return GainLimits(
        dead_time_s=process.dead_time_s,
        period_s=period_s,
        overshoot=overshoot,
        stability=stability,
        design=design,
        gains=pid,
    )
