"""Recovery of unfinished or damaged files and bags."""

from collections import Counter
from collections.abc import Generator, Iterable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Final

from mcap.opcode import Opcode
from mcap.records import Channel, Header, Schema

from turtlelog.display import describe_count, fit_line
from turtlelog.errors import LogError
from turtlelog.files.urls import RemotePath, make_path
from turtlelog.log.engine.limits import DAMAGES, DESCRIPTIONS, RECORDS, Allowance
from turtlelog.log.engine.opening import Damaged, open_damaged, open_place
from turtlelog.log.engine.records import take_apart
from turtlelog.log.engine.source import FileSummary, salvage_summary
from turtlelog.log.engine.sqlite_file import describe_sqlite_error, measure_pages
from turtlelog.log.engine.sqlite_source import (
    FIRST_ROW,
    Row,
    SqliteRows,
    SqliteSource,
    build_query,
    find_next_row,
    read_row,
)
from turtlelog.log.engine.walk import Section, walk_sections
from turtlelog.log.file_access import Loss, create_folder, name_file, replace_when_complete
from turtlelog.log.file_info import METADATA_FILE, describe_bag
from turtlelog.log.mcap_writer import LIBRARY, join_records
from turtlelog.log.recording.head import RECOVERY, SUMMARY_LOST, format_recovery
from turtlelog.log.rewriting import Numbering, Rewriter
from turtlelog.log.ros2.bag_files import list_present_files, read_compression

if TYPE_CHECKING:
    import sqlite3


@dataclass(frozen=True, slots=True, kw_only=True)
class RecoveryReport:
    """Recovered and lost parts of a recording.

    Attributes:
        file: Source, as given.
        complete: Whether the source was complete and undamaged, so that nothing is lost.
        recovered: Number of recovered messages by topic.
        unchecked: Number of recovered messages without a checksum, by topic. Such messages may be
            corrupted unnoticed.
        missing: Number of lost messages by topic, according to the source's summary. Empty also if
            the summary is lost but the checksum of all data is correct; None if unknown.
        from_s: Log time of the earliest message recovered [s].
        to_s: Log time of the latest message recovered [s].
        lost: Losses in the order of the file.
        lost_summary_alone: Whether the only loss is the summary, which counts the messages.
    """

    file: str
    complete: bool
    recovered: Mapping[str, int]
    unchecked: Mapping[str, int]
    missing: Mapping[str, int] | None
    from_s: float
    to_s: float
    lost: tuple[Loss, ...]
    lost_summary_alone: bool = False

    def __repr__(self) -> str:
        found = describe_count(sum(self.recovered.values()), "message")
        lost = describe_count(len(self.lost), "part")
        return fit_line(f"<RecoveryReport {self.file}: {found}, {lost} lost>")


def recover_recording(source: str | Path, target: str | Path) -> RecoveryReport:
    """Write the readable contents of an unfinished or damaged MCAP or SQLite file as a new file.

    Profile, schemas, channels, metadata, attachments and messages are kept, in the order of the
    file. Damaged chunks are omitted as a whole. Messages of unknown channels are omitted too. The
    metadata record `turtlelog_recovery` lists the losses.

    Args:
        source: The file, or the folder of a bag, perhaps without `metadata.yaml`.
        target: The MCAP file to write. If the source is a folder, a name that does not end in .mcap
            is a new folder for a bag of all files.

    Raises:
        LogError: If the source cannot be read or has no recoverable message, or if the target is
            the source or cannot be written.
    """
    source, target = make_path(source), make_path(target)
    if source.is_dir() and target.suffix.lower() != ".mcap":
        return _recover_bag(source, target)
    return _recover_file(_find_file(source), target)


