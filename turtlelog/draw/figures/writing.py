"""Figures as files, and in notebooks."""

import io
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from threading import get_ident
from typing import Any, Final

from fontTools import subset
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_pdf import FigureCanvasPdf
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from turtlelog import compare
from turtlelog.draw.documents import choose_essentials
from turtlelog.draw.figures import marked_panels
from turtlelog.draw.figures.figure_curves import add_gain_bar, add_legend
from turtlelog.draw.figures.figure_kinds import FIGURES, has_table1, list_usual_figures
from turtlelog.draw.figures.needs import FigureKind
from turtlelog.draw.figures.page import Page, use_looks
from turtlelog.draw.figures.plane_panels import has_one_plane, stress_window
from turtlelog.draw.output_files import replace_file, replace_together
from turtlelog.draw.table_formats import format_latex
from turtlelog.errors import ShowError, describe_unknown, make_portable
from turtlelog.files.urls import make_path
from turtlelog.measure import measure_run
from turtlelog.processes import CAN_FORK, count_cores, map_in_processes
from turtlelog.run import Run, list_runs

FIGURE_FORMATS: Final = ("pdf", "png", "svg")

_UNUSED_TABLES: Final = ("GSUB", "GPOS", "GDEF", "MATH", "kern", "cmap", "post", "name", "OS/2")
"""Font tables on ligatures, look-up and names of glyphs. A PDF does not need them, because it finds
glyphs by index. ISO 32000-1, 9.9: a CIDFontType2 needs glyf, head, hhea, hmtx, loca, maxp, and, if
present, cvt, fpgm and prep."""
_LEAST_INCH: Final = 3.0
"""Width below which a figure keeps its height, because its text has the same size [inch]."""
_MOST_COLUMNS: Final = 4
"""Largest number of runs as columns; more runs become rows."""
_WIDE: Final = frozenset(
    {
        *("plant", "plane", "panel", "bode", "nyquist", "step"),
        *("attribution", "luck", "rates", "violation"),
    }
)
_WIDE_OF_RUNS: Final = frozenset({"root-locus"})
"""Figures with one panel if they show theory alone."""
_LEAST_DRAWN: Final = 3
"""Smallest number of figures per process if the number of processes is not given. A fork takes as
long as a fifth of a small figure, and the copies of changed memory as long again."""
_NO_DATE: Final = {
    "pdf": {"CreationDate": None, "ModDate": None},
    "svg": {"Date": None},
    "png": {"Software": None},
}
"""Metadata without dates, so that equal runs give identical files."""


def draw_figure(
    name: str,
    runs: Run | Iterable[Run] = (),
    *,
    page: Page | None = None,
    kinds: Mapping[str, FigureKind] | None = None,
) -> Figure:
    """Return one drawn figure, which a notebook can show. Several panels use the whole text width.

    Runs are drawn in the order of their gains.

    Args:
        name: Name from `FIGURES`.
        runs: Run or runs to draw.
        page: Page format.
        kinds: Figures that replace those of `FIGURES`, by name.

    Raises:
        ShowError: If there is no such figure, or the runs lack the data.
    """
    runs = list_runs(runs)
    kind, page = _find_kind(name, runs, kinds), page or Page()
    is_alone = name == "plane" and has_one_plane(runs)
    marked_panels.require_window(runs, page)
    if (name in _WIDE and not is_alone) or (runs and name in _WIDE_OF_RUNS):
        page = page.widen()
    with use_looks():
        size = (page.width_inch, max(page.width_inch, _LEAST_INCH) * kind.find_height(runs))
        figure = ShownFigure(figsize=size, layout="constrained")
        kind.draw_on(figure, compare.order_by_gain(runs))
        marked_panels.cut_time_axes(figure, runs, page)
        stress_window(
            figure, compare.order_by_gain(runs), marked_panels.find_shown_times(runs, page)
        )
        add_legend(figure, without=add_gain_bar(figure, compare.order_by_gain(runs)))
        page.fit(figure)
        if page.has_marks:
            is_cut = page.from_s is not None or page.to_s is not None
            marked_panels.mark_panels(figure, compare.order_by_gain(runs), is_cut=is_cut)
    return figure


