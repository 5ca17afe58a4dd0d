"""Files of this stage are complete or not there, and fail with its own error."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from turtlelog.errors import LogError, ShowError
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
