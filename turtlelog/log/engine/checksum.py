"""The CRC-32 of bytes, in a third of zlib's time where the compiled loops are loaded."""

import zlib
from typing import Final

import numpy as np

from turtlelog.log.engine.load_kernels import KERNELS

_STATE: Final = 64  # bytes that the loop folds all others into
_LEAST: Final = 2**12  # bytes; of fewer the calls take longer than the loop saves


def compute_crc(data: bytes | memoryview, before: int = 0) -> int:
    """Return the checksum of bytes; `before` is that of what stands before them."""
    kernels = KERNELS.find()
    if kernels is None or kernels.fold is None or len(data) < _LEAST:
        return zlib.crc32(data, before)
    octets = np.frombuffer(data, np.uint8)
    state = octets[:_STATE].copy()
    # A checksum starts from the inverse of the one before, here added to the first bytes.
    state[:4] ^= np.frombuffer((~before & 0xFFFFFFFF).to_bytes(4, "little"), np.uint8)
    kernels.fold(octets[_STATE:], state)
    rest = len(data) % _STATE
    folded = zlib.crc32(state.data, 0xFFFFFFFF)  # the inverse of 0: nothing stands before
    return zlib.crc32(octets[len(data) - rest :].data, folded)
