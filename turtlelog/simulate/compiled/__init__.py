"""The loop compiled by numba, from the same sources as in Python."""

from threading import Event
from typing import Final

COMPILING: Final = Event()
"""Set during compilation, which takes seconds once, so that a progress bar can show this."""
