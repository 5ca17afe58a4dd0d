"""`turtlelog convert --recover`: make a whole file of what a damaged one still holds."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import turtlelog as tl
from turtlelog.cli.output import fill_lines, print_json, print_text
from turtlelog.cli.progress import show_progress
from turtlelog.cli.targets import require_new_folder, require_new_target
from turtlelog.display import describe_count
from turtlelog.errors import UsageError

if TYPE_CHECKING:
    from turtlelog.log import RecoveryReport

_MOST_LINES = 20


@dataclass(frozen=True, slots=True, kw_only=True)
class LostBytes:
    """Bytes that were lost.

    Attributes:
        start: The first.
        end: The first behind them.
        reason: Why.
    """

    start: int
    end: int
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class RecoverAnswer:
    """What was recovered of a damaged recording.

    Attributes:
        file: Name of the file as given.
        complete: Whether nothing was lost.
        recovered: Messages by topic.
        unchecked: Those of them that no checksum covers, by topic.
        missing: Lost messages by topic; None if nothing counts them.
        from_s: Log time of the first message [s].
        to_s: Log time of the last message [s].
        lost: Bytes that were lost.
        output: File that was written.
    """

    file: str
    complete: bool
    recovered: Mapping[str, int]
    unchecked: Mapping[str, int]
    missing: Mapping[str, int] | None
    from_s: float
    to_s: float
    lost: tuple[LostBytes, ...]
    output: str


def recover_file(file: Path, outputs: Sequence[Path], *, json: bool) -> None:
    """Write what a damaged or unfinished recording still holds as a complete one, and say so."""
    if len(outputs) != 1:
        raise UsageError(f"--recover writes one output, not {len(outputs)}")
    (output,) = outputs
    if file.is_dir() and output.suffix.lower() != ".mcap":
        require_new_folder(output)
    else:
        require_new_target(output, [file], suffix=".mcap")
    with show_progress("recovering"):
        report = tl.recover_recording(file, output)
    if json:
        told = {name: getattr(report, name) for name in _SAME}
        lost = tuple(
            LostBytes(start=one.start, end=one.end, reason=one.reason) for one in report.lost
        )
        print_json(RecoverAnswer(**told, lost=lost, output=str(output)))
        return
    print_text(fill_lines(_format(report, output), indent=2))


_SAME: Final = ("file", "complete", "recovered", "unchecked", "missing", "from_s", "to_s")
"""Fields of a report that the answer has as they are."""


def _format(report: "RecoveryReport", output: Path) -> list[str]:
    count = sum(report.recovered.values())
    span = f"from {report.from_s:.3f} s to {report.to_s:.3f} s"
    source = Path(report.file).name
    lines = [f"{output.name}: {count} messages {span}, from {source}; {_describe_loss(report)}"]
    width = max(map(len, report.recovered))
    lines += [f"  {topic:<{width}}  {found}" for topic, found in report.recovered.items()]
    if report.complete:
        return lines
    if report.missing:
        lost = ", ".join(f"{count} of {topic}" for topic, count in report.missing.items())
        lines.append(f"messages lost: {lost}")
    elif report.missing is None:
        lines.append("messages lost: not known, because the file has no summary that counts them")
    if report.unchecked:
        unchecked = sum(report.unchecked.values())
        lines.append(f"messages that no checksum covers: {unchecked}")
    lines += [
        f"lost: bytes {loss.start} to {loss.end}: {loss.reason}"
        for loss in report.lost[:_MOST_LINES]
    ]
    if len(report.lost) > _MOST_LINES:
        lines.append(f"lost: and {len(report.lost) - _MOST_LINES} more segments (--json has all)")
    return lines


def _describe_loss(report: "RecoveryReport") -> str:
    """Return how much was lost, in a clause."""
    if report.complete:
        return "nothing was lost: the file is complete and undamaged"
    if report.missing is None:
        count = sum(loss.end - loss.start for loss in report.lost)
        return f"an unknown number of messages is lost ({count} bytes)"
    lost = sum(report.missing.values())
    return (
        f"{describe_count(lost, 'message')} {'is' if lost == 1 else 'are'} lost"
        if lost
        else "no message is lost"
    )
