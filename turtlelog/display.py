"""Display of public values: one line in a console, a table in a notebook."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from math import degrees, isclose, isfinite
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, TypeGuard, TypeVar

from turtlelog.escapes import escape_controls

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

Value = TypeVar("Value")

_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)
_LARGEST_NS: Final = 2**62

LATEST_S: Final = 4e9
"""Largest time since 1970 that is read [s]. In nanoseconds it fits into 64 bits."""

_LISTED: Final = 4
"""Number of names in the one-line display of a catalogue."""


def show_list(values: Sequence[Any]) -> str:
    """Return a list as Python writes it; a long one by its length, first and last value."""
    text = str(values)
    if len(text) <= _LINE:
        return text
    ends = (
        f"({', '.join(map(format_number, end))})" if isinstance(end, list | tuple) else str(end)
        for end in (values[0], values[-1])
    )
    return f"{len(values)} values, {' to '.join(ends)}"


def describe_count(number: int, noun: str) -> str:
    """Return a count with its noun, as in `1 row` and `2 rows`."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def fit_line(text: str) -> str:
    """Return the line in angle brackets that a console shows for a value: at most 80 characters."""
    text = escape_controls(text)
    return text if len(text) <= _LINE else f"{text[: _LINE - 4]}...>"


_LINE: Final = 80


def cut_name(name: str, most: int, *, tail: int = 0, mark: str = "...") -> str:
    """Return a name of at most `most` characters; a mark replaces the rest of a longer name.

    Args:
        name: Name.
        most: Largest number of characters, including the mark.
        tail: Number of last characters to keep.
        mark: Characters in the place of the rest.
    """
    if len(name) <= most:
        return name
    return f"{name[: most - len(mark) - tail]}{mark}{name[len(name) - tail :]}"


NULL_IF_EMPTY: Final[Mapping[str, object]] = MappingProxyType({"null if empty": True})
"""Metadata of a field whose empty text is null in JSON."""


def join_words(words: Sequence[str], last: str = "and") -> str:
    """Return words as a list in a sentence."""
    return f" {last} ".join(filter(None, (", ".join(words[:-1]), *words[-1:])))


def capitalise(text: str) -> str:
    """Return text with a capital as its first letter; other letters stay."""
    return f"{text[:1].upper()}{text[1:]}"


def split_numbers(name: str) -> list[str | tuple[int, str]]:
    """Return a key for the natural order of names, `run2` before `run10`: text, number, text, ...

    A number in the key is the count of its digits and the digits: Python does not parse an int of
    many thousand digits.
    """
    parts = re.split(r"0*([0-9]+)", name)
    return [(len(part), part) if index % 2 else part for index, part in enumerate(parts)]


def format_number(number: float | None, unit: str = "") -> str:
    """Return a number with its unit in five digits, an angle in degrees; `-` for no number."""
    if number is None:
        return "-"
    number, unit = show_angle(number, unit)
    return _add_unit(f"{number + 0.0:.5g}", unit)  # -0 is printed as 0


def format_short(number: float, unit: str = "") -> str:
    """Return a number with its unit in three digits; lengths below a centimetre are in mm."""
    if 0.0 < abs(number) < ROUNDING and unit in _ROUNDED:
        return _ROUNDED[unit]
    number, unit = show_angle(number, unit)
    if unit == "m" and 0.0 < abs(number) < _SHORT_M:
        number, unit = 1e3 * number, "mm"
    return _add_unit(f"{number:{'.0f' if _WHOLE <= abs(number) < _LONG else '.3g'}}", unit)


def format_range(low: float, high: float, unit: str) -> tuple[str, str]:
    """Return both ends of a range in one unit, the one that `format_short` gives the larger.

    Ends that differ by less than the rounding to three digits are written alike.
    """
    low = high if isclose(low, high, rel_tol=_ALIKE) else low
    least, most = format_short(low, unit), format_short(high, unit)
    if unit == "m" and "mm" in least and "mm" not in most and abs(low) >= ROUNDING:
        least = f"{low:.3g} m"
    elif unit == "m" and "mm" in most and "mm" not in least:
        most = f"{high:.3g} m"
    return least, most


def describe_range(values: Sequence[tuple[float, str]], unit: str) -> str:
    """Return the smallest and the largest value, each with the name of what has it."""
    (low, lowest), (high, highest) = min(values), max(values)
    least, most = format_range(low, high, unit)
    # Two values that are printed alike are no range: the reader sees no difference.
    if least == most:
        return f"{least} (all)" if len(values) > 1 else least
    return f"{least} ({lowest}) to {most} ({highest})"


ROUNDING: Final = 1e-9
"""Size below which a value is rounding [m, rad]: text with nine decimals ends there."""

_ROUNDED: Final = {"m": "below 1e-6 mm", "rad": "below 1e-7 deg"}

_ALIKE: Final = 5e-4
"""Half a unit of the third digit, as a fraction of the largest such number [1]. Closer ends may
still be rounded to different texts: 21.94999 and 21.95001 to 21.9 and 22."""

_SHORT_M: Final = 0.01
_WHOLE: Final = 999.5
"""Number that `.3g` rounds to a power of ten."""

