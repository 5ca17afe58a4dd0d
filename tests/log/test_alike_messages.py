"""Messages that differ in numbers alone have the bytes of messages encoded one by one."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from turtlelog.log.engine.cdr import encode_message
from turtlelog.log.engine.message_types import PackedItems, lay_out_alike, read_type
from turtlelog.log.engine.records import FRONT
from turtlelog.log.recording.topics import SCHEMAS


@pytest.mark.parametrize(
    ("kind", "prefix"),
    [
        ("nav_msgs/msg/Odometry", ""),
        ("geometry_msgs/msg/PoseStamped", ""),
        ("tf2_msgs/msg/TFMessage", "transforms.0."),
        ("nav_msgs/msg/Path", "poses.0."),
        ("rcl_interfaces/msg/Log", ""),
    ],
)
@settings(max_examples=25)
@given(text=st.text(max_size=9).filter(lambda text: "\0" not in text), seed=st.integers(0, 99))
def test_bytes_are_those_of_one_by_one(kind: str, prefix: str, text: str, seed: int) -> None:
    fields = read_type(kind, SCHEMAS[kind]).fields
    try:
        text.encode()
    except UnicodeEncodeError:
        return
    texts = {"nav_msgs/msg/Odometry": "child_frame_id", "rcl_interfaces/msg/Log": "msg"}
    name = prefix + texts.get(kind, "header.frame_id")
    rows = 3
    columns = {name: np.full(rows, text, dtype=object)}
    if prefix:  # a sequence has an item as soon as one of its fields is named
        columns[f"{prefix}header.stamp.sec"] = np.arange(rows)
    layout = lay_out_alike(fields, columns)
    assert layout is not None
    random = np.random.default_rng(seed)
    for number, code, length, _ in layout.numbers:
        shape = (rows,) if length is None else (rows, length)
        columns[number] = random.integers(0, 100, shape).astype(f"<{code.replace('?', 'u1')}")
    found = layout.fill(rows, columns)
    for row in range(rows):
        values = {key: column[row] for key, column in columns.items()}
        if prefix:
            items = {
                key.removeprefix(prefix): values.pop(key)
                for key in [*values]
                if key.startswith(prefix)
            }
            values[prefix.partition(".")[0]] = [items]
        expected = encode_message(fields, values, 0, (0, 0, 0))[FRONT.size :]
        assert found[row].tobytes() == expected


def test_texts_that_differ_and_values_of_other_kinds_are_encoded_one_by_one() -> None:
    kind = "geometry_msgs/msg/PoseStamped"
    fields = read_type(kind, SCHEMAS[kind]).fields
    frame = "header.frame_id"
    assert lay_out_alike(fields, {frame: np.array(["a", "a"], dtype=object)}) is not None
    assert lay_out_alike(fields, {frame: np.array(["a", "b"], dtype=object)}) is None
    assert lay_out_alike(fields, {frame: np.array([1, 1], dtype=object)}) is None
    objects = np.array([1.0, 2.0], dtype=object)
    assert lay_out_alike(fields, {"pose.position.x": objects}) is None
    assert lay_out_alike(fields, {"pose.position.x": np.zeros((2, 2))}) is None


def test_items_that_are_packed_have_the_bytes_of_items() -> None:
    kind, item = "nav_msgs/msg/Path", "geometry_msgs/msg/PoseStamped"
    fields = read_type(kind, SCHEMAS[kind]).fields
    rows = [{"header.frame_id": "world", "pose.position.x": float(number)} for number in range(4)]
    columns = {
        "header.frame_id": np.full(4, "world", dtype=object),
        "pose.position.x": np.arange(4.0),
    }
    layout = lay_out_alike(read_type(item, SCHEMAS[item]).fields, columns)
    assert layout is not None
    packed = PackedItems(4, layout.fill(4, columns).tobytes())
    values = {"header.frame_id": "world"}
    assert encode_message(fields, {**values, "poses": packed}, 0, (0, 0, 0)) == encode_message(
        fields, {**values, "poses": rows}, 0, (0, 0, 0)
    )
