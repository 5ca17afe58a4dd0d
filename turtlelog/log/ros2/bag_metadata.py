"""Reading and writing of the metadata.yaml of bags.

The reader needs four entries and the writer always writes the same few lines, so both process
single lines. A YAML library would be a further dependency, and takes 50 times as long (4 s for
2,000 topics). The reader refuses anchors, and lists in brackets over several lines, with the line
number; neither rosbag2 nor rosbags writes them.
"""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from turtlelog.errors import LogError
from turtlelog.files.text_files import iterate_lines
from turtlelog.log.file_access import name_file, open_file

METADATA_FILE: Final = "metadata.yaml"

_LARGEST: Final = 2**24
"""Largest size of metadata.yaml [bytes]; a file with 2,000 topics has 2 MB."""

_MOST_ENTRIES: Final = 1000
_MOST_FILES: Final = 100_000
"""Largest numbers of entries directly below the root, of which rosbag2 writes 12, and of files: a
day in parts of one second. A text of this size could contain ten million entries."""

_MOST_LINES: Final = 10 * _MOST_FILES
"""Largest number of lines: a file takes eight, and the text is read up to four times."""

_ROOT: Final = "rosbag2_bagfile_information"

_TEXTS: Final = ("storage_identifier", "compression_mode")
_FILES: Final = "relative_file_paths"
_DURATION: Final = "duration"

_ITEM: Final = re.compile(r"- ++")
_ENTRY: Final = re.compile(r"^(?P<key>[\w.]+):(?: +(?P<value>.*))?$")
_QUOTED: Final = re.compile(
    r"""^(?:"(?P<double>[^"\\]*)"|'(?P<single>[^']*+(?:''[^']*+)*+)')(?:\s+#.*)?$"""
)
_FLOW_ITEM: Final = re.compile(
    r"""\s*(?:(?P<quoted>"[^"\\]*"|'[^']*+(?:''[^']*+)*+')\s*|(?P<plain>[^\s,'"\[\]{}][^,'"\[\]{}]*))(?:,|$)"""
)
_FLOW_LIST: Final = re.compile(r"^\[(?P<items>[^\[\]]*)\](?:\s+#.*)?$")
_FLOW_DURATION: Final = re.compile(r"^\{\s*nanoseconds:\s+(?P<value>[^\s{},]+)\s*\}")
_COMMENT: Final = re.compile(r"(?:^|\s)#.*$")

_PLAIN: Final = re.compile(r"[\w/.][\w/.-]*", re.ASCII)
"""Text in names of topics and types that YAML can only read as text."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BagMetadata:
    """Contents of a bag's metadata.yaml.

    Attributes:
        storage: Storage of the files: `mcap` or `sqlite3`.
        compression: Compression in addition to the storage's: `file`, `message`, or empty.
        files: Names of the files, in order of time.
        duration_ns: Time from first to last message [ns]; None if missing.
    """

    storage: str
    compression: str
    files: tuple[str, ...]
    duration_ns: int | None = None


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


def read_bag_metadata(folder: Path) -> BagMetadata:
    """Return the metadata of a bag folder."""
    place = folder / METADATA_FILE
    with name_file(place, expected="the description of a bag"), open_file(place) as stream:
        size = stream.seek(0, 2)
        if size > _LARGEST:
            raise LogError(f"expected up to {_LARGEST} bytes, found {size}")
        stream.seek(0)
        try:
            text = stream.read().decode("utf-8-sig")
        except UnicodeDecodeError as err:
            found = f"byte {err.object[err.start]:#04x} at {err.start}"
            raise LogError(f"expected text in UTF-8, found {found}") from err
        return parse_bag_metadata(text)


def parse_bag_metadata(text: str) -> BagMetadata:
    """Return the entries about files in the text of a metadata.yaml."""
    if text.count("\n") > _MOST_LINES:
        raise LogError(f"expected up to {_MOST_LINES:,} lines, found more")
    values: dict[str, str] = {}
    files: list[str] = []
    under = ""
    for number, key, value in _iterate_entries(text, _ROOT):
        if len(values) > _MOST_ENTRIES or len(files) > _MOST_FILES:
            raise LogError(
                f"line {number}: expected up to {_MOST_ENTRIES} entries and {_MOST_FILES:,} files,"
                " found more"
            )
        if key in values:
            raise LogError(f"line {number}: {key}: expected once, found again")
        if key == _FILES:
            files += _read_flow_list(number, value)
        if key:
            under = key
            flow = _FLOW_DURATION.match(value) if key == _DURATION else None
            value = flow["value"] if flow else value
            values[key] = _unquote(number, key, value) if key in (*_TEXTS, _DURATION) else value
        elif under == _FILES:
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
    return "\n".join([f"{_ROOT}:", *(f"  {line}" for line in lines), ""])


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


def _read_flow_list(number: int, value: str) -> list[str]:
    """Return the names of a list in brackets on one line; empty for another value."""
    found = _FLOW_LIST.match(value)
    items = found["items"].strip() if found else ""
    names, place = [], 0
    while place < len(items):
        item = _FLOW_ITEM.match(items, place)
        if item is None:
            raise LogError(f"line {number}: {_FILES}: expected names, found {items[place:][:60]!r}")
        names.append(_read_file_name(number, item["quoted"] or item["plain"].strip()))
        place = item.end()
    return names


def _read_file_name(number: int, value: str) -> str:
    name = _unquote(number, _FILES, value)
    if not name or (value[:1] not in {'"', "'"} and re.search(r":(\s|$)", name)):
        raise LogError(
            f"line {number}: {_FILES}: expected the name of a file, found {value[:60]!r}"
        )
    return name


def _read_below(number: int, under: str, value: str) -> dict[str, str]:
    """Return what a line adds to the entry above; empty for entries that are not needed."""
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
        raise LogError(f"{_FILES}: expected a list of files, found {found or 'no file'}")
    if "storage_identifier" not in values:
        raise LogError("storage_identifier: missing; it must be mcap or sqlite3")


def _parse_duration(text: str) -> int | None:
    if not text:
        return None
    if not re.fullmatch(r"[0-9]{1,19}", text) or int(text) >= 2**63:
        raise LogError(f"{_DURATION}: expected whole nanoseconds below 2^63, found {text[:60]}")
    return int(text)


def _iterate_entries(text: str, root: str) -> Iterator[tuple[int, str, str]]:
    """Yield line, key and value of the entries right below the root.

    List items and keys below an entry are yielded as text without a key.
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
        raise LogError(f"the entry {root} is missing")


def _iterate_body(text: str, root: str) -> Iterator[tuple[int, int, bool, str]]:
    """Yield the lines below the root: number, indent, whether a list item begins, and content."""
    is_inside = False
    for number, whole in iterate_lines(text):
        line = whole.rstrip()
        body = line.lstrip(" ")
        item = _ITEM.match(body)
        content = body if item is None else body[item.end() :]
        if not content or content.startswith(("#", "---")):
            continue
        if item is None and body == line:
            is_inside = _COMMENT.sub("", content).rstrip() == f"{root}:"
        elif is_inside:
            yield number, len(line) - len(body), item is not None, content


def _unquote(number: int, key: str, value: str) -> str:
    """Return a value without quotes and without a trailing comment."""
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
