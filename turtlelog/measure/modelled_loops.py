"""The loops of a run as `theory` models them."""

from collections.abc import Mapping

import numpy as np

from turtlelog.measure.dead_time import find_dead_time
from turtlelog.measure.metric import Missing
from turtlelog.measure.outliers import compute_median
from turtlelog.run import Parameter, Run
from turtlelog.run.loops import ControlLoop
from turtlelog.theory import LoopModel, MeasuredTiming, model_loop

_MEASURED = "measured in the recording"


def model_run_loops(
    run: Run, *, identified: Mapping[str, Parameter] | None = None
) -> tuple[LoopModel, ...]:
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


def _model(run: Run, loop: ControlLoop, parameters: Mapping[str, Parameter]) -> LoopModel:
    sources = {}
    if loop.gain not in run.parameters:
        sources["gains"] = "identified from the commands"
    if "loop.period_ticks" not in run.parameters and "plant.kind" not in parameters:
        sources["plant"] = "assumed, as the recording names no plant"
    is_plain = parameters.get("plant.kind", "turtlesim") == "turtlesim"
    is_plain = is_plain and parameters.get("loop.trigger", "pose") == "pose"
    timing = _measure_timing(run, loop) if is_plain else None
    return model_loop(loop, parameters, timing=timing, sources=sources)


def _measure_timing(run: Run, loop: ControlLoop) -> MeasuredTiming | str:
    periods_ns = np.diff(run.samples.time_ns)
    periods_ns = periods_ns[periods_ns > 0]  # without those of a burst
    if not len(periods_ns) or len(run.poses) < 2:
        return "the recording holds no two samples at different times"
    found = find_dead_time(run, loop)
    if isinstance(found, Missing):
        return f"the dead time cannot be measured: {found.reason}"
    tick_s = compute_median(np.diff(run.poses.time_ns)) / 1e9
    changes = " at the end" if found.changes else ""
    words = f"{_MEASURED}, {found.ticks} tick{'' if found.ticks == 1 else 's'}"
    return MeasuredTiming(
        period_s=compute_median(periods_ns) / 1e9,
        dead_time_s=found.ticks * tick_s,
        sources={"period_s": _MEASURED, "dead_time_s": words + changes},
    )
