"""The still content of the plane: border, walls, starts, goals, ends, and what runs left there."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import numpy as np
import rerun as rr
from numpy.typing import ArrayLike, NDArray

from turtlelog.charts import close_up as close_ups, many_runs, palette, plane_scene
from turtlelog.charts.close_up import CloseUp, Label, Lettering, WorstPlace
from turtlelog.charts.curves import Values
from turtlelog.charts.plane_scene import read_pace
from turtlelog.draw.rerun import entities
from turtlelog.draw.rerun.entities import join_path
from turtlelog.draw.rerun.recording_stream import RunStream, Timelines, choose_trace_rows
from turtlelog.log.ros2.bag_surroundings import CELL_M, UNKNOWN, OccupancyMap, Surroundings
from turtlelog.plants.turtlesim import WORLD_SIZE_M
from turtlelog.run import Event, Run

_WORLD_MARGIN = 0.03
_MARGIN = 0.12
_GOAL_ASIDE = 0.22
_START_ASIDE = 0.32  # beside the turtle's arrow
_NAME_UP = 0.11  # the viewer writes a name below its point
_MARKER_RADIUS = 3.5  # [points]

UPWARD: Final = rr.Transform3D(mat3x3=np.diag([1.0, -1.0, 1.0]))
"""Transform that turns y upward for all entities below it: Rerun's 2D views have y downward."""

LETTERING: Final = Lettering(letter=0.06, line=0.2, gap=0.1, reach=1.6)
"""Size of text, measured at 1200 x 860 pixels, where half of the close-up is 125 pixels."""

SMALL_LETTERING: Final = Lettering(letter=0.09, line=0.25, gap=0.12, reach=1.55, most_told=6)
"""Size of text at 700 x 450, where half of the close-up is 73 pixels and a line of text 18."""

_ABOVE: Final = 0.6  # offset of text in lines, because the viewer writes text below its point

_END_RADIUS: Final = 4.0  # [points]
_ABOVE_ENDS: Final = 31.0  # points have 30
TRACE_RADIUS: Final = 1.5
_BELOW_TRACES: Final = 15.0  # lines have 20
_RING: Final[palette.Color] = (80, 80, 80)


@dataclass(frozen=True, slots=True, kw_only=True)
class Bounds:
    """A square of the plane, y upward [m]."""

    center_xy_m: tuple[float, float]
    half_size_m: float


def find_plane_bounds(runs: Sequence[Run]) -> Bounds:
    """Return the world's bounds, or the bounds of paths and goals that leave the world."""
    if plane_scene.is_in_world(runs):
        return _square(np.zeros(2), np.full(2, WORLD_SIZE_M), _WORLD_MARGIN)
    return find_way_bounds(runs)


def find_way_bounds(runs: Sequence[Run]) -> Bounds:
    """Return the bounds of paths and goals."""
    points = np.concatenate([*map(plane_scene.list_places, runs), plane_scene.list_goals(runs)])
    return _square(points.min(axis=0), points.max(axis=0), _MARGIN)


def draw_world(
    stream: rr.RecordingStream, runs: Sequence[Run], *, half_size_m: float | None = None
) -> None:
    """Draw the border, and each tracked path, start and goal once.

    `half_size_m` is half the size of the plane, if it differs from the world's.
    """
    stream.log(join_path(entities.PLANE), UPWARD, static=True)
    if plane_scene.is_in_world(runs):
        half = WORLD_SIZE_M / 2.0
        border = rr.Boxes2D(
            centers=[(half, half)],
            half_sizes=[(half, half)],
            colors=[palette.REFERENCE],
            radii=rr.Radius.ui_points(0.75),
        )
        stream.log(join_path(entities.BORDER), border, static=True)
    paths = plane_scene.list_paths(runs)
    if paths:
        strips = [plane_scene.outline_path(path) for path in paths]
        look, colors = {"draw_order": _BELOW_TRACES}, [palette.TRACKED] * len(paths)
        log_strips(stream, entities.TRACKED_PATH, strips, colors, radius=2.5, **look)
    starts, goals = plane_scene.list_starts(runs), plane_scene.list_goals(runs)
    log_points(stream, entities.START, starts, [palette.START], _MARKER_RADIUS)
    if len(goals):
        log_points(stream, entities.GOAL, goals, [palette.GOAL], _MARKER_RADIUS)
        _draw_tolerances(stream, runs)
    if len(starts) == 1 and len(goals) == 1:
        half_m = half_size_m or find_plane_bounds(runs).half_size_m
        # Each name is on the side away from the path.
        side = 1.0 if goals[0][0] <= starts[0][0] else -1.0
        asides = np.array([(side * _START_ASIDE, _NAME_UP), (-side * _GOAL_ASIDE, _NAME_UP)])
        places, colors = [starts[0], goals[0]] + half_m * asides, [palette.START, palette.GOAL]
        log_words(stream, entities.NAMES, places, ["start", "goal"], colors)


