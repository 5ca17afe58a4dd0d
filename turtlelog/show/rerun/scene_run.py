"""One run as a Rerun recording."""

from collections.abc import Mapping
from pathlib import Path

from turtlelog.run import Run
from turtlelog.show.documents import describe_run
from turtlelog.show.rerun import drawing, palette
from turtlelog.show.rerun.content import describe_content
from turtlelog.show.rerun.layout import build_run_layout
from turtlelog.show.rerun.properties import collect_run_properties
from turtlelog.show.rerun.recording import open_recording
from turtlelog.show.rerun.series import list_references, list_series
from turtlelog.show.rerun.surroundings import draw_surroundings


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
    documents = describe_run(run) if documents is None else documents
    series, references = list_series(run), list_references([run])
    content = describe_content([run], [""], [series], references, documents)
    with open_recording(path, name=run.name, layout=build_run_layout(content)) as stream:
        stream.send_property("run", collect_run_properties(run))
        draw_surroundings(stream, [run])
        drawing.draw_motion(stream, "", run, palette.MAIN, plane=content.plane)
        drawing.draw_references(stream, references, [run])
        for curves in series:
            drawing.draw_series(stream, "", curves, run.start_ns)
        drawing.draw_documents(stream, documents)
