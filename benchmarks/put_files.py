"""A maker of one file of some content: what most hostile files are made with."""

from collections.abc import Callable
from pathlib import Path

Make = Callable[[Path], Path]
"""Puts a file, or a folder, into a folder that is given, and returns its path."""


def put_file(name: str, make: Callable[[], bytes | str]) -> Make:
    """Return what puts a file of a name."""

    def put(folder: Path) -> Path:
        content, path = make(), folder / name
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    return put
