"""`turtlelog plot`: figures and tables for print."""

from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

import turtlelog as tl
from turtlelog import show
from turtlelog.cli.list_names import complete_figures
from turtlelog.cli.options import Json, TopicOptions, read_runs
from turtlelog.cli.output import print_json, print_lines, print_note
from turtlelog.cli.progress import show_progress
from turtlelog.errors import UsageError


def plot(  # noqa: PLR0913 (each is an option of the command)
    files: Annotated[list[Path] | None, Parameter(name="FILE")] = None,
    /,
    *,
    output: Annotated[Path, Parameter(name=("--output", "-o"))],
    only: Annotated[str | None, Parameter(metavar="NAMES", completer=complete_figures)] = None,
    formats: Annotated[str, Parameter(name="--format")] = "pdf,png,svg",
    columns: Literal[1, 2] = 1,
    text_width: Annotated[float, Parameter(metavar="WIDTH")] = 181.0,
    topics: TopicOptions | None = None,
    json: Json = False,
) -> None:
    """Make the paper's figures from any recordings, as PDF, PNG and SVG, and tables as LaTeX.

    Only what the recordings hold is drawn; what is left out, and why, is said on stderr. Without
    recordings: the figures of the ideal loop. Figures and tables that are there already are
    replaced.

    Example: turtlelog plot kp1.mcap kp4.mcap -o figures --only heading,plane

    Args:
        files: Recordings (.mcap), ROS 2 bags, or the paper's logs (.json, .csv); one is drawn in
            detail, several over each other.
        output: Write into this folder.
        only: Figures by name, with commas: plant, step-responses, root-locus, heading, position,
            heading-error, position-error, turn-rate, speed, wanted-speed, world-velocity,
            error-log, plane, panel. Otherwise all that the recordings hold the data for.
        formats: Some of pdf, png, svg, with commas.
        columns: How many of two columns a figure spans; side-by-side panels always span both.
        text_width: Width of the page's text [mm], 120 to 1000.
        json: Print one JSON object instead of lines.
    """
    from turtlelog.show.figures.writing import add_figures, add_tables
    from turtlelog.show.output_files import replace_together

    if output.exists() and not output.is_dir():
        raise UsageError(f"{output}: expected a folder to write to, found a file")
    page = tl.Page(text_width_mm=text_width, columns=columns)
    runs = read_runs(files, topics) if files else []
    names = None if only is None else _split(only, "--only")
    kinds = _split(formats, "--format")
    most = len(kinds) * len(tl.FIGURES if names is None else names)
    with show_progress("drawing", most, "files at most") as progress:

        def count(_: Path) -> None:
            progress.done += 1

        with replace_together(output) as write:
            figures = add_figures(
                write, runs, only=names, formats=kinds, page=page, on_written=count
            )
            tables = add_tables(write, runs) if runs and only is None else []
    left_out = show.list_left_out(runs, names) if runs else ()
    for line in left_out:
        print_note(f"plot: {line}")
    if json:
        print_json({**_describe(files or [], figures, tables), "left_out": list(left_out)})
    else:
        print_lines(f"wrote {path}" for path in [*figures, *tables])


def _split(text: str, option: str) -> list[str]:
    names = [name.strip() for name in text.split(",")]
    if not all(names):
        raise UsageError(f"{option}: expected names with commas between, found {text!r}")
    return names


def _describe(files: list[Path], figures: list[Path], tables: list[Path]) -> dict[str, Any]:
    return {
        "files": [str(path) for path in files],
        "figures": [
            {
                "file": str(path),
                "figure": path.stem,
                "title": tl.FIGURES[path.stem].title,
                "paper": tl.FIGURES[path.stem].paper or None,
            }
            for path in figures
        ],
        "tables": [str(path) for path in tables],
    }
