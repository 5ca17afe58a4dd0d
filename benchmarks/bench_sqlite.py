"""A bag in SQLite of a million messages as columns, against a bare select of its rows and rosbags.

The bound is the time in which Python gets time and data of every row out of SQLite, row by row, and
keeps none of them: `for row in connection.execute("select timestamp, data from messages")`.
"""

import sqlite3
import statistics
import tempfile
import time
from collections.abc import Callable
from itertools import islice
from pathlib import Path

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from turtlelog.log import read_columns, read_info

MESSAGES = 1_000_000
PART = 50_000  # of them, that rosbags reads: it takes long enough
COMMANDS_EVERY = 60
REPEATS = 5

_POSE = "float32 x\nfloat32 y\nfloat32 theta\nfloat32 linear_velocity\nfloat32 angular_velocity\n"
_CDR = b"\x00\x01\x00\x00"


def measure(call: Callable[[], object], repeats: int = REPEATS) -> float:
    """Return the median time of a call [s]."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return statistics.median(times)


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


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "million.db3"
        write_bag(path, MESSAGES)
        assert select_rows(path) == MESSAGES
        assert sum(map(len, read_columns(path).values())) == MESSAGES
        bound = measure(lambda: select_rows(path))
        ours = measure(lambda: read_columns(path))
        info = measure(lambda: read_info(path))
        rosbags = measure(lambda: deserialize_rows(path, PART), 1) * MESSAGES / PART
        print(f"{MESSAGES:,} messages in SQLite, {path.stat().st_size / 1e6:.1f} MB")
        print(f"select of all rows    {bound:7.3f} s: the bound")
        print(f"read_columns          {ours:7.3f} s, {ours / bound:.2f} times the bound (up to 3)")
        print(f"read_info             {info:7.3f} s, {info / bound:.2f} times the bound (up to 3)")
        ratio = f"{rosbags / ours:.0f} times as long (at least 5)"
        print(f"rosbags               {rosbags:7.2f} s, {ratio}; measured on {PART:,}, scaled")


if __name__ == "__main__":
    main()
