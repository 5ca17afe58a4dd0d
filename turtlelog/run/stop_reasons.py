"""The reasons why a run ended: their words, their numbers in a loop, and what they say of the run.

A law of the user's own may end a run with any other word.
"""

from collections.abc import Sequence
from typing import Final

WITHIN_TOLERANCE: Final = "within_tolerance"
STANDSTILL: Final = "standstill"
SETTLED: Final = "settled"
PATH_END: Final = "path_end"
END_OF_SIGNAL: Final = "end_of_signal"
TIMEOUT: Final = "timeout"
"""The law exceeded its time."""

MAX_DURATION: Final = "max_duration"
"""The scenario's `max_duration_s` had passed."""

LAW_FAILED: Final = "law_failed"
STEP_BUDGET: Final = "step_budget"
"""The law exceeded the time limit of one answer."""

INTERRUPTED: Final = "interrupted"
"""The run was ended from outside."""

FINISHED: Final = "finished"
"""The controller ended the run; its log does not say why."""

OF_LOOP: Final = (MAX_DURATION, LAW_FAILED, STEP_BUDGET)
"""Stop reasons that the loop sets; their numbers are -1, -2, -3. Those of its law are 1, 2, ..."""

CUT_SHORT = frozenset({*OF_LOOP, INTERRUPTED})
"""Stop reasons of runs that the controller did not end itself."""

FROM_OUTSIDE: Final = (None, INTERRUPTED)
"""Stop reasons of runs that might have continued if the recording had not ended."""

AT_REST: Final = frozenset({WITHIN_TOLERANCE, STANDSTILL, PATH_END})
"""Stop reasons of a run that came to rest, or to the end of its path, by itself."""

AT_GOAL: Final = frozenset({WITHIN_TOLERANCE, STANDSTILL, SETTLED})
"""Stop reasons of a run whose law considered itself at the goal."""

MAY_MISS: Final = AT_GOAL | {TIMEOUT, MAX_DURATION}
"""Stop reasons of built-in laws in runs that do not reach the goal; `within_tolerance` of a law
that reads late or wrong poses."""


def number_stop(reason: str) -> int:
    """Return the number of a stop reason that the loop sets, which is below 0."""
    return -1 - OF_LOOP.index(reason)


def name_stop(number: int, of_law: Sequence[str]) -> str:
    """Return the stop reason with a number; `of_law` are the stop reasons of the law in order."""
    return OF_LOOP[-1 - number] if number < 0 else of_law[number - 1]