_LONG: Final = 1e6
"""Largest whole number that is written in full where `.3g` would write a power of ten."""


def show_angle(value: float, unit: str) -> tuple[float, str]:
    """Return a value and its unit for printing: angles in degrees, other values unchanged.

    Turn rates stay in rad/s, and integrals of angles keep their unit.
    """
    return (degrees(value), "deg") if unit == "rad" else (value, unit)


def format_pair(first: object, second: object, unit: str = "") -> tuple[str, str]:
    """Return two values with their unit, in at least six digits and enough to distinguish them.

    Angles are in degrees. Counts and values that are not numbers have no unit.
    """
    if not (isinstance(first, float) and isinstance(second, float)):
        one, other = ("none" if v is None else escape_controls(str(v)) for v in (first, second))
        return one, other
    (first, printed), (second, _) = show_angle(first, unit), show_angle(second, unit)
    pairs = [(f"{first:.{digits}g}", f"{second:.{digits}g}") for digits in range(6, 18)]
    one, other = next((pair for pair in pairs if pair[0] != pair[1]), pairs[0])
    return _add_unit(one, printed), _add_unit(other, printed)


def _add_unit(text: str, unit: str) -> str:
    return text if unit in {"", "1"} else f"{text} {unit}"


def format_html(
    rows: Iterable[Sequence[object]], *, heads: Sequence[str] = (), title: str = ""
) -> str:
    """Return a table as HTML with escaped text; columns of numbers are aligned to the right.

    Args:
        rows: Cells; None is an empty cell.
        heads: Titles of the columns; no titles if empty.
        title: Caption; no caption if empty.
    """
    rows = [*rows]
    lines = ['<table class="turtlelog">']
    if title:
        lines.append(f'<caption style="text-align:left">{_escape(title)}</caption>')
    if heads:
        columns = zip(*rows, strict=True) if rows else [()] * len(heads)
        sides = ("right" if any(map(_is_number, cells)) else "left" for cells in columns)
        titles = "".join(
            f'<th style="text-align:{side}">{_escape(head)}</th>'
            for head, side in zip(heads, sides, strict=False)
        )
        lines.append(f"<thead><tr>{titles}</tr></thead>")
    lines.append("<tbody>")
    lines += [f"<tr>{''.join(map(_format_cell, row))}</tr>" for row in rows]
    return "\n".join([*lines, "</tbody>", "</table>"])


def format_notebook(answer: str, *parts: str) -> str:
    """Return the HTML that a notebook shows for a value: the answer, then the details.

    The colours are those of the notebook, light or dark.

    Args:
        answer: Text, which is escaped.
        parts: HTML of the details; empty parts are left out.
    """
    head = f"<p><strong>{_escape(answer)}</strong></p>"
    return "\n".join(['<div class="turtlelog">', head, *filter(None, parts), "</div>"])


def format_folded(summary: str, html: str) -> str:
    """Return a part of an answer as HTML that stays folded until a click."""
    return f"<details><summary>{_escape(summary)}</summary>{html}</details>"


def format_curve_svg(values: Sequence[float], *, label: str) -> str:
    """Return values as a small curve in SVG; a value that is not finite leaves a gap.

    Args:
        values: Values at equally spaced positions.
        label: Description of the curve for readers who do not see it.
    """
    known = [value for value in values if isfinite(value)]
    if not known:
        return ""
    low, high = min(known), max(known)
    scale, step = (_CURVE_HEIGHT - 4.0) / ((high - low) or 1.0), _CURVE_WIDTH / max(1, len(values))
    drawn, pen = [], "M"
    for number, value in enumerate(values):
        if isfinite(value):
            y = _CURVE_HEIGHT - 2.0 - (value - low) * scale
            drawn.append(f"{pen}{number * step:.1f},{y:.1f}")
        pen = "L" if isfinite(value) else "M"
    size = f'width="{_CURVE_WIDTH:g}" height="{_CURVE_HEIGHT:g}"'
    path = f'<path d="{"".join(drawn)}" fill="none" stroke="{CURVE_COLOUR}" stroke-width="1.5"/>'
    name = f'role="img" aria-label="{_escape(label)}"'
    return f'<svg xmlns="http://www.w3.org/2000/svg" {size} {name}>{path}</svg>'


_CURVE_WIDTH: Final = 320.0
_CURVE_HEIGHT: Final = 60.0
CURVE_COLOUR: Final = "#0082cc"
"""Colour with contrast to white and to the black of dark notebooks."""


