"""Export of runs for other programs: rosbag2 folders, CSV, Parquet, TUM trajectories."""

import csv
import json
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import LogError
from turtlelog.escapes import guard_cell
from turtlelog.files.urls import make_path
from turtlelog.libraries import load_library
from turtlelog.log.file_access import create_folder, name_write_error, replace_when_complete
from turtlelog.log.file_info import survey_file
from turtlelog.log.parquet_file import MOST_ROWS
from turtlelog.log.recording.run_writer import write_recording
from turtlelog.log.ros2.bag_files import METADATA_FILE, METADATA_ROOT
from turtlelog.run import TABLES, Run, tabulate_run
from turtlelog.run.tables import iterate_arrow

_LONGEST_NAME: Final = 255  # bytes; the limit of file systems

_ROWS: Final = 4096
"""Number of rows converted to Python values at once; these take five times as many bytes."""

_ROWS_GROUPED: Final = 2**16
"""Number of rows of a Parquet file encoded at once; each row takes 160 bytes during encoding."""

_Write = Callable[[Run, str, Path], None]


def export_rosbag2(run: Run, path: str | Path, *, shares_poses: bool = False) -> tuple[Path, ...]:
    """Write a run as a rosbag2 folder, which `ros2 bag` and programs based on it can open.

    The folder contains one recording, written by `write_recording` and named like the first file of
    a ROS 2 bag. `turtlelog` reads the folder back as the same run.

    Args:
        run: Run to write.
        path: Path of the folder.
        shares_poses: As in `write_recording`.

    Raises:
        LogError: If the folder exists or cannot be written, or a recording cannot store the run.
    """
    path = make_path(path)
    name = f"{path.resolve().name}_0.mcap"
    if len(name.encode(errors="replace")) > _LONGEST_NAME:
        raise LogError(f"{path}: expected a shorter name")
    if not name.isprintable():
        # The bag's metadata.yaml contains the name, in UTF-8 and on one line.
        raise LogError(f"{path}: expected a name of printable characters, found {name!a}")
    with create_folder(path) as folder:
        try:
            write_recording(run, folder / name, shares_poses=shares_poses)
        except LogError as err:
            # The name of the temporary folder is removed: users do not know it.
            raise LogError(f"{path}: {str(err).removeprefix(f'{folder / name}: ')}") from err
        text = describe_bag([folder / name])
        (folder / METADATA_FILE).write_text(text, encoding="utf-8", newline="\n")
    return path / name, path / METADATA_FILE


def describe_bag(files: Sequence[Path], compression: str = "") -> str:
    """Return the metadata.yaml text of a bag of complete MCAP files, in order of time."""
    topics: dict[tuple[str, str], BagTopic] = {}
    parts = []
    for file in files:
        with file.open("rb") as stream:
            survey = survey_file(stream)
        schemas = survey.catalogue.schemas
        for number, channel in sorted(survey.catalogue.channels.items()):
            schema = schemas.get(channel.schema_id)
            topic = BagTopic(
                name=channel.topic,
                type=schema.name if schema else "",
                type_hash=channel.metadata.get("topic_type_hash", ""),
                count=survey.counts.get(number, 0),
            )
            known = topics.setdefault((topic.name, topic.type), topic)
            if known is not topic:
                topics[topic.name, topic.type] = replace(known, count=known.count + topic.count)
        start_ns, end_ns = survey.span_ns or (0, 0)
        count = sum(survey.counts.values())
        parts.append(
            BagPart(name=file.name, start_ns=start_ns, duration_ns=end_ns - start_ns, count=count)
        )
    return format_bag_metadata(parts, [*topics.values()], compression=compression)


def export_csv(run: Run, path: str | Path, *, table: str | None = None) -> tuple[Path, ...]:
    """Write the tables of a run as CSV and return the files. Numbers can be read back exactly.

    Args:
        run: Run to write.
        path: A name that ends in .csv is one file, which replaces an existing file; any other name
            is a new folder with one file per table.
        table: Table to write (`poses`, `commands`, `samples`, `events`). Default: `poses` for a
            file, all tables for a folder.

    Raises:
        LogError: If the path cannot be written, a folder exists, or there is no such table.
    """
    return _export(run, make_path(path), ".csv", table, _write_csv)


def export_parquet(run: Run, path: str | Path, *, table: str | None = None) -> tuple[Path, ...]:
    """Write the tables of a run as Parquet, as `export_csv` does, and return the files.

    Columns keep their types. The metadata contain the units of the columns, and the name, goal,
    scenario and declaration of the run.

    Raises:
        LogError: If the path cannot be written, a folder exists, or there is no such table.
    """
    return _export(run, make_path(path), ".parquet", table, _write_parquet)


def export_tum(run: Run, path: str | Path) -> tuple[Path, ...]:
    """Write the poses of a run as a TUM trajectory, replacing the file, and return the file.

    Each pose is one line, for programs such as evo: time [s], x y z [m], and the quaternion x y z w
    of the heading. Position and time can be read back exactly, the heading to about 1e-15 rad.

    Raises:
        LogError: If the file cannot be written.
    """
    path = make_path(path)
    with (
        replace_when_complete(path) as temporary,
        temporary.open("w", encoding="ascii", newline="\n") as stream,
    ):
        stream.writelines(_format_tum(run))
    return (path,)


