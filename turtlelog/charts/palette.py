"""The meaning of each colour, dash and marker in all pictures, for colour-blind readers.

A run has a colour, and in print also a marker. A loop of its law has a dash. The kind of any other
curve determines its colour and dash.
"""

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Final, Literal

import numpy as np
from numpy.typing import NDArray

from turtlelog.run.loops import DONE, PAUSE

if TYPE_CHECKING:
    from turtlelog.charts.plotted_curves import CurveKind

Color = tuple[int, int, int]

FEW: Final[tuple[Color, ...]] = (
    (0, 114, 178),
    (184, 125, 2),
    (17, 157, 92),
    (228, 108, 160),
    (141, 80, 45),
    (0, 160, 206),
    (108, 102, 0),
)
"""Hues after Okabe and Ito for colour-blind readers, with a contrast of at least 3:1 to white and
dark.

The first four differ in grey by at least 0.08 of white.
"""

_OF_CAUSES: Final[tuple[Color, ...]] = (
    (196, 20, 52),
    (164, 196, 116),
    (148, 116, 244),
    (212, 20, 180),
    (84, 68, 244),
    (212, 100, 100),
)
"""Colours of causes, as far as possible in CIELAB from the colours of runs and from each other,
also for red-green blind readers. All are visible on white and on black."""

_RAMP: Final[tuple[Color, ...]] = (
    (38, 69, 247),
    (62, 88, 216),
    (64, 110, 184),
    (62, 134, 146),
    (106, 147, 84),
    (176, 145, 33),
)
"""Ramp of many runs. The lightness increases from end to end, so that the order is visible even in
grey. The contrast of 3:1 to white paper and dark ground leaves half of the range of lightness."""

_SHADES: Final[tuple[Color, ...]] = (
    (94, 73, 190),
    (32, 138, 204),
    (12, 172, 155),
    (108, 194, 92),
    (188, 200, 42),
    (250, 206, 60),
)
"""Ramp of values in cells: with no required contrast, twice the range of lightness."""

# Of the palette of Okabe and Ito.
_YELLOW: Final[Color] = (240, 228, 66)
_VERMILION: Final[Color] = (213, 94, 0)
_PURPLE: Final[Color] = (204, 121, 167)

GROUND: Final[Color] = (13, 13, 13)
"""Background of planes, also in a light theme. Plots follow the theme, like their cursor."""

REFERENCE: Final[Color] = (150, 150, 150)
"""Colour of goal bearing, goal position, limits, world border and moving references."""

TRACKED: Final[Color] = (95, 95, 95)
"""Colour of tracked paths: broad lines, dark enough that the driven path is visible on them."""

WALLS: Final[Color] = (118, 118, 118)
"""Colour of scans' end points, below the driven paths and still visible on the ground."""

SCAN: Final[Color] = (232, 128, 52)  # colour of the robot's present scan

