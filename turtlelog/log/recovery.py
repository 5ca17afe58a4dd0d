"""Unfinished or damaged file -> complete file with whatever it still holds."""

import json
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

from mcap.opcode import Opcode

from turtlelog.errors import LogError
from turtlelog.log.atomic import replace_when_complete
from turtlelog.log.border import name_file
from turtlelog.log.engine.ending import read_ending
from turtlelog.log.engine.walk import Damage, Section, walk_sections
from turtlelog.log.rewriting import Descriptions, Rewriter
from turtlelog.log.single_records import iterate_records

RECOVERY: Final = "turtlelog_recovery"
"""Name of the metadata record that tells a recovered file from one that was always whole."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Loss:
    """A stretch of a file that could not be recovered.

    Attributes:
        start: First byte in the file.
        end: Byte after the last one; where it equals `start`, something is missing there.
        reason: One clause: what was expected, what was found.
    """

    start: int
    end: int
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class RecoveryReport:
    """What was recovered, and what was not.

    Attributes:
        file: The source, as given.
        complete: Whether the source was finished and undamaged, so that nothing is lost.
        recovered: Messages by topic.
        unchecked: Those of them that no checksum vouches for, by topic; a bit of them may have
            changed unnoticed.
        missing: Messages by topic that the source's summary counts and that did not come; None
            where it counts none, or is lost itself.
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


def recover_recording(source: str | Path, target: str | Path) -> RecoveryReport:
    """Write what an unfinished or damaged MCAP file still holds, anybody's, as a complete one.

    Profile, schemas, channels, metadata, attachments and messages are kept, in the order of the
    file. Damaged chunks are left out as a whole, and so are messages whose channel is described
    nowhere. What was lost is noted in a metadata record `turtlelog_recovery`.

    Raises:
        LogError: Where the source cannot be read, or holds no message that can be recovered;
            where the target is the source, or cannot be written.
    """
    source, target = Path(source), Path(target)
    survey = _survey_file(source, target)
    with replace_when_complete(target) as temporary, temporary.open("wb") as output:
        rewriter = Rewriter(output, survey.described, has_notes=bool(survey.lost))
        for section, opcode, body in _iterate_records(source, []):
            with suppress(LogError):  # told by the survey
                is_checked = section.is_checked or survey.is_vouched
                rewriter.take_record(opcode, body, section.start, is_checked=is_checked)
        report = _build_report(str(source), survey, rewriter)
        rewriter.finish({} if report.complete else {RECOVERY: _format_notes(report)})
    return report


@dataclass(slots=True, kw_only=True)
class _Survey:
    """What a first pass over the source found.

    Attributes:
        described: Schemas, channels and the rest that must be known before messages are written.
        counts: Messages by channel as the summary counts them, if it does.
        lost: What could not be read.
        is_vouched: Whether the checksum of the whole data section holds.
    """

    described: Descriptions
    counts: Mapping[int, int] | None
    lost: list[Loss]
    is_vouched: bool = False


def _survey_file(source: Path, target: Path) -> _Survey:
    with name_file(source, expected="an MCAP file"), source.open("rb") as stream:
        if target.exists() and source.samefile(target):
            raise LogError(f"expected another file to write to, found the same: {target}")
        ending, size = read_ending(stream), stream.seek(0, 2)
    survey = _Survey(described=Descriptions(), counts=ending.counts, lost=[])
    for section, opcode, body in _iterate_records(source, survey.lost):
        try:
            survey.described.take_record(opcode, body)
        except LogError as err:
            survey.lost.append(Loss(start=section.start, end=section.start, reason=str(err)))
        if opcode == Opcode.DATA_END and not section.is_chunk:
            survey.is_vouched = section.is_checked
            if not ending.is_sound:
                reason = "expected a sound summary, found none"
                survey.lost.append(Loss(start=section.start + 13, end=size, reason=reason))
    survey.described.take_ending(ending)
    if not survey.described.opcodes[Opcode.MESSAGE]:
        reason = f", found: {survey.lost[0].reason}" if survey.lost else ", found none"
        raise LogError(f"{source}: expected messages to recover{reason}")
    return survey


def _iterate_records(path: Path, lost: list[Loss]) -> Iterator[tuple[Section, int, bytes]]:
    """Yield every record of the data section with where it stands; what is damaged joins `lost`."""
    with name_file(path, expected="an MCAP file"), path.open("rb") as stream:
        for found in walk_sections(stream):
            if isinstance(found, Damage):
                lost.append(Loss(start=found.start, end=found.end, reason=found.reason))
                continue
            try:
                for opcode, body in iterate_records(found.data):
                    yield found, opcode, body
            except LogError as err:
                lost.append(Loss(start=found.start, end=found.start, reason=str(err)))


def _build_report(file: str, survey: _Survey, rewriter: Rewriter) -> RecoveryReport:
    if rewriter.span_ns is None:
        raise LogError(
            f"{file}: expected messages to recover, found {rewriter.unknown.total()} of channels"
            " that nothing describes"
        )
    missing = _count_missing(survey, rewriter)
    lost = [*survey.lost, *(_describe_unknown(rewriter, number) for number in rewriter.unknown)]
    return RecoveryReport(
        file=file,
        complete=not lost and not missing,
        recovered=dict(sorted(rewriter.recovered.items())),
        unchecked=dict(sorted(rewriter.unchecked.items())),
        missing=missing,
        from_s=rewriter.span_ns[0] / 1e9,
        to_s=rewriter.span_ns[1] / 1e9,
        lost=tuple(sorted(lost, key=lambda loss: loss.start)),
    )


def _count_missing(survey: _Survey, rewriter: Rewriter) -> dict[str, int] | None:
    if survey.counts is None:
        return None
    channels, expected = survey.described.channels, Counter[str]()
    for number, count in survey.counts.items():
        known = channels.get(number)
        expected[f"channel {number}" if known is None else known.topic] += count
    return dict(sorted((expected - rewriter.recovered).items()))


def _describe_unknown(rewriter: Rewriter, number: int) -> Loss:
    place, count = rewriter.first_unknown[number], rewriter.unknown[number]
    reason = f"expected a description of channel {number}, found only its messages: {count}"
    return Loss(start=place, end=place, reason=reason)


def _format_notes(report: RecoveryReport) -> dict[str, str]:
    return {
        "lost": json.dumps([asdict(loss) for loss in report.lost]),
        "missing": json.dumps(report.missing),
        "unchecked": json.dumps(report.unchecked),
    }
