"""The files of a bag, what its metadata.yaml says of them, and what is in them.

A reader needs four entries of metadata.yaml and a writer always writes the same few lines, so both
go by lines here: a YAML library would be a dependency for that alone, and takes 50 times as long (4
s for 2,000 topics). What the reader does not understand (flow lists, anchors) it refuses by line;
neither rosbag2 nor rosbags writes it.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Final

from turtlelog.errors import LogError
from turtlelog.log.engine.opening import BAG_SUFFIXES
from turtlelog.log.error_boundary import name_file, open_file
from turtlelog.log.info import RecordingInfo, list_absent, merge_topics, read_info, sort_topics

METADATA_FILE: Final = "metadata.yaml"

_LARGEST: Final = 2**24
"""Bytes of metadata.yaml; with 2,000 topics it takes 2 MB."""

_ROOT: Final = "rosbag2_bagfile_information"

_TEXTS: Final = ("storage_identifier", "compression_mode")
_FILES: Final = "relative_file_paths"
_DURATION: Final = "duration"

_LINE: Final = re.compile(r"^(?P<indent> *)(?P<item>- +)?(?P<text>.*?)\s*$")
_ENTRY: Final = re.compile(r"^(?P<key>[\w.]+):(?: +(?P<value>.*))?$")
_QUOTED: Final = re.compile(
    r"""^(?:"(?P<double>[^"\\]*)"|'(?P<single>(?:[^']|'')*)')(?:\s+#.*)?$"""
)
_FLOW_ITEM: Final = re.compile(r"""\s*("[^"\\]*"|'(?:[^']|'')*'|[^,'"\[\]{}]+)\s*(?:,|$)""")
_FLOW_LIST: Final = re.compile(rf"^\[(?P<items>(?:{_FLOW_ITEM.pattern})*)\s*\](?:\s+#.*)?$")
_FLOW_DURATION: Final = re.compile(r"^\{\s*nanoseconds:\s+(?P<value>[^\s{},]+)\s*\}")
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


@dataclass(frozen=True, slots=True, kw_only=True)
class BagFiles:
    """The files of a bag.

    Attributes:
        files: In order of time, as far as the bag says.
        duration_ns: First to last message as the bag says [ns]; None where it does not.
        notes: `bag_files` where the metadata is missing or broken, or names another file.
    """

    files: tuple[Path, ...]
    duration_ns: int | None = None
    notes: Mapping[str, str] = field(default_factory=dict)


def list_bag_files(path: str | Path) -> tuple[Path, ...]:
    """Return the files of a bag in its own order: those of a folder, or a lone file.

    Raises:
        LogError: As `find_bag_files`.
    """
    return find_bag_files(path).files


def find_bag_files(path: str | Path) -> BagFiles:
    """Return the files of a bag: those that metadata.yaml names and, without it, those there are.

    Raises:
        LogError: Where a folder holds no files of a bag, lacks one that its metadata names, or
            mixes kinds.
    """
    path = Path(path)
    if not path.is_dir():
        return BagFiles(files=(path,))
    with name_file(path, expected="a bag"):
        present = tuple(sorted((file for file in path.iterdir() if _is_bag_file(file)), key=_rank))
    place = path / METADATA_FILE
    try:
        metadata = read_bag_metadata(path)
    except LogError as err:
        found = _take_present(path, present, str(err))
    else:
        with name_file(place, expected="the description of a bag"):
            found = _find_named(path, metadata, present)
    with name_file(path, expected="a bag"):
        _require_one_kind(found.files)
    return found


def read_bag_metadata(folder: Path) -> BagMetadata:
    """Return what a bag folder says of itself.

    Raises:
        LogError: Where it says nothing that can be read.
    """
    place = folder / METADATA_FILE
    with name_file(place, expected="the description of a bag"):
        return parse_bag_metadata(_decode(_read_description(place)))


def _read_description(place: Path) -> bytes:
    with open_file(place) as stream:
        size = stream.seek(0, 2)
        if size > _LARGEST:
            raise LogError(f"expected up to {_LARGEST} bytes, found {size}")
        stream.seek(0)
        return stream.read()


def _is_bag_file(file: Path) -> bool:
    return file.name.lower().endswith(BAG_SUFFIXES) and file.is_file()


