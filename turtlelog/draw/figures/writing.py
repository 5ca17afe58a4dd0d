"""The figures and tables of runs as files, and what they leave out of the runs."""

import io
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Final, NamedTuple

from matplotlib.figure import Figure

from turtlelog import compare
from turtlelog.charts.close_up import ARRIVED_M, ON_PATH_M, format_length
from turtlelog.charts.curve_marks import list_characteristics
from turtlelog.charts.curves import lack_samples
from turtlelog.charts.plane_scene import list_paths
from turtlelog.draw.figures import figure_kinds, marked_panels, page as pages
from turtlelog.draw.figures.figure_curves import add_gain_bar, add_legend, label_runs
from turtlelog.draw.figures.figure_kinds import FIGURES, FigureKind, list_usual_figures
from turtlelog.draw.figures.figure_needs import GOAL, SAMPLES, Lack
from turtlelog.draw.figures.page import FIGURE_FORMATS, Page, ShownFigure, use_looks
from turtlelog.draw.figures.plane_panels import has_one_plane, stress_window
from turtlelog.draw.written_tables import choose_essentials, format_latex
from turtlelog.errors import ShowError, describe_unknown, make_portable
from turtlelog.files.urls import make_path
from turtlelog.log import replace_when_complete
from turtlelog.measure import measure_run
from turtlelog.processes import CAN_FORK, count_cores, map_in_processes
from turtlelog.run import Run, list_runs

_MOST_COLUMNS: Final = 4  # runs as columns; more runs become rows
_LEAST_INCH: Final = 3.0
"""Width below which a figure keeps its height, because its text has the same size [inch]."""

_LEAST_DRAWN: Final = 3
"""Smallest number of figures per process if the number of processes is not given. A fork takes as
long as a fifth of a small figure, and the copies of changed memory as long again."""


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
    runs = compare.order_by_gain(runs)
    marked_panels.require_window(runs, page)
    if kind.is_wide(runs):
        page = page.widen()
    with use_looks():
        size = (page.width_inch, max(page.width_inch, _LEAST_INCH) * kind.find_height(runs))
        figure = ShownFigure(figsize=size, layout="constrained")
        kind.draw_on(figure, runs)
        marked_panels.cut_time_axes(figure, runs, page)
        window_s = marked_panels.find_shown_times(runs, page)
        stress_window(figure, runs, window_s)
        add_legend(figure, without=add_gain_bar(figure, runs))
        page.fit(figure)
        if page.has_marks:
            marked_panels.mark_panels(figure, runs, is_cut=window_s is not None)
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
    figure = draw_figure(name, runs, page=page, kinds=kinds)
    with use_looks():
        pages.arrange_panels(figure)
    figure.set_layout_engine("none")  # the layout is the same in all formats
    files = []
    for form in formats:
        data = io.BytesIO()  # matplotlib's PDF writer does not handle a full disk
        pages.save_figure(figure, data, form, page)
        files.append(data.getvalue())
    return files


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
        **({"table1": compare.tabulate_table1(runs)} if _has_table1(runs) else {}),
        "metrics": metrics,
    }
    return [
        write(f"{name}.tex", format_latex(replace(table, label=f"tab:{name}")).encode())
        for name, table in tables.items()
    ]


_MOST_NAMED: Final = 3  # runs that are named as missing from a figure; more runs are only counted

_ARRIVAL: Final = f"one goal, and a run that ends within {format_length(ARRIVED_M)} of it"

_DEPARTURE: Final = f"one path, and a run that is more than {format_length(ON_PATH_M)} off it"


def list_left_out(runs: Sequence[Run], names: Iterable[str] | None = None) -> tuple[str, ...]:
    """Return what figures leave out of some runs and why, one line for each reason.

    Args:
        runs: Runs to draw, with the names of legends in these lines.
        names: Names of the requested figures. Default: all figures, and the tables.
    """
    runs = compare.order_by_gain(runs)
    left_out: _Left = {}
    shown = list_usual_figures() if names is None else tuple(dict.fromkeys(names))
    for name in shown:
        for part, lacks in _list_parts(name, runs):
            for lack in dict.fromkeys(filter(None, lacks)):
                lacking = tuple(number for number, one in enumerate(lacks) if one == lack)
                left_out.setdefault((lack, lacking), []).append(part)
    if lack_samples(runs):
        left_out = _join_controller(left_out, has_tables=names is None)
    lines = [_describe(lack, lacking, parts, runs) for (lack, lacking), parts in left_out.items()]
    if names is None and not _has_table1(runs) and not lack_samples(runs):
        needed = GOAL if any(len(run.samples) for run in runs) else SAMPLES
        lines.append(f"left out table1.tex: needs a gain or {needed.words}")
    return (*lines, *_tell_parts(runs, shown))


