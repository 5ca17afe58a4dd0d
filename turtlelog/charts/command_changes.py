"""Changes of a command from one level to another, to lay what follows them over each other."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.charts.curves import Curve

Values = NDArray[np.float64]

_LARGE: Final = 0.2
"""Share of the largest change from which a change counts: noise and resolution are smaller."""

_LEAST_HELD_S: Final = 0.15
"""Commands come at 10 Hz and more, with jitter: a longer pause is a level."""

_MOST: Final = 60
"""Changes that are drawn, the largest: more are a grey block."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandChange:
    """A change in one direction, at once or within several commands.

    Attributes:
        begin_s: When its first command comes [s].
        half_s: When the command passes the middle between its levels [s].
        end_s: When the next change begins, or the commands end [s].
        before: Level from which it changes.
        after: Level to which it changes.
    """

    begin_s: float
    half_s: float
    end_s: float
    before: float
    after: float

    def scale(self, values: Values) -> Values:
        """Return values as the part of the change that is done: 0 before it, 1 after it."""
        return (values - self.before) / (self.after - self.before)


def find_command_changes(command: Curve) -> list[CommandChange]:
    """Return the large changes of a command in the order of time.

    Commands that follow each other in one direction are one change; a level that is held for
    longer than the change itself, up to there, parts two.
    """
    values = np.concatenate([[0.0], command.values])
    rows = np.flatnonzero(np.diff(values) != 0.0)
    if not len(rows):
        return []
    signs, times_s = np.sign(np.diff(values)[rows]), command.time_s[rows]
    is_first = np.ones(len(rows), dtype=bool)
    first_s = times_s[0]
    for number in range(1, len(rows)):
        pause_s = times_s[number] - times_s[number - 1]
        is_held = pause_s > max(times_s[number - 1] - first_s, _LEAST_HELD_S)
        is_first[number] = signs[number] != signs[number - 1] or is_held
        first_s = times_s[number] if is_first[number] else first_s
    firsts = np.flatnonzero(is_first)
    lasts = np.append(firsts[1:], len(rows)) - 1
    ends_s = np.append(times_s[firsts[1:]], command.time_s[-1])
    found = []
    for first, last, end_s in zip(firsts, lasts, ends_s, strict=True):
        before, after = float(values[rows[first]]), float(values[rows[last] + 1])
        own = values[rows[first : last + 1] + 1]
        half = int(np.argmax((own - before) / (after - before) >= 0.5))
        change = CommandChange(
            begin_s=float(times_s[first]),
            half_s=float(times_s[first + half]),
            end_s=float(end_s),
            before=before,
            after=after,
        )
        found.append(change)
    sizes = np.array([abs(one.after - one.before) for one in found])
    kept = [
        row
        for row in np.argsort(-sizes, kind="stable")[:_MOST]
        if sizes[row] >= _LARGE * sizes.max()
    ]
    return [found[row] for row in sorted(kept)]
