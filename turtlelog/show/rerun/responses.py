"""What theory expects of a run, as thin curves beside what was measured."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.measure import Metric, read_signal
from turtlelog.run import Phase, PhaseSpan, Run
from turtlelog.show.rerun import entities, palette
from turtlelog.show.rerun.series import Series
from turtlelog.show.run_colors import Color
from turtlelog.theory import compute_sampled_step_response, compute_step_response

_WIDTH: Final = 1.0
_POINTS: Final = 501
_MOST_SAMPLES: Final = 1_000_000
_MOST_DEAD_SAMPLES: Final = 1000


@dataclass(frozen=True, slots=True, kw_only=True)
class _Step:
    """The step that a phase answers.

    Attributes:
        kp: Gain [1/s].
        start_ns: Start of the phase, in the run's own time [ns].
        end_ns: Its end [ns].
        initial: First value of the signal, in the plot's unit.
        reference: What the phase drives at, in the same unit.
    """

    kp: float
    start_ns: int
    end_ns: int
    initial: float
    reference: float


_RESPONSES: Final = (
    (entities.HEADING, "heading", Phase.ROTATE, "law.kp_angular"),
    (entities.ALONG_TRACK, "along_track", Phase.TRANSLATE, "law.kp_linear"),
)


def list_responses(run: Run, metrics: Mapping[str, Metric]) -> tuple[Series, ...]:
    """Return the ideal response of each loop, and the sampled one with the dead time found.

    Both start where the phase starts, as if nothing were clipped. A loop whose gain is not known
    has neither, one whose dead time is not known has no sampled one.
    """
    found: list[Series] = []
    for plot, signal_name, phase, key in _RESPONSES:
        step = _find_step(run, signal_name, phase, key)
        if step is not None:
            found += [_compute_ideal(plot, step)]
            found += _compute_sampled(plot, step, run, metrics.get(f"{phase.label}.dead_time"))
    return tuple(found)


def _find_step(run: Run, signal_name: str, phase: Phase, key: str) -> _Step | None:
    kp, signal = run.parameters.get(key), read_signal(run, signal_name)
    stretch = list(_take_stretch(run, phase))
    if isinstance(kp, bool | str | list) or kp is None or not 0.0 < kp < np.inf:
        return None
    if signal is None or not stretch or stretch[-1].end_ns <= stretch[0].start_ns:
        return None
    rows = np.searchsorted(signal.time_ns, [stretch[0].start_ns, stretch[-1].end_ns])
    initial, last = signal.values[np.minimum(rows, len(signal.values) - 1)].tolist()
    reference = float(np.hypot(*run.samples.error_xy_m[0]))
    if phase is Phase.ROTATE:
        bearing_rad = float(run.samples.bearing_rad[0])
        # The heading is counted through full turns: take the bearing's turn where it ended.
        reference = bearing_rad + round((last - bearing_rad) / (2.0 * np.pi)) * 2.0 * np.pi
        initial, reference = float(np.degrees(initial)), float(np.degrees(reference))
    return _Step(
        kp=float(kp),
        start_ns=stretch[0].start_ns,
        end_ns=stretch[-1].end_ns,
        initial=initial,
        reference=reference,
    )


def _take_stretch(run: Run, phase: Phase) -> Iterator[PhaseSpan]:
    """Yield the spans of the phase's first stretch, a pause among them."""
    has_begun = False
    for span in run.find_phase_spans():
        is_of_phase = span.phase is phase or (span.phase is Phase.PAUSE and phase is Phase.ROTATE)
        if is_of_phase:
            has_begun = True
            yield span
        elif has_begun:
            return


def _compute_ideal(plot: str, step: _Step) -> Series:
    time_s = np.arange(_POINTS) * ((step.end_ns - step.start_ns) / 1e9 / (_POINTS - 1))
    values = compute_step_response(step.kp, time_s, initial=step.initial, reference=step.reference)
    return _build(plot, entities.IDEAL, "ideal", palette.IDEAL, (step, time_s, values))


def _compute_sampled(
    plot: str, step: _Step, run: Run, dead_time: Metric | None
) -> Iterator[Series]:
    steps_ns = np.diff(run.samples.time_ns)
    if dead_time is None or dead_time.value is None or not (steps_ns > 0).any():
        return
    period_s = float(np.median(steps_ns[steps_ns > 0])) / 1e9
    delay = round(dead_time.value / period_s)
    count = int((step.end_ns - step.start_ns) / 1e9 / period_s) + 1
    if count > _MOST_SAMPLES or delay > _MOST_DEAD_SAMPLES:
        return
    values = compute_sampled_step_response(
        step.kp,
        count,
        period_s=period_s,
        dead_time_ticks=delay,
        initial=step.initial,
        reference=step.reference,
    )
    label = f"ideal with {dead_time.value * 1e3:.3g} ms dead time"
    time_s = np.arange(count) * period_s
    yield _build(plot, entities.SAMPLED, label, palette.SAMPLED, (step, time_s, values))


def _build(
    plot: str,
    kind: str,
    label: str,
    color: Color,
    response: tuple[_Step, NDArray[np.floating], NDArray[np.float64]],
) -> Series:
    step, time_s, values = response
    return Series(
        entity=f"{plot}/{kind}",
        labels=(label,),
        colors=(color,),
        time_ns=step.start_ns + np.rint(time_s * 1e9).astype(np.int64),
        values=values[:, np.newaxis],
        width=_WIDTH,
        is_main=False,
        is_measured=False,
    )
