"""Options of pictures: page format, content of figures with special options, movies."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Literal

from cyclopts import Parameter

from turtlelog import draw
from turtlelog.cli.list_names import complete_metrics
from turtlelog.cli.options import MetricsAsked, Place
from turtlelog.cli.progress import show_progress
from turtlelog.cli.targets import require_new_target
from turtlelog.errors import ShowError, UsageError

if TYPE_CHECKING:
    from turtlelog import Run
    from turtlelog.draw import Page
    from turtlelog.draw.figures import FigureKind

    Only = Collection[str] | Mapping[str, FigureKind]


TIMELESS: Final = frozenset(
    {
        *("plant", "step-responses", "root-locus", "bode", "nyquist", "step"),
        *("gains", "luck", "strips"),
    }
)
"""Figures that a time window cannot cut: they have no time axis, and no driven path."""


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
    dpi: int | None = None
    from_s: Annotated[float | None, Parameter(name="--from", metavar="SECONDS")] = None
    to_s: Annotated[float | None, Parameter(name="--to", metavar="SECONDS")] = None
    marks: Annotated[bool, Parameter(negative=())] = False

    def build_page(
        self,
        formats: Sequence[str],
        names: Sequence[str] | None,
        *,
        usual: Literal["column", "page"] = "column",
    ) -> "Page":
        """Return the size, resolution and time range of the figures.

        Raises:
            UsageError: If an option has no effect: no format has a resolution, a slide has no text,
                or no figure has a time axis.
            ShowError: If a value is out of range.
        """
        if self.text_width is not None and self.kind == "slide":
            raise UsageError("--text-width: needs --for column or page, not slide")
        for option, bound_s in (("--from", self.from_s), ("--to", self.to_s)):
            if bound_s is not None and not math.isfinite(bound_s):
                raise UsageError(f"{option} {bound_s:g}: must be a finite time [s]")
            if bound_s is not None and names and TIMELESS.issuperset(names):
                found = ", ".join(names)
                raise UsageError(f"{option}: needs a figure over time, not {found}")
        if self.dpi is not None and "png" not in formats:
            raise UsageError(f"--dpi: is for png files, not {', '.join(formats)}")
        return draw.Page(
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

_OF_METRICS: Final = ("attribution", "gains", "luck", "strips")


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class AskedOptions(MetricsAsked):
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
        """Raise an error if an option belongs to a figure that is not drawn.

        Raises:
            UsageError: If an option has no figure, or a figure does not have its option.
        """
        if self.metric is not None and not {*names} & {*_OF_METRICS}:
            expected = "--only attribution, gains, luck or strips"
            raise UsageError(f"--metric: needs {expected}")
        if self.expect is not None and "violation" not in names:
            raise UsageError("--expect: needs --only violation")
        if self.expect is None and "violation" in names:
            raise UsageError("--only violation: needs --expect FORMULA")

    def bind(self, names: Sequence[str], runs: "Sequence[Run]") -> "Only":
        """Return figures by name, with the requested content."""
        kinds = draw.FIGURES
        unknown = [name for name in names if name not in kinds]
        if unknown or not runs:
            return names
        found = {name: kinds[name] for name in names}
        for name in found:
            if name in _BINDERS and not found[name].find_lack(runs):
                found[name] = _BINDERS[name](self, found[name], runs)
        return found


def _bind_attribution(
    asked: AskedOptions, kind: "FigureKind", runs: "Sequence[Run]"
) -> "FigureKind":
    """Explain the run, which may take seconds."""
    from turtlelog.draw.figures.explanation_figures import draw_attribution, explain_for_figure

    with show_progress("explaining", 100.0, "%") as progress:
        explained = explain_for_figure(runs, metric=asked.metric, report=progress.count)
    return replace(kind, draw=partial(draw_attribution, explained=explained))


def _bind_luck(asked: AskedOptions, kind: "FigureKind", runs: "Sequence[Run]") -> "FigureKind":
    """Simulate the run from other starts, which may take seconds."""
    from turtlelog.draw.figures.explanation_figures import draw_luck, measure_luck_for_figure
    from turtlelog.explain import Work

    with show_progress("simulated", 100.0, "%") as progress:
        work = Work(jobs=None, report=progress.count)
        luck = measure_luck_for_figure(runs, metric=asked.metric, work=work)
    return replace(kind, draw=partial(draw_luck, luck=luck))


def _bind_gains(asked: AskedOptions, kind: "FigureKind", _: "Sequence[Run]") -> "FigureKind":
    from turtlelog.draw.figures.gain_figure import draw_gains

    return replace(kind, draw=partial(draw_gains, metrics=asked.list_patterns()))


def _bind_strips(asked: AskedOptions, kind: "FigureKind", _: "Sequence[Run]") -> "FigureKind":
    from turtlelog.draw.figures.strip_figure import draw_strips

    return replace(kind, draw=partial(draw_strips, metrics=asked.list_patterns()))


def _bind_violation(asked: AskedOptions, kind: "FigureKind", runs: "Sequence[Run]") -> "FigureKind":
    """Check the run against the formula."""
    import turtlelog as tl
    from turtlelog.check.violation import find_judged_signal
    from turtlelog.cli.check import build_spec
    from turtlelog.draw.figures.time_panels import draw_violation

    if len(runs) != 1 or asked.expect is None:
        return kind
    (result,) = tl.check_runs(build_spec([asked.expect]), [(runs[0].name, runs[0])])
    found = find_judged_signal(runs[0], result)
    if found.signal is None:
        raise ShowError(f"figure violation: needs {_DRAWABLE}: {found.reason}")
    return replace(kind, draw=partial(draw_violation, violated=found.signal))


_BINDERS: Final = {
    "attribution": _bind_attribution,
    "gains": _bind_gains,
    "luck": _bind_luck,
    "strips": _bind_strips,
    "violation": _bind_violation,
}


_SUFFIXES = (".mp4", ".gif")


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class MovieOptions:
    """A movie of the runs.

    Attributes:
        movie: Write a movie of the runs driving into this .mp4 (VP9) or .gif file.
        length: Length of the movie [s], 1 to 600. Default: real time, at most 10 s.
    """

    movie: Place | None = None
    length: Annotated[float | None, Parameter(metavar="SECONDS")] = None


def require_movie(options: MovieOptions, files: Sequence[Path]) -> None:
    """Refuse a movie that cannot be written, before any file is read."""
    if options.movie is None:
        if options.length is not None:
            raise UsageError("--length: needs --movie NAME.mp4")
        return
    suffix = options.movie.suffix.lower()
    if suffix not in _SUFFIXES:
        raise UsageError(f"--movie {options.movie}: the name must end in .mp4 or .gif")
    require_new_target(options.movie, files, suffix=suffix)
    from turtlelog.draw.movie_file import require_encoder

    require_encoder(suffix)


def film_runs(runs: "Sequence[Run]", options: MovieOptions, *, timeline: str) -> None:
    """Write the movie if one is requested."""
    if options.movie is None:
        return
    from turtlelog.draw.movie_file import write_movie

    bare = next((run.name for run in runs if not len(run.poses)), None)
    if bare is not None:
        raise UsageError(f"--movie: {bare} has commands alone, and a movie needs poses")
    with show_progress("filming", 100.0, "%") as progress:
        write_movie(
            runs,
            options.movie,
            timeline=timeline,
            length_s=options.length,
            on_picture=progress.count,
        )
