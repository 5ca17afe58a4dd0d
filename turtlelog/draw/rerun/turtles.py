"""What moves in the plane: turtles with trails and arrows, ghosts with their distance and a key."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import rerun as rr

from turtlelog.charts import palette
from turtlelog.charts.close_up import format_length
from turtlelog.charts.curves import Values, find_steps
from turtlelog.charts.plane_scene import find_break_rows, read_way_to_reference
from turtlelog.charts.time_plots import locate_run
from turtlelog.draw.rerun import entities, plane
from turtlelog.draw.rerun.entities import join_path, name_part
from turtlelog.draw.rerun.plots import Series
from turtlelog.draw.rerun.recording_stream import RunStream, Timelines, choose_trace_rows
from turtlelog.run import PoseColumns, Run
from turtlelog.run.angles import wrap_angle

_ARROW_SHARE: Final = 0.12
_ARROW_RADIUS: Final = 2.5
_THIN_RADIUS: Final = 1.0
_ABOVE_TRACES: Final = 28.0  # below points, which have 30


def draw_growing_path(run_stream: RunStream, run: Run) -> None:
    """Draw the path of a growing run, which has been driven whole, as one bright path."""
    run_stream.log(entities.PLANE, plane.UPWARD)
    strips = _part_strip(run)
    colors = [palette.MAIN] * len(strips)
    plane.log_strips(run_stream, entities.PATH, strips, colors, plane.TRACE_RADIUS)


def draw_reference_pose(run_stream: RunStream, run: Run, half_size_m: float) -> None:
    """Draw a recorded reference pose at the cursor as an arrow."""
    xy_m, heading_rad = run.samples.reference_xy_m, run.samples.reference_heading_rad
    if xy_m is None or heading_rad is None or not np.isfinite(heading_rad).any():
        return
    _log_arrow_style(run_stream, entities.REFERENCE_POSE, palette.GOAL, _ARROW_RADIUS)
    ways = half_size_m * _ARROW_SHARE * np.column_stack([np.cos(heading_rad), np.sin(heading_rad)])
    values = np.column_stack([xy_m, ways])
    # A row of NaN draws no arrow, and removes the previous arrow.
    run_stream.send(entities.REFERENCE_POSE, run.samples.time_ns, values, _build_arrows)


def draw_arrows(run_stream: RunStream, run: Run) -> None:
    """Draw arrows at the cursor: the error from turtle to goal, and the command's motion in 1 s.

    For a law without a goal, the error leads to the reference pose, if it is recorded.

    The command is drawn as two arrows in the turtle's frame: the speed along the heading, and the
    turn rate as the sideways motion of a point 1 m ahead, to the left.
    """
    ways_m = _read_errors(run)
    if ways_m is not None:
        _log_arrow_style(run_stream, entities.ERROR, palette.ERROR)
        values = np.column_stack([run.poses.xy_m, ways_m])
        run_stream.send(entities.ERROR, run.poses.time_ns, values, _build_arrows)
    table = run.samples if len(run.samples) else run.commands
    if len(table):
        _log_arrow_style(run_stream, entities.COMMAND, palette.COMMAND)
        values = np.column_stack([table.speed_m_s, table.turn_rate_rad_s])
        run_stream.send(entities.COMMAND, table.time_ns, values, _build_command)


def name_arrows(run: Run) -> str:
    """Return text on the thin arrows that `draw_arrows` draws at the turtle."""
    aim = "goal" if run.goal_xy_m is not None else "reference"
    words = [f"pink: to the {aim}"] if _read_errors(run) is not None else []
    words += ["yellow: command"] if len(run.samples) or len(run.commands) else []
    return ", ".join(words)


def _read_errors(run: Run) -> Values | None:
    """Return the vectors from each pose to the goal or reference [m], shape (n, 2)."""
    if run.goal_xy_m is not None:
        return np.asarray(np.array(run.goal_xy_m) - run.poses.xy_m)
    return read_way_to_reference(run)


def _log_arrow_style(
    run_stream: RunStream, entity: str, color: palette.Color, radius: float = _THIN_RADIUS
) -> None:
    style = rr.Arrows2D.from_fields(
        colors=[color], radii=rr.Radius.ui_points(radius), draw_order=_ABOVE_TRACES
    )
    run_stream.log(entity, style)


def _build_arrows(values: Values) -> rr.ComponentColumnList:
    """Build one arrow per row, as origins and vectors; a row that is not finite has no arrow."""
    known = np.isfinite(values).all(axis=1)
    columns = rr.Arrows2D.columns(origins=values[known, :2], vectors=values[known, 2:])
    return columns if known.all() else columns.partition(known.astype(np.int64))


def _build_command(values: Values) -> rr.ComponentColumnList:
    zeros = np.zeros(len(values))
    vectors = np.column_stack([values[:, 0], zeros, zeros, values[:, 1]]).reshape(-1, 2)
    origins = np.tile([(0.0, 0.0), (1.0, 0.0)], (len(values), 1))
    lengths = np.full(len(values), 2)
    return rr.Arrows2D.columns(origins=origins, vectors=vectors).partition(lengths)


MOST_SEGMENTS: Final = 1000  # segments of a trail; the viewer looks up each segment in every frame

_ALL_SEGMENTS: Final = 8000
"""Largest number of segments of all trails; more take longer than a frame of 1/30 s."""

_FEWEST_SEGMENTS: Final = 40  # segments of a trail: a path across the window grows by 20 pixels

_FAINT: Final = 45
"""Opacity of the path that is not driven yet, of 255: visible, but different from the trail."""

_SIZE: Final = 0.07
"""Radius of the shell, as a share of the plane's half-width: 14 pixels in a view of 400."""

