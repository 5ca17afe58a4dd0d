"""Where a trace breaks: jumps that no command explains, and rows that are missing."""

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.explain.trace import Trace, Values, estimate_trace_noise
from turtlelog.plants import LAGGED, find_plant
from turtlelog.run import Run
from turtlelog.run.angles import subtract_headings
from turtlelog.run.loops import PLANT_KEYS, read_number

_NOISE_STEPS: Final = 8.0
"""Standard deviations of noise beyond which a step is a jump: once in 1e15 steps without one."""

_ROUNDING: Final = 1e-5
"""What the 32-bit rounding of two poses cannot explain [m, rad]."""

_NEAR_ROWS: Final = 3
"""Steps on either side that say how far the robot moves in one."""

_MOVES: Final = 4.0
"""Standard deviations from which on a motion says how many steps it took."""

_CAUGHT_UP: Final = 0.5
"""A step shorter than this share of the usual one follows a callback that was only late."""

_FAR_TICKS: Final = 1000
"""Ticks put where nobody knows how many passed: further than any dead time reaches."""


def mark_breaks(trace: Trace) -> Trace:
    """Return the trace with its jumps, and with numbers that leave out what is missing."""
    jumps = _find_jumps(trace)
    number = trace.number if trace.has_ticks else _number_rows(trace, jumps)
    return replace(trace, jumps=jumps, number=number)


def list_breaks(trace: Trace) -> list[int]:
    """Return the rows at which a new stretch begins: after a jump, or after missing rows."""
    return sorted({*trace.jumps, *(row for row, _ in trace.missing)})


def describe_breaks(trace: Trace) -> list[str]:
    """Return jumps, missing rows and misread poses in sentences; of many the first."""
    found = []
    if trace.jumps:
        row = trace.jumps[0]
        moved, turned = _measure_steps(trace)
        way = f"{moved[row - 1]:.3g} m and {np.degrees(turned[row - 1]):.3g} deg"
        more = _count_more(len(trace.jumps))
        found.append(f"the pose jumps by {way} at {_find_time_s(trace, row):.3f} s{more}")
    if trace.missing:
        row, amount = trace.missing[0]
        noun = "sample is" if amount == 1 else "samples are"
        at_s = _find_time_s(trace, row - 1)
        length_s = _find_time_s(trace, row) - at_s
        more = _count_more(len(trace.missing))
        found.append(f"{amount} {noun} missing after {at_s:.3f} s, for {length_s:.3f} s{more}")
    if not np.array_equal(trace.read_xy_m, trace.xy_m) or not np.array_equal(
        trace.read_heading_rad, trace.heading_rad
    ):
        off_m = float(np.hypot(*(trace.read_xy_m - trace.xy_m).T).max())
        off_rad = np.abs(subtract_headings(trace.read_heading_rad, trace.heading_rad)).max()
        off = f"{off_m:.3g} m and {np.degrees(off_rad):.3g} deg"
        found.append(f"the poses that the controller read are off the plant's by up to {off}")
    return found


def space_out(trace: Trace) -> Run:
    """Return the run with poses at the ticks that their numbers say, and jumps far apart.

    What reads motion then knows across which steps it may look. The run itself where no row is
    missing and no pose jumps.
    """
    run = trace.run
    if not list_breaks(trace):
        return run
    if trace.has_ticks:
        time_ns = run.poses.time_ns.copy()
        for row in trace.jumps:
            time_ns[run.samples.pose_sequence[row] :] += _FAR_TICKS * trace.tick_ns
        return replace(run, poses=replace(run.poses, time_ns=time_ns))
    ticks = trace.number * trace.period_ticks
    for row in (trace.rotating, *trace.jumps):
        ticks[row:] += _FAR_TICKS
    return replace(run, poses=replace(run.poses, time_ns=ticks * trace.tick_ns))


