"""By which clock the poses of a run are timed."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, slots=True, kw_only=True)
class Clock:
    """The clock that times the poses of a bag, and how it stands to the recorder's.

    Attributes:
        used: `stamp`: when the robot measured each pose, mapped to the recorder's clock; `log`:
            when the recorder received it.
        ratio: Seconds of the stamps per second of the recorder; None where poses have no stamps.
        offset_s: The recorder's time less the stamp of the first pose, by the message that was
            transported fastest [s]; None likewise.
        jitter_s: By how much the transport of a pose usually differs from the fastest [s]; None
            likewise.
    """

    used: Literal["log", "stamp"]
    ratio: float | None = None
    offset_s: float | None = None
    jitter_s: float | None = None
