"""CDR, the bytes of ROS 2 messages: our few types to bytes and back, from one table of fields.

The encoder of mcap-ros2-support is public only inside its own writer, which leaves no choice of
indexes; here whole columns go through numpy at once.
"""

import struct
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import LogError

Column = NDArray[Any]

_TEXT: Final = "text"
_HEADER: Final = b"\x00\x01\x00\x00"  # encapsulation: plain CDR, little-endian
_XYZ: Final = ("x", "y", "z")
_STAMP: Final = MappingProxyType({"stamp.sec": "<i4", "stamp.nanosec": "<u4"})

_CONTROL_NUMBERS: Final = (
    *("bearing", "heading_error", "error_x", "error_y", "distance", "wanted_speed"),
    *("wanted_turn_rate", "speed", "turn_rate", "world_v_x", "world_v_y"),
)

_FIELDS: Final[Mapping[str, Mapping[str, str]]] = MappingProxyType(
    {
        "geometry_msgs/msg/PoseStamped": {
            **_STAMP,
            "frame_id": _TEXT,
            **{f"position.{axis}": "<f8" for axis in _XYZ},
            **{f"orientation.{axis}": "<f8" for axis in (*_XYZ, "w")},
        },
        "turtlesim/msg/Pose": dict.fromkeys(
            ("x", "y", "theta", "linear_velocity", "angular_velocity"), "<f4"
        ),
        "geometry_msgs/msg/Pose2D": dict.fromkeys(("x", "y", "theta"), "<f8"),
        "turtlelog_msgs/msg/ControlSample": {
            "sequence": "<u4",
            "pose_sequence": "<u4",
            "phase": "<u1",
            **dict.fromkeys(_CONTROL_NUMBERS, "<f8"),
        },
        "geometry_msgs/msg/Twist": {
            f"{part}.{axis}": "<f8" for part in ("linear", "angular") for axis in _XYZ
        },
        "std_msgs/msg/String": {"data": _TEXT},
        "rcl_interfaces/msg/Log": {
            **_STAMP,
            "level": "<u1",
            **dict.fromkeys(("name", "msg", "file", "function"), _TEXT),
            "line": "<u4",
        },
    }
)
"""The fields of a message type in order, nested ones by dotted name."""


def _lay_out(fields: Mapping[str, str]) -> np.dtype[np.void]:
    """Return the record of a type without text: CDR aligns a number to its own size."""
    offsets, end = [], 0
    for kind in fields.values():
        size = np.dtype(kind).itemsize
        offsets.append(len(_HEADER) + end + -end % size)
        end += -end % size + size
    layout = {
        "names": ["encapsulation", *fields],
        "formats": [f"V{len(_HEADER)}", *fields.values()],
        "offsets": [0, *offsets],
        "itemsize": len(_HEADER) + end,
    }
    return np.dtype(layout)  # type: ignore[call-overload,no-any-return]


_LAYOUTS: Final = MappingProxyType(
    {schema: _lay_out(fields) for schema, fields in _FIELDS.items() if _TEXT not in fields.values()}
)


def encode_columns(schema: str, count: int, columns: Mapping[str, Any]) -> list[bytes]:
    """Return `count` messages of a type without text; a field left out is 0."""
    layout = _LAYOUTS[schema]
    rows = np.zeros(count, dtype=layout)
    rows["encapsulation"] = np.void(_HEADER)
    # What 32 bits cannot hold becomes inf here, and is exact on a topic with 64.
    with np.errstate(over="ignore"):
        for name, values in columns.items():
            rows[name] = values
    data, size = rows.tobytes(), layout.itemsize
    return [data[start : start + size] for start in range(0, len(data), size)]


def encode_message(schema: str, values: Mapping[str, Any]) -> bytes:
    """Return one message of a type with text; a field left out is 0 or empty."""
    body = bytearray()
    for name, kind in _FIELDS[schema].items():
        if kind == _TEXT:
            text = str(values.get(name, "")).encode() + b"\x00"
            body += bytes(-len(body) % 4) + struct.pack("<I", len(text)) + text
        else:
            number = np.array(values.get(name, 0), dtype=kind)
            body += bytes(-len(body) % number.itemsize) + number.tobytes()
    return _HEADER + body


def decode_columns(schema: str, payloads: Sequence[bytes]) -> dict[str, Column]:
    """Return the fields of messages as columns; texts become columns of objects.

    Raises:
        LogError: Where a message is not of the type.
    """
    for number, payload in enumerate(payloads):
        if payload[: len(_HEADER)] != _HEADER:
            found = payload[: len(_HEADER)].hex()
            raise LogError(f"message {number}: expected the CDR header 00010000, found {found}")
    if schema in _LAYOUTS:
        return _view_columns(_LAYOUTS[schema], payloads)
    rows = [_decode_message(schema, number, payload) for number, payload in enumerate(payloads)]
    return {
        name: np.array([row[name] for row in rows], dtype=object if kind == _TEXT else kind)
        for name, kind in _FIELDS[schema].items()
    }


def _view_columns(layout: np.dtype[np.void], payloads: Sequence[bytes]) -> dict[str, Column]:
    for number, payload in enumerate(payloads):
        if len(payload) != layout.itemsize:
            raise LogError(
                f"message {number}: expected {layout.itemsize} bytes, found {len(payload)}"
            )
    rows = np.frombuffer(bytearray().join(payloads), dtype=layout)
    return {name: np.ascontiguousarray(rows[name]) for name in (layout.names or ())[1:]}


def _decode_message(schema: str, number: int, payload: bytes) -> dict[str, Any]:
    body, place, row = memoryview(payload)[len(_HEADER) :], 0, {}
    for name, kind in _FIELDS[schema].items():
        size = 4 if kind == _TEXT else np.dtype(kind).itemsize
        place += -place % size
        value: Any = np.frombuffer(body[place : place + size], dtype=kind.replace(_TEXT, "<u4"))
        place += size
        if kind == _TEXT:
            text = bytes(body[place : place + int(value[0])])
            place += int(value[0])
            value = [text.removesuffix(b"\x00").decode()]
        if place > len(body):
            raise LogError(f"message {number}: {name}: expected more than {len(payload)} bytes")
        row[name] = value[0]
    return row
