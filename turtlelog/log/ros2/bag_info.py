"""What is in a bag, without reading its messages."""

from collections import Counter
from pathlib import Path

from turtlelog.log.info import RecordingInfo, TopicInfo, list_absent, read_info
from turtlelog.log.ros2.bag_folder import list_bag_files, read_bag_metadata


def read_bag_info(path: str | Path) -> RecordingInfo:
    """Return what is in a bag folder: its files' topics together.

    A folder around one of turtlelog's own recordings is described as that recording.

    Raises:
        LogError: Where it is no bag, or one of its files cannot be read.
    """
    path = Path(path)
    files = list_bag_files(path)
    infos = [read_info(file) for file in files]
    if len(infos) == 1 and infos[0].format_version is not None:
        return infos[0]
    counts: Counter[tuple[str, str]] = Counter()
    for info in infos:
        counts.update({(topic.topic, topic.type): topic.count for topic in info.topics})
    topics = tuple(
        TopicInfo(topic=topic, type=kind, count=count)
        for (topic, kind), count in sorted(counts.items())
    )
    duration_ns = read_bag_metadata(path).duration_ns
    name = path.resolve().name
    return RecordingInfo(
        file=str(path),
        format_version=None,
        source=f"rosbag2: {name}",
        name=name,
        complete=all(info.complete for info in infos),
        duration_s=None if duration_ns is None else duration_ns / 1e9,
        topics=topics,
        absent=list_absent(topics),
        not_understood=tuple(dict.fromkeys(text for info in infos for text in info.not_understood)),
        notes={name: text for info in infos for name, text in info.notes.items()},
    )
