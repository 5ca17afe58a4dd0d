"""Reading of recordings as runs: complete, with losses, or while they grow."""

import warnings
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from turtlelog.errors import LogError
from turtlelog.log.engine.blocks import build_walked_block
from turtlelog.log.engine.channels import Catalogue
from turtlelog.log.engine.decode import Rows, Selection, read_piece
from turtlelog.log.engine.limits import Allowance
from turtlelog.log.engine.message_types import Column
from turtlelog.log.engine.opening import NoMcapError, open_mcap
from turtlelog.log.engine.topic_columns import TopicColumns
from turtlelog.log.engine.walk import Section, walk_growing
from turtlelog.log.file_access import (
    MCAP0_MAGIC,
    DamageError,
    UnfinishedError,
    check_start,
    is_live,
    name_file,
    open_file,
)
from turtlelog.log.file_info import parse_scenario_file, survey_file
from turtlelog.log.recording import topics
from turtlelog.log.recording.head import (
    MAY_BE_ABSENT,
    Contents,
    ForeignFileError,
    Head,
    PartialRecordingWarning,
    add_lost,
    build_contents,
    describe_damages,
    lacks_values,
    read_contents,
    salvage_contents,
)
from turtlelog.log.recording.topics import reconcile_tables
from turtlelog.run import (
    CommandColumns,
    Event,
    Lost,
    PoseColumns,
    Run,
    SampleColumns,
    find_greatest_loss,
)
from turtlelog.run.loops import Declaration
from turtlelog.scenario import DEFAULT_LAW, flatten_tables

Values = NDArray[np.float64]

_FOUND_LATE: Final = frozenset(MAY_BE_ABSENT) - {"wanted_speed_m_s", "wanted_turn_rate_rad_s"}
_NOTHING_LEFT: Final = "no message can be recovered: copy the file again from its source"


def read_recording(path: str | Path, *, allow_partial: bool = False) -> Run:
    """Return the run in a recording after checking its checksums. The law is not loaded.

    Args:
        path: The recording.
        allow_partial: Whether to read the intact part of an unfinished or damaged recording. A
            `PartialRecordingWarning` and the note `partial` of the run describe the losses.

    Raises:
        LogError: If the file cannot be read, is not a recording, is damaged, or is from a newer
            turtlelog. One line with the file and the place.
    """
    return _read_file(path, allow_partial=allow_partial, may_be_foreign=False)


def read_if_own(path: str | Path, *, allow_partial: bool = False) -> Run | None:
    """Return the run in a recording as `read_recording` does; None for third-party files."""
    try:
        return _read_file(path, allow_partial=allow_partial, may_be_foreign=True)
    except LogError as err:
        if isinstance(err.__cause__, ForeignFileError | NoMcapError):
            return None
        raise


def _read_file(path: str | Path, *, allow_partial: bool, may_be_foreign: bool) -> Run:
    with name_file(path, expected="a turtlelog recording"), open_mcap(path) as stream:
        try:
            return _build_whole_run(read_contents(stream, may_be_foreign=may_be_foreign))
        except DamageError as err:
            # The error's frames hold unpacked data; they are freed before the file is read again.
            damage, is_unfinished = str(err), isinstance(err, UnfinishedError)
        if not allow_partial:
            survey = None
            with suppress(LogError):  # no record is left
                survey = survey_file(stream, allow_partial=True)
            if may_be_foreign and is_unfinished and survey is not None and not survey.is_own:
                raise ForeignFileError(f"{damage}: not a recording by turtlelog")
            is_empty = survey is not None and not any(survey.counts.values())
            advice = f"turtlelog convert --recover {path} -o OUT rewrites what can be read"
            raise LogError(f"{damage}: {_NOTHING_LEFT if is_empty else advice}")
        try:
            contents, dropped = _reconcile(salvage_contents(stream))
            lost: Lost = "rows" if contents.damages or dropped else "summary"
            lost = find_greatest_loss(contents.lost, lost)
            run = _build_part(replace(contents, lost=lost))
            said = describe_damages(contents.damages) + dropped
        except LogError as err:
            raise LogError(f"{damage}; in what it still holds: {err}") from err
    warnings.warn(f"{path}: {said}", PartialRecordingWarning, stacklevel=3)
    return replace(run, notes={**run.notes, "partial": said})


