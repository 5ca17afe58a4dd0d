"""The printed page: size and style of figures, and figures as files of each format."""

import io
import math
import os
import re
import textwrap
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from threading import RLock, get_ident
from types import MappingProxyType
from typing import Any, Final, Literal, get_args

from fontTools import subset
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_pdf import FigureCanvasPdf
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from turtlelog.charts import palette
from turtlelog.errors import ShowError
from turtlelog.files.urls import make_path
from turtlelog.log import replace_when_complete

_MM_PER_INCH: Final = 25.4
_GAP_MM: Final = 6.0
_NARROWEST_MM, _WIDEST_MM = 120.0, 1000.0
_LEAST_DPI, _MOST_DPI = 50, 600
"""Range of resolutions: at 50, letters of 7 points have 5 pixels; printers resolve 600."""

_DPI: Final = 300.0

_SLIDE_INCH: Final = (6.4, 3.6)
"""Size of a slide, 16:9 [inch]: projected, letters of 8 points have 17."""
_PROJECTED_INCH: Final = 40.0 / 3.0  # width of a slide in presentation programs [inch]
_SLIDE_DPI: Final = 144.0
_LOW_ROWS: Final = 3
"""Number of rows of panels from which units on a slide are on a line of their own."""

SIDE_BY_SIDE_INCH: Final = 5.0
"""Width below which panels are stacked [inch]; side by side, they would be smaller than text."""

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
        # Selectable text: TrueType in PDF, text with the name of its font in SVG.
        "pdf.fonttype": 42,
        "svg.fonttype": "none",
        "svg.hashsalt": "turtlelog",
    }
)
"""Settings of matplotlib for drawing and writing every figure."""

_DRAWING: Final = RLock()
"""Lock of the drawing thread, because matplotlib's settings belong to the whole process."""
if hasattr(os, "register_at_fork"):
    # A process forked while another thread draws would wait for that thread for ever.
    os.register_at_fork(
        before=_DRAWING.acquire, after_in_parent=_DRAWING.release, after_in_child=_DRAWING.release
    )


def fix_style(**looks: Any) -> Mapping[str, Any]:
    """Return settings of matplotlib's artists that nothing changes."""
    return MappingProxyType(looks)


@contextmanager
def use_looks(looks: Mapping[str, Any] = LOOKS) -> Iterator[None]:
    """Draw with settings of matplotlib. Other threads wait until the settings are restored."""
    with _DRAWING, rc_context(dict(looks)):
        yield


def to_rgb(color: palette.Color) -> tuple[float, ...]:
    """Return a colour in matplotlib's form."""
    return tuple(part / 255.0 for part in color)


STROKES: Final[Mapping[palette.Dash, Any]] = MappingProxyType(
    {
        "solid": "-",
        "dashed": (0, (5, 2)),
        "dotted": (0, (1, 1.5)),
        "dash-dot": (0, (4, 1.2, 1, 1.2)),
    }
)
"""Dashes of matplotlib, in multiples of the line's width."""

REFERENCE: Final = fix_style(color="0.45", linewidth=0.7)  # style of goals, limits and zeros

GOAL: Final = fix_style(
    linestyle="", marker="x", color=palette.to_hex(palette.GOAL_ON_WHITE), zorder=3
)
"""Style of goals in the plane."""

START: Final = fix_style(linestyle="", marker="s", color="0.3", zorder=3)
"""Style of starts in the plane."""

NOTE: Final = fix_style(fontsize=7.0, color="0.4")  # style of text below the panels

IDEAL_ENDS: Final = "ideal, first and last run"
"""Label of the ideal responses of the first and the last of many runs."""

AIM: Final = fix_style(
    linewidth=0.8, linestyle=STROKES[palette.choose_dash("aim")], zorder=1.9, marker=""
)
"""Style of moving references, of a law or a goal."""

MEASURED: Final = fix_style(color=to_rgb(palette.MEASURED))
"""Style of a robot's measured motion beside a model."""

MODELLED: Final = fix_style(color=to_rgb(palette.MODEL), linestyle=STROKES[palette.SUPPOSED_DASH])
"""Style of a model's response to a command."""

SENSED: Final = fix_style(
    linestyle="",
    marker=".",
    markersize=2.4,
    markeredgewidth=0.0,
    color="0.62",
    zorder=1.7,
    label="sensed",
)
"""Style of sensed poses, drawn below the true ones."""

