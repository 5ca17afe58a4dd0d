"""The files of a bag, what its metadata.yaml says of them, and what is in them.

A reader needs four entries of metadata.yaml and a writer always writes the same few lines, so both
go by lines here: a YAML library would be a dependency for that alone, and takes 50 times as long (4
s for 2,000 topics). What the reader does not understand (flow lists, anchors) it refuses by line;
neither rosbag2 nor rosbags writes it.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Final

from turtlelog.errors import LogError
from turtlelog.log.error_boundary import name_file
from turtlelog.log.info import RecordingInfo, list_absent, merge_topics, read_info, sort_topics

METADATA_FILE: Final = "metadata.yaml"

_ROOT: Final = "rosbag2_bagfile_information"

_TEXTS: Final = ("storage_identifier", "compression_mode")
_FILES: Final = "relative_file_paths"
_DURATION: Final = "duration"

_LINE: Final = re.compile(r"^(?P<indent> *)(?P<item>- +)?(?P<text>.*?)\s*$")
_ENTRY: Final = re.compile(r"^(?P<key>[\w.]+):(?: +(?P<value>.*))?$")
_QUOTED: Final = re.compile(
    r"""^(?:"(?P<double>[^"\\]*)"|'(?P<single>(?:[^']|'')*)')(?:\s+#.*)?$"""
)
_COMMENT: Final = re.compile(r"(?:^|\s)#.*$")


@dataclass(frozen=True, slots=True, kw_only=True)
class BagMetadata:
    """What a bag says of its files.

    Attributes:
        storage: Kind of the files: `mcap`, `sqlite3`.
        compression: How whole files or messages are compressed on top: `file`, `message`, or
            empty.
        files: Their names, in order of time.
        duration_ns: First to last message [ns], None where it is not said.
    """

    storage: str
    compression: str
    files: tuple[str, ...]
    duration_ns: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class BagTopic:
    """A topic of a bag: its name, the type of its messages, that type's hash, how many."""

    name: str
    type: str
    type_hash: str
    count: int


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
    topics = sort_topics(merge_topics(topic for info in infos for topic in info.topics))
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


def parse_bag_metadata(text: str) -> BagMetadata:
    """Return what the text of a metadata.yaml says of the files.

    Raises:
        LogError: Where it is none, with the line.
    """
    values: dict[str, str] = {}
    files: list[str] = []
    under = ""
    for number, key, value in _iterate_entries(text, _ROOT):
        if key in values:
            raise LogError(f"line {number}: {key}: expected once, found again")
        if key:
            under = key
            values[key] = _unquote(number, key, value) if key in (*_TEXTS, _DURATION) else value
        elif under == _FILES and value != "[]":
            files.append(_read_file_name(number, value))
        else:
            values |= _read_below(number, under, value)
    _require_entries(values, files)
    mode = values.get("compression_mode", "").lower()
    return BagMetadata(
        storage=values["storage_identifier"],
        compression="" if mode == "none" else mode,
        files=tuple(files),
        duration_ns=_parse_duration(values.get(_DURATION, "")),
    )


def format_bag_metadata(
    file: str, topics: Sequence[BagTopic], *, start_ns: int, duration_ns: int
) -> str:
    """Return the metadata.yaml of a bag of one MCAP file.

    Version 8 is the newest whose quality of service is text, which Humble and Jazzy both read;
    empty, as in the file's channels, it lets the player choose. Later keys are skipped by earlier
    readers.
    """
    count = sum(topic.count for topic in topics)
    span = [
        "starting_time:",
        f"  nanoseconds_since_epoch: {start_ns}",
        "duration:",
        f"  nanoseconds: {duration_ns}",
        f"message_count: {count}",
    ]
    lines = ["version: 8", "storage_identifier: mcap", *span, "topics_with_message_count:"]
    for topic in topics:
        lines += [
            "  - topic_metadata:",
            f"      name: {topic.name}",
            f"      type: {topic.type}",
            "      serialization_format: cdr",
            '      offered_qos_profiles: ""',
            f"      type_description_hash: {topic.type_hash}",
            f"    message_count: {topic.count}",
        ]
    lines += ['compression_format: ""', 'compression_mode: ""']
    lines += ["relative_file_paths:", f"  - {_quote(file)}"]
    lines += ["files:", f"  - path: {_quote(file)}", *(f"    {line}" for line in span)]
    lines += ["custom_data: ~", 'ros_distro: ""']
    return "\n".join([f"{_ROOT}:", *(f"  {line}" for line in lines), ""])


