"""Robots that are driven by steps, and how their metrics are read."""

from typing import Any

import numpy as np

import turtlelog as tl
from tests.measure.driven import Values, make_driven_run, publish, respond

STEPS = [(2.0, 0.2), (5.0, 0.0), (8.0, 0.4), (11.0, 0.1), (14.0, -0.3), (17.0, 0.0)]
AT_20_HZ = np.arange(0.0, 20.0, 0.05)


def drive(
    time_s: Values = AT_20_HZ,
    steps: list[tuple[float, float]] = STEPS,
    *,
    axis: str = "speed",
    lag_s: float = 0.1,
    dead_s: float = 0.05,
    hz: float = 10.0,
    **changes: Any,
) -> tl.Run:
    """Return a robot of one lag and dead time under held commands of one axis."""
    at_s, values = publish(steps, 20.0, hz)
    none = np.zeros(len(at_s))
    speed, turn = (values, none) if axis == "speed" else (none, values)
    driven: dict[str, Any] = {
        "speed" if axis == "speed" else "turn": respond(time_s, steps, lag_s, dead_s)
    }
    return make_driven_run(time_s, commands=(at_s, speed, turn), **driven, **changes)


def measure(run: tl.Run, name: str, **settings: Any) -> tl.Metric:
    return tl.measure_run(run, tl.MeasureSettings(**settings), only=[name])[name]


def read(run: tl.Run, name: str) -> float:
    metric = measure(run, name)
    assert metric.value is not None, metric.reason
    return metric.value


def tell(run: tl.Run, name: str) -> tuple[str, str]:
    metric = measure(run, name)
    return metric.status.value, metric.reason
