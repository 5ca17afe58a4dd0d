"""Messages that follow each other -> where they start, many at a time.

Topics take turns, so the lengths of messages repeat. A turn is taken from the messages before, and
all that it foretells is held against the bytes; where it fails, steps are made one by one again.
"""

from typing import Final

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from turtlelog.log.engine.framing import LARGEST_RECORD, LEAST_MESSAGE, RECORD

_MESSAGE: Final = int(Opcode.MESSAGE)
_HEAD: Final = np.dtype([("opcode", "u1"), ("length", "<u8")])

_LONGEST_TURN: Final = 64  # messages; robots have some 20 topics, not all of one rate
_FIRST: Final = 16  # steps before a turn is looked for; a robot's chunk holds some thousand
_RAREST: Final = 2**12  # steps between looks where there is none: a look takes as long as 100
_WORTH: Final = 128  # messages foretold; a look that finds fewer has not paid
_MOST: Final = 2**14  # messages foretold at a time


class MessageWalk:
    """Foretells where messages start from the steps that were made before.

    Attributes:
        is_due: Whether it is time to try.
    """

    def __init__(self, data: bytes) -> None:
        self.is_due = False
        self._size = len(data)
        count = max(self._size - RECORD.size + 1, 0)
        self._heads = np.ndarray((count,), f"V{RECORD.size}", buffer=data, strides=(1,))
        self._steps: list[int] = []
        self._wait, self._turn, self._reach = _FIRST, 0, 2 * _WORTH

    def add(self, step: int) -> None:
        """Note the bytes from one message to the next."""
        self._steps.append(step)
        self.is_due = len(self._steps) >= self._wait

    def go_on(self, place: int, most: int) -> tuple[NDArray[np.uint32], int]:
        """Return where whole messages start from `place` on, up to so many, and what comes next."""
        length = self._turn or _find_turn(self._steps)
        turn = np.array(self._steps[len(self._steps) - length :], np.int64)
        found = [np.array([place], np.int64)]
        count = 0
        while len(turn) and count < most:
            reach = min(self._reach - self._reach % len(turn), most - count)  # whole turns
            places = self._foretell(int(found[-1][-1]), turn, reach)
            found.append(places[1:])
            count += len(places) - 1
            if len(places) <= reach:
                break
            self._reach = min(2 * self._reach, _MOST)
        self._plan(count, len(turn))
        places = np.concatenate(found)
        return places[:-1].astype(np.uint32), int(places[-1])

    def _foretell(self, place: int, turn: NDArray[np.int64], most: int) -> NDArray[np.int64]:
        ends = np.cumsum(turn)
        firsts = place + ends[-1] * np.arange(-(-most // len(turn)))
        places = np.empty(most + 1, np.int64)
        places[0], places[1:] = place, (firsts[:, None] + ends).ravel()[:most]
        places = places[: places.searchsorted(self._size, side="right")]
        heads = self._heads[places[:-1]].view(_HEAD)
        lengths = np.diff(places) - RECORD.size
        fits = (heads["length"] == lengths.view(np.uint64)) & (heads["opcode"] == _MESSAGE)
        return places if fits.all() else places[: int(fits.argmin()) + 1]

    def _plan(self, count: int, turn: int) -> None:
        """Say when to try again."""
        if count >= _WORTH:
            # The step that was not foretold comes before those of the next turn.
            self._turn, self._wait = turn, turn + 1
            self._reach = min(max(count + 2 * turn, 2 * _WORTH), _MOST)
        else:
            self._turn, self._wait = 0, min(2 * max(self._wait, _FIRST), _RAREST)
        self._steps.clear()
        self.is_due = False


def _find_turn(steps: list[int]) -> int:
    """Return after how many steps they last repeated; 0 where they did not."""
    for turn in range(1, min(len(steps) // 2, _LONGEST_TURN) + 1):
        if steps[-turn:] == steps[-2 * turn : -turn]:
            return turn
    return 0


def skip_followed(data: bytes) -> int:
    """Return where the last message starts of those that follow each other from the first byte on.

    That one may be cut; 0 where there is none.
    """
    place, last, walk = 0, 0, MessageWalk(data)
    end, unpack = len(data) - RECORD.size, RECORD.unpack_from
    while place <= end:
        opcode, length = unpack(data, place)
        if opcode != _MESSAGE or not LEAST_MESSAGE <= length <= LARGEST_RECORD:
            break
        last = place
        place += RECORD.size + length
        walk.add(RECORD.size + length)
        if walk.is_due:
            starts, place = walk.go_on(place, end)
            if len(starts):
                last = int(starts[-1])
    return last
