"""The turtle in the plane, and its trail: the way until the cursor, and faintly the rest."""

from dataclasses import dataclass
from typing import Final

import numpy as np
import rerun as rr

from turtlelog.charts import palette
from turtlelog.charts.palette import Color
from turtlelog.charts.robot_curves import find_break_rows
from turtlelog.draw.rerun import entities
from turtlelog.draw.rerun.timelines import RunStream, Values, choose_trace_rows
from turtlelog.draw.rerun.world import UPWARD
from turtlelog.run import PoseColumns, Run

MOST_SEGMENTS: Final = 1000
"""Of a trail: the viewer looks each one up in every frame."""

_ALL_SEGMENTS: Final = 8000
"""Of all trails together: with more the viewer takes longer than a frame of 1/30 s."""

_FEWEST_SEGMENTS: Final = 40
"""Of a trail among many: on its way of a window's height it grows by steps of 20 pixels."""

_FAINT: Final = 45
"""Alpha of the way that is not driven yet, of 255: it is seen, and not taken for the trail."""

_SIZE: Final = 0.07
"""Radius of the shell, as a part of the plane's half-width: 14 pixels of a view of 400."""

_DOT_RADIUS: Final = 5.0  # [points]
_ARROW_SHARE: Final = 0.2
_ARROW_RADIUS: Final = 1.5  # [points]
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
"""Strokes with their radii, in radii of the shell, ahead along x: shell, head, tail and legs."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Look:
    """How a turtle and its trail are drawn.

    Attributes:
        color: Of both.
        is_ghost: Whether it might have been: its shell is hollow, and it is behind the others.
        width: Radius of the trail [points].
        size: Of the turtle; 1 is that of a run.
    """

    color: Color
    is_ghost: bool = False
    width: float = 1.5
    size: float = 1.0


def count_segments(trails: int) -> int:
    """Return how many segments each of so many trails may have."""
    return max(min(MOST_SEGMENTS, _ALL_SEGMENTS // max(trails, 1)), _FEWEST_SEGMENTS)


def draw_turtle(run_stream: RunStream, poses: PoseColumns, look: Look, half_size_m: float) -> None:
    """Draw the turtle where it is at the cursor, with an arrow along its heading.

    All begin with the first pose: a turtle without one would stand at the origin.
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
        radii=rr.Radius.ui_points(_ARROW_RADIUS), colors=[look.color], draw_order=order
    )
    run_stream.log(entities.ARROW, heading)
    length_m = half_size_m * _ARROW_SHARE * look.size
    run_stream.send_few(entities.ARROW, first_ns, rr.Arrows2D.columns(vectors=[(length_m, 0.0)]))
    values = np.column_stack([poses.xy_m, poses.heading_rad])
    run_stream.send(entities.TURTLE, poses.time_ns, values, _build_transforms)


def draw_trail(
    run_stream: RunStream, run: Run, look: Look, *, segments: int = MOST_SEGMENTS
) -> None:
    """Draw the whole way faintly, and the driven part of it as a trail."""
    run_stream.log(entities.PLANE, UPWARD)
    strips = part_strip(run)
    # What is not driven yet is faint.
    faint = palette.pack_colors([look.color] * len(strips)) & 0xFFFFFF00 | _FAINT
    radii = rr.Radius.ui_points(look.width)
    run_stream.log(entities.PATH, rr.LineStrips2D(strips, radii=radii, colors=faint))
    _send_trail(run_stream, run, look, segments)


def _send_trail(run_stream: RunStream, run: Run, look: Look, segments: int) -> None:
    """Send the trail in segments, each at the time of its last pose; a view shows those until now.

    None leads over a break of the poses or stands still.
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


def part_strip(run: Run) -> list[Values]:
    """Return the path in strips, parted where nobody drove from one pose to the next."""
    rows = np.arange(len(run.poses))[choose_trace_rows(run)]
    strips = np.split(run.poses.xy_m[rows], np.searchsorted(rows, find_break_rows(run)))
    return [strip for strip in strips if len(strip)]


def _shade(color: Color, factor: float) -> Color:
    red, green, blue = (min(round(factor * part), 255) for part in color)
    return red, green, blue


def _build_transforms(values: Values) -> rr.ComponentColumnList:
    half_rad, zeros = values[:, 2] / 2.0, np.zeros(len(values))
    return rr.Transform3D.columns(
        translation=np.column_stack([values[:, :2], zeros]),
        quaternion=np.column_stack([zeros, zeros, np.sin(half_rad), np.cos(half_rad)]),
    )
