"""`turtlelog plot`: figures and tables for print."""

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli import options
from turtlelog.cli.console import fill_lines, list_written, print_json, print_note, print_text
from turtlelog.cli.list_names import complete_figures, complete_metrics
from turtlelog.cli.plot_table import ViewOptions, draw_table, find_sweep_table
from turtlelog.cli.scenario import collect_runs
from turtlelog.cli.view import MovieOptions, film_runs, require_movie, require_scenes
from turtlelog.cli.work import Jobs, show_progress
from turtlelog.display import describe_count, join_words
from turtlelog.errors import ShowError, UsageError
from turtlelog.files.urls import RemotePath

if TYPE_CHECKING:
    from turtlelog.draw.figures import FigureKind

    Only = Collection[str] | Mapping[str, FigureKind]


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class PageOptions:
    """Page format of figures, and the shown part of the runs.

    Attributes:
        kind: column is one of two columns of a paper, page the whole width, slide 16:9 with large
            lettering. Figures with panels side by side always take the page. Default: column, and
            page for the table of a sweep.
        text_width: Width of the paper's text [mm], 120 to 1000; slides ignore it. Default: 181.
        dpi: Resolution of PNGs [dots per inch], 50 to 600. Default: 300; for a slide 144, which is
            1920 by 1080 pixels.
        from_s: Begin time axes here, from the first sample [s].
        to_s: End time axes here [s].
        marks: Mark rise, settling time with its band, peak and overshoot, dead time and pause on
            the curves that loops control, and cut single panels to the phase.
    """

    kind: Annotated[Literal["column", "page", "slide"] | None, Parameter(name="--for")] = None
    text_width: Annotated[float | None, Parameter(metavar="WIDTH")] = None
    dpi: Annotated[int | None, Parameter(metavar="DPI")] = None
    from_s: Annotated[float | None, Parameter(name="--from", metavar="SECONDS")] = None
    to_s: Annotated[float | None, Parameter(name="--to", metavar="SECONDS")] = None
    marks: Annotated[bool, Parameter(negative=())] = False

    @property
    def is_usual(self) -> bool:
        """Whether no option is given."""
        return self == PageOptions()

    def build_page(
        self,
        formats: Sequence[str],
        names: Sequence[str] | None,
        *,
        usual: Literal["column", "page"] = "column",
    ) -> "tl.draw.Page":
        """Return the size, resolution and time range of the figures.

        An option without effect is refused: no format has a resolution, a slide has no text, or no
        figure has a time axis.
        """
        if self.text_width is not None and self.kind == "slide":
            raise UsageError("--text-width: needs --for column or page, not slide")
        for option, bound_s in (("--from", self.from_s), ("--to", self.to_s)):
            if bound_s is not None and not math.isfinite(bound_s):
                raise UsageError(f"{option} {bound_s:g}: must be a finite time [s]")
            if bound_s is not None and names and not _list_cut(names):
                found = ", ".join(names)
                raise UsageError(f"{option}: needs a figure over time, not {found}")
        if self.dpi is not None and "png" not in formats:
            raise UsageError(f"--dpi: is for png files, not {', '.join(formats)}")
        return tl.draw.Page(
            kind=self.kind or usual,
            **({} if self.text_width is None else {"text_width_mm": self.text_width}),
            dpi=self.dpi,
            from_s=self.from_s,
            to_s=self.to_s,
            has_marks=self.marks,
        )


