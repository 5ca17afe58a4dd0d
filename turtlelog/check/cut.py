"""Where a run ends, and a stretch of it as a run of its own."""

import enum
from typing import Final

from turtlelog.run import Run

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
