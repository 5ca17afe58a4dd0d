"""The ideal loop and the sampled one: time constants, responses, limits."""

from turtlelog.theory.closed_loop import (
    compute_exact_settling_time,
    compute_settling_time,
    compute_time_constant,
)
from turtlelog.theory.responses import compute_sampled_step_response, compute_step_response

__all__ = [
    "compute_exact_settling_time",
    "compute_sampled_step_response",
    "compute_settling_time",
    "compute_step_response",
    "compute_time_constant",
]
