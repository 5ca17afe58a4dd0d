"""Readable pictures of many runs: their colours, short names, unsettled runs, ends of each gain."""

import re
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from turtlelog.charts.curves import Values, is_limit
from turtlelog.charts.palette import FEW, Color, choose_run_colors
from turtlelog.compare import name_runs
from turtlelog.compare.run_selection import has_one_gain, list_differing
from turtlelog.compare.run_summary import complete_parameters
from turtlelog.display import cut_name
from turtlelog.run import Run
from turtlelog.run.stop_reasons import AT_REST

MANY: Final = len(FEW)
"""Largest number of runs with distinct hues. Colours of more follow their order, as a bar shows."""

_MOST_SWINGS: Final = 10
"""Largest number of sign changes of a command in the last half of a run that comes to rest. The
paper's runs that come to rest have at most 4."""

LONGEST_NAME: Final = 24
"""Longest name [letters]. With longer names, a legend takes half of a plot 350 pixels wide."""

_TAIL: Final = 11  # last letters kept of a longer name: half of its letters, without the mark

_BETWEEN_WORDS: Final = re.compile(r"(?<=\w)([-_ ])(?=[A-Za-z])")

_MOST_NAMED: Final = 2  # runs that a title names; of more runs, it gives the number
_MOST_KEYS: Final = 3  # keys in a name; with more, the name would be as long as the replaced one

