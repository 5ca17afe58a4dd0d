"""Marks in or next to plots: metrics, lines, theory, phases, events; and short legends of plots."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
import rerun as rr

from turtlelog.charts import palette
from turtlelog.charts.curve_marks import SIGNS, MarkShape, list_characteristics
from turtlelog.charts.curves import Level, LoopStep, find_steps
from turtlelog.charts.time_plots import find_marked
from turtlelog.draw.rerun import entities
from turtlelog.draw.rerun.plots import LevelLines, Series
from turtlelog.draw.rerun.recording_stream import RunStream
from turtlelog.measure import Metric, find_first_stretch
from turtlelog.run import Run
from turtlelog.run.loops import DONE, PAUSE
from turtlelog.theory import compute_sampled_step_response

Shape = Literal["Circle", "Square", "Cross"]

_SHAPES: Final[Mapping[MarkShape, Shape]] = {"disc": "Circle", "square": "Square", "cross": "Cross"}
"""Mark shapes of the viewer."""

_MINOR: Final = frozenset({"rise_time", "time_to_goal"})
"""Metrics that neighbouring metrics bound: a rise ends before the curve settles."""

_SIZE: Final = 4.0  # [points]
_LINE_WIDTH: Final = 1.0
_DECADES: Final = 10.0 ** -np.arange(8.0)
_RESPONSE_WIDTH: Final = 1.0
_MOST_SAMPLES: Final = 1_000_000
_MOST_DEAD_SAMPLES: Final = 1000


@dataclass(frozen=True, slots=True, kw_only=True)
class Mark:
    """A metric at its point of a curve."""

    plot: str  # plot of the curve
    label: str  # legend text with the value. The name of the curve in a plot contains this text
    sign: str  # shape as a letter, because a legend shows only a dot
    shape: Shape  # Rerun's name of a marker
    time_ns: int  # time in the run's own time [ns]
    level: float  # value in the unit of the curve
    is_minor: bool = False  # whether a full legend may leave it out

    @property
    def entity(self) -> str:
        """Entity path of all marks of the plot, below the run's prefix."""
        return f"{self.plot}/{entities.MARKS}"


def list_marks(
    run: Run, series: Sequence[Series], metrics: Mapping[str, Metric]
) -> tuple[Mark, ...]:
    """Return the metrics that can be marked on a drawn curve."""
    curves = {curve.entity: curve for curve in series}
    marks = []
    for found in list_characteristics(run, metrics):
        name, entry = find_marked(found.signal) or ("", None)
        curve = curves.get("" if entry is None else _join(entities.name_plot(name), entry.name))
        if found.shape is None or curve is None or found.level is None:
            continue
        if found.kind == "dead_time":
            continue  # dead times have a bar of their own
        marks.append(
            Mark(
                plot=curve.plot,
                label=found.text,
                sign=found.sign,
                shape=_SHAPES[found.shape],
                time_ns=run.start_ns + round(found.marked_s * 1e9),
                level=found.level,
                is_minor=found.kind in _MINOR,
            )
        )
    return tuple(marks)


def _join(*parts: str) -> str:
    return "/".join(filter(None, parts))


def draw_marks(run_stream: RunStream, marks: Sequence[Mark]) -> None:
    """Draw each metric as a point whose name in the legend contains the value."""
    for entity in dict.fromkeys(mark.entity for mark in marks):
        found = [mark for mark in marks if mark.entity == entity]
        style = rr.SeriesPoints(
            names=[mark.label for mark in found],
            colors=palette.pack_colors([palette.MAIN] * len(found)),
            markers=[mark.shape for mark in found],
            marker_sizes=[_SIZE] * len(found),
        )
        run_stream.log(entity, style)
        # One row per mark; the others are NaN in it.
        levels = np.full((len(found), len(found)), np.nan)
        np.fill_diagonal(levels, [mark.level for mark in found])
        times_ns = [mark.time_ns for mark in found]
        run_stream.send_few(entity, times_ns, rr.Scalars.columns(scalars=levels))


def draw_lines(
    run_stream: RunStream,
    entity: str,
    label: str,
    color: palette.Color,
    times_ns: Sequence[int],
    *,
    largest: float,
) -> None:
    """Draw vertical lines at times of the run [ns], up to the `largest` value of any plot.

    Every plot that shows these lines needs a fixed range.
    """
    style = rr.SeriesLines(
        names=[label],
        colors=palette.pack_colors([color]),
        widths=[_LINE_WIDTH],
        aggregation_policy="Off",
    )
    run_stream.log(entity, style)
    # The viewer cannot draw a line thousands of plot heights long: the line has powers of ten as
    # points.
    steps = largest * _DECADES
    line = [*-steps, *steps[::-1], np.nan]
    levels = np.tile(line, len(times_ns))
    run_stream.send_few(entity, np.repeat(times_ns, len(line)), rr.Scalars.columns(scalars=levels))


