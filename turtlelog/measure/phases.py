"""The stretch of a run that a phase's metrics are computed on."""

from dataclasses import dataclass
from functools import cached_property
from itertools import dropwhile, takewhile
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.measure.command import compute_hold_times
from turtlelog.measure.integrals import fold_at_zero
from turtlelog.measure.metric import Missing, Status
from turtlelog.measure.settings import MeasureSettings
from turtlelog.measure.signals import Signal
from turtlelog.run import Phase, PhaseSpan, Run

Values = NDArray[np.float64]

_TIMEOUT: Final = "timeout"
"""Stop reason of a law whose time was up."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CommandStretch:
    """The commands of a phase, as they hold; no rows where its samples are not of this run.

    Attributes:
        time_s: When each was published, from the first sample of the run [s], shape (m,); when its
            pose was answered, where the publication is not recorded.
        values: In rad/s or m/s, shape (m,).
        wanted: Before clipping, shape (m,); None where not recorded.
        limit: Magnitude at which they are clipped, None where not recorded.
        end_s: When the last one ceases to hold, from the first sample of the run [s].
    """

    time_s: Values
    values: Values
    wanted: Values | None
    limit: float | None
    end_s: float

    @cached_property
    def is_saturated(self) -> NDArray[np.bool_] | None:
        """Whether each command stands at its limit, None where that is not recorded."""
        return None if self.limit is None else np.abs(self.values) >= self.limit

    @cached_property
    def held_s(self) -> Values:
        """How long each holds [s], shape (m,)."""
        return compute_hold_times(self.time_s, self.end_s)


@dataclass(frozen=True, kw_only=True, eq=False)
class Response:
    """How the controlled coordinate of a phase answers its reference.

    Attributes:
        phase: ROTATE (its pause included) or TRANSLATE.
        start_s: Start of the phase, from the first sample of the run [s].
        rows: Its poses among those of the run.
        time_s: From the start of the phase [s], shape (n,), n >= 2.
        values: Heading without jumps [rad], or along-track [m], shape (n,).
        initial: What the step starts from: the first value, or as asked.
        reference: What the step leads to: what the phase drives at, or as asked.
        band: Half-width of the settling band, as a share of the step.
        commands: Those of its samples.
        was_cut: Whether the run was cut before the phase had come to its end.
        ended_itself: Whether the law ended the phase because it was done: neither a cut nor the
            law's timeout did.
    """

    phase: Phase
    start_s: float
    rows: slice
    time_s: Values
    values: Values
    initial: float
    reference: float
    band: float
    commands: CommandStretch
    was_cut: bool
    ended_itself: bool

    @cached_property
    def error(self) -> Values:
        """Reference minus value [rad or m], shape (n,)."""
        return np.asarray(self.reference - self.values)

    @cached_property
    def step_s(self) -> Values:
        """Time from each row to the next [s], shape (n - 1,)."""
        return np.diff(self.time_s)

    @cached_property
    def folded_error(self) -> tuple[Values, Values, Values]:
        """Times [s], steps of time [s], magnitudes of the error: a row added wherever it is 0."""
        time_s, magnitude = fold_at_zero(self.time_s, self.error)
        return time_s, self.step_s if time_s is self.time_s else np.diff(time_s), magnitude


def find_response(
    run: Run, phase: Phase, signal: Signal | None, settings: MeasureSettings
) -> Response | Missing:
    """Return the response of ROTATE (its pause included) or TRANSLATE, or why there is none.

    `signal` is what the phase controls: `heading` or `along_track`.
    """
    if signal is None or not len(run.samples):
        return Missing(status=Status.ABSENT, reason="no samples of a controller were read")
    stretch = _find_first_stretch(run, phase)
    if not stretch:
        return Missing(status=Status.NO_PHASE, reason=f"the run has no phase {phase.label}")
    start_ns, end_ns = stretch[0].start_ns, stretch[-1].end_ns
    first = int(np.searchsorted(signal.time_ns, start_ns, side="left"))
    inside = slice(first, int(np.searchsorted(signal.time_ns, end_ns, side="right")))
    values = signal.values[inside]
    if len(values) < 2:
        found = f"{len(values)} pose" + ("" if len(values) == 1 else "s")
        return Missing(status=Status.TOO_SHORT, reason=f"{found} in {phase.label}")
    initial, reference = _find_step(run, phase, values, settings)
    return Response(
        phase=phase,
        start_s=(start_ns - run.start_ns) / 1e9,
        rows=inside,
        time_s=(signal.time_ns[inside] - start_ns) / 1e9,
        values=values,
        initial=initial,
        reference=reference,
        band=settings.band,
        commands=_find_commands(run, phase, end_ns),
        was_cut=not run.is_complete and end_ns == run.end_ns,
        ended_itself=stretch[-1].phase is not phase or end_ns < run.end_ns or came_to_rest(run),
    )


def came_to_rest(run: Run) -> bool:
    """Return whether the law ended the run because it was done; a timeout ends it as a cut does."""
    return run.is_complete and run.stop_reason != _TIMEOUT


def _find_first_stretch(run: Run, phase: Phase) -> list[PhaseSpan]:
    """Return the spans of the phase's first stretch; later returns to the phase are not part."""
    kinds = {Phase.ROTATE, Phase.PAUSE} if phase is Phase.ROTATE else {phase}
    before = dropwhile(lambda span: span.phase is not phase, run.find_phase_spans())
    return list(takewhile(lambda span: span.phase in kinds, before))


def _find_commands(run: Run, phase: Phase, end_ns: int) -> CommandStretch:
    samples = run.samples
    of_phase = samples.phase == phase
    first = int(of_phase.argmax())
    others = ~of_phase[first:]
    rows = slice(first, first + int(others.argmax()) if others.any() else len(of_phase))
    has_publications = len(run.commands) == len(samples)
    time_ns = (run.commands if has_publications else samples).time_ns[rows]
    if phase is Phase.ROTATE:
        values, wanted = samples.turn_rate_rad_s, samples.wanted_turn_rate_rad_s
        limit = run.parameters.get("limits.turn_rate_rad_s")
    else:
        values, wanted = samples.speed_m_s, samples.wanted_speed_m_s
        limit = run.parameters.get("limits.speed_m_s")
    return CommandStretch(
        time_s=(np.minimum(time_ns, end_ns) - run.start_ns) / 1e9,
        values=values[rows],
        wanted=None if wanted is None else wanted[rows],
        limit=float(limit) if isinstance(limit, int | float) else None,
        end_s=(end_ns - run.start_ns) / 1e9,
    )


def _find_step(
    run: Run, phase: Phase, values: Values, settings: MeasureSettings
) -> tuple[float, float]:
    """Return what the step of a phase leads from and to."""
    initial, final = settings.get_initial(phase), settings.get_final(phase)
    first, last = float(values[0]), float(values[-1])
    initial = first if initial is None else _turn_towards(phase, initial, first)
    if final == "last":
        return initial, last
    if final != "reference":
        return initial, _turn_towards(phase, float(final), last)
    if phase is Phase.ROTATE:
        return initial, _turn_towards(phase, float(run.samples.bearing_rad[0]), last)
    return initial, float(np.hypot(*run.samples.error_xy_m[0]))


def _turn_towards(phase: Phase, value: float, measured: float) -> float:
    """Return a heading with the full turns of a measured one: it is counted without jumps."""
    if phase is not Phase.ROTATE:
        return value
    return value + float(np.round((measured - value) / (2.0 * np.pi))) * 2.0 * np.pi
