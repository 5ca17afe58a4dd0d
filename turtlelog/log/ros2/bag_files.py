"""The files of a bag, as its metadata.yaml or the folder names them, and their contents.

Single lines of metadata.yaml are read, because a YAML library takes 50 times as long: 4 s for 2,000
topics. Anchors, and lists in brackets over several lines, are refused; no recorder writes them.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Final

from turtlelog.display import split_numbers
from turtlelog.errors import LogError
from turtlelog.files.text_files import iterate_lines
from turtlelog.files.urls import make_path
from turtlelog.log.engine.opening import BAG_SUFFIXES, require_one_storage
from turtlelog.log.file_access import name_file, open_file
from turtlelog.log.file_info import (
    METADATA_FILE,
    METADATA_ROOT,
    RecordingInfo,
    list_absent,
    merge_topics,
    read_info,
)
from turtlelog.run import find_greatest_loss

_LARGEST: Final = 2**24
"""Largest size of metadata.yaml [bytes]; a file with 2,000 topics has 2 MB."""

_MOST_ENTRIES: Final = 1000

_MOST_FILES: Final = 100_000
"""Largest numbers of entries directly below the root, of which rosbag2 writes 12, and of files: a
day in parts of one second. A text of this size could contain ten million entries."""

_MOST_LINES: Final = 10 * _MOST_FILES
"""Largest number of lines: a file takes eight, and the text is read up to four times."""

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
    for number, key, value in _iterate_entries(text):
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
    return _build_metadata(values, files)


def _read_flow_list(number: int, value: str) -> list[str]:
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


def _build_metadata(values: Mapping[str, str], files: Sequence[str]) -> BagMetadata:
    if not files:
        found = values.get(_FILES, "")[:60].replace("[]", "")
        raise LogError(f"{_FILES}: expected a list of files, found {found or 'no file'}")
    if "storage_identifier" not in values:
        raise LogError("storage_identifier: missing; it must be mcap or sqlite3")
    mode, span = values.get("compression_mode", "").lower(), values.get(_DURATION, "")
    if span and (not re.fullmatch(r"[0-9]{1,19}", span) or int(span) >= 2**63):
        raise LogError(f"{_DURATION}: expected whole nanoseconds below 2^63, found {span[:60]}")
    return BagMetadata(
        storage=values["storage_identifier"],
        compression="" if mode == "none" else mode,
        files=tuple(files),
        duration_ns=int(span) if span else None,
    )


def _iterate_entries(text: str) -> Iterator[tuple[int, str, str]]:
    """Yield line, key and value of the entries below the root; items without a key."""
    depth, is_inside = -1, False
    for number, whole in iterate_lines(text):
        line = whole.rstrip()
        body = line.lstrip(" ")
        item, indent = _ITEM.match(body), len(line) - len(body)
        content = body if item is None else body[item.end() :]
        if not content or content.startswith(("#", "---")):
            continue
        if item is None and not indent:
            is_inside = _COMMENT.sub("", content).rstrip() == f"{METADATA_ROOT}:"
            continue
        if not is_inside:
            continue
        depth = indent if depth < 0 else depth
        entry = None if item or indent > depth else _ENTRY.match(content)
        if entry is not None:
            yield number, entry["key"], entry["value"] or ""
        elif item or indent > depth:
            yield number, "", content
        else:
            raise LogError(f"line {number}: expected key: value, found {content[:60]!r}")
    if depth < 0:
        raise LogError(f"the entry {METADATA_ROOT} is missing")


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


_PART: Final = re.compile(r"_[0-9]+(?:\.[A-Za-z0-9]+)+$")
"""Pattern for the ends of the names of a bag's parts."""

_MOST_NAMED: Final = 6
"""Largest number of files that an error names: one line of a terminal."""

_MOST_OVERLAP: Final = 0.5
"""Largest overlap of two parts, as a share of the shorter; two recordings overlap completely."""

_MOST_APART_NS: Final = 10_000_000_000
"""Longest time from the end of a part to the next part [ns]. A running robot publishes transforms,
diagnostics or odometry at least every few seconds."""

_MOST_APART_STEPS: Final = 100.0
"""The same limit as a multiple of the mean time between messages, for slow topics alone."""

_UNITS_S: Final = (("days", 86_400.0), ("hours", 3600.0), ("minutes", 60.0), ("s", 1.0))


