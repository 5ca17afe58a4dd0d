"""A run beside theory: its loops as models, and metrics of the deviation of a response from theory.

All three theories describe an integrator under proportional feedback with the gain of the run and
without a limit on the command. Each leads from the response's own initial value to its reference:

- ideal: dy/dt = Kp (r - y), so y = r + (y0 - r) exp(-Kp t);
- sampled: the command is held for a period T: y[k+1] = y[k] + Kp T (r - y[k]);
- delayed: each pose is answered d samples late: y[k+1] = y[k] + Kp T (r - y[k-d]), at rest before.

Between samples, a sampled loop moves along a line, because the command is held. The deviation is
the measured value minus the theory, which is linearly interpolated at the times of the response.
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.measure.context import MOST_TICKS, RunContext
from turtlelog.measure.dead_time import find_dead_time
from turtlelog.measure.metric import Found, Missing, Result, Status
from turtlelog.measure.metric_kinds import loop_metric
from turtlelog.measure.reductions import compute_median, find_largest
from turtlelog.measure.response import Response
from turtlelog.measure.step_response import compute_rms
from turtlelog.run import Parameter, Run
from turtlelog.run.loops import ControlLoop

if TYPE_CHECKING:
    from turtlelog.theory import LoopModel, MeasuredTiming

Values = NDArray[np.float64]

THEORIES: Final[Mapping[str, str]] = MappingProxyType(
    {
        "ideal": "the ideal loop",
        "sampled": "the ideal loop with sampling",
        "delayed": "the ideal loop with sampling and dead time",
    }
)
"""Theories with their names in texts."""

_MOST_SAMPLES: Final = 20_000_000

_NO_GAIN: Final = Missing(Status.ABSENT, "the recording does not hold the gain")
_ONE_TIME: Final = Missing(Status.TOO_SHORT, "the samples share one time")


def has_theory(loop: ControlLoop) -> bool:
    """Return whether theory covers a loop: an integrator with u = Kp e."""
    return not loop.moves and loop.has_theory


@loop_metric(
    "dead_time",
    "s",
    "Time from reading a pose until its {command} moves the turtle, less the plant's smallest"
    " delay.",
    needs_whole=False,
)
def compute_dead_time(context: RunContext, response: Response) -> Result:
    """See `dead_time.find_dead_time`. The value is ticks times the time between poses."""
    ticks = context.find_dead_time_ticks(response.loop)
    if isinstance(ticks, Missing):
        return ticks
    return _ONE_TIME if context.tick_s is None else Found(ticks * context.tick_s)


def _deviate_by(theory: str, figure: str) -> Callable[[RunContext, Response], Result]:
    """Return the metric `max` or `rms` of the deviation from a theory."""

    def compute(context: RunContext, response: Response) -> Result:
        def deviate() -> Values | Missing:
            predicted = _predict(theory, context, response)
            return predicted if isinstance(predicted, Missing) else response.values - predicted

        found = context.recall((theory, response.loop.name), deviate)
        if isinstance(found, Missing):
            return found
        if figure == "rms":
            return Found(compute_rms(response.step_s, found, None))
        largest, row = find_largest(found)
        return Found(largest, response.start_s + float(response.time_s[row]))

    return compute


def _predict(theory: str, context: RunContext, response: Response) -> Values | Missing:
    from turtlelog.theory import compute_step_response  # only `metrics --all` needs these
    from turtlelog.theory.sampled_loop import LARGEST_DEVIATION, interpolate_sampled_response

    kp = response.loop.read_gain(context.run.parameters)
    if kp is None:
        return _NO_GAIN
    if theory == "ideal":
        return compute_step_response(
            kp, response.time_s, initial=response.initial, reference=response.reference
        )
    period_s = context.loop_period_s
    if period_s is None:
        return _ONE_TIME
    if response.time_s[-1] / period_s > _MOST_SAMPLES:
        return Missing(Status.TOO_LARGE, "the sampling period is too short")
    dead_time = _find_dead_time_samples(theory, context, response, period_s)
    if isinstance(dead_time, Missing):
        return dead_time
    predicted = interpolate_sampled_response(
        kp,
        response.time_s,
        period_s=period_s,
        dead_time_ticks=dead_time,
        initial=response.initial,
        reference=response.reference,
    )
    limit = f"beyond {LARGEST_DEVIATION:g} steps before the phase ends"
    unstable = Missing(Status.TOO_LARGE, f"theory's loop is unstable: {limit}")
    return unstable if predicted is None else predicted


def _find_dead_time_samples(
    theory: str, context: RunContext, response: Response, period_s: float
) -> int | Missing:
    """Return the dead time of a theory in samples: 0, the setting, or found in the run."""
    if theory == "sampled":
        return 0
    asked = context.settings.dead_time_ticks
    if asked is not None:
        return asked
    ticks = context.find_dead_time_ticks(response.loop)
    if isinstance(ticks, Missing) or context.tick_s is None:
        return ticks if isinstance(ticks, Missing) else _ONE_TIME
    return min(round(ticks * context.tick_s / period_s), MOST_TICKS)


for _theory, _described in THEORIES.items():
    for _figure, _start in (("max", "Largest deviation"), ("rms", "RMS deviation")):
        loop_metric(
            f"{_theory}_deviation_{_figure}",
            "{value}",
            f"{_start} of the {{signal}} from {_described}, at the same gain.",
            # The dead time of the third theory is estimated from all rows.
            grows=_figure == "max" and _theory != "delayed",
            needs_whole=False,
            applies=has_theory,
        )(_deviate_by(_theory, _figure))


_MEASURED = "measured in the recording"


def model_run_loops(
    run: Run, *, identified: Mapping[str, Parameter] | None = None
) -> "tuple[LoopModel, ...]":
    """Return the loops of a run as `theory` models them, one per declared loop.

    Gains and plant come from the scenario, period and dead time from the samples and poses. A time
    constant looks like dead time. Therefore the timing comes from the scenario for a robot with a
    time constant, or a law triggered by a timer.

    Args:
        run: Any run.
        identified: Identified parameters for keys that the run lacks.
    """
    parameters = {**(identified or {}), **run.parameters}
    return tuple(_model(run, loop, parameters) for loop in run.declaration.loops)


def _model(run: Run, loop: ControlLoop, parameters: Mapping[str, Parameter]) -> "LoopModel":
    from turtlelog.theory import model_loop  # it loads the laws

    sources = {}
    if loop.gain not in run.parameters:
        sources["gains"] = "identified from the commands"
    if "loop.period_ticks" not in run.parameters and "plant.kind" not in parameters:
        sources["plant"] = "assumed, as the recording names no plant"
    is_plain = parameters.get("plant.kind", "turtlesim") == "turtlesim"
    is_plain = is_plain and parameters.get("loop.trigger", "pose") == "pose"
    timing = _measure_timing(run, loop) if is_plain else None
    return model_loop(loop, parameters, timing=timing, sources=sources)


def _measure_timing(run: Run, loop: ControlLoop) -> "MeasuredTiming | str":
    periods_ns = np.diff(run.samples.time_ns)
    periods_ns = periods_ns[periods_ns > 0]  # without those of a burst
    if not len(periods_ns) or len(run.poses) < 2:
        return "the recording holds no two samples at different times"
    found = find_dead_time(run, loop)
    if isinstance(found, Missing):
        return f"the dead time cannot be measured: {found.reason}"
    from turtlelog.theory import MeasuredTiming

    tick_s = compute_median(np.diff(run.poses.time_ns)) / 1e9
    changes = " at the end" if found.changes else ""
    words = f"{_MEASURED}, {found.ticks} tick{'' if found.ticks == 1 else 's'}"
    return MeasuredTiming(
        period_s=compute_median(periods_ns) / 1e9,
        dead_time_s=found.ticks * tick_s,
        sources={"period_s": _MEASURED, "dead_time_s": words + changes},
    )
