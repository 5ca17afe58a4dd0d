"""What to look at when a check fails: a Rerun view of the violation, its picture, the stretch."""

import re
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Final

from turtlelog.check.cut import cut_run
from turtlelog.check.message import describe_failure
from turtlelog.check.result import CheckResult
from turtlelog.errors import CheckError, ShowError
from turtlelog.log import write_recording
from turtlelog.run import Run

_AROUND_S: Final = 1.0
_LONGEST: Final = 60


@dataclass(frozen=True, slots=True, kw_only=True)
class Artifacts:
    """What was written.

    Attributes:
        files: .rrd, .png where a picture could be made, and .mcap.
        notes: What could not be, and why.
    """

    files: tuple[Path, ...]
    notes: tuple[str, ...] = ()


def write_artifacts(
    run: Run, result: CheckResult, folder: str | Path, *, prefix: str = ""
) -> Artifacts:
    """Write a .rrd that opens at the violation, its picture, and the recording around it.

    Where a violation belongs to no moment they show the end of the run, and the recording is whole.

    Args:
        run: That failed.
        result: What came of the check.
        folder: Made where it is not there.
        prefix: In front of the names of the files: of the test that failed.

    Raises:
        CheckError: Where the folder cannot be made.
        LogError: Where the recording cannot be written.
        ShowError: Where the view cannot be written.
    """
    from turtlelog.show import write_snapshot, write_violation_rrd

    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as err:
        raise CheckError(f"{folder}: expected a folder to write to, found: {err.strerror}") from err
    base = folder / _name_files(result, prefix)
    rrd, png, mcap = (base.with_name(base.name + end) for end in (".rrd", ".png", ".mcap"))
    at_s = result.first_violation_s
    shown_s = (run.end_ns - run.start_ns) / 1e9 if at_s is None else at_s
    message = "\n".join(describe_failure(run, result))
    write_violation_rrd(run, rrd, at_s=shown_s, title=result.check, message=message)
    write_recording(_cut(run, at_s), mcap)
    try:
        write_snapshot(rrd, png, at_s=shown_s, size=(1400, 900))
    except ShowError as err:
        return Artifacts(files=(rrd, mcap), notes=(f"{png}: no picture: {err}",))
    return Artifacts(files=(rrd, png, mcap))


def _cut(run: Run, at_s: float | None) -> Run:
    """Return what was recorded a second before and after the violation."""
    if at_s is None:
        return run
    start_ns = run.start_ns + round((at_s - _AROUND_S) * 1e9)
    cut = cut_run(run, start_ns=start_ns, end_ns=start_ns + round(2 * _AROUND_S * 1e9))
    return replace(cut, scenario_is_complete=False, stop_reason=None)


def _name_files(result: CheckResult, prefix: str) -> str:
    """Return a name that every file system takes, one of its own for every file and check."""
    words = [prefix, Path(result.file).stem, result.check]
    plain = re.sub(r"[^A-Za-z0-9._-]+", "-", "-".join(filter(None, words))).strip("-.")
    key = sha256("\0".join([prefix, result.file, result.check]).encode()).hexdigest()[:6]
    return f"{plain[:_LONGEST]}-{key}"
