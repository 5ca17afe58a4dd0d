"""Close-ups: the ends of runs around their goal, and where a run is furthest off its path."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from turtlelog.charts.curves import Values
from turtlelog.charts.plane_scene import Point, list_paths
from turtlelog.display import cut_name
from turtlelog.measure import find_signal
from turtlelog.run import Run

ARRIVED_M: Final = 1.0
"""Distance from the goal beyond which a run has not arrived [m].

The paper's runs miss by 1 to 107 mm on a path of 5.7 m. A close-up with 1 m or more to each side
would look like the plane.
"""

_ROOM: Final = 1.25
"""Half-width as a multiple of the furthest end's distance, with room for its dot and text."""

_TOLERANCES: Final = 3.0
"""Smallest half-width, in tolerances of the law, so that their square is visible."""

_LEAST_HALF_M: Final = 1e-3
_HALVES: Final = ((1.2, 0.5), (1.5, 0.5), (2.5, 1.0), (4.0, 1.0), (6.0, 2.0), (8.0, 2.0))
"""Half-widths and distances between rings in one decade; each half-width has two or three rings."""

_MOST_LISTED: Final = 3  # distances in one label; of more, it gives the smallest and the largest
_MOST_TOLD: Final = 12  # ends with text; of more, only the furthest, as text would hide the dots

_LONGEST: Final = 16
"""Longest name [letters]; with its distance it takes half of a close-up 430 pixels wide."""

_SHIFTS: Final = (0.0, 0.5, -0.5, 1.0, -1.0)
"""Upward offsets of text from its dot, best first [lines]."""

_ANGLES_RAD: Final = np.radians([90.0, -90.0, 60.0, 120.0, -60.0, -120.0, 45.0, 135.0])
"""Angles for the names of the rings, best first [rad]; names above each other need least room."""

_RING_POINTS: Final = 97  # number of points of a ring: one per 4 degrees


@dataclass(frozen=True, slots=True, kw_only=True)
class End:
    """End of a run."""

    run: int  # number of the run
    xy_m: Point  # position of the run's last pose [m]
    miss_m: float  # distance from this position to the goal [m]
    name: str = ""  # name of the run next to its distance; empty if there is a legend


@dataclass(frozen=True, slots=True, kw_only=True)
class CloseUp:
    """Content of the close-up."""

    goal_xy_m: Point  # position of the goal, at the centre [m]
    half_m: float  # half of the close-up's width and height, a round length [m]
    rings_m: tuple[float, ...]  # radii of the rings, round lengths, rising [m]
    ends: tuple[End, ...]  # ends of the runs inside the close-up, nearest first
    outside: int  # number of runs with this goal that end outside

    def list_rings(self) -> list[Values]:
        """Return the rings as lines [m], each of shape (n, 2)."""
        turns_rad = np.linspace(0.0, 2.0 * np.pi, _RING_POINTS)
        circle = np.column_stack([np.cos(turns_rad), np.sin(turns_rad)])
        return [np.array(self.goal_xy_m) + ring_m * circle for ring_m in self.rings_m]

    def describe(self) -> str:
        """Return the half-width and the number of runs outside, for a title."""
        return f"±{format_length(self.half_m)}{self.count_outside()}"

    def count_outside(self) -> str:
        """Return the number of runs outside, for the end of a title; empty if no run is outside."""
        count = self.outside + len(self.ends)
        return f", {self.outside} of {count} runs outside" if self.outside else ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Lettering:
    """Size of text in a picture, in half-widths of the close-up.

    Of too many ends only the furthest has text, and the last run (highest gain) if runs have names.
    """

    letter: float  # width of a letter
    line: float  # height of a line
    gap: float  # distance between a dot and its text
    reach: float = 1.0  # from the goal to the left and right border, which may be far away
    most_told: int = _MOST_TOLD  # number of ends that can all have text


@dataclass(frozen=True, slots=True, kw_only=True)
class Label:
    """Text in the close-up."""

    text: str  # one or more distances. With names of runs, each has a line, in the order of `runs`
    xy_m: Point  # centre of the text [m]
    runs: tuple[int, ...] = ()  # numbers of the runs whose ends it labels; empty for a ring