def draw_close_up(
    stream: rr.RecordingStream,
    close_up: CloseUp,
    run: Run,
    prefixes: Sequence[str],
    colors: Sequence[palette.Color],
    *,
    lettering: Lettering = LETTERING,
) -> None:
    """Draw each run's end with its distance from the goal; `run` gives the direction of arrival."""
    for end in close_up.ends:
        told = f"ends {close_ups.format_length(end.miss_m)} from the goal"
        entity, color = f"{prefixes[end.run]}/{entities.END}", colors[end.run]
        log_points(
            stream, entity, [end.xy_m], [color], _END_RADIUS, labels=[told], show_labels=False
        )
    misses = close_ups.list_miss_labels(close_up, lettering)
    rings = close_ups.list_ring_labels(close_up, run.poses.xy_m[0], misses, lettering)
    up_m = _ABOVE * LETTERING.line * close_up.half_m
    lines = [line for label in misses for line in _part_lines(label, lettering, close_up.half_m)]
    hues = [colors[one.runs[0]] if len(one.runs) == 1 else palette.START for one in lines]
    _write_labels(stream, entities.MISSES, up_m, lines, hues)
    _write_labels(stream, entities.RING_NAMES, up_m, rings, [palette.REFERENCE] * len(rings))
    log_strips(stream, entities.RINGS, close_up.list_rings(), [_RING], radius=0.5)


def draw_ends(
    stream: rr.RecordingStream, runs: Sequence[Run], colors: Sequence[palette.Color]
) -> None:
    """Draw the ends of many runs; for each gain, the median and an outline of 90 % of the ends."""
    ends_m = [run.poses.xy_m[-1] for run in runs]
    log_points(stream, entities.ENDS, ends_m, colors, radius=2.0)
    groups = many_runs.find_gain_ends(runs)
    if not groups:
        return
    hues = [colors[group.middle_run] for group in groups]
    names = [f"Kp {group.gain:.3g}: " for group in groups]
    looks: dict[str, Any] = {"show_labels": False, "draw_order": _ABOVE_ENDS}
    looks["labels"] = [f"{name}{many_runs.OUTLINE_LABEL}" for name in names]
    outlines = [group.around_xy_m for group in groups]
    log_strips(stream, entities.OUTLINES, outlines, hues, radius=0.75, **looks)
    looks["labels"] = [f"{name}{many_runs.MEDIAN_LABEL}" for name in names]
    medians = [group.median_xy_m for group in groups]
    log_points(stream, entities.MEDIANS, medians, hues, radius=4.5, **looks)


def draw_worst_place(stream: rr.RecordingStream, worst: WorstPlace, color: palette.Color) -> None:
    """Draw the largest deviation from the path of all runs, in the colour of its run."""
    way = [worst.path_xy_m, worst.xy_m]
    log_strips(stream, entities.WORST, [way], [color], radius=1.0)
    up_m = _ABOVE * LETTERING.line * worst.half_m
    label = close_ups.label_worst_place(worst, LETTERING)
    _write_labels(stream, entities.WORST_NAME, up_m, [label], [color])


def _draw_tolerances(stream: rr.RecordingStream, runs: Sequence[Run]) -> None:
    """Draw a square around each goal, because the law checks each coordinate's error alone."""
    squares = sorted(
        {
            (run.goal_xy_m, tolerance_m)
            for run in runs
            if run.goal_xy_m is not None
            and (tolerance_m := close_ups.find_tolerance(run)) is not None
        }
    )
    if squares:
        boxes = rr.Boxes2D(
            centers=[goal for goal, _ in squares],
            half_sizes=[(tolerance_m, tolerance_m) for _, tolerance_m in squares],
            colors=[palette.GOAL],
            radii=rr.Radius.ui_points(0.75),
        )
        stream.log(join_path(entities.TOLERANCE), boxes, static=True)


def _square(low: Values, high: Values, margin: float) -> Bounds:
    x_m, y_m = (low + high) / 2.0
    size_m = max(float((high - low).max()), 0.1)
    return Bounds(center_xy_m=(float(x_m), float(y_m)), half_size_m=size_m * (0.5 + margin))


def _part_lines(label: Label, lettering: Lettering, half_m: float) -> list[Label]:
    """Return a label for each line from top to bottom, each with its run."""
    lines = label.text.split("\n")
    if len(lines) == 1:
        return [label]
    (x_m, y_m), line_m = label.xy_m, lettering.line * half_m
    middle = (len(lines) - 1) / 2.0
    return [
        Label(text=line, xy_m=(x_m, y_m + (middle - number) * line_m), runs=(run,))
        for number, (line, run) in enumerate(zip(lines, label.runs, strict=True))
    ]


