"""Metadata and contents of recordings, complete or not: declaration, topics and losses."""

import zlib
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from typing import Any, BinaryIO, Final

import msgspec
import numpy as np
from mcap.opcode import Opcode
from mcap.records import Attachment, Metadata
from numpy.typing import NDArray

from turtlelog.display import describe_count, parse_utc
from turtlelog.errors import LogError, RunError
from turtlelog.libraries import __version__
from turtlelog.log.engine.blocks import build_walked_block, walk_through
from turtlelog.log.engine.channels import Catalogue
from turtlelog.log.engine.decode import (
    LOG_TIME,
    PUBLISH_TIME,
    SEQUENCE,
    Rows,
    Selection,
    read_piece,
)
from turtlelog.log.engine.limits import Allowance, measure_stored
from turtlelog.log.engine.source import Source, salvage_summary
from turtlelog.log.engine.topic_columns import TopicColumns, build_columns, collect_parts
from turtlelog.log.file_access import DamageError, Loss, name_place
from turtlelog.log.recording.topics import (
    LAW_STATE,
    TOPIC_NAMES,
    USED_FIELDS,
    check_type,
    list_topics,
    make_empty_topic,
    plan_topic,
)
from turtlelog.run import Clock, Lost, Origin
from turtlelog.run.loops import Declaration, format_declaration, parse_declaration

HEAD: Final = "turtlelog"
"""Name of the metadata record."""

CHECKSUM: Final = "checksum"
"""Name of the entry with the crc32 of all other entries, as JSON sorted by name, in hexadecimal."""

FORMAT_VERSION: Final = 2
SCENARIO_FILE: Final = "scenario.toml"
"""Attachment with a complete scenario."""

PARAMETER_FILE: Final = "parameters.toml"
"""Attachment with the known values of a scenario."""

_USUAL: Final = 2**13
"""Longest declaration that is cached [bytes]."""

LONGEST_TEXT: Final = 2**18
"""Largest size of the record, and of an attachment, that is read [bytes]; turtlelog writes a few
thousand. Parsing TOML takes several hundred bytes of memory per byte."""

MAY_BE_ABSENT: Final = (
    *("wanted_speed_m_s", "wanted_turn_rate_rad_s", "bearing_rad", "heading_error_rad"),
    *("error_xy_m", "distance_m", "world_velocity_m_s"),
)
"""Columns of `SampleColumns` that are None if not recorded."""

_REQUIRED: Final = object()
"""Value of entries that every record has."""