def find_close_up(runs: Sequence[Run]) -> CloseUp | None:
    """Return a close-up of every arrival; None without a common goal, or if no run arrived."""
    goals = {run.goal_xy_m for run in runs if run.goal_xy_m is not None}
    if len(goals) != 1:
        return None
    (goal,) = goals
    found = []
    for number, run in enumerate(runs):
        if run.goal_xy_m is not None:
            x_m, y_m = run.poses.xy_m[-1].tolist()
            miss_m = float(np.hypot(goal[0] - x_m, goal[1] - y_m))
            found.append(End(run=number, xy_m=(x_m, y_m), miss_m=miss_m))
    arrived_m = [end.miss_m for end in found if end.miss_m < ARRIVED_M]
    if not arrived_m:
        return None
    tolerance_m = max((find_tolerance(run) or 0.0) for run in runs)
    half_m, rings_m = choose_rings(max(*arrived_m, _TOLERANCES / _ROOM * tolerance_m))
    ends = [end for end in found if np.abs(np.subtract(end.xy_m, goal)).max() <= half_m]
    return CloseUp(
        goal_xy_m=goal,
        half_m=half_m,
        rings_m=rings_m,
        ends=tuple(sorted(ends, key=lambda end: end.miss_m)),
        outside=len(found) - len(ends),
    )


def choose_rings(furthest_m: float) -> tuple[float, tuple[float, ...]]:
    """Return the next round half-width beyond a given distance, and its rings [m]."""
    least_m = max(_ROOM * furthest_m, _LEAST_HALF_M)
    decade = 10.0 ** np.floor(np.log10(least_m / _HALVES[-1][0]))
    scaled = [
        (half * unit, step * unit) for unit in (decade, 10.0 * decade) for half, step in _HALVES
    ]
    half_m, step_m = next(found for found in scaled if found[0] >= least_m * (1.0 - 1e-12))
    rings_m = np.arange(1, half_m / step_m - 1e-9) * step_m
    return float(half_m), tuple(rings_m.tolist())


def name_ends(close_up: CloseUp, names: Sequence[str]) -> CloseUp:
    """Return a close-up with names for the runs, in their order; long names are cut."""
    short = [cut_name(name, _LONGEST) for name in names]
    ends = tuple(replace(end, name=short[end.run]) for end in close_up.ends)
    return replace(close_up, ends=ends)


def find_tolerance(run: Run) -> float | None:
    """Return the law's tolerance of each coordinate [m]; None if unknown."""
    tolerance_m = run.parameters.get("law.position_tolerance_m")
    return float(tolerance_m) if isinstance(tolerance_m, int | float) else None


def format_length(length_m: float) -> str:
    """Return a length in millimetres below 1 m, in metres above."""
    # Rounding to three digits would give 1e+03 mm.
    return f"{length_m * 1e3:.3g} mm" if length_m < 0.9995 else f"{length_m:.3g} m"


def list_miss_labels(close_up: CloseUp, lettering: Lettering) -> tuple[Label, ...]:
    """Return labels with the distances of ends from the goal; crowded ends share a label.

    If there are too many ends, only the furthest has text, and the last run if runs have names.
    Rings show the distances of the other ends.
    """
    if len(close_up.ends) > lettering.most_told:
        furthest, last = close_up.ends[-1], max(close_up.ends, key=lambda end: end.run)
        told = (furthest,) if last is furthest or not last.name else (last, furthest)
        close_up = replace(close_up, ends=told)
    groups = _gather(close_up, lettering)
    while True:
        labels: list[Label] = []
        for number, group in enumerate(groups):
            label = _place(close_up, group, labels, lettering)
            if isinstance(label, int):
                groups[label] += groups.pop(number)
                break
            labels.append(label)
        else:
            return tuple(labels)