def _format_tum(run: Run) -> Iterator[str]:
    poses = run.poses
    half_rad = poses.heading_rad / 2.0
    columns = (poses.time_ns, *poses.xy_m.T, np.sin(half_rad), np.cos(half_rad))
    for time_ns, x, y, qz, qw in _list_rows(columns):
        sign, (seconds, rest) = "-" if time_ns < 0 else "", divmod(abs(time_ns), 1_000_000_000)
        yield f"{sign}{seconds}.{rest:09d} {x!r} {y!r} 0 0 0 {qz!r} {qw!r}\n"


def _list_rows(columns: Sequence[NDArray[Any]]) -> Iterator[tuple[Any, ...]]:
    """Yield the rows of equally long columns as Python values, with few rows in memory."""
    for first in range(0, len(columns[0]), _ROWS):
        parts = (column[first : first + _ROWS].tolist() for column in columns)
        yield from zip(*parts, strict=True)


def _export(
    run: Run, path: Path, suffix: str, table: str | None, write: _Write
) -> tuple[Path, ...]:
    if table is not None and table not in TABLES:
        raise LogError(f"table: expected one of {', '.join(TABLES)}, found {table}")
    names = tuple(TABLES) if table is None else (table,)
    try:
        if path.suffix.lower() == suffix:
            with replace_when_complete(path) as temporary:
                write(run, table or "poses", temporary)
            return (path,)
        with create_folder(path) as folder:
            for name in names:
                write(run, name, folder / f"{name}{suffix}")
    except UnicodeEncodeError as err:
        raise name_write_error(path, err) from err
    return tuple(path / f"{name}{suffix}" for name in names)


def _write_csv(run: Run, table: str, path: Path) -> None:
    columns = tabulate_run(run, table)
    with path.open("w", encoding="utf-8", newline="") as stream:
        # One line end on every platform: equal runs give identical files.
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(map(guard_cell, row) for row in _list_rows([*columns.values()]))


def _write_parquet(run: Run, table: str, path: Path) -> None:
    parquet = load_library("pyarrow.parquet")
    parts = iterate_arrow(run, table, _ROWS_GROUPED)
    first = next(parts)
    # Readers accept a larger table only if the file has enough bytes, so it is not compressed.
    is_packed = len(tabulate_run(run, table)["time_ns"]) <= MOST_ROWS
    compression = "zstd" if is_packed else "none"
    with (
        path.open("wb") as stream,
        parquet.ParquetWriter(
            stream, first.schema, compression=compression, use_dictionary=is_packed
        ) as writer,
    ):
        for part in chain([first], parts):
            writer.write_table(part)


_PLAIN: Final = re.compile(r"[\w/.][\w/.-]*", re.ASCII)
"""Text in names of topics and types that YAML can only read as text."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BagTopic:
    """A topic of a bag: name, message type, hash of the type, number of messages."""

    name: str
    type: str
    type_hash: str
    count: int


@dataclass(frozen=True, slots=True, kw_only=True)
class BagPart:
    """A file of a bag: name, time of the first message [ns], duration [ns], number of messages."""

    name: str
    start_ns: int
    duration_ns: int
    count: int


def format_bag_metadata(
    files: Sequence[BagPart], topics: Sequence[BagTopic], *, compression: str = ""
) -> str:
    """Return the metadata.yaml of a bag of MCAP files.

    Version 8 is the newest with quality of service as text, which Humble and Jazzy both read. An
    empty text, as in the file's channels, lets the player choose. Readers of earlier format
    versions skip the keys that later versions added.

    Args:
        files: Files in order of time.
        topics: Topics of all files.
        compression: `message` if rosbag2 compressed messages one by one.
    """
    start_ns = min(part.start_ns for part in files)
    end_ns = max(part.start_ns + part.duration_ns for part in files)
    count = sum(topic.count for topic in topics)
    lines = ["version: 8", "storage_identifier: mcap"]
    lines += [*_format_span(start_ns, end_ns - start_ns, count), "topics_with_message_count:"]
    for topic in topics:
        type_hash = topic.type_hash or '""'
        lines += [
            "  - topic_metadata:",
            f"      name: {_format_text(topic.name)}",
            f"      type: {_format_text(topic.type)}",
            "      serialization_format: cdr",
            '      offered_qos_profiles: ""',
            f"      type_description_hash: {type_hash}",
            f"    message_count: {topic.count}",
        ]
    codec, mode = ("zstd", compression.upper()) if compression else ('""', '""')
    lines += [f"compression_format: {codec}", f"compression_mode: {mode}"]
    lines += ["relative_file_paths:", *(f"  - {_quote(part.name)}" for part in files), "files:"]
    for part in files:
        span = _format_span(part.start_ns, part.duration_ns, part.count)
        lines += [f"  - path: {_quote(part.name)}", *(f"    {line}" for line in span)]
    lines += ["custom_data: ~", 'ros_distro: ""']
    return "\n".join([f"{METADATA_ROOT}:", *(f"  {line}" for line in lines), ""])


def _format_span(start_ns: int, duration_ns: int, count: int) -> list[str]:
    return [
        "starting_time:",
        f"  nanoseconds_since_epoch: {start_ns}",
        "duration:",
        f"  nanoseconds: {duration_ns}",
        f"message_count: {count}",
    ]


def _format_text(value: str) -> str:
    return value if _PLAIN.fullmatch(value) else json.dumps(value, ensure_ascii=False)


def _quote(value: str) -> str:
    """Return text in quotes, so that YAML reads it as text."""
    return "'" + value.replace("'", "''") + "'"