def _write_labels(
    stream: rr.RecordingStream,
    entity: str,
    up_m: float,
    labels: Sequence[Label],
    colors: Sequence[palette.Color],
) -> None:
    places = [(label.xy_m[0], label.xy_m[1] + up_m) for label in labels]
    log_words(stream, entity, places, [label.text for label in labels], colors)


def log_words(
    stream: rr.RecordingStream,
    entity: str,
    places: ArrayLike,
    texts: Sequence[str],
    colors: Sequence[palette.Color],
) -> None:
    """Write each text at its place, as the label of a point without a radius."""
    log_points(stream, entity, places, colors, 0.0, labels=texts, show_labels=True)


def log_points(
    stream: rr.RecordingStream | RunStream,
    entity: str,
    places: ArrayLike,
    colors: Sequence[palette.Color] | NDArray[np.uint32],
    radius: float,
    **more: Any,
) -> None:
    """Draw static points with a radius [points]."""
    points = rr.Points2D(places, radii=rr.Radius.ui_points(radius), colors=colors, **more)
    stream.log(join_path(entity), points, static=True)


def log_strips(
    stream: rr.RecordingStream | RunStream,
    entity: str,
    strips: Sequence[ArrayLike],
    colors: Sequence[palette.Color] | NDArray[np.uint32],
    radius: float,
    **more: Any,
) -> None:
    """Draw static lines with a radius [points]."""
    lines = rr.LineStrips2D(strips, radii=rr.Radius.ui_points(radius), colors=colors, **more)
    stream.log(join_path(entity), lines, static=True)


_MAP_ORDER: Final = 5.0  # tracked paths have 15, traces 20
_COSTMAP_ORDER: Final = 5.5
_WALL_ORDER: Final = 6.0
_SCAN_ORDER: Final = 16.0
_SCAN_RADIUS: Final = 1.75  # [points]

_WIDEST: Final = 3.0
"""Largest growth of the plane for surroundings, with which the path stays readable."""

_SHARE: Final = 0.95
"""Share of the walls that the plane shows, because rays through a door lead far away."""


def draw_surroundings(
    stream: rr.RecordingStream,
    seen: Surroundings,
    timelines: Timelines,
    shift_m: Values,
) -> None:
    """Draw the surroundings of the robot; `shift_m` is added to them, as to the run's poses."""
    for place in seen.maps:
        _draw_map(stream, place, shift_m)
    if len(seen.walls_xy_m):
        cells = rr.Points2D(
            seen.walls_xy_m + shift_m,
            radii=CELL_M / 2.0,
            colors=[palette.WALLS],
            draw_order=_WALL_ORDER,
        )
        stream.log(join_path(entities.WALLS), cells, static=True)
    if not len(seen.time_ns):
        return
    look = rr.Points2D.from_fields(
        radii=rr.Radius.ui_points(_SCAN_RADIUS), colors=[palette.SCAN], draw_order=_SCAN_ORDER
    )
    scans = RunStream(stream, "", timelines)
    scans.log(entities.SCAN, look)
    points = rr.Points2D.columns(positions=np.concatenate(seen.scans_xy_m) + shift_m)
    columns = points.partition([len(one) for one in seen.scans_xy_m])
    scans.send_few(entities.SCAN, seen.time_ns, columns)


def _draw_map(stream: rr.RecordingStream, place: OccupancyMap, shift_m: Values) -> None:
    """Draw a map as one picture in the colours of occupancy; unknown cells are empty."""
    entity, order = (
        (entities.COSTMAP, _COSTMAP_ORDER) if place.is_costmap else (entities.MAP, _MAP_ORDER)
    )
    colors = palette.COST_COLORS if place.is_costmap else palette.OCCUPANCY_COLORS
    names = [rr.AnnotationInfo(id=value, color=color) for value, color in enumerate(colors)]
    names.append(rr.AnnotationInfo(id=UNKNOWN, color=(0, 0, 0, 0)))
    turn = np.eye(3)
    turn[:2, :2] = np.column_stack([place.column_xy_m, place.row_xy_m])
    corner = rr.Transform3D(translation=[*(place.corner_xy_m + shift_m), 0.0], mat3x3=turn)
    picture = rr.SegmentationImage(place.cells, draw_order=order, opacity=1.0)
    for part in (rr.AnnotationContext(names), corner, picture):
        stream.log(join_path(entity), part, static=True)


