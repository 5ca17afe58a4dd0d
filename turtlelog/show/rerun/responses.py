"""What theory expects of a run, as thin curves beside what was measured."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.measure import Metric, read_signal
from turtlelog.run import Run
from turtlelog.show import palette
from turtlelog.show.aims import LoopStep, find_steps
from turtlelog.show.palette import Color
from turtlelog.show.rerun import entities
from turtlelog.show.rerun.plots import Series
from turtlelog.theory import compute_sampled_step_response, compute_step_response

_WIDTH: Final = 1.0
_POINTS: Final = 501
_MOST_SAMPLES: Final = 1_000_000
_MOST_DEAD_SAMPLES: Final = 1000


@dataclass(frozen=True, slots=True, kw_only=True)
class _Step:
    """The step that a loop answers, as its plot shows it.

    Attributes:
        plot: Where.
        of: Beside the name of each response, where its plot has those of several loops.
        kp: Gain [1/s].
        start_ns: Start of the loop's stretch, in the run's own time [ns].
        end_ns: Its end [ns].
        initial: First value of the signal, in the plot's unit.
        reference: What the loop drives at, in the same unit.
    """

    plot: str
    of: str
    kp: float
    start_ns: int
    end_ns: int
    initial: float
    reference: float


def list_responses(run: Run, metrics: Mapping[str, Metric]) -> tuple[Series, ...]:
    """Return the ideal response of each loop, and the sampled one with the dead time found.

    Both start where the loop starts, as if nothing were clipped. A loop whose reference moves, that
    is not theory's, or whose gain is not known has neither; one whose dead time is not known has no
    sampled one.
    """
    found: list[Series] = []
    for signal in entities.PLOTS:
        steps = list(find_steps(run, signal))
        for number, declared in enumerate(steps):
            of = declared.loop.name if number else ""
            step = _find_step(run, declared, of)
            if step is not None:
                dead_time = metrics.get(f"{declared.loop.name}.dead_time")
                found += [_compute_ideal(step), *_compute_sampled(step, run, dead_time)]
    return tuple(found)


def _find_step(run: Run, declared: LoopStep, of: str) -> _Step | None:
    start_ns, end_ns = declared.stretch[0].start_ns, declared.stretch[-1].end_ns
    signal, reference = read_signal(run, declared.loop.signal), declared.reference
    if signal is None or end_ns <= start_ns:
        return None
    rows = np.searchsorted(signal.time_ns, [start_ns, end_ns])
    initial, last = signal.values[np.minimum(rows, len(signal.values) - 1)].tolist()
    if signal.kind.unit == "rad":
        # The heading is counted through full turns: take the reference's turn where it ended.
        reference += round((last - reference) / (2.0 * np.pi)) * 2.0 * np.pi
        initial, reference = float(np.degrees(initial)), float(np.degrees(reference))
    return _Step(
        plot=entities.PLOTS[declared.loop.signal],
        of=of,
        kp=declared.kp,
        start_ns=start_ns,
        end_ns=end_ns,
        initial=initial,
        reference=reference,
    )


def _compute_ideal(step: _Step) -> Series:
    time_s = np.arange(_POINTS) * ((step.end_ns - step.start_ns) / 1e9 / (_POINTS - 1))
    values = compute_step_response(step.kp, time_s, initial=step.initial, reference=step.reference)
    return _build(step, entities.IDEAL, "ideal", palette.IDEAL, (time_s, values))


def _compute_sampled(step: _Step, run: Run, dead_time: Metric | None) -> Iterator[Series]:
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
    yield _build(step, entities.SAMPLED, label, palette.SAMPLED, (time_s, values))


def _build(
    step: _Step,
    kind: str,
    label: str,
    color: Color,
    response: tuple[NDArray[np.floating], NDArray[np.float64]],
) -> Series:
    time_s, values = response
    return Series(
        entity="/".join(part for part in (step.plot, kind, step.of) if part),
        labels=(f"{label}, {step.of}" if step.of else label,),
        colors=(color,),
        time_ns=step.start_ns + np.rint(time_s * 1e9).astype(np.int64),
        values=values[:, np.newaxis],
        width=_WIDTH,
        is_main=False,
        is_measured=False,
    )