def _quote(value: str) -> str:
    """Return text as YAML that cannot be taken for anything else."""
    return "'" + value.replace("'", "''") + "'"


def _read_file_name(number: int, value: str) -> str:
    name = _unquote(number, _FILES, value)
    if not name or (value[:1] not in {'"', "'"} and re.search(r":(\s|$)", name)):
        raise LogError(
            f"line {number}: {_FILES}: expected the name of a file, found {value[:60]!r}"
        )
    return name


def _read_below(number: int, under: str, value: str) -> dict[str, str]:
    """Return what a line below an entry adds to it; of the entries that are not needed, nothing."""
    if under in _TEXTS:
        raise LogError(f"line {number}: {under}: expected text, found {value[:60]!r}")
    if under != _DURATION:
        return {}
    entry = _ENTRY.match(value)
    if entry is None or entry["key"] != "nanoseconds":
        raise LogError(f"line {number}: {_DURATION}: expected nanoseconds, found {value[:60]!r}")
    return {_DURATION: _unquote(number, _DURATION, entry["value"] or "")}


def _require_entries(values: Mapping[str, str], files: Sequence[str]) -> None:
    if not files:
        found = values.get(_FILES, "")[:60].replace("[]", "")
        raise LogError(f"{_FILES}: expected a list of files, found {found or 'none'}")
    if "storage_identifier" not in values:
        raise LogError("storage_identifier: expected mcap, found none")


def _parse_duration(text: str) -> int | None:
    if not text:
        return None
    if not re.fullmatch(r"[0-9]{1,19}", text) or int(text) >= 2**63:
        raise LogError(f"{_DURATION}: expected whole nanoseconds below 2^63, found {text[:60]}")
    return int(text)


def _iterate_entries(text: str, root: str) -> Iterator[tuple[int, str, str]]:
    """Yield line, key and value of the entries right below the root.

    What stands below an entry, list items or keys of its own, comes as text without a key.
    """
    depth: int | None = None
    for number, indent, item, content in _iterate_body(text, root):
        depth = indent if depth is None else depth
        if item or indent > depth:
            yield number, "", content
        else:
            entry = _ENTRY.match(content)
            if entry is None:
                raise LogError(f"line {number}: expected key: value, found {content[:60]!r}")
            yield number, entry["key"], entry["value"] or ""
    if depth is None:
        raise LogError(f"expected an entry {root}, found none")


def _iterate_body(text: str, root: str) -> Iterator[tuple[int, int, bool, str]]:
    """Yield the lines below the root: number, indent, whether a list item begins, content."""
    is_inside = False
    for number, line in enumerate(text.splitlines(), start=1):
        found = _LINE.match(line)
        if found is None or not found["text"] or found["text"].startswith(("#", "---")):
            continue
        if not found["indent"] and not found["item"]:
            is_inside = _COMMENT.sub("", found["text"]).rstrip() == f"{root}:"
        elif is_inside:
            yield number, len(found["indent"]), bool(found["item"]), found["text"]


def _unquote(number: int, key: str, value: str) -> str:
    """Return a value without its quotes and without a comment behind it."""
    if value[:1] in {'"', "'"}:
        found = _QUOTED.match(value)
        if found is None:
            raise LogError(f"line {number}: {key}: expected text in quotes, found {value[:60]!r}")
        is_double = found["double"] is not None
        return found["double"] if is_double else found["single"].replace("''", "'")
    value = _COMMENT.sub("", value).rstrip()
    if value == "[]":
        return ""
    if value[:1] in {"[", "{", "&", "*", "|", ">", "!"}:
        raise LogError(f"line {number}: {key}: expected plain text, found {value[:60]!r}")
    return "" if value in {"~", "null"} else value
