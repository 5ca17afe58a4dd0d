"""References of a law's loops, reference paths, and the position of a run on its path or line.

The reference of a loop, at every pose:

| reference | of the signal heading | of the other signals |
|---|---|---|
| `goal_bearing` | direction of the line from start to goal | |
| `bearing_now` | bearing of the goal from the present position | |
| `goal_heading` | heading that the goal asks for | |
| `goal_distance` | | along-track: length of that line |
| `zero` | 0 | 0 |
| `path` | heading of the recorded pose | along-track: its arc length by time; cross-track: 0 |
| `recorded` | heading of the recorded pose | its projection on that line; distance: 0 |
"""

import math
import pathlib
from collections.abc import Callable
from io import StringIO
from typing import Any, Final, NamedTuple, TypeVar, cast
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import LogError, MeasureError
from turtlelog.files.text_files import describe_csv_error, read_text_file
from turtlelog.files.urls import make_path
from turtlelog.measure.loop_segment import (
    BEARING_NOW,
    HEADING,
    REFERENCES,
    Aim,
    aim_at,
    find_bearing,
    find_last_acting,
    find_latest,
    hold_column,
    project,
    read_constant,
)
from turtlelog.measure.reductions import Values, measure_way
from turtlelog.run import GoalLine, Run
from turtlelog.run.angles import wrap_angle
from turtlelog.run.loops import ControlLoop
from turtlelog.run.path_pieces import follow_pieces
from turtlelog.run.paths import Path

_Value = TypeVar("_Value")


def read_reference(run: Run, loop: ControlLoop) -> float | Values | None:
    """Return the reference of a loop [rad or m]; a number if it is constant.

    Otherwise the result has one value per pose, shape (n,); a sample's value is held until the next
    sample. The result is None if the run lacks the reference.
    """
    line, reference = run.goal_line, loop.reference
    if reference in {"path", "recorded"}:
        return _read_path(run, loop) if reference == "path" else _read_recorded(run, loop, line)
    if reference == "bearing_now":
        return _read_bearings(run)
    aim = aim_at(line, run.goal_xy_m, run.goal_heading_rad)
    wanted = read_constant(REFERENCES.index(reference), aim)
    return None if math.isnan(wanted) else wanted


def read_heading_reference(run: Run) -> float | Values | None:
    """Return the reference heading of the loop that acts, or acted last [rad].

    Before any loop acts, the result belongs to the first loop that acts; if no loop ever acts, to
    the first declared loop. The result is a number if the reference is constant, otherwise one
    value per pose. Without samples and loops, the result is the heading of the goal. Without a
    heading loop, it is None.
    """
    declared = [loop for loop in run.declaration.loops if loop.signal == "heading"]
    loops = [(loop, read_reference(run, loop)) for loop in declared]
    known = [(loop, found) for loop, found in loops if found is not None]
    if not known:
        # If the controller is unknown, only the goal gives the reference heading.
        return run.goal_heading_rad if run.is_lawless else None
    if len(known) == 1:
        return known[0][1]
    acting = _find_acting(run, tuple(loop for loop, _ in known))
    rows = len(run.poses)
    columns = np.array([np.broadcast_to(found, (rows,)) for _, found in known])
    return np.asarray(columns[acting, np.arange(rows)])


class LastPose(NamedTuple):
    """The last pose of a run, for its heading error.

    Attributes:
        x_m: Position in the world frame [m]; likewise `y_m`.
        heading_rad: Heading, in [-pi, pi) [rad].
        unwrapped_rad: Heading without jumps at full turns [rad].
        reference_rad: Reference heading that the law last recorded [rad]; NaN if none.
    """

    x_m: float
    y_m: float
    heading_rad: float
    unwrapped_rad: float
    reference_rad: float


def find_last_heading_error(phase: Any, loops: Any, aim: Aim, last: LastPose) -> float:
    """Return the reference heading minus the heading at the end of a run [rad]; NaN if unknown.

    The reference is that of the heading loop that acted last. It is the heading of the goal if no
    such loop is known, or if it aims at the goal from the present position: at the goal, this
    bearing is arbitrary.

    Args:
        phase: Phase of each sample.
        loops: Loops of the law in numbers.
        aim: Goal and line to it.
        last: Last pose.
    """
    known = 0
    for number in range(len(loops)):
        reference_rad = _read_last(loops[number].reference, aim, last)
        if loops[number].signal == HEADING and not math.isnan(reference_rad):
            known |= 1 << number
    acting = find_last_acting(phase, loops, known)
    is_arbitrary = acting < 0 or loops[acting].reference == BEARING_NOW
    error_rad: float = math.nan
    if is_arbitrary and not math.isnan(aim.goal_heading_rad):
        error_rad = wrap_angle(aim.goal_heading_rad - last.heading_rad)
    elif acting >= 0 and len(phase) > 0:
        error_rad = wrap_angle(_read_last(loops[acting].reference, aim, last) - last.unwrapped_rad)
    return error_rad