_DOT_RADIUS: Final = 5.0  # [points]
_HEADING_SHARE: Final = 0.2
_HEADING_RADIUS: Final = 1.5  # [points]
_TRAIL_ORDER: Final = 21.0  # lines have 20
_BODY_ORDER: Final = 24.0
_SHELL: Final = ([(-0.3, 0.0), (0.3, 0.0)], 0.62)
_BODY: Final = (
    ([(-0.3, 0.0), (0.3, 0.0)], 0.85),
    ([(1.2, 0.0), (1.5, 0.0)], 0.4),
    ([(-1.1, 0.0), (-1.5, 0.0)], 0.13),
    ([(0.6, 0.7), (0.95, 1.15)], 0.26),
    ([(0.6, -0.7), (0.95, -1.15)], 0.26),
    ([(-0.6, 0.7), (-0.95, 1.15)], 0.26),
    ([(-0.6, -0.7), (-0.95, -1.15)], 0.26),
)
"""Strokes of a turtle and their radii, in radii of the shell, x ahead: shell, head, tail, legs."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Look:
    """The style of a turtle and its trail."""

    color: palette.Color  # colour of turtle and trail
    is_ghost: bool = False  # whether its shell is hollow, and behind other turtles
    width: float = plane.TRACE_RADIUS  # radius of the trail [points]
    size: float = 1.0  # size of the turtle; 1 for a run


def count_segments(trails: int) -> int:
    """Return the number of segments that each of several trails may have."""
    return max(min(MOST_SEGMENTS, _ALL_SEGMENTS // max(trails, 1)), _FEWEST_SEGMENTS)


def draw_turtle(run_stream: RunStream, poses: PoseColumns, look: Look, half_size_m: float) -> None:
    """Draw the turtle at its pose at the cursor, with an arrow along its heading.

    All turtles begin with the first pose: a turtle without a pose would be at the origin.
    """
    first_ns = poses.time_ns[:1]
    order = _BODY_ORDER - 2.0 * look.is_ghost
    run_stream.log(
        entities.TURTLE,
        rr.Points2D.from_fields(
            radii=rr.Radius.ui_points(_DOT_RADIUS * look.size), colors=[look.color]
        ),
    )
    places = rr.Points2D.columns(positions=[(0.0, 0.0)])
    run_stream.send_few(entities.TURTLE, first_ns, places)
    radius_m = _SIZE * look.size * half_size_m
    red, green, blue = (
        min(round((0.3 if look.is_ghost else 1.3) * part), 255) for part in look.color
    )
    for entity, strokes, color, above in (
        (entities.BODY, _BODY, look.color, 0.0),
        (entities.SHELL, (_SHELL,), (red, green, blue), 1.0),
    ):
        style = rr.LineStrips2D.from_fields(colors=[color], draw_order=order + above)
        run_stream.log(entity, style)
        strips = [np.multiply(points, radius_m) for points, _ in strokes]
        columns = rr.LineStrips2D.columns(
            strips=strips, radii=[radius * radius_m for _, radius in strokes]
        )
        run_stream.send_few(entity, first_ns, columns.partition([len(strips)]))
    heading = rr.Arrows2D.from_fields(
        radii=rr.Radius.ui_points(_HEADING_RADIUS), colors=[look.color], draw_order=order
    )
    run_stream.log(entities.ARROW, heading)
    length_m = half_size_m * _HEADING_SHARE * look.size
    run_stream.send_few(entities.ARROW, first_ns, rr.Arrows2D.columns(vectors=[(length_m, 0.0)]))
    values = np.column_stack([poses.xy_m, poses.heading_rad])
    run_stream.send(entities.TURTLE, poses.time_ns, values, _build_transforms)


def draw_trail(
    run_stream: RunStream, run: Run, look: Look, *, segments: int = MOST_SEGMENTS
) -> None:
    """Draw the whole path faintly, and the part driven so far as a trail."""
    run_stream.log(entities.PLANE, plane.UPWARD)
    strips = _part_strip(run)
    # The part that is not driven yet is faint.
    bright = palette.pack_colors([look.color] * len(strips))
    faint = bright & np.uint32(0xFFFFFF00) | np.uint32(_FAINT)
    plane.log_strips(run_stream, entities.PATH, strips, faint, look.width)
    # Each segment of the trail has the time of its last pose, and views show past segments. A
    # segment never spans a gap in the poses, and always has a length.
    kept = choose_trace_rows(run)
    if len(kept) < 2:
        return
    even = np.linspace(0, len(kept) - 1, min(segments, len(kept) - 1) + 1).round().astype(int)
    breaks = np.searchsorted(kept, find_break_rows(run))
    edges = np.unique(np.concatenate([even, breaks, np.maximum(breaks - 1, 0)]))
    xy_m = run.poses.xy_m[kept]
    pieces = [
        (first, last)
        for first, last in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)
        if last not in breaks and np.ptp(xy_m[first : last + 1], axis=0).any()
    ]
    if not pieces:
        return
    style = rr.LineStrips2D.from_fields(
        radii=rr.Radius.ui_points(look.width), draw_order=_TRAIL_ORDER - 0.5 * look.is_ghost
    )
    run_stream.log(entities.TRAIL, style)
    colors = palette.pack_colors([look.color] * len(pieces))
    columns = rr.LineStrips2D.columns(
        strips=[xy_m[first : last + 1] for first, last in pieces], colors=colors
    )
    times_ns = run.poses.time_ns[kept[[last for _, last in pieces]]]
    run_stream.send_few(entities.TRAIL, times_ns, columns)


def _part_strip(run: Run) -> list[Values]:
    """Return the path in strips, separated between poses where the robot did not drive."""
    rows = np.arange(len(run.poses))[choose_trace_rows(run)]
    strips = np.split(run.poses.xy_m[rows], np.searchsorted(rows, find_break_rows(run)))
    return [strip for strip in strips if len(strip)]


def _build_transforms(values: Values) -> rr.ComponentColumnList:
    half_rad, zeros = values[:, 2] / 2.0, np.zeros(len(values))
    return rr.Transform3D.columns(
        translation=np.column_stack([values[:, :2], zeros]),
        quaternion=np.column_stack([zeros, zeros, np.sin(half_rad), np.cos(half_rad)]),
    )


_MOST_GAPS: Final = 1000
"""Number of rows of the line between run and ghost: as many as a trail has segments."""

_APART_M: Final = 5e-4  # smallest distance that is written [m]; a smaller distance would be 0 mm
_ONE_M: Final = 1.0  # gap from which the plot is in m instead of mm [m]

_GAP_WIDTH: Final = 1.0  # [points]
_GAP_ORDER: Final = 27.0  # above turtles

_KEY_LETTER: Final = 0.036
"""Width of a letter, as a share of the plane's half-width: 7 pixels of 200."""