def list_ring_labels(
    close_up: CloseUp, start_xy_m: ArrayLike, taken: Sequence[Label], lettering: Lettering
) -> tuple[Label, ...]:
    """Return the radius of each ring at a place without other text and without arriving runs."""
    away = np.subtract(close_up.goal_xy_m, start_xy_m)

    def count_hidden(labels: Sequence[Label]) -> float:
        pairs = [*product(labels, taken), *pairwise(labels)]
        hidden = sum(_overlap(one, other, close_up, lettering) for one, other in pairs)
        way = np.subtract(labels[0].xy_m, close_up.goal_xy_m)
        return hidden + 0.5 * bool(way @ away < 0.0)

    (x_m, y_m), rings_m = close_up.goal_xy_m, close_up.rings_m
    named = (
        tuple(Label(text=format_length(m), xy_m=(x_m + m * cos, y_m + m * sin)) for m in rings_m)
        for cos, sin in zip(np.cos(_ANGLES_RAD).tolist(), np.sin(_ANGLES_RAD).tolist(), strict=True)
    )
    labels = min(named, key=count_hidden)
    crowded = any(_overlap(one, other, close_up, lettering) for one, other in pairwise(labels))
    return labels[-1:] if crowded else labels


def _gather(close_up: CloseUp, lettering: Lettering) -> list[list[End]]:
    """Return groups of ends whose dots are too close for separate text."""
    groups: list[list[End]] = []
    for end in close_up.ends:
        ways_m = [np.hypot(*np.subtract(group[0].xy_m, end.xy_m)) for group in groups]
        near = [way_m < lettering.gap * close_up.half_m for way_m in ways_m]
        if any(near):
            groups[near.index(True)].append(end)
        else:
            groups.append([end])
    return groups


def _place(
    close_up: CloseUp, ends: Sequence[End], taken: Sequence[Label], lettering: Lettering
) -> Label | int:
    """Return the text for some ends, moved up or down if necessary, or the text in its way."""
    label = _label_ends(close_up, ends, lettering)
    for lines in _SHIFTS:
        y_m = label.xy_m[1] + lines * lettering.line * close_up.half_m
        moved = replace(label, xy_m=(label.xy_m[0], y_m))
        hidden = [_overlap(other, moved, close_up, lettering) for other in taken]
        if not any(hidden):
            return moved
    hidden = [_overlap(other, label, close_up, lettering) for other in taken]
    return hidden.index(True)


def _label_ends(close_up: CloseUp, ends: Sequence[End], lettering: Lettering) -> Label:
    """Return the text for some ends, on the side away from the goal if it fits."""
    misses_m = sorted(end.miss_m for end in ends)
    ends = sorted(ends, key=lambda end: end.run)
    if len(ends) > _MOST_LISTED:
        text = f"{len(ends)} runs: {_join([misses_m[0], misses_m[-1]], ' to ')}"
    elif all(end.name for end in ends):
        text = "\n".join(f"{end.name}: {format_length(end.miss_m)}" for end in ends)
    else:
        text = _join(misses_m, ", ")
    xs_m, ys_m = zip(*(end.xy_m for end in ends), strict=True)
    half_width_m = lettering.letter * _measure(text)[0] / 2.0 * close_up.half_m
    aside_m = lettering.gap * close_up.half_m + half_width_m
    goal_x_m, reach_m = close_up.goal_xy_m[0], lettering.reach * close_up.half_m - half_width_m
    is_right = sum(xs_m) / len(xs_m) >= goal_x_m
    beside_m = sorted((max(xs_m) + aside_m, min(xs_m) - aside_m), reverse=is_right)
    fitting_m = [x_m for x_m in beside_m if abs(x_m - goal_x_m) <= reach_m]
    x_m = [*fitting_m, min(max(beside_m[0], goal_x_m - reach_m), goal_x_m + reach_m)][0]
    runs = tuple(end.run for end in ends)
    return Label(text=text, xy_m=(x_m, (min(ys_m) + max(ys_m)) / 2.0), runs=runs)


def _join(lengths_m: Sequence[float], word: str) -> str:
    """Return lengths as text, with a common unit only once."""
    texts = list(dict.fromkeys(format_length(length_m) for length_m in lengths_m))
    units = {text.rpartition(" ")[2] for text in texts}
    if len(units) > 1:
        return word.join(texts)
    return f"{word.join(text.rpartition(' ')[0] for text in texts)} {units.pop()}"


def _overlap(one: Label, other: Label, close_up: CloseUp, lettering: Lettering) -> bool:
    across_m, up_m = abs(one.xy_m[0] - other.xy_m[0]), abs(one.xy_m[1] - other.xy_m[1])
    (letters, lines), (others, more) = _measure(one.text), _measure(other.text)
    width_m = (letters + others) / 2 * lettering.letter * close_up.half_m
    return across_m < width_m and up_m < (lines + more) / 2 * lettering.line * close_up.half_m


