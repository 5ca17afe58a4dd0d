"""Several runs over each other as one Rerun recording: compared, or a run beside its what-ifs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import rerun as rr

from turtlelog.compare import Column, Table, name_runs, order_by_gain
from turtlelog.display import format_number
from turtlelog.errors import ShowError
from turtlelog.loops import PAUSE
from turtlelog.measure import Metric, find_first_stretch, list_metrics, measure_run
from turtlelog.run import Run
from turtlelog.show import palette
from turtlelog.show.documents import describe_runs
from turtlelog.show.palette import Color, choose_run_colors
from turtlelog.show.rerun import entities, plane
from turtlelog.show.rerun.content import Content, describe_content, find_largest
from turtlelog.show.rerun.entities import ALONG_TRACK, RUNS, join_path
from turtlelog.show.rerun.layout import (
    arrange_names,
    build_comparison_layout,
    build_explanation_layout,
    choose_names,
)
from turtlelog.show.rerun.marks import draw_events, draw_lines, draw_phases
from turtlelog.show.rerun.plots import (
    LevelLines,
    Series,
    draw_references,
    draw_series,
    list_compared_series,
    list_references,
)
from turtlelog.show.rerun.rrd_file import draw_documents, open_recording, send_comparison_properties
from turtlelog.show.rerun.timelines import (
    RunStream,
    Timelines,
    add_thinning,
    build_compared_timelines,
    read_span,
)
from turtlelog.show.rerun.world import draw_close_up, draw_world, draw_worst_place
from turtlelog.show.table_formats import format_markdown

_RECORDED: Final = "recorded"
_LEGEND_RADIUS: Final = 5.0  # [points]
_BAR_WIDTH: Final = 0.8
_LEGEND_SHARE: Final = 0.35


def write_comparison_rrd(
    runs: Sequence[Run], path: str | Path, *, documents: Mapping[str, str] | None = None
) -> None:
    """Write one recording of several runs over each other; time zero is each one's first sample.

    On the timeline of a later phase, as `translate_time`, it is the start of that phase in each.

    Args:
        runs: At least one; each keeps its colour in every view, in the order of `order_by_gain`.
        path: The .rrd file; replaced when the new one is complete.
        documents: Markdown texts by title, shown as tabs; `describe_runs` where None.

    Raises:
        ShowError: Where there is no run, or the file cannot be written.
    """
    if not runs:
        raise ShowError(f"{path}: expected at least one run to compare, found none")
    runs = order_by_gain(runs)
    metrics, overlay = [measure_run(run) for run in runs], _build_overlay(runs, name_runs(runs))
    if documents is None:
        documents = describe_runs(runs, metrics=metrics)
    documents = add_thinning(documents, runs)
    content = overlay.describe(documents)
    layout = build_comparison_layout(content)
    with open_recording(path, name=_name_recording(overlay.names), layout=layout) as stream:
        _draw_overlay(stream, overlay, content, metrics)
        draw_documents(stream, documents)


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
    overlay = _build_overlay([recorded, *without.values()], names)
    metrics = [measure_run(run) for run in overlay.runs]
    pairs = zip(without, metrics[1:], strict=True)
    of_metric = {name: known[metric] for name, known in pairs if metric in known}
    texts = {"Shares": _tabulate_shares(shares, metrics[0][metric], of_metric), **(documents or {})}
    texts = {**add_thinning(texts, overlay.runs)}
    dead_times = _list_dead_times(recorded, metrics[0])
    lines = {
        "pause": (palette.WANTED, _list_pause_times(recorded)),
        "dead_time": (palette.SAMPLED, [end_ns for _, end_ns in dead_times]),
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
        run_stream = _draw_overlay(stream, overlay, content, metrics)[0]
        _draw_shares(stream, shares, dict(zip(without, overlay.colors[1:], strict=True)))
        for line, (color, times_ns) in drawn.items():
            entity, label = f"{entities.LINES}/{line}", line.replace("_", " ")
            draw_lines(run_stream, entity, label, color, times_ns, largest=find_largest(content))
        _draw_dead_times(run_stream, dead_times)
        draw_documents(stream, texts)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Overlay:
    """Several runs and how they are told apart; all sequences are in the same order.

    Attributes:
        runs: At least one.
        names: No two alike.
        prefixes: Entity prefixes.
        colors: The same in every view.
        timelines: Aligned at the first samples.
        series: The curves of each.
        references: Level lines that all share.
    """

    runs: tuple[Run, ...]
    names: tuple[str, ...]
    prefixes: tuple[str, ...]
    colors: tuple[Color, ...]
    timelines: tuple[Timelines, ...]
    series: tuple[tuple[Series, ...], ...]
    references: tuple[LevelLines, ...]

    def describe(self, documents: Mapping[str, str]) -> Content:
        """Return what a recording of it holds."""
        return describe_content(
            self.runs, self.prefixes, self.series, self.references, documents, names=self.names
        )


def _build_overlay(runs: Sequence[Run], names: Sequence[str]) -> _Overlay:
    """Return runs with their colours, curves and timelines."""
    colors = choose_run_colors(len(runs))
    # The legend stands along the track, and has no room for more than the runs.
    references = [found for found in list_references(runs) if found.plot != ALONG_TRACK]
    return _Overlay(
        runs=tuple(runs),
        names=tuple(names),
        prefixes=tuple(join_path(RUNS, part) for part in _list_path_parts(names)),
        colors=colors,
        timelines=tuple(build_compared_timelines(run) for run in runs),
        series=tuple(
            list_compared_series(run, name, color)
            for run, name, color in zip(runs, names, colors, strict=True)
        ),
        references=tuple(references),
    )


def _draw_overlay(
    stream: rr.RecordingStream,
    overlay: _Overlay,
    content: Content,
    metrics: Sequence[Mapping[str, Metric]],
) -> list[RunStream]:
    """Draw all runs and what they share; return a stream for each run."""
    send_comparison_properties(stream, overlay.runs, overlay.names, overlay.prefixes, metrics)
    draw_world(stream, overlay.runs)
    span = read_span(overlay.runs, overlay.timelines)
    draw_references(stream, overlay.references, span)
    if content.legend_names:
        _draw_legend(stream, overlay.names, overlay.colors)
    streams = []
    for number, run in enumerate(overlay.runs):
        run_stream = RunStream(stream, overlay.prefixes[number], overlay.timelines[number])
        plane.draw_trace(run_stream, run, overlay.colors[number])
        plane.draw_reference_path(run_stream, run)
        plane.draw_turtle(run_stream, run, overlay.colors[number], content.plane.half_size_m)
        draw_phases(run_stream, run)
        draw_events(run_stream, run, overlay.names[number])
        for curves in overlay.series[number]:
            draw_series(run_stream, curves)
        streams.append(run_stream)
    if content.goal is not None:
        draw_close_up(
            stream,
            content.goal,
            overlay.runs[0],
            overlay.prefixes,
            overlay.colors,
            is_small=content.shares_title is not None,
        )
    if content.worst is not None:
        draw_worst_place(stream, content.worst, overlay.colors[content.worst.run])
    return streams


def _draw_legend(stream: rr.RecordingStream, names: Sequence[str], colors: Sequence[Color]) -> None:
    """Draw runs' names in their colours."""
    chosen = choose_names(len(names))
    shown = [names[number] for number in chosen]
    points = rr.Points2D(
        arrange_names(shown),
        radii=rr.Radius.ui_points(_LEGEND_RADIUS),
        colors=[colors[number] for number in chosen],
        labels=shown,
        show_labels=True,
    )
    stream.log(join_path(entities.LEGEND), points, static=True)


