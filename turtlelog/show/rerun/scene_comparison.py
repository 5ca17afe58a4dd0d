"""Several runs over each other, as one Rerun recording."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from turtlelog.compare import name_runs, order_by_gain
from turtlelog.errors import ShowError
from turtlelog.measure import measure_run
from turtlelog.run import Run
from turtlelog.show.documents import describe_runs
from turtlelog.show.rerun.comparison_scene import build_overlay, draw_overlay
from turtlelog.show.rerun.drawing import draw_documents
from turtlelog.show.rerun.layout import build_comparison_layout
from turtlelog.show.rerun.recording import open_recording
from turtlelog.show.rerun.run_stream import add_thinning


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
    metrics, overlay = [measure_run(run) for run in runs], build_overlay(runs, name_runs(runs))
    if documents is None:
        documents = describe_runs(runs, metrics=metrics)
    documents = add_thinning(documents, runs)
    content = overlay.describe(documents)
    layout = build_comparison_layout(content)
    with open_recording(path, name=_name_recording(overlay.names), layout=layout) as stream:
        draw_overlay(stream, overlay, content, metrics)
        draw_documents(stream, documents)


def _name_recording(names: Sequence[str]) -> str:
    return ", ".join(names) if len(names) <= 4 else f"{names[0]} to {names[-1]}, {len(names)} runs"
