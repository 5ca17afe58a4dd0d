"""Where a damaged file makes sense again."""

from collections.abc import Iterator
from typing import Final

import numpy as np
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray

from turtlelog.errors import LogError
from turtlelog.log.engine.framing import (
    CHAIN,
    RECORD,
    SUMMARY_ONLY,
    FileWindow,
    find_record_end,
    is_record_start,
    measure_record,
)

_FIRST_STEP: Final = 2**12  # bytes looked through at a time, while the next record may be near
_STEP: Final = 2**19
_FOOTER_SIZE: Final = 29
_INDEX_HEAD: Final = 6  # bytes of a message index before its pairs: channel, their length
_PAIR: Final = 16  # bytes: log time, offset

_BOUND: Final = (Opcode.FOOTER, Opcode.CHUNK, Opcode.MESSAGE_INDEX, Opcode.ATTACHMENT)
_LONE: Final = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.METADATA)


def find_next_record(window: FileWindow, place: int, *, is_lone: bool) -> int | None:
    """Return where the next record stands that bears itself out, if any does.

    Schemas, channels and messages alone are looked for only where messages stand alone: within a
    damaged chunk that is not compressed they would look sound, and nothing vouches for them.
    """
    is_wanted = np.zeros(256, dtype=bool)
    is_wanted[[*_BOUND, Opcode.DATA_END, *(_LONE if is_lone else ())]] = True
    for candidate in _iterate_candidates(window, place, is_wanted):
        try:
            if _is_borne_out(window, candidate):
                return candidate
        except LogError:
            continue
    return None


def _iterate_candidates(
    window: FileWindow, place: int, is_wanted: NDArray[np.bool_]
) -> Iterator[int]:
    """Yield where an opcode and a length of less than 2 to the 40 may stand."""
    start, after, step = place, place, _FIRST_STEP
    while after < window.size:
        start, after, step = after, after + step, min(2 * step, _STEP)
        block = np.frombuffer(window.read(start, after - start + RECORD.size - 1), dtype=np.uint8)
        count = len(block) - RECORD.size + 1
        if count <= 0:
            return
        high = [block[at : at + count] == 0 for at in (6, 7, 8)]
        found = is_wanted[block[:count]] & high[0] & high[1] & high[2]
        yield from (start + at for at in np.flatnonzero(found).tolist())


def _is_borne_out(window: FileWindow, place: int) -> bool:
    opcode = window.read(place, 1)[0]
    if opcode == Opcode.FOOTER:
        return place + _FOOTER_SIZE + len(MCAP0_MAGIC) == window.size
    _, end = find_record_end(window, place)
    if opcode == Opcode.CHUNK:  # its reader checks what it holds
        return is_record_start(window, end, after=opcode)
    if opcode == Opcode.DATA_END:
        follows = window.read(end, 1)
        return bool(follows) and follows[0] in {
            Opcode.FOOTER,
            Opcode.SCHEMA,
            Opcode.CHANNEL,
            *SUMMARY_ONLY,
        }
    if opcode == Opcode.MESSAGE_INDEX:
        pairs = measure_record(window, place, opcode, end) - place - RECORD.size - _INDEX_HEAD
        return pairs % _PAIR == 0
    if opcode == Opcode.ATTACHMENT:
        return True
    for _ in range(CHAIN - 1):
        if end == window.size:
            break
        _, end = find_record_end(window, end)
    return True
