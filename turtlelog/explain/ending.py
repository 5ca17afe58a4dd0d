"""What happened between the phases, and at the end."""

from typing import Any

import numpy as np

from turtlelog.angles import subtract_headings
from turtlelog.explain.finding import Finding, find_exactly, miss
from turtlelog.explain.loop import Hints
from turtlelog.explain.trace import Trace

_STANDSTILL_SAMPLES = 100
_STANDSTILL_COMMAND = 0.001  # [m/s] and [rad/s]
_SETTLED_ERROR_M = 0.01
_SETTLED_NS = 5_000_000_000
_TIMEOUT_NS = 30_000_000_000


def find_pause(trace: Trace, hints: Hints) -> dict[str, Finding]:
    """Return how long the controller was silent after rotating, and what the robot did meanwhile.

    The rotation's last command but one is held, unless the silence ends before the queue is empty.
    """
    keys = ("pause.seconds", "pause.held_turn_rate_rad_s", "pause.turned_rad", "pause.burst")
    if hints.pause_s is None:
        return dict.fromkeys(keys, miss("the log does not show the end of a rotation"))
    ended = trace.rotating - 1
    turned = subtract_headings(float(trace.heading_rad[-1]), float(trace.heading_rad[ended]))
    return {
        "pause.seconds": find_exactly(hints.pause_s, "from the last answer to the next one"),
        "pause.held_turn_rate_rad_s": find_exactly(
            float(trace.turn_rate_rad_s[ended - 1]), "the last command before the rotation's end"
        ),
        "pause.turned_rad": find_exactly(
            float(turned), "heading at the end, less at the rotation's"
        ),
        "pause.burst": find_exactly(hints.burst, "poses answered at once after it"),
    }


def find_stop_reason(trace: Trace) -> Finding:
    """Return which of the law's rules the last sample meets, in the law's word, or `cut`."""
    speed = trace.speed_m_s[trace.rotating :]
    if not len(speed):
        return find_exactly("cut", "the log ends while the robot rotates")
    if speed[-1] == 0.0:
        return find_exactly("within_tolerance", "the last command is 0")
    still = _count_trailing(np.abs(speed) < _STANDSTILL_COMMAND)
    if still > _STANDSTILL_SAMPLES:
        return find_exactly("standstill", f"{still} samples below {_STANDSTILL_COMMAND:g} m/s")
    close_s = _find_close_s(trace)
    if close_s > _SETTLED_NS / 1e9:
        return find_exactly(
            "settled", f"both errors below {_SETTLED_ERROR_M:g} m for {close_s:.2f} s"
        )
    length_ns = int(trace.time_ns[-1] - trace.time_ns[0])
    if length_ns > _TIMEOUT_NS:
        return find_exactly("timeout", f"{length_ns / 1e9:.2f} s after the first sample")
    return find_exactly("cut", "no rule of the law ends the run at the last sample")


def _find_close_s(trace: Trace) -> float:
    if trace.goal_xy_m is None:
        return 0.0
    errors = np.abs(np.subtract(trace.goal_xy_m, trace.xy_m[trace.rotating :]))
    close = _count_trailing((errors < _SETTLED_ERROR_M).all(axis=1))
    return float(trace.time_ns[-1] - trace.time_ns[len(trace) - close]) / 1e9 if close else 0.0


def _count_trailing(holds: Any) -> int:
    return len(holds) if holds.all() else int((~holds[::-1]).argmax())