_WORDS: Final[Mapping[str, str]] = {
    "loop.transport_delay_ticks": "delay",
    "loop.command_queue": "command queue",
    "loop.pose_queue": "pose queue",
    "loop.start_backlog": "backlog",
    "law.pause_ticks": "pause",
    "limits.speed_m_s": "speed limit",
    "limits.turn_rate_rad_s": "turn rate limit",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class GainScale:
    """The number in which many runs differ, with the runs in its order."""

    word: str  # name of the number: `Kp`, `pause_ticks`
    values: tuple[float, ...]  # value of each run
    unit: str = ""  # unit of a gain; empty for other numbers, whose keys contain the unit

    def name_run(self, number: int) -> str:
        """Return the name of a run in a picture, from the value that the run's colour shows."""
        return f"{self.word} {self.values[number]:.3g}"

    def list_ticks(self, most: int) -> list[tuple[float, str]]:
        """Return the values to write at the colour bar of the runs: all, or some at equal steps.

        Returns:
            Mean position of the runs of each value, and the value.
        """
        values = sorted({*self.values})
        rows = np.linspace(0, len(values) - 1, min(len(values), most)).round().astype(int)
        shown = [values[row] for row in np.unique(rows)]
        own = np.array(self.values)
        return [(float(np.flatnonzero(own == one).mean()), f"{one:.3g}") for one in shown]


def group_equal(runs: Sequence[Run]) -> list[list[int]]:
    """Return the numbers of runs in groups with equal rows, from time zero."""
    groups: dict[tuple[bytes, ...], list[int]] = {}
    for number, run in enumerate(runs):
        poses, samples, commands = run.poses, run.samples, run.commands
        columns = (
            *(poses.time_ns - run.start_ns, poses.xy_m, poses.heading_rad),
            *(samples.time_ns - run.start_ns, samples.speed_m_s, samples.turn_rate_rad_s),
            *(commands.time_ns - run.start_ns, commands.speed_m_s, commands.turn_rate_rad_s),
            np.array(run.goal_xy_m or (), dtype=np.float64),
        )
        track = repr((run.path, run.declaration, *run.phase_names)).encode()
        key = (track, *(column.tobytes() for column in columns))
        groups.setdefault(key, []).append(number)
    return list(groups.values())


def find_restless(runs: Sequence[Run]) -> frozenset[int]:
    """Return the numbers of runs that never come to rest, unless they are the majority.

    A picture without most of its runs would be untrue.
    """
    found = set()
    for number, run in enumerate(runs):
        table = run.samples if len(run.samples) else run.commands
        late = table.time_ns >= (run.start_ns + run.end_ns) // 2
        for values in (table.speed_m_s[late], table.turn_rate_rad_s[late]):
            signs = np.sign(values[values != 0.0])
            if np.count_nonzero(np.diff(signs)) > _MOST_SWINGS and run.stop_reason not in AT_REST:
                found.add(number)
    return frozenset(found if 2 * len(found) <= len(runs) else ())


def describe_restless(runs: Sequence[Run], restless: frozenset[int]) -> str:
    """Return a text on the runs that `find_restless` found; empty if there are none."""
    return join_run_names(sorted(restless), name_runs(runs), find_color_scale(runs))


def join_run_names(numbers: Sequence[int], names: Sequence[str], scale: GainScale | None) -> str:
    """Return the names of several runs of a picture as text.

    If the runs are the last in order, they are named by their smallest value. Runs of one value are
    counted: `14 of Kp 10`.
    """
    if scale is None:
        return _join_names([names[number] for number in numbers])
    values = Counter(scale.values[number] for number in numbers)
    if len({*scale.values}) < len(scale.values):
        return _join_names([f"{values[one]} of {scale.word} {one:.3g}" for one in sorted(values)])
    are_last = [*numbers] == [*range(len(names) - len(numbers), len(names))]
    if are_last and len(numbers) > 1:
        return f"{scale.word} from {scale.values[numbers[0]]:.3g} on"
    return _join_names([*map(scale.name_run, numbers)])


def _join_names(names: Sequence[str]) -> str:
    more = len(names) - _MOST_NAMED
    return ", ".join(cut_names(names[:_MOST_NAMED])) + (f" and {more} more" if more > 0 else "")


def cut_names(names: Sequence[str]) -> tuple[str, ...]:
    """Return names of at most `LONGEST_NAME` letters, longer ones without their middle."""
    return tuple(cut_name(name, LONGEST_NAME, tail=_TAIL) for name in names)


def choose_colors_by_value(runs: Sequence[Run]) -> tuple[Color, ...]:
    """Return the colour of each run. Many runs of one gain, or of one other number, share one."""
    scale = find_color_scale(runs)
    values = () if scale is None else scale.values
    if len({*values}) < 2:
        return choose_run_colors(len(runs))
    places = sorted({*values})
    colors = dict(zip(places, choose_run_colors(len(places)), strict=True))
    return tuple(colors[value] for value in values)


def find_color_scale(runs: Sequence[Run]) -> GainScale | None:
    """Return the number that the colours of many runs show.

    It is the only differing number, the gain, or of a few keys the one with most values, all in the
    runs' order. In runs that differ in more keys, it would show a difference among many.
    """
    if len(runs) <= MANY:
        return None
    found, groups = find_gain_scale(runs), group_by_gain(runs)
    if found is not None:
        return found
    if len(groups) > 1:
        gains = {number: gain for gain, numbers in groups.items() for number in numbers}
        return GainScale(word="Kp", values=tuple(gains[number] for number in range(len(runs))))
    keys = [key for key in list_differing(runs) if not key.endswith("seed")]
    scales = [_scale(runs, key, "") for key in keys if len(keys) <= _MOST_KEYS]
    ordered = [one for one in scales if one and [*one.values] == sorted(one.values)]
    return max(ordered, key=lambda one: len({*one.values}), default=None)


def find_gain_scale(runs: Sequence[Run]) -> GainScale | None:
    """Return the gain if all runs have different gains, or the only number in which runs differ.

    The result is None if runs differ in more numbers, or in words. Seeds count only if nothing else
    differs.
    """
    differing = list_differing(runs)
    differing = [key for key in differing if not key.endswith("seed")] or differing
    gains, word = _list_gain_keys(runs), ""
    is_of_gain = bool(gains & {*differing}) and all(map(has_one_gain, runs))
    is_apart = is_of_gain and len({run.parameters.get(min(gains)) for run in runs}) == len(runs)
    if is_of_gain and ({*differing} <= gains or is_apart):
        word, differing = "Kp", [min(gains)]
    return _scale(runs, differing[0], word) if len(differing) == 1 else None


def _scale(runs: Sequence[Run], key: str, word: str) -> GainScale | None:
    """Return the values of a key; None if a run has no number."""
    values = [run.parameters.get(key) for run in runs]
    numbers = [float(v) for v in values if isinstance(v, int | float) and not isinstance(v, bool)]
    if len(numbers) < len(runs) or not all(np.isfinite(numbers)):
        return None
    word = word or _WORDS.get(key, key.rpartition(".")[2])
    return GainScale(word=word, values=tuple(numbers), unit=find_gain_unit(runs, key))


def group_by_gain(runs: Sequence[Run]) -> dict[float, list[int]]:
    """Return the numbers of runs by their gain; empty if a run has no single gain."""
    keys = _list_gain_keys(runs)
    if not keys or not all(map(has_one_gain, runs)):
        return {}
    groups: dict[float, list[int]] = {}
    for number, run in enumerate(runs):
        gain = run.parameters.get(min(keys))
        if not isinstance(gain, int | float):
            return {}
        groups.setdefault(float(gain), []).append(number)
    return groups


def _list_gain_keys(runs: Sequence[Run]) -> set[str]:
    return {key for run in runs for key in run.declaration.list_gains()}


def find_gain_unit(runs: Sequence[Run], key: str) -> str:
    """Return the unit of a loop's gain by its key; empty if loops differ, or for other keys."""
    loops = [loop for run in runs for loop in run.declaration.loops if loop.gain == key]
    units = {loop.gain_unit for loop in loops}
    return units.pop() if len(units) == 1 else ""


def shorten_run_names(runs: Sequence[Run], names: Sequence[str]) -> tuple[str, ...]:
    """Return names, or if a name is long, how the runs differ: `Kp 4, no speed limit`."""
    if max(map(len, names)) <= LONGEST_NAME or len(runs) < 2:
        return tuple(names)
    keys, gains = list_differing(runs), _list_gain_keys(runs)
    if gains and gains <= {*keys} and all(map(has_one_gain, runs)):
        keys = [min(gains), *(key for key in keys if key not in gains)]
    if 0 < len(keys) <= _MOST_KEYS:
        told = [", ".join(_tell(run, keys, gains)) for run in runs]
        if len({*told}) == len(told):
            return tuple(told)
    return cut_alike(names)


def _tell(run: Run, keys: Sequence[str], gains: Collection[str]) -> Iterator[str]:
    known = complete_parameters(run)
    for key in keys:
        value = known.get(key)
        word = "Kp" if key in gains else _WORDS.get(key, key.rpartition(".")[2].replace("_", " "))
        if value is None and not run.scenario_is_complete:
            yield f"{word} unknown"
        elif value is None or value is False:
            yield f"no {word}"
        elif value is True:
            yield word
        elif not isinstance(value, int | float):
            yield f"{word} {value}"
        elif key.startswith("limits.") and not is_limit(value):
            yield f"no {word}"
        else:
            number = f"{value:g}" if isinstance(value, float) else str(value)
            yield f"{word} {number}{' ticks' if key.endswith('_ticks') else ''}"


def cut_alike(names: Sequence[str]) -> tuple[str, ...]:
    """Return names without their common first and last words: `kp1` and `kp10`.

    Words are separated at spaces, and at dashes and underscores before letters. Numbers therefore
    stay whole.
    """
    # Words and their separators alternate.
    parts = [_BETWEEN_WORDS.split(name) for name in names]
    words = [part[::2] for part in parts]
    head, tail = _count_alike(words), _count_alike([word[::-1] for word in words])
    cut = ["".join(part[2 * head : len(part) - 2 * tail]) for part in parts]
    return tuple(cut) if all(cut) and len({*cut}) == len(cut) else tuple(names)


MANY_PATHS: Final = 24
"""Largest number of coloured paths in a plane. Of more, only the last drawn would be visible."""

OUTLINE_LABEL: Final = "90 % of the ends of a gain"

MEDIAN_LABEL: Final = "median end"

_LEAST_RUNS: Final = 10  # ends of a gain for an outline; of fewer ends, nine tenths are all

_INSIDE: Final = 0.9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GainEnds:
    """Ends of the runs of one gain."""

    gain: float  # gain Kp of the runs
    runs: tuple[int, ...]  # numbers of the runs, rising
    median_xy_m: Values  # median of x and of y [m], shape (2,)
    outline_xy_m: Values  # corners around 90 % of the ends [m], counter-clockwise, shape (n, 2)

    @property
    def middle_run(self) -> int:
        """Number of the run whose colour represents the gain."""
        return self.runs[len(self.runs) // 2]

    @property
    def around_xy_m(self) -> Values:
        """The outline as a closed line [m], shape (n + 1, 2)."""
        return np.append(self.outline_xy_m, self.outline_xy_m[:1], axis=0)


def has_grey_paths(runs: Sequence[Run]) -> bool:
    """Return whether a plane shows grey paths, and coloured ends with medians and outlines."""
    return len(runs) > MANY_PATHS


def find_gain_ends(runs: Sequence[Run]) -> list[GainEnds]:
    """Return the ends of runs for each gain with enough runs, by rising gain."""
    found = []
    for gain, numbers in sorted(group_by_gain(runs).items()):
        if len(numbers) < _LEAST_RUNS:
            continue
        ends_m = np.array([runs[number].poses.xy_m[-1] for number in numbers])
        median_m = np.median(ends_m, axis=0)
        # From the centre outward, relative to the spread of the ends.
        away_m = ends_m - median_m
        squares = np.einsum("ni,ij,nj->n", away_m, np.linalg.pinv(np.cov(ends_m.T)), away_m)
        order = np.argsort(squares, kind="stable")
        inside = order[: int(np.ceil(_INSIDE * len(numbers)))]
        found.append(
            GainEnds(
                gain=gain,
                runs=tuple(numbers),
                median_xy_m=median_m,
                outline_xy_m=outline_points(ends_m[inside]),
            )
        )
    return found


def outline_points(points: Values) -> Values:
    """Return the corners of the convex hull of points, counter-clockwise, shape (n, 2)."""
    points = np.unique(points, axis=0)
    if len(points) < 3:
        return points
    return np.array([*_walk(points)[:-1], *_walk(points[::-1])[:-1]])


def _walk(points: Values) -> list[Values]:
    """Return the right-hand border of sorted points (Andrew's monotone chain)."""
    border: list[Values] = []
    for point in points:
        while len(border) > 1:
            (ax, ay), (bx, by) = border[-1] - border[-2], point - border[-1]
            if ax * by - ay * bx > 0.0:
                break
            border.pop()
        border.append(point)
    return border


def _count_alike(parts: Sequence[Sequence[str]]) -> int:
    """Return how many first parts are common to all names."""
    return [*(len({*column}) == 1 for column in zip(*parts, strict=False)), False].index(False)
