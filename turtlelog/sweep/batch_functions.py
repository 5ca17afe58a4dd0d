"""What compiles the functions that measure rows, and those of angles that they call."""

from typing import Any, Final

from numba import from_dtype, njit, types

from turtlelog import arithmetic
from turtlelog.simulate.twins import Twins

measure = njit(_nrt=False, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
"""Compiles a function that compiled code calls, and no Python."""

wrap_angle: Final = Twins().compile(arithmetic.wrap_angle)
"""`arithmetic.wrap_angle`, compiled."""


def list_array(kind: Any, dimensions: int = 1) -> Any:
    """Return the type of contiguous arrays of a dtype."""
    import numpy as np

    return types.Array(from_dtype(np.dtype(kind)), dimensions, "C")