_LONGEST_DECLARATION: Final = LONGEST_TEXT // 2
"""Largest declaration as JSON [bytes]; 250 names of 60 letters take 16 KiB."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Head:
    """Contents of the metadata record.

    Attributes:
        format_version: Format version of the recording.
        source: Source, as in `Run`.
        name: Name, as in `Run`.
        stop_reason: Stop reason, as in `Run`.
        goal_heading_rad: Goal heading, as in `Run`; in the messages it is not exact.
        absent: Missing fields, as in `Run`.
        nan_columns: Columns of the run that are None, and NaN in the messages.
        more_topics: Optional topics of this recording, even without messages.
        declaration: Declaration, as in `Run`; None in format 1.
        notes: Notes, as in `Run`.
        clock: Clock, as in `Run`.
        origin: Origin, as in `Run`.
        simulated_by: Software, as in `Run`.
    """

    format_version: int
    source: str
    name: str
    stop_reason: str | None
    goal_heading_rad: float | None
    absent: tuple[str, ...]
    nan_columns: frozenset[str]
    more_topics: frozenset[str] = frozenset()
    declaration: Declaration | None
    notes: Mapping[str, str]
    clock: Clock | None = None
    origin: Origin = field(default_factory=Origin)
    simulated_by: Mapping[str, str] = field(default_factory=dict)


class ForeignFileError(LogError):
    """A third-party file."""


class PartialRecordingWarning(UserWarning):
    """Warning that only a part of a recording could be read, as allowed by the caller."""


def format_head(head: Head) -> dict[str, str]:
    """Return the metadata record. Entries that are None are omitted."""
    record = {
        "format_version": str(head.format_version),
        "turtlelog_version": __version__,
        "source": head.source,
        "name": head.name,
        "absent": _encode(head.absent),
        "nan_columns": _encode(sorted(head.nan_columns)),
        "notes": _encode(dict(head.notes)),
    }
    if head.declaration is not None:
        text = format_declaration(head.declaration)
        if len(text) > _LONGEST_DECLARATION:
            most = _LONGEST_DECLARATION
            raise LogError(f"declaration: expected up to {most} bytes as JSON, found {len(text)}")
        record["declaration"] = text
    rest = {
        "more_topics": sorted(head.more_topics),
        "clock": head.clock,
        "origin": None if head.origin == Origin() else head.origin,
        "simulated_by": dict(head.simulated_by),
    }
    record |= {name: _encode(value) for name, value in rest.items() if value}
    if head.stop_reason is not None:
        record["stop_reason"] = head.stop_reason
    if head.goal_heading_rad is not None:
        record["goal_heading_rad"] = repr(float(head.goal_heading_rad))
    # MCAP has no checksum for metadata records that are read without the rest of the file.
    return {**record, CHECKSUM: sum_up_record(record)}


def parse_head(record: Mapping[str, str]) -> Head:
    """Return the metadata record of a recording."""
    if (size := sum(len(key) + len(value) for key, value in record.items())) > LONGEST_TEXT:
        raise LogError(f"metadata {HEAD}: expected up to {LONGEST_TEXT} bytes, found {size}")
    version = _decode(record, "format_version", int)
    if version > FORMAT_VERSION:
        raise LogError(f"format version {version}: this turtlelog reads up to {FORMAT_VERSION}")
    if version < 1:
        raise LogError(f"format version {version}: expected 1 to {FORMAT_VERSION}")
    if _get(record, CHECKSUM) != sum_up_record(record):
        raise LogError(f"metadata {HEAD}: expected checksum {record[CHECKSUM]}: it is damaged")
    declaration = None
    if version > 1:
        text = _get(record, "declaration")
        with name_place(f"metadata {HEAD}: declaration"):
            parse = _keep_declaration if len(text) <= _USUAL else parse_declaration
            declaration = parse(text)
    head = Head(
        format_version=version,
        source=_get(record, "source"),
        name=_get(record, "name"),
        stop_reason=record.get("stop_reason"),
        goal_heading_rad=_decode(record, "goal_heading_rad", float, None),
        absent=_decode(record, "absent", tuple[str, ...]),
        nan_columns=_decode(record, "nan_columns", frozenset[str]),
        more_topics=_decode(record, "more_topics", frozenset[str], frozenset()),
        declaration=declaration,
        notes=_decode(record, "notes", dict[str, str]),
        clock=_decode(record, "clock", Clock, None),
        origin=_decode(record, "origin", Origin, Origin()),
        simulated_by=_decode(record, "simulated_by", dict[str, str], {}),
    )
    if version > 1:
        return head
    # Format 1 has the date of a log only in a note.
    began_ns = parse_utc(head.notes.get("original_timestamp", ""))
    return replace(head, origin=Origin(began_ns=began_ns))


_COLUMNS: Final = ("poses", "commands", "samples", "goal_xy_m", "parameters")
"""Columns of every recording, unless its metadata lists them as absent. Events may be missing."""


def add_lost(head: Head, held: Collection[str]) -> tuple[str, ...]:
    """Return the absent fields of an incomplete file: those in its metadata, and those not held."""
    has_goal = head.declaration is None or head.declaration.uses_goal
    expected = (name for name in _COLUMNS if has_goal or name != "goal_xy_m")
    lost = [name for name in expected if name not in held]
    return tuple(dict.fromkeys([*lost, *head.absent]))


def lacks_values(name: str, values: NDArray[np.float64]) -> bool:
    """Return whether a column of samples was not recorded. Some may lack a world velocity."""
    unknown = np.isnan(values)
    is_unknown = unknown.all() if name == "world_velocity_m_s" else unknown.any()
    return bool(unknown.size and is_unknown)


def sum_up_record(record: Mapping[str, str]) -> str:
    """Return the checksum of all entries except `CHECKSUM`."""
    rest = {key: value for key, value in sorted(record.items()) if key != CHECKSUM}
    return f"{zlib.crc32(msgspec.json.encode(rest)):08x}"


_keep_declaration = lru_cache(maxsize=32)(parse_declaration)


def _encode(value: object) -> str:
    return msgspec.json.encode(value).decode()


def _get(record: Mapping[str, str], key: str, of: str = HEAD) -> str:
    if key not in record:
        raise LogError(f"metadata {of}: the entry {key} is missing")
    return record[key]


def _decode(
    record: Mapping[str, str], key: str, kind: Any, absent: Any = _REQUIRED, of: str = HEAD
) -> Any:
    if key not in record and absent is not _REQUIRED:
        return absent
    text = _get(record, key, of)
    try:
        return msgspec.json.decode(text, type=kind)
    except (msgspec.MsgspecError, RunError) as err:
        raise LogError(f"metadata {of}: {key}: {err}, found {text[:60]!r}") from err


RECOVERY: Final = "turtlelog_recovery"
"""Name of the metadata record that distinguishes a recovered file from a complete one."""

LOSS_NOTES: Final = ("partial", "recovered")
"""Notes of a run on the losses of its recording."""

SUMMARY_LOST: Final = "the summary is damaged or missing"
SUMMARY_ALONE: Final = "no loss is found, only the summary is damaged"
"""A summary and a checksum would show that there is none."""


def describe_damages(damages: Sequence[Loss]) -> str:
    """Return one line on the losses: their total, and the first place."""
    if not damages:
        return SUMMARY_ALONE
    lost = sum(damage.end - damage.start for damage in damages)
    extent = f"{lost} bytes are lost in" if lost else "not whole in"
    places = describe_count(len(damages), "place")
    return f"{extent} {places}: byte {damages[0].start}: {damages[0].reason}"


def format_recovery(
    lost: Sequence[Loss], missing: Mapping[str, int] | None, unchecked: Mapping[str, int]
) -> dict[str, str]:
    """Return the metadata record, with each entry as JSON and a checksum of all entries."""
    entries = {"lost": lost, "missing": missing, "unchecked": unchecked}
    record = {name: _encode(value) for name, value in entries.items()}
    return {**record, CHECKSUM: sum_up_record(record)}


def describe_recovery(records: Iterable[Any]) -> tuple[dict[str, str], Lost]:
    """Return the note `recovered` for a file with these records, and what it has lost.

    If the file was not recovered, there is no note, and nothing is lost.
    """
    notes = [found for found in records if isinstance(found, Metadata) and found.name == RECOVERY]
    if not notes:
        return {}, "nothing"
    losses = dict(_describe(note.metadata) for note in notes)
    lost: Lost = "rows" if any(losses.values()) else "summary"
    return {"recovered": f"from a damaged or unfinished file: {'; '.join(losses)}"}, lost


def _describe(record: Mapping[str, str]) -> tuple[str, bool]:
    """Return a clause on the losses, and whether messages may be among them."""
    if record.get(CHECKSUM) != sum_up_record(record):
        raise LogError(f"metadata {RECOVERY}: damaged, its checksum does not match")
    lost = _decode(record, "lost", tuple[Loss, ...], of=RECOVERY)
    missing = _decode(record, "missing", dict[str, int] | None, of=RECOVERY)
    if missing is None:
        count = "the number of lost messages is unknown"
    elif missing:
        count = "lost " + ", ".join(f"{count} of {topic}" for topic, count in missing.items())
    else:
        count = "no message is lost"
    places = [f"byte {loss.start}: {loss.reason}" for loss in lost[:1]]
    if len(lost) > 1:
        places.append(describe_count(len(lost) - 1, "more place"))
    return f"{count} ({', and '.join(places)})" if places else count, missing != {}


_OWN: Final = Selection(topics=TOPIC_NAMES, is_lenient=True, is_flat=True, is_counted=True)
_USED: Final = replace(
    _OWN,
    kept={name: frozenset((LOG_TIME, SEQUENCE, *fields)) for name, fields in USED_FIELDS.items()},
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Contents:
    """Contents of a recording.

    Attributes:
        head: Metadata of the recording.
        attachments: Attached bytes by name.
        topics: Columns of every expected topic by name, empty without messages. In a complete file,
            fields that no run needs are omitted, and log times replace publish times.
        damages: Segments that could not be read; empty if the file is complete.
        recovered: Note on earlier losses, if the file was recovered.
        lost: What the file has lost.
    """

    head: Head
    attachments: Mapping[str, bytes]
    topics: dict[str, TopicColumns]
    damages: tuple[Loss, ...] = ()
    recovered: Mapping[str, str] = field(default_factory=dict)
    lost: Lost = "nothing"


def read_contents(stream: BinaryIO, *, may_be_foreign: bool = False) -> Contents:
    """Return the contents of a recording, after checking all available checksums.

    Damage of a third-party file is not suspected if it `may_be_foreign`.

    Raises:
        LogError: If the file is not MCAP, or a topic of turtlelog has another type.
        ForeignFileError: If the file is a third-party file.
        DamageError: If the file is unfinished or damaged.
    """
    source = Source(stream)
    try:
        contents = _read_source(source)
    except DamageError:
        raise
    except LogError as err:
        if may_be_foreign and isinstance(err, ForeignFileError):
            raise
        source.check_data()  # a wrong byte is the actual reason
        raise
    if source.is_indexed:  # last, because its error names no place
        source.check_data()
    return contents


def _read_source(source: Source) -> Contents:
    found: list[Any] = list(source.read_lone((Opcode.METADATA, Opcode.ATTACHMENT)))
    head: Head | None = None
    if source.is_indexed:
        # First: messages of other programs or a newer turtlelog may have other types.
        head = _find_head(found)
    parts = collect_parts(source, _USED, lambda piece: found.extend(_keep_notes(piece.rest)))
    for rows in (rows for of_topic in parts.values() for rows in of_topic):
        rows[PUBLISH_TIME] = rows[LOG_TIME]
    return build_contents(found, source.catalogue, parts, (), head)


def _keep_notes(records: Iterable[Any]) -> list[Any]:
    return [found for found in records if isinstance(found, Metadata | Attachment)]


def salvage_contents(stream: BinaryIO) -> Contents:
    """Return the readable contents of a damaged or unfinished recording."""
    catalogue, damages = Catalogue(Allowance(measure_stored(stream))), list[Loss]()
    parts: dict[str, list[Rows]] = {}
    found: list[Any] = []
    summary = salvage_summary(stream)
    if summary is not None:
        catalogue.add((*summary.schemas, *summary.channels), 0)
    for block in walk_through(stream, partial(build_walked_block, catalogue), damages=damages):
        found += _keep_notes(block.rest)
        known = {number: block.offsets[number] for number in block.offsets if number in catalogue}
        try:
            piece = read_piece(catalogue, _OWN, block, known)
        except LogError as err:
            end = block.byte + len(block.data)
            damages.append(Loss(start=block.byte, end=end, reason=str(err)))
            continue
        for number in block.offsets.keys() - known.keys():
            reason = f"channel {number}: expected its record, found messages only"
            damages.append(Loss(start=block.byte, end=block.byte, reason=reason))
        for topic, rows in piece.rows.items():
            parts.setdefault(topic, []).append(rows)
    return build_contents(found, catalogue, parts, damages)


def build_contents(
    records: Collection[Any],
    catalogue: Catalogue,
    parts: Mapping[str, list[Rows]],
    damages: Collection[Loss],
    head: Head | None = None,
) -> Contents:
    """Return the contents from records outside chunks and the rows of topics in parts."""
    head, tables = head or _find_head(records), dict[str, TopicColumns]()
    states = () if head.declaration is None else head.declaration.states
    # For an unfinished recording, its topics show its effects.
    for topic in list_topics(head.declaration, more={*head.more_topics, *parts}):
        own = states if topic.name == LAW_STATE else ()
        if topic.name in catalogue.topics:
            check_type(plan_topic(topic, own), catalogue.find_plan(topic.name))
        rows = parts.get(topic.name) or [dict(make_empty_topic(topic, own))]
        tables |= build_columns({topic.name: rows}, {topic.name: topic.schema})
    recovered, lost = describe_recovery(records)
    return Contents(
        head=head,
        attachments={found.name: found.data for found in records if isinstance(found, Attachment)},
        topics=tables,
        damages=tuple(damages),
        recovered=recovered,
        lost=lost,
    )


def _find_head(records: Collection[Any]) -> Head:
    """Return the last metadata record: a live recording adds one with its stop reason."""
    heads = [found for found in records if isinstance(found, Metadata) and found.name == HEAD]
    if not heads:
        raise ForeignFileError(f"not a recording of turtlelog: it has no metadata record {HEAD}")
    return parse_head(heads[-1].metadata)