def _recover_bag(source: Path, target: Path) -> RecoveryReport:
    files, absent = list_present_files(source)
    reports: list[tuple[Path, RecoveryReport]] = []
    lost = [Loss(start=0, end=0, reason=f"{name} is missing") for name in absent]
    errors: list[LogError] = []
    with create_folder(target) as folder:
        for file in files:
            name = f"{target.name}_{len(reports)}.mcap"
            try:
                reports.append((folder / name, _recover_file(file, folder / name)))
            except LogError as err:
                size = file.stat().st_size
                errors.append(err)
                lost.append(Loss(start=0, end=size, reason=str(err)))
            else:
                report = reports[-1][1]
                lost += [replace(one, reason=f"{file.name}: {one.reason}") for one in report.lost]
        if not reports:
            raise errors[0]
        text = describe_bag([place for place, _ in reports], read_compression(source))
        (folder / METADATA_FILE).write_text(text, encoding="utf-8", newline="\n")
    found = [report for _, report in reports]
    is_known = not errors and not absent and all(report.missing is not None for report in found)
    return RecoveryReport(
        file=str(source),
        complete=not errors and not absent and all(report.complete for report in found),
        recovered=_sum_counts(report.recovered for report in found),
        unchecked=_sum_counts(report.unchecked for report in found),
        missing=_sum_counts(report.missing or {} for report in found) if is_known else None,
        from_s=min(report.from_s for report in found),
        to_s=max(report.to_s for report in found),
        lost=tuple(lost),
    )


def _sum_counts(counts: Iterable[Mapping[str, int]]) -> dict[str, int]:
    total = Counter[str]()
    for found in counts:
        total.update(found)
    return dict(sorted(total.items()))


def _recover_file(source: Path, target: Path) -> RecoveryReport:
    with ExitStack() as closing:
        with name_file(source, expected="an MCAP file"):
            found = closing.enter_context(open_damaged(source))
            if not isinstance(target, RemotePath) and target.exists() and source.samefile(target):
                raise LogError(f"expected another file to write to, found the same: {target}")
            summary, size = None, found.place.stat().st_size
            if found.bag is None:
                with open_place(found) as stream:
                    summary = salvage_summary(stream)
        with replace_when_complete(target) as temporary, temporary.open("wb") as output:
            copied = _copy(source, found, output, summary)
            if found.fault is not None:
                copied.lose(Loss(start=size, end=size, reason=found.fault))
            report = _build_report(str(source), copied, summary)
            if found.fault is not None:  # the summary counts what was unpacked
                report = replace(report, missing=None)
            if found.bag is not None:
                # A bag has no message counts, but a tree of pages without a gap is complete.
                report = replace(report, missing={} if report.complete else None)
            note = format_recovery(report.lost, report.missing, report.unchecked)
            copied.rewriter.finish({} if report.complete else {RECOVERY: note})
    return report


def _copy(source: Path, found: Damaged, output: BinaryIO, summary: FileSummary | None) -> "_Copied":
    schemas: Iterable[Schema] = summary.schemas if summary else ()
    channels: Iterable[Channel] = summary.channels if summary else ()
    if found.bag is not None:
        catalogue = found.bag.catalogue
        schemas, channels = catalogue.schemas.values(), catalogue.channels.values()
    copied = _copy_records(_walk(source, found), found.stored_size, output, schemas, channels)
    if copied.is_described_late:
        # A schema or channel came later than its messages: the copy starts again with those known.
        output.seek(0)
        output.truncate()
        first = copied.rewriter.numbering
        schemas, channels = first.first_schemas.values(), first.first_channels.values()
        copied = _copy_records(_walk(source, found), found.stored_size, output, schemas, channels)
    if copied.data_end is not None and summary is None:
        size = found.place.stat().st_size
        copied.summary = Loss(start=copied.data_end, end=size, reason=SUMMARY_LOST)
    return copied


def _find_file(source: Path) -> Path:
    files = list_present_files(source)[0] if source.is_dir() else (source,)
    if len(files) != 1:
        names = ", ".join(file.name for file in files)
        raise LogError(
            f"{source}: expected a folder with one file to make one .mcap file of it, found"
            f" {names[:200]}: name a new folder instead"
        )
    return files[0]


