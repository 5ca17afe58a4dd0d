"""A bag that is open for reading: what its files hold, and the messages of its topics."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

from turtlelog.errors import LogError
from turtlelog.files.urls import make_path
from turtlelog.log.engine.topic_columns import TopicColumns, read_some_columns
from turtlelog.log.file_info import RecordingInfo, TopicInfo, merge_topics, read_info
from turtlelog.log.ros2.bag_folder import find_bag_files


@dataclass(frozen=True, slots=True, kw_only=True)
class Bag:
    """The files of a bag and what is in each, whatever their storage.

    Attributes:
        path: The folder, or the lone file.
        infos: What each file holds, in order of time.
    """

    path: Path
    infos: Mapping[Path, RecordingInfo]

    @property
    def topics(self) -> Sequence[TopicInfo]:
        """The topics of all files, each name and type once."""
        first, *others = (info.topics for info in self.infos.values())
        return merge_topics(chain(first, *others)) if others else first

    def read(
        self, names: Collection[str], *, is_flat: bool = True
    ) -> tuple[Mapping[str, TopicColumns], ...]:
        """Return the messages of some topics, by topic, for each file; those without any left out.

        Args:
            names: Of the topics.
            is_flat: Whether their types have no sequences of texts or messages.
        """
        held = (
            (file, {*names} & {topic.topic for topic in info.topics if topic.count})
            for file, info in self.infos.items()
        )
        return tuple(read_some_columns(file, some, is_flat=is_flat) for file, some in held)


def open_bag(path: str | Path) -> Bag:
    """Return a bag of ROS 2: a folder, or a lone file.

    Raises:
        LogError: Where it is no bag, or one of its files cannot be read, is cut or is damaged.
    """
    path = make_path(path)
    found = find_bag_files(path)
    infos = {file: read_info(file) for file in found.files}
    if found.notes:
        first = found.files[0]
        infos[first] = replace(infos[first], notes={**infos[first].notes, **found.notes})
    for file, info in infos.items():
        if not info.complete:
            raise LogError(
                f"{file}: no end of an MCAP file: truncated or unfinished: {info.notes['partial']}"
            )
    return Bag(path=path, infos=infos)
