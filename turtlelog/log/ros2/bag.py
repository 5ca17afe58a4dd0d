"""Bags: their files, the contents of the files, and the messages of topics."""

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, pairwise
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Final

from turtlelog.display import split_numbers
from turtlelog.errors import LogError
from turtlelog.files.urls import make_path
from turtlelog.log.engine.opening import BAG_SUFFIXES
from turtlelog.log.engine.topic_columns import TopicColumns, read_some_columns
from turtlelog.log.file_access import name_file
from turtlelog.log.file_info import RecordingInfo, TopicInfo, list_absent, merge_topics, read_info
from turtlelog.log.ros2.bag_metadata import METADATA_FILE, BagMetadata, read_bag_metadata


@dataclass(frozen=True, slots=True, kw_only=True)
class Bag:
    """The files of a bag and their contents, for any storage.

    Attributes:
        path: The folder, or the single file.
        infos: Contents of each file, in order of time.
    """

    path: Path
    infos: Mapping[Path, RecordingInfo]

    @property
    def topics(self) -> Sequence[TopicInfo]:
        """The topics of all files, without duplicates."""
        first, *others = (info.topics for info in self.infos.values())
        return merge_topics(chain(first, *others)) if others else first

    def read(
        self, names: Collection[str], *, is_flat: bool = True
    ) -> tuple[Mapping[str, TopicColumns], ...]:
        """Return the messages of some topics, by topic, for each file; empty topics are omitted.

        Args:
            names: Names of the topics.
            is_flat: Whether to refuse types with sequences of texts or messages.
        """
        held = (
            (file, {*names} & {topic.topic for topic in info.topics if topic.count})
            for file, info in self.infos.items()
        )
        return tuple(read_some_columns(file, some, is_flat=is_flat) for file, some in held)

    def read_topic(self, name: str, *, is_flat: bool = True) -> list[TopicColumns]:
        """Return the messages of a topic, for each file that has some."""
        files = self.read({name}, is_flat=is_flat)
        return [file[name] for file in files if name in file and len(file[name])]


def open_bag(path: str | Path) -> Bag:
    """Return a ROS 2 bag: a folder, or a single file.

    Raises:
        LogError: If the path is not a bag, or one of its files cannot be read, is truncated or is
            damaged.
    """
    path = make_path(path)
    found = _find_bag_files(path)
    infos = {file: read_info(file) for file in found.files}
    if found.notes:
        first = found.files[0]
        infos[first] = replace(infos[first], notes={**infos[first].notes, **found.notes})
    for file, info in infos.items():
        if not info.complete:
            is_left = any(topic.count for topic in info.topics)
            fix = "; turtlelog convert --recover reads what is left" if is_left else ""
            lost = info.notes["partial"]
            raise LogError(f"{file}: truncated or unfinished (no end of an MCAP file): {lost}{fix}")
    return Bag(path=path, infos=infos)


_PART: Final = re.compile(r"_[0-9]+(?:\.[A-Za-z0-9]+)+$")
"""Pattern for the ends of the names of a bag's parts."""

_MOST_NAMED: Final = 6
"""Largest number of files that an error names: one line of a terminal."""

_MOST_OVERLAP: Final = 0.5
"""Largest overlap of two parts, as a share of the shorter part. Queued messages overlap by seconds,
two recordings completely."""

_MOST_APART_NS: Final = 10_000_000_000
"""Longest time from the end of a part to the next part [ns]. rosbag2 begins a part with the next
message, and a running robot publishes transforms, diagnostics or odometry at least every few
seconds."""