@dataclass(slots=True, kw_only=True)
class _Copied:
    """Result of a pass over the source.

    Attributes:
        rewriter: Writer of the records.
        lost: Segments that could not be read.
        data_end: Offset after the end of the data; None if the end is missing.
        is_vouched: Whether the checksum of the whole data section is correct.
        mismatch: Offset of the checksum if it is wrong.
        summary: Offset of the summary if it is damaged.
    """

    rewriter: Rewriter
    lost: list[Loss] = field(default_factory=list)
    data_end: int | None = None
    is_vouched: bool = False
    mismatch: Loss | None = None
    summary: Loss | None = None

    def lose(self, loss: Loss) -> None:
        """Note a loss, or merge it into the previous loss that it continues for the same reason."""
        last = self.lost[-1] if self.lost else None
        is_place = loss.start == loss.end
        if last and last.reason == loss.reason and (is_place or last.end == loss.start):
            self.lost[-1] = replace(last, end=loss.end)
        else:
            self.lost.append(loss)

    @property
    def is_described_late(self) -> bool:
        numbering = self.rewriter.numbering
        unknown = self.rewriter.unknown.keys()
        return numbering.has_late_schemas or not unknown.isdisjoint(numbering.channels)


def _copy_records(
    walk: Iterator[Section | Loss],
    stored_size: int,
    output: BinaryIO,
    schemas: Iterable[Schema],
    channels: Iterable[Channel],
) -> _Copied:
    """Copy the sections of a walk over a file; `schemas` and `channels` are known beforehand."""
    allowance = Allowance(stored_size)
    rewriter = Rewriter(output, Numbering(schemas, channels, allowance), allowance)
    copied = _Copied(rewriter=rewriter)
    for found in walk:
        if isinstance(found, Loss):
            # After the end of the data, the walk only reports that their checksum is wrong.
            if copied.data_end is None:
                copied.lose(found)
            else:
                copied.mismatch = found
            continue
        left, place = allowance.count_left(RECORDS), found.start
        stretch = take_apart(found.data, is_chunk=found.is_chunk, most_records=left)
        allowance.spend(RECORDS, stretch.records)
        try:
            allowance.spend(DESCRIPTIONS, len(stretch.others))
        except LogError as err:
            faults = [str(err)]
        else:
            faults = rewriter.take_stretch(stretch, place, is_checked=found.is_checked)
        for reason in faults:
            copied.lose(Loss(start=place, end=place, reason=reason))
        if found.opcode == Opcode.DATA_END:
            copied.data_end, copied.is_vouched = place + len(found.data), found.is_checked
    return copied


def _walk(source: Path, found: Damaged) -> Iterator[Section | Loss]:
    # Errors of writing the new file do not concern this file.
    if found.bag is None:
        with name_file(source, expected="an MCAP file"), open_place(found) as stream:
            yield from walk_sections(stream)
        return
    header = join_records([Header(profile="ros2", library=LIBRARY)])
    yield Section(data=header, start=0, is_chunk=False, is_checked=False)
    with name_file(source, expected="a bag in SQLite"):
        size, claimed, _ = measure_pages(found.place)
        yield from _group_rows(found.bag, size)
        if size < claimed:
            reason = f"expected a file of {claimed} bytes, found its end: cut short"
            yield Loss(start=size, end=claimed, reason=reason)


def _build_report(file: str, copied: _Copied, summary: FileSummary | None) -> RecoveryReport:
    rewriter, span_ns = copied.rewriter, copied.rewriter.span_ns
    lost = [*copied.lost]
    for number, count in rewriter.unknown.items():
        place = rewriter.first_unknown[number]
        reason = f"expected a description of channel {number}, found only its messages: {count}"
        lost.append(Loss(start=place, end=place, reason=reason))
    missing = _count_missing(copied, summary, is_whole=not lost)
    if span_ns is None:
        why = lost[0].reason if lost else "it has none"
        if rewriter.unknown:
            why = f"nothing describes the channels of its {rewriter.unknown.total()} messages"
        raise LogError(f"{file}: no message can be recovered: {why}")
    for loss in (copied.mismatch, copied.summary):
        if loss is not None:
            is_harmless = not lost and missing == {}
            text = f"{loss.reason}: no message is missing" if is_harmless else loss.reason
            lost.append(replace(loss, reason=text))
    return RecoveryReport(
        file=file,
        complete=not lost and not missing,
        recovered=dict(sorted(rewriter.recovered.items())),
        unchecked={} if copied.is_vouched else dict(sorted(rewriter.unchecked.items())),
        missing=missing,
        from_s=span_ns[0] / 1e9,
        to_s=span_ns[1] / 1e9,
        lost=tuple(sorted(lost, key=lambda loss: loss.start)),
        lost_summary_alone=missing is None and lost == [copied.summary],
    )


