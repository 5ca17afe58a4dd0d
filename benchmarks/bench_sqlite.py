"""A bag in SQLite of a million messages as columns, against a bare select of its rows and rosbags.

The select gets time and data of every row out of SQLite, row by row, and keeps none of them:
`for row in connection.execute("select timestamp, data from messages")`. It is a peer and no bound:
the pages of the file can be read without SQLite. The bound is to read the bytes of the file.
"""

import sqlite3
import tempfile
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from benchmarks.table import Cost, Row, run_alone, time_calls
from turtlelog.log import read_columns, read_info

MESSAGES = 1_000_000
PART = 50_000  # of them, that rosbags reads: it takes long enough
COMMANDS_EVERY = 60
REPEATS = 5

_POSE = "float32 x\nfloat32 y\nfloat32 theta\nfloat32 linear_velocity\nfloat32 angular_velocity\n"
_CDR = b"\x00\x01\x00\x00"


def write_bag(path: Path, count: int) -> None:
    """Write poses of turtlesim, and a command now and then, as rosbag2 of Humble does."""
    values = np.random.default_rng(1).random((count, 6))
    poses = values[:, :5].astype("<f4")
    rows = (
        (row, 1, 1_700_000_000_000_000_000 + 16_000_000 * row, _CDR + values[row].tobytes())
        if row % COMMANDS_EVERY == 0
        else (row, 2, 1_700_000_000_000_000_000 + 16_000_000 * row, _CDR + poses[row].tobytes())
        for row in range(count)
    )
    connection = sqlite3.connect(path)
    connection.executescript(
        "CREATE TABLE topics(id INTEGER PRIMARY KEY,name TEXT NOT NULL,type TEXT NOT NULL,"
        "serialization_format TEXT NOT NULL,offered_qos_profiles TEXT NOT NULL);"
        "CREATE TABLE messages(id INTEGER PRIMARY KEY,topic_id INTEGER NOT NULL,"
        "timestamp INTEGER NOT NULL, data BLOB NOT NULL);"
        "CREATE INDEX timestamp_idx ON messages (timestamp ASC);"
        "INSERT INTO topics VALUES(1,'/turtle1/cmd_vel','geometry_msgs/msg/Twist','cdr','');"
        "INSERT INTO topics VALUES(2,'/turtle1/pose','turtlesim/msg/Pose','cdr','');"
    )
    connection.executemany("INSERT INTO messages VALUES(?,?,?,?)", rows)
    connection.commit()
    connection.close()


def select_rows(path: Path) -> int:
    """Get every row out of SQLite, and drop it."""
    connection = sqlite3.connect(f"{path.as_uri()}?mode=ro&immutable=1", uri=True)
    count = 0
    for _ in connection.execute("select timestamp, data from messages"):
        count += 1
    connection.close()
    return count


def deserialize_rows(path: Path, count: int) -> None:
    """Read messages through rosbags."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(_POSE, "turtlesim/msg/Pose"))
    with AnyReader([path], default_typestore=store) as reader:
        for connection, _, data in islice(reader.messages(), count):
            reader.deserialize(data, connection.msgtype)


def measure(share: float = 1.0) -> Iterator[Row]:
    messages, part = round(MESSAGES * share), round(PART * share)
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "million.db3"
        write_bag(path, messages)
        assert select_rows(path) == messages
        assert sum(map(len, read_columns(path).values())) == messages
        ours, info, select, bound = time_calls(
            lambda: read_columns(path),
            lambda: read_info(path),
            lambda: select_rows(path),
            path.read_bytes,
            repeats=REPEATS,
        )
        (rosbags,) = time_calls(lambda: deserialize_rows(path, part), repeats=1)
    peer = Cost("select", select, is_yardstick=True)
    job = f"read {messages:,} rows of .db3"
    yield Row(job=job, value=ours, peer=peer, aim=3)
    yield Row(
        job=job,
        value=ours,
        peer=Cost("rosbags", rosbags * messages / part),
        bound=Cost("bytes", bound),
    )
    yield Row(job="info of the .db3", value=info, peer=peer, aim=3)


if __name__ == "__main__":
    run_alone(measure)