_REACH: Final = 1.2
"""Half-width of the view, as a multiple of the plane's half-width; text beyond it is cut off."""

_ASIDE, _UP = 0.1, -0.1
"""Offset of the distance's text from its line, in half-widths, away from the goal's name."""

_EDGE: Final = 0.87
"""Position of the key, as a share of the plane's half-width: inside the border of the world."""

_KEY_LINE: Final = 0.19
"""Height of a line of the key, as a share of the plane's half-width: 18 pixels in a window of 700 x
450, less than the height of text with its frame."""

_KEY_SAMPLE: Final = 0.1
_KEY_GAP: Final = 0.06
_KEY_UP: Final = 0.055


@dataclass(frozen=True, slots=True, kw_only=True)
class Ghost:
    """A run that did not happen, for comparison with a real run."""

    name: str  # name of the ghost in words
    prefix: str  # entity prefix
    run: Run  # run with the ghost's poses
    look: Look  # style of the ghost
    is_run: bool  # whether the ghost was simulated; otherwise only its poses are valid
    brief: str = ""  # short name


def build_ideal_ghost(run: Run) -> Ghost | None:
    """Return the ideal loop as a ghost of a run; None if theory does not know its poses."""
    poses = find_ideal_poses(run)
    if poses is None:
        return None
    look, ideal = Look(color=palette.GHOST, is_ghost=True), replace(run, poses=poses)
    prefix = join_path("ideal_loop")
    return Ghost(name="ideal loop", prefix=prefix, run=ideal, look=look, is_run=False)


