"""Effect of chance on a run: values and ends over starts or seeds."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.charts import palette
from turtlelog.charts.attribution_steps import choose_unit, label_metric
from turtlelog.charts.close_up import choose_rings
from turtlelog.charts.curves import Values
from turtlelog.display import describe_count, join_words
from turtlelog.explain import Luck, LuckCurve
from turtlelog.measure import find_metric_kind

_DIGITS: Final = 2
"""Number of digits of a value in text; neighbouring starts differ in the third digit."""

_MOST_DIGITS: Final = 5  # digits of two values that fewer digits do not distinguish

_SMALL: Final = 0.5
"""Share of the smallest value with all effects below which values are given by an upper bound."""

_JUMP: Final = 0.02  # smallest visible jump between neighbours, as a share of the picture's height

_SMOOTH: Final = 6.0
"""Ratio to the lower quartile of steps from which a step is a jump instead of a slope."""

_FROM_ZERO: Final = 0.5
"""Ratio of smallest to largest value below which the axis begins at 0; for errors, always."""

_ROOM: Final = 0.06  # margin above and below the curves, as a share of the axis
_AROUND: Final = 1.12  # half-width of the plane, as a multiple of the furthest end's distance

WITH_ALL: Final = "with all effects"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LuckLine:
    """A curve over the starts."""

    name: str  # short label at the right end of the curve; the sentences have the full name
    color: palette.Color  # colour of the run, of the removed cause, or of the ghost
    kind: str  # `run`: with all effects. `cause`: one cause removed. `ghost`: all causes removed
    values: Values  # values in the unit of the picture, shape (n,); NaN if missing
    pieces: tuple[tuple[int, int], ...]  # first and last row of each part without a jump
    is_joined: bool  # whether lines join neighbouring values; values of seeds are independent


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LuckPlane:
    """Ends of the runs relative to the goal."""

    title: str  # title of the picture
    half_m: float  # half of the picture's width and height [m]
    rings_m: tuple[float, ...]  # radii of the rings, round lengths, rising [m]
    ends_m: Values  # ends with all effects, relative to the goal [m], shape (n, 2)
    ghosts_m: Values  # ends without all acting causes, shape (n, 2); empty without such ends
    recorded_m: Values  # end of the run itself [m], shape (2,)
    note: str  # how close the ghosts end, in two lines; empty without ghosts


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LuckPicture:
    """Content of the picture of chance in a run."""

    varied: str  # start headings or seeds: `start` or `seed`
    sentences: tuple[str, ...]  # result in words, for above the picture
    places: Values  # position of each start on the axis [deg], or of each seed, from 1
    place_label: str  # label of the axis of places
    value_label: str  # label of the axis of values
    limits: tuple[float, float]  # limits of the axis of values
    lines: tuple[LuckLine, ...]  # the curves; the curve with all effects is first
    recorded: tuple[float, float] | None  # position and value of the run itself; None: no value
    recorded_name: str  # label of the run's own value
    plane: LuckPlane | None  # ends of the runs; None without a goal

    def find_end(self, line: LuckLine) -> tuple[float, float]:
        """Return the value at the end of a curve; without a value, the lower end of the axis."""
        if not line.pieces:
            return float(self.places[-1]), self.limits[0]
        last = line.pieces[-1][1]
        return float(self.places[last]), float(line.values[last])


def build_luck_picture(luck: Luck) -> LuckPicture:
    """Return the content of the picture of chance in a run."""
    sizes = [float(np.nanmax(np.abs(curve.values), initial=0.0)) for curve in luck.curves]
    factor, unit = choose_unit(max(sizes), luck.unit)
    order, places, label, at = _place_starts(luck)
    columns = [curve.values[order] * factor for curve in luck.curves]
    recorded = math.nan if luck.recorded is None else luck.recorded * factor
    kind = find_metric_kind(luck.metric)
    is_error = kind is not None and kind.nature == "error"
    limits = _find_limits([*columns, np.array([recorded])], is_error=is_error)
    colors = palette.choose_cause_colors(luck.causes)
    values = luck.curves[0].values
    told = "no value"
    if luck.recorded is not None:
        ends = float(np.nanmin(values)), float(np.nanmax(values))
        told = _write_range(*ends, luck.unit, told=luck.recorded)
    lines = tuple(
        _build_line(luck, curve, values, colors, limits)
        for curve, values in zip(luck.curves, columns, strict=True)
    )
    return LuckPicture(
        varied=luck.varied,
        sentences=_write_sentences(luck),
        places=places,
        place_label=label,
        value_label=label_metric(luck.metric, unit),
        limits=limits,
        lines=lines,
        recorded=None if luck.recorded is None else (at, recorded),
        recorded_name=f"this run: {told}",
        plane=_build_plane(luck),
    )


def _place_starts(luck: Luck) -> tuple[NDArray[np.intp], Values, str, float]:
    """Return the order of starts or seeds, their places, the axis' label, and the run's place."""
    values = luck.curves[0].values
    if luck.varied == "seed":
        below = 0 if luck.recorded is None else int((values <= luck.recorded).sum())
        label = f"{len(luck.seeds)} seeds, by the value {WITH_ALL}"
        places = np.arange(1.0, len(luck.seeds) + 1.0)
        return np.argsort(values, kind="stable"), places, label, below + 0.5
    turn_deg = math.degrees(float(luck.starts_rad[-1] - luck.starts_rad[0]))
    label = f"start heading, from the recorded one [deg] (one sample turns {turn_deg:.3g} deg)"
    return np.arange(len(values)), np.degrees(luck.starts_rad), label, 0.0


def spread_labels(
    values: Sequence[float], height: float, limits: tuple[float, float]
) -> list[float]:
    """Return positions of labels near their values without overlap, in the order of the values.

    `height` is that of a label; the positions are within the limits as far as there is room.
    """

    def find_edge(group: Sequence[float], side: float) -> float:
        return sum(group) / len(group) + side * len(group) * height / 2.0

    order = sorted(range(len(values)), key=lambda row: values[row])
    # Overlapping labels are placed around the mean of their values.
    groups: list[list[float]] = []
    for row in order:
        groups.append([values[row]])
        while len(groups) > 1 and find_edge(groups[-1], -1.0) < find_edge(groups[-2], 1.0):
            upper = groups.pop()
            groups[-1] += upper
    middles = [
        find_edge(group, -1.0) + (number + 0.5) * height
        for group in groups
        for number in range(len(group))
    ]
    below_top = limits[1] - height * (np.arange(len(middles))[::-1] + 0.5)
    above_bottom = limits[0] + height * (np.arange(len(middles)) + 0.5)
    places = np.maximum(np.minimum(middles, below_top), above_bottom).tolist()
    found = dict(zip(order, places, strict=True))
    return [found[row] for row in range(len(values))]


def _write_range(low: float, high: float, unit: str, *, told: float | None = None) -> str:
    """Return two values, or `told` instead, with enough digits to distinguish the two."""
    factor, name = choose_unit(max(abs(low), abs(high)), unit)
    for digits in range(_DIGITS, _MOST_DIGITS + 1):
        least, most = _round(low * factor, digits), _round(high * factor, digits)
        if least != most:
            text = f"{least} to {most}" if told is None else _round(told * factor, digits)
            return f"{text} {name}".strip()
    return f"{_round((high if told is None else told) * factor, _DIGITS)} {name}".strip()


def _write_bound(most: float, unit: str) -> str:
    """Return a value with two digits, rounded up."""
    factor, name = choose_unit(abs(most), unit)
    step = 10.0 ** -_count_decimals(most * factor, _DIGITS)
    return f"{_round(math.ceil(most * factor / step - 1e-9) * step, _DIGITS)} {name}".strip()


def _round(value: float, digits: int) -> str:
    """Return a value as text with the given number of digits; whole numbers have all digits."""
    decimals = 0 if value == round(value) else _count_decimals(value, digits)
    return f"{value:.{decimals}f}"


def _count_decimals(value: float, digits: int) -> int:
    return max(digits - 1 - math.floor(math.log10(abs(value))), 0) if value else 0


def _find_limits(columns: Sequence[Values], *, is_error: bool) -> tuple[float, float]:
    values = np.concatenate(columns)
    values = values[np.isfinite(values)]
    low, high = float(values.min()), float(values.max())
    if 0.0 <= low <= (1.0 if is_error else _FROM_ZERO) * high:
        low = 0.0
    room = _ROOM * ((high - low) or abs(high) or 1.0)
    return (0.0 if low == 0.0 else low - room), high + room


def _build_line(
    luck: Luck,
    curve: LuckCurve,
    values: Values,
    colors: dict[str, palette.Color],
    limits: tuple[float, float],
) -> LuckLine:
    kind = "run" if not curve.without else "ghost" if curve is luck.curves[-1] else "cause"
    is_known = bool(np.isfinite(values).any())
    is_joined = luck.varied == "start" or bool(np.ptp(values) == 0.0)
    own = {"run": palette.MAIN, "ghost": palette.GHOST}
    return LuckLine(
        name=_name_curve(curve, is_brief=True) + ("" if is_known else ": no value"),
        color=own.get(kind) or colors[curve.without[0]],
        kind=kind,
        values=values,
        pieces=_find_pieces(values, limits[1] - limits[0], is_joined=is_joined),
        is_joined=is_joined,
    )


def _name_curve(curve: LuckCurve, *, is_brief: bool = False) -> str:
    if is_brief and len(curve.without) > 1:
        return "without both" if len(curve.without) == 2 else f"without all {len(curve.without)}"
    return f"without {join_words(curve.without)}" if curve.without else WITH_ALL


def _find_pieces(values: Values, height: float, *, is_joined: bool) -> tuple[tuple[int, int], ...]:
    rows = np.flatnonzero(np.isfinite(values)).tolist()
    steps = np.abs(np.diff(values[np.isfinite(values)]))
    least = max(_JUMP * height, _SMOOTH * float(np.quantile(steps, 0.25)) if len(steps) else 0.0)
    pieces: list[tuple[int, int]] = []
    for row in rows:
        last = pieces[-1][1] if pieces else row
        if is_joined and pieces and row == last + 1 and abs(values[row] - values[last]) <= least:
            pieces[-1] = (pieces[-1][0], row)
        else:
            pieces.append((row, row))
    return tuple(pieces)


def _write_sentences(luck: Luck) -> tuple[str, ...]:
    whole, rest = luck.curves[0], luck.curves[-1]
    first = f"{luck.metric}: {_write_values(luck, whole)} {WITH_ALL}"
    if len(luck.curves) == 1:
        has = "no effect changes it" if luck.causes else "no effect is in this run"
        return f"{first}; {has}.", _write_dependence(luck)
    most = float(np.nanmax(rest.values, initial=-math.inf))
    is_small = bool((rest.values >= 0.0).all()) and most < _SMALL * np.nanmin(whole.values)
    size = f"at most {_write_bound(most, luck.unit)}" if is_small else _write_values(luck, rest)
    return f"{first}, {size} {_name_curve(rest)}.", _write_dependence(luck)


def _write_values(luck: Luck, curve: LuckCurve) -> str:
    values = curve.values[np.isfinite(curve.values)]
    if not len(values):
        return "no value"
    text = _write_range(float(values.min()), float(values.max()), luck.unit)
    missing = len(curve.values) - len(values)
    way = "from" if luck.varied == "start" else "with"
    return f"{text} (no value {way} {describe_count(missing, luck.varied)})" if missing else text


def _write_dependence(luck: Luck) -> str:
    values = luck.curves[0].values
    if np.ptp(values) == 0.0:
        way = "from" if luck.varied == "start" else "with"
        return f"It is the same {way} all {len(values)} {luck.varied}s."
    if luck.varied == "seed":
        return "Each seed gives another value."
    added = "" if len(luck.curves) == 1 else "; what the effects add depends little on it"
    told = {"wide": "on single samples", "steady": "little on the start"}
    return f"It depends {told.get(luck.dependence, f'on the start{added}')}."


def _build_plane(luck: Luck) -> LuckPlane | None:
    if luck.goal_xy_m is None:
        return None
    goal_m = np.array(luck.goal_xy_m)
    whole, rest = luck.curves[0], luck.curves[-1]
    ends_m, ghosts_m = (
        curve.ends_xy_m[np.isfinite(curve.ends_xy_m).all(axis=1)] - goal_m
        for curve in (whole, rest)
    )
    recorded_m = np.array(luck.recorded_end_xy_m) - goal_m
    if len(luck.curves) == 1:
        ghosts_m = np.zeros((0, 2))
    shown_m = np.concatenate([ends_m, ghosts_m, recorded_m[np.newaxis]])
    furthest_m = float(np.hypot(*shown_m.T).max())
    half_m, rings_m = choose_rings(furthest_m)
    half_m = min(half_m, _AROUND * max(furthest_m, *rings_m))
    count, note = len(whole.values), ""
    if len(ghosts_m):
        which = f"all {count}" if len(ghosts_m) == count else f"{len(ghosts_m)} of {count}"
        within = _write_bound(float(np.hypot(*ghosts_m.T).max()), "m")
        note = f"{_name_curve(rest)}:\n{which} within {within}"
    return LuckPlane(
        title=f"where {count} {luck.varied}s end",
        half_m=half_m,
        rings_m=rings_m,
        ends_m=ends_m,
        ghosts_m=ghosts_m,
        recorded_m=recorded_m,
        note=note,
    )
