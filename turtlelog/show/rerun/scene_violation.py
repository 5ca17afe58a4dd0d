"""One run as a Rerun recording that opens where something was violated."""

from dataclasses import replace
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.components import AbsoluteTimeRange

from turtlelog.escapes import fence_markdown
from turtlelog.run import Event, Run
from turtlelog.show.documents import describe_run
from turtlelog.show.rerun.drawing import draw_documents
from turtlelog.show.rerun.entities import TIMELINE, VIOLATION, join_path
from turtlelog.show.rerun.layout import build_run_layout
from turtlelog.show.rerun.recording import open_recording
from turtlelog.show.rerun.run_scene import build_single, draw_single
from turtlelog.show.rerun.run_stream import add_thinning
from turtlelog.show.run_colors import Color

_RADIUS = 6.0
_COLOR: Color = (214, 39, 40)


def write_violation_rrd(
    run: Run, path: str | Path, *, at_s: float, title: str, message: str
) -> None:
    """Write a recording of one run that opens at a moment and marks it.

    The cursor stands there in every plot; the plane has a mark where the turtle was, the list of
    events a line, and the message is the first tab.

    Args:
        run: What to show.
        path: The .rrd file; replaced when the new one is complete.
        at_s: The moment, from the first sample [s].
        title: A few words, beside the mark.
        message: All there is to say, as it would be printed.

    Raises:
        ShowError: Where the file cannot be written.
    """
    at_ns = run.start_ns + round(at_s * 1e9)
    event = Event(time_ns=at_ns, kind="violation", text=f"Violation: {title}")
    events = sorted((*run.events, event), key=lambda found: found.time_ns)
    run = replace(run, events=tuple(events))
    single = build_single(run)
    documents = {"Violation": fence_markdown(message), **describe_run(run, metrics=single.metrics)}
    documents = {**add_thinning(documents, [run])}
    content = single.describe(documents)
    layout = build_run_layout(content)
    layout.time_panel = _stop_at(at_ns - run.start_ns)
    with open_recording(path, name=f"{run.name}: {title}", layout=layout) as stream:
        draw_single(stream, single, content)
        draw_documents(stream, documents)
        _draw_mark(stream, run, at_ns, title)


def _stop_at(at_ns: int) -> rrb.TimePanel:
    """Return a panel whose cursor stands at a time: it loops over a stretch of no length.

    A layout cannot name the cursor's place, and a paused one stands at the beginning.
    """
    return rrb.TimePanel(
        state="collapsed",
        timeline=TIMELINE,
        play_state="playing",
        loop_mode="selection",
        time_selection=AbsoluteTimeRange(min=at_ns, max=at_ns),
    )


def _draw_mark(stream: rr.RecordingStream, run: Run, at_ns: int, title: str) -> None:
    row = max(int(run.poses.time_ns.searchsorted(at_ns, side="right")) - 1, 0)
    mark = rr.Points2D(
        run.poses.xy_m[row : row + 1],
        radii=rr.Radius.ui_points(_RADIUS),
        colors=[_COLOR],
        labels=[title],
    )
    stream.log(join_path(VIOLATION), mark, static=True)
