"""The ideal loop: the step that each loop answers, and the ideal response as a curve."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from turtlelog.charts.curves import Curve, Values, list_loops, read_curve
from turtlelog.measure import find_first_stretch, find_signal, read_reference
from turtlelog.run import Run
from turtlelog.run.loops import ControlLoop
from turtlelog.theory import compute_step_response

_ALONG: Final = ("along_track",)
_DRIVEN_BY: Final[Mapping[str, tuple[str, ...]]] = {
    "heading": ("heading",),
    "heading_error": ("heading",),
    **dict.fromkeys(("x", "y", "error_x", "error_y", "along_track"), _ALONG),
    **dict.fromkeys(("world_velocity_x", "world_velocity_y"), _ALONG),
    "distance": ("along_track", "distance"),
}
"""Signals of the loops that determine the ideal response of a curve; along the line, all are
equal."""

_ERRORS: Final = frozenset(
    {"heading_error", "error_x", "error_y", "distance", "world_velocity_x", "world_velocity_y"}
)


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopStep:
    """The step of a loop that theory can model.

    Attributes:
        loop: Loop of the step.
        kp: Proportional gain [1/s].
        start_ns: Start of the loop's first segment, in the run's time [ns].
        end_ns: End of this segment with its pause [ns].
        initial: Value of the signal at the start of the segment [deg or m].
        reference: Reference of the signal [deg or m]. A heading is shifted by full turns so that it
            is nearest to the value at the end of the segment.
    """

    loop: ControlLoop
    kp: float
    start_ns: int
    end_ns: int
    initial: float
    reference: float

    def respond(
        self, time_s: ArrayLike, *, initial: float | None = None, target: float | None = None
    ) -> Values:
        """Return the ideal response at times from the start of the segment [s], shape (n,).

        `initial` and `target` belong to another signal that the loop drives, and have its unit.
        """
        return compute_step_response(
            self.kp,
            time_s,
            initial=self.initial if initial is None else initial,
            reference=self.reference if target is None else target,
        )


def find_steps(run: Run, signal_name: str) -> Iterator[LoopStep]:
    """Yield the step of each loop of a signal that theory can model, in declared order.

    The reference is constant, the signal integrates the command, and the gain is known.
    """
    signal = find_signal(run, signal_name)
    for loop in list_loops(run, signal_name):
        if loop.moves or not loop.has_theory:
            continue
        kp, stretch = loop.read_gain(run.parameters), find_first_stretch(run, loop)
        reference = read_reference(run, loop)
        if signal is None or kp is None or not stretch or not isinstance(reference, float):
            continue
        start_ns, end_ns = stretch[0].start_ns, stretch[-1].end_ns
        rows = np.searchsorted(signal.time_ns, [start_ns, end_ns])
        initial, last = signal.values[np.minimum(rows, len(signal.values) - 1)].tolist()
        if signal.kind.unit == "rad":
            reference += round((last - reference) / (2.0 * np.pi)) * 2.0 * np.pi
            initial, reference = float(np.degrees(initial)), float(np.degrees(reference))
        yield LoopStep(
            loop=loop,
            kp=kp,
            start_ns=start_ns,
            end_ns=end_ns,
            initial=initial,
            reference=reference,
        )


def compute_ideals(run: Run, signal_name: str) -> list[Curve]:
    """Return the ideal responses of a signal for loops with the same gains.

    Each response starts with the value and time of its loop. The result is None if no loop of
    theory drives the signal, the reference moves, or the gain or the goal is unknown.
    """
    measured = read_curve(run, signal_name)
    if measured is None or signal_name not in _DRIVEN_BY:
        return []
    steps = [step for driven in _DRIVEN_BY[signal_name] for step in find_steps(run, driven)]
    # An along-track loop brings other signals to their final values only if its target is the goal.
    elsewhere = {"along_track"} - {signal_name}
    found = [
        _compute_ideal(run, signal_name, measured, step)
        for step in steps
        if step.loop.signal not in elsewhere or step.loop.reference == "goal_distance"
    ]
    return [curve for curve in found if curve is not None]


def _compute_ideal(run: Run, signal_name: str, measured: Curve, step: LoopStep) -> Curve | None:
    target = _find_target(run, signal_name, step)
    start_s = (step.start_ns - run.start_ns) / 1e9
    after = measured.time_s >= start_s
    if target is None or not after.any():
        return None
    initial = float(measured.values[after][0])
    values = step.respond(measured.time_s[after] - start_s, initial=initial, target=target)
    return Curve(start_ns=run.start_ns, time_ns=measured.time_ns[after], values=values)


def _find_target(run: Run, signal_name: str, step: LoopStep) -> float | None:
    """Return the final value of a signal under a loop, in the unit of the signal's curve."""
    if signal_name in _ERRORS:
        return 0.0
    if signal_name in ("x", "y"):
        return None if run.goal_xy_m is None else run.goal_xy_m["xy".index(signal_name)]
    return step.reference