_DRAWABLE: Final = (
    "a signal in a band (always(abs(cross_track) <= 0.05)) or a metric that is a signal's value at"
    " a moment (final.position_error <= 0.05)"
)
"""Subjects that the figure violation can draw."""


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class AskedOptions:
    """Content of the figures attribution, gains, luck, strips and violation.

    Attributes:
        metric: Id of the metric that the figures `attribution` and `luck` show (turtlelog list
            metrics). For the figures `gains` and `strips` and for tables: metrics by id, pattern or
            name without loop (overshoot), separated by commas. Default: up to four.
        expect: Formula whose signal the figure violation shows. Example: "always(abs(cross_track)
            <= 0.05)".
    """

    metric: Annotated[str | None, Parameter(metavar="ID", completer=complete_metrics)] = None
    expect: Annotated[str | None, Parameter(metavar="FORMULA")] = None

    def require_figures(self, names: Sequence[str]) -> None:
        """Refuse an option whose figure is not drawn, and a figure without its option."""
        if self.metric is not None and not _list_figures(names, *_BY_METRIC):
            known = join_words(sorted(_list_figures(tl.draw.FIGURES, *_BY_METRIC)), last="or")
            raise UsageError(f"--metric: needs --only {known}")
        by_formula = _list_figures(names, "formula")
        if not by_formula:
            known = join_words(_list_figures(tl.draw.FIGURES, "formula"), last="or")
            options.refuse_given({"--expect": self.expect}, f"needs --only {known}")
        elif self.expect is None:
            raise UsageError(f"--only {by_formula[0]}: needs --expect FORMULA")

    def bind(self, names: Sequence[str], runs: "Sequence[tl.Run]") -> "Only":
        """Return figures by name, with the requested content."""
        if not (runs and {*names} <= {*tl.draw.FIGURES}):
            return names
        found = {name: tl.draw.FIGURES[name] for name in names}
        for name, kind in found.items():
            content = {} if kind.find_lack(runs) else self._read_content(name, kind, runs)
            if content and kind.draw is not None:
                found[name] = replace(kind, draw=partial(kind.draw, **content))
        return found

    def _read_content(
        self, name: str, kind: "FigureKind", runs: "Sequence[tl.Run]"
    ) -> Mapping[str, Any]:
        """Return the requested content of a figure, which may take seconds; empty if usual."""
        if kind.content == "metrics":
            return {"metrics": options.split_names(self.metric, "--metric")}
        if kind.prepare is not None:
            with show_progress("simulated", 100.0, "%") as progress:
                work = tl.explain.Work(jobs=None, report=progress.count)
                return kind.prepare(runs, metric=self.metric, work=work)
        if kind.content == "formula" and len(runs) == 1 and self.expect is not None:
            from turtlelog.check.spec import build_spec
            from turtlelog.check.violation import find_judged_signal

            (result,) = tl.check_runs(build_spec([self.expect]), [(runs[0].name, runs[0])])
            judged = find_judged_signal(runs[0], result)
            if judged.signal is None:
                raise ShowError(f"figure {name}: needs {_DRAWABLE}: {judged.reason}")
            return {"violated": judged.signal}
        return {}


_BY_METRIC: Final = ("metric", "metrics")


def _list_figures(names: Iterable[str], *contents: str) -> list[str]:
    """Return the named figures whose content a user may choose like that."""
    kinds = tl.draw.FIGURES
    return [name for name in names if name in kinds and kinds[name].content in contents]


