"""Report of a failed check: text, Rerun view, picture, and the segment of the recording."""

import math
import re
import textwrap
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from hashlib import sha256
from itertools import zip_longest
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING, Final

import numpy as np

from turtlelog.check.result import CheckResult
from turtlelog.display import format_number, show_angle
from turtlelog.errors import CheckError, LibraryError, ShowError
from turtlelog.escapes import escape_controls
from turtlelog.files.urls import make_path
from turtlelog.log import write_recording
from turtlelog.measure import find_signal, list_signals
from turtlelog.run import Run, slice_run

if TYPE_CHECKING:
    from turtlelog.draw.rerun.snapshot import Camera


_WIDTH = 92
_MOST = 3


def describe_failure(run: Run, *results: CheckResult) -> list[str]:
    """Return lines: value, limit, margin, first violation with values around it, gains, scenario.

    Only the first violated results of the run are shown in full.
    """
    lines = [*describe_results(run, *results), *_list_scenario(run, results[0])]
    return [escape_controls(line) for line in lines]


def describe_results(run: Run, *results: CheckResult) -> list[str]:
    """Return the lines of `describe_failure` without recording, gains and scenario."""
    ordered = sorted(results, key=_read_first)
    lines: list[str] = []
    for result in ordered[:_MOST]:
        lines += [*_list_figures(result), *_list_violation(run, result)]
    if len(ordered) > _MOST:
        others = ", ".join(result.check for result in ordered[_MOST:])
        lines += textwrap.wrap(f"and {len(ordered) - _MOST} more: {others}", _WIDTH)
    return [escape_controls(line) for line in lines]


def _read_first(result: CheckResult) -> tuple[bool, float]:
    """Return a sort key that places the explained result first, then the first violated."""
    first_s = result.first_violation_s
    return not result.why, math.inf if first_s is None else first_s


def _list_figures(result: CheckResult) -> Iterator[str]:
    name = "" if result.check == result.expected else f"{result.check}: "
    yield f"{name}expected {result.expected}" if result.expected else result.check
    if result.decided_by:
        yield f"  decided by      {result.decided_by}"
    if result.value is not None:
        at = "" if result.value_s is None else f" at {result.value_s:.3f} s"
        yield f"  value           {format_number(result.value, result.unit)}{at}"
    if result.limit is not None:
        yield f"  limit           {format_number(result.limit, result.unit)}"
    if result.margin is not None:
        yield f"  margin          {format_number(result.margin, result.unit)}"
    if result.reason:
        yield f"  reason          {result.reason}"
    for head, text in zip(["why", *([""] * len(result.why))], result.why, strict=False):
        lines = textwrap.wrap(text, _WIDTH - 18, break_on_hyphens=False, break_long_words=False)
        yield from (
            f"  {name:<16}{line}" for name, line in zip_longest([head], lines, fillvalue="")
        )


def _list_violation(run: Run, result: CheckResult) -> Iterator[str]:
    at_s = result.first_violation_s
    if not result.is_decided:
        return
    if at_s is None:
        yield f"  first violated  no single moment ({describe_clock(run)})"
        return
    yield f"  first violated  {at_s:.3f} s ({describe_clock(run)})"
    for line in tabulate_surroundings(run, result.names, at_s):
        yield f"    {line}"


def _list_scenario(run: Run, result: CheckResult) -> Iterator[str]:
    yield f"  recording       {result.file}"
    parameters = run.parameters
    keys = dict.fromkeys(loop.gain for loop in run.declaration.loops if loop.gain is not None)
    gains = [f"{name} = {parameters[name]}" for name in keys if name in parameters]
    gains = gains or [f"{n} = {v}" for n, v in parameters.items() if n.startswith("law.")]
    if gains or not run.is_lawless:
        yield f"  gains           {', '.join(gains) or 'not recorded'}"
    others = [f"{n} = {v}" for n, v in parameters.items() if n not in (*keys, "name")]
    if run.is_lawless and not others:
        yield f"  source          {run.source}"
        return
    text = ", ".join([run.name, *others]) if others else f"{run.name}, nothing else recorded"
    wrapped = textwrap.wrap(text, _WIDTH - 18, break_on_hyphens=False, break_long_words=False)
    yield f"  scenario        {wrapped[0]}"
    yield from (f"                  {line}" for line in wrapped[1:])