@dataclass(frozen=True, slots=True, kw_only=True)
class BagFiles:
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
        LogError: If a folder contains no files of a bag, lacks a named one, or mixes kinds.
    """
    return find_bag_files(path).files


def find_bag_files(path: str | Path) -> BagFiles:
    """Return the files of a bag as named in metadata.yaml; without it, the files in the folder."""
    path = make_path(path)
    if not path.is_dir():
        return BagFiles(files=(path,))
    present, metadata = _list_present(path), None
    try:
        metadata = read_bag_metadata(path)
    except LogError as err:
        found = _take_present(path, present, str(err))
    if metadata is not None:
        with name_file(path / METADATA_FILE, expected="the description of a bag"):
            found = _find_named(path, metadata, present)
    with name_file(path, expected="a bag"):
        require_one_storage(found.files)
    if metadata is None:
        _require_one_bag(path, found.files)
    return found


def list_present_files(folder: Path) -> tuple[tuple[Path, ...], list[str]]:
    """Return the files of a bag to recover, in order if known, and names of those missing."""
    try:
        return find_bag_files(folder).files, []
    except LogError as err:
        files = _take_present(folder, _list_present(folder), str(err)).files
    present, named = {file.name for file in files}, tuple[str, ...]()
    with suppress(LogError):
        named = read_bag_metadata(folder).files
    return files, [name for name in named if PurePosixPath(name).name not in present]


def _list_present(folder: Path) -> tuple[Path, ...]:
    with name_file(folder, expected="a bag"):
        named = (file for file in folder.iterdir() if file.name.lower().endswith(BAG_SUFFIXES))
        files = sorted(filter(Path.is_file, named), key=lambda file: split_numbers(file.name))
        first: dict[Path, Path] = {}  # of links to one file
        for file in files:
            first.setdefault(file.resolve(), file)
        return tuple(first.values())


def read_compression(folder: Path) -> str:
    """Return `message` if a bag's metadata show that messages are compressed one by one."""
    try:
        found = read_bag_metadata(folder).compression
    except LogError:
        return ""
    return found if found == "message" else ""


def _take_present(folder: Path, present: tuple[Path, ...], reason: str) -> BagFiles:
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
    return BagFiles(files=present, notes={"bag_files": f"{reason}; in order of name: {names}"})


def _find_named(folder: Path, metadata: BagMetadata, present: tuple[Path, ...]) -> BagFiles:
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
    if not missing:
        return BagFiles(files=tuple(files), duration_ns=metadata.duration_ns)
    others = [file for file in present if file not in files]
    names = ", ".join(file.name for file in others) or "none"
    if len(missing) != len(others) or (files and len(others) > 1):
        names = f"{names[:200]}{'; --partial reads the others' if files else ''}"
        raise LogError(f"relative_file_paths: expected the file {missing[0]}, found {names}")
    found = [*files] or others
    if files:
        found.insert(metadata.files.index(missing[0]), others[0])
    lost = ", ".join(missing)
    note = f"{METADATA_FILE} names {lost}, not in the folder; read instead: {names}"
    return BagFiles(files=tuple(found), duration_ns=metadata.duration_ns, notes={"bag_files": note})


def _find_file(folder: Path, name: str, base: str) -> Path | None:
    """Return a file of a bag; `base` is the bag's folder from the root.

    None outside the bag is read: a recording must not choose which files are opened.
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
    """Return why numbered files are not parts of one bag; None if each continues another."""
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
            unit, unit_s = next(one for one in _UNITS_S if gap_ns >= 2e9 * one[1])
            return f"{second} begins {gap_ns / 1e9 / unit_s:.0f} {unit} after {first} ends"
    return None


def read_bag_info(path: str | Path) -> RecordingInfo:
    """Return the contents of a bag folder, with the topics of all files merged.

    A folder with one turtlelog recording is described as that recording.

    Raises:
        LogError: If the folder is not a bag, or one of its files cannot be read.
    """
    path = make_path(path)
    found = find_bag_files(path)
    infos = [read_info(file) for file in found.files]
    if len(infos) == 1 and infos[0].format_version is not None:
        return replace(infos[0], notes={**infos[0].notes, **found.notes})
    merged = merge_topics(topic for info in infos for topic in info.topics)
    topics = tuple(sorted(merged, key=lambda topic: (topic.topic, topic.type)))
    duration_ns = found.duration_ns
    if duration_ns is None and (spans := [info.span_ns for info in infos if info.span_ns]):
        duration_ns = max(end for _, end in spans) - min(start for start, _ in spans)
    name, all_notes = path.resolve().name, [*(info.notes for info in infos), found.notes]
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
        notes={name: text for notes in all_notes for name, text in notes.items()},
        lost=find_greatest_loss(*(info.lost for info in infos)),
    )
