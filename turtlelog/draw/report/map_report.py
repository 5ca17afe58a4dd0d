"""A sweep as one HTML file: maps, curves, sensitivities, best rows, and provenance."""

import platform
from base64 import b64encode
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from turtlelog.compare import Column, Table
from turtlelog.display import describe_count, show_angle
from turtlelog.draw.figures.sweep_figures import MapKind, draw_sweep_svg
from turtlelog.draw.output_files import replace_file, write_policy_tag
from turtlelog.draw.report.report_file import hash_file
from turtlelog.draw.report.sections import show, wrap_provenance, write_page, write_table
from turtlelog.sweep.gain_borders import LoopLimits, find_borders, tell_borders
from turtlelog.sweep.table.swept_results import SweptMetric
from turtlelog.sweep.table.swept_views import SweptView, find_best_rows, list_shown_values
from turtlelog.version import __version__


def write_map_report(
    view: SweptView, limits: Sequence[LoopLimits], path: str | Path, *, command: str = ""
) -> None:
    """Write the metrics of a sweep over the axes of a view as one HTML file.

    Args:
        view: View from `choose_view`.
        limits: Limits from theory, as from `find_loop_limits`.
        path: The .html file. An existing file is replaced when the new one is complete.
        command: Command that creates the report.

    Raises:
        ShowError: If the file cannot be written.
    """
    body = "".join(
        (
            _write_conclusion(view, limits),
            *(_write_figure(view, limits, kind, title) for kind, title in _list_figures(view)),
            write_table(_tabulate(view)),
            _write_provenance(view, command),
        )
    )
    text = write_page(
        Path(view.results.path).name,
        "plot",
        f"<main>\n{body}</main>",
        policy=write_policy_tag(),
        style="\nfigure{margin:0;background:#fff;padding:8px}\n"
        "figure img{width:100%;max-width:1100px}",
    )
    with replace_file(path) as part:
        part.write_text(text, encoding="utf-8", newline="\n")


def _list_figures(view: SweptView) -> Iterator[tuple[MapKind, str]]:
    if view.y is not None:
        yield "map", f"{view.x.name} and {view.y.name}"
    yield "curves", "Against one key"
    if sum(len(axis) > 1 for axis in view.results.axes) > 1:
        yield "tornado", "How far each key moves a metric"


def _write_figure(view: SweptView, limits: Sequence[LoopLimits], kind: MapKind, title: str) -> str:
    picture = b64encode(draw_sweep_svg(view, limits, kind)).decode()
    image = f'<img alt="{show(title)}" src="data:image/svg+xml;base64,{picture}">'
    return f"<section><h2>{show(title)}</h2><figure>{image}</figure></section>"


def _write_conclusion(view: SweptView, limits: Sequence[LoopLimits]) -> str:
    results, held = view.results, view.tell_held()
    first = f"{describe_count(results.row_count, 'row')}, {results.failed} failed"
    sentences = [f"{first}; shown at {held}." if held else f"{first}."]
    for metric in results.metrics:
        borders = find_borders(view, metric, limits)
        if borders is not None:
            sentences.append(f"{metric.name}: {tell_borders(borders)}.")
    notes = [*view.notes, *(note for one in limits for note in one.notes)]
    parts = "".join(f"<p>{show(text)}</p>" for text in sentences)
    parts += "".join(f'<p class="note">{show(text)}.</p>' for text in notes)
    return f'<section id="conclusion">{parts}</section>'


def _tabulate(view: SweptView) -> Table:
    return Table(
        title="Metrics of the rows that are shown",
        columns=(
            *(Column(title=title) for title in ("metric", "unit", "least", "greatest")),
            *(Column(title=title) for title in ("without a value", "best row", "its keys")),
        ),
        rows=tuple(_list_cells(view, metric) for metric in view.results.metrics),
        notes=("A row is run again by turtlelog run --from TABLE --row NUMBER.",),
    )


def _list_cells(view: SweptView, metric: SweptMetric) -> tuple[str | float | None, ...]:
    values, best = list_shown_values(view, metric)[1], find_best_rows(view, metric)
    known = values[np.isfinite(values)]
    unit = show_angle(0.0, metric.unit)[1]
    ends = (show_angle(float(find(known)), metric.unit)[0] for find in (np.min, np.max))
    least, most = ends if len(known) else (None, None)
    row = best[0] if best else None
    keys = "" if row is None else view.results.tell_row(row)
    number = "" if row is None else str(view.results.row_numbers[row])
    missing = str(len(values) - len(known))
    return metric.name, unit, least, most, missing, number, keys


def _write_provenance(view: SweptView, command: str) -> str:
    file = str(view.results.path)
    versions = f"turtlelog {__version__}, Python {platform.python_version()}"
    digest = f"<p>{show(file)}: sha256 <code>{hash_file(file)}</code></p>"
    return wrap_provenance(versions, command, digest)
