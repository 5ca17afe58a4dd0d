"""Figures of `turtlelog plot` that show what an option asks for: a metric, a formula."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Annotated, Final

from cyclopts import Parameter

from turtlelog import draw
from turtlelog.cli.list_names import complete_metrics
from turtlelog.cli.options import split_names
from turtlelog.cli.progress import show_progress
from turtlelog.errors import ShowError, UsageError

if TYPE_CHECKING:
    from turtlelog import Run
    from turtlelog.draw.figures import FigureKind

    Only = Collection[str] | Mapping[str, FigureKind]

_DRAWABLE: Final = (
    "a signal in a band (always(abs(cross_track) <= 0.05)) or a metric that is a signal's value at"
    " a moment (final.position_error <= 0.05)"
)
"""What the figure violation can draw."""

_OF_METRICS: Final = ("attribution", "gains", "luck", "strips")


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class AskedOptions:
    """What the figures attribution, gains, luck, strips and violation show.

    Attributes:
        metric: The metric that attribution and luck are of, by its id (turtlelog list metrics); or
            those that gains and strips show: ids, patterns, or names of metrics of any loop
            (overshoot), separated by commas. For a table the metrics to show. Default: up to four.
        expect: The formula whose signal violation shows, as in "always(abs(cross_track) <= 0.05)".
    """

    metric: Annotated[str | None, Parameter(metavar="ID", completer=complete_metrics)] = None
    expect: Annotated[str | None, Parameter(metavar="FORMULA")] = None

    def require_figures(self, names: Sequence[str]) -> None:
        """Refuse options of figures that are not asked for.

        Raises:
            UsageError: If one has no figure, or a figure lacks its option.
        """
        if self.metric is not None and not {*names} & {*_OF_METRICS}:
            expected = "--only attribution, gains, luck or strips"
            raise UsageError(f"--metric: needs {expected}")
        if self.expect is not None and "violation" not in names:
            raise UsageError("--expect: needs --only violation")
        if self.expect is None and "violation" in names:
            raise UsageError("--only violation: needs --expect FORMULA")

    def bind(self, names: Sequence[str], runs: "Sequence[Run]") -> "Only":
        """Return figures by name, with what they are asked to show."""
        kinds = draw.FIGURES
        unknown = [name for name in names if name not in kinds]
        if unknown or not runs:
            return names
        found = {name: kinds[name] for name in names}
        for name in found:
            if name in _BINDERS and not found[name].find_lack(runs):
                found[name] = _BINDERS[name](self, found[name], runs)
        return found

    def list_metrics(self) -> list[str] | None:
        """Return the metrics that are asked for; None if none are."""
        return None if self.metric is None else split_names(self.metric, "--metric")


def _tell(names: Sequence[str]) -> str:
    return f"--only {','.join(names)}" if names else "none"


def _bind_attribution(
    asked: AskedOptions, kind: "FigureKind", runs: "Sequence[Run]"
) -> "FigureKind":
    """Explain the run; it may take seconds."""
    from turtlelog.draw.figures.attribution_figure import draw_attribution, explain_for_figure

    with show_progress("explaining", 100.0, "%") as progress:
        explained = explain_for_figure(runs, metric=asked.metric, report=progress.count)
    return replace(kind, draw=partial(draw_attribution, explained=explained))


def _bind_luck(asked: AskedOptions, kind: "FigureKind", runs: "Sequence[Run]") -> "FigureKind":
    """Simulate the run from other starts; it may take seconds."""
    from turtlelog.draw.figures.luck_figure import draw_luck, measure_luck_for_figure
    from turtlelog.explain import Work

    with show_progress("simulated", 100.0, "%") as progress:
        work = Work(jobs=None, report=progress.count)
        luck = measure_luck_for_figure(runs, metric=asked.metric, work=work)
    return replace(kind, draw=partial(draw_luck, luck=luck))


def _bind_gains(asked: AskedOptions, kind: "FigureKind", _: "Sequence[Run]") -> "FigureKind":
    from turtlelog.draw.figures.gain_figure import draw_gains

    return replace(kind, draw=partial(draw_gains, metrics=asked.list_metrics()))


def _bind_strips(asked: AskedOptions, kind: "FigureKind", _: "Sequence[Run]") -> "FigureKind":
    from turtlelog.draw.figures.strip_figure import draw_strips

    return replace(kind, draw=partial(draw_strips, metrics=asked.list_metrics()))


def _bind_violation(asked: AskedOptions, kind: "FigureKind", runs: "Sequence[Run]") -> "FigureKind":
    """Hold the run to the formula."""
    import turtlelog as tl
    from turtlelog.check.violation import find_judged_signal
    from turtlelog.cli.check import build_spec
    from turtlelog.draw.figures.violation_figure import draw_violation

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