def _rank(file: Path) -> tuple[object, ...]:
    """Return the place of a file among others: numbers in names count, so that _10 follows _9."""
    parts = re.split(r"([0-9]+)", file.name)
    return (*((int(part), "") if part.isdecimal() else (-1, part) for part in parts), file.name)


def _take_present(folder: Path, present: tuple[Path, ...], reason: str) -> BagFiles:
    """Return the files that are there, where nothing that can be read names them.

    Raises:
        LogError: Where there are none.
    """
    if not present:
        if not (folder / METADATA_FILE).exists():
            ros1 = next(iter(sorted(folder.glob("*.bag"))), None)
            found = f"the bag of ROS 1 {ros1.name}: name that file" if ros1 else "a folder without"
            ending = "" if ros1 else f" {METADATA_FILE}, .mcap or .db3 files"
            raise LogError(f"{folder}: expected a bag, found {found}{ending}")
        raise LogError(reason)
    names = ", ".join(file.name for file in present)
    if not (folder / METADATA_FILE).exists():
        reason = f"{METADATA_FILE} is missing"
    return BagFiles(files=present, notes={"bag_files": f"{reason}; in order of name: {names}"})


def _find_named(folder: Path, metadata: BagMetadata, present: tuple[Path, ...]) -> BagFiles:
    """Return the files that the metadata names; one that was renamed, where it is the only one.

    Raises:
        LogError: Where one is missing, or named twice.
    """
    files: list[Path] = []
    missing: list[str] = []
    for name in metadata.files:
        file = _find_file(folder, name)
        if file is None:
            missing.append(name)
        elif file in files:
            raise LogError(f"relative_file_paths: expected each file once, found {file.name} twice")
        else:
            files.append(file)
    duration_ns = metadata.duration_ns
    if not missing:
        return BagFiles(files=tuple(files), duration_ns=duration_ns)
    others = [file for file in present if file not in files]
    names = ", ".join(file.name for file in others) or "none"
    if len(missing) != len(others) or (files and len(others) > 1):
        raise LogError(f"relative_file_paths: expected the file {missing[0]}, found {names[:200]}")
    for lost, other in zip(missing, others, strict=True):
        files.insert(metadata.files.index(lost), other)
    note = f"{METADATA_FILE} names {', '.join(missing)}, found none; read instead: {names}"
    return BagFiles(files=tuple(files), duration_ns=duration_ns, notes={"bag_files": note})


def _find_file(folder: Path, name: str) -> Path | None:
    """Return a file of a bag; early versions put the folder's name in front, or a whole path.

    Whatever path is named, what is read lies in the folder.
    """
    place = PurePosixPath(name.replace("\\", "/"))
    is_inside = not (place.is_absolute() or PureWindowsPath(name).drive or ".." in place.parts)
    for file in (*([folder / place] if is_inside else []), folder / place.name):
        if place.name not in {"", ".."} and file.is_file():
            return file
    return None


def _require_one_kind(files: tuple[Path, ...]) -> None:
    """Refuse files of SQLite beside files of MCAP: no recorder writes both into one bag."""
    kinds = {".db3" in file.suffixes for file in files}
    if len(kinds) > 1:
        names = ", ".join(file.name for file in files)
        raise LogError(f"expected files of one storage, found MCAP beside SQLite: {names[:200]}")


def _decode(content: bytes) -> str:
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as err:
        found = f"byte {content[err.start]:#04x} at {err.start}"
        raise LogError(f"expected text in UTF-8, found {found}") from err


def read_bag_info(path: str | Path) -> RecordingInfo:
    """Return what is in a bag folder: its files' topics together.

    A folder around one of turtlelog's own recordings is described as that recording.

    Raises:
        LogError: Where it is no bag, or one of its files cannot be read.
    """
    path = Path(path)
    found = find_bag_files(path)
    infos = [read_info(file) for file in found.files]
    if len(infos) == 1 and infos[0].format_version is not None:
        return replace(infos[0], notes={**infos[0].notes, **found.notes})
    topics = sort_topics(merge_topics(topic for info in infos for topic in info.topics))
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
        if key == _FILES:
            files += _read_flow_list(number, value)
        if key:
            under = key
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


def _read_flow_list(number: int, value: str) -> list[str]:
    """Return the names of a list within brackets, on one line; none of another value."""
    found = _FLOW_LIST.match(value)
    if found is None or not found["items"].strip():
        return []
    return [
        _read_file_name(number, item[0].strip()) for item in _FLOW_ITEM.finditer(found["items"])
    ]


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
