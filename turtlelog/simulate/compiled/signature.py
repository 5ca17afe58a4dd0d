"""The types that compiled loops are compiled for, before they are called."""

from typing import Any

import numpy as np
from numba import from_dtype, typeof, types

from turtlelog.simulate.compiled.fields import SETTINGS
from turtlelog.simulate.compiled.memory import STATE, allocate


def list_array(kind: Any, dimensions: int = 1) -> Any:
    """Return the type of contiguous arrays of a dtype."""
    return types.Array(from_dtype(np.dtype(kind)), dimensions, "C")


MEMORY = typeof(allocate(1, 1))
"""The arrays of a loop."""

LOOP = types.int64(list_array(SETTINGS), list_array(STATE), MEMORY)
"""A loop: of settings and state of one scenario, and the arrays."""
