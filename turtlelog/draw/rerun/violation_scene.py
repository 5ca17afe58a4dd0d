"""A run as a Rerun recording that opens at the violation of a check, with the signal on top."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from textwrap import shorten
from typing import Any, Final

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.components import AbsoluteTimeRange

from turtlelog.charts import palette
from turtlelog.charts.curve_marks import ViolatedSignal
from turtlelog.charts.curves import Curve, select_curve_rows
from turtlelog.charts.plotted_curves import TIMELINE
from turtlelog.display import cut_name
from turtlelog.draw.documents import document_run
from turtlelog.draw.rerun import entities
from turtlelog.draw.rerun.content import view_curves
from turtlelog.draw.rerun.entities import VIOLATION, join_path
from turtlelog.draw.rerun.layout import LEGEND_TITLE, build_run_layout, build_violation_layout
from turtlelog.draw.rerun.plots import Series, draw_series
from turtlelog.draw.rerun.rrd_file import draw_documents, open_recording
from turtlelog.draw.rerun.run_scene import build_single, draw_single
from turtlelog.draw.rerun.timelines import RunStream, add_thinning, build_run_timelines
from turtlelog.draw.rerun.world import draw_points, draw_strips
from turtlelog.escapes import escape_markdown, fence_markdown
from turtlelog.run import Event, Run

_RADIUS: Final = 6.0  # [points], as are the other sizes
_CURVE_WIDTH: Final = 2.0
_OUTSIDE_WIDTH: Final = 4.0
_LIMIT_WIDTH: Final = 1.5
_POINT_SIZE: Final = 6.0

_MARKERS: Final = {"first": "circle", "worst": "diamond", "high": "up", "low": "down"}
_SIGNS: Final[Mapping[str, str]] = {"high": "▲", "low": "▼"}
"""Symbols of limits in the legend, because a plot has no text next to its lines."""

_NAMES_OUTSIDE: Final[Mapping[str, str]] = {"worst": "outside", "nearest": "not within"}

_MARK_AT: Final = 0.03
"""Position of a limit's mark along the limit, as a share; at the start, the plot's edge would cut
the mark."""

_STRETCH_RADIUS: Final = 2.5
_ABOVE_TRACES: Final = 26.0  # lines have 20

_STROKES: Final = 700
"""Number of vertical strokes that fill the band: every other pixel of a window of 1400 pixels."""
_STROKE_WIDTH: Final = 3.0
_FILL_ALPHA: Final = 64
"""Opacity of strokes, of 255. Strokes overlap once or twice, and curves stay brighter than the
band."""

_LONGEST_TITLE: Final = 110
"""Longest title [letters of 6.5 pixels]: in a window 1200 pixels wide, the plot has 850 pixels for
the title."""

_LONGEST_NAME: Final = 28
"""Longest name in the plane [letters]: about half of its width."""


def write_violation_rrd(
    run: Run,
    path: str | Path,
    *,
    at_s: float,
    title: str,
    message: str,
    violated: ViolatedSignal | None = None,
) -> None:
    """Write a recording of one run that opens at a time and marks this time.

    The violated signal is at the top with its band, and is red outside the band. The first and the
    worst violation have labels with value and time. The cursor is at the first violation in every
    plot. The plane has a mark at the turtle's position, and the list of events has a line.

    Args:
        run: Run to show.
        path: The .rrd file. An existing file is replaced when the new one is complete.
        at_s: Time of the violation, from the first sample [s].
        title: A few words, shown next to the mark if there is no signal.
        message: Full message, as printed.
        violated: Violated signal; None if the violation belongs to no signal.

    Raises:
        ShowError: If the file cannot be written.
    """
    at_ns = run.start_ns + round(at_s * 1e9)
    event = Event(time_ns=at_ns, kind="violation", text=f"Violation: {title}")
    events = sorted((*run.events, event), key=lambda found: found.time_ns)
    run = replace(run, events=tuple(events))
    single = build_single(run)
    documents = {"Violation": fence_markdown(message), **document_run(run, metrics=single.metrics)}
    documents = {**add_thinning(documents, [run])}
    if violated is not None:
        documents[LEGEND_TITLE] = _write_legend(violated)
    content = single.describe(documents)
    if violated is None:
        layout = build_run_layout(content)
    else:
        layout = build_violation_layout(content, _view_signal(violated))
    layout.time_panel = _stop_at(at_ns - run.start_ns)
    with open_recording(path, name=f"{run.name}: {title}", layout=layout) as stream:
        draw_single(stream, single, content)
        draw_documents(stream, documents)
        _mark_place(stream, run, at_ns, _name_place(title, violated))
        if violated is not None:
            run_stream = RunStream(stream, "", build_run_timelines(run))
            _draw_signal(run_stream, violated)
            _draw_stretch(stream, run, violated)


def _view_signal(violated: ViolatedSignal) -> rrb.View:
    """Return the view of the signal, its band, and the part outside."""
    part = violated.find_range()
    shown = violated.describe_moment(violated.worst, violated.worst_word)
    outside = violated.describe_outside(violated.worst)
    shown = f"{shown}, {outside} outside" if outside else shown
    title = f"{violated.title}{', close up' if part.note else ''}: {shown}"
    title = f"{title}; violates {violated.expected or violated.check}"
    title = shorten(title, _LONGEST_TITLE, placeholder="...")
    contents = [f"{join_path(entities.VIOLATED)}/**"]
    return view_curves(title, contents, (part.low, part.high), rrb.PlotLegend(visible=False))


def _write_legend(violated: ViolatedSignal) -> str:
    """Return the legend as Markdown, with a line for each mark and each curve."""
    outside, word = violated.describe_outside(violated.worst), violated.worst_word
    worst = violated.describe_moment(violated.worst, word)
    limits = violated.describe_limits()
    lines = [
        f"◆ {worst}, {outside} outside" if outside else f"◆ {worst}",
        f"● {violated.describe_moment(violated.first, 'first violated')}",
        *(f"{sign} {limits[side]}" for side, sign in _SIGNS.items() if side in limits),
        "green: allowed",
        f"blue: {violated.name}",
        f"red: {_NAMES_OUTSIDE[word]}",
    ]
    return "  \n".join(map(escape_markdown, lines))


def _draw_signal(run_stream: RunStream, violated: ViolatedSignal) -> None:
    """Draw band, limits, curve, the part outside, and the moments, from bottom to top."""
    curve, limits = violated.curve, violated.describe_limits()
    _fill_band(run_stream, violated)
    _draw(run_stream, "curve", curve, violated.name, width=_CURVE_WIDTH)
    for side, label in limits.items():
        ends = violated.low if side == "low" else violated.high
        assert ends is not None
        limit = replace(curve, values=ends)
        look: dict[str, Any] = {"colors": (palette.ALLOWED,), "width": _LIMIT_WIDTH}
        _draw(run_stream, f"limit_{side}", limit, label, **look)
        known = np.flatnonzero(np.isfinite(ends))
        if len(known):
            row = known[int(_MARK_AT * len(known)) :][:1]
            look = {"colors": (palette.GOAL,), "width": _POINT_SIZE, "marker": _MARKERS[side]}
            _draw(run_stream, f"points/limit_{side}", select_curve_rows(limit, row), label, **look)
    beyond = replace(curve, values=np.where(violated.outside, curve.values, np.nan))
    look = {"colors": (palette.VIOLATION,), "width": _OUTSIDE_WIDTH}
    _draw(run_stream, "outside", beyond, _NAMES_OUTSIDE[violated.worst_word], **look)
    for part, word, moment in (
        ("first", "first violated", violated.first),
        ("worst", violated.worst_word, violated.worst),
    ):
        time_ns = np.array([curve.start_ns + round(moment.time_s * 1e9)])
        point = replace(curve, time_ns=time_ns, values=np.array([moment.value]))
        look |= {"width": _POINT_SIZE, "marker": _MARKERS[part]}
        _draw(run_stream, f"points/{part}", point, violated.describe_moment(moment, word), **look)


def _draw(run_stream: RunStream, part: str, curve: Curve, label: str, **looks: Any) -> None:
    """Draw a curve or a point of the violated signal."""
    series = Series(
        entity=f"{entities.VIOLATED}/{part}",
        labels=(label,),
        time_ns=curve.time_ns,
        values=curve.values[:, np.newaxis],
        holds=curve.holds,
        **looks,
    )
    draw_series(run_stream, series)


def _fill_band(run_stream: RunStream, violated: ViolatedSignal) -> None:
    """Fill the band with vertical strokes; an unbounded band is filled up to the plot's edge."""
    time_ns = violated.curve.time_ns
    times_ns = np.linspace(time_ns[0], time_ns[-1], _STROKES).round().astype(np.int64)
    rows = np.searchsorted(time_ns, times_ns, side="right") - 1
    rows = np.clip(rows, 0, len(time_ns) - 1)
    part = violated.find_range()
    low, high = (
        np.full(len(rows), edge) if end is None else end[rows]
        for end, edge in ((violated.low, part.low), (violated.high, part.high))
    )
    strokes = np.column_stack([low, high, np.full(len(rows), np.nan)]).reshape(-1)
    style = rr.SeriesLines(
        names=["allowed"],
        colors=[(*palette.ALLOWED, _FILL_ALPHA)],
        widths=[_STROKE_WIDTH],
        aggregation_policy="Off",
    )
    entity = f"{entities.VIOLATED}/band"
    run_stream.log(entity, style)
    run_stream.send_few(entity, np.repeat(times_ns, 3), rr.Scalars.columns(scalars=strokes))


