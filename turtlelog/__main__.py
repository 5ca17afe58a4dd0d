"""`turtlelog` and `python -m turtlelog`: a process for one command."""

import atexit
import gc
import os
from typing import Final

_MOST_NEW_OBJECTS: Final = 100_000
"""Number of new objects after which Python searches for cycles, which commands rarely create. The
modules of a command are 60,000 objects: with 10,000, the search takes 17 ms of `metrics`. With
Python's default of 700, it takes a quarter of the time for a file with 65,000 channels."""


def main() -> None:
    """Run the command in `sys.argv` and exit."""
    gc.set_threshold(_MOST_NEW_OBJECTS)
    # At its end, Python would search all modules for cycles, which takes 20 ms.
    atexit.register(gc.freeze)
    # The matrices of commands have a few rows: more threads of numpy only wait, for 25 ms at start.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from turtlelog.cli.app import main as run

    run()


if __name__ == "__main__":
    main()
