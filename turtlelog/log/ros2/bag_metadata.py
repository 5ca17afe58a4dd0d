"""metadata.yaml, the file that makes a folder a bag.

A reader needs four of its entries and a writer always writes the same few lines, so both go by
lines here: a YAML library would be a dependency for that alone. What the reader does not
understand (flow lists, anchors) it refuses by line; neither rosbag2 nor rosbags writes it.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from turtlelog.errors import LogError

ROOT: Final = "rosbag2_bagfile_information"

_LINE: Final = re.compile(r"^(?P<indent> *)(?P<item>- +)?(?P<text>.*?)\s*$")
_ENTRY: Final = re.compile(r"^(?P<key>[\w.]+):(?: +(?P<value>.*))?$")


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


def parse_bag_metadata(text: str) -> BagMetadata:
    """Return what the text of a metadata.yaml says of the files.

    Raises:
        LogError: Where it is none, with the line.
    """
    values: dict[str, str] = {}
    files: list[str] = []
    under = ""
    for number, key, value in _iterate_entries(text):
        if key:
            under = key
            values[key] = value
        elif under == "relative_file_paths":
            files.append(_unquote(number, value))
        elif under == "duration":
            values[under] = value.removeprefix("nanoseconds: ")
    if not files:
        raise LogError("relative_file_paths: expected a list of files, found none")
    if "storage_identifier" not in values:
        raise LogError("storage_identifier: expected mcap, found none")
    mode = values.get("compression_mode", "").lower()
    return BagMetadata(
        storage=values["storage_identifier"],
        compression="" if mode == "none" else mode,
        files=tuple(files),
        duration_ns=int(duration) if (duration := values.get("duration", "")).isdecimal() else None,
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
    return "\n".join([f"{ROOT}:", *(f"  {line}" for line in lines), ""])


def _iterate_entries(text: str) -> Iterator[tuple[int, str, str]]:
    """Yield line, key and value of the entries right below the root.

    What stands below an entry, list items or keys of its own, comes as text without a key.
    """
    depth: int | None = None
    for number, indent, item, content in _iterate_body(text):
        depth = indent if depth is None else depth
        if item or indent > depth:
            yield number, "", content
        else:
            entry = _ENTRY.match(content)
            if entry is None:
                raise LogError(f"line {number}: expected key: value, found {content[:60]!r}")
            yield number, entry["key"], _unquote(number, entry["value"] or "")
    if depth is None:
        raise LogError(f"expected an entry {ROOT}, found none")


def _iterate_body(text: str) -> Iterator[tuple[int, int, bool, str]]:
    """Yield the lines below the root: number, indent, whether a list item begins, content."""
    is_inside = False
    for number, line in enumerate(text.splitlines(), start=1):
        found = _LINE.match(line)
        if found is None or not found["text"] or found["text"].startswith(("#", "---")):
            continue
        if not found["indent"] and not found["item"]:
            is_inside = found["text"] == f"{ROOT}:"
        elif is_inside:
            yield number, len(found["indent"]), bool(found["item"]), found["text"]


def _quote(value: str) -> str:
    """Return text as YAML that cannot be taken for anything else."""
    return "'" + value.replace("'", "''") + "'"


def _unquote(number: int, value: str) -> str:
    mark = value[:1]
    if mark in {'"', "'"}:
        inner = value[1:-1].replace(2 * mark, "") if mark == "'" else value[1:-1]
        if len(value) < 2 or value[-1] != mark or mark in inner or (mark == '"' and "\\" in inner):
            raise LogError(f"line {number}: expected text in quotes, found {value[:60]!r}")
        return value[1:-1].replace("''", "'") if mark == "'" else inner
    if mark in {"[", "{", "&", "*", "|", ">", "!"}:
        raise LogError(f"line {number}: expected plain text, found {value[:60]!r}")
    return "" if value in {"~", "null"} else value