def format_path_svg(xy_m: "NDArray[np.float64]", goal_xy_m: tuple[float, float] | None) -> str:
    """Return the path as SVG: a square at the start, a dot at the end, a cross at the goal.

    The text is empty if there is nothing to draw: no motion and no distance to the goal.
    """
    import numpy as np  # most commands draw no path

    rows = np.unique(np.linspace(0, len(xy_m) - 1, _MOST_POINTS).round().astype(int))
    shown = xy_m if goal_xy_m is None else np.vstack([xy_m, goal_xy_m])
    extent_m = float(np.ptp(shown, axis=0).max())
    middle = (shown.min(axis=0) + shown.max(axis=0)) / 2.0
    scale = (_SIDE - 2.0 * _ROOM) / max(extent_m, _LEAST_M)
    if not extent_m * scale >= _MARK:
        return ""

    def place(points_m: "NDArray[np.float64]") -> list[tuple[float, float]]:
        # The y of a picture points downward.
        pixels = (points_m - middle) * [scale, -scale] + _SIDE / 2.0
        return [(x, y) for x, y in pixels.round(1).tolist()]

    way = place(xy_m[rows])
    (left, top), (right, bottom) = way[0], way[-1]
    square = f'width="{_MARK:g}" height="{_MARK:g}" fill="currentColor"'
    marks = f'<rect x="{left - _MARK / 2}" y="{top - _MARK / 2}" {square}/>'
    marks += f'<circle cx="{right}" cy="{bottom}" r="4" fill="{CURVE_COLOUR}"/>'
    if goal_xy_m is not None:
        ((x, y),) = place(np.array([goal_xy_m]))
        cross = f"M{x - 5},{y - 5}L{x + 5},{y + 5}M{x - 5},{y + 5}L{x + 5},{y - 5}"
        marks += f'<path d="{cross}" stroke="currentColor" stroke-width="2"/>'
    points = " ".join(f"{x},{y}" for x, y in way)
    line = f'<polyline points="{points}" fill="none" stroke="{CURVE_COLOUR}" stroke-width="1.5"/>'
    side = f'width="{_SIDE:g}" height="{_SIDE:g}"'
    label = 'role="img" aria-label="path from the start (square) to the end (dot)"'
    return f'<svg xmlns="http://www.w3.org/2000/svg" {side} {label}>{line}{marks}</svg>'


_SIDE: Final = 220.0
_ROOM: Final = 12.0
"""Size of the picture, and margin around the path [pixels]."""

_MOST_POINTS: Final = 400
"""Largest number of points; with more, points would be less than a pixel apart."""

_LEAST_M: Final = 0.5
"""Smallest side of the shown area [m]; in a smaller area, the noise of poses would look like
motion."""

_MARK: Final = 8.0
"""Width of the marks [pixels]; a path that the marks cover is not visible."""


_LONGEST_NAME: Final = 24
"""Longest name in a table [characters]; a browser would break a name at each of its hyphens."""


def _is_number(cell: object) -> TypeGuard[int | float]:
    return isinstance(cell, int | float) and not isinstance(cell, bool)


def _format_cell(cell: object) -> str:
    if _is_number(cell):
        text = format_number(cell) if isinstance(cell, float) else str(cell)
        return f'<td style="text-align:right">{text}</td>'
    text = "" if cell is None else str(cell)
    wraps = len(text) > _LONGEST_NAME or " " in text
    style = "text-align:left" if wraps else "text-align:left;white-space:nowrap"
    return f'<td style="{style}">{_escape(text)}</td>'


def _escape(text: str) -> str:
    from html import escape  # with the names of 2,000 letters

    return escape(escape_controls(text))


class NamedValues(Mapping[str, Value]):
    """Read-only values by name. The display shows only the names."""

    __slots__ = ("_kind", "_values")

    def __init__(self, kind: str, values: Mapping[str, Value]) -> None:
        """Store the values.

        Args:
            kind: Kind of each value: `metric`.
            values: Values by name, in the order of display.
        """
        self._kind = kind
        self._values = dict(values)

    def __getitem__(self, name: str) -> Value:
        return self._values[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def __repr__(self) -> str:
        names = list(self._values)
        listed = ", ".join(names[:_LISTED]) + (", ..." if len(names) > _LISTED else "")
        return fit_line(f"<{describe_count(len(names), self._kind)}: {listed}>")

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self._kind, self._values)


def format_utc(time_ns: int) -> str:
    """Return a time since 1970 [ns] as ISO 8601 in UTC, to the nanosecond."""
    seconds, nanoseconds = divmod(time_ns, 1_000_000_000)
    try:
        return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%dT%H:%M:%S}.{nanoseconds:09d}Z"
    except (OverflowError, OSError, ValueError):  # beyond the year 9999
        return f"{time_ns} ns"


def format_seconds(time_ns: int) -> str:
    """Return a time [ns] in seconds with nine decimals, exactly."""
    seconds, nanoseconds = divmod(abs(time_ns), 1_000_000_000)
    return f"{'-' if time_ns < 0 else ''}{seconds}.{nanoseconds:09d}"


def parse_utc(text: str) -> int | None:
    """Return an ISO 8601 time in nanoseconds since 1970 UTC; None if the text is not such a time.

    A time without a time zone is read as UTC, because its zone is unknown.
    """
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        return None
    moment = moment.replace(tzinfo=moment.tzinfo or UTC)
    fraction = re.search(r":\d\d[.,](\d+)", text)
    seconds = (moment.replace(microsecond=0) - _EPOCH) // (moment.resolution * 1_000_000)
    time_ns = seconds * 1_000_000_000 + int(f"{fraction[1] if fraction else '':0<9}"[:9])
    return time_ns if abs(time_ns) < _LARGEST_NS else None