def find_ideal_poses(run: Run) -> PoseColumns | None:
    """Return the poses of a run's ideal loops at the times of the run's poses.

    Each ideal loop begins together with the run's loop, like the ideal response in the plots;
    nothing is clipped. Theory gives a pose if one loop turns the robot, and another loop then
    drives it along its track. Otherwise the result is None.
    """
    turns, ways = [*find_steps(run, "heading")], [*find_steps(run, "along_track")]
    line = run.goal_line
    if len(turns) != 1 or len(ways) != 1 or line is None or not len(run.poses):
        return None
    (turn,), (way,) = turns, ways
    loops = {loop.name for loop in run.declaration.loops}
    if loops != {turn.loop.name, way.loop.name} or turn.end_ns > way.start_ns:
        return None
    time_ns = run.poses.time_ns
    heading_rad = np.radians(turn.respond(np.maximum(time_ns - turn.start_ns, 0) / 1e9))
    along_m = way.respond(np.maximum(time_ns - way.start_ns, 0) / 1e9)
    ahead = np.array([np.cos(line.bearing_rad), np.sin(line.bearing_rad)])
    xy_m = line.start_xy_m + along_m[:, np.newaxis] * ahead
    return PoseColumns(time_ns=time_ns, xy_m=xy_m, heading_rad=wrap_angle(heading_rad))


def draw_ghost(
    stream: rr.RecordingStream,
    ghost: Ghost,
    timelines: Timelines,
    half_size_m: float,
    *,
    segments: int = MOST_SEGMENTS,
) -> RunStream:
    """Draw trail and turtle of a ghost."""
    run_stream = RunStream(stream, ghost.prefix, timelines)
    draw_trail(run_stream, ghost.run, ghost.look, segments=segments)
    draw_turtle(run_stream, ghost.run.poses, ghost.look, half_size_m)
    return run_stream


def list_gaps(run: Run, ghosts: Sequence[Ghost]) -> tuple[Series, ...]:
    """Return the distance of each ghost from the run at equal times after its start."""
    gaps = [measure_gap(run, ghost) for ghost in ghosts]
    if len(run.poses) < 2 or not gaps:
        return ()
    in_mm = max(float(gap.max()) for gap in gaps) < _ONE_M
    plot, factor = (entities.GAP_MM, 1e3) if in_mm else (entities.GAP_M, 1.0)
    return tuple(
        Series(
            entity=f"{plot}/{name_part(ghost.name)}",
            labels=(ghost.name,),
            colors=(ghost.look.color,),
            time_ns=run.poses.time_ns,
            values=factor * gap[:, np.newaxis],
            width=ghost.look.width,
        )
        for ghost, gap in zip(ghosts, gaps, strict=True)
    )


def measure_gap(run: Run, ghost: Ghost) -> Values:
    """Return the distance to a ghost at each of a run's poses [m], shape (n,)."""
    away_m = _follow(run, ghost) - run.poses.xy_m
    return np.asarray(np.hypot(away_m[:, 0], away_m[:, 1]))