def _find_jumps(trace: Trace) -> tuple[int, ...]:
    """Return the rows whose pose no command can have reached from the one before."""
    if len(trace) < 2:
        return ()
    ticks = np.maximum(np.rint(np.diff(trace.pose_time_ns) / trace.tick_ns), 1.0) + 1.0
    moved, turned = _measure_steps(trace)
    speed, turn_rate = _find_fastest(trace)
    reach_m, reach_rad = (ticks * (trace.tick_ns / 1e9) * rate for rate in (speed, turn_rate))
    is_jump = moved > reach_m + _find_slack(trace.xy_m, trace.grain_m)
    unwrapped = np.unwrap(trace.heading_rad)[:, None]
    is_jump |= turned > reach_rad + _find_slack(unwrapped, trace.grain_rad)
    return tuple((np.flatnonzero(is_jump) + 1).tolist())


def _find_fastest(trace: Trace) -> tuple[float, float]:
    """Return the largest speed [m/s] and turn rate [rad/s] that the robot can have had."""
    run = trace.run
    speed, turn_rate = (float(np.abs(v).max()) for v in (trace.speed_m_s, trace.turn_rate_rad_s))
    if find_plant(run).name != LAGGED:
        return speed, turn_rate
    gains = [
        max(
            abs(read_number(run.parameters, f"{PLANT_KEYS[name]}{of}gain", default))
            for of, default in (("", 1.0), ("reverse_", 0.0))
        )
        for name in ("speed", "turn_rate")
    ]
    shown = [run.poses.speed_m_s, run.poses.turn_rate_rad_s]
    fastest = [
        max(rate * gain, _find_largest(values))
        for rate, gain, values in zip((speed, turn_rate), gains, shown, strict=True)
    ]
    return fastest[0], fastest[1]


def _find_largest(values: Values | None) -> float:
    return 0.0 if values is None else float(np.abs(values).max())


def _number_rows(trace: Trace, jumps: tuple[int, ...]) -> NDArray[np.int64]:
    """Return the number of each row among those that the controller must have had.

    A long step of the clock hides rows if the robot moved as far as in several steps, or stood.
    """
    step_ns = np.diff(trace.time_ns)
    usual_ns = trace.period_ticks * trace.tick_ns
    steps = np.rint(step_ns / usual_ns).astype(np.int64)
    is_late = np.append(step_ns[1:] < _CAUGHT_UP * usual_ns, False)
    rows = set(np.flatnonzero((steps > 1) & ~is_late).tolist())
    rows -= {trace.rotating - 1, *(row - 1 for row in jumps)}
    number = np.ones(len(trace), dtype=np.int64)
    number[0] = 0
    moved, turned = _measure_steps(trace)
    least_m = _MOVES * np.sqrt(2.0) * estimate_trace_noise(trace.xy_m) + trace.grain_m
    unwrapped = np.unwrap(trace.heading_rad)[:, None]
    least_rad = _MOVES * np.sqrt(2.0) * estimate_trace_noise(unwrapped) + trace.grain_rad
    for row in sorted(rows):
        near = [
            step
            for step in range(max(row - _NEAR_ROWS, 0), min(row + _NEAR_ROWS + 1, len(steps)))
            if step not in rows and step != trace.rotating - 1
        ]
        shares = [
            float(done[row] / np.median(done[near]))
            for done, least in ((moved, least_m), (turned, least_rad))
            if near and np.median(done[near]) > least
        ]
        # One step's way in a long time: the callback was late, and no row is missing.
        if not shares or max(shares) > 1.5:
            number[row + 1] = steps[row]
    return np.cumsum(number)


def _count_more(amount: int) -> str:
    return f", and {amount - 1} more" if amount > 1 else ""


def _find_time_s(trace: Trace, row: int) -> float:
    return float(trace.time_ns[row] - trace.run.start_ns) / 1e9


def _measure_steps(trace: Trace) -> tuple[Values, Values]:
    moved = np.hypot(*np.diff(trace.xy_m, axis=0).T)
    turned = np.abs(subtract_headings(trace.heading_rad[1:], trace.heading_rad[:-1]))
    return moved, turned


def _find_slack(values: Values, grain: float) -> float:
    return (
        _NOISE_STEPS * float(np.sqrt(2.0)) * estimate_trace_noise(values) + 2.0 * grain + _ROUNDING
    )