def _measure(text: str) -> tuple[int, int]:
    """Return the number of letters in the longest line, and the number of lines."""
    lines = text.split("\n")
    return max(map(len, lines)), len(lines)


ON_PATH_M: Final = 1e-3
"""Largest deviation from a path that is not shown [m]. Corners of a path are drawn sharp, and in
print a millimetre of a path of metres is thinner than the path's line."""

_SHARE: Final = 0.1
"""Share of the largest deviation from which poses around it are in view: the whole excursion."""

_ROOM_AROUND: Final = 1.15  # half-width of the view, as a multiple of half of the excursion's size

_MOST_HALVES: Final = 10.0
"""Largest half-width, in largest deviations, which stay visible next to a long segment."""

_LEAST_HALVES: Final = 1.5
"""Smallest half-width of the view, as such a multiple, so that both robot and path are in view."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WorstPlace:
    """Position of the largest deviation from the tracked path, and the region to show."""

    run: int  # number of the run with the largest deviation
    xy_m: Point  # position of the robot's pose [m]
    path_xy_m: Point  # nearest point of the path [m]
    offset_m: float  # distance between the pose and this point [m]
    center_xy_m: Point  # centre of the region: the whole excursion, or its worst part [m]
    half_m: float  # half of the region's width and height [m]


def find_worst_place(runs: Sequence[Run]) -> WorstPlace | None:
    """Return the position of the runs' largest deviation from their common path.

    The result is None if the runs track no path or several paths, or if no deviation exceeds
    `ON_PATH_M`.
    """
    paths = list_paths(runs)
    if len(paths) != 1:
        return None
    signals = {
        number: find_signal(run, "cross_track") for number, run in enumerate(runs) if run.path
    }
    offsets = {n: np.abs(one.values) for n, one in signals.items() if one is not None}
    number = max(offsets, key=lambda one: float(offsets[one].max(initial=0.0)), default=0)
    offsets_m = offsets.get(number, np.zeros(0))
    if not len(offsets_m) or not offsets_m.max() > ON_PATH_M:
        return None
    row, run = int(offsets_m.argmax()), runs[number]
    along = find_signal(run, "along_track")
    point = paths[0].locate(0.0 if along is None else float(along.values[row]))
    path_xy_m, xy_m = (
        (point.x_m, point.y_m),
        (float(run.poses.xy_m[row, 0]), float(run.poses.xy_m[row, 1])),
    )
    offset_m = float(offsets_m[row])
    # The excursion: the rows around the worst one in which the offset exceeds a share of its value.
    near = np.flatnonzero(offsets_m <= _SHARE * offset_m)
    place = int(np.searchsorted(near, row))
    first, after = [-1, *near.tolist(), len(offsets_m)][place : place + 2]
    shown = np.vstack([run.poses.xy_m[first + 1 : after], path_xy_m])
    low, high = shown.min(axis=0), shown.max(axis=0)
    center, half_m = (low + high) / 2.0, _ROOM_AROUND * float((high - low).max()) / 2.0
    if half_m > _MOST_HALVES * offset_m:
        center, half_m = np.add(xy_m, path_xy_m) / 2.0, _MOST_HALVES * offset_m
    return WorstPlace(
        run=number,
        xy_m=xy_m,
        path_xy_m=path_xy_m,
        offset_m=offset_m,
        center_xy_m=(float(center[0]), float(center[1])),
        half_m=max(half_m, _LEAST_HALVES * offset_m),
    )


def label_worst_place(worst: WorstPlace, lettering: Lettering) -> Label:
    """Return the label of the largest deviation, beyond the robot as seen from the path."""
    text = format_length(worst.offset_m)
    away = np.subtract(worst.xy_m, worst.path_xy_m) / worst.offset_m
    sides = np.abs(away) * (lettering.letter * len(text) / 2.0, lettering.line / 2.0)
    aside_m = (lettering.gap + float(sides.sum())) * worst.half_m
    x_m, y_m = (worst.xy_m + aside_m * away).tolist()
    return Label(text=text, xy_m=(x_m, y_m), runs=(worst.run,))
