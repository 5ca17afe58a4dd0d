"""Bags as other people's recorders leave them."""

import math
import sqlite3
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from mcap_ros2.writer import Writer
from rosbags.typesys import Stores, get_typestore

from tests.known import known
from tests.log.engine.raw_records import read_raw
from turtlelog.log.engine.channels import find_definition

START_NS: Final = 1_700_000_000_123_456_789
TICK_NS: Final = 16_000_000

_FLOATS: Final = ("x", "y", "theta", "linear_velocity", "angular_velocity")
_TURTLESIM: Final = "".join(f"float32 {name}\n" for name in _FLOATS)


@dataclass(frozen=True, kw_only=True)
class Said:
    """A message; sequence and publish time as rosbag2 leaves them."""

    topic: str
    type: str
    values: dict[str, Any] = field(default_factory=dict)
    time_ns: int = START_NS
    sequence: int = 0


def make_poses(
    count: int = 3, *, topic: str = "/turtle1/pose", kind: str = "turtlesim/msg/Pose", **values: Any
) -> list[Said]:
    pose = {"x": 1.0, "y": 2.0, "theta": 0.5, "linear_velocity": 0.25, "angular_velocity": -0.5}
    return [
        Said(topic=topic, type=kind, values=pose | values, time_ns=START_NS + row * TICK_NS)
        for row in range(count)
    ]


def make_command(
    forward: float = 1.0,
    *,
    topic: str = "/turtle1/cmd_vel",
    time_ns: int = START_NS,
    number: int = 0,
) -> Said:
    values = {"linear": make_vector(forward, 0.5), "angular": make_vector(0.0, 0.0, 2.0)}
    return Said(
        topic=topic,
        type="geometry_msgs/msg/Twist",
        values=values,
        time_ns=time_ns,
        sequence=number,
    )


def make_stamped_pose(topic: str = "/pose", *, yaw_rad: float = 0.0, length: float = 1.0) -> Said:
    return Said(
        topic=topic, type="geometry_msgs/msg/PoseStamped", values=_make_pose(yaw_rad, length)
    )


def make_odometry(*, yaw_rad: float, speed: tuple[float, float], turn_rate: float) -> Said:
    twist = {"linear": make_vector(*speed), "angular": make_vector(0.0, 0.0, turn_rate)}
    values = {
        **_make_pose(yaw_rad, 1.0),
        "child_frame_id": "base_link",
        "twist": {"twist": twist, "covariance": [0.0] * 36},
    }
    values["pose"] = {"pose": values["pose"], "covariance": [math.nan] * 36}
    return Said(topic="/odom", type="nav_msgs/msg/Odometry", values=values)


def make_vector(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> dict[str, float]:
    return {"x": x, "y": y, "z": z}


def _make_pose(yaw_rad: float, length: float) -> dict[str, Any]:
    turn = {"z": length * math.sin(yaw_rad / 2), "w": length * math.cos(yaw_rad / 2)}
    return {
        "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": "map"},
        "pose": {"position": make_vector(3.0, 4.0), "orientation": make_vector() | turn},
    }


def write_mcap(path: Path, messages: Iterable[Said]) -> Path:
    """Write messages in the order given."""
    store = get_typestore(Stores.ROS2_JAZZY)
    with path.open("wb") as stream:
        writer = Writer(stream)
        schemas = {}
        for said in messages:
            if said.type not in schemas:
                text = (
                    _TURTLESIM
                    if said.type.startswith("turtlesim")
                    else known(find_definition(said.type))
                    if said.type.startswith("ackermann")
                    else store.generate_msgdef(said.type, ros_version=2)[0]
                )
                schemas[said.type] = writer.register_msgdef(said.type, text)
            writer.write_message(
                said.topic,
                schemas[said.type],
                said.values,
                log_time=said.time_ns,
                publish_time=said.time_ns,
                sequence=said.sequence,
            )
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def write_sqlite(
    path: Path, messages: Iterable[Said], *, schema: int = 4, definitions: bool = True
) -> Path:
    """Write the messages that `write_mcap` writes, byte for byte, as rosbag2 does in SQLite.

    Args:
        path: The file.
        messages: In the order given.
        schema: 1 of Dashing, without quality of service; 2 to Galactic; 3 of Humble; 4 of Jazzy.
        definitions: Whether version 4 finds the definitions of the types.
    """
    raw = read_raw(write_mcap(path.with_name(f"{path.name}.mcap"), messages))
    path.with_name(f"{path.name}.mcap").unlink()
    connection = sqlite3.connect(path)
    notes = [", offered_qos_profiles TEXT NOT NULL"] * (schema > 1)
    notes += [", type_description_hash TEXT NOT NULL"] * (schema > 3)
    connection.execute(
        "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,"
        f" serialization_format TEXT NOT NULL{''.join(notes)})"
    )
    connection.execute(
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL,"
        " timestamp INTEGER NOT NULL, data BLOB NOT NULL)"
    )
    connection.execute("CREATE INDEX timestamp_idx ON messages (timestamp ASC)")
    if schema > 2:
        connection.execute("CREATE TABLE schema(schema_version INTEGER, ros_distro TEXT)")
        connection.execute("INSERT INTO schema VALUES (?, 'humble')", (schema,))
        connection.execute("CREATE TABLE metadata(id INTEGER, metadata_version INTEGER, metadata)")
    if schema > 3:
        connection.execute(
            "CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL,"
            " encoding TEXT NOT NULL, encoded_message_definition TEXT NOT NULL,"
            " type_description_hash TEXT NOT NULL)"
        )
    for found in raw.schemas.values() if schema > 3 else ():
        text = found.data.decode() if definitions else ""
        row = (found.name, "ros2msg" if definitions else "unknown", text, "RIHS01_0")
        connection.execute("INSERT INTO message_definitions VALUES (NULL, ?, ?, ?, ?)", row)
    for channel in raw.channels.values():
        kind = raw.schemas[channel.schema_id].name
        values = (channel.id, channel.topic, kind, "cdr", *("" for _ in notes))
        marks = ",".join("?" * len(values))
        connection.execute(f"INSERT INTO topics VALUES ({marks})", values)
    connection.executemany(
        "INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)",
        [(found.channel_id, found.log_time, found.data) for found in raw.messages],
    )
    connection.commit()
    connection.close()
    return path


def write_metadata(
    folder: Path, files: Sequence[str], *, storage: str = "mcap", mode: str = '""'
) -> Path:
    lines = [
        "rosbag2_bagfile_information:",
        "  version: 5",
        f"  storage_identifier: {storage}",
        "  relative_file_paths:",
        *(f"    - {file}" for file in files),
        "  duration:",
        "    nanoseconds: 2500000000",
        '  compression_format: ""',
        f"  compression_mode: {mode}",
    ]
    (folder / "metadata.yaml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder


def change(file: Path, *queries: str) -> Path:
    connection = sqlite3.connect(file)
    for query in queries:
        connection.execute(query)
    connection.commit()
    connection.close()
    return file
