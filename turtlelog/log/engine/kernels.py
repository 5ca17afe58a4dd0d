"""The inner loops of reading, compiled by numba; `compiled` decides when they are loaded.

Records are MCAP's: opcode u8, length u64, body. That of a message, opcode 5, begins with channel
u16, sequence u32, log time u64 and publish time u64; then comes its data.

The loops check no bounds of the arrays that they are given. No place beyond `data` is read: what
is no whole message ends a walk.
"""

from typing import Any

from numba import int64, njit, types, uint8, uint16, uint32, uint64
from numba.extending import intrinsic

_BYTES = types.Array(uint8, 1, "C", readonly=True)
_PLACES = int64[::1]


@intrinsic
def _load(_: Any, kind: Any, _address: Any) -> Any:
    """Return the number that stands at an address, aligned or not; of the kind of the first."""

    def build(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        pointer = builder.inttoptr(arguments[1], context.get_value_type(kind).as_pointer())
        return builder.load(pointer, align=1)

    return kind(kind, types.int64), build


@intrinsic
def _store(_: Any, _address: Any, value: Any) -> Any:
    """Put a number at an address, aligned or not."""

    def build(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        pointer = builder.inttoptr(arguments[0], arguments[1].type.as_pointer())
        builder.store(arguments[1], pointer, align=1)
        return context.get_dummy_value()

    return types.void(types.int64, value), build


@njit(inline="always")
def _find_end(begin: int, size: int, place: int) -> int:
    """Return where the message at a place ends; the place itself where there is no whole one."""
    left = size - place
    if left < 31 or _load(uint8(0), begin + place) != 5:
        return place
    length = _load(uint64(0), begin + place + 1)
    if length < 22 or length > uint64(left - 9):
        return place
    return place + 9 + int64(length)  # type: ignore[no-any-return]


@njit(types.UniTuple(int64, 2)(_BYTES, int64, uint32[::1]), nogil=True, cache=True)
def walk(data: Any, place: int, starts: Any) -> tuple[int, int]:
    """Note the messages that follow each other from a place, as far as there is room.

    Returns:
        Where the first record stands that is no whole message, and how many messages are noted.
    """
    begin, count = data.ctypes.data, 0
    while count < len(starts):
        end = _find_end(begin, len(data), place)
        if end == place:
            break
        starts[count] = place
        count += 1
        place = end
    return place, count


@njit(types.void(_BYTES, _PLACES, uint16[::1]), nogil=True, cache=True)
def take_channels(data: Any, starts: Any, channels: Any) -> None:
    """Read the channels of messages."""
    begin = data.ctypes.data
    for row in range(len(starts)):
        channels[row] = _load(uint16(0), begin + starts[row] + 9)


@njit(int64(_BYTES, int64, _PLACES, _PLACES, _PLACES), nogil=True, cache=True)
def follow(data: Any, place: int, offsets: Any, cursors: Any, ends: Any) -> int:
    """Walk the messages from a place, as long as each is the next that its channel's index names.

    Args:
        data: The records.
        place: Where to start.
        offsets: Where the messages of all channels start, channel by channel.
        cursors: By channel: which of them is the next; moved on.
        ends: By channel: behind its last one.

    Returns:
        Where the first record stands that is none of them.
    """
    begin = data.ctypes.data
    while True:
        end = _find_end(begin, len(data), place)
        if end == place:
            break
        channel = _load(uint16(0), begin + place + 9)
        if channel >= len(ends):
            break
        cursor = cursors[channel]
        if cursor == ends[channel] or offsets[cursor] != place:
            break
        cursors[channel] = cursor + 1
        place = end
    return place


@njit(int64(_BYTES, uint64), nogil=True, cache=True)
def skip_followed(data: Any, longest: int) -> int:
    """Return where the messages from the first byte on end of which each is followed by another.

    Args:
        data: The records, perhaps cut.
        longest: What the length of a record may say.
    """
    begin, place = data.ctypes.data, 0
    while True:
        end = _find_end(begin, len(data), place)
        if end == place or len(data) - end < 9 or _load(uint8(0), begin + end) != 5:
            return place
        length = _load(uint64(0), begin + end + 1)
        if length < 22 or length > longest or uint64(end - place - 9) > longest:
            return place
        place = end


@njit(int64(_BYTES, _PLACES, uint64, int64[:, ::1], _PLACES, int64), nogil=True, cache=True)
def scatter(data: Any, starts: Any, size: int, numbers: Any, columns: Any, first: int) -> int:
    """Copy the numbers of messages of one size into columns; return of how many before another.

    Args:
        data: The records.
        starts: Where the messages start, each whole.
        size: What the length of each record must say, or up to 3 bytes more: some middlewares fill
            it up.
        numbers: Of each: its offset from the start, its bytes, and how many stand together.
        columns: Address of the column of each.
        first: Row of the first message.
    """
    begin = data.ctypes.data
    for message in range(len(starts)):
        place = begin + starts[message]
        extra = _load(uint64(0), place + 1) - size
        times = _load(uint64(0), place + 15) | _load(uint64(0), place + 23)
        # Plain CDR, little-endian, and of times that 63 bits hold.
        if extra > 3 or times >> uint64(63) or _load(uint16(0), place + 31) != 0x0100:
            return message
        for number in range(len(numbers)):
            source, width = place + numbers[number, 0], numbers[number, 1]
            together = numbers[number, 2]
            target = columns[number] + (first + message) * width * together
            for _ in range(together):
                if width == 8:
                    _store(target, _load(uint64(0), source))
                elif width == 4:
                    _store(target, _load(uint32(0), source))
                elif width == 2:
                    _store(target, _load(uint16(0), source))
                else:
                    _store(target, _load(uint8(0), source))
                source += width
                target += width
    return len(starts)
