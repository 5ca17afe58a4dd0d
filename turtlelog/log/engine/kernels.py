"""The inner loops of reading, compiled by numba; `compiled` decides when they are loaded.

Records are MCAP's: opcode u8, length u64, body. That of a message, opcode 5, begins with channel
u16, sequence u32, log time u64 and publish time u64; then comes its data.

The loops check no bounds of the arrays that they are given. No place beyond `data` is read: what
is no whole message ends a walk.
"""

from typing import Any

from llvmlite import binding, ir
from numba import config, int64, njit, types, uint8, uint16, uint32, uint64
from numba.extending import intrinsic

_BYTES = types.Array(uint8, 1, "C", readonly=True)
_PLACES = int64[::1]
_AT_ONCE = 128  # messages; of 150 bytes, 19 kB


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


def _reduce_power(bits: int) -> int:
    """Return x^bits modulo the polynomial of CRC-32, its bits as the checksum has them, times 2."""
    rest = 1
    for _ in range(bits):
        rest <<= 1
        rest ^= 0x104C11DB7 if rest >> 32 else 0
    return int(f"{rest:032b}"[::-1], 2) << 1


_FOLDED = 64  # bytes, four vectors
_VECTOR = ir.VectorType(ir.IntType(64), 2)
_POWERS = [_reduce_power(8 * _FOLDED + 32), _reduce_power(8 * _FOLDED - 32)]
# Of another processor than this one, which numba can be told to compile for, nobody knows.
HAS_FOLD = bool(
    binding.get_host_cpu_features().get("pclmul") and not (config.CPU_NAME or config.CPU_FEATURES)
)
"""Whether the processor multiplies without carries, which `fold` does."""


@intrinsic
def _fold_once(_: Any, _state: Any, _address: Any) -> Any:
    """Multiply a state of 64 bytes by x^512, modulo the polynomial, and add the bytes there."""

    def build(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        word, octet = ir.IntType(64), ir.IntType(8)
        kind = ir.FunctionType(_VECTOR, [_VECTOR, _VECTOR, octet])
        name = "llvm.x86.pclmulqdq"
        multiply = builder.module.globals.get(name) or ir.Function(builder.module, kind, name)
        powers = ir.Constant(_VECTOR, _POWERS)
        for place in range(0, _FOLDED, 16):
            states, addresses = (
                builder.inttoptr(builder.add(found, word(place)), _VECTOR.as_pointer())
                for found in arguments
            )
            state = builder.load(states, align=1)
            low, high = (builder.call(multiply, [state, powers, octet(half)]) for half in (0, 17))
            added = builder.load(addresses, align=1)
            builder.store(builder.xor(builder.xor(low, high), added), states, align=1)
        return context.get_dummy_value()

    return types.void(types.int64, types.int64), build


def _fold(data: Any, state: Any) -> None:
    """Take bytes into a state of 64 bytes that has the checksum of all that it has taken.

    Args:
        data: Of them all but the last, fewer than 64, are taken.
        state: The bytes before, the first four of all with the checksum before them added.
    """
    begin, to = data.ctypes.data, state.ctypes.data
    for place in range(0, len(data) - _FOLDED + 1, _FOLDED):
        _fold_once(to, begin + place)


_FOLD = types.void(_BYTES, types.Array(uint8, 1, "C"))
# After Gopal et al., "Fast CRC Computation for Generic Polynomials Using PCLMULQDQ" (2009).
fold = njit(_FOLD, nogil=True, cache=True)(_fold) if HAS_FOLD else None


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
    """Return where the last message starts of those that follow each other from the first byte on.

    Args:
        data: The records, perhaps cut.
        longest: The greatest length of a record that is believed [bytes].
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


@njit(inline="always")
def _count_usual(begin: int, starts: Any, size: int) -> int:
    """Return how many messages come before one that is longer or shorter, or in another order."""
    for message in range(len(starts)):
        place = begin + starts[message]
        extra = _load(uint64(0), place + 1) - size
        times = _load(uint64(0), place + 15) | _load(uint64(0), place + 23)
        # Plain CDR, little-endian, and of times that 63 bits hold.
        if extra > 3 or times >> uint64(63) or _load(uint16(0), place + 31) != 0x0100:
            return message
    return len(starts)


@njit(inline="always")
def _copy_numbers(source: int, starts: Any, kind: Any, width: int, together: int, to: int) -> None:
    """Copy so many numbers that stand together in each message."""
    if together == 1:  # nearly all: the loop for several takes twice as long
        for message in range(len(starts)):
            _store(to + message * width, _load(kind, source + starts[message]))
        return
    for message in range(len(starts)):
        for number in range(together):
            step = number * width
            _store(to + step, _load(kind, source + starts[message] + step))
        to += width * together


@njit(int64(_BYTES, _PLACES, uint64, int64[:, ::1], _PLACES, int64), nogil=True, cache=True)
def scatter(data: Any, starts: Any, size: int, numbers: Any, columns: Any, first: int) -> int:
    """Copy numbers from messages into columns, up to a message of another size; return how many.

    It takes as many messages at a time as the processor's nearest cache holds, and copies them
    column by column: message by message takes twice as long.

    Args:
        data: The records.
        starts: Where the messages start, each whole.
        size: Length of a usual record [bytes]; up to 3 more pass, as some middlewares pad messages.
        numbers: A row for each column: the offset from the message's start and the width of a
            number [bytes], and how many numbers stand together.
        columns: Address of the column of each.
        first: Row of the first message.
    """
    begin, done = data.ctypes.data, 0
    while done < len(starts):
        some = starts[done : done + _AT_ONCE]
        usual = _count_usual(begin, some, size)
        for number in range(len(numbers)):
            source, width = begin + numbers[number, 0], numbers[number, 1]
            together = numbers[number, 2]
            to = columns[number] + (first + done) * width * together
            if width == 8:
                _copy_numbers(source, some[:usual], uint64(0), 8, together, to)
            elif width == 4:
                _copy_numbers(source, some[:usual], uint32(0), 4, together, to)
            elif width == 2:
                _copy_numbers(source, some[:usual], uint16(0), 2, together, to)
            else:
                _copy_numbers(source, some[:usual], uint8(0), 1, together, to)
        done += usual
        if usual < len(some):
            break
    return done
