"""The phases of the sequential law by the number that samples hold, and what the law declares."""

from turtlelog.laws.sequential_p import DECLARATION

__all__ = ["DECLARATION", "DONE", "PAUSE", "ROTATE", "TRANSLATE"]

ROTATE, PAUSE, TRANSLATE, DONE = range(len(DECLARATION.phase_names))
