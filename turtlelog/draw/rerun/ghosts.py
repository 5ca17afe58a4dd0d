"""Ghosts in the plane next to a run, their distance from the run, and a key."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import rerun as rr

from turtlelog.charts import palette
from turtlelog.charts.close_up import format_length
from turtlelog.charts.curves import Values, find_steps
from turtlelog.charts.plotted_curves import TIMELINE, locate_run
from turtlelog.draw.rerun import entities
from turtlelog.draw.rerun.entities import join_path, name_part
from turtlelog.draw.rerun.plane import MOST_SEGMENTS, Look, draw_trail, draw_turtle
from turtlelog.draw.rerun.plots import Series
from turtlelog.draw.rerun.timelines import RunStream, Timelines, build_index
from turtlelog.draw.rerun.world import Bounds, draw_strips, write_words
from turtlelog.run import PoseColumns, Run
from turtlelog.run.angles import wrap_angle

IDEAL: Final = "ideal_loop"
_IDEAL_NAME: Final = "ideal loop"

_MOST_GAPS: Final = 1000
"""Number of rows of the line between run and ghost: as many as a trail has segments."""

_APART_M: Final = 5e-4
"""Smallest distance that is written [m]; a smaller distance would be 0 mm."""

_ONE_M: Final = 1.0
"""Gap from which the plot is in m instead of mm [m]."""

_GAP_WIDTH: Final = 1.0  # [points]
_GAP_ORDER: Final = 27.0  # above turtles
_KEY_LETTER: Final = 0.036
"""Width of a letter, as a share of the plane's half-width: 7 pixels of 200."""

_REACH: Final = 1.2
"""Half-width of the view, as a multiple of the plane's half-width; text beyond it is cut off."""

_ASIDE, _UP = 0.1, -0.1
"""Offset of the distance's text from its line, in half-widths of the plane, away from the goal's
name."""

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
    look = Look(color=palette.GHOST, is_ghost=True)
    ideal = replace(run, poses=poses)
    return Ghost(name=_IDEAL_NAME, prefix=join_path(IDEAL), run=ideal, look=look, is_run=False)


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
    after_s = np.maximum(time_ns - turn.start_ns, 0) / 1e9
    heading_rad = np.radians(turn.respond(after_s))
    driven_s = np.maximum(time_ns - way.start_ns, 0) / 1e9
    along_m = way.respond(driven_s)
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
    stream: rr.RecordingStream, run: Run, ghost: Ghost, bounds: Bounds, words: str
) -> None:
    """Draw a line from the run to a ghost at the cursor, with the distance as text."""
    half_size_m = bounds.half_size_m
    rows = np.unique(
        np.linspace(0, len(run.poses) - 1, min(len(run.poses), _MOST_GAPS)).round().astype(int)
    )
    own_m, other_m = run.poses.xy_m[rows], _follow(run, ghost)[rows]
    gap_m = measure_gap(run, ghost)[rows]
    # On other timelines the distance is different.
    index = build_index({TIMELINE: run.poses.time_ns[rows] - run.start_ns})
    stream.log(
        join_path(entities.GAP),
        rr.LineStrips2D.from_fields(
            radii=rr.Radius.ui_points(_GAP_WIDTH), colors=[palette.GOAL], draw_order=_GAP_ORDER
        ),
        static=True,
    )
    lines = rr.LineStrips2D.columns(strips=[*np.stack([own_m, other_m], axis=1)])
    stream.send_columns(join_path(entities.GAP), index, lines)
    stream.log(
        join_path(entities.GAP_NAME),
        rr.Points2D.from_fields(
            radii=rr.Radius.ui_points(0.0), colors=[palette.GOAL], show_labels=True
        ),
        static=True,
    )
    is_apart = gap_m >= _APART_M
    middles_m = (own_m + other_m)[is_apart] / 2.0
    places_m = middles_m + _UP * half_size_m * np.array([[0.0, 1.0]])
    labels = [f"{words}: {format_length(float(gap))}" for gap in gap_m[is_apart]]
    longest = max(map(len, labels), default=0)
    places_m[:, 0] += _find_aside(run, middles_m[:, 0], bounds, longest * _KEY_LETTER)
    names = rr.Points2D.columns(positions=places_m, labels=labels)
    stream.send_columns(
        join_path(entities.GAP_NAME), index, names.partition(is_apart.astype(np.int64))
    )


def draw_key(
    stream: rr.RecordingStream,
    rows: Sequence[tuple[str, palette.Color]],
    bounds: Bounds,
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
    draw_strips(stream, entities.KEY, lines, colors, 2.5)
    # In a small window samples are hidden, so that the names have their colours.
    names = [name for name, _ in rows]
    write_words(stream, entities.KEY_NAMES, center + half_m * np.array(words), names, colors)


def _follow(run: Run, ghost: Ghost) -> Values:
    """Return the ghost's position at each of the run's poses [m], equally long after its start."""
    since_start_s = (run.poses.time_ns - run.start_ns) / 1e9
    return locate_run(ghost.run, ghost.run.start_ns, since_start_s)[0]


def _find_aside(run: Run, x_m: Values, bounds: Bounds, width: float) -> Values:
    """Return the sideways offset of text [m], on the side without the goal's name.

    `width` is the width of the text, in half-widths of the plane. The text ends inside the view.
    """
    goal_x_m = run.goal_xy_m[0] if run.goal_xy_m is not None else float(run.poses.xy_m[-1, 0])
    side = 1.0 if goal_x_m <= run.poses.xy_m[0, 0] else -1.0
    at = side * (x_m - bounds.center_xy_m[0]) / bounds.half_size_m
    aside = np.minimum(_ASIDE, _REACH - width - at) + width / 2.0
    return np.asarray(side * aside * bounds.half_size_m)
