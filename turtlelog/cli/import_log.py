"""`turtlelog import`: turn somebody's log into a recording."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli.options import Json, Output
from turtlelog.cli.output import print_json, print_lines
from turtlelog.cli.progress import show_progress
from turtlelog.cli.targets import require_new_target
from turtlelog.errors import UsageError


def import_(
    log: Path,
    /,
    *,
    output: Output = None,
    sort: Annotated[bool, Parameter(negative="")] = False,
    json: Json = False,
) -> None:
    """Import a log of the paper's controller (JSON or CSV) into an MCAP recording.

    Example: turtlelog import kp1_210.json -o kp1.mcap

    Args:
        log: The log to read.
        output: Where to write the recording; otherwise beside the log, with the suffix .mcap.
        sort: Sort rows by time and drop exact duplicates, and count both, instead of refusing them.
        json: Print one JSON object instead of a line.
    """
    if log.is_dir():
        raise UsageError(f"{log}: expected the name of a log, found a folder")
    path = log.with_suffix(".mcap") if output is None else output
    require_new_target(path, [log], suffix=".mcap")
    with show_progress("importing"):
        run = tl.import_log(log, sort=sort)
        tl.write_recording(run, path)
    if json:
        print_json(
            {
                "file": str(log),
                "output": str(path),
                "name": run.name,
                "samples": len(run.samples),
                "absent": list(run.absent),
                "notes": dict(run.notes),
            }
        )
        return
    lines = [f"{path}: {run.name}, {len(run.samples)} samples from {log}"]
    if run.absent:
        lines.append(f"absent in the source: {', '.join(run.absent)}")
    for name in ("sorted_rows", "dropped_duplicates"):
        if name in run.notes:
            lines.append(f"{name.replace('_', ' ')}: {run.notes[name]}")
    print_lines(lines)
