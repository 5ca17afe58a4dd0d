"""The close-up of the goal in the viewer: rings, ends and distances, at every time the same."""

from collections.abc import Sequence
from typing import Final

import numpy as np
import rerun as rr

from turtlelog.run import Run
from turtlelog.show import palette
from turtlelog.show.close_up import (
    CloseUp,
    Label,
    Lettering,
    format_length,
    list_miss_labels,
    list_ring_labels,
)
from turtlelog.show.rerun import entities
from turtlelog.show.rerun.entities import join_path
from turtlelog.show.run_colors import Color

_LETTERING: Final = Lettering(letter=0.06, line=0.2, gap=0.1, reach=1.6)
"""As measured in a window of 1200 x 860 pixels, where 125 pixels are half of the close-up."""

_BESIDE_SHARES: Final = Lettering(letter=0.09, line=0.3, gap=0.15, reach=2.1)
"""Likewise where bars of shares stand below it: there are but 85 pixels."""

_ABOVE: Final = 0.6
"""The viewer writes words below their point: so far, in lines."""

_END_RADIUS: Final = 4.0  # [points]
_RING_RADIUS: Final = 0.5
_RING: Final[Color] = (80, 80, 80)
_RING_POINTS: Final = 97


def draw_close_up(
    stream: rr.RecordingStream,
    close_up: CloseUp,
    run: Run,
    prefixes: Sequence[str],
    colors: Sequence[Color],
    *,
    is_small: bool = False,
) -> None:
    """Draw where each run ends, in its colour, and how far from the goal that is.

    Args:
        stream: The recording.
        close_up: What is shown.
        run: One of them; from where it starts, they come.
        prefixes: Entity prefix of each run.
        colors: Colour of each run.
        is_small: Whether the view is lower than usual, since bars stand below it.
    """
    for end in close_up.ends:
        dot = rr.Points2D(
            [end.xy_m],
            radii=rr.Radius.ui_points(_END_RADIUS),
            colors=[colors[end.run]],
            labels=[f"ends {format_length(end.miss_m)} from the goal"],
            show_labels=False,
        )
        stream.log(join_path(prefixes[end.run], entities.END), dot, static=True)
    lettering = _BESIDE_SHARES if is_small else _LETTERING
    misses = list_miss_labels(close_up, lettering)
    rings = list_ring_labels(close_up, run.poses.xy_m[0], misses, lettering)
    up_m = _ABOVE * lettering.line * close_up.half_m
    _write(
        stream,
        entities.MISSES,
        up_m,
        misses,
        [_choose_color(label, colors) for label in misses],
    )
    _write(stream, entities.RING_NAMES, up_m, rings, [palette.REFERENCE] * len(rings))
    turns_rad = np.linspace(0.0, 2.0 * np.pi, _RING_POINTS)
    circle = np.column_stack([np.cos(turns_rad), np.sin(turns_rad)])
    strips = rr.LineStrips2D(
        [np.array(close_up.goal_xy_m) + ring_m * circle for ring_m in close_up.rings_m],
        radii=rr.Radius.ui_points(_RING_RADIUS),
        colors=[_RING],
    )
    stream.log(join_path(entities.RINGS), strips, static=True)


def _choose_color(label: Label, colors: Sequence[Color]) -> Color:
    """Return the colour of the run that the words are of, grey where there are several."""
    return colors[label.runs[0]] if len(label.runs) == 1 else palette.START


def _write(
    stream: rr.RecordingStream,
    entity: str,
    up_m: float,
    labels: Sequence[Label],
    colors: Sequence[Color],
) -> None:
    words = rr.Points2D(
        [(label.xy_m[0], label.xy_m[1] + up_m) for label in labels],
        radii=rr.Radius.ui_points(0.0),
        colors=colors,
        labels=[label.text for label in labels],
        show_labels=True,
    )
    stream.log(join_path(entity), words, static=True)