def write_figures(
    runs: Run | Iterable[Run],
    folder: str | Path,
    *,
    only: Collection[str] | Mapping[str, FigureKind] | None = None,
    formats: Collection[str] = FIGURE_FORMATS,
    page: Page | None = None,
    jobs: int | None = 1,
) -> list[Path]:
    """Write figures as `<folder>/<name>.<format>` and return the files.

    Args:
        runs: Runs to draw: one in detail, several in the same axes, none for theory.
        folder: Folder of the files, which is created if necessary.
        only: Names in `FIGURES`, or figures that replace them by name. Default: all usual figures
            for which the runs have data.
        formats: Formats from `FIGURE_FORMATS`.
        page: Page format.
        jobs: Number of processes, at least 1. Default: one per core if that is faster. Processes
            are forked; systems other than Linux use one process. The files do not depend on this
            number.

    Raises:
        ShowError: If a name or format is unknown, `jobs` is not a number of processes, the runs
            lack the data of a named figure, or the folder cannot be written. Then nothing is
            written.
    """
    runs = list_runs(runs)
    with replace_together(folder) as write:
        return add_figures(write, runs, only=only, formats=formats, page=page, jobs=jobs)


def add_figures(
    write: Callable[[str, bytes], Path],
    runs: Sequence[Run],
    *,
    only: Collection[str] | Mapping[str, FigureKind] | None = None,
    formats: Collection[str] = FIGURE_FORMATS,
    page: Page | None = None,
    jobs: int | None = 1,
) -> list[Path]:
    """Write figures as `write_figures` does, with the function that `replace_together` yields."""
    unknown = [form for form in formats if form not in FIGURE_FORMATS]
    if unknown or not formats:
        found = repr(unknown[0]) if unknown else "none"
        raise ShowError(f"format: expected some of {', '.join(FIGURE_FORMATS)}, found {found}")
    if jobs is not None and jobs < 1:
        raise ShowError(f"jobs: expected at least 1 process, found {jobs}")
    kinds = only if isinstance(only, Mapping) else None
    names = [name for name in list_usual_figures() if not FIGURES[name].find_lack(runs)]
    for name in (only or ()) if names else FIGURES:
        _find_kind(name, runs, kinds)
    names = names if only is None else [*dict.fromkeys(only)]
    forms = [*dict.fromkeys(formats)]
    draw = partial(_draw_files, runs=runs, formats=forms, page=page or Page(), kinds=kinds)
    return [
        write(f"{name}.{form}", data)
        for name, files in _draw_in_processes(draw, names, jobs)
        for form, data in zip(forms, files, strict=True)
    ]


