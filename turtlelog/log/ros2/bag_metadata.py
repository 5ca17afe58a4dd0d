"""metadata.yaml, the file that makes a folder a bag.

A reader needs four of its entries and a writer always writes the same few lines, so both go by
lines here: a YAML library would be a dependency for that alone, and takes 50 times as long (4 s for
2,000 topics). What the reader does not understand (flow lists, anchors) it refuses by line; neither
rosbag2 nor rosbags writes it.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from turtlelog.errors import LogError

ROOT: Final = "rosbag2_bagfile_information"

_TEXTS: Final = ("storage_identifier", "compression_mode")
_FILES: Final = "relative_file_paths"
_DURATION: Final = "duration"

_LINE: Final = re.compile(r"^(?P<indent> *)(?P<item>- +)?(?P<text>.*?)\s*$")
ENTRY: Final = re.compile(r"^(?P<key>[\w.]+):(?: +(?P<value>.*))?$")
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


def parse_bag_metadata(text: str) -> BagMetadata:
    """Return what the text of a metadata.yaml says of the files.

    Raises:
        LogError: Where it is none, with the line.
    """
    values: dict[str, str] = {}
    files: list[str] = []
    under = ""
    for number, key, value in iterate_entries(text, ROOT):
        if key in values:
            raise LogError(f"line {number}: {key}: expected once, found again")
        if key:
            under = key
            values[key] = unquote(number, key, value) if key in (*_TEXTS, _DURATION) else value
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
    return "\n".join([f"{ROOT}:", *(f"  {line}" for line in lines), ""])


def _quote(value: str) -> str:
    """Return text as YAML that cannot be taken for anything else."""
    return "'" + value.replace("'", "''") + "'"


def _read_file_name(number: int, value: str) -> str:
    name = unquote(number, _FILES, value)
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
    entry = ENTRY.match(value)
    if entry is None or entry["key"] != "nanoseconds":
        raise LogError(f"line {number}: {_DURATION}: expected nanoseconds, found {value[:60]!r}")
    return {_DURATION: unquote(number, _DURATION, entry["value"] or "")}


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


def iterate_entries(text: str, root: str) -> Iterator[tuple[int, str, str]]:
    """Yield line, key and value of the entries right below the root.

    What stands below an entry, list items or keys of its own, comes as text without a key.
    """
    depth: int | None = None
    for number, indent, item, content in _iterate_body(text, root):
        depth = indent if depth is None else depth
        if item or indent > depth:
            yield number, "", content
        else:
            entry = ENTRY.match(content)
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


def unquote(number: int, key: str, value: str) -> str:
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
