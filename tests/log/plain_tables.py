"""Tables of poses for tests."""

from pathlib import Path
from typing import Any

ROWS = [(0.0, 1.0, 2.0, 0.5), (0.1, 1.5, 2.5, 0.75), (0.2, 2.0, 3.0, 1.0)]


def write(path: Path, header: str, *rows: Any, suffix: str = "csv", sign: str = ",") -> Path:
    lines = [row if isinstance(row, str) else sign.join(map(str, row)) for row in rows]
    file = path / f"drive.{suffix}"
    file.write_text("\n".join([header, *lines]) + "\n", encoding="utf-8")
    return file
