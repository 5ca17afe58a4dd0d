"""A run beside what it would have been without one mechanism or another, as a Rerun recording."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import rerun as rr

from turtlelog.compare import Column, Table
from turtlelog.errors import ShowError
from turtlelog.loops import PAUSE
from turtlelog.measure import Metric, find_first_stretch, list_metrics, measure_run
from turtlelog.run import Run
from turtlelog.show import palette
from turtlelog.show.palette import Color
from turtlelog.show.rerun import drawing, entities
from turtlelog.show.rerun.comparison_scene import build_overlay, draw_overlay
from turtlelog.show.rerun.content import find_largest
from turtlelog.show.rerun.entities import join_path
from turtlelog.show.rerun.layout import build_explanation_layout
from turtlelog.show.rerun.marks import draw_lines
from turtlelog.show.rerun.rrd_file import open_recording
from turtlelog.show.rerun.timelines import RunStream, add_thinning
from turtlelog.show.table_formats import format_markdown

_RECORDED: Final = "recorded"
_BAR_WIDTH: Final = 0.8
_LEGEND_SHARE: Final = 0.35


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
    texts = {"Shares": _tabulate_shares(shares, metrics[0][metric], of_metric), **(documents or {})}
    texts = {**add_thinning(texts, overlay.runs)}
    dead_times = _list_dead_times(recorded, metrics[0])
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
        _draw_shares(stream, shares, dict(zip(without, overlay.colors[1:], strict=True)))
        for line, (color, times_ns) in drawn.items():
            entity, label = f"{entities.LINES}/{line}", line.replace("_", " ")
            draw_lines(run_stream, entity, label, color, times_ns, largest=find_largest(content))
        _draw_dead_times(run_stream, dead_times)
        drawing.draw_documents(stream, texts)


def _draw_shares(
    stream: rr.RecordingStream, shares: Mapping[str, float], colors: Mapping[str, Color]
) -> None:
    """Draw a bar per mechanism, in the colour of the run without it where there is one."""
    for number, (mechanism, share) in enumerate(shares.items(), start=1):
        # After the last bar, one of no height makes room for the legend.
        places = [number] if number < len(shares) else [number, number * (1.0 + _LEGEND_SHARE)]
        bar = rr.BarChart(
            [share, 0.0][: len(places)],
            abscissa=places,
            widths=[_BAR_WIDTH] * len(places),
            color=colors.get(mechanism, palette.REFERENCE),
        )
        entity = join_path(entities.SHARES, rr.escape_entity_path_part(mechanism))
        stream.log(entity, bar, static=True)


def _tabulate_shares(
    shares: Mapping[str, float], recorded: Metric, without: Mapping[str, Metric]
) -> str:
    """Return a Markdown table of each mechanism's share, and of the metric without it."""
    table = Table(
        title=f"{recorded.id}: {_format_metric(recorded)} as recorded",
        columns=(
            Column(title="mechanism"),
            Column(title="share", unit=recorded.unit),
            Column(title="without it alone", unit=recorded.unit),
        ),
        rows=tuple(
            (
                mechanism,
                shares.get(mechanism),
                without[mechanism].value if mechanism in without else None,
            )
            for mechanism in dict.fromkeys([*shares, *without])
        ),
    )
    return format_markdown(table)


@dataclass(frozen=True, slots=True, kw_only=True)
class _DeadSpan:
    """From a loop's first sample until its command acts, in the run's own time [ns]."""

    start_ns: int
    end_ns: int


def _list_dead_times(run: Run, metrics: Mapping[str, Metric]) -> tuple[_DeadSpan, ...]:
    """Return the dead time at the start of each loop, where it is known, in order of time.

    Of loops that begin together it is the longest.
    """
    ends_ns: dict[int, int] = {}
    for loop in run.declaration.loops:
        metric, stretch = metrics.get(f"{loop.name}.dead_time"), find_first_stretch(run, loop)
        if stretch and metric is not None and metric.value:
            start_ns = stretch[0].start_ns
            end_ns = start_ns + round(metric.value * 1e9)
            ends_ns[start_ns] = max(end_ns, ends_ns.get(start_ns, end_ns))
    return tuple(_DeadSpan(start_ns=start, end_ns=end) for start, end in sorted(ends_ns.items()))


def _draw_dead_times(run_stream: RunStream, spans: Sequence[_DeadSpan]) -> None:
    """Draw them as a bar of their own."""
    if not spans:
        return
    style = rr.StateConfiguration(
        values=["dead time"], labels=[" "], colors=palette.pack_colors([palette.SAMPLED])
    )
    run_stream.log(entities.DEAD_TIME, style)
    times_ns = [time_ns for span in spans for time_ns in (span.start_ns, span.end_ns)]
    columns = rr.StateChange.columns(state=["dead time", ""] * len(spans))
    run_stream.send_few(entities.DEAD_TIME, times_ns, columns)


def _list_pause_times(run: Run) -> list[int]:
    """Return where each pause starts and ends [ns]."""
    pauses = [span for span in run.find_phase_spans() if span.phase == PAUSE]
    return [time_ns for span in pauses for time_ns in (span.start_ns, span.end_ns)]


def _format_metric(metric: Metric) -> str:
    return metric.status.value if metric.value is None else f"{metric.value:.5g} {metric.unit}"
