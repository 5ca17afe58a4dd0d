"""The polynomials of a PID loop, written out: the package finds poles and verdicts without them."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from turtlelog.theory import PidGains, Process
from turtlelog.theory.pid_loop import _prepare
from turtlelog.theory.process import INTEGRATOR


def compute_pid_polynomial(
    gains: PidGains,
    *,
    period_s: float,
    dead_time_ticks: int = 0,
    process: Process = INTEGRATOR,
) -> NDArray[np.float64]:
    """Return the characteristic polynomial in z of a closed loop, highest power first."""
    loop: dict[str, Any] = {"period_s": period_s, "dead_time_ticks": dead_time_ticks}
    above, below = expand_transfer_function(gains, process=process, **loop)
    return np.asarray(np.polyadd(below, above), dtype=np.float64)


def expand_transfer_function(
    gains: PidGains,
    *,
    period_s: float,
    dead_time_ticks: int = 0,
    process: Process = INTEGRATOR,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return numerator and denominator in z of the open loop, highest power first."""
    shape, _ = _prepare(gains, period_s, dead_time_ticks, process)
    c0, c1, c2 = shape.numerator
    below: Any = np.array([1.0, -1.0] if shape.integrators == 1 else [1.0, -2.0, 1.0])
    if shape.a is not None:
        below = np.convolve(below, np.array([1.0, -shape.a]))
    weights = [shape.ahead, 1.0 - shape.ahead - shape.behind, shape.behind][: 2 + shape.lift]
    above: Any = np.polymul(np.array([c2, c1 - 2.0 * c2, c2 - c1 + c0]), np.array(weights))
    for gap in shape.gaps:
        below, above = np.convolve(below, np.array([1.0, gap - 1.0])), above * gap
    return above, np.concatenate((below, np.zeros(shape.delay + shape.lift)))