def _draw_in_processes(
    draw: Callable[[str], list[bytes]], names: Sequence[str], jobs: int | None
) -> Iterator[tuple[str, list[bytes]]]:
    """Yield each figure and its files, drawn in several processes if forking is possible.

    Each process draws consecutive figures. The figures of theory are drawn in one process, which
    loads their libraries. Distributing the figures one by one took a quarter more processor time.
    """
    if jobs is None:
        jobs = min(count_cores(), len(names) // _LEAST_DRAWN)
    jobs = max(min(jobs, len(names)) if CAN_FORK else 1, 1)
    cuts = [len(names) * part // jobs for part in range(jobs + 1)]
    parts = [names[first:after] for first, after in pairwise(cuts)]
    work = partial(_draw_until_error, draw)
    drawings = map_in_processes(work, parts, jobs, name=", ".join, is_forked=True)
    with closing(drawings):
        for part, (drawn, error) in zip(parts, drawings, strict=True):
            yield from zip(part, drawn, strict=False)
            if error is not None:
                raise error


def _draw_until_error(
    draw: Callable[[str], list[bytes]], names: Sequence[str]
) -> tuple[list[list[bytes]], Exception | None]:
    """Return the files of figures up to the first one that fails, with the error."""
    drawn: list[list[bytes]] = []
    try:
        drawn.extend(map(draw, names))
    except Exception as err:
        return drawn, make_portable(err)
    return drawn, None


def _draw_files(
    name: str,
    *,
    runs: Sequence[Run],
    formats: Sequence[str],
    page: Page,
    kinds: Mapping[str, FigureKind] | None,
) -> list[bytes]:
    """Return one figure in each format."""
    figure = draw_figure(name, runs, page=page, kinds=kinds)
    _settle_layout(figure)
    files = []
    for form in formats:
        data = io.BytesIO()  # matplotlib's PDF writer does not handle a full disk
        save_figure(figure, data, form, page)
        files.append(data.getvalue())
    return files


def save_figure(figure: Figure, data: io.BytesIO, form: str, page: Page | None = None) -> None:
    """Write a figure in one of `FIGURE_FORMATS`. Equal figures give equal bytes."""
    with use_looks():
        # `savefig` would draw everything once more to compute the layout.
        figure.dpi = (page or Page()).pixels_per_inch
        _arrange(figure)
        if form == "pdf":
            with _drop_unused_tables():
                FigureCanvasPdf(figure).print_pdf(data, metadata=_NO_DATE[form])
        elif form == "svg":
            FigureCanvasSVG(figure).print_svg(data, metadata=_NO_DATE[form])
        else:
            FigureCanvasAgg(figure).print_png(data, metadata=_NO_DATE[form])


_LAYOUTS: Final = 3
"""Number of layout computations after which square planes leave room for all labels."""


def _arrange(figure: Figure) -> None:
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
    with replace_file(path) as part:
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


def _settle_layout(figure: Figure) -> None:
    """Compute the layout of a figure once for all of its formats."""
    with use_looks():
        _arrange(figure)
    figure.set_layout_engine("none")


def _find_kind(
    name: str, runs: Sequence[Run], kinds: Mapping[str, FigureKind] | None = None
) -> FigureKind:
    if name not in FIGURES:
        raise ShowError(describe_unknown("figure", name, FIGURES, place="turtlelog list figures"))
    kind = (kinds or FIGURES)[name]
    lack = kind.find_lack(runs)
    if lack:
        raise ShowError(f"figure {name} needs {lack}")
    return kind


def write_tables(runs: Sequence[Run], folder: str | Path) -> list[Path]:
    """Write tables of runs, Table 1 and essential metrics as LaTeX with booktabs; return files.

    Table 1 is left out if no run has a value for it. The tables use the booktabs package.

    Raises:
        ShowError: If the folder cannot be written. Then nothing is written.
    """
    with replace_together(folder) as write:
        return add_tables(write, runs)


def add_tables(write: Callable[[str, bytes], Path], runs: Sequence[Run]) -> list[Path]:
    """Write tables as `write_tables` does, with the function that `replace_together` yields."""
    runs = compare.order_by_gain(runs)
    if len(runs) <= _MOST_COLUMNS:
        essentials = choose_essentials(runs, [measure_run(run) for run in runs])
        declarations = [run.declaration for run in runs]
        metrics = compare.tabulate_measured(
            compare.name_runs(runs), essentials, declarations=declarations
        )
    else:
        metrics = compare.tabulate_runs([compare.summarise_run(run) for run in runs])
    tables = {
        "whole-runs": compare.tabulate_whole_runs(runs),
        "table1": compare.tabulate_table1(runs),
        "metrics": metrics,
    }
    if not has_table1(runs):
        del tables["table1"]
    return [
        write(f"{name}.tex", format_latex(replace(table, label=f"tab:{name}")).encode())
        for name, table in tables.items()
    ]


_DPI: Final = 192
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
                self.dpi = _DPI
                _arrange(self)
                FigureCanvasAgg(self).print_png(data)
            finally:
                self.dpi = dpi
        width, height = (round(float(inch) * _BROWSER_DPI) for inch in self.get_size_inches())
        return data.getvalue(), {"width": width, "height": height}