def draw_gap(
    stream: rr.RecordingStream, run: Run, ghost: Ghost, bounds: plane.Bounds, words: str
) -> None:
    """Draw a line from the run to a ghost at the cursor, with the distance as text."""
    rows = np.unique(
        np.linspace(0, len(run.poses) - 1, min(len(run.poses), _MOST_GAPS)).round().astype(int)
    )
    own_m, other_m = run.poses.xy_m[rows], _follow(run, ghost)[rows]
    # On other timelines the distance is different.
    run_stream = RunStream(stream, "", Timelines(zero_ns=run.start_ns))
    time_ns, colors = run.poses.time_ns[rows], [palette.GOAL]
    radii = rr.Radius.ui_points(_GAP_WIDTH)
    style = rr.LineStrips2D.from_fields(radii=radii, colors=colors, draw_order=_GAP_ORDER)
    run_stream.log(entities.GAP, style)
    lines = rr.LineStrips2D.columns(strips=[*np.stack([own_m, other_m], axis=1)])
    run_stream.send_few(entities.GAP, time_ns, lines)
    radii = rr.Radius.ui_points(0.0)
    run_stream.log(
        entities.GAP_NAME, rr.Points2D.from_fields(radii=radii, colors=colors, show_labels=True)
    )
    gap_m = measure_gap(run, ghost)[rows]
    is_apart = gap_m >= _APART_M
    middles_m = (own_m + other_m)[is_apart] / 2.0
    labels = [f"{words}: {format_length(float(gap))}" for gap in gap_m[is_apart]]
    longest = max(map(len, labels), default=0)
    aside_m = _find_aside(run, middles_m[:, 0], bounds, longest * _KEY_LETTER)
    places_m = middles_m + np.column_stack(
        [aside_m, np.full(len(aside_m), _UP * bounds.half_size_m)]
    )
    names = rr.Points2D.columns(positions=places_m, labels=labels)
    run_stream.send_few(entities.GAP_NAME, time_ns, names.partition(is_apart.astype(np.int64)))


def draw_key(
    stream: rr.RecordingStream,
    rows: Sequence[tuple[str, palette.Color]],
    bounds: plane.Bounds,
    runs: Sequence[Run],
) -> None:
    """Name the turtles of a plane at the place with the fewest of their poses."""
    half_m = bounds.half_size_m
    longest = max(len(name) for name, _ in rows) * _KEY_LETTER + _KEY_GAP
    width = _KEY_SAMPLE + _KEY_GAP + longest
    xy = (np.concatenate([run.poses.xy_m for run in runs]) - bounds.center_xy_m) / half_m
    height = _KEY_LINE * (len(rows) + 1)
    lefts, tops = (-_EDGE, _EDGE - width, -width / 2.0), (height - _EDGE, _EDGE, height / 2.0)

    def count_hidden(corner: tuple[float, float]) -> int:
        across = (xy[:, 0] > corner[0]) & (xy[:, 0] < corner[0] + width)
        return int((across & (xy[:, 1] > corner[1] - height) & (xy[:, 1] < corner[1])).sum())

    # If several places are equally empty, the first is used: the lower left.
    left, top = min(((x, y) for y in tops for x in lefts), key=count_hidden)
    ys = top - _KEY_LINE * (np.arange(len(rows)) + 1.0)
    samples = [[(left, y), (left + _KEY_SAMPLE, y)] for y in ys]
    middle = left + _KEY_SAMPLE + _KEY_GAP
    words = [
        (middle + len(name) * _KEY_LETTER / 2.0, y + _KEY_UP)
        for (name, _), y in zip(rows, ys, strict=True)
    ]
    center, colors = np.array(bounds.center_xy_m), [color for _, color in rows]
    lines = [center + half_m * np.array(sample) for sample in samples]
    plane.log_strips(stream, entities.KEY, lines, colors, 2.5)
    # In a small window samples are hidden, so that the names have their colours.
    names = [name for name, _ in rows]
    plane.log_words(stream, entities.KEY_NAMES, center + half_m * np.array(words), names, colors)


def _follow(run: Run, ghost: Ghost) -> Values:
    """Return the ghost's position at each of the run's poses [m], equally long after its start."""
    since_start_s = (run.poses.time_ns - run.start_ns) / 1e9
    return locate_run(ghost.run, ghost.run.start_ns, since_start_s)[0]


def _find_aside(run: Run, x_m: Values, bounds: plane.Bounds, width: float) -> Values:
    """Return the sideways offset of text [m], away from the goal's name and inside the view."""
    goal_x_m = run.goal_xy_m[0] if run.goal_xy_m is not None else float(run.poses.xy_m[-1, 0])
    side = 1.0 if goal_x_m <= run.poses.xy_m[0, 0] else -1.0
    at = side * (x_m - bounds.center_xy_m[0]) / bounds.half_size_m
    aside = np.minimum(_ASIDE, _REACH - width - at) + width / 2.0
    return np.asarray(side * aside * bounds.half_size_m)