_MOST_APART_STEPS: Final = 100.0
"""The same limit as a multiple of the mean time between messages, because slow topics alone may be
silent for longer."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _BagFiles:
    """The files of a bag.

    Attributes:
        files: Files, in order of time if the metadata contain it.
        duration_ns: Time from first to last message in the metadata [ns]; None if missing.
        notes: Note `bag_files` if the metadata are missing or invalid, or name another file.
    """

    files: tuple[Path, ...]
    duration_ns: int | None = None
    notes: Mapping[str, str] = field(default_factory=dict)


def list_bag_files(path: str | Path) -> tuple[Path, ...]:
    """Return the files of a bag in the bag's order: the files in a folder, or a single file.

    Raises:
        LogError: If a folder contains no files of a bag, lacks a file named in its metadata, or
            mixes kinds of files.
    """
    return _find_bag_files(path).files


def _find_bag_files(path: str | Path) -> _BagFiles:
    """Return the files of a bag as named in metadata.yaml; without it, the files in the folder."""
    path = make_path(path)
    if not path.is_dir():
        return _BagFiles(files=(path,))
    present = _list_present(path)
    place = path / METADATA_FILE
    is_described = True
    try:
        metadata = read_bag_metadata(path)
    except LogError as err:
        is_described, found = False, _take_present(path, present, str(err))
    else:
        with name_file(place, expected="the description of a bag"):
            found = _find_named(path, metadata, present)
    with name_file(path, expected="a bag"):
        _require_one_kind(found.files)
        _require_distinct(found.files)
    if not is_described:
        _require_one_bag(path, found.files)
    return found


def list_present_files(folder: Path) -> tuple[Path, ...]:
    """Return the files of a bag to recover, in the bag's order if known."""
    try:
        return _find_bag_files(folder).files
    except LogError as err:
        return _take_present(folder, _list_present(folder), str(err)).files


def _list_present(folder: Path) -> tuple[Path, ...]:
    with name_file(folder, expected="a bag"):
        named = (file for file in folder.iterdir() if file.name.lower().endswith(BAG_SUFFIXES))
        files = (file for file in named if file.is_file())
        return tuple(sorted(files, key=lambda file: split_numbers(file.name)))


def read_compression(folder: Path) -> str:
    """Return `message` if a bag's metadata show that messages are compressed one by one."""
    try:
        found = read_bag_metadata(folder).compression
    except LogError:
        return ""
    return found if found == "message" else ""


def _take_present(folder: Path, present: tuple[Path, ...], reason: str) -> _BagFiles:
    """Return the files in the folder, at least one, if no readable metadata name files."""
    is_described = (folder / METADATA_FILE).exists()
    if not present and is_described:
        raise LogError(reason)
    if not present:
        if ros1 := min(folder.glob("*.bag"), default=None):
            raise LogError(f"{folder}: a folder with the ROS 1 bag {ros1.name}: name that file")
        raise LogError(
            f"{folder}: no recordings in this folder (no {METADATA_FILE}, .mcap or .db3 files)"
        )
    names = ", ".join(file.name for file in present)
    reason = reason if is_described else f"{METADATA_FILE} is missing"
    return _BagFiles(files=present, notes={"bag_files": f"{reason}; in order of name: {names}"})


def _find_named(folder: Path, metadata: BagMetadata, present: tuple[Path, ...]) -> _BagFiles:
    """Return the files named in the metadata, each once. A single renamed file is accepted."""
    files: dict[Path, None] = {}  # ordered, with fast look-up
    missing: list[str] = []
    base = folder.resolve().as_posix()
    for name in metadata.files:
        file = _find_file(folder, name, base)
        if file is None:
            missing.append(name)
        elif file in files:
            raise LogError(f"relative_file_paths: expected each file once, found {file.name} twice")
        else:
            files[file] = None
    duration_ns = metadata.duration_ns
    if not missing:
        return _BagFiles(files=tuple(files), duration_ns=duration_ns)
    others = [file for file in present if file not in files]
    names = ", ".join(file.name for file in others) or "none"
    if len(missing) != len(others) or (files and len(others) > 1):
        raise LogError(f"relative_file_paths: expected the file {missing[0]}, found {names[:200]}")
    found = [*files] or others
    if files:
        found.insert(metadata.files.index(missing[0]), others[0])
    lost = ", ".join(missing)
    note = f"{METADATA_FILE} names {lost}, not in the folder; read instead: {names}"
    return _BagFiles(files=tuple(found), duration_ns=duration_ns, notes={"bag_files": note})


def _find_file(folder: Path, name: str, base: str) -> Path | None:
    """Return a file of a bag; `base` is the bag's folder from the root.

    Early versions wrote the folder's name before the file's. Files outside the bag are not read: a
    recording must not choose which files are opened.
    """
    place = PurePosixPath(name.replace("\\", "/"))
    within = place.relative_to(base) if place.is_relative_to(base) else place
    if within.is_absolute() or PureWindowsPath(name).drive or ".." in within.parts:
        return None
    places = (folder / within, folder / within.name) if within.name else ()
    return next((file for file in places if file.is_file()), None)


