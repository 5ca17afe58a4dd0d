"""Fields -> the record in which numpy sees a whole message, where the type has a fixed size."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.log.engine.message_types import TEXT, Field

Column = NDArray[Any]

MESSAGE: Final = np.dtype(
    {
        "names": [
            *("#opcode", "#length", "#channel", "#sequence", "#log_time", "#publish_time"),
            "#encapsulation",
        ],
        "formats": ["u1", "<u8", "<u2", "<u4", "<u8", "<u8", "<u2"],
        "offsets": [0, 1, 9, 11, 15, 23, 31],
        "itemsize": 35,
    }
)
"""What stands before the fields of a CDR message, from the record's opcode on.

A field of ROS cannot start with #.
"""

LITTLE_ENDIAN: Final = 0x0100
"""Encapsulation of plain CDR, its two bytes read as a little-endian number."""

BIG_ENDIAN: Final = 0x0000

ENCAPSULATION: Final = 4
"""Bytes before the fields that say which CDR it is; alignment counts from behind them."""

_LARGEST_RECORD: Final = 2**28  # bytes; a schema may claim arrays of any length


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """The bytes of a message type of fixed size.

    Attributes:
        little: Record from the opcode to the last field, little-endian.
        big: The same with big-endian fields.
        size: Of the message, encapsulation included [bytes].
        kinds: The type code of every field, by dotted name in order.
    """

    little: np.dtype[np.void]
    big: np.dtype[np.void]
    size: int
    kinds: dict[str, str]


def lay_out(fields: tuple[Field, ...]) -> Layout | None:
    """Return the layout of a type; None where messages of it differ in size.

    CDR aligns a number to its own size, and nothing else.
    """
    if not _is_fixed(fields):
        return None
    places: list[tuple[str, str, int | None, int]] = []
    end = _place(fields, "", 0, places)
    if end > _LARGEST_RECORD:
        return None
    kinds = {name: kind for name, kind, _, _ in places}
    size = ENCAPSULATION + end
    return Layout(
        little=_join(places, end, "<"), big=_join(places, end, ">"), size=size, kinds=kinds
    )


def name_parts(field: Field) -> Iterator[str]:
    """Yield the names that a nested message has in dotted names: one, or one per array element."""
    if field.length is None:
        yield field.name
    else:
        yield from (f"{field.name}.{number}" for number in range(field.length))


def split_rows(layout: Layout, rows: NDArray[np.void]) -> dict[str, Column]:
    """Return contiguous columns in the machine's byte order, of records as `MESSAGE` and fields."""
    little = rows.view(layout.little)
    columns: dict[str, Column] = {
        "#log_time": little["#log_time"].astype(np.int64),
        "#publish_time": little["#publish_time"].astype(np.int64),
        "#sequence": little["#sequence"].astype(np.uint32),
        **{name: _copy(little[name], kind) for name, kind in layout.kinds.items()},
    }
    is_big = little["#encapsulation"] == BIG_ENDIAN
    if is_big.any():
        big = rows.view(layout.big)
        for name, kind in layout.kinds.items():
            columns[name][is_big] = _copy(big[name][is_big], kind)
    return columns


def _copy(values: Column, kind: str) -> Column:
    # A byte that is neither 0 nor 1 is no bool of numpy's.
    return values != 0 if kind == "?" else values.astype(kind)


def _is_fixed(fields: tuple[Field, ...]) -> bool:
    return all(
        not field.is_sequence
        and (field.kind != TEXT if isinstance(field.kind, str) else _is_fixed(field.kind))
        for field in fields
    )


def _place(
    fields: tuple[Field, ...], prefix: str, end: int, places: list[tuple[str, str, int | None, int]]
) -> int:
    """Append name, kind, array length and offset of every number; return where they end."""
    for field in fields:
        if isinstance(field.kind, str):
            size = np.dtype(field.kind).itemsize
            end += -end % size
            places.append((prefix + field.name, field.kind, field.length, end))
            end += size * (1 if field.length is None else field.length)
        else:
            for part in name_parts(field):
                end = _place(field.kind, f"{prefix}{part}.", end, places)
    # ROS gives a type without fields one byte.
    return end if fields else end + 1


def _join(
    places: list[tuple[str, str, int | None, int]], end: int, order: str
) -> np.dtype[np.void]:
    formats = []
    for _, kind, length, _ in places:
        code = f"{order}{kind.replace('?', 'u1')}"
        formats.append(code if length is None else f"({length},){code}")
    assert MESSAGE.names is not None
    layout = {
        "names": [*MESSAGE.names, *(name for name, *_ in places)],
        "formats": [*(MESSAGE[name] for name in MESSAGE.names), *formats],
        "offsets": [
            *(MESSAGE.fields[name][1] for name in MESSAGE.names if MESSAGE.fields),
            *(MESSAGE.itemsize + place for *_, place in places),
        ],
        "itemsize": MESSAGE.itemsize + end,
    }
    return np.dtype(layout)  # type: ignore[call-overload,no-any-return]
