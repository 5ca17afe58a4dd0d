"""Sums of products along columns, the same to the last bit on every processor.

`np.dot` is a library's, which adds up in another order on another processor: a recording measured
here would differ from the same one measured there.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray


def sum_products(*columns: NDArray[Any]) -> float:
    """Return the sum over the rows of what their values make multiplied.

    Nothing is laid out in memory on the way: long signals are measured at the speed of reading.

    Args:
        columns: Two or three of shape (n,).
    """
    rows = ",".join("i" for _ in columns)
    return float(np.einsum(f"{rows}->", *columns))