def plot(  # noqa: PLR0913 (each is an option of the command)
    files: Annotated[list[options.Place] | None, Parameter(name="FILE")] = None,
    /,
    *,
    output: Annotated[options.Place | None, Parameter(name=("--output", "-o"))] = None,
    only: Annotated[str | None, Parameter(metavar="NAMES", completer=complete_figures)] = None,
    formats: Annotated[str | None, Parameter(name="--format", metavar="FORMATS")] = None,
    where: PageOptions = PageOptions(),
    asked: AskedOptions = AskedOptions(),
    view: ViewOptions = ViewOptions(),
    movie: MovieOptions = MovieOptions(),
    timeline: Annotated[str, Parameter(metavar="NAME")] = "sim_time",
    topics: options.ReadingOptions = options.ReadingOptions(),
    jobs: Jobs = None,
    json: options.Json = False,
) -> None:
    """Plot recordings as the paper's figures and tables, and the table of a sweep as maps.

    If OUT is a folder, it gets every figure for which the recordings have data. The figures
    attribution, bode, gains, luck, nyquist, rates, step, strips and violation are drawn only if
    --only names them. Omitted figures are listed on stderr, with the reasons. Without recordings,
    the figures show the ideal loop. If OUT ends in .pdf, .png or .svg, it is one figure: that of
    --only, otherwise an overview. Existing figures and tables are replaced.

    For the table of a sweep with two varied keys, each metric is a map. If one key is a gain, lines
    show the limits of its loop from theory. With one varied key, each metric is a curve. Other keys
    have the values of the base scenario, or a value in the middle; --at chooses others. Values are
    means over seeds. The printed lines contain the best row of each metric, and the command that
    runs it again. Without -o nothing is drawn. OUT may be a report (.html).

    Example: turtlelog plot kp4.mcap -o kp4.png

    Example: turtlelog plot kp1.mcap kp4.mcap -o figures --only heading,plane

    Example: turtlelog plot paper-kp10 -o bode.png --only bode

    Example: turtlelog plot kp10.mcap -o why.png --only attribution

    Example: turtlelog plot kp10.mcap -o luck.png --only luck

    Example: turtlelog plot runs/*.mcap -o gains.png --only gains --metric overshoot

    Example: turtlelog plot kp10.mcap -o turn.png --only heading --for slide --to 3

    Example: turtlelog plot kp1.mcap kp10.mcap --movie race.mp4

    Example: turtlelog plot results.parquet -o map.png

    Args:
        files: Recordings (.mcap), ROS 2 bags, the paper's logs (.json, .csv), or presets and
            scenario files (.toml), which are simulated; one is drawn in detail, several over each
            other. Or one table (.parquet) that `turtlelog sweep` wrote.
        output: Write into this folder, or one figure to this .pdf, .png or .svg file; with --movie
            it may be missing.
        only: Names of figures, separated by commas. turtlelog list figures prints the names.
        formats: One or more of pdf, png and svg, separated by commas. Default: pdf.
        timeline: Timeline of the movie: sim_time, or PHASE_time, from the start of a later phase of
            each run, as translate_time.
        jobs: Number of processes, on Linux. Default: one for every three figures of a folder, at
            most one per core.
        json: Print one JSON object instead of lines.
    """
    options.require_there(files or [])
    given = {"--only": only, "--format": formats, "--movie": movie.movie}
    table = find_sweep_table(files or [], view, given)
    files = options.list_files(files or [])
    if table is not None:
        patterns = options.split_names(asked.metric, "--metric")
        draw_table(table, output, view, where, patterns, json=json)
        return
    require_movie(movie, files)
    if movie.movie is None and timeline != "sim_time":
        raise UsageError("--timeline: needs --movie NAME.mp4")
    if output is None:
        require_scenes(files, movie)
        runs = collect_runs(files, topics)
        film_runs(runs, movie, timeline=timeline)
        _tell(_build_answer(files, runs, {}, [], (), movie), runs, json=json)
        return
    names = options.split_names(only, "--only")
    is_file = output.suffix.lower() in options.PICTURES
    _require_output(output, names, formats, files)
    kinds = options.split_names(formats, "--format") or ["pdf"]
    kinds = [output.suffix[1:].lower()] if is_file else kinds
    page = where.build_page(kinds, names)
    asked.require_figures(names or [])
    runs = collect_runs(files, topics)
    kinds_of = None if names is None else asked.bind(names, runs)
    settings = {"formats": kinds, "page": page, "jobs": jobs}
    tables, left_out = list[Path](), tuple[str, ...]()
    if is_file:
        name = names[0] if names else _choose_overview(runs)
        _draw_one(output, runs, only=kinds_of or [name], **settings)
        figures = {output: name}
    else:
        drawn, tables = _draw_all(output, runs, only=kinds_of, **settings)
        figures = {path: path.stem for path in drawn}
        left_out = tl.draw.list_left_out(runs, names) if runs else ()
    if page.has_marks and (names or is_file):
        left_out = (*left_out, *tl.draw.list_unmarked(runs, figures.values()))
    for line in left_out:
        print_note(f"plot: {line}")
    _tell_whole(figures.values(), page)
    film_runs(runs, movie, timeline=timeline)
    _tell(_build_answer(files, runs, figures, tables, left_out, movie), runs, json=json)


def _tell_whole(names: Collection[str], page: "tl.draw.Page") -> None:
    """Print the names of figures that the page's time window does not cut."""
    whole = dict.fromkeys(name for name in names if name not in _list_cut(names))
    if whole and (page.from_s is not None or page.to_s is not None):
        print_note(f"plot: not cut in time: {', '.join(whole)}")


def _list_cut(names: Iterable[str]) -> list[str]:
    """Return the figures that a time window cuts."""
    kinds = tl.draw.FIGURES
    return [name for name in names if name not in kinds or not kinds[name].is_timeless]


@dataclass(frozen=True, slots=True, kw_only=True)
class FigureAnswer:
    """A figure: file, name, content, and the corresponding figure of the paper."""

    file: str
    figure: str
    title: str
    paper: str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class PlotAnswer:
    """Result of drawing.

    Attributes:
        files: Names of the files, as given.
        ending: Ends of the runs, in words.
        figures: The figures.
        tables: Files of tables.
        left_out: Figures that were not drawn, with reasons.
        movie: The movie.
    """

    files: list[str]
    ending: str | None
    figures: list[FigureAnswer]
    tables: list[str]
    left_out: list[str]
    movie: str | None


