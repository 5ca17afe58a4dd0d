"""Tracebacks that end in the user's test: what turtlelog refuses is said by its one line."""

from pathlib import Path
from typing import Any

import pytest

from turtlelog.errors import TurtlelogError

_PACKAGE = Path(__file__).parents[1]


def end_at_test(info: pytest.ExceptionInfo[Any] | None) -> None:
    """Drop turtlelog's own frames from the traceback of an error that it raised on purpose."""
    if info is None or not isinstance(info.value, TurtlelogError):
        return
    outside = info.traceback.filter(lambda entry: not _is_own(entry.path))
    if outside:
        info.traceback = outside


def _is_own(path: Path | str) -> bool:
    return Path(path).is_relative_to(_PACKAGE)
