"""Content of a run in the plane: turtle, trace and trail, error and command, events."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from turtlelog.charts import palette
from turtlelog.charts.curves import Values
from turtlelog.charts.plane_scene import (
    find_break_rows,
    has_own_way,
    read_pace,
    read_way_to_reference,
)
from turtlelog.draw.rerun import entities
from turtlelog.draw.rerun.timelines import RunStream, choose_trace_rows
from turtlelog.draw.rerun.world import UPWARD
from turtlelog.run import Event, PoseColumns, Run

_SPEED_LEVELS: Final = 16
_TRACE_RADIUS: Final = 1.5  # [points], as are the others
_SPEED_RADIUS: Final = 1.75
_ARROW_SHARE: Final = 0.12
_ARROW_RADIUS: Final = 2.5
_THIN_RADIUS: Final = 1.0
_SENSED_RADIUS: Final = 1.25
_BELOW_TRACES: Final = 18.0  # lines have 20
_ON_TRACES: Final = 22.0
_EVENT_RADIUS: Final = 4.0
_LOST_AGAIN: Final = frozenset({"poses_lost", "commands_lost"})
"""Kinds of events that random effects cause every few samples. Only the list of events shows
them."""
_ABOVE_TRACES: Final = 28.0  # below points, which have 30


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SpeedTrace:
    """A path in colours of its speed."""

    strips: list[Values]  # segments of one colour [m], each of shape (n, 2)
    colors: list[palette.Color]  # colour of each strip; brighter means faster
    highest_m_s: float  # speed of the brightest colour [m/s]


def draw_growing_path(run_stream: RunStream, run: Run) -> None:
    """Draw the path of a growing run, which has been driven whole, as one bright path."""
    run_stream.log(entities.PLANE, UPWARD)
    strips = _part_strip(run)
    _log_strips(run_stream, entities.PATH, strips, [palette.MAIN] * len(strips), _TRACE_RADIUS)


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


def draw_speed_trace(run_stream: RunStream, trace: SpeedTrace) -> None:
    """Draw the whole path in colours of its speed."""
    _log_strips(run_stream, entities.SPEED_PATH, trace.strips, trace.colors, _SPEED_RADIUS)


def draw_reference_path(run_stream: RunStream, run: Run) -> None:
    """Draw the path of a recorded reference pose, as strips where the reference is known.

    Another function draws the path that a law tracks.
    """
    xy_m = run.samples.reference_xy_m
    if xy_m is None or not has_own_way(run):
        return
    known = np.isfinite(xy_m[:, 0]).astype(np.int64)
    stretches = [s for s in _split_where_changed(known) if known[s[0]]]
    strips = [xy_m[first:after] for first, after in stretches]
    colors = [palette.REFERENCE] * len(strips)
    _log_strips(run_stream, entities.REFERENCE_PATH, strips, colors, _TRACE_RADIUS)


def draw_sensed(run_stream: RunStream, run: Run) -> None:
    """Draw the sensed poses, and the true pose where a sensed pose dropped out."""
    xy_m, lost = run.poses.sensed_xy_m, np.flatnonzero(run.poses.dropped_out)
    if xy_m is None:
        return
    kept = choose_trace_rows(run)
    lost_m = run.poses.xy_m[np.intersect1d(kept, lost)]
    for entity, places_m, color, order in (
        (entities.SENSED_PLACES, xy_m[kept], palette.SENSED, _BELOW_TRACES),
        (entities.DROPPED_PLACES, lost_m, palette.DROPPED_OUT, _ON_TRACES),
    ):
        points = rr.Points2D(
            places_m[np.isfinite(places_m[:, 0])],
            radii=rr.Radius.ui_points(_SENSED_RADIUS),
            colors=[color],
            draw_order=order,
        )
        run_stream.log(entity, points)


def draw_reference_pose(run_stream: RunStream, run: Run, half_size_m: float) -> None:
    """Draw a recorded reference pose at the cursor as an arrow."""
    xy_m, heading_rad = run.samples.reference_xy_m, run.samples.reference_heading_rad
    if xy_m is None or heading_rad is None or not np.isfinite(heading_rad).any():
        return
    _log_arrow_style(run_stream, entities.REFERENCE_POSE, palette.GOAL, _ARROW_RADIUS)
    ways = half_size_m * _ARROW_SHARE * np.column_stack([np.cos(heading_rad), np.sin(heading_rad)])
    values = np.column_stack([xy_m, ways])
    run_stream.send(entities.REFERENCE_POSE, run.samples.time_ns, values, _build_known_arrows)


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
        run_stream.send(entities.ERROR, run.poses.time_ns, values, _build_error)
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


def list_placed(run: Run) -> list[Event]:
    """Return the events that are marked, without frequent losses, which would cover others."""
    return [event for event in run.events if event.kind not in _LOST_AGAIN]


def draw_event_places(run_stream: RunStream, run: Run) -> None:
    """Mark the turtle's places at events. The viewer shows each event's name at the pointer."""
    events = list_placed(run)
    times_ns = [event.time_ns for event in events]
    rows = np.searchsorted(run.poses.time_ns, times_ns, side="right") - 1
    points = rr.Points2D(
        run.poses.xy_m[np.maximum(rows, 0)],
        radii=rr.Radius.ui_points(_EVENT_RADIUS),
        colors=[
            palette.WALL_HIT if event.kind == "wall_hit" else palette.EVENT for event in events
        ],
        labels=[event.kind.replace("_", " ") for event in events],
        show_labels=False,
    )
    run_stream.log(entities.EVENT_PLACES, points)


def _split_where_changed(values: NDArray[np.int64]) -> Iterator[tuple[int, int]]:
    """Yield the first row of each segment of equal values, and the row after the segment."""
    bounds = [0, *(np.flatnonzero(np.diff(values)) + 1).tolist(), len(values)]
    for first, last in pairwise(bounds):
        if last > first:
            yield first, last


def _log_strips(
    run_stream: RunStream,
    entity: str,
    strips: list[Values],
    colors: list[palette.Color],
    radius: float,
) -> None:
    radii = rr.Radius.ui_points(radius)
    run_stream.log(entity, rr.LineStrips2D(strips, radii=radii, colors=palette.pack_colors(colors)))


def _log_arrow_style(
    run_stream: RunStream, entity: str, color: palette.Color, radius: float = _THIN_RADIUS
) -> None:
    style = rr.Arrows2D.from_fields(
        colors=[color], radii=rr.Radius.ui_points(radius), draw_order=_ABOVE_TRACES
    )
    run_stream.log(entity, style)


def _build_known_arrows(values: Values) -> rr.ComponentColumnList:
    """Build one arrow per row. A row of NaN draws no arrow, and removes the previous arrow."""
    known = np.isfinite(values).all(axis=1)
    columns = rr.Arrows2D.columns(origins=values[known, :2], vectors=values[known, 2:])
    return columns.partition(known.astype(np.int64))


def _build_error(values: Values) -> rr.ComponentColumnList:
    return rr.Arrows2D.columns(origins=values[:, :2], vectors=values[:, 2:])


def _build_command(values: Values) -> rr.ComponentColumnList:
    zeros = np.zeros(len(values))
    vectors = np.column_stack([values[:, 0], zeros, zeros, values[:, 1]]).reshape(-1, 2)
    origins = np.tile([(0.0, 0.0), (1.0, 0.0)], (len(values), 1))
    lengths = np.full(len(values), 2)
    return rr.Arrows2D.columns(origins=origins, vectors=vectors).partition(lengths)


MOST_SEGMENTS: Final = 1000
"""Largest number of segments of a trail; the viewer looks up each segment in every frame."""

_ALL_SEGMENTS: Final = 8000
"""Largest number of segments of all trails. With more segments, the viewer takes longer than a
frame of 1/30 s."""

_FEWEST_SEGMENTS: Final = 40
"""Smallest number of segments of a trail among many. A path as long as the window then grows in
steps of 20 pixels."""

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
"""Strokes of a turtle with their radii, in radii of the shell, x ahead: shell, head, tail and
legs."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Look:
    """The style of a turtle and its trail."""

    color: palette.Color  # colour of turtle and trail
    is_ghost: bool = False  # whether its shell is hollow, and behind other turtles
    width: float = _TRACE_RADIUS  # radius of the trail [points]
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
    shade = _shade(look.color, 0.3 if look.is_ghost else 1.3)
    for entity, strokes, color, above in (
        (entities.BODY, _BODY, look.color, 0.0),
        (entities.SHELL, (_SHELL,), shade, 1.0),
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
    run_stream.log(entities.PLANE, UPWARD)
    strips = _part_strip(run)
    # The part that is not driven yet is faint.
    faint = palette.pack_colors([look.color] * len(strips)) & 0xFFFFFF00 | _FAINT
    radii = rr.Radius.ui_points(look.width)
    run_stream.log(entities.PATH, rr.LineStrips2D(strips, radii=radii, colors=faint))
    _send_trail(run_stream, run, look, segments)


def _send_trail(run_stream: RunStream, run: Run, look: Look, segments: int) -> None:
    """Send the trail in segments, each at the time of its last pose. Views show past segments.

    Segments never span a gap in the poses, and always have a length.
    """
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


def _shade(color: palette.Color, factor: float) -> palette.Color:
    red, green, blue = (min(round(factor * part), 255) for part in color)
    return red, green, blue


def _build_transforms(values: Values) -> rr.ComponentColumnList:
    half_rad, zeros = values[:, 2] / 2.0, np.zeros(len(values))
    return rr.Transform3D.columns(
        translation=np.column_stack([values[:, :2], zeros]),
        quaternion=np.column_stack([zeros, zeros, np.sin(half_rad), np.cos(half_rad)]),
    )