def list_unmarked(runs: Sequence[Run], names: Iterable[str]) -> tuple[str, ...]:
    """Return one line on the named figures whose curves have no characteristics, if any."""
    found = [list_characteristics(run, measure_run(run)) for run in runs]
    lacking = []
    for name in names:
        kind = FIGURES[name]
        signals = (
            [one.plot for one in kind.choose_panels(runs) if one.plot] if not kind.draw else []
        )
        if not any(marked_panels.has_marks(one, marks) for one in signals for marks in found):
            lacking.append(name)
    expected = "a curve with characteristics"
    return (f"left marks out of {', '.join(lacking)}: needs {expected}",) if lacking else ()


def _tell_parts(runs: Sequence[Run], shown: Sequence[str]) -> Iterator[str]:
    """Yield what the figure of states, and a plane without a close-up, leave out."""
    most, states = figure_kinds.MOST_STATES, figure_kinds.list_state_panels(runs, most=sys.maxsize)
    if "states" in shown and len(states) > most:
        found = f"expected at most {most} panels, found {len(states)}"
        yield f"left out states (from {states[most].name} on): {found}"
    is_bare = lack_samples(runs) and not any(run.goal_xy_m for run in runs)
    if "plane" in shown and not is_bare and has_one_plane(runs):
        follows = bool(list_paths(runs))
        part, needed = (
            ("furthest off the path", _DEPARTURE) if follows else ("how each run ends", _ARRIVAL)
        )
        yield f"left out plane ({part}): needs {needed}"


class _Part(NamedTuple):
    """A figure, one of its panels, or a table."""

    name: str  # name of the figure, or of the table's file
    panel: str = ""  # name of the panel; empty for the whole

    def describe(self) -> str:
        """Return the name, with the panel in parentheses."""
        return f"{self.name} ({self.panel})" if self.panel else self.name


_Left = dict[tuple[Lack, tuple[int, ...]], list[_Part]]
"""Omitted figures and panels, by missing data and by the runs without these data."""


def _join_controller(left_out: _Left, *, has_tables: bool) -> _Left:
    """Return missing controller data as one line: a recording without samples has none."""
    of_motion: _Left = {}
    of_controller: list[_Part] = []
    for (lack, lacking), parts in left_out.items():
        if lack.is_of_motion:
            of_motion[lack, lacking] = parts
        else:
            of_controller += [part for part in parts if not (part.name == "panel" and part.panel)]
            everyone = lacking
    if not of_controller:
        return of_motion
    tables = [_Part("table1.tex")] if has_tables else []
    return {(SAMPLES, everyone): [*of_controller, *tables], **of_motion}


def _has_table1(runs: Sequence[Run]) -> bool:
    """Return whether Table 1 of these runs contains anything but their names."""
    rows = compare.tabulate_table1(runs).rows
    return any(value is not None for row in rows for value in row[1:])


def _list_parts(name: str, runs: Sequence[Run]) -> list[tuple[_Part, tuple[Lack | None, ...]]]:
    """Return a figure, or its panels if their needs differ, with the data that each run lacks."""
    kind = FIGURES[name]
    chosen = kind.choose_panels(runs) if kind.draw is None else ()
    if kind.draw is None and not kind.is_usual and not chosen:
        return []
    if not kind.panels:
        return [(_Part(name), kind.needs.find_lacks(runs))]
    parts = [panel for panel in kind.panels if panel.is_usual or panel in chosen]
    if not chosen or len({(panel.needs, panel.loop) for panel in parts}) == 1:
        return [(_Part(name), parts[0].find_lacks(runs))]
    return [(_Part(name, panel.name), panel.find_lacks(runs)) for panel in parts]


def _describe(
    lack: Lack, lacking: Sequence[int], parts: Sequence[_Part], runs: Sequence[Run]
) -> str:
    listed = ", ".join(part.describe() for part in parts)
    if len(lacking) == len(runs):
        return f"left out {listed}: needs {lack.words}"
    labels = label_runs(runs)
    named = ", ".join(labels[number] for number in lacking[:_MOST_NAMED])
    more = f" and {len(lacking) - _MOST_NAMED} more" if len(lacking) > _MOST_NAMED else ""
    return f"left {named}{more} out of {listed}: needs {lack.words}"


@contextmanager
def replace_together(folder: str | Path) -> Iterator[Callable[[str, bytes], Path]]:
    """Yield a function that writes files into a folder by name; all appear together at the end.

    If the block fails, or the folder cannot be written, no file and no new folder remain.
    """
    folder = make_path(folder)
    with ExitStack() as undoing:
        try:
            for new in [place for place in (folder, *folder.parents) if not place.exists()][::-1]:
                new.mkdir(exist_ok=True)
                undoing.callback(_remove_folder, new)
            folder.mkdir(exist_ok=True)
        except OSError as err:
            raise ShowError(
                f"{folder}: expected a folder to write to, found: {err.strerror or err}"
            ) from err
        with ExitStack() as parts:

            def write(name: str, data: bytes) -> Path:
                part = replace_when_complete(folder / name, raising=ShowError)
                parts.enter_context(part).write_bytes(data)
                return folder / name

            yield write
        undoing.pop_all()


def _remove_folder(folder: Path) -> None:
    with suppress(OSError):  # another program may write there, too
        folder.rmdir()