def _build_whole_run(contents: Contents) -> Run:
    """Return the run of a complete file. A recovered file may lack rows, and then has a note."""
    if not contents.recovered:
        return build_run(contents)
    reconciled, dropped = _reconcile(contents)
    notes = {name: text + dropped for name, text in contents.recovered.items()}
    lost: Lost = "rows" if dropped else contents.lost
    return _build_part(replace(reconciled, recovered=notes, lost=lost))


def _build_part(contents: Contents) -> Run:
    """Return the run of a file without some of its rows. A column without values is absent."""
    run = build_run(contents)
    columns = {
        "poses": len(run.poses) > 0,
        "commands": len(run.commands) > 0,
        "samples": len(run.samples) > 0,
        "goal_xy_m": run.goal_xy_m is not None,
        "parameters": bool(run.parameters),
    }
    held = {name for name, is_there in columns.items() if is_there}
    return replace(run, absent=add_lost(contents.head, held))


def build_run(contents: Contents) -> Run:
    """Return the run in the contents of a recording. The topics are removed to save memory."""
    head = contents.head
    tables, is_complete = parse_scenario_file(contents.attachments)
    columns = contents.topics
    declaration = head.declaration
    if declaration is None:
        declaration = declare_format1(tables, has_samples=len(columns[topics.CONTROL.name]) > 0)
    goal, goal_xy_m = columns[topics.GOAL.name].fields, None
    if len(columns[topics.GOAL.name]):
        goal_xy_m = float(goal["pose.position.x"][0]), float(goal["pose.position.y"][0])
    # Each table frees its source before the next is built.
    columns.pop(topics.REFERENCE.name, None)
    poses = _build_poses(columns, head)
    command = columns.pop(topics.COMMAND.name)
    commands = CommandColumns(
        time_ns=command.log_time_ns,
        speed_m_s=command.fields["linear.x"],
        lateral_speed_m_s=command.fields["linear.y"],
        turn_rate_rad_s=command.fields["angular.z"],
    )
    events = _build_events(columns.pop(topics.EVENT.name))
    samples = _build_samples(columns, head, declaration)
    return Run(
        name=head.name,
        source=head.source,
        poses=poses,
        commands=commands,
        samples=samples,
        goal_xy_m=goal_xy_m,
        goal_heading_rad=head.goal_heading_rad,
        declaration=declaration,
        parameters=flatten_tables(tables),
        scenario_is_complete=is_complete,
        clock=head.clock,
        stop_reason=head.stop_reason,
        events=events,
        simulated_by=head.simulated_by,
        absent=head.absent,
        origin=replace(head.origin, lost=find_greatest_loss(head.origin.lost, contents.lost)),
        notes={**head.notes, **contents.recovered},
    )


_OTHER_LAW: Final = Declaration(phases=dict.fromkeys(("rotate", "pause", "translate", "done"), ()))
"""Declaration of another law in format 1: the phases that every law had then."""


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


def _build_poses(columns: dict[str, TopicColumns], head: Head) -> PoseColumns:
    pose = columns.pop(topics.POSE.name)
    if not len(pose):
        raise LogError(f"topic {topics.POSE.name}: no messages")
    position = _prefer(columns.pop(topics.POSE64.name), pose).fields
    velocity = _prefer(columns.pop(topics.VELOCITY64.name), pose).fields
    speed = velocity["linear.x" if "linear.x" in velocity else "linear_velocity"]
    turn_rate = velocity["angular.z" if "angular.z" in velocity else "angular_velocity"]
    sensed = _build_sensed(columns, pose, columns[topics.CONTROL.name].fields["pose_sequence"])
    return PoseColumns(
        time_ns=pose.log_time_ns,
        xy_m=_gather(position, ("x", "y")),
        heading_rad=_gather(position, ("theta",)),
        speed_m_s=_unless_nan(head, "poses.speed_m_s", speed),
        turn_rate_rad_s=_unless_nan(head, "poses.turn_rate_rad_s", turn_rate),
        **_build_measured(columns, pose, head),
        sensed_xy_m=sensed[0],
        sensed_heading_rad=sensed[1],
    )


