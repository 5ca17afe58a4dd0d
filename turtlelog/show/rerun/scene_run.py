"""One run as a Rerun recording."""

from collections.abc import Mapping
from pathlib import Path

from turtlelog.run import Run
from turtlelog.show.documents import describe_run
from turtlelog.show.rerun.drawing import draw_documents
from turtlelog.show.rerun.layout import build_run_layout
from turtlelog.show.rerun.recording import open_recording
from turtlelog.show.rerun.run_scene import build_single, draw_single
from turtlelog.show.rerun.run_stream import add_thinning


def write_run_rrd(
    run: Run, path: str | Path, *, documents: Mapping[str, str] | None = None
) -> None:
    """Write a recording of one run with its layout; time zero is the first sample.

    Args:
        run: What to show.
        path: The .rrd file; replaced when the new one is complete.
        documents: Markdown texts by title, shown as tabs; `describe_run` where None.

    Raises:
        ShowError: Where the file cannot be written.
    """
    single = build_single(run)
    if documents is None:
        documents = describe_run(run, metrics=single.metrics)
    documents = add_thinning(documents, [run])
    content = single.describe(documents)
    with open_recording(path, name=run.name, layout=build_run_layout(content)) as stream:
        draw_single(stream, single, content)
        draw_documents(stream, documents)
