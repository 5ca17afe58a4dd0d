"""`turtlelog compare`: runs beside each other."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli.options import Files, Json, TopicOptions, read_runs
from turtlelog.cli.output import print_json, print_note, print_text
from turtlelog.cli.progress import show_progress
from turtlelog.cli.targets import require_new_target
from turtlelog.errors import UsageError

if TYPE_CHECKING:
    from turtlelog import Comparison, Run


def compare(
    files: Files,
    /,
    *,
    reference: Path | None = None,
    rrd: Annotated[Path | None, Parameter(name="--rrd")] = None,
    topics: TopicOptions | None = None,
    json: Json = False,
) -> None:
    """Compare runs across gains and against a reference, aligned at their first samples.

    Example: turtlelog compare kp1.mcap kp4.mcap --rrd comparison.rrd

    Args:
        files: Recordings (.mcap), ROS 2 bags, or the paper's logs (.json, .csv).
        reference: The run that differences are taken from; otherwise the first file.
        rrd: Write all runs into one Rerun recording.
        json: Print one JSON object instead of tables.
    """
    paths = [*([] if reference is None else [reference]), *files]
    if len(paths) < 2:
        raise UsageError(f"FILE: expected at least two runs to compare, found {len(paths)}")
    require_new_target(rrd, paths, suffix=".rrd")
    runs = read_runs(paths, topics)
    comparisons = [tl.compare_runs(runs[0], run) for run in runs[1:]]
    if rrd is not None:
        with show_progress("drawing"):
            tl.write_comparison_rrd(runs, rrd)
        print_note(f"wrote {rrd}")
    if json:
        print_json(_describe(paths, comparisons))
    else:
        print_text(_format(runs, comparisons))


def _format(runs: "Sequence[Run]", comparisons: "Sequence[Comparison]") -> str:
    reference, *names = tl.name_runs(runs)
    tables = [
        tl.tabulate_table1(runs),
        tl.tabulate_whole_runs(runs),
        tl.tabulate_differences(comparisons, names=names, reference=reference),
    ]
    return "\n".join(map(tl.format_table, tables))


def _describe(paths: Sequence[Path], comparisons: "Sequence[Comparison]") -> dict[str, Any]:
    return {
        "reference": str(paths[0]),
        "alignment": "first_sample",
        "verdict": None,
        "runs": [
            {
                "file": str(path),
                "name": comparison.name,
                "overlap_s": comparison.overlap_s,
                "signals": _describe_signals(comparison),
                "metrics": _describe_metrics(comparison),
            }
            for path, comparison in zip(paths[1:], comparisons, strict=True)
        ],
    }


def _describe_signals(comparison: "Comparison") -> list[dict[str, Any]]:
    # No tolerances are asked for, so nothing is judged.
    unjudged = {"within": None, "tolerance": None, "first_outside_s": None}
    return [
        {
            "signal": found.signal,
            "unit": found.unit,
            "largest": found.largest,
            "at_s": found.at_s,
            **unjudged,
        }
        for found in comparison.signals
    ]


def _describe_metrics(comparison: "Comparison") -> list[dict[str, Any]]:
    return [
        {
            "id": found.metric.id,
            "value": found.metric.value,
            "unit": found.metric.unit,
            "status": found.metric.status.value,
            "reference": found.reference.value,
            "better": tl.METRICS[found.metric.id].better,
        }
        for found in comparison.metrics
    ]
