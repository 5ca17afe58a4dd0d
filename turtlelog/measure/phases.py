"""The stretch of a run that a phase's metrics are computed on."""

from dataclasses import dataclass
from itertools import dropwhile, takewhile

import numpy as np
from numpy.typing import NDArray

from turtlelog.measure.metric import Missing, Status
from turtlelog.measure.signals import read_signal
from turtlelog.run import Phase, PhaseSpan, Run

Values = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Response:
    """How the controlled coordinate of a phase answers its reference.

    Attributes:
        time_s: From the start of the phase [s], shape (n,), n >= 2.
        values: Heading without jumps [rad], or along-track [m], shape (n,).
        initial: First value.
        reference: What the phase drives at.
        commands: Commands of its samples [rad/s or m/s], shape (m,).
        limit: Magnitude at which they are clipped, None where not recorded.
        was_cut: Whether the run was cut before the phase had come to its end.
    """

    time_s: Values
    values: Values
    initial: float
    reference: float
    commands: Values
    limit: float | None
    was_cut: bool


def find_response(run: Run, phase: Phase) -> Response | Missing:
    """Return the response of ROTATE (its pause included) or TRANSLATE, or why there is none."""
    stretch = _find_first_stretch(run, phase)
    if not stretch:
        return Missing(status=Status.NO_PHASE, reason=f"the run has no phase {phase.label}")
    start_ns, end_ns = stretch[0].start_ns, stretch[-1].end_ns
    signal = read_signal(run, "heading" if phase is Phase.ROTATE else "along_track")
    if signal is None:
        return Missing(status=Status.ABSENT, reason="the recording holds no samples")
    inside = (signal.time_ns >= start_ns) & (signal.time_ns <= end_ns)
    values = signal.values[inside]
    if len(values) < 2:
        return Missing(status=Status.TOO_SHORT, reason=f"{len(values)} pose in {phase.label}")
    samples = run.samples
    of_phase = (samples.phase == phase) & (samples.time_ns <= end_ns)
    if phase is Phase.ROTATE:
        commands, limit = samples.turn_rate_rad_s, run.parameters.get("limits.turn_rate_rad_s")
    else:
        commands, limit = samples.speed_m_s, run.parameters.get("limits.speed_m_s")
    return Response(
        time_s=(signal.time_ns[inside] - start_ns) / 1e9,
        values=values,
        initial=float(values[0]),
        reference=_find_reference(run, phase, values),
        commands=commands[of_phase],
        limit=float(limit) if isinstance(limit, int | float) else None,
        was_cut=not run.is_complete and end_ns == run.end_ns,
    )


def _find_first_stretch(run: Run, phase: Phase) -> list[PhaseSpan]:
    """Return the spans of the phase's first stretch; later returns to the phase are not part."""
    kinds = {Phase.ROTATE, Phase.PAUSE} if phase is Phase.ROTATE else {phase}
    before = dropwhile(lambda span: span.phase is not phase, run.find_phase_spans())
    return list(takewhile(lambda span: span.phase in kinds, before))


def _find_reference(run: Run, phase: Phase, values: Values) -> float:
    bearing_rad = float(run.samples.bearing_rad[0])
    if phase is Phase.ROTATE:
        # The heading is counted through full turns: take the bearing's turn where it ended.
        turns = np.round((values[-1] - bearing_rad) / (2.0 * np.pi))
        return float(bearing_rad + turns * 2.0 * np.pi)
    error_xy_m = run.samples.error_xy_m[0]
    return float(np.hypot(*error_xy_m))
