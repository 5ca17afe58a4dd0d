"""Recording of a run with its ghosts, without each effect, and with the effects' contributions."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import rerun as rr

from turtlelog.charts import attribution_steps, palette
from turtlelog.charts.close_up import Lettering, name_ends
from turtlelog.charts.luck_chart import build_luck_picture
from turtlelog.compare import Column, Table
from turtlelog.draw.rerun import entities, pictures, plane, plots, recording_stream, turtles
from turtlelog.draw.rerun.content import Content, describe_content
from turtlelog.draw.rerun.entities import join_path, name_part
from turtlelog.draw.rerun.layout import build_explanation_layout
from turtlelog.draw.rerun.recording_stream import RunStream, open_recording
from turtlelog.draw.rerun.turtles import Ghost, Look
from turtlelog.draw.written_tables import format_markdown
from turtlelog.errors import ShowError
from turtlelog.escapes import escape_markdown
from turtlelog.explain import Attribution, Luck, write_sentences
from turtlelog.measure import Metric, find_first_stretch, measure_run
from turtlelog.run import Run
from turtlelog.run.loops import PAUSE

_RECORDED: Final = "recorded"
_WIDTH: Final = 1.75
_THIN_WIDTH: Final = 0.75  # [points]
_THIN_SIZE: Final = 0.55
_MOST_TOLD: Final = 2  # ghosts with a value; more would be wider than the picture

_LONGEST: Final = 36
"""Longest name in the key [letters], which takes 250 of the 480 pixels of the plane."""

_LETTERING: Final = Lettering(letter=0.042, line=0.15, gap=0.08, reach=1.2)
"""Size of text, measured in a window of 1200 x 860 pixels, where the close-up is 480 x 370."""


def write_explanation_rrd(
    recorded: Run,
    found: Attribution,
    what_ifs: Mapping[str, Run],
    path: str | Path,
    *,
    luck: Luck | None = None,
    documents: Mapping[str, str] | None = None,
) -> None:
    """Write a recording of a run, with its what-ifs as ghosts and the attribution as steps.

    The last what-if is the main ghost: the run without all acting effects. Without what-ifs, the
    ideal loop is the main ghost if theory knows it. If contributions are withheld, the reason is
    shown instead.

    Args:
        recorded: Recorded run.
        found: Causes of a value of the run.
        what_ifs: Runs without causes, from `simulate_what_ifs`.
        path: The .rrd file. An existing file is replaced when the new one is complete.
        luck: Values from other starts, from `measure_luck`: a picture next to the steps, and ends
            in the close-up of the goal.
        documents: Markdown texts by title, shown as tabs after the table of contributions.

    Raises:
        ShowError: If there are neither contributions nor a ghost, or the file cannot be written.
    """
    scene = _build_scene(recorded, found, what_ifs)
    if found.withheld and not scene.ghosts:
        raise ShowError(f"{path}: no contributions and no ghost to show: {found.withheld}")
    texts = {"Contributions": _describe_contributions(found), **(documents or {})}
    texts = {**recording_stream.add_thinning(texts, scene.runs)}
    metrics = [measure_run(run) for run in scene.runs]
    dead_times = _list_dead_time_spans(recorded, metrics[0])
    marked = {
        "pause": (palette.PAUSED, _list_pause_times(recorded)),
        "dead_time": (palette.DEAD_TIME, [end_ns for _, end_ns in dead_times]),
    }
    lines = {name: line for name, line in marked.items() if line[1]}
    content = scene.describe(texts)
    content = replace(
        content,
        lines=tuple(join_path(scene.prefixes[0], entities.LINES, name) for name in lines),
        steps_title=_name_steps(found),
        has_dead_time=bool(dead_times),
    )
    picture = None if luck is None else build_luck_picture(luck)
    if picture is not None:
        content = replace(
            content,
            luck_title=f"With other {picture.varied}s",
            starts=pictures.count_ends(picture, content.goal),
        )
    name = f"{recorded.name}, explained"
    with open_recording(path, name=name, layout=build_explanation_layout(content)) as stream:
        run_stream = _draw_scene(stream, scene, content, metrics)
        if found.withheld:
            pictures.draw_reason(stream, write_sentences(found))
        else:
            waterfall = attribution_steps.draw_up_attribution(found)
            ghosts = dict(zip(what_ifs, metrics[1:], strict=False))
            pictures.draw_waterfall_picture(stream, waterfall, _tell_ghosts(found, ghosts))
        if picture is not None:
            pictures.draw_luck_picture(stream, picture)
            pictures.draw_luck_ends(stream, picture, content.goal)
        for line, (color, times_ns) in lines.items():
            entity, label = f"{entities.LINES}/{line}", line.replace("_", " ")
            plots.draw_lines(
                run_stream, entity, label, color, times_ns, largest=content.find_largest_shown()
            )
        _draw_dead_times(run_stream, dead_times)
        recording_stream.draw_documents(stream, texts)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Scene:
    recorded: Run  # recorded run
    ghosts: tuple[Ghost, ...]  # ghosts, the main ghost last; empty if no ghost is known
    series: tuple[tuple[plots.Series, ...], ...]  # curves of the run and of each simulated ghost
    gaps: tuple[plots.Series, ...]  # distance of the ghosts from the run over time
    references: tuple[plots.LevelLines, ...]  # common level lines

    @property
    def runs(self) -> tuple[Run, ...]:
        """The recorded run and the simulated runs."""
        return (self.recorded, *(ghost.run for ghost in self.ghosts if ghost.is_run))

    @property
    def prefixes(self) -> tuple[str, ...]:
        """Entity prefixes of the runs."""
        recorded = join_path(entities.RUNS, _RECORDED)
        return (recorded, *(ghost.prefix for ghost in self.ghosts if ghost.is_run))

    def describe(self, documents: Mapping[str, str]) -> Content:
        """Return the content of the recording, with phases of only the run and the main ghost."""
        series = ((*self.series[0], *self.gaps), *self.series[1:])
        content = describe_content(self.runs, self.prefixes, series, self.references, documents)
        return replace(
            content,
            plane=plane.find_way_bounds([self.recorded, *(ghost.run for ghost in self.ghosts)]),
            ghosts=tuple(ghost.prefix for ghost in self.ghosts if not ghost.is_run),
            with_phases=min(content.with_phases, 2),
            phase_rows=(self.prefixes[0], *self.prefixes[1:][-1:]),
        )


def _build_scene(recorded: Run, found: Attribution, what_ifs: Mapping[str, Run]) -> _Scene:
    colors, ghosts = palette.choose_cause_colors(found.causes), []
    for number, (lacks, run) in enumerate(what_ifs.items(), start=1):
        look = Look(color=palette.GHOST, is_ghost=True, width=_WIDTH)  # of the main ghost
        if number < len(what_ifs) and lacks in colors:
            look = Look(color=colors[lacks], is_ghost=True, width=_THIN_WIDTH, size=_THIN_SIZE)
        prefix = join_path(entities.GHOSTS, name_part(f"without {lacks}"))
        brief = _name_briefly(lacks, found)
        ghosts.append(
            Ghost(
                name=f"without {lacks}", brief=brief, prefix=prefix, run=run, look=look, is_run=True
            )
        )
    ideal = None if ghosts else turtles.build_ideal_ghost(recorded)
    if ideal is not None:
        ghosts.append(ideal)
    drawn = [(_RECORDED, recorded, palette.MAIN, _WIDTH)]
    drawn += [(one.name, one.run, one.look.color, one.look.width) for one in ghosts if one.is_run]
    return _Scene(
        recorded=recorded,
        ghosts=tuple(ghosts),
        series=tuple(
            tuple(
                replace(curves, width=width)
                for curves in plots.list_compared_series(run, name, color)
            )
            for name, run, color, width in drawn
        ),
        gaps=turtles.list_gaps(recorded, ghosts),
        references=plots.list_references([run for _, run, _, _ in drawn]),
    )


def _name_briefly(lacks: str, found: Attribution) -> str:
    """Return a short name for the close-up; the key of the plane has the complete name."""
    if lacks in found.causes:
        return f"no {lacks}"
    return "neither" if len(found.deciding) == 2 else "none of these"


def _draw_scene(
    stream: rr.RecordingStream,
    scene: _Scene,
    content: Content,
    metrics: Sequence[Mapping[str, Metric]],
) -> RunStream:
    """Draw the run and its ghosts, and return the stream of the run."""
    recorded, half_size_m = scene.recorded, content.plane.half_size_m
    simulated = [ghost for ghost in scene.ghosts if ghost.is_run]
    names = [_RECORDED, *(ghost.name for ghost in simulated)]
    recording_stream.send_comparison_properties(stream, scene.runs, names, scene.prefixes, metrics)
    plane.draw_world(stream, scene.runs, half_size_m=half_size_m)
    timelines = [recording_stream.build_compared_timelines(run) for run in scene.runs]
    span = recording_stream.read_span(scene.runs, timelines)
    plots.draw_references(stream, scene.references, span)
    run_stream = RunStream(stream, scene.prefixes[0], timelines[0])
    look, segments = Look(color=palette.MAIN), turtles.count_segments(1 + len(scene.ghosts))
    turtles.draw_trail(run_stream, recorded, look, segments=segments)
    plane.draw_reference_path(run_stream, recorded)
    turtles.draw_turtle(run_stream, recorded.poses, look, half_size_m)
    streams = [run_stream]
    for ghost in scene.ghosts:
        own = recording_stream.build_compared_timelines(ghost.run)
        ghost_stream = turtles.draw_ghost(stream, ghost, own, half_size_m, segments=segments)
        streams += [ghost_stream] if ghost.is_run else []
    for own_stream, run, name, listed in zip(streams, scene.runs, names, scene.series, strict=True):
        if own_stream in (streams[0], streams[-1]):
            plots.draw_phases(own_stream, run)
        plots.list_events(own_stream, run, name)
        for curves in listed:
            plots.draw_series(own_stream, curves)
    for curves in scene.gaps:
        plots.draw_series(run_stream, curves)
    _draw_apart(stream, scene, content)
    colors = [palette.MAIN, *(ghost.look.color for ghost in simulated)]
    if content.goal is not None:
        ends = name_ends(content.goal, [_RECORDED, *(ghost.brief for ghost in simulated)])
        plane.draw_close_up(stream, ends, recorded, scene.prefixes, colors, lettering=_LETTERING)
    if content.worst is not None:
        plane.draw_worst_place(stream, content.worst, colors[content.worst.run])
    return run_stream


def _draw_apart(stream: rr.RecordingStream, scene: _Scene, content: Content) -> None:
    """Draw the distance of the main ghost, and name all turtles."""
    if scene.ghosts:
        main = scene.ghosts[-1]
        turtles.draw_gap(stream, scene.recorded, main, content.plane, "blue to grey")
        whole = main.name if len(main.name) <= _LONGEST else "without all of these"
        rows = [(_RECORDED, palette.MAIN), (whole, main.look.color)]
        rows += [(ghost.name, ghost.look.color) for ghost in reversed(scene.ghosts[:-1])]
        turtles.draw_key(stream, rows, content.plane, [scene.recorded, main.run])


def _name_steps(found: Attribution) -> str:
    value = found.resimulated if found.as_logged is None else found.as_logged
    if value is None:
        return f"Why {found.metric} has no value"
    if found.withheld:
        return f"Why there are no contributions to {found.metric}"
    return f"Why {found.metric} is {attribution_steps.choose_step_scale(found).format_value(value)}"


def _tell_ghosts(found: Attribution, ghosts: Mapping[str, Mapping[str, Metric]]) -> tuple[str, ...]:
    """Return text on the values of ghosts by cause, which no bar shows if causes act together."""
    acting = [share.cause for share in attribution_steps.choose_acting_contributions(found)]
    if len(acting) < 2:
        return ()
    scale = attribution_steps.choose_step_scale(found)
    told = [
        f"{scale.format_value(value)} without {name}"
        for name in acting
        if name in ghosts and (value := ghosts[name][found.metric].value) is not None
    ]
    if len(told) > _MOST_TOLD:
        told = ["each thin one is without one cause"]
    return (f"Ghosts: {', '.join(told)}",) if told else ()


def _describe_contributions(found: Attribution) -> str:
    """Return a Markdown table of each cause's contribution, and a summary in sentences."""
    table = Table(
        title=_name_steps(found),
        columns=(
            Column(title="cause"),
            Column(title="contribution", unit=found.unit),
            Column(title="without it alone", unit=found.unit),
            Column(title="without it means"),
        ),
        rows=tuple(
            (share.cause, share.contribution, share.alone, share.ending or share.meaning)
            for share in (*found.contributions, *found.others)
        ),
    )
    sentences = "\n\n".join(escape_markdown(text) for text in write_sentences(found))
    return f"{format_markdown(table)}\n{sentences}\n"


def _list_dead_time_spans(run: Run, metrics: Mapping[str, Metric]) -> list[tuple[int, int]]:
    """Return the intervals of known dead times at the start of each loop, in order of time.

    Each interval has a start and an end in the run's own time [ns], from a loop's first sample
    until its command acts. If loops begin together, the longest interval is returned.
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
    """Draw dead times as a separate bar below the bar of phases."""
    if not spans_ns:
        return
    style = rr.StateConfiguration(
        values=["dead time"], labels=[" "], colors=palette.pack_colors([palette.DEAD_TIME])
    )
    prefix = entities.locate_dead_times(run_stream.prefix)
    dead_times = RunStream(run_stream.stream, prefix, run_stream.timelines)
    dead_times.log("", style)
    times_ns = [time_ns for span_ns in spans_ns for time_ns in span_ns]
    columns = rr.StateChange.columns(state=["dead time", ""] * len(spans_ns))
    dead_times.send_few("", times_ns, columns)


def _list_pause_times(run: Run) -> list[int]:
    """Return start and end of each pause [ns]."""
    pauses = [span for span in run.find_phase_spans() if span.phase == PAUSE]
    return [time_ns for span in pauses for time_ns in (span.start_ns, span.end_ns)]
