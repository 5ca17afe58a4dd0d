"""The printed page: how wide a figure is, its fonts and lines, and how runs are told apart."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final, Literal

from turtlelog.errors import ShowError
from turtlelog.show.run_colors import FEW, choose_run_colors

_MM_PER_INCH: Final = 25.4
_GAP_MM: Final = 6.0
_NARROWEST_MM, _WIDEST_MM = 120.0, 1000.0

LOOKS: Final[Mapping[str, Any]] = MappingProxyType(
    {
        "font.family": "DejaVu Sans",
        "font.size": 8.0,
        "axes.titlesize": 8.0,
        "axes.labelsize": 8.0,
        "xtick.labelsize": 7.0,
        "ytick.labelsize": 7.0,
        "legend.fontsize": 7.0,
        "legend.frameon": False,
        "legend.borderpad": 0.0,
        "legend.columnspacing": 1.0,
        "legend.handlelength": 2.3,
        "axes.linewidth": 0.6,
        "axes.grid": True,
        "axes.axisbelow": True,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "grid.color": "0.9",
        "grid.linewidth": 0.5,
        "lines.linewidth": 1.1,
        "xtick.major.width": 0.6,
        "ytick.major.width": 0.6,
        "axes.formatter.useoffset": False,
        # TrueType in PDF, outlines in SVG: the page looks the same without the font installed.
        "pdf.fonttype": 42,
        "svg.fonttype": "path",
        "svg.hashsalt": "turtlelog",
    }
)
"""Settings of matplotlib under which every figure is drawn and written."""

_DASHES: Final[tuple[Any, ...]] = ("-", (0, (6, 1.5)), (0, (3, 1.2, 1, 1.2)), (0, (1.6, 0.9)))
"""Patterns of lines: what tells runs apart where colours are gone."""

REFERENCE: Final[Mapping[str, Any]] = MappingProxyType({"color": "0.45", "linewidth": 0.7})
"""Goals, limits, zeros."""

IDEAL: Final[Mapping[str, Any]] = MappingProxyType(
    {"linewidth": 0.7, "linestyle": (0, (1, 1.5)), "zorder": 1.8, "label": "ideal"}
)
"""What theory says; in the colour of its run."""

AIM: Final[Mapping[str, Any]] = MappingProxyType(
    {"linewidth": 0.8, "linestyle": (0, (4, 1.2, 1, 1.2, 1, 1.2)), "zorder": 1.9}
)
"""What a law, or the goal, asks for where that moves; in the colour of its run."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Page:
    """Where figures will stand.

    Attributes:
        text_width_mm: Width of the text block [mm], 120 to 1000.
        columns: How many columns a figure spans: `1` of two, or `2`, the whole width.

    Raises:
        ShowError: Where the width is out of range.
    """

    text_width_mm: float = 181.0
    columns: Literal[1, 2] = 1

    def __post_init__(self) -> None:
        if not _NARROWEST_MM <= self.text_width_mm <= _WIDEST_MM:
            raise ShowError(
                f"text width: expected {_NARROWEST_MM:g} to {_WIDEST_MM:g} mm,"
                f" found {self.text_width_mm}"
            )
        if self.columns not in {1, 2}:
            raise ShowError(f"columns: expected 1 or 2, found {self.columns}")

    @property
    def width_inch(self) -> float:
        """Width of a figure [inch]."""
        whole_mm = self.text_width_mm
        return (whole_mm if self.columns == 2 else (whole_mm - _GAP_MM) / 2.0) / _MM_PER_INCH


def choose_lines(count: int) -> Sequence[Mapping[str, Any]]:
    """Return colour and dashes for each of several runs; the colours are those on screen.

    Of more runs than have a hue of their own, the first lie on top: the fast swings of a large gain
    would cover all others.
    """
    colors = [tuple(part / 255.0 for part in color) for color in choose_run_colors(count)]
    lines = [
        {"color": color, "linestyle": _DASHES[index % len(_DASHES)]}
        for index, color in enumerate(colors)
    ]
    if count <= len(FEW):
        return lines
    return [{**line, "zorder": 2.9 - 0.9 * i / count} for i, line in enumerate(lines)]