def _require_one_bag(folder: Path, files: tuple[Path, ...]) -> None:
    """Refuse several files that are not numbered as parts of one bag by rosbag2 (drive_0.db3)."""
    if len(files) < 2:
        return
    stems = {_PART.sub("", file.name) for file in files}
    are_numbered = len(stems) == 1 and all(_PART.search(file.name) for file in files)
    reason = _find_break(files) if are_numbered else ""
    if reason is not None:
        names = ", ".join(file.name for file in files[:_MOST_NAMED])
        more = f" and {len(files) - _MOST_NAMED} more" if len(files) > _MOST_NAMED else ""
        apart = f"; {reason}" if reason else ""
        raise LogError(
            f"{folder}: a folder of {len(files)} recordings, not one bag (it has no readable"
            f" {METADATA_FILE}{apart}): name one of them: {names}{more}"
        )


def _find_break(files: tuple[Path, ...]) -> str | None:
    """Return why numbered files are not parts of one bag; None if each part continues another part.

    Every recording by turtlelog begins at 0, and no recording has parts.
    """
    found: list[tuple[tuple[int, int], int, str]] = []
    is_whole = True
    for file in files:
        try:
            info = read_info(file)
        except LogError:  # the reader of the file reports the error
            is_whole = False
            continue
        if info.format_version is not None:
            return ""
        if info.span_ns is not None:
            found.append((info.span_ns, sum(topic.count for topic in info.topics), file.name))
    for (one_ns, one_count, first), (other_ns, other_count, second) in pairwise(sorted(found)):
        lengths_ns = [one_ns[1] - one_ns[0], other_ns[1] - other_ns[0]]
        gap_ns = other_ns[0] - one_ns[1]
        if -gap_ns > _MOST_OVERLAP * min(lengths_ns):
            return f"{second} overlaps {first}"
        usual_ns = sum(lengths_ns) / (one_count + other_count)
        # An unreadable part may lie in between.
        if is_whole and gap_ns > max(_MOST_APART_NS, _MOST_APART_STEPS * usual_ns):
            return f"{second} begins {_format_gap(gap_ns / 1e9)} after {first} ends"
    return None


def _format_gap(gap_s: float) -> str:
    for unit, length_s in (("days", 86_400.0), ("hours", 3600.0), ("minutes", 60.0)):
        if gap_s >= 2.0 * length_s:
            return f"{gap_s / length_s:.0f} {unit}"
    return f"{gap_s:.0f} s"


def _require_one_kind(files: tuple[Path, ...]) -> None:
    """Refuse a mixture of SQLite and MCAP files, which no recorder writes into one bag."""
    kinds = {".db3" in file.suffixes for file in files}
    if len(kinds) > 1:
        names = ", ".join(file.name for file in files)
        raise LogError(f"expected files of one storage, found MCAP beside SQLite: {names[:200]}")


def _require_distinct(files: tuple[Path, ...]) -> None:
    """Refuse a file with two names in the folder, because its messages would be duplicated."""
    places: dict[tuple[int, int], Path] = {}
    for file in files if len(files) > 1 else ():
        found = file.stat()
        first = places.setdefault((found.st_dev, found.st_ino), file)
        if first is not file and found.st_ino:
            raise LogError(f"expected each file once, found {first.name} and {file.name} are one")


def read_bag_info(path: str | Path) -> RecordingInfo:
    """Return the contents of a bag folder, with the topics of all files merged.

    A folder with one turtlelog recording is described as that recording.

    Raises:
        LogError: If the folder is not a bag, or one of its files cannot be read.
    """
    path = make_path(path)
    found = _find_bag_files(path)
    infos = [read_info(file) for file in found.files]
    if len(infos) == 1 and infos[0].format_version is not None:
        return replace(infos[0], notes={**infos[0].notes, **found.notes})
    merged = merge_topics(topic for info in infos for topic in info.topics)
    topics = tuple(sorted(merged, key=lambda topic: (topic.topic, topic.type)))
    duration_ns = found.duration_ns
    if duration_ns is None and (spans := [info.span_ns for info in infos if info.span_ns]):
        duration_ns = max(end for _, end in spans) - min(start for start, _ in spans)
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
        notes={
            **{name: text for info in infos for name, text in info.notes.items()},
            **found.notes,
        },
    )