def _count_missing(
    copied: _Copied, summary: FileSummary | None, *, is_whole: bool
) -> dict[str, int] | None:
    if summary is None or summary.statistics is None:
        return {} if is_whole and copied.is_vouched else None
    channels, expected = copied.rewriter.numbering.first_channels, Counter[str]()
    for number, count in summary.statistics.channel_message_counts.items():
        known = channels.get(number)
        expected[f"channel {number}" if known is None else known.topic] += count
    return dict(sorted((expected - copied.rewriter.recovered).items()))


_BATCH: Final = 4096  # rows
_BATCH_BYTES: Final = 2**22
_MOST_NAMED: Final = 10_000  # invalid rows that are listed with their reasons

_BEFORE: Final = FIRST_ROW - 1
"""Row number before the first row. The smallest number itself may belong to a row."""


def _group_rows(source: SqliteSource, size: int) -> Iterator[Section | Loss]:
    """Yield the readable rows of a damaged bag in sections of some thousand rows, and the losses.

    With a page of a table its rows are lost. The rows after it are found by searching the smallest
    row number that SQLite can read again.
    """
    rows = SqliteRows()

    def join() -> Section:
        data = source.build_block(rows, 1).data
        return Section(data=data, start=0, is_chunk=True, is_checked=False)

    for found in _judge_rows(source):
        if isinstance(found, str):
            yield Loss(start=0, end=size, reason=found)
            continue
        rows.take([found])
        if len(rows.times) == _BATCH or rows.size > _BATCH_BYTES:
            yield join()
            rows = SqliteRows()
    if rows.times:
        yield join()


def _judge_rows(source: SqliteSource) -> Iterator[Row | str]:
    """Yield the rows that are messages; for other rows and for gaps, yield the reason."""
    faults, left = 0, source.size
    for found in _walk_rows(source):
        if isinstance(found, str):
            yield found
            continue
        number, *values = found
        left -= sum(len(value) for value in values if isinstance(value, str | bytes))
        if left < 0:
            yield "expected messages of the size of the file"
            break
        fault = source.judge_row(*values)
        faults += fault is not None
        if fault is None:
            yield tuple(values)
        elif faults <= _MOST_NAMED:
            yield f"messages: row {number}: {fault}"
    if faults > _MOST_NAMED:
        yield f"messages: {faults - _MOST_NAMED} rows more that are no messages"


def _walk_rows(source: SqliteSource) -> Iterator[Row | str]:
    """Yield the rows that SQLite can read, with their numbers; for gaps, yield the reason."""
    last: int | None = _BEFORE
    while last is not None:
        last, error = yield from _walk_sound(source, last)
        if error is None:
            return
        try:
            source.catalogue.allowance.spend(DAMAGES)
        except LogError as err:
            yield str(err)
            return
        # The cursor reads one row ahead: the row that it would return next may be valid.
        row = read_row(source, last)
        if row:
            yield row
            last = int(row[0])
        elif row is None:
            after = find_next_row(source, last)
            since = "the first row" if last == _BEFORE else f"row {last + 1}"
            until = "the last" if after is None else f"row {after - 1}"
            yield f"messages from {since} to {until}: {describe_sqlite_error(error)}"
            last = None if after is None else after - 1
        else:
            yield f"messages behind row {last}: {describe_sqlite_error(error)}"
            return


def _walk_sound(
    source: SqliteSource, last: int
) -> "Generator[Row, None, tuple[int, sqlite3.Error | None]]":
    """Yield rows after `last` up to an error; return the last row's number and the error."""
    import sqlite3

    try:
        for row in source.execute(build_query(source), last + 1):
            if row[0] <= last:
                return last, sqlite3.DatabaseError("rows out of order")
            last = row[0]
            yield row
    except sqlite3.Error as err:
        return last, err
    return last, None
