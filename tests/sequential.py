"""The sequential law in numbers and names: its phases as samples hold them, its metrics."""

from typing import Final

import turtlelog as tl
from turtlelog.laws.sequential_p import DECLARATION

__all__ = ["DECLARATION", "DONE", "ESSENTIAL_METRICS", "METRICS", "PAUSE", "ROTATE", "TRANSLATE"]

ROTATE, PAUSE, TRANSLATE, DONE = range(len(DECLARATION.phase_names))

METRICS: Final = tl.measure.list_metrics(DECLARATION)
ESSENTIAL_METRICS: Final = tl.measure.list_essential_metrics(DECLARATION)