def list_responses(run: Run, metrics: Mapping[str, Metric]) -> tuple[Series, ...]:
    """Return the response of each loop with the measured dead time, without limits.

    A loop has no response if its reference moves, theory does not know the loop, or its gain or
    dead time is unknown.
    """
    found: list[Series] = []
    for signal in dict.fromkeys(loop.signal for loop in run.declaration.loops):
        for number, step in enumerate(find_steps(run, signal)):
            if step.end_ns > step.start_ns:
                of = step.loop.name if number else ""
                dead_time = metrics.get(f"{step.loop.name}.dead_time")
                found += _compute_sampled(step, of, run, dead_time)
    return tuple(found)


def draw_phases(run_stream: RunStream, run: Run) -> None:
    """Draw the phases as a bar, which ends in `done` unless the run was cut off."""
    spans = run.find_phase_spans()
    if not spans:
        return
    style = rr.StateConfiguration(
        values=list(run.phase_names),
        # The pause is too short for its name; the view's title explains its colour.
        labels=[" " if name == PAUSE else name for name in run.phase_names],
        colors=palette.pack_colors(palette.choose_phase_colors(run.phase_names)),
    )
    prefix = entities.locate_phases(run_stream.prefix)
    phases = RunStream(run_stream.stream, prefix, run_stream.timelines)
    phases.log("", style)
    last = DONE if run.is_complete else ""
    columns = rr.StateChange.columns(state=[*(span.phase for span in spans), last])
    starts_ns = [*(span.start_ns for span in spans), run.end_ns]
    phases.send_few("", starts_ns, columns)


def list_events(run_stream: RunStream, run: Run, speaker: str = "") -> None:
    """List the events as a text log, each after a given speaker's name."""
    if not run.events:
        return
    columns = rr.TextLog.columns(
        text=[f"{speaker}: {event.text}" if speaker else event.text for event in run.events],
        level=["INFO" if event.kind == "stop" else "WARN" for event in run.events],
    )
    run_stream.send_few(entities.EVENTS, [event.time_ns for event in run.events], columns)


def list_dead_times(run: Run, metrics: Mapping[str, Metric]) -> list[tuple[int, int]]:
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


def draw_dead_times(run_stream: RunStream, spans_ns: Sequence[tuple[int, int]]) -> None:
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


def list_pause_times(run: Run) -> list[int]:
    """Return start and end of each pause [ns]."""
    pauses = [span for span in run.find_phase_spans() if span.phase == PAUSE]
    return [time_ns for span in pauses for time_ns in (span.start_ns, span.end_ns)]


def name_marks(marks: Sequence[Mark]) -> list[str]:
    """Return the legend text of marks, in order of time."""
    placed = sorted(marks, key=lambda found: found.time_ns)
    return [f"{mark.sign} {mark.label}" for mark in placed]


def _compute_sampled(
    step: LoopStep, of: str, run: Run, dead_time: Metric | None
) -> Iterator[Series]:
    steps_ns = np.diff(run.samples.time_ns)
    if dead_time is None or dead_time.value is None or not (steps_ns > 0).any():
        return
    period_s = float(np.median(steps_ns[steps_ns > 0])) / 1e9
    delay = round(dead_time.value / period_s)
    count = int((step.end_ns - step.start_ns) / 1e9 / period_s) + 1
    # Without a dead time it would be drawn over the ideal response.
    if count > _MOST_SAMPLES or not 0 < delay <= _MOST_DEAD_SAMPLES:
        return
    values = compute_sampled_step_response(
        step.kp,
        count,
        period_s=period_s,
        dead_time_ticks=delay,
        initial=step.initial,
        reference=step.reference,
    )
    label = f"+ {dead_time.value * 1e3:.3g} ms dead time"
    time_s = np.arange(count) * period_s
    yield Series(
        entity=_join(entities.name_plot(step.loop.signal), entities.SAMPLED, of),
        labels=(f"{label}, {of}" if of else label,),
        colors=(palette.IDEAL,),
        time_ns=step.start_ns + np.rint(time_s * 1e9).astype(np.int64),
        values=values[:, np.newaxis],
        width=_RESPONSE_WIDTH,
        is_main=False,
        is_measured=False,
    )


