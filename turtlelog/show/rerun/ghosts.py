"""Ghosts: what might have been, beside the run in the plane; how far apart they are, a key."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import rerun as rr

from turtlelog.run import Run
from turtlelog.show import palette
from turtlelog.show.close_up import format_length
from turtlelog.show.ideal_pose import NAME as IDEAL_LOOP, find_ideal_poses
from turtlelog.show.palette import Color
from turtlelog.show.phase_timelines import TIMELINE, locate_run
from turtlelog.show.rerun import entities
from turtlelog.show.rerun.entities import join_path, name_part
from turtlelog.show.rerun.plots import Series
from turtlelog.show.rerun.timelines import RunStream, Timelines, Values, build_index
from turtlelog.show.rerun.turtles import MOST_SEGMENTS, Look, draw_trail, draw_turtle
from turtlelog.show.rerun.world import Bounds

IDEAL: Final = "ideal_loop"

_MOST_GAPS: Final = 1000
"""Rows of the line between run and ghost: as many as a trail has segments."""

_APART_M: Final = 5e-4
"""Less is not written [m]: it would be 0 mm."""

_ONE_M: Final = 1.0
"""Gaps below are plotted in mm, larger ones in m."""

_GAP_WIDTH: Final = 1.0  # [points]
_GAP_ORDER: Final = 27.0  # above turtles
_ROOM: Final = 0.45
"""Of the plane's half-width, from its middle: beyond, words beside a line would be cut off."""

_ASIDE, _UP = 0.33, -0.1
"""Of the plane's half-width: where the distance stands beside its line, far from goal's name."""

_KEY_LETTER: Final = 0.036
"""Of the plane's half-width: 7 pixels of 200."""

_EDGE: Final = 0.87
"""Of the plane's half-width: inside of the world's border."""

_KEY_LINE: Final = 0.19
"""Of the plane's half-width: 18 pixels in a window of 700 x 450, less than words and frame take."""
_KEY_SAMPLE: Final = 0.1
_KEY_GAP: Final = 0.06
_KEY_UP: Final = 0.055


@dataclass(frozen=True, slots=True, kw_only=True)
class Ghost:
    """What might have been.

    Attributes:
        name: In words.
        prefix: Entity prefix.
        run: Whose poses are the ghost's.
        look: How it is drawn.
        is_run: Whether it was simulated; else only its poses are its own.
    """

    name: str
    prefix: str
    run: Run
    look: Look
    is_run: bool


def build_ideal_ghost(run: Run) -> Ghost | None:
    """Return the ideal loop beside a run, None where theory does not know where it would be."""
    poses = find_ideal_poses(run)
    if poses is None:
        return None
    look = Look(color=palette.GHOST, is_ghost=True)
    ideal = replace(run, poses=poses)
    return Ghost(name=IDEAL_LOOP, prefix=join_path(IDEAL), run=ideal, look=look, is_run=False)


def draw_ghost(
    stream: rr.RecordingStream,
    ghost: Ghost,
    timelines: Timelines,
    half_size_m: float,
    *,
    segments: int = MOST_SEGMENTS,
) -> RunStream:
    """Draw its trail and its turtle."""
    run_stream = RunStream(stream, ghost.prefix, timelines)
    draw_trail(run_stream, ghost.run, ghost.look, segments=segments)
    draw_turtle(run_stream, ghost.run.poses, ghost.look, half_size_m)
    return run_stream


def list_gaps(run: Run, ghosts: Sequence[Ghost]) -> tuple[Series, ...]:
    """Return how far each ghost is from the run at the same time after its start."""
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


def draw_gap(stream: rr.RecordingStream, run: Run, ghost: Ghost, bounds: Bounds) -> None:
    """Draw a line from the run to a ghost at the cursor, and how long it is."""
    half_size_m = bounds.half_size_m
    rows = np.unique(
        np.linspace(0, len(run.poses) - 1, min(len(run.poses), _MOST_GAPS)).round().astype(int)
    )
    own_m, other_m = run.poses.xy_m[rows], _follow(run, ghost)[rows]
    gap_m = measure_gap(run, ghost)[rows]
    # On no other timeline are they this far apart.
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
    places_m[:, 0] += _find_aside(run, middles_m[:, 0], bounds)
    labels = [f"{format_length(float(gap))} apart" for gap in gap_m[is_apart]]
    names = rr.Points2D.columns(positions=places_m, labels=labels)
    stream.send_columns(
        join_path(entities.GAP_NAME), index, names.partition(is_apart.astype(np.int64))
    )


def draw_key(
    stream: rr.RecordingStream,
    rows: Sequence[tuple[str, Color]],
    bounds: Bounds,
    runs: Sequence[Run],
) -> None:
    """Name the turtles of a plane where fewest of their poses are."""
    half_m = bounds.half_size_m
    longest = max(len(name) for name, _ in rows) * _KEY_LETTER + _KEY_GAP
    width = _KEY_SAMPLE + _KEY_GAP + longest
    xy = (np.concatenate([run.poses.xy_m for run in runs]) - bounds.center_xy_m) / half_m
    height = _KEY_LINE * (len(rows) + 1)
    lefts, tops = (-_EDGE, _EDGE - width, -width / 2.0), (height - _EDGE, _EDGE, height / 2.0)

    def count_hidden(corner: tuple[float, float]) -> int:
        across = (xy[:, 0] > corner[0]) & (xy[:, 0] < corner[0] + width)
        return int((across & (xy[:, 1] > corner[1] - height) & (xy[:, 1] < corner[1])).sum())

    # Of places that are as empty the first: the lower left.
    left, top = min(((x, y) for y in tops for x in lefts), key=count_hidden)
    ys = top - _KEY_LINE * (np.arange(len(rows)) + 1.0)
    samples = [[(left, y), (left + _KEY_SAMPLE, y)] for y in ys]
    middle = left + _KEY_SAMPLE + _KEY_GAP
    words = [
        (middle + len(name) * _KEY_LETTER / 2.0, y + _KEY_UP)
        for (name, _), y in zip(rows, ys, strict=True)
    ]
    center = np.array(bounds.center_xy_m)
    stream.log(
        join_path(entities.KEY),
        rr.LineStrips2D(
            [center + half_m * np.array(sample) for sample in samples],
            radii=rr.Radius.ui_points(2.5),
            colors=[color for _, color in rows],
        ),
        static=True,
    )
    stream.log(
        join_path(entities.KEY_NAMES),
        rr.Points2D(
            center + half_m * np.array(words),
            radii=rr.Radius.ui_points(0.0),
            # Where the window is small they hide the samples.
            colors=[color for _, color in rows],
            labels=[name for name, _ in rows],
            show_labels=True,
        ),
        static=True,
    )


def _follow(run: Run, ghost: Ghost) -> Values:
    """Return where the ghost is at each of the run's poses, as long after its start [m]."""
    since_start_s = (run.poses.time_ns - run.start_ns) / 1e9
    return locate_run(ghost.run, ghost.run.start_ns, since_start_s)[0]


def _find_aside(run: Run, x_m: Values, bounds: Bounds) -> Values:
    """Return how far to the right words stand [m]: where the goal has no name, if there is room."""
    goal_x_m = run.goal_xy_m[0] if run.goal_xy_m is not None else float(run.poses.xy_m[-1, 0])
    side = 1.0 if goal_x_m <= run.poses.xy_m[0, 0] else -1.0
    has_room = side * (x_m - bounds.center_xy_m[0]) < _ROOM * bounds.half_size_m
    return np.where(has_room, side, -side) * _ASIDE * bounds.half_size_m