PUSHED: Final = fix_style(color="0.92", linewidth=0.0, zorder=0.5, label="disturbance")
"""Style of the time while a disturbance acts on the plant."""

PageKind = Literal["column", "page", "slide"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Page:
    """Page format of figures, and the part of the runs that they show.

    Attributes:
        kind: `column`: one of two columns of a paper. `page`: the whole width. `slide`: 16:9 with
            text and lines for a projector.
        text_width_mm: Width of the text block [mm], 120 to 1000; not used for slides.
        dpi: Resolution of a PNG [dots per inch], 50 to 600; for a slide, it refers to the size
            13.33 by 7.5 inch. Default: 300, for a slide 144 (1920 by 1080 pixels).
        from_s: Start of time axes, from the first sample [s]. Default: the start of the runs.
        to_s: End of time axes [s]. Default: the end of the runs.
        has_marks: Whether characteristics are marked on the curves of controlled signals.

    Raises:
        ShowError: If a value is out of range.
    """

    kind: PageKind = "column"
    text_width_mm: float = 181.0
    dpi: int | None = None
    from_s: float | None = None
    to_s: float | None = None
    has_marks: bool = False

    def __post_init__(self) -> None:
        if not _NARROWEST_MM <= self.text_width_mm <= _WIDEST_MM:
            raise ShowError(
                f"text width: expected {_NARROWEST_MM:g} to {_WIDEST_MM:g} mm,"
                f" found {self.text_width_mm}"
            )
        if self.kind not in get_args(PageKind):
            raise ShowError(f"page: expected column, page or slide, found {self.kind}")
        if self.dpi is not None and not _LEAST_DPI <= self.dpi <= _MOST_DPI:
            raise ShowError(f"dpi: expected {_LEAST_DPI} to {_MOST_DPI}, found {self.dpi}")
        for name, bound_s in (("from", self.from_s), ("to", self.to_s)):
            if bound_s is not None and not math.isfinite(bound_s):
                raise ShowError(f"{name}: expected a time [s], found {bound_s}")
        if self.from_s is not None and self.to_s is not None and self.from_s >= self.to_s:
            raise ShowError(
                f"from: expected a time before {self.to_s:g} s, where it ends,"
                f" found {self.from_s:g} s"
            )

    @property
    def width_inch(self) -> float:
        """Width of a figure [inch]."""
        if self.kind == "slide":
            return _SLIDE_INCH[0]
        whole_mm = self.text_width_mm
        return (whole_mm if self.kind == "page" else (whole_mm - _GAP_MM) / 2.0) / _MM_PER_INCH

    @property
    def height_inch(self) -> float:
        """Height of a slide's figure [inch]. On paper, each figure has its own height."""
        return _SLIDE_INCH[1] if self.kind == "slide" else math.inf

    @property
    def pixels_per_inch(self) -> float:
        """Resolution of a PNG [pixels per inch of the drawn figure]."""
        if self.kind == "slide":
            return (self.dpi or _SLIDE_DPI) * _PROJECTED_INCH / _SLIDE_INCH[0]
        return self.dpi or _DPI

    def widen(self) -> "Page":
        """Return the page format for figures with panels side by side."""
        return replace(self, kind="page") if self.kind == "column" else self

    def fit(self, figure: Figure) -> None:
        """Set the size of a drawn figure if this page format fixes it."""
        if self.kind == "slide":
            figure.set_size_inches(*_SLIDE_INCH)
            for axes in figure.axes:
                place = axes.get_subplotspec()
                if place is not None and place.get_gridspec().nrows >= _LOW_ROWS:
                    axes.set_ylabel(break_label(axes.get_ylabel()))


def break_label(label: str) -> str:
    """Return the label of a low panel on two lines of similar length."""
    words = label.split(" ")
    pairs = [(" ".join(words[:count]), " ".join(words[count:])) for count in range(1, len(words))]
    return "\n".join(min(pairs, key=lambda pair: max(map(len, pair)), default=(label,)))


_UNIT_SPACE: Final = re.compile(r"(?<=\d) (?=[^\W\d])")
"""Space between a number and its unit, where no line breaks."""


def break_words(text: str, letters: int) -> str:
    """Return text on at most three lines of some letters; a number stays beside its unit."""
    whole = _UNIT_SPACE.sub("\N{NO-BREAK SPACE}", text)
    return "\n".join(textwrap.wrap(whole, letters, max_lines=3, placeholder=" ..."))


_UNUSED_TABLES: Final = ("GSUB", "GPOS", "GDEF", "MATH", "kern", "cmap", "post", "name", "OS/2")
"""Font tables on ligatures, look-up and names of glyphs. A PDF does not need them, because it finds
glyphs by index. ISO 32000-1, 9.9: a CIDFontType2 needs glyf, head, hhea, hmtx, loca, maxp, and, if
present, cvt, fpgm and prep."""

_NO_DATE: Final = {
    "pdf": {"CreationDate": None, "ModDate": None},
    "png": {"Software": None},
    "svg": {"Date": None},
}
"""Metadata without dates, so that equal runs give identical files."""

FIGURE_FORMATS: Final = tuple(_NO_DATE)


def save_figure(figure: Figure, data: io.BytesIO, form: str, page: Page | None = None) -> None:
    """Write a figure in one of `FIGURE_FORMATS`. Equal figures give equal bytes."""
    with use_looks():
        # `savefig` would draw everything once more to compute the layout.
        figure.dpi = (page or Page()).pixels_per_inch
        arrange_panels(figure)
        if form == "pdf":
            with _drop_unused_tables():
                FigureCanvasPdf(figure).print_pdf(data, metadata=_NO_DATE[form])
        elif form == "svg":
            FigureCanvasSVG(figure).print_svg(data, metadata=_NO_DATE[form])
        else:
            FigureCanvasAgg(figure).print_png(data, metadata=_NO_DATE[form])


_LAYOUTS: Final = 3
"""Number of layout computations after which square planes leave room for all labels."""


def arrange_panels(figure: Figure) -> None:
    """Compute the places of panels; repeatedly for planes, because their squares change places."""
    has_planes = any(axes.get_aspect() != "auto" for axes in figure.axes)
    for _ in range(_LAYOUTS if has_planes else 1):
        if (engine := figure.get_layout_engine()) is not None:
            engine.execute(figure)


def require_figure_path(path: str | Path) -> Path:
    """Return the path for a figure, or raise an error if the suffix is not a format."""
    path = make_path(path)
    if path.suffix.lower().removeprefix(".") not in FIGURE_FORMATS:
        raise ShowError(f"{path}: the name must end in .pdf, .png or .svg")
    return path


def write_figure(figure: Figure, path: Path, page: Page) -> Path:
    """Write a figure in the format of the suffix, and return its path."""
    data = io.BytesIO()
    save_figure(figure, data, path.suffix.lower().removeprefix("."), page)
    with replace_when_complete(path, raising=ShowError) as part:
        part.write_bytes(data.getvalue())
    return path


@contextmanager
def _drop_unused_tables() -> Iterator[None]:
    """Leave out font tables that no PDF uses, because reducing them takes most of the writing time.

    matplotlib has no option for these tables. matplotlib opens fonts with a public function of
    fontTools, which leaves the tables out in this thread during the block. If matplotlib opened
    fonts in another way, writing would only take longer.
    """
    usual, ours = subset.load_font, get_ident()

    def load(*arguments: Any, **named: Any) -> Any:
        font = usual(*arguments, **named)
        if get_ident() != ours:
            return font
        font.setGlyphOrder([f"glyph{number}" for number in range(font["maxp"].numGlyphs)])
        for table in _UNUSED_TABLES:
            if table in font:
                del font[table]
        return font

    subset.load_font = load
    try:
        yield
    finally:
        subset.load_font = usual


_SHOWN_DPI: Final = 192
"""Resolution in notebooks: twice the inch of browsers, sharp on every kind of screen."""

_BROWSER_DPI: Final = 96


class ShownFigure(Figure):
    """A `matplotlib.figure.Figure` that a notebook shows as the value of a cell.

    No magic command is needed, and the figure does not stay in the memory of pyplot.
    """

    def _repr_png_(self) -> tuple[bytes, dict[str, Any]]:
        data, dpi = io.BytesIO(), self.dpi
        with use_looks():
            try:
                self.dpi = _SHOWN_DPI
                arrange_panels(self)
                FigureCanvasAgg(self).print_png(data)
            finally:
                self.dpi = dpi
        width, height = (round(float(inch) * _BROWSER_DPI) for inch in self.get_size_inches())
        return data.getvalue(), {"width": width, "height": height}