def _read_last(reference: int, aim: Aim, last: LastPose) -> float:
    """Return a reference of headings at the end of a run [rad]; NaN if it is unknown."""
    if reference == BEARING_NOW:
        return find_bearing(last.x_m, last.y_m, aim.goal_x_m, aim.goal_y_m)
    return last.reference_rad if reference > BEARING_NOW else read_constant(reference, aim)


def _find_acting(run: Run, loops: tuple[ControlLoop, ...]) -> NDArray[np.int64]:
    """Return the index of the loop that acts at every pose, or acted last, shape (n,)."""
    names = run.phase_names
    of_phase = np.full(len(names), -1)
    for number, phase in enumerate(names):
        acts = run.declaration.phases.get(phase, ())
        found = [index for index, loop in enumerate(loops) if loop.name in acts]
        of_phase[number] = found[0] if found else -1
    of_sample = of_phase[run.samples.phase]
    acting = np.flatnonzero(of_sample >= 0)
    if not len(acting):
        return np.zeros(len(run.poses), dtype=np.int64)
    latest = find_latest(run.samples.pose_sequence[acting], len(run.poses))
    return np.asarray(of_sample[acting[latest]])


def hold_samples(run: Run, values: Values) -> Values:
    """Return the recorded value of the last sample at or before each pose, shape (n,)."""
    return np.asarray(values[find_latest(run.samples.pose_sequence, len(run.poses))])


def _read_bearings(run: Run) -> Values | None:
    if run.goal_xy_m is None:
        return None
    (goal_x_m, goal_y_m), xy_m = run.goal_xy_m, run.poses.xy_m.tolist()
    bearings_rad = (find_bearing(x_m, y_m, goal_x_m, goal_y_m) for x_m, y_m in xy_m)
    return np.fromiter(bearings_rad, np.float64, len(xy_m))


def _read_recorded(run: Run, loop: ControlLoop, line: GoalLine | None) -> float | Values | None:
    xy_m, heading_rad = run.samples.reference_xy_m, run.samples.reference_heading_rad
    if xy_m is None or heading_rad is None:
        return None
    if loop.signal == "distance":
        return 0.0
    if loop.signal == "heading":
        return hold_reference(run, heading_rad)
    held_xy_m = None if line is None else hold_reference(run, xy_m)
    if held_xy_m is None or line is None:
        return None
    return project_on_line(held_xy_m, line, along=loop.signal == "along_track")


def _read_path(run: Run, loop: ControlLoop) -> Values | None:
    """Return the reference from the path at every pose; an arc length only if it has a speed."""
    path = run.path
    if path is None:
        return None
    if loop.signal == "cross_track":
        return np.zeros(len(run.poses))
    if loop.signal == "heading":
        return hold_reference(run, run.samples.reference_heading_rad)
    return None if path.speed_m_s is None else _trace_reference(run, path)


def _trace_reference(run: Run, path: Path) -> Values | None:
    held_xy_m = hold_reference(run, run.samples.reference_xy_m)
    if held_xy_m is None:
        return None
    first_m = _find_first_arc(run, path)
    return recall(run, "reference", lambda: trace_path(path, held_xy_m, first_m or 0.0))[0]


def trace_poses(run: Run, path: Path) -> tuple[Values, Values]:
    """Return the arc length of the nearest point to every pose and the distance to it [m]."""
    due_m = None if path.speed_m_s is None else _trace_reference(run, path)
    first_m = _find_first_arc(run, path)
    given = run.path_row if due_m is None and first_m is None else 0

    def trace() -> tuple[Values, Values]:
        """Trace the poses from when the path was given, and those before it, by themselves."""
        after = trace_path(path, run.poses.xy_m[given:], first_m, due_m)
        if not given:
            return after
        before = trace_path(path, run.poses.xy_m[:given], None, None)
        along_m, offset_m = (np.concatenate(pair) for pair in zip(before, after, strict=True))
        return along_m, offset_m

    return recall(run, "poses", trace)


def _find_first_arc(run: Run, path: Path) -> float | None:
    """Return the arc length of the first reference if the first sample is lost [m]; else None."""
    samples = run.samples
    if samples.reference_xy_m is None or not len(samples) or samples.sequence[0] == 0:
        return None
    assert samples.reference_heading_rad is not None
    x_m, y_m = map(float, samples.reference_xy_m[0])
    return path.find_point((x_m, y_m, float(samples.reference_heading_rad[0])))


_KNOWN: Final[WeakKeyDictionary[Run, dict[str, object]]] = WeakKeyDictionary()


def recall(run: Run, what: str, compute: Callable[[], _Value]) -> _Value:
    """Return what is slow to find in a run; it is computed once, and lasts as long as the run."""
    known = _KNOWN.setdefault(run, {})
    if what not in known:
        known[what] = compute()
    return cast("_Value", known[what])


def hold_reference(run: Run, column: Values | None) -> Values | None:
    """Return a component of the recorded reference pose, held at each pose; None if missing."""
    if column is None or not np.isfinite(column[:, 0] if column.ndim > 1 else column).any():
        return None
    return hold_column(column, run.samples.pose_sequence, len(run.poses), None)


