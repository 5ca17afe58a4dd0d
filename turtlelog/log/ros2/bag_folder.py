"""The files of a bag, what its metadata.yaml says of them, and what is in them."""

from collections import Counter
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Final

from turtlelog.errors import LogError
from turtlelog.log.error_boundary import name_file
from turtlelog.log.info import RecordingInfo, TopicInfo, list_absent, read_info
from turtlelog.log.ros2.bag_metadata import BagMetadata, parse_bag_metadata

METADATA_FILE: Final = "metadata.yaml"


def list_bag_files(path: str | Path) -> tuple[Path, ...]:
    """Return the MCAP files of a bag in its own order: those that a folder names, or a lone file.

    Raises:
        LogError: Where a folder is no bag, lacks a file, or holds another kind of them.
    """
    path = Path(path)
    if not path.is_dir():
        return (path,)
    metadata = read_bag_metadata(path)
    with name_file(path / METADATA_FILE, expected="the description of a bag"):
        _require_plain_mcap(metadata)
        files = tuple(_find_file(path, name) for name in metadata.files)
        for number, file in enumerate(files):
            if file in files[:number]:
                raise LogError(
                    f"relative_file_paths: expected each file once, found {file.name} twice"
                )
    return files


def read_bag_metadata(path: str | Path) -> BagMetadata:
    """Return what a bag folder says of itself.

    Raises:
        LogError: Where it is no bag.
    """
    place = Path(path) / METADATA_FILE
    if not place.is_file():
        raise LogError(f"{path}: expected a bag, found a folder without {METADATA_FILE}")
    with name_file(place, expected="the description of a bag"):
        return parse_bag_metadata(_decode(place.read_bytes()))


def _decode(content: bytes) -> str:
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as err:
        found = f"byte {content[err.start]:#04x} at {err.start}"
        raise LogError(f"expected text in UTF-8, found {found}") from err


def _find_file(folder: Path, name: str) -> Path:
    """Return a file of a bag; early versions put the folder's name in front.

    Raises:
        LogError: Where there is none, or it lies elsewhere: what is read is what was named.
    """
    place = PurePosixPath(name.replace("\\", "/"))
    within = place.relative_to(folder.resolve().as_posix()) if _is_within(place, folder) else place
    if within.is_absolute() or PureWindowsPath(name).drive or ".." in within.parts:
        raise LogError(f"relative_file_paths: expected a file in the bag's folder, found {name}")
    for file in (folder / within, folder / within.name):
        if within.name and file.is_file():
            return file
    raise LogError(f"relative_file_paths: expected the file {name}, found none")


def _is_within(place: PurePosixPath, folder: Path) -> bool:
    return place.is_relative_to(folder.resolve().as_posix())


def _require_plain_mcap(metadata: BagMetadata) -> None:
    if metadata.storage != "mcap":
        found = metadata.storage or "none"
        raise LogError(
            f"storage_identifier: expected mcap, found {found}: ros2 bag convert makes MCAP of it"
        )
    if metadata.compression:
        raise LogError(
            f"compression_mode: expected none, found {metadata.compression}, which turtlelog does"
            " not understand: ros2 bag convert makes a plain bag of it"
        )


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
