"""The messages of one topic in a block -> columns."""

from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import LogError
from turtlelog.log.engine.blocks import Block, Offsets
from turtlelog.log.engine.catalogue import TopicPlan
from turtlelog.log.engine.decode import Order, decode_messages
from turtlelog.log.engine.gather import gather_bytes
from turtlelog.log.engine.layout import (
    BIG_ENDIAN,
    ENCAPSULATION,
    LITTLE_ENDIAN,
    MESSAGE,
    Column,
    Layout,
    split_rows,
)
from turtlelog.log.engine.stretches import MESSAGE_HEAD

Rows = dict[str, Column]

LOG_TIME: Final = "#log_time"
PUBLISH_TIME: Final = "#publish_time"
SEQUENCE: Final = "#sequence"

MESSAGE_HEADER: Final = np.dtype(
    {
        "names": ["#length", LOG_TIME],
        "formats": ["<u8", "<u8"],
        "offsets": [1, 15],
        "itemsize": MESSAGE_HEAD,
    }
)
"""What stands before the data of any message, as far as it is needed alone."""

_PADDING: Final = 4  # some middlewares fill a message up to a multiple of this [bytes]
_LENGTH: Final = 22  # bytes of a message record that its length counts, before its data


def read_rows(plan: TopicPlan, block: Block, starts: Offsets) -> Rows:
    """Return the messages that start at these places as columns: fields, times and sequence.

    Raises:
        LogError: Where a message is not of the topic's type.
    """
    try:
        if plan.layout is None:
            return _read_differing(plan, block, starts)
        return _read_fixed(plan.layout, block, starts)
    except LogError as err:
        raise LogError(f"byte {block.byte}: topic {plan.topic}: {err}") from err


def make_empty_rows(plan: TopicPlan) -> Rows:
    """Return the columns of a topic without messages."""
    block = Block(data=b"", byte=0, offsets={}, rest=())
    return read_rows(plan, block, np.empty(0, np.int64))


def select_rows(
    rows: Mapping[str, Column], chosen: NDArray[np.bool_] | NDArray[np.int64] | slice
) -> Rows:
    """Return some of the rows."""
    return {name: values[chosen] for name, values in rows.items()}


class RowStore:
    """Rows of one topic, part by part; where their number is known, each is copied only once."""

    def __init__(self, expected: int) -> None:
        self._expected, self._used = expected, 0
        self._whole: Rows = {}
        self._others: list[Rows] = []

    def take(self, part: Rows) -> None:
        """Add rows behind those that are there."""
        end = self._used + len(part[LOG_TIME])
        if self._others or end > self._expected:
            self._others.append(part)
            return
        if not self._whole:
            self._whole = {
                name: np.empty((self._expected, *values.shape[1:]), values.dtype)
                for name, values in part.items()
            }
        for name, values in part.items():
            self._whole[name][self._used : end] = values
        self._used = end

    @property
    def parts(self) -> list[Rows]:
        """All rows, in one part where their number was right."""
        whole = [select_rows(self._whole, slice(self._used))] if self._used else []
        return [*whole, *self._others]


def join_rows(parts: list[Rows]) -> Rows:
    """Return the rows of all parts in order of log time; those of one time keep their order."""
    if len(parts) == 1:
        rows = parts[0]
    else:
        rows = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    times = rows[LOG_TIME]
    if len(times) > 1 and (times[1:] < times[:-1]).any():
        rows = select_rows(rows, np.argsort(times, kind="stable"))
    return rows


def _read_fixed(layout: Layout, block: Block, starts: Offsets) -> Rows:
    size = layout.little.itemsize
    if len(starts) and starts[-1] > len(block.data) - size:
        # The last one is too short: found by the check, which needs no more than its head.
        _check_sizes(gather_bytes(block.data, starts, MESSAGE_HEAD).view(MESSAGE_HEADER), layout)
    rows = gather_bytes(block.data, starts, size)
    heads = rows.view(layout.little)
    _check_sizes(heads, layout)
    _check_heads(heads)
    return split_rows(layout, rows)


def _check_sizes(heads: NDArray[np.void], layout: Layout) -> None:
    extra = heads["#length"] - np.uint64(_LENGTH + layout.size)  # wraps where it is below
    if len(extra) and extra.max() >= _PADDING:
        number = int((extra >= _PADDING).argmax())
        found = int(heads["#length"][number]) - _LENGTH
        raise LogError(f"message {number}: expected {layout.size} bytes, found {found}")


def _read_differing(plan: TopicPlan, block: Block, starts: Offsets) -> Rows:
    lengths = (
        gather_bytes(block.data, starts, MESSAGE_HEAD)
        .view(MESSAGE_HEADER)["#length"]
        .astype(np.int64)
    )
    if (lengths < _LENGTH + ENCAPSULATION).any():
        number = int((lengths < _LENGTH + ENCAPSULATION).argmax())
        found = lengths[number] - _LENGTH
        raise LogError(f"message {number}: expected at least 4 bytes, found {found}")
    heads = gather_bytes(block.data, starts, MESSAGE.itemsize).view(MESSAGE)
    _check_heads(heads)
    firsts, ends = starts + MESSAGE.itemsize, starts + 9 + lengths
    columns: Rows = {
        LOG_TIME: heads[LOG_TIME].astype(np.int64),
        PUBLISH_TIME: heads[PUBLISH_TIME].astype(np.int64),
        SEQUENCE: heads[SEQUENCE].astype(np.uint32),
    }
    is_big = heads["#encapsulation"] == BIG_ENDIAN
    if not is_big.any():
        return columns | decode_messages(plan.fields, block.data, firsts, ends, "<")
    orders: tuple[tuple[Order, NDArray[np.bool_]], ...] = (("<", ~is_big), (">", is_big))
    for order, rows in orders:
        found = decode_messages(plan.fields, block.data, firsts[rows], ends[rows], order)
        for name, values in found.items():
            shape = (len(starts), *values.shape[1:])
            columns.setdefault(name, np.empty(shape, values.dtype))[rows] = values
    return columns


def _check_heads(heads: NDArray[np.void]) -> None:
    """Check that every message is plain CDR, and of a time that 63 bits hold."""
    kinds = heads["#encapsulation"]
    wrong = kinds != LITTLE_ENDIAN
    if wrong.any() and (wrong := wrong & (kinds != BIG_ENDIAN)).any():
        number = int(wrong.argmax())
        found = kinds[number].tobytes().hex()
        raise LogError(f"message {number}: expected the CDR header 0001 or 0000, found {found}")
    for name in (LOG_TIME, PUBLISH_TIME):
        if len(heads) and heads[name].max() >= 2**63:
            raise LogError(f"expected times below 2^63 ns, found {heads[name].max()}")