def widen_plane(bounds: Bounds, seen: Surroundings, shift_m: Values) -> Bounds:
    """Return bounds of the plane with most of the walls, limited so that paths stay large."""
    walls = np.concatenate([seen.walls_xy_m, seen.map_xy_m]) + shift_m
    if not len(walls):
        return bounds
    away = np.abs(walls - np.asarray(bounds.center_xy_m)).max(axis=1)
    wanted_m = float(np.quantile(away, _SHARE)) * 1.05
    half_m = min(max(wanted_m, bounds.half_size_m), _WIDEST * bounds.half_size_m)
    return Bounds(center_xy_m=bounds.center_xy_m, half_size_m=half_m)


_SPEED_LEVELS: Final = 16
_SENSED_ORDER: Final = 18.0  # lines have 20
_ON_TRACES: Final = 22.0

_LOST_AGAIN: Final = frozenset({"poses_lost", "commands_lost"})
"""Kinds of events that random effects cause every few samples, only listed."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SpeedTrace:
    """A path in colours of its speed."""

    strips: list[Values]  # segments of one colour [m], each of shape (n, 2)
    colors: list[palette.Color]  # colour of each strip; brighter means faster
    highest_m_s: float  # speed of the brightest colour [m/s]

    def draw(self, run_stream: RunStream) -> None:
        """Draw the whole path."""
        log_strips(run_stream, entities.SPEED_PATH, self.strips, self.colors, radius=1.75)


def build_speed_trace(run: Run) -> SpeedTrace | None:
    """Return the whole path in colours of its speed; None if nothing moves."""
    kept = choose_trace_rows(run)
    xy_m, speed_m_s = run.poses.xy_m[kept], read_pace(run, np.arange(len(run.poses))[kept])
    highest = float(speed_m_s.max(initial=0.0))
    if not 0.0 < highest < np.inf:
        return None
    levels = np.rint(speed_m_s / highest * (_SPEED_LEVELS - 1)).astype(np.int64)
    ramp = palette.choose_shades(_SPEED_LEVELS)
    stretches = list(_split_where_changed(levels))
    return SpeedTrace(
        strips=[xy_m[first : last + 1] for first, last in stretches],
        colors=[ramp[int(levels[first])] for first, _ in stretches],
        highest_m_s=highest,
    )


def draw_reference_path(run_stream: RunStream, run: Run) -> None:
    """Draw the path of a recorded reference pose, as strips where the reference is known.

    Another function draws the path that a law tracks.
    """
    xy_m = run.samples.reference_xy_m
    if xy_m is None or not plane_scene.has_own_way(run):
        return
    known = np.isfinite(xy_m[:, 0]).astype(np.int64)
    stretches = [s for s in _split_where_changed(known) if known[s[0]]]
    strips = [xy_m[first:after] for first, after in stretches]
    colors = [palette.REFERENCE] * len(strips)
    log_strips(run_stream, entities.REFERENCE_PATH, strips, colors, TRACE_RADIUS)


def draw_sensed(run_stream: RunStream, run: Run) -> None:
    """Draw the sensed poses, and the true pose where a sensed pose dropped out."""
    xy_m, lost = run.poses.sensed_xy_m, np.flatnonzero(run.poses.dropped_out)
    if xy_m is None:
        return
    kept = choose_trace_rows(run)
    lost_m = run.poses.xy_m[np.intersect1d(kept, lost)]
    for entity, places_m, color, order in (
        (entities.SENSED_PLACES, xy_m[kept], palette.SENSED, _SENSED_ORDER),
        (entities.DROPPED_PLACES, lost_m, palette.DROPPED_OUT, _ON_TRACES),
    ):
        places_m = places_m[np.isfinite(places_m[:, 0])]
        log_points(run_stream, entity, places_m, [color], radius=1.25, draw_order=order)


def list_placed(run: Run) -> list[Event]:
    """Return the events that are marked, without frequent losses, which would cover others."""
    return [event for event in run.events if event.kind not in _LOST_AGAIN]


def draw_event_places(run_stream: RunStream, run: Run) -> None:
    """Mark the turtle's places at events. The viewer shows each event's name at the pointer."""
    events = list_placed(run)
    times_ns = [event.time_ns for event in events]
    rows = np.searchsorted(run.poses.time_ns, times_ns, side="right") - 1
    places_m, kinds = run.poses.xy_m[np.maximum(rows, 0)], [event.kind for event in events]
    colors = [palette.WALL_HIT if kind == "wall_hit" else palette.EVENT for kind in kinds]
    look: dict[str, Any] = {"labels": [kind.replace("_", " ") for kind in kinds]}
    look["show_labels"] = False
    log_points(run_stream, entities.EVENT_PLACES, places_m, colors, radius=4.0, **look)


def _split_where_changed(values: NDArray[np.int64]) -> Iterator[tuple[int, int]]:
    """Yield the first row of each segment of equal values, and the row after the segment."""
    bounds = [0, *(np.flatnonzero(np.diff(values)) + 1).tolist(), len(values)]
    for first, last in pairwise(bounds):
        if last > first:
            yield first, last