def _draw_stretch(stream: rr.RecordingStream, run: Run, violated: ViolatedSignal) -> None:
    """Draw the robot's path in red while the signal was outside its band."""
    if violated.worst_word != "worst":
        return
    rows = np.searchsorted(violated.curve.time_ns, run.poses.time_ns, side="right") - 1
    is_outside = violated.outside[np.maximum(rows, 0)] & (rows >= 0)
    starts = np.flatnonzero(np.diff(is_outside.astype(np.int8), prepend=0) == 1)
    ends = np.flatnonzero(np.diff(is_outside.astype(np.int8), append=0) == -1)
    strips = [run.poses.xy_m[a : b + 1] for a, b in zip(starts, ends, strict=True) if b > a]
    if strips:
        entity, look = entities.VIOLATED_STRETCH, {"draw_order": _ABOVE_TRACES}
        draw_strips(stream, entity, strips, [palette.VIOLATION], _STRETCH_RADIUS, **look)


def _stop_at(at_ns: int) -> rrb.TimePanel:
    """Return a panel whose cursor is at a given time, by a loop of length zero.

    A layout cannot set the cursor's place, and a paused cursor is at the start.
    """
    return rrb.TimePanel(
        state="collapsed",
        timeline=TIMELINE,
        play_state="playing",
        loop_mode="selection",
        time_selection=AbsoluteTimeRange(min=at_ns, max=at_ns),
    )


def _name_place(title: str, violated: ViolatedSignal | None) -> str:
    """Return the text next to the mark. If there is a signal, its title names the check."""
    if violated is not None:
        return "first violated"
    return cut_name(title, _LONGEST_NAME)


def _mark_place(stream: rr.RecordingStream, run: Run, at_ns: int, title: str) -> None:
    row = max(int(run.poses.time_ns.searchsorted(at_ns, side="right")) - 1, 0)
    place_m = run.poses.xy_m[row : row + 1]
    draw_points(stream, VIOLATION, place_m, [palette.VIOLATION], _RADIUS, labels=[title])
