"""What theory expects of a run, as thin curves beside what was measured."""

from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.measure import Metric
from turtlelog.run import Run
from turtlelog.show import palette
from turtlelog.show.aims import LoopStep, Values, find_steps
from turtlelog.show.rerun import entities
from turtlelog.show.rerun.plots import Series
from turtlelog.theory import compute_sampled_step_response

_WIDTH: Final = 1.0
_POINTS: Final = 501
_MOST_SAMPLES: Final = 1_000_000
_MOST_DEAD_SAMPLES: Final = 1000
_COLORS: Final = {entities.IDEAL: palette.IDEAL, entities.SAMPLED: palette.SAMPLED}


def list_responses(run: Run, metrics: Mapping[str, Metric]) -> tuple[Series, ...]:
    """Return the ideal response of each loop, and the sampled one with the dead time found.

    Both start where the loop starts, as if nothing were clipped. A loop whose reference moves, that
    is not theory's, or whose gain is not known has neither; one whose dead time is not known has no
    sampled one.
    """
    found: list[Series] = []
    for signal in entities.PLOTS:
        for number, step in enumerate(find_steps(run, signal)):
            if step.end_ns > step.start_ns:
                of = step.loop.name if number else ""
                dead_time = metrics.get(f"{step.loop.name}.dead_time")
                found += [_compute_ideal(step, of), *_compute_sampled(step, of, run, dead_time)]
    return tuple(found)


def _compute_ideal(step: LoopStep, of: str) -> Series:
    time_s = np.arange(_POINTS) * ((step.end_ns - step.start_ns) / 1e9 / (_POINTS - 1))
    return _build(step, of, entities.IDEAL, "ideal", time_s, step.respond(time_s))


def _compute_sampled(
    step: LoopStep, of: str, run: Run, dead_time: Metric | None
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
    yield _build(step, of, entities.SAMPLED, label, time_s, values)


def _build(
    step: LoopStep, of: str, kind: str, label: str, time_s: NDArray[np.floating], values: Values
) -> Series:
    """Return a response as a curve; `of` names its loop where its plot has those of several."""
    return Series(
        entity="/".join(part for part in (entities.PLOTS[step.loop.signal], kind, of) if part),
        labels=(f"{label}, {of}" if of else label,),
        colors=(_COLORS[kind],),
        time_ns=step.start_ns + np.rint(time_s * 1e9).astype(np.int64),
        values=values[:, np.newaxis],
        width=_WIDTH,
        is_main=False,
        is_measured=False,
    )
