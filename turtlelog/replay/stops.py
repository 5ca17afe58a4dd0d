"""Why a run ended, recorded and replayed."""

from typing import Final

from turtlelog.laws import Decision
from turtlelog.replay.difference import Difference
from turtlelog.run import Run

_SIGNAL: Final = "stop"

_CUT: Final = (None, "interrupted")
"""Stop reasons of runs that somebody or something else ended."""

_SOMEHOW: Final = "finished"
"""Stop reason of a log that says that its controller came to an end, and not why."""

_TIME_IS_UP: Final = "max_duration"


def is_cut(run: Run) -> bool:
    """Whether a run might have gone on, had the recording not ended."""
    return run.stop_reason in _CUT


def compare_last_decision(run: Run, row: int, last: Decision) -> Difference | None:
    """Return how the end by a law's decision on sample `row` differs from the recorded end."""
    time_ns = int(run.samples.time_ns[row])
    if row < len(run.samples) - 1:
        return _build(time_ns, None, last.stop_reason)
    if last.blocks_ticks and run.stop_reason == _TIME_IS_UP:
        return None  # the time was up before it could stop
    found = _TIME_IS_UP if last.stop_reason is None else last.stop_reason
    return None if _agrees(run, found) else _build(time_ns, run.stop_reason, last.stop_reason)


def compare_ends(run: Run, stop_reason: str | None) -> Difference | None:
    """Return how the end of a replay, for this reason, differs from the recorded end."""
    return None if _agrees(run, stop_reason) else _build(run.end_ns, run.stop_reason, stop_reason)


def _agrees(run: Run, stop_reason: str | None) -> bool:
    if run.stop_reason == _SOMEHOW:
        return stop_reason != _TIME_IS_UP
    return is_cut(run) or run.stop_reason == stop_reason


def _build(time_ns: int, recorded: str | None, replayed: str | None) -> Difference:
    return Difference(signal=_SIGNAL, time_ns=time_ns, recorded=recorded, replayed=replayed)
