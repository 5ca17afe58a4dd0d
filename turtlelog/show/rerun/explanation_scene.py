"""A run beside what it would have been without one mechanism or another, as a Rerun recording."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final

from turtlelog.errors import ShowError
from turtlelog.loops import PAUSE
from turtlelog.measure import list_metrics, measure_run
from turtlelog.run import Run
from turtlelog.show import palette
from turtlelog.show.rerun import drawing, entities
from turtlelog.show.rerun.comparison_scene import build_overlay, draw_overlay
from turtlelog.show.rerun.content import find_largest
from turtlelog.show.rerun.dead_times import draw_dead_times, list_dead_times
from turtlelog.show.rerun.entities import join_path
from turtlelog.show.rerun.layout import build_explanation_layout
from turtlelog.show.rerun.marks import draw_lines
from turtlelog.show.rerun.recording import open_recording
from turtlelog.show.rerun.run_stream import add_thinning
from turtlelog.show.rerun.shares import draw_shares, tabulate_shares

_RECORDED: Final = "recorded"


def write_explanation_rrd(
    recorded: Run,
    without: Mapping[str, Run],
    shares: Mapping[str, float],
    path: str | Path,
    *,
    metric: str = "final.position_error",
    documents: Mapping[str, str] | None = None,
) -> None:
    """Write a recording of a run beside its what-ifs, with the mechanisms' shares as bars.

    The recorded run's pauses and dead times are marked on the time axes.

    Args:
        recorded: What happened.
        without: What would have happened without a mechanism, or several, by its name.
        shares: How much of the metric each mechanism caused, in its unit, by name.
        path: The .rrd file; replaced when the new one is complete.
        metric: Id of the metric that is shared out.
        documents: Markdown texts by title, shown as tabs after the table of shares.

    Raises:
        ShowError: Where the recorded run has no metric of that id, or the file cannot be written.
    """
    kinds = list_metrics(recorded.declaration)
    if metric not in kinds:
        raise ShowError(f"metric: expected an id such as final.position_error, found {metric!r}")
    names = [_RECORDED, *(f"without {mechanism}" for mechanism in without)]
    overlay = build_overlay([recorded, *without.values()], names)
    metrics = [measure_run(run) for run in overlay.runs]
    pairs = zip(without, metrics[1:], strict=True)
    of_metric = {name: known[metric] for name, known in pairs if metric in known}
    texts = {"Shares": tabulate_shares(shares, metrics[0][metric], of_metric), **(documents or {})}
    texts = {**add_thinning(texts, overlay.runs)}
    dead_times = list_dead_times(recorded, metrics[0])
    lines = {
        "pause": (palette.WANTED, _list_pause_times(recorded)),
        "dead_time": (palette.SAMPLED, [span.end_ns for span in dead_times]),
    }
    drawn = {name: found for name, found in lines.items() if found[1]}
    content = replace(
        overlay.describe(texts),
        lines=tuple(join_path(overlay.prefixes[0], entities.LINES, name) for name in drawn),
        legend_names=overlay.names,
        shares_title=f"Shares of {metric} [{kinds[metric].unit}]" if shares else None,
        has_dead_time=bool(dead_times),
    )
    name = f"{recorded.name}, explained"
    with open_recording(path, name=name, layout=build_explanation_layout(content)) as stream:
        run_stream = draw_overlay(stream, overlay, content, metrics)[0]
        draw_shares(stream, shares, dict(zip(without, overlay.colors[1:], strict=True)))
        for line, (color, times_ns) in drawn.items():
            entity, label = f"{entities.LINES}/{line}", line.replace("_", " ")
            draw_lines(run_stream, entity, label, color, times_ns, largest=find_largest(content))
        draw_dead_times(run_stream, dead_times)
        drawing.draw_documents(stream, texts)


def _list_pause_times(run: Run) -> list[int]:
    """Return where each pause starts and ends [ns]."""
    pauses = [span for span in run.find_phase_spans() if span.phase == PAUSE]
    return [time_ns for span in pauses for time_ns in (span.start_ns, span.end_ns)]
