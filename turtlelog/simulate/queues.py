"""The queue between controller and plant. A backlog in it is dead time for as long as it lasts."""

from collections import deque

from turtlelog.simulate.law_driver import Sample


class CommandQueue:
    """Commands on their way to the plant: in transport, then in a queue that keeps the newest.

    Attributes:
        dropped: Commands that the full queue has pushed out so far.
    """

    __slots__ = ("_delay_ticks", "_newest_only", "_queue", "_transport", "dropped")

    def __init__(self, *, depth: int, newest_only: bool, delay_ticks: int) -> None:
        """Keep `depth` commands; with `newest_only` a take empties the queue."""
        self._queue: deque[Sample] = deque(maxlen=depth)
        self._transport: deque[tuple[int, Sample]] = deque()
        self._newest_only = newest_only
        self._delay_ticks = delay_ticks
        self.dropped = 0

    def put(self, tick: int, command: Sample) -> None:
        """Publish a command at the end of a tick."""
        if self._delay_ticks:
            self._transport.append((tick + self._delay_ticks, command))
        else:
            self._append(command)

    def take(self, tick: int) -> Sample | None:
        """Return the command that a step begins with, None where none has arrived."""
        while self._transport and self._transport[0][0] < tick:
            self._append(self._transport.popleft()[1])
        if not self._queue:
            return None
        if not self._newest_only:
            return self._queue.popleft()
        newest = self._queue.pop()
        self._queue.clear()
        return newest

    def _append(self, command: Sample) -> None:
        full = len(self._queue) == self._queue.maxlen
        self.dropped += full and not self._newest_only
        self._queue.append(command)