def _build_measured(
    columns: dict[str, TopicColumns], pose: TopicColumns, head: Head
) -> dict[str, Values | None]:
    if topics.MEASURED.name not in columns:
        return {}
    found = columns.pop(topics.MEASURED.name)
    if not np.array_equal(found.log_time_ns, pose.log_time_ns):
        expected = f"the times of the {len(pose)} poses"
        raise LogError(f"topic {found.topic}: expected {expected}, found {len(found)} others")
    names = {"measured_speed_m_s": "linear.x", "measured_turn_rate_rad_s": "angular.z"}
    return {
        name: _unless_nan(head, f"poses.{name}", found.fields[field])
        for name, field in names.items()
    }


def _build_sensed(
    columns: dict[str, TopicColumns], pose: TopicColumns, read: Column
) -> tuple[Values | None, Values | None]:
    """Return sensed position and heading, NaN for poses that dropped out."""
    if topics.SENSED.name not in columns:
        return None, None
    sensed = columns.pop(topics.SENSED.name)
    rows, place = sensed.sequence, f"topic {topics.SENSED.name}"
    is_rising = bool((rows[1:] > rows[:-1]).all())
    if not is_rising or not (rows < len(pose)).all():
        raise LogError(
            f"{place}: expected numbers of the {len(pose)} poses, each once, found others"
        )
    if not np.array_equal(sensed.log_time_ns, pose.log_time_ns[rows]):
        raise LogError(
            f"{place}: expected the times of the poses of the same numbers, found others"
        )
    missing = ~np.isin(read, rows)
    if missing.any():
        number = read[missing.argmax()]
        raise LogError(f"{place}: pose {number} is missing, which a sample read")
    return _spread(_prefer(columns.pop(topics.SENSED64.name), sensed), rows, len(pose))


def _spread(found: TopicColumns, rows: Column, count: int) -> tuple[Values, Values]:
    """Return position and heading at some of `count` rows, NaN at all others."""
    xy_m, heading_rad = np.full((count, 2), np.nan), np.full(count, np.nan)
    xy_m[rows, 0], xy_m[rows, 1] = found.fields["x"], found.fields["y"]
    heading_rad[rows] = found.fields["theta"]
    return xy_m, heading_rad


def _prefer(exact: TopicColumns, rounded: TopicColumns) -> TopicColumns:
    if not len(exact):
        return rounded
    if not np.array_equal(exact.log_time_ns, rounded.log_time_ns):
        expected, found = len(rounded), len(exact)
        raise LogError(
            f"topic {exact.topic}: expected the times of the {expected} poses, found {found} others"
        )
    return exact


def _build_samples(
    columns: dict[str, TopicColumns], head: Head, declaration: Declaration
) -> SampleColumns:
    sequence = columns[topics.CONTROL.name].fields["sequence"]
    reference_xy_m, reference_heading_rad = _build_reference(columns, head, sequence)
    states = _pop_numbered(columns, topics.LAW_STATE, sequence)
    shaped = _pop_numbered(columns, topics.SHAPED.name, sequence)
    samples = columns.pop(topics.CONTROL.name)
    time_ns, fields = samples.log_time_ns, dict(samples.fields)
    del samples, sequence
    found: dict[str, Any] = {}
    for name, parts in topics.CONTROL_COLUMNS.items():
        found[name] = _gather(fields, parts)
        for part in parts:
            del fields[part]
    for name in MAY_BE_ABSENT:
        # The metadata at the start of a live recording cannot list what its samples will lack.
        is_late = head.format_version > 1 and name in _FOUND_LATE
        is_lacking = is_late and lacks_values(name, found[name])
        found[name] = None if is_lacking else _unless_nan(head, f"samples.{name}", found[name])
    return SampleColumns(
        time_ns=time_ns,
        **found,
        states=np.column_stack([states[name] for name in declaration.states]) if states else None,
        shaped_speed_m_s=shaped.get("linear.x"),
        shaped_turn_rate_rad_s=shaped.get("angular.z"),
        reference_xy_m=reference_xy_m,
        reference_heading_rad=reference_heading_rad,
    )


def _gather(fields: Mapping[str, Column], names: tuple[str, ...]) -> Column:
    """Return a field, or several fields side by side, as 64-bit numbers."""
    values = fields[names[0]] if len(names) == 1 else np.column_stack([fields[n] for n in names])
    return values.astype(np.float64 if values.dtype.kind == "f" else np.int64, copy=False)


