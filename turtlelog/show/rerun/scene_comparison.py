"""Several runs over each other, as one Rerun recording."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import rerun as rr

from turtlelog.compare import name_runs
from turtlelog.errors import ShowError
from turtlelog.run import Run
from turtlelog.show.documents import describe_runs
from turtlelog.show.rerun import drawing
from turtlelog.show.rerun.content import describe_content
from turtlelog.show.rerun.entities import RUNS, join_path
from turtlelog.show.rerun.layout import build_comparison_layout
from turtlelog.show.rerun.legend import draw_legend
from turtlelog.show.rerun.palette import choose_run_colors
from turtlelog.show.rerun.properties import collect_comparison_properties
from turtlelog.show.rerun.recording import open_recording
from turtlelog.show.rerun.series import list_compared_series, list_references
from turtlelog.show.rerun.surroundings import draw_surroundings


def write_comparison_rrd(
    runs: Sequence[Run], path: str | Path, *, documents: Mapping[str, str] | None = None
) -> None:
    """Write one recording of several runs over each other; time zero is each one's first sample.

    Args:
        runs: At least one; each keeps its colour in every view.
        path: The .rrd file; replaced when the new one is complete.
        documents: Markdown texts by title, shown as tabs; `describe_runs` where None.

    Raises:
        ShowError: Where there is no run, or the file cannot be written.
    """
    if not runs:
        raise ShowError(f"{path}: expected at least one run to compare, found none")
    documents = describe_runs(runs) if documents is None else documents
    names = name_runs(runs)
    colors = choose_run_colors(len(runs))
    prefixes = [join_path(RUNS, rr.escape_entity_path_part(name)) for name in names]
    series = [
        list_compared_series(run, name, color)
        for run, name, color in zip(runs, names, colors, strict=True)
    ]
    references = list_references(runs)
    content = describe_content(runs, prefixes, series, references, documents, names=names)
    layout = build_comparison_layout(content)
    with open_recording(path, name=_name_recording(names), layout=layout) as stream:
        stream.send_property("runs", collect_comparison_properties(runs, names, prefixes))
        draw_surroundings(stream, runs)
        drawing.draw_references(stream, references, runs)
        if content.legend_names:
            draw_legend(stream, names, colors)
        for run, name, prefix, color, listed in zip(
            runs, names, prefixes, colors, series, strict=True
        ):
            drawing.draw_motion(stream, prefix, run, color, plane=content.plane, speaker=name)
            for curves in listed:
                drawing.draw_series(stream, prefix, curves, run.start_ns)
        drawing.draw_documents(stream, documents)


def _name_recording(names: Sequence[str]) -> str:
    return ", ".join(names) if len(names) <= 4 else f"{names[0]} to {names[-1]}, {len(names)} runs"
