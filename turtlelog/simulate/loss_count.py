"""What is lost, counted by stretches: an event for each would fill a log."""


class LossCount:
    """Counts what is lost until something comes through again."""

    __slots__ = ("_count", "_finished", "_since_ns")

    def __init__(self) -> None:
        self._since_ns = self._count = 0
        self._finished: tuple[int, int] | None = None

    def add(self, time_ns: int) -> None:
        """Count one that is lost at a time [ns]."""
        self._since_ns = self._since_ns if self._count else time_ns
        self._count += 1

    def end_stretch(self) -> None:
        """Note that something came through."""
        if not self._count:
            return
        since_ns, count = self._finished or (self._since_ns, 0)
        self._finished = since_ns, count + self._count
        self._count = 0

    def take_finished(self) -> tuple[int, int] | None:
        """Return since when [ns] and how many were lost, once a stretch is over, else None."""
        finished, self._finished = self._finished, None
        return finished
