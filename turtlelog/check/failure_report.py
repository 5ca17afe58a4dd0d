"""What to look at when a check fails: a Rerun view of the violation, its picture, the stretch."""

import re
from contextlib import ExitStack
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING, Final

from turtlelog.check.cut import cut_run
from turtlelog.check.failure_message import describe_failure
from turtlelog.check.result import CheckResult
from turtlelog.errors import CheckError, ShowError
from turtlelog.log import write_recording
from turtlelog.run import Run

if TYPE_CHECKING:
    from turtlelog.show.rerun.snapshot import Camera

_AROUND_S: Final = 1.0
_LONGEST: Final = 60
_SIZE: Final = (1400, 900)


@dataclass(frozen=True, slots=True, kw_only=True)
class Artifacts:
    """What was written.

    Attributes:
        files: .rrd, .png where a picture could be made, and .mcap.
        notes: What could not be, and why.
    """

    files: tuple[Path, ...]
    notes: tuple[str, ...] = ()


class ArtifactWriter:
    """Writes what there is to look at of many failures; one viewer takes all pictures.

    The viewer is started for the first picture and ended by `close`, or at the end of a `with`.

    Args:
        folder: Made where it is not there.
    """

    def __init__(self, folder: str | Path) -> None:
        self._folder = Path(folder)
        self._viewer = ExitStack()
        self._camera: Camera | None = None
        self._has_seen = False
        self._lack = ""

    def __enter__(self) -> "ArtifactWriter":
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()

    def close(self) -> None:
        """End the viewer."""
        self._camera = None
        self._viewer.close()

    def write(self, run: Run, result: CheckResult, *, prefix: str = "") -> Artifacts:
        """Write the files of one failure, as `write_artifacts` does."""
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
        except OSError as err:
            found = f"found: {err.strerror}"
            raise CheckError(f"{self._folder}: expected a folder to write to, {found}") from err
        from turtlelog.show import write_violation_rrd

        base = self._folder / name_files(result, prefix)
        rrd, png, mcap = (base.with_name(base.name + end) for end in (".rrd", ".png", ".mcap"))
        at_s = result.first_violation_s
        shown_s = (run.end_ns - run.start_ns) / 1e9 if at_s is None else at_s
        message = "\n".join(describe_failure(run, result))
        title = shorten(result.check, _LONGEST, placeholder="...")
        write_violation_rrd(run, rrd, at_s=shown_s, title=title, message=message)
        write_recording(_cut(run, at_s), mcap)
        if self._lack:
            return Artifacts(files=(rrd, mcap), notes=(f"{png}: no picture: {self._lack}",))
        try:
            self._open_camera().take(rrd, png, at_s=shown_s)
        except ShowError as err:
            self._lack = "" if self._has_seen else str(err)  # as now, so for the next failure
            self.close()
            return Artifacts(files=(rrd, mcap), notes=(f"{png}: no picture: {err}",))
        self._has_seen = True
        return Artifacts(files=(rrd, png, mcap))

    def _open_camera(self) -> "Camera":
        from turtlelog.show.rerun.snapshot import open_camera

        if self._camera is None:
            self._camera = self._viewer.enter_context(open_camera(size=_SIZE))
        return self._camera


def write_artifacts(
    run: Run, result: CheckResult, folder: str | Path, *, prefix: str = ""
) -> Artifacts:
    """Write a .rrd that opens at the violation, its picture, and the recording around it.

    Where a violation belongs to no moment they show the end of the run, and the recording is whole.

    Args:
        run: That failed.
        result: What came of the check.
        folder: Made where it is not there.
        prefix: Id of the test that failed; the end of it stands in front of the files' names.

    Raises:
        CheckError: Where the folder cannot be made.
        LogError: Where the recording cannot be written.
        ShowError: Where the view cannot be written.
    """
    with ArtifactWriter(folder) as writer:
        return writer.write(run, result, prefix=prefix)


def _cut(run: Run, at_s: float | None) -> Run:
    """Return what was recorded a second before and after the violation."""
    if at_s is None:
        return run
    start_ns = run.start_ns + round((at_s - _AROUND_S) * 1e9)
    cut = cut_run(run, start_ns=start_ns, end_ns=start_ns + round(2 * _AROUND_S * 1e9))
    return replace(cut, scenario_is_complete=False, stop_reason=None)


def name_files(result: CheckResult, prefix: str) -> str:
    """Return a name that every file system takes, one of its own for every file and check."""
    stem, test = Path(result.file).stem, prefix.rpartition("::")[2]
    words = [test, "" if f"[{stem}]" in test else stem, result.check]
    plain = re.sub(r"[^A-Za-z0-9._]+", "-", "-".join(filter(None, words))).strip("-.")
    key = sha256("\0".join([prefix, result.file, result.check]).encode()).hexdigest()[:6]
    return f"{plain[:_LONGEST]}-{key}"
