"""Files of this stage are complete or not there, and fail with its own error."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from turtlelog.errors import LogError, ShowError
from turtlelog.files.urls import make_path
from turtlelog.log import replace_when_complete


@contextmanager
def replace_file(path: str | Path) -> Iterator[Path]:
    """Yield a temporary name beside `path`, which takes its place when the block ends well.

    Raises:
        ShowError: Where the place cannot be written.
    """
    try:
        with replace_when_complete(path) as part_path:
            yield part_path
    except LogError as err:
        raise ShowError(str(err)) from err


@contextmanager
def replace_together(folder: str | Path) -> Iterator[Callable[[str, bytes], Path]]:
    """Yield what writes files into a folder, by name; all take their places at the end together.

    Where the block fails nothing is left: no file, and no folder that was not there.

    Raises:
        ShowError: Where the place cannot be written.
    """
    folder = make_path(folder)
    with ExitStack() as undoing:
        try:
            for new in [place for place in (folder, *folder.parents) if not place.exists()][::-1]:
                new.mkdir(exist_ok=True)
                undoing.callback(_remove_folder, new)
            folder.mkdir(exist_ok=True)
        except OSError as err:
            raise ShowError(
                f"{folder}: expected a folder to write to, found: {err.strerror or err}"
            ) from err
        with ExitStack() as parts:

            def write(name: str, data: bytes) -> Path:
                parts.enter_context(replace_file(folder / name)).write_bytes(data)
                return folder / name

            yield write
        undoing.pop_all()


def _remove_folder(folder: Path) -> None:
    with suppress(OSError):  # somebody else writes there, too
        folder.rmdir()
