"""Metadata of recordings: declaration, scenario and losses."""

import zlib
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Final

import msgspec
import numpy as np
from mcap.records import Metadata
from numpy.typing import NDArray

from turtlelog.display import describe_count, parse_utc
from turtlelog.errors import LogError, RunError, ScenarioError
from turtlelog.files.text_files import format_toml, parse_known_toml
from turtlelog.libraries import __version__
from turtlelog.log.file_access import Loss, name_place
from turtlelog.run import Clock, Lost, Origin
from turtlelog.run.loops import Declaration, format_declaration, parse_declaration
from turtlelog.scenario import DEFAULT_LAW, nest_parameters

if TYPE_CHECKING:
    from turtlelog.run import Run


HEAD: Final = "turtlelog"
"""Name of the metadata record."""

CHECKSUM: Final = "checksum"
"""Name of the entry with the crc32 of all other entries, as JSON sorted by name, in hexadecimal."""

FORMAT_VERSION: Final = 2
SCENARIO_FILE: Final = "scenario.toml"
"""Attachment with a complete scenario."""

_PARAMETER_FILE: Final = "parameters.toml"
"""Attachment with the known values of a scenario."""

_USUAL: Final = 2**13
"""Longest declaration that is cached [bytes]."""

_LONGEST: Final = 2**18
"""Largest size of the record, and of an attachment, that is read [bytes]; turtlelog writes a few
thousand. Parsing TOML takes several hundred bytes of memory per byte."""

MAY_BE_ABSENT: Final = (
    *("wanted_speed_m_s", "wanted_turn_rate_rad_s", "bearing_rad", "heading_error_rad"),
    *("error_xy_m", "distance_m", "world_velocity_m_s"),
)
"""Columns of `SampleColumns` that are None if not recorded."""

_REQUIRED: Final = object()
"""Value of entries that every record has."""

_LONGEST_DECLARATION: Final = _LONGEST // 2
"""Largest declaration as JSON [bytes]; 250 names of 60 letters take 16 KiB."""

_OTHER_LAW: Final = Declaration(phases=dict.fromkeys(("rotate", "pause", "translate", "done"), ()))
"""Declaration of another law in format 1: the phases that every law had then."""


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
    if (size := sum(len(key) + len(value) for key, value in record.items())) > _LONGEST:
        raise LogError(f"metadata {HEAD}: expected up to {_LONGEST} bytes, found {size}")
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


def format_scenario_file(run: "Run") -> dict[str, bytes]:
    """Return the attached TOML text by its name; nothing if no parameter is known."""
    if not run.parameters and not run.scenario_is_complete:
        return {}
    try:
        tables = nest_parameters(run.parameters)
    except ScenarioError as err:
        raise LogError(f"parameters: {err}") from err
    name = SCENARIO_FILE if run.scenario_is_complete else _PARAMETER_FILE
    return {name: format_toml(tables).encode()}


def parse_scenario_file(attachments: Mapping[str, bytes]) -> tuple[dict[str, Any], bool]:
    """Return the attached tables, and whether they are a complete scenario. No law is loaded."""
    name = SCENARIO_FILE if SCENARIO_FILE in attachments else _PARAMETER_FILE
    text = attachments.get(name, b"")
    if len(text) > _LONGEST:
        raise LogError(f"attachment {name}: expected up to {_LONGEST} bytes, found {len(text)}")
    try:
        tables = parse_known_toml(text.decode())
    except ValueError as err:
        raise LogError(f"attachment {name}: not TOML: {err}") from err
    return tables, name in attachments and name == SCENARIO_FILE


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


def declare_format1(tables: Mapping[str, Any], *, has_samples: bool) -> Declaration:
    """Return the declaration of a law in format 1, which stores no declaration.

    A missing law is the default one; without its name and samples, nothing is known.
    """
    from turtlelog.laws.sequential_p import DECLARATION as SEQUENTIAL_P

    law = tables.get("law")
    kind = law.get("kind") if isinstance(law, Mapping) else None
    if kind is None and not has_samples:
        return Declaration()
    return SEQUENTIAL_P if kind is None or kind == DEFAULT_LAW else _OTHER_LAW


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
