"""A reference path from a file."""

import csv
import math
from io import StringIO
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import MeasureError
from turtlelog.text_files import read_text_file

_MOST_BYTES: Final = 2**24
"""Half a million points, which take a second to read; a longer file is none of a path."""


def read_reference_path(path: str | Path) -> NDArray[np.float64]:
    """Return the points of a CSV file with x and y in metres, shape (n, 2); a head is skipped.

    Raises:
        MeasureError: One line with the file, the line, what was expected and what was found.
    """
    path = Path(path)
    try:
        text = StringIO(read_text_file(path, most=_MOST_BYTES), newline="")
        rows = [(line, row) for line, row in enumerate(csv.reader(text), start=1) if row]
    except (OSError, UnicodeDecodeError, csv.Error) as err:
        reason = err.strerror if isinstance(err, OSError) else "no CSV text"
        raise MeasureError(f"{path}: expected a file of points, found: {reason}") from err
    if rows and _parse(rows[0][1]) is None and any(map(str.isalpha, "".join(rows[0][1]))):
        rows = rows[1:]
    points = []
    for line, row in rows:
        point = _parse(row)
        if point is None:
            found = ",".join(row)[:60]
            raise MeasureError(f"{path}: line {line}: expected x,y in metres, found {found!r}")
        points.append(point)
    if len(points) < 2:
        raise MeasureError(f"{path}: expected two points or more, found {len(points)}")
    return np.array(points)


def _parse(row: list[str]) -> tuple[float, float] | None:
    try:
        x_m, y_m = map(float, row)
    except ValueError:
        return None
    return (x_m, y_m) if math.isfinite(x_m) and math.isfinite(y_m) else None