OCCUPANCY_COLORS: Final[tuple[tuple[int, int, int, int], ...]] = tuple(
    (26 + shade, 26 + shade, 28 + shade, 255)
    for shade in (69 * percent // 100 for percent in range(101))
)
"""Colours of map cells from free to occupied, from a shade above the ground to the shade of a
tracked path."""

COST_COLORS: Final[tuple[tuple[int, int, int, int], ...]] = tuple(
    (*_PURPLE, 0 if percent == 0 else 20 + percent) for percent in range(101)
)
"""Colours of costmap cells: lower layers stay visible, and cells without cost have none."""

PATH_OF_MANY: Final[Color] = (105, 105, 105)
"""Colour of the paths of very many runs on dark ground; only their ends have other colours."""

GOAL: Final[Color] = (255, 255, 255)  # colour of goals on `GROUND`
GOAL_ON_WHITE: Final[Color] = (0, 0, 0)  # colour of goals in print

GOAL_ON_ANY: Final[Color] = (138, 138, 138)
"""Colour of goals, and of the rings around them, on pages whose theme is light or dark."""

START: Final[Color] = (190, 190, 190)

COMMAND: Final[Color] = _YELLOW  # colour of the arrow of the command at a turtle
SHAPED: Final[Color] = FEW[3]  # colour of shaped commands, before the limits

MEASURED: Final[Color] = FEW[2]
"""Colour of the robot's response to a command: the reported or applied rate."""

MODEL: Final[Color] = FEW[1]
"""Colour of an identified model's response to a command, which is shown only for a single run."""

SENSED: Final[Color] = (128, 128, 128)  # colour of sensed poses
DROPPED_OUT: Final[Color] = (128, 128, 128)  # colour of poses that dropped out

GHOST: Final[Color] = (170, 170, 170)
"""Colour of ghosts: a run without the acting effects, or the ideal loop."""

IDEAL: Final[Color] = (128, 128, 128)
"""Colour of ideal responses and moving references: at least 3.9:1 to white and to `GROUND`."""

DEAD_TIME: Final[Color] = _PURPLE
"""Colour of dead times: of the bar below the bars of the phases, and of spans in plots."""

EVENT: Final[Color] = (176, 124, 64)  # colour of events
WALL_HIT: Final[Color] = _VERMILION  # colour of a turtle's contacts with the wall
PAUSED: Final[Color] = _VERMILION  # colour of the start and end of a pause
ERROR: Final[Color] = _PURPLE  # colour of the arrow from the turtle to the goal

VIOLATION: Final[Color] = (208, 52, 44)
"""Colour of violations: 5:1 to white, 3.7:1 to dark. No run and no phase has this red."""

FULFILLED: Final[Color] = (0, 103, 75)  # colour of a check that holds, on white

OUTLIER: Final[Color] = (198, 40, 40)  # colour of measurements left out of a fit, on white

TIME_CONSTANT: Final[Color] = (86, 180, 233)  # colour of time constants, beside `DEAD_TIME`

OVERSHOOT: Final[Color] = (176, 112, 0)  # colour of gains from which a loop overshoots, on white
OVERSHOOT_ON_CELLS: Final[Color] = (122, 75, 0)  # the same on coloured cells
OVERSHOOTING: Final[Color] = (230, 159, 0)  # colour of the range of such gains, transparent

VERDICTS: Final[tuple[Color, Color, Color]] = ((232, 162, 143), (217, 217, 217), (154, 199, 224))
"""Colours of cells that are unstable, between and stable: of differing lightness, and light below
lines."""

UNSTABLE: Final[Color] = (179, 38, 30)
"""Colour of unstable settings and of missing values, on white."""

ALLOWED: Final[Color] = (128, 128, 128)
"""Colour of the allowed band of a check, thin enough that curves on it are visible."""


def choose_run_colors(count: int) -> tuple[Color, ...]:
    """Return one colour per run: distinct hues for a few runs, an ordered ramp for many."""
    if count <= len(FEW):
        return FEW[:count]
    return _mix(_RAMP, count)


def choose_shades(count: int) -> tuple[Color, ...]:
    """Return colours for increasing values, for cells and broad strokes."""
    return _mix(_SHADES, count)


def choose_cause_colors(names: Sequence[str]) -> dict[str, Color]:
    """Return a colour for each cause, in the given order, different from the colours of runs.

    There are six colours, one for each cause of an attribution; for more causes they repeat.
    """
    return {name: _OF_CAUSES[number % len(_OF_CAUSES)] for number, name in enumerate(names)}


_OF_EVERY_LAW: Final[Mapping[str, Color]] = {PAUSE: (140, 70, 20), DONE: (90, 90, 90)}

_BY_ORDER: Final = (
    (46, 96, 148),
    (20, 110, 84),
    (112, 104, 20),
    (132, 62, 102),
    (88, 72, 166),
    (70, 106, 24),
    (150, 58, 66),
    (24, 104, 118),
)
"""Hues of phases in declared order. With more phases, the hues repeat."""


def choose_phase_colors(names: Sequence[str]) -> tuple[Color, ...]:
    """Return colours of the phase bars in declared order; `pause` and `done` have special colours.

    The colours are dark enough for the viewer's white letters, and are used nowhere else.
    """
    own = [name for name in names if name not in _OF_EVERY_LAW]
    by_name = {name: _BY_ORDER[number % len(_BY_ORDER)] for number, name in enumerate(own)}
    return tuple((by_name | {**_OF_EVERY_LAW})[name] for name in names)


def tint(color: Color) -> Color:
    """Return a lighter colour for a second curve of the same run."""
    red, green, blue = (part + (255 - part) * 9 // 20 for part in color)
    return red, green, blue


def darken(color: Color) -> Color:
    """Return a darker colour, for text and thin strokes on white."""
    red, green, blue = (part * 7 // 10 for part in color)
    return red, green, blue


def dim(color: Color) -> Color:
    """Return a colour halfway to the dark ground, for background items."""
    red, green, blue = ((part + ground) // 2 for part, ground in zip(color, GROUND, strict=True))
    return red, green, blue


def to_hex(color: Color) -> str:
    """Return a colour in the notation of HTML, which Matplotlib also reads."""
    return "#{:02x}{:02x}{:02x}".format(*color)


def pack_colors(colors: Sequence[Color]) -> NDArray[np.uint32]:
    """Return opaque colours in the format that is fastest for Rerun, shape (n,)."""
    red, green, blue = np.array(colors, dtype=np.uint32).reshape(-1, 3).T
    return (red << 24 | green << 16 | blue << 8 | 255).astype(np.uint32)


def _mix(ramp: Sequence[Color], count: int) -> tuple[Color, ...]:
    places = np.linspace(0.0, len(ramp) - 1.0, count)
    reds, greens, blues = (
        np.interp(places, range(len(ramp)), part).round().astype(int).tolist()
        for part in zip(*ramp, strict=True)
    )
    return tuple(zip(reds, greens, blues, strict=True))


MAIN: Final[Color] = choose_run_colors(1)[0]  # colour of a single run

Dash = Literal["solid", "dashed", "dotted", "dash-dot"]
Marker = Literal["up", "diamond", "down", "plus", "star", "left", "right"]

_FIXED: Final["Mapping[CurveKind, Color]"] = {
    "applied": MEASURED,
    "shaped": SHAPED,
    "ideal": IDEAL,
    "aim": IDEAL,
    "sensed": SENSED,
    "dropped_out": DROPPED_OUT,
}
"""Kinds of curves whose colour is the same for every run."""

_DASHES: Final["Mapping[CurveKind, Dash]"] = {
    "ideal": "dotted",
    "aim": "dash-dot",
    "shaped": "dash-dot",
}
"""Dashes of all kinds of curves except the run's own."""

LIMIT_DASH: Final[Dash] = "dashed"  # dash of limits and tolerances; references are solid

SUPPOSED_DASH: Final[Dash] = "dashed"
"""Dash of curves that did not happen: a run without some effects, the output of a model."""

LOOP_DASHES: Final[tuple[Dash, ...]] = ("solid", "dashed", "dash-dot", "dotted")
"""Dashes of a law's loops in declared order. With more loops, the dashes repeat."""

RUN_MARKERS: Final[tuple[Marker, ...]] = ("up", "diamond", "down", "plus", "star", "left", "right")
"""Markers of runs with distinct hues; discs, squares and crosses mark places and values."""


def choose_curve_color(kind: "CurveKind", run: Color, *, is_alone: bool) -> Color:
    """Return the colour of a curve; `run` is the colour of its run.

    If the picture has other runs, measured values have the colour of their run.
    """
    if kind in ("measured", "outlier"):
        return MEASURED if is_alone else run
    if kind == "beside":
        return tint(run)
    if kind == "applied" and not is_alone:
        return run
    return _FIXED.get(kind, run)


def choose_dash(kind: "CurveKind") -> Dash:
    """Return the dash of a curve of a run, which depends on the kind of the curve."""
    return _DASHES.get(kind, "solid")


_FEW_TURTLES: Final = 4  # largest number of turtles of full size; more are smaller

_SMALLEST_TURTLE: Final = 0.3
"""Smallest share of a turtle's full size: a shell of 4 pixels, as large as the dot."""


def choose_turtle_size(turtles: int) -> float:
    """Return the size of each turtle in a group. Many turtles cover as much area as a few."""
    return max(min(1.0, math.sqrt(_FEW_TURTLES / max(turtles, 1))), _SMALLEST_TURTLE)


def choose_markers(count: int) -> tuple[Marker, ...]:
    """Return markers that distinguish several runs. A single run, and very many runs, have none."""
    return RUN_MARKERS[:count] if 1 < count <= len(RUN_MARKERS) else ()