def read_controlled_distance(run: Run) -> Values | None:
    """Return the distance of every pose to the recorded reference pose [m]."""
    held_xy_m = hold_reference(run, run.samples.reference_xy_m)
    if held_xy_m is None:
        return None
    away_m = held_xy_m - run.poses.xy_m
    return np.asarray(np.hypot(away_m[:, 0], away_m[:, 1]))


def project_on_line(xy_m: Values, line: GoalLine, *, along: bool) -> Values:
    """Return the coordinates of points along, or left of, the line from start to goal [m]."""
    return np.asarray(project(xy_m[:, 0], xy_m[:, 1], aim_at(line, None, None), along))


_BLOCKS: Final = (2048, 64)
"""Numbers of points that share a selection of path segments: of all segments, then of the remaining
ones."""

_PIECE: Final = 512

_BITS: Final = 12
"""Bits of each coordinate of the grid cells in which points are processed together."""


_CLOSED: Final = 1e-6
"""Distance from start to end, as a share of the path, that is rounding: of 32-bit poses, 1e-7."""


def compute_straightness(xy_m: Values) -> float | None:
    """Return path length divided by the distance from first to last point; None if that is 0."""
    distance_m = float(np.hypot(*(xy_m[-1] - xy_m[0])))
    way_m = measure_way(xy_m[:, 0], xy_m[:, 1], None)
    if distance_m <= _CLOSED * way_m:
        return None
    # Rounding may make the sum slightly shorter than a straight line's distance.
    return max(way_m / distance_m, 1.0)


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
        # Only these parts of the path can be nearest to a point of the block.
        centre = (xy_m[rows].min(axis=0) + xy_m[rows].max(axis=0)) / 2.0
        radius = np.hypot(*(xy_m[rows] - centre).T).max()
        to_centre = _measure_parts(centre[None], starts, ways)[0]
        near = to_centre <= to_centre.min() + 2.0 * radius * (1.0 + 1e-9)
        find = _measure_blocks if sizes else _find_nearest
        distances[rows] = find(xy_m[rows], starts[near], ways[near], *sizes)
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
    path: Path, xy_m: Values, arc_m: float | None, due_m: Values | None = None
) -> tuple[Values, Values]:
    """Return arc length of the nearest point, and distance to the left, of positions in order [m].

    Args:
        path: Path that is tracked.
        xy_m: Positions in the world frame [m], shape (n, 2).
        arc_m: Approximate arc length of the first position [m]; None if the robot has yet to reach
            the path.
        due_m: Arc length of the reference at each position, if the path has a time law [m], shape
            (n,).
    """
    x_m, y_m = (column.tolist() for column in xy_m.T)
    dues_m = [math.nan] * len(xy_m) if due_m is None else due_m.tolist()
    arcs_m, offsets_m = [0.0] * len(xy_m), [0.0] * len(xy_m)
    first_m = math.nan if arc_m is None else arc_m
    follow_pieces(path.numbers, path.ways, first_m, x_m, y_m, dues_m, arcs_m, offsets_m)
    return np.array(arcs_m, np.float64), np.array(offsets_m, np.float64)


_MOST_BYTES: Final = 2**24
"""Largest size of a path file [bytes]: half a million points, read in a second."""


def read_reference_path(path: str | pathlib.Path) -> NDArray[np.float64]:
    """Return the points of a CSV file with x and y [m], shape (n, 2).

    A header may name other units, as in `x [mm],y [mm]`.

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
    units = (1.0, 1.0)
    if rows and _parse(rows[0][1]) is None and any(map(str.isalpha, "".join(rows[0][1]))):
        units, rows = _read_units(path, rows[0][1]), rows[1:]
    points = []
    for line, row in rows:
        point = _parse(row)
        if point is None:
            found = ",".join(row)[:60]
            raise MeasureError(f"{path}: line {line}: expected x,y in metres, found {found!r}")
        points.append(point)
    if len(points) < 2:
        raise MeasureError(f"{path}: expected two points or more, found {len(points)}")
    return np.array(points) * units


def _read_units(path: pathlib.Path, header: list[str]) -> tuple[float, float]:
    """Return the units of x and y in a header [m]."""
    from turtlelog.log.table_columns import read_length_unit  # only paths with a header need it

    if [name.strip().lower()[:1] for name in header[:2]] == ["y", "x"]:
        raise MeasureError(f"{path}: line 1: expected x,y, found {','.join(header)[:60]!r}")
    try:
        found = [read_length_unit(axis, name) for axis, name in zip("xy", header, strict=False)]
    except LogError as err:
        raise MeasureError(f"{path}: line 1: {err}") from err
    return (found[0], found[1]) if len(found) == 2 else (1.0, 1.0)


def _parse(row: list[str]) -> tuple[float, float] | None:
    try:
        x_m, y_m = map(float, row)
    except ValueError:
        return None
    return (x_m, y_m) if math.isfinite(x_m) and math.isfinite(y_m) else None
