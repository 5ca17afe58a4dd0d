"""Unfinished or damaged file -> complete file with whatever it still holds."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import BinaryIO

from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from turtlelog.display import count
from turtlelog.errors import LogError
from turtlelog.escapes import escape_controls
from turtlelog.log.complete_files import replace_when_complete
from turtlelog.log.engine.limits import DESCRIPTIONS, RECORDS, Allowance
from turtlelog.log.engine.parsing import take_apart
from turtlelog.log.engine.summary import FileSummary, salvage_summary
from turtlelog.log.engine.walk import Loss, Section, walk_sections
from turtlelog.log.error_boundary import name_file, open_file
from turtlelog.log.recording.losses import RECOVERY, format_recovery
from turtlelog.log.rewriting import Numbering, Rewriter


@dataclass(frozen=True, slots=True, kw_only=True)
class RecoveryReport:
    """What was recovered, and what was not.

    Attributes:
        file: The source, as given.
        complete: Whether the source was finished and undamaged, so that nothing is lost.
        recovered: Messages by topic.
        unchecked: Those of them that no checksum vouches for, by topic; a bit of them may have
            changed unnoticed.
        missing: Messages by topic that the source's summary counts and that did not come; empty
            too where it is lost, but the checksum of all data holds; None where nothing tells.
        from_s: Log time of the earliest message recovered [s].
        to_s: Of the latest [s].
        lost: In the order of the file.
    """

    file: str
    complete: bool
    recovered: Mapping[str, int]
    unchecked: Mapping[str, int]
    missing: Mapping[str, int] | None
    from_s: float
    to_s: float
    lost: tuple[Loss, ...]

    def __repr__(self) -> str:
        found = count(sum(self.recovered.values()), "message")
        lost = f"{len(self.lost)} stretch{'es' * (len(self.lost) != 1)}"
        return escape_controls(f"<RecoveryReport {self.file}: {found}, {lost} lost>")


def recover_recording(source: str | Path, target: str | Path) -> RecoveryReport:
    """Write what an unfinished or damaged MCAP file still holds, anybody's, as a complete one.

    Profile, schemas, channels, metadata, attachments and messages are kept, in the order of the
    file. Damaged chunks are left out as a whole, and so are messages whose channel is described
    nowhere. What was lost is noted in a metadata record `turtlelog_recovery`.

    Args:
        source: The file, or the folder of a bag with one .mcap file: a bag that was never closed
            has no `metadata.yaml`.
        target: The file to write.

    Raises:
        LogError: Where the source cannot be read, or holds no message that can be recovered;
            where the target is the source, or cannot be written.
    """
    source, target = _find_file(Path(source)), Path(target)
    with name_file(source, expected="an MCAP file"), open_file(source) as stream:
        if target.exists() and source.samefile(target):
            raise LogError(f"expected another file to write to, found the same: {target}")
        summary = salvage_summary(stream)
    with replace_when_complete(target) as temporary, temporary.open("wb") as output:
        known = ((), ()) if summary is None else (summary.schemas, summary.channels)
        copied = _copy_records(source, output, *known, is_sound=summary is not None)
        if copied.is_described_late:
            # Behind its messages, by a later chunk: now it is known from the start.
            output.seek(0)
            output.truncate()
            first = copied.rewriter.numbering
            known = (tuple(first.first_schemas.values()), tuple(first.first_channels.values()))
            copied = _copy_records(source, output, *known, is_sound=summary is not None)
        report = _build_report(str(source), copied, summary)
        note = format_recovery(report.lost, report.missing, report.unchecked)
        copied.rewriter.finish({} if report.complete else {RECOVERY: note})
    return report


def _find_file(source: Path) -> Path:
    """Return the file to read: of a folder the only one in it."""
    with name_file(source, expected="an MCAP file"):
        files = sorted(source.glob("*.mcap")) if source.is_dir() else [source]
        if len(files) != 1:
            names = ", ".join(file.name for file in files) or "none"
            raise LogError(f"expected an MCAP file or a folder with one, found {names}")
    return files[0]


@dataclass(slots=True, kw_only=True)
class _Copied:
    """What came of a pass over the source.

    Attributes:
        rewriter: What took the records.
        lost: What could not be read.
        is_vouched: Whether the checksum of the whole data section holds.
        mismatch: Where it does not; its place is that of the checksum.
        summary: Where the summary is not sound; its place.
    """

    rewriter: Rewriter
    lost: list[Loss] = field(default_factory=list)
    is_vouched: bool = False
    mismatch: Loss | None = None
    summary: Loss | None = None

    def lose(self, loss: Loss) -> None:
        """Note a loss; what follows on one of the same reason is part of it."""
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
    source: Path,
    output: BinaryIO,
    schemas: tuple[Schema, ...],
    channels: tuple[Channel, ...],
    *,
    is_sound: bool,
) -> _Copied:
    """Copy what can be read; `is_sound` says whether the source has a sound summary."""
    allowance = Allowance(source.stat().st_size)
    rewriter = Rewriter(output, Numbering(schemas, channels, allowance), allowance)
    copied, is_at_end = _Copied(rewriter=rewriter), False
    for found in _walk(source):
        if isinstance(found, Loss):
            if is_at_end:  # all that is told there is that the checksum of the data fails
                copied.mismatch = found
            else:
                copied.lose(found)
            continue
        is_checked, place = found.is_checked, found.start
        for reason in _take_section(rewriter, found, allowance):
            copied.lose(Loss(start=place, end=place, reason=reason))
        if not found.is_chunk and found.data[0] == Opcode.DATA_END:
            is_at_end, copied.is_vouched = True, is_checked
            if not is_sound:
                start, reason = place + len(found.data), "expected a sound summary, found none"
                copied.summary = Loss(start=start, end=source.stat().st_size, reason=reason)
    return copied


def _take_section(rewriter: Rewriter, section: Section, allowance: Allowance) -> list[str]:
    left = allowance.count_left(RECORDS)
    stretch = take_apart(section.data, is_chunk=section.is_chunk, most_records=left)
    allowance.spend(RECORDS, stretch.records)
    try:
        allowance.spend(DESCRIPTIONS, len(stretch.others))
    except LogError as err:
        return [str(err)]
    return rewriter.take_stretch(stretch, section.start, is_checked=section.is_checked)


def _walk(path: Path) -> Iterator[Section | Loss]:
    # Errors of writing what comes are not this file's.
    with name_file(path, expected="an MCAP file"), open_file(path) as stream:
        yield from walk_sections(stream)


def _build_report(file: str, copied: _Copied, summary: FileSummary | None) -> RecoveryReport:
    rewriter, span_ns = copied.rewriter, copied.rewriter.span_ns
    lost = [*copied.lost, *(_describe_unknown(rewriter, number) for number in rewriter.unknown)]
    missing = _count_missing(copied, summary, is_whole=not lost)
    if span_ns is None:
        raise _describe_nothing(file, rewriter, lost)
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


def _describe_nothing(file: str, rewriter: Rewriter, lost: Sequence[Loss]) -> LogError:
    if rewriter.unknown:
        found = f", found {rewriter.unknown.total()} of channels that nothing describes"
    else:
        found = f", found: {lost[0].reason}" if lost else ", found none"
    return LogError(f"{file}: expected messages to recover{found}")


def _describe_unknown(rewriter: Rewriter, number: int) -> Loss:
    place, count = rewriter.first_unknown[number], rewriter.unknown[number]
    reason = f"expected a description of channel {number}, found only its messages: {count}"
    return Loss(start=place, end=place, reason=reason)