def _build_answer(
    files: Sequence[Path],
    runs: "Sequence[tl.Run]",
    figures: Mapping[Path, str],
    tables: Sequence[Path],
    left_out: Sequence[str],
    movie: MovieOptions,
) -> PlotAnswer:
    kinds = tl.draw.FIGURES
    return PlotAnswer(
        files=[*map(str, files)],
        ending=tl.compare.describe_runs(runs) if runs else None,
        figures=[
            FigureAnswer(
                file=str(path),
                figure=name,
                title=kinds[name].title,
                paper=kinds[name].paper or None,
            )
            for path, name in figures.items()
        ],
        tables=[*map(str, tables)],
        left_out=list(left_out),
        movie=None if movie.movie is None else str(movie.movie),
    )


def _tell(answer: PlotAnswer, runs: "Sequence[tl.Run]", *, json: bool) -> None:
    if json:
        print_json(answer)
        return
    written = [figure.file for figure in answer.figures] + answer.tables
    written += filter(None, [answer.movie])
    said = [*filter(None, [answer.ending]), _describe_shown(answer, runs)]
    print_text("\n".join([fill_lines(said), *list_written(written)]))


def _describe_shown(answer: PlotAnswer, runs: "Sequence[tl.Run]") -> str:
    names = tl.compare.name_runs(runs)
    whose = join_words(names) if 0 < len(names) <= _MOST_NAMED else describe_count(len(runs), "run")
    of = f" of {whose}" if runs else " of the ideal loop"
    if len(answer.figures) == 1 and not answer.tables:
        (one,) = answer.figures
        return f"{one.file} shows the figure {one.figure}{of}: {one.title}."
    figures = list(dict.fromkeys(figure.figure for figure in answer.figures))
    if not figures:
        return f"{answer.movie} shows {whose} driving."
    tables = f" and {describe_count(len(answer.tables), 'table')}" if answer.tables else ""
    return f"{describe_count(len(figures), 'figure')}{tables}{of}: {', '.join(figures)}."


_MOST_NAMED: Final = 4
"""Largest number of runs in the first line."""


_OTHER_PICTURES: Final = frozenset(
    {".bmp", ".eps", ".gif", ".jpeg", ".jpg", ".ps", ".tif", ".tiff", ".webp"}
)
"""Suffixes that folders never have. A user who types such a suffix means a picture."""
_OVERVIEWS: Final = ("panel", "plane", "step-responses")
"""Default content of a single file: the first figure that has data."""


def _require_output(
    output: Path, names: list[str] | None, formats: str | None, files: Sequence[Path]
) -> None:
    suffix = output.suffix.lower()
    if suffix in options.PICTURES:
        if names is not None and len(names) != 1:
            raise UsageError(
                f"--only: {output} has room for one figure; write several to a folder: -o FOLDER"
            )
        if formats is not None:
            raise UsageError(f"--format: leave it out, the name {output} says it")
        options.require_new_target(output, files, suffix=suffix)
    elif suffix in _OTHER_PICTURES:
        raise UsageError(
            f"{output}: figures are written as .pdf, .png or .svg, or to a folder, not as"
            f" {output.suffix}"
        )
    elif isinstance(output, RemotePath):
        raise UsageError(f"{output}: a URL must end in .pdf, .png or .svg; folders are local")
    elif output.exists() and not output.is_dir():
        raise UsageError(
            f"{output}: is a file; name a folder, or a figure that ends in .pdf, .png or .svg"
        )


def _choose_overview(runs: "Sequence[tl.Run]") -> str:
    kinds = tl.draw.FIGURES
    name = next((one for one in _OVERVIEWS if not kinds[one].find_lack(runs)), _OVERVIEWS[0])
    print_note(f"plot: the figure {name}; --only chooses another (turtlelog list figures)")
    return name


def _draw_one(output: Path, runs: "Sequence[tl.Run]", **settings: Any) -> None:
    """Draw a figure into a file. The settings are those of `add_figures`."""
    from turtlelog.draw.figures.writing import add_figures

    with show_progress("drawing"), tl.log.replace_when_complete(output) as part:

        def write(_: str, data: bytes) -> Path:
            part.write_bytes(data)
            return output

        add_figures(write, runs, **settings)


def _draw_all(
    output: Path, runs: "Sequence[tl.Run]", only: "Only | None", **settings: Any
) -> tuple[list[Path], list[Path]]:
    from turtlelog.draw.figures.writing import add_figures, add_tables, replace_together

    most = len(settings["formats"]) * len(tl.draw.FIGURES if only is None else only)
    with (
        show_progress("drawing", most, "files at most") as progress,
        replace_together(output) as write,
    ):

        def count(name: str, data: bytes) -> Path:
            progress.done += 1
            return write(name, data)

        figures = add_figures(count, runs, only=only, **settings)
        tables = add_tables(write, runs) if only is None and runs else []
    return figures, tables