_LINE_LETTERS: Final = 46
"""Number of letters in a legend's line: in any window, the viewer breaks lines of more than 275
pixels."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Legends:
    """All curves, lines and marks of plots, with their names in legends."""

    series: tuple[Series, ...]  # curves
    references: tuple[LevelLines, ...]  # level lines
    marks: tuple[Mark, ...]  # metrics on curves
    names: Mapping[str, str]  # name of the main curve of each plot, which vertical lines share
    shown: frozenset[str]  # plots whose legend contains more than their title


def name_legends(
    series: Sequence[Series], references: Sequence[LevelLines], marks: Sequence[Mark] = ()
) -> Legends:
    """Return curves, level lines and marks under names that make a short legend of each plot.

    Items with one colour share a name. Limits and marks have the name of the main curve. Zero has
    no line, because the axis shows it.
    """
    lines = {line.plot: line for line in references}
    found = [
        _name_plot(
            [one for one in series if one.plot == plot],
            lines.get(plot),
            [mark for mark in marks if mark.plot == plot],
        )
        for plot in dict.fromkeys(curves.plot for curves in series)
    ]
    return Legends(
        series=tuple(one for named in found for one in named.series),
        references=tuple(line for named in found for line in named.references),
        marks=tuple(mark for named in found for mark in named.marks),
        names={plot: name for named in found for plot, name in named.names.items()},
        shown=frozenset(plot for named in found for plot in named.shown),
    )


def _name_plot(
    curves: Sequence[Series], lines: LevelLines | None, marks: Sequence[Mark]
) -> Legends:
    main = next((one for one in curves if one.is_main), curves[0])
    # Marks are sufficient for a curve with the name of its plot.
    is_named = not marks or main.entity != main.plot
    words: dict[palette.Color, list[str]] = {main.colors[0]: [main.labels[0]] if is_named else []}
    for one in curves:
        for color, label in zip(one.colors, one.labels, strict=True):
            said = f"lighter: {label}" if color == palette.tint(main.colors[0]) else label
            if one is main and label == main.labels[0]:
                continue
            words.setdefault(_join_tint(color, main), []).append(_describe(one, said))
    marks = _choose_marks(marks, _LINE_LETTERS - len(", ".join([*words[main.colors[0]], ""])))
    words[main.colors[0]] += [" ".join(name_marks(marks))] if marks else []
    levels = () if lines is None else lines.levels
    for level in levels:
        if level.kind in ("target", "tolerance"):
            words.setdefault(palette.IDEAL, []).insert(0, f"{level.label} {level.value:.4g}")
        elif level.kind == "limit" and level.value > 0.0:
            words[main.colors[0]].append(f"limit {level.value:.4g}")
    names = {color: ", ".join(dict.fromkeys(said)) for color, said in words.items()}
    name, plot = names[main.colors[0]], main.plot
    is_told = len(names) > 1 or name != main.labels[0]
    return Legends(
        series=tuple(
            replace(one, labels=tuple(names[_join_tint(color, main)] for color in one.colors))
            for one in curves
        ),
        references=tuple(_part_levels(plot, levels, names, main)),
        marks=tuple(replace(mark, label=name) for mark in marks),
        names={plot: name},
        shown=frozenset([plot] if is_told else []),
    )


def _choose_marks(marks: Sequence[Mark], letters: int) -> Sequence[Mark]:
    """Return the marks whose names fit a line, after less interesting marks are left out."""
    for least in [mark for mark in marks if mark.is_minor]:
        if len(" ".join(name_marks(marks))) > letters:
            marks = [mark for mark in marks if mark is not least]
    return marks


def _part_levels(
    plot: str, levels: Sequence[Level], names: Mapping[palette.Color, str], main: Series
) -> Iterator[LevelLines]:
    """Yield references in grey, and limits in the colour of the curve that they limit."""
    grey = tuple(level for level in levels if level.kind in ("target", "tolerance"))
    limits = tuple(level for level in levels if level.kind == "limit")
    for kept, color in ((grey, palette.IDEAL), (limits, main.colors[0])):
        if kept:
            yield LevelLines(plot=plot, levels=kept, name=names[color], color=color)


def _join_tint(color: palette.Color, main: Series) -> palette.Color:
    return main.colors[0] if color == palette.tint(main.colors[0]) else color


def _describe(curves: Series, label: str) -> str:
    """Return the name of a curve; for points, the name describes their look."""
    if curves.marker is None:
        return label
    return f"{SIGNS['disc' if curves.marker == 'circle' else 'cross']} {label}"
