"""Whether a file is being recorded live: a lock that ends with the process, however that ends."""

import sys
from io import UnsupportedOperation
from pathlib import Path
from typing import BinaryIO

if sys.platform == "win32":
    # There nobody can replace a file that is open.
    def mark_live(stream: BinaryIO) -> None:
        """Do nothing."""

    def is_live(path: Path) -> bool:  # noqa: ARG001
        """Return False: the system itself refuses."""
        return False

else:
    import fcntl

    def mark_live(stream: BinaryIO) -> None:
        """Lock a file for as long as it is open, so that `is_live` tells; where it can be locked.

        The lock hinders no reader, and nobody who does not ask.
        """
        try:
            fcntl.flock(stream.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
        except (UnsupportedOperation, OSError):
            return  # no file, or a file system without locks

    def is_live(path: Path) -> bool:
        """Return whether somebody records to the file that has this name, if any."""
        try:
            with path.open("rb") as stream:
                fcntl.flock(stream.fileno(), fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        except OSError:
            return False
        return False
