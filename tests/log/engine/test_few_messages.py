import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from turtlelog.errors import LogError
from turtlelog.log.engine import cdr
from turtlelog.log.engine.cdr import FEW_MESSAGES, decode_few
from turtlelog.log.engine.message_types import read_type

DEFINITION = "uint8 level\nstring name\nfloat64 x\nbool on\nint16 low\nstring text\nfloat32 y\n"
FIELDS = read_type("test/msg/Mixed", DEFINITION).fields
ROWS = [(7, "", 0.1, 1, -3, "a", 2.5), (255, "\u00fcber", -0.0, 2, 9, "long text", np.nan)]


def pack(*rows: tuple[Any, ...]) -> tuple[bytes, Any, Any]:
    """Return messages as bytes, with the places where they start and end."""
    data, starts, ends = bytearray(b"?" * 3), [], []
    for row in rows:
        starts.append(len(data))
        for code, value in zip("BsdBhsf", row, strict=True):
            size = 4 if code == "s" else struct.calcsize(code)
            data += bytes((starts[-1] - len(data)) % size)
            text = value.encode() + b"\0" if code == "s" else b""
            number = len(text) if code == "s" else value
            data += struct.pack("<" + code.replace("s", "I"), number) + text
        ends.append(len(data))
    return bytes(data), np.array(starts), np.array(ends)


def decode_all(data: bytes, starts: Any, ends: Any) -> dict[str, Any]:
    taken, columns = cdr._Cursor(data, starts, ends, "<"), dict[str, Any]()
    taken.take_fields(FIELDS, "", columns)
    return columns


@pytest.mark.parametrize("count", [1, 2, FEW_MESSAGES, FEW_MESSAGES + 1])
def test_few_messages_are_read_as_many_are(count: int) -> None:
    packed = pack(*(ROWS * FEW_MESSAGES)[:count])
    few, many = decode_few(FIELDS, *packed), decode_all(*packed)
    assert few is not None
    assert list(few) == list(many)
    for name, values in many.items():
        assert few[name].dtype == values.dtype
        assert few[name].tolist() == values.tolist() or name == "y"
        assert values.dtype == object or few[name].tobytes() == values.tobytes()


@pytest.mark.parametrize(
    "harm",
    [
        lambda data, starts, ends: (data, starts, ends - 1),
        lambda data, starts, ends: (data + bytes(4), starts, ends + 4),
        lambda data, starts, ends: (data.replace(b"long", b"\xff\xff\xff\xff"), starts, ends),
        lambda data, starts, ends: (
            data.replace(struct.pack("<I", 10), b"\xff" * 4),
            starts,
            ends,
        ),
    ],
    ids=["short", "long", "no text", "endless text"],
)
def test_messages_that_are_not_sound_are_left_to_the_general_way(
    harm: Callable[..., tuple[bytes, Any, Any]],
) -> None:
    data, starts, ends = pack(*ROWS)
    data, starts, ends = harm(data, starts[1:], ends[1:])
    assert decode_few(FIELDS, data, starts, ends) is None
    with pytest.raises(LogError):
        cdr.decode_messages(FIELDS, data, starts, ends, "<")


def test_up_to_three_bytes_of_padding_do_no_harm() -> None:
    data, starts, ends = pack(*ROWS)
    assert decode_few(FIELDS, data + bytes(3), starts[1:], ends[1:] + 3) is not None


@pytest.mark.parametrize("definition", ["float64[] x\n", "string[2] x\n", "uint8[3] x\n", ""])
def test_types_with_arrays_or_nothing_in_them_are_left_to_the_general_way(definition: str) -> None:
    fields = read_type("test/msg/Other", definition).fields
    assert decode_few(fields, bytes(40), np.array([0]), np.array([8])) is None
