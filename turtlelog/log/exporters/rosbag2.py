"""Run -> a rosbag2 bag: a recording, and the file beside it that makes its folder a bag."""

from pathlib import Path
from typing import Final

from mcap.reader import make_reader
from mcap.summary import Summary

from turtlelog.errors import LogError
from turtlelog.log.exporters.folder import create_folder
from turtlelog.log.recording.writer import write_recording
from turtlelog.log.ros2 import METADATA_FILE, BagTopic, format_bag_metadata
from turtlelog.run import Run

_LONGEST_NAME: Final = 255  # bytes; what file systems take


def export_rosbag2(run: Run, path: str | Path) -> tuple[Path, ...]:
    """Write a run as a rosbag2 folder, which `ros2 bag` and all that builds on it open.

    Its one file is a recording as `write_recording` writes it, named as ROS 2 names the first file
    of a bag: `turtlelog` reads the folder back as the same run.

    Raises:
        LogError: Where the folder exists or cannot be written, or the run holds what a recording
            cannot.
    """
    path = Path(path)
    name = f"{path.resolve().name}_0.mcap"
    if len(name.encode(errors="replace")) > _LONGEST_NAME:
        raise LogError(f"{path}: expected a shorter name")
    if not name.isprintable():
        # Its metadata.yaml holds the name, in UTF-8 and on one line.
        raise LogError(f"{path}: expected a name of printable characters, found {name!a}")
    with create_folder(path) as folder:
        try:
            write_recording(run, folder / name)
        except LogError as err:
            # The temporary folder's name would mean nothing to anybody.
            raise LogError(f"{path}: {str(err).removeprefix(f'{folder / name}: ')}") from err
        text = _describe(folder / name)
        (folder / METADATA_FILE).write_text(text, encoding="utf-8", newline="\n")
    return path / name, path / METADATA_FILE


def _describe(recording: Path) -> str:
    with recording.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    if summary is None or summary.statistics is None:
        raise LogError(f"{recording}: expected a summary with statistics, found none")
    statistics = summary.statistics
    return format_bag_metadata(
        recording.name,
        _list_topics(summary),
        start_ns=statistics.message_start_time,
        duration_ns=statistics.message_end_time - statistics.message_start_time,
    )


def _list_topics(summary: Summary) -> list[BagTopic]:
    counts = summary.statistics.channel_message_counts if summary.statistics else {}
    return [
        BagTopic(
            name=channel.topic,
            type=summary.schemas[channel.schema_id].name,
            type_hash=channel.metadata["topic_type_hash"],
            count=counts.get(number, 0),
        )
        for number, channel in sorted(summary.channels.items())
    ]