def _pop_numbered(
    columns: dict[str, TopicColumns], topic: str, sequence: Column
) -> Mapping[str, Column]:
    """Return the fields of a topic with exactly one message per sample; empty without the topic."""
    if topic not in columns:
        return {}
    found = columns.pop(topic)
    if not np.array_equal(found.sequence, sequence):
        expected = f"the numbers of the {len(sequence)} samples"
        raise LogError(f"topic {topic}: expected {expected}, found {len(found)} others")
    return found.fields


def _build_reference(
    columns: dict[str, TopicColumns], head: Head, sequence: Column
) -> tuple[Values | None, Values | None]:
    """Return reference position and heading by sample; NaN for samples without a reference."""
    found = columns.pop(topics.REFERENCE64.name, None)
    if found is None or "samples.reference_xy_m" in head.nan_columns:
        return None, None
    is_rising = bool((found.sequence[1:] > found.sequence[:-1]).all())
    if not is_rising or not np.isin(found.sequence, sequence).all():
        expected = f"numbers of the {len(sequence)} samples, each once"
        raise LogError(f"topic {topics.REFERENCE64.name}: expected {expected}, found others")
    return _spread(found, np.searchsorted(sequence, found.sequence), len(sequence))


def _build_events(columns: TopicColumns) -> tuple[Event, ...]:
    event = columns.fields
    rows = zip(columns.log_time_ns.tolist(), event["function"], event["msg"], strict=True)
    return tuple(Event(time_ns=time_ns, kind=kind, text=text) for time_ns, kind, text in rows)


def _unless_nan(head: Head, name: str, values: Column) -> Values | None:
    return None if name in head.nan_columns else values.astype(np.float64, copy=False)


def _reconcile(contents: Contents) -> tuple[Contents, str]:
    """Return contents with consistent rows, and a clause on the changes; empty without changes."""
    tables, clause = reconcile_tables(contents.topics, contents.head.declaration)
    return replace(contents, topics=tables), clause


_ANY_SIZE: Final = 2**40  # bytes; the final size is unknown


class RecordingTail:
    """An open turtlelog recording that may still grow.

    Attributes:
        is_finished: Whether the end of the recording has been read.
    """

    def __init__(self, path: str | Path) -> None:
        """Open the recording.

        Raises:
            LogError: If the file cannot be read, or is not an MCAP file.
        """
        self.is_finished = False
        self._path, self._place = Path(path), len(MCAP0_MAGIC)
        self._catalogue, self._records = Catalogue(Allowance(_ANY_SIZE)), list[Any]()
        self._parts: dict[str, list[Rows]] = {}
        with ExitStack() as closing, name_file(path, expected="a turtlelog recording"):
            self._stream = closing.enter_context(open_file(self._path))
            check_start(self._stream)
            closing.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._stream.close()

    @property
    def is_live(self) -> bool:
        """Whether a program still writes to the recording; False if there are no file locks."""
        return is_live(self._path)

    def read_run(self) -> Run | None:
        """Return the run so far; None if nothing is new since the last call, or there is no pose.

        Raises:
            LogError: If the file is not a recording by turtlelog.
        """
        with name_file(self._path, expected="a turtlelog recording"):
            has_grown = False
            for section, place in walk_growing(self._stream, self._place):
                self._place = place
                has_grown |= section is not None and self._take(section)
            return self._build() if has_grown and topics.POSE.name in self._parts else None

    def read_last_run(self) -> Run:
        """Return the run so far, even if it is incomplete.

        Raises:
            LogError: If the file is not a recording by turtlelog, or contains no pose.
        """
        self.read_run()
        with name_file(self._path, expected="a turtlelog recording"):
            return self._build()

    def _build(self) -> Run:
        # `build_contents` empties its parts, which are needed again here.
        parts = {topic: [dict(rows) for rows in found] for topic, found in self._parts.items()}
        contents = build_contents(self._records, self._catalogue, parts, ())
        return build_run(_reconcile(contents)[0])

    def _take(self, section: Section) -> bool:
        """Add a section, and return whether it contains new data for a run."""
        if section.opcode == Opcode.DATA_END:
            self.is_finished = True
            return False
        block = build_walked_block(self._catalogue, section)
        self._records += block.rest
        piece = read_piece(self._catalogue, Selection(), block, block.offsets)
        for topic, rows in piece.rows.items():
            self._parts.setdefault(topic, []).append(rows)
        return True
