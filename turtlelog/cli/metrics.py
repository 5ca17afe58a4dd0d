"""`turtlelog metrics`: measure recordings."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, Final

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli.exit_codes import EXIT_BAD_INPUT, EXIT_FINE
from turtlelog.cli.formats import FormatOptions, print_tables
from turtlelog.cli.measuring import MeasureOptions
from turtlelog.cli.options import Files, TopicOptions, Whole, require_files
from turtlelog.cli.output import (
    describe_metrics,
    print_csv,
    print_error,
    print_json_list,
)
from turtlelog.cli.summaries import watch_summaries
from turtlelog.errors import TurtlelogError

if TYPE_CHECKING:
    from turtlelog import RunSummary


_MOST_COLUMNS: Final = 6


def metrics(
    files: Files,
    /,
    *,
    measuring: MeasureOptions | None = None,
    all_: Annotated[bool, Parameter(name="--all", negative="")] = False,
    jobs: Whole = 1,
    formats: FormatOptions | None = None,
    topics: TopicOptions | None = None,
) -> int:
    """Measure recordings: the essential metrics as a table, a status where there is no value.

    Up to six runs stand side by side; of more, each has a row. Runs stand in
    order of their gains, and are called by their files where names are alike.
    JSON and CSV hold every metric, file by file in the order given. A file that
    cannot be read is reported on stderr; the others are measured, and the exit
    code is 2.

    Example: turtlelog metrics kp1.mcap kp4.mcap

    Example: turtlelog metrics kp4.mcap --only "translate.*" --band 0.05

    Args:
        files: Recordings (.mcap), ROS 2 bags, or the paper's logs (.json, .csv).
        all_: Show every metric, not only the essential ones.
        jobs: Processes to read and measure in.
    """
    require_files(files)
    measuring, topics = measuring or MeasureOptions(), topics or TopicOptions()
    kind = (formats or FormatOptions()).choose()
    chosen = _choose(measuring, kind, everything=all_)
    found = tl.summarise_files(
        files,
        measuring.build_settings(),
        only=chosen,
        topics=topics.build_choice(),
        jobs=jobs,
    )
    errors: list[TurtlelogError] = []
    summaries = watch_summaries(found, len(files), errors)
    if kind == "json":
        print_json_list(map(_describe, summaries))
    elif kind == "csv":
        units = [f"{name} [{tl.METRICS[name].unit}]" for name in chosen]
        print_csv(["file", "run", *units], map(_list_cells, summaries))
    else:
        has_more = measuring.only is None and len(chosen) < len(tl.METRICS)
        _print_tables(list(summaries), chosen, kind, tell_more=kind == "txt" and has_more)
    for err in errors:
        print_error(str(err))
    return EXIT_BAD_INPUT if errors else EXIT_FINE


def _choose(options: MeasureOptions, kind: str, *, everything: bool) -> tuple[str, ...]:
    """Return the metrics to compute."""
    patterns = options.list_patterns()
    if patterns is not None:
        return tl.choose_metrics(patterns)
    if everything or kind in {"json", "csv"}:
        return tuple(tl.METRICS)
    return tl.ESSENTIAL_METRICS


def _print_tables(
    summaries: "Sequence[RunSummary]", chosen: Sequence[str], kind: str, *, tell_more: bool
) -> None:
    if not summaries:
        return
    summaries = tl.order_by_gain(summaries)
    if len(summaries) > _MOST_COLUMNS:
        table = tl.tabulate_runs(summaries, only=chosen)
    else:
        names = tl.name_runs(summaries)
        table = tl.tabulate_measured(names, [summary.metrics for summary in summaries])
    if tell_more:
        more = f"{len(chosen)} of {len(tl.METRICS)} metrics: --all shows every one, --only chooses."
        table = replace(table, notes=(more, *table.notes))
    print_tables([table], kind)


def _list_cells(summary: "RunSummary") -> list[str | float]:
    """Return the row of a run: a status where there is no value."""
    cells = (
        found.status.value if found.value is None else found.value
        for found in summary.metrics.values()
    )
    return [summary.file, summary.name, *cells]


def _describe(summary: "RunSummary") -> dict[str, Any]:
    return {
        "file": summary.file,
        "name": summary.name,
        "metrics": describe_metrics(summary.metrics),
    }
