"""The ideal loop."""

from turtlelog.theory.ideal import compute_settling_time, compute_time_constant

__all__ = ["compute_settling_time", "compute_time_constant"]
