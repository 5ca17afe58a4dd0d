"""`turtlelog recover`: make a whole file of what a damaged one still holds."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli.options import File, Json, MaxDownload, Place
from turtlelog.cli.output import print_json, print_lines
from turtlelog.cli.progress import show_progress
from turtlelog.cli.targets import require_new_folder, require_new_target

if TYPE_CHECKING:
    from turtlelog.log import RecoveryReport

_MOST_LINES = 20


def recover(
    file: File,
    /,
    *,
    output: Annotated[Place, Parameter(name=("--output", "-o"))],
    json: Json = False,
    max_download: MaxDownload = None,  # noqa: ARG001 (it holds as soon as it is read)
) -> None:
    """Write what an unfinished or damaged recording still holds as a complete one.

    For recordings that were cut off (a crash, a full disk, a copy that broke off) or damaged, by
    turtlelog or by anybody else, in MCAP or SQLite. The file itself is not changed.

    Example: turtlelog recover cut.mcap -o whole.mcap

    Args:
        file: The file to read, .mcap or .db3, or the folder of a bag.
        output: Write the recovered recording to this .mcap file. Of a bag, another name is a new
            folder, for a bag of all its files.
        json: Print one JSON object instead of text.
        max_download: Longest file behind a URL that is fetched as a whole, which servers without
            ranges need, as in 500MB. Default: 4GiB.
    """
    if file.is_dir() and output.suffix.lower() != ".mcap":
        require_new_folder(output)
    else:
        require_new_target(output, [file], suffix=".mcap")
    with show_progress("recovering"):
        report = tl.recover_recording(file, output)
    if json:
        print_json({**asdict(report), "output": str(output)})
        return
    print_lines(_format(report, output))


def _format(report: "RecoveryReport", output: Path) -> list[str]:
    count = sum(report.recovered.values())
    span = f"from {report.from_s:.3f} s to {report.to_s:.3f} s"
    lines = [f"{output}: {count} messages {span}, from {report.file}"]
    width = max(map(len, report.recovered))
    lines += [f"  {topic:<{width}}  {found}" for topic, found in report.recovered.items()]
    if report.complete:
        return [*lines, "nothing was lost: the file is complete and undamaged"]
    if report.missing:
        lost = ", ".join(f"{count} of {topic}" for topic, count in report.missing.items())
        lines.append(f"messages lost: {sum(report.missing.values())} ({lost})")
    elif report.missing is None:
        lines.append("messages lost: not known, for the file has no sound summary that counts them")
    else:
        lines.append("messages lost: none")
    if report.unchecked:
        unchecked = sum(report.unchecked.values())
        lines.append(f"messages that no checksum vouches for: {unchecked}")
    lines += [
        f"lost: bytes {loss.start} to {loss.end}: {loss.reason}"
        for loss in report.lost[:_MOST_LINES]
    ]
    if len(report.lost) > _MOST_LINES:
        lines.append(f"lost: and {len(report.lost) - _MOST_LINES} more stretches (--json has all)")
    return lines