_ROWS: Final = 2


def describe_clock(run: Run) -> str:
    """Return the meaning of a run's times."""
    is_simulated = run.source == "simulation" or run.source.startswith("replay of ")
    clock = "simulated time" if is_simulated else "the recording's clock"
    return f"{clock}, from the first {run.first_row}"


def tabulate_surroundings(run: Run, names: Sequence[str], at_s: float) -> list[str]:
    """Return lines: the signals at the poses around a time; `>` marks the pose at that time.

    A command published between two poses has a line of its own. Without poses, lines are commands.
    """
    rows = run.poses if len(run.poses) else run.commands
    time_ns, at_ns = rows.time_ns, run.start_ns + round(at_s * 1e9)
    row = max(int(np.searchsorted(time_ns, at_ns, side="right")) - 1, 0)
    times_ns = time_ns[max(row - _ROWS, 0) : row + _ROWS + 1].tolist()
    kinds = list_signals(run.declaration)
    held = _choose_held(run, [name for name in names if name in kinds])
    marked_ns = int(time_ns[row])
    if at_ns != marked_ns and any(_is_published(run, name, at_ns) for name in held):
        times_ns, marked_ns = sorted({*times_ns, at_ns}), at_ns
    columns = [["", *(">" if found == marked_ns else "" for found in times_ns)]]
    columns.append(["t [s]", *(f"{(found - run.start_ns) / 1e9:.3f}" for found in times_ns)])
    for name in held:
        unit = kinds[name].unit
        title = name if unit == "1" else f"{name} [{show_angle(0.0, unit)[1]}]"
        cells = [_read_value(run, name, found) for found in times_ns]
        if set(cells) != {"-"}:
            columns.append([title, *cells])
    widths = [max(map(len, column)) for column in columns]
    return [
        "  ".join(f"{cell:>{width}}" for cell, width in zip(cells, widths, strict=True)).rstrip()
        for cells in zip(*columns, strict=True)
    ]


def _is_published(run: Run, name: str, time_ns: int) -> bool:
    """Return whether a signal belongs to commands, and a command was published exactly then."""
    signal = find_signal(run, name)
    return signal is not None and signal.kind.source == "command" and time_ns in signal.time_ns


def _choose_held(run: Run, names: Sequence[str]) -> list[str]:
    """Return the named signals that a run contains; if one is missing, also x and y."""
    held = [name for name in names if find_signal(run, name) is not None]
    return held if held == [*names] and held else ["x", "y", *(n for n in held if n not in "xy")]


def _read_value(run: Run, name: str, time_ns: int) -> str:
    signal = find_signal(run, name)
    if signal is None:
        return "-"
    row = int(np.searchsorted(signal.time_ns, time_ns, side="right")) - 1
    if row < 0:
        return "-"
    value = float(signal.values[row])
    if signal.kind.compared_as == "label":
        return run.phase_names[int(value)]
    return format_number(show_angle(value, signal.kind.unit)[0])


_AROUND_S: Final = 1.0
_LONGEST: Final = 60
_SIZE: Final = (1400, 900)


@dataclass(frozen=True, slots=True, kw_only=True)
class Artifacts:
    """Files that were written, and notes on files that could not be written, with reasons."""

    files: tuple[Path, ...]
    notes: tuple[str, ...] = ()


