"""Several runs in one Rerun recording, in the same views."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
import rerun as rr

from turtlelog.charts import many_runs, palette
from turtlelog.charts.close_up import name_ends
from turtlelog.charts.many_runs import has_grey_paths
from turtlelog.charts.plane_scene import move_near
from turtlelog.compare import name_runs, order_by_gain
from turtlelog.draw.documents import document_runs
from turtlelog.draw.rerun import entities, plane, plots, world
from turtlelog.draw.rerun.content import (
    Content,
    choose_phase_rows,
    describe_content,
    find_heading_close_up,
    find_ranges,
)
from turtlelog.draw.rerun.entities import ALONG_TRACK, RUNS, join_path, name_part
from turtlelog.draw.rerun.layout import (
    build_comparison_layout,
    draw_legend,
    draw_scale,
    is_small,
    tell_span,
    title_scale,
)
from turtlelog.draw.rerun.marks import draw_phases, list_events
from turtlelog.draw.rerun.plane import Look, count_segments, draw_trail, draw_turtle
from turtlelog.draw.rerun.rrd_file import draw_documents, open_recording, send_comparison_properties
from turtlelog.draw.rerun.timelines import (
    RunStream,
    Timelines,
    add_thinning,
    build_compared_timelines,
    read_span,
)
from turtlelog.errors import ShowError
from turtlelog.measure import measure_run
from turtlelog.run import Run, list_runs

_THIN_WIDTH: Final = 1.0
_OF_MANY: Final = Look(color=palette.PATH_OF_MANY, width=0.75)
"""Style of the paths of very many runs; only their ends have colours."""
_MOST_EXTREMES: Final = 3
"""Largest number of runs that are named in the plane; more names would hide the paths."""

_EXTREME_SHARE: Final = 0.2
"""Smallest distance of a name from the goal or another name, as a share of half the plane; nearer
names would cover others."""


def write_comparison_rrd(
    runs: Run | Iterable[Run],
    path: str | Path,
    *,
    documents: Mapping[str, str] | None = None,
    size: tuple[int, int] | None = None,
) -> None:
    """Write one recording of several runs. Time zero is the first sample of each run.

    On the timeline of a later phase, such as `translate_time`, time zero is the start of that
    phase.

    Args:
        runs: Runs, at least one; each has one colour in every view, in the order of
            `order_by_gain`.
        path: The .rrd file. An existing file is replaced when the new one is complete.
        documents: Markdown texts by title, shown as tabs. Default: those of `document_runs`.
        size: Size of the window [pixels], as in `write_run_rrd`.

    Raises:
        ShowError: If there is no run, or the file cannot be written.
    """
    runs = list_runs(runs)
    if not runs:
        raise ShowError(f"{path}: a comparison needs at least one run")
    runs = order_by_gain(runs)
    metrics = [measure_run(run) for run in runs]
    if documents is None:
        documents = document_runs(runs, metrics=metrics)
    documents = add_thinning(documents, runs)
    groups = many_runs.group_equal(runs)
    near, origin = move_near(runs)
    overlay = _build_overlay([near[first] for first, *_ in groups], _name_groups(runs, groups))
    equal = [name for name, group in zip(overlay.names, groups, strict=True) if len(group) > 1]
    content = replace(
        overlay.describe(documents),
        is_small=is_small(size),
        equal="; ".join(equal),
        origin=origin,
    )
    layout = build_comparison_layout(content)
    with open_recording(path, name=_name_recording(overlay.names), layout=layout) as stream:
        drawn = {number: place for place, group in enumerate(groups) for number in group}
        prefixes = [overlay.prefixes[drawn[number]] for number in range(len(runs))]
        send_comparison_properties(stream, runs, name_runs(runs), prefixes, metrics)
        _draw_overlay(stream, overlay, content)
        draw_documents(stream, documents)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Overlay:
    """Several runs with names and colours. All sequences have the same order.

    Attributes:
        runs: Runs, at least one.
        names: Different names of the runs.
        prefixes: Entity prefixes.
        colors: Colours of the runs in every view.
        timelines: Timelines, aligned at the first samples.
        series: Curves of each run.
        references: Common level lines.
        restless: Indices of the runs among many that never come to rest.
        scale: Number in which many runs differ; None if there is no single number.
    """

    runs: tuple[Run, ...]
    names: tuple[str, ...]
    prefixes: tuple[str, ...]
    colors: tuple[palette.Color, ...]
    timelines: tuple[Timelines, ...]
    series: tuple[tuple[plots.Series, ...], ...]
    references: tuple[plots.LevelLines, ...]
    restless: frozenset[int] = frozenset()
    scale: many_runs.GainScale | None = None

    def describe(self, documents: Mapping[str, str]) -> Content:
        """Return the content of the recording."""
        content = describe_content(
            self.runs, self.prefixes, self.series, self.references, documents, names=self.names
        )
        calm = [number for number in range(len(self.runs)) if number not in self.restless]
        content = replace(
            content,
            scale_title=None if self.scale is None else title_scale(self.scale),
            scale_span="" if self.scale is None else f"{self.scale.word} {tell_span(self.scale)}",
            phase_rows=choose_phase_rows(self.prefixes),
        )
        if not self.restless:
            return content
        settled = [self.runs[number] for number in calm]
        ranges = {
            **content.ranges,
            **find_ranges([self.series[number] for number in calm], self.references),
            **find_heading_close_up(settled),
        }
        lasting = max(run.end_ns - run.start_ns for run in settled) / 1e9
        longest = max(run.end_ns - run.start_ns for run in self.runs) / 1e9
        return replace(
            content,
            ranges=ranges,
            end_s=lasting if lasting < longest else None,
            length_s=longest,
            restless=many_runs.join_run_names(sorted(self.restless), self.names, self.scale),
            notes={**content.notes, **self._name_beyond(ranges)},
        )

    def _name_beyond(self, ranges: Mapping[str, tuple[float, float]]) -> dict[str, str]:
        """Return the restless runs that exceed the range of each plot that shows them."""
        found: dict[str, list[int]] = {}
        for number in sorted(self.restless):
            for series in self.series[number]:
                low, high = ranges.get(series.plot, (-np.inf, np.inf))
                values = series.values[np.isfinite(series.values)]
                if ((values < low) | (values > high)).any():
                    found.setdefault(series.plot, []).append(number)
        return {
            plot: f"{many_runs.join_run_names(numbers, self.names, self.scale)} beyond"
            for plot, numbers in found.items()
        }

    def name_briefly(self) -> tuple[str, ...]:
        """Return short names of the runs."""
        if self.scale is not None:
            return tuple(map(self.name_run, range(len(self.runs))))
        return many_runs.cut_alike(self.names)

    def name_run(self, number: int) -> str:
        """Return the name of a run among many in a picture: the value that the colours show."""
        return self.names[number] if self.scale is None else self.scale.name_run(number)


def _name_groups(runs: Sequence[Run], groups: Sequence[Sequence[int]]) -> list[str]:
    """Return a name for each group of equal runs. One run of a group is drawn with all names."""
    names = name_runs(runs)
    firsts = [runs[first] for first, *_ in groups]
    brief = many_runs.shorten_run_names(firsts, [names[first] for first, *_ in groups])
    return [
        name if len(group) == 1 else _name_equal(name, [names[number] for number in group])
        for name, group in zip(brief, groups, strict=True)
    ]


def _name_equal(name: str, names: Sequence[str]) -> str:
    if name not in names:
        return f"{name} ({len(names)} equal runs)"
    if len(names) == 2:
        return f"{names[0]} and {names[1]} are equal"
    return f"{name} and {len(names) - 1} more are equal"


def _build_overlay(runs: Sequence[Run], names: Sequence[str]) -> _Overlay:
    """Return runs with their colours, curves and timelines."""
    colors = many_runs.choose_colors_by_value(runs)
    restless = many_runs.find_restless(runs) if len(runs) > many_runs.MANY else frozenset()
    # The legend of the along-track plot has no room for more names than those of the runs.
    references = [found for found in plots.list_references(runs) if found.plot != ALONG_TRACK]
    return _Overlay(
        runs=tuple(runs),
        names=tuple(names),
        prefixes=tuple(join_path(RUNS, part) for part in _list_path_parts(names)),
        colors=colors,
        timelines=tuple(build_compared_timelines(run) for run in runs),
        series=tuple(
            _list_series(run, names[number], colors[number], is_restless=number in restless)
            if len(runs) > many_runs.MANY
            else plots.list_compared_series(run, names[number], colors[number])
            for number, run in enumerate(runs)
        ),
        references=tuple(references),
        restless=restless,
        scale=many_runs.find_color_scale(runs),
    )


def _list_series(
    run: Run, name: str, color: palette.Color, *, is_restless: bool
) -> tuple[plots.Series, ...]:
    """Return the curves of a run among many, without oscillating commands, which hide others."""
    found = plots.list_compared_series(run, name, color)
    if is_restless:
        found = tuple(series for series in found if series.plot not in entities.RESTLESS)
        color = palette.dim(color)
    return tuple(
        replace(series, colors=(color,) * len(series.colors), width=min(series.width, _THIN_WIDTH))
        for series in found
    )


def _draw_overlay(stream: rr.RecordingStream, overlay: _Overlay, content: Content) -> None:
    """Draw all runs and their common parts."""
    world.draw_world(stream, overlay.runs)
    span = read_span(overlay.runs, overlay.timelines)
    plots.draw_references(stream, overlay.references, span)
    if overlay.scale is not None:
        draw_scale(stream, overlay.scale, overlay.colors)
    elif content.legend_names:
        draw_legend(stream, overlay.names, overlay.colors)
    if len(overlay.runs) > many_runs.MANY:
        _show_ends(stream, overlay, content)
    for number, run in enumerate(overlay.runs):
        run_stream = RunStream(stream, overlay.prefixes[number], overlay.timelines[number])
        look = Look(
            color=overlay.colors[number], size=palette.choose_turtle_size(len(overlay.runs))
        )
        way = _OF_MANY if has_grey_paths(overlay.runs) else look
        draw_trail(run_stream, run, way, segments=count_segments(len(overlay.runs)))
        plane.draw_reference_path(run_stream, run)
        draw_turtle(run_stream, run.poses, look, content.plane.half_size_m)
        draw_phases(run_stream, run)
        list_events(run_stream, run, overlay.names[number])
        for curves in overlay.series[number]:
            plots.draw_series(run_stream, curves)
    if content.goal is not None:
        world.draw_close_up(
            stream,
            name_ends(content.goal, overlay.name_briefly()),
            overlay.runs[0],
            overlay.prefixes,
            overlay.colors,
            lettering=world.SMALL_LETTERING if content.is_small else world.LETTERING,
        )
    if content.worst is not None:
        world.draw_worst_place(stream, content.worst, overlay.colors[content.worst.run])


def _show_ends(stream: rr.RecordingStream, overlay: _Overlay, content: Content) -> None:
    """Name the runs that end furthest from the goal at their ends.

    Of very many runs, show all ends.
    """
    if has_grey_paths(overlay.runs):
        world.draw_ends(stream, overlay.runs, overlay.colors)
    if content.goal is None:
        return
    misses = [(_miss(run), number) for number, run in enumerate(overlay.runs)]
    least_m, furthest = _EXTREME_SHARE * content.plane.half_size_m, list[int]()
    for miss_m, number in sorted(misses, reverse=True):
        place = overlay.runs[number].poses.xy_m[-1]
        ways = [place - overlay.runs[other].poses.xy_m[-1] for other in furthest]
        if miss_m > least_m and all(np.hypot(*way) > least_m for way in ways):
            furthest.append(number)
    furthest = furthest[:_MOST_EXTREMES]
    if not furthest:
        return
    places = [overlay.runs[number].poses.xy_m[-1] for number in furthest]
    names = [overlay.name_run(number) for number in furthest]
    world.write_words(
        stream, entities.EXTREMES, places, names, [overlay.colors[number] for number in furthest]
    )


def _miss(run: Run) -> float:
    return 0.0 if run.goal_xy_m is None else float(np.hypot(*(run.poses.xy_m[-1] - run.goal_xy_m)))


def _name_recording(names: Sequence[str]) -> str:
    return ", ".join(names) if len(names) <= 4 else f"{names[0]} to {names[-1]}, {len(names)} runs"


def _list_path_parts(names: Sequence[str]) -> list[str]:
    """Return a part of an entity path for each name, without spaces, which look like escapes."""
    plain = [name_part(name) for name in names]
    if len(set(plain)) == len(plain):
        return plain
    return [rr.escape_entity_path_part(name) for name in names]
