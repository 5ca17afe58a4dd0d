"""Several runs over each other as one Rerun recording."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import rerun as rr

from turtlelog.compare import name_runs, order_by_gain
from turtlelog.errors import ShowError
from turtlelog.measure import Metric, measure_run
from turtlelog.run import Run
from turtlelog.show.documents import describe_runs
from turtlelog.show.palette import Color, choose_run_colors
from turtlelog.show.rerun import entities, plane
from turtlelog.show.rerun.content import Content, describe_content
from turtlelog.show.rerun.entities import ALONG_TRACK, RUNS, join_path
from turtlelog.show.rerun.layout import (
    arrange_names,
    build_comparison_layout,
    choose_names,
)
from turtlelog.show.rerun.marks import draw_events, draw_phases
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
from turtlelog.show.rerun.turtles import Look, choose_size, count_segments, draw_trail, draw_turtle
from turtlelog.show.rerun.world import draw_close_up, draw_world, draw_worst_place

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
        look = Look(color=overlay.colors[number], size=choose_size(len(overlay.runs)))
        draw_trail(run_stream, run, look, segments=count_segments(len(overlay.runs)))
        plane.draw_reference_path(run_stream, run)
        draw_turtle(run_stream, run.poses, look, content.plane.half_size_m)
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
