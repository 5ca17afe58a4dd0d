"""Where a run ends, and a stretch of it as a run of its own."""

import enum
from dataclasses import fields, replace
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from turtlelog.run import CommandColumns, PoseColumns, Run, SampleColumns

Columns = TypeVar("Columns", PoseColumns, CommandColumns, SampleColumns)

_LOSSES: Final = ("partial", "recovered")
"""Notes that say what a recording has lost."""

_NO_LOSS: Final = (
    "no data is lost, only the summary is damaged",
    "from a damaged or unfinished file: no message is lost",
)
"""How the notes begin of files of which nothing is lost but the summary; what follows a semicolon
is another loss."""


class RunEnding(enum.Enum):
    """What is known of the time after the last row; the value says why it is unknown."""

    SETTLED = ""
    """The run came to its own end, or the phase to its: the last values hold for ever."""
    CUT = "the run had not ended"
    """It reached `max_duration`, was interrupted, or does not say why it ended."""
    LOST = "part of it is lost"
    """Rows may be missing, at the end too."""
    UNDECLARED = "it does not say whether the robot had stopped"
    """A bag of another recorder: windows without an end stop at its last row."""


def find_ending(run: Run) -> RunEnding:
    """Return what is known of the time after a run's last row."""
    notes = [run.notes[name] for name in _LOSSES if name in run.notes]
    if not all(note.startswith(_NO_LOSS) and ";" not in note for note in notes):
        return RunEnding.LOST
    if run.is_complete:
        return RunEnding.SETTLED
    # A log of a controller could say that it had finished; a bag of other topics could not.
    could_tell = len(run.samples) or "stop_reason" not in run.absent
    return RunEnding.CUT if could_tell else RunEnding.UNDECLARED


def find_loss(run: Run) -> str | None:
    """Return what a recording has lost, None where it is whole."""
    for name in _LOSSES:
        if name in run.notes:
            return f"expected a whole recording, found one that is not: {run.notes[name]}"
    return None


def cut_run(run: Run, *, start_ns: int | None = None, end_ns: int | None = None) -> Run:
    """Return the rows of a run in [start_ns, end_ns]; at least one pose stays.

    Samples whose pose is cut off are cut off with it, and the stop reason with the run's end. Times
    stay as they are.
    """
    start_ns = run.poses.time_ns[0] if start_ns is None else start_ns
    end_ns = run.end_ns if end_ns is None else end_ns
    first = int(np.searchsorted(run.poses.time_ns, start_ns, side="left"))
    after = int(np.searchsorted(run.poses.time_ns, end_ns, side="right"))
    first = min(first, len(run.poses) - 1)
    after = max(after, first + 1)
    read = run.samples.pose_sequence
    kept = _select(run.samples.time_ns, start_ns, end_ns) & (read >= first) & (read < after)
    samples = _take(run.samples, kept)
    return replace(
        run,
        stop_reason=run.stop_reason if end_ns >= run.end_ns else None,
        poses=_take(run.poses, slice(first, after)),
        commands=_take(run.commands, _select(run.commands.time_ns, start_ns, end_ns)),
        samples=replace(samples, pose_sequence=samples.pose_sequence - first),
        events=tuple(event for event in run.events if start_ns <= event.time_ns <= end_ns),
    )


def _select(time_ns: NDArray[np.int64], start_ns: int, end_ns: int) -> NDArray[np.bool_]:
    return np.asarray((time_ns >= start_ns) & (time_ns <= end_ns))


def _take(columns: Columns, rows: slice | NDArray[np.bool_]) -> Columns:
    taken = {
        field.name: values[rows]
        for field in fields(columns)
        if (values := getattr(columns, field.name)) is not None
    }
    return replace(columns, **taken)