class ArtifactWriter:
    """Writer of files for the analysis of failures; one viewer makes all pictures.

    The viewer is started for the first picture and ended by `close`, or at the end of a `with`.

    Args:
        folder: Folder of the files, which is created if necessary.
    """

    def __init__(self, folder: str | Path) -> None:
        self._folder = make_path(folder)
        self._viewer = ExitStack()
        self._camera: Camera | None = None
        self._has_seen = False
        self._lack = ""

    def __enter__(self) -> "ArtifactWriter":
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the viewer."""
        self._camera = None
        self._viewer.close()

    def write(self, run: Run, result: CheckResult, *, prefix: str = "") -> Artifacts:
        """Write a .rrd that opens at the violation, its picture, and the recording around it.

        If a violation has no time, the files show the end of the run, and the recording is
        complete. A run without poses has nothing to show, which is noted.

        Args:
            run: Run that failed.
            result: Result of the check.
            prefix: Id of the failed test; its end is the start of the files' names.

        Raises:
            CheckError: If the folder cannot be created.
            LogError: If the recording cannot be written.
            ShowError: If the view cannot be written.
        """
        if not len(run.poses):
            note = f"{result.file}: no artifacts of {result.check}: it holds commands without poses"
            return Artifacts(files=(), notes=(note,))
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
        except OSError as err:
            found = f"found: {err.strerror}"
            raise CheckError(f"{self._folder}: expected a folder to write to, {found}") from err
        base = self._folder / name_files(result, prefix)
        rrd, png, mcap = (base.with_name(base.name + end) for end in (".rrd", ".png", ".mcap"))
        at_s = result.first_violation_s
        shown_s = (run.end_ns - run.start_ns) / 1e9 if at_s is None else at_s
        write_recording(_cut(run, at_s), mcap)
        try:
            _write_view(run, result, rrd, at_s=shown_s)
        except LibraryError as err:
            return Artifacts(files=(mcap,), notes=(f"{rrd}: no view: {err}",))
        if self._lack:
            return Artifacts(files=(rrd, mcap), notes=(f"{png}: no picture: {self._lack}",))
        try:
            self._open_camera().take(rrd, png, at_s=shown_s)
        except ShowError as err:
            self._lack = "" if self._has_seen else str(err)  # the same for the next failure
            self.close()
            return Artifacts(files=(rrd, mcap), notes=(f"{png}: no picture: {err}",))
        self._has_seen = True
        return Artifacts(files=(rrd, png, mcap))

    def _open_camera(self) -> "Camera":
        from turtlelog.draw.rerun.snapshot import open_camera

        if self._camera is None:
            self._camera = self._viewer.enter_context(open_camera(size=_SIZE))
        return self._camera


def _write_view(run: Run, result: CheckResult, rrd: Path, *, at_s: float) -> None:
    from turtlelog.check.violation import find_violated_signal
    from turtlelog.draw import write_violation_rrd

    found = find_violated_signal(run, result)
    # The scenario has a tab of its own.
    lines = [*describe_results(run, result), escape_controls(f"  recording       {result.file}")]
    if found.signal is None:
        lines += textwrap.wrap(f"no band is drawn: {found.reason}", _WIDTH)
    title = shorten(result.check, _LONGEST, placeholder="...")
    message = "\n".join(lines)
    write_violation_rrd(run, rrd, at_s=at_s, title=title, message=message, violated=found.signal)


def _cut(run: Run, at_s: float | None) -> Run:
    """Return the segment from one second before to one second after the violation."""
    if at_s is None:
        return run
    start_ns = run.start_ns + round((at_s - _AROUND_S) * 1e9)
    cut = slice_run(run, start_ns=start_ns, end_ns=start_ns + round(2 * _AROUND_S * 1e9))
    return replace(cut, scenario_is_complete=False, stop_reason=None)


def name_files(result: CheckResult, prefix: str) -> str:
    """Return a valid name for every file system, unique for every file and check."""
    stem, test = Path(result.file).stem, prefix.rpartition("::")[2]
    words = [test, "" if f"[{stem}]" in test else stem, result.check]
    plain = re.sub(r"[^A-Za-z0-9._]+", "-", "-".join(filter(None, words))).strip("-.")
    key = sha256("\0".join([prefix, result.file, result.check]).encode()).hexdigest()[:6]
    return f"{plain[:_LONGEST]}-{key}"
