"""Messages that hold many others: in time and memory linear in their length."""

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.torture.bombs import channel, chunk, describe, message, pose_messages, schema, whole
from turtlelog.errors import LogError
from turtlelog.log import read_run
from turtlelog.log.engine import cdr
from turtlelog.log.engine.message_types import read_type

INNER = f"{'=' * 80}\nMSG: test/Inner\n"
FIELDS = read_type("test/msg/List", f"Inner[] a\n{INNER}string s\nfloat64 x\nbool on\n").fields


def pack(*rows: list[tuple[str, float]]) -> tuple[bytes, Any, Any]:
    """Return messages as bytes, with the places where they start and end."""
    data, starts, ends = bytearray(), [], []
    for row in rows:
        starts.append(len(data))
        data += struct.pack("<I", len(row))
        for text, number in row:
            data += bytes((starts[-1] - len(data)) % 4)
            data += struct.pack("<I", len(text) + 1) + text.encode() + b"\0"
            data += bytes((starts[-1] - len(data)) % 8) + struct.pack("<d?", number, number > 0)
        ends.append(len(data))
        data += bytes(-len(data) % 8)
    return bytes(data), np.array(starts), np.array(ends)


ROWS = [("a", 1.5), ("", -2.0), ("long text", 3.0)] * 5


def test_a_long_list_is_taken_message_by_message(monkeypatch: pytest.MonkeyPatch) -> None:
    packed = pack(ROWS, [], ROWS[:4], *[ROWS[:1]] * 20)
    found = cdr.decode_messages(FIELDS, *packed, "<")["a"].tolist()
    monkeypatch.setattr(cdr, "take_few_lists", lambda *_: None)
    assert found == cdr.decode_messages(FIELDS, *packed, "<")["a"].tolist()
    assert [len(row) for row in found] == [15, 0, 4, *[1] * 20]
    assert found[0][2] == {"s": "long text", "x": 3.0, "on": True}


@pytest.mark.parametrize("cut", [1, 9, 40])
def test_a_long_list_that_is_cut_is_told(cut: int) -> None:
    data, starts, ends = pack(ROWS)
    with pytest.raises(LogError, match=r"^a: .*message 0: expected more than \d+ bytes$"):
        cdr.decode_messages(FIELDS, data[:-cut], starts, ends - cut, "<")


def test_a_text_that_is_no_text_in_a_long_list_is_told() -> None:
    data, starts, ends = pack(ROWS)
    with pytest.raises(LogError, match="message 0: expected UTF-8 text"):
        cdr.decode_messages(FIELDS, data.replace(b"long", b"\xff\xff\xff\xff"), starts, ends, "<")


def test_a_long_path_is_read_in_few_steps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    steps = [0]
    take = cdr._Cursor.take_values

    def count(self: Any, kind: Any) -> Any:
        steps[0] += 1
        return take(self, kind)

    monkeypatch.setattr(cdr._Cursor, "take_values", count)
    plan = b"\0\1\0\0" + bytes(8) + b"\1\0\0\0" + bytes(4) + struct.pack("<I", 1000)
    front = schema(2, "nav_msgs/msg/Path", "") + channel(2, "/plan", 2)
    rows = pose_messages(1, 2) + message(2, plan + bytes(1000 * 72 - 4))
    (tmp_path / "a.mcap").write_bytes(whole(chunk([describe("/turtle1/pose"), front, rows])))
    assert "path" in read_run(tmp_path / "a.mcap").notes
    assert steps[0] == 0


@pytest.mark.parametrize("count", [20, 21])
def test_arrays_in_a_long_list_are_bounded(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cdr, "_MOST_STEPS", 20)
    fields = read_type("test/msg/List", f"Inner[] a\n{INNER}uint8[] b\n").fields
    data = struct.pack("<I", count) + bytes(4 * count)
    packed = data, np.array([0]), np.array([len(data)])
    if count == 20:
        assert len(cdr.decode_messages(fields, *packed, "<")["a"][0]) == 20
        return
    with pytest.raises(LogError, match="a: message 0: expected up to 20 values, each of any size"):
        cdr.decode_messages(fields, *packed, "<")


def test_many_texts_are_taken_in_few_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cdr, "_MOST_STEPS", 0)
    fields = read_type("test/msg/Names", "string[] names\nuint8 last\n").fields
    texts = (b"\2\0\0\0a\0\0\0" * 100)[:-2]
    data = struct.pack("<I", 100) + texts + b"\7"
    found = cdr.decode_messages(fields, data, np.array([0]), np.array([len(data)]), "<")
    assert found["names"][0] == ["a"] * 100
    assert found["last"].tolist() == [7]
