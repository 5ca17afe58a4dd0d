"""Folders that are either complete or not there."""

import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from turtlelog.errors import LogError


@contextmanager
def create_folder(path: str | Path) -> Iterator[Path]:
    """Yield a temporary folder beside `path` to write into; it is renamed when the block ends well.

    A folder that is there is refused, as `ros2 bag` refuses it: what else it holds is not ours to
    remove. An empty one is taken.

    Raises:
        LogError: Where there is something, or the place cannot be written, in one line.
    """
    path = Path(path)
    is_empty = path.is_dir() and not any(path.iterdir())
    if (path.exists() or path.is_symlink()) and not is_empty:
        kind = "a folder with files" if path.is_dir() else "a file"
        raise LogError(f"{path}: expected the name of a new folder, found {kind}")
    # An absolute path has a name also where it was given as "." or "run/..".
    target = path.resolve()
    temporary = target.with_name(f".turtlelog-{secrets.token_hex(6)}.part")
    try:
        temporary.mkdir()
        yield temporary
        if is_empty:
            target.rmdir()
        temporary.rename(target)
    except OSError as err:
        raise LogError(
            f"{path}: expected a place that can be written, found: {err.strerror or err}"
        ) from err
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
