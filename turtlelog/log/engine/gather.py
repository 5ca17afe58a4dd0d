"""Records that stand anywhere in a buffer -> rows, in one step."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import LogError


def gather_bytes(data: bytes | bytearray, starts: NDArray[np.int64], size: int) -> NDArray[Any]:
    """Return `size` bytes from each of the places in `data`, as an array of V-size rows.

    The view lets every byte start a row; indexed with the places it costs a sixth of a copy field
    by field.

    Raises:
        LogError: Where a place is not followed by so many bytes.
    """
    if not len(starts):
        return np.empty(0, f"V{size}")
    if starts.min() < 0 or starts.max() > len(data) - size:
        raise LogError(f"expected {size} bytes from each place, found {len(data)} in all")
    view = np.ndarray((len(data) - size + 1,), f"V{size}", buffer=data, strides=(1,))
    return view[starts]