def _name_recording(names: Sequence[str]) -> str:
    return ", ".join(names) if len(names) <= 4 else f"{names[0]} to {names[-1]}, {len(names)} runs"


def _list_path_parts(names: Sequence[str]) -> list[str]:
    """Return a part of an entity path per name, without spaces, which a path shows as escapes."""
    plain = [name.replace(" ", "_") for name in names]
    parts = plain if len(set(plain)) == len(plain) else names
    return [rr.escape_entity_path_part(part) for part in parts]


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


def _list_dead_times(run: Run, metrics: Mapping[str, Metric]) -> list[tuple[int, int]]:
    """Return the dead time at the start of each loop, where it is known, in order of time.

    Each is a start and an end in the run's own time [ns], from a loop's first sample until its
    command acts. Of loops that begin together it is the longest.
    """
    ends_ns: dict[int, int] = {}
    for loop in run.declaration.loops:
        metric, stretch = metrics.get(f"{loop.name}.dead_time"), find_first_stretch(run, loop)
        if stretch and metric is not None and metric.value:
            start_ns = stretch[0].start_ns
            end_ns = start_ns + round(metric.value * 1e9)
            ends_ns[start_ns] = max(end_ns, ends_ns.get(start_ns, end_ns))
    return sorted(ends_ns.items())


def _draw_dead_times(run_stream: RunStream, spans_ns: Sequence[tuple[int, int]]) -> None:
    """Draw them as a bar of their own."""
    if not spans_ns:
        return
    style = rr.StateConfiguration(
        values=["dead time"], labels=[" "], colors=palette.pack_colors([palette.SAMPLED])
    )
    run_stream.log(entities.DEAD_TIME, style)
    times_ns = [time_ns for span_ns in spans_ns for time_ns in span_ns]
    columns = rr.StateChange.columns(state=["dead time", ""] * len(spans_ns))
    run_stream.send_few(entities.DEAD_TIME, times_ns, columns)


def _list_pause_times(run: Run) -> list[int]:
    """Return where each pause starts and ends [ns]."""
    pauses = [span for span in run.find_phase_spans() if span.phase == PAUSE]
    return [time_ns for span in pauses for time_ns in (span.start_ns, span.end_ns)]


def _format_metric(metric: Metric) -> str:
    if metric.value is None:
        return metric.status.value
    return format_number(metric.value, metric.unit)
