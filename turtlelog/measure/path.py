"""A path in the plane, read from a file and measured: points of shape (n, 2), joined by lines."""

import math
from io import StringIO
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import MeasureError
from turtlelog.files.text_files import describe_csv_error, read_text_file
from turtlelog.files.urls import make_path
from turtlelog.measure.reductions import measure_way
from turtlelog.run.paths import Path as TrackedPath, PathFollower

Values = NDArray[np.float64]

_BLOCKS: Final = (2048, 64)
"""Numbers of points that share a selection of path segments: of all segments, then of the remaining
ones."""

_PIECE: Final = 512

_BITS: Final = 12
"""Bits of each coordinate of the grid cells in which points are processed together."""


def compute_path_length(xy_m: Values) -> float:
    """Return the length of the line through all points [m]."""
    return measure_way(xy_m[:, 0], xy_m[:, 1], None)


def compute_straightness(xy_m: Values, length_m: float | None = None) -> float | None:
    """Return path length divided by the distance from first to last point [1]; 1 if straight.

    The result is None if both points are the same. `length_m` is the path length, if already known.
    """
    distance_m = float(np.hypot(*(xy_m[-1] - xy_m[0])))
    if distance_m <= 0.0:
        return None
    if length_m is None:
        length_m = compute_path_length(xy_m)
    # Rounding may make the sum slightly shorter than a straight line's distance.
    return max(length_m / distance_m, 1.0)


def compute_path_distances(xy_m: Values, path_xy_m: Values) -> Values:
    """Return each point's distance to the nearest point of a path [m], shape (n,).

    The path is the line through the points `path_xy_m`, shape (m, 2), m >= 2. Nearby points are
    processed in blocks. A block uses only the parts of the path that can be nearest, so long paths
    cost little more than short ones.
    """
    parts = np.hstack([path_xy_m[:-1], np.diff(path_xy_m, axis=0)])
    parts = np.unique(parts, axis=0)  # a robot at rest repeats them
    order = _sort_by_place(xy_m)
    distances = np.empty(len(xy_m))
    distances[order] = _measure_blocks(xy_m[order], parts[:, :2], parts[:, 2:], *_BLOCKS)
    return distances


def _measure_blocks(xy_m: Values, starts: Values, ways: Values, size: int, *sizes: int) -> Values:
    """Return the distances of points sorted by place, in nested blocks."""
    distances = np.empty(len(xy_m))
    for first in range(0, len(xy_m), size):
        rows = slice(first, first + size)
        near = _select_near(xy_m[rows], starts, ways)
        find = _measure_blocks if sizes else _find_nearest
        distances[rows] = find(xy_m[rows], *near, *sizes)
    return distances


def _sort_by_place(xy_m: Values) -> NDArray[np.int64]:
    """Return an order of points in which neighbours in the plane are close (Z-order)."""
    low_m = xy_m.min(axis=0, initial=np.inf)
    size_m = np.max(xy_m.max(axis=0, initial=-np.inf) - low_m, initial=0.0)
    if not (0.0 < size_m < np.inf):
        return np.arange(len(xy_m))
    cells = ((xy_m - low_m) / size_m * (2**_BITS - 1)).astype(np.int64)
    codes = np.zeros(len(cells), np.int64)
    for bit in range(_BITS):
        codes |= ((cells[:, 0] >> bit & 1) | (cells[:, 1] >> bit & 1) << 1) << 2 * bit
    return np.argsort(codes, kind="stable")


def _select_near(block: Values, starts: Values, ways: Values) -> tuple[Values, Values]:
    """Return the parts of the path that can be nearest to a point of the block."""
    centre = (block.min(axis=0) + block.max(axis=0)) / 2.0
    radius = np.hypot(*(block - centre).T).max()
    to_centre = _measure_parts(centre[None], starts, ways)[0]
    near = to_centre <= to_centre.min() + 2.0 * radius * (1.0 + 1e-9)
    return starts[near], ways[near]


def _find_nearest(block: Values, starts: Values, ways: Values) -> Values:
    pieces = range(_PIECE, len(starts), _PIECE)
    pairs = zip(np.split(starts, pieces), np.split(ways, pieces), strict=True)
    nearest = [_measure_parts(block, *pair).min(axis=1) for pair in pairs]
    return np.asarray(np.min(nearest, axis=0))


def _measure_parts(points: Values, starts: Values, ways: Values) -> Values:
    """Return the distances of points, shape (n, 2), to straight parts, shape (m, 2): (n, m)."""
    to_point = points[:, None] - starts[None]
    squares = (ways * ways).sum(axis=1)
    along = (to_point * ways[None]).sum(axis=2)
    share = np.clip(along / np.where(squares > 0.0, squares, 1.0), 0.0, 1.0)
    rest = to_point - share[..., None] * ways[None]
    return np.asarray(np.hypot(rest[..., 0], rest[..., 1]))


def trace_path(
    path: TrackedPath, xy_m: Values, arc_m: float | None, due_m: Values | None = None
) -> tuple[Values, Values]:
    """Return positions relative to a path, one after the other.

    Args:
        path: Path that is tracked.
        xy_m: Positions in the world frame [m], shape (n, 2).
        arc_m: Approximate arc length of the first position [m]; None if the robot has yet to reach
            the path.
        due_m: Arc length of the reference at each position, if the path has a time law [m], shape
            (n,).

    Returns:
        Arc length of the nearest point [m], and distance from there, positive to the left [m]; each
        of shape (n,).
    """
    follower = PathFollower(path, arc_m)
    dues_m = [None] * len(xy_m) if due_m is None else due_m.tolist()
    places = [
        follower.advance(x_m, y_m, due)
        for (x_m, y_m), due in zip(xy_m.tolist(), dues_m, strict=True)
    ]
    arcs_m, offsets_m = zip(*places, strict=True) if places else ((), ())
    return np.array(arcs_m, dtype=np.float64), np.array(offsets_m, dtype=np.float64)


_MOST_BYTES: Final = 2**24
"""Largest size of a path file [bytes]: half a million points, read in a second."""


def read_reference_path(path: str | Path) -> NDArray[np.float64]:
    """Return the points of a CSV file with x and y in metres, shape (n, 2); a header is skipped.

    Raises:
        MeasureError: If the file is wrong; one line with the file, the line, expected and found.
    """
    import csv  # few runs need it

    path = make_path(path)
    try:
        text = StringIO(read_text_file(path, most=_MOST_BYTES), newline="")
        rows = [(line, row) for line, row in enumerate(csv.reader(text), start=1) if row]
    except (OSError, UnicodeDecodeError, csv.Error) as err:
        reason = err.strerror if isinstance(err, OSError) else "no CSV text"
        reason = describe_csv_error(err) if isinstance(err, csv.Error) else reason
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
