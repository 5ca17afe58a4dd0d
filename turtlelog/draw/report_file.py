"""Reports as one HTML file: of runs with plots and tables, and of a sweep with its maps."""

import json
import platform
from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from hashlib import file_digest
from importlib.resources import files
from pathlib import Path
from typing import Final

import numpy as np

from turtlelog import compare
from turtlelog.charts.many_runs import choose_colors_by_value
from turtlelog.charts.palette import GHOST, choose_cause_colors
from turtlelog.charts.plane_scene import move_near, require_near
from turtlelog.charts.plotted_curves import CurveKind
from turtlelog.display import describe_count, show_angle
from turtlelog.draw import report_sections as sections
from turtlelog.draw.figures.sweep_figures import MapKind, draw_sweep_svg
from turtlelog.draw.report_drawing import Drawn, Plots
from turtlelog.draw.report_plots import draw_plots
from turtlelog.draw.written_tables import choose_essentials
from turtlelog.errors import ShowError
from turtlelog.escapes import write_policy_tag
from turtlelog.explain import Attribution
from turtlelog.files.urls import make_path
from turtlelog.libraries import __version__, load_library
from turtlelog.log import replace_when_complete
from turtlelog.measure import Metric, measure_run
from turtlelog.run import Run
from turtlelog.sweep.sweep_analysis import LoopLimits, find_borders, tell_borders
from turtlelog.sweep.sweep_table import SweptMetric
from turtlelog.sweep.sweep_views import SweptView, count_rivals, find_best_rows, list_shown_values

_MOST_COLUMNS: Final = 4
"""Largest number of runs with a column of metrics each; more columns would be wider than a page."""

_MOST_TITLED: Final = 4
_MARKS_NOTE: Final = (
    '<p class="note">Shaded where a run has them: pauses over the whole height, dead times in'
    " pink, settling bands along the reference.</p>"
)
_KINDS: Final[Mapping[CurveKind, str]] = {
    "ideal": "dotted grey: the ideal loop",
    "aim": "dashed grey: what is asked for",
    "applied": "green: what the plant applied",
    "measured": "green: what the robot measured",
    "beside": "lighter: the distance to the reference",
}
"""Descriptions of the kinds of curves other than the run's own."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Explanation:
    """The causes of a metric of one of the runs."""

    run: Run  # explained run, one of those in the report
    attribution: Attribution | None = None  # None if there is none, for the reason in `note`
    what_ifs: Mapping[str, Run] = field(default_factory=dict)  # as from `simulate_what_ifs`
    note: str = ""  # reason why there is no attribution; empty if there is one


def write_report(
    runs: Sequence[Run],
    path: str | Path,
    *,
    sources: Sequence[str | Path] = (),
    explanation: Explanation | None = None,
    checks: Sequence[sections.CheckLine] = (),
    command: str = "",
) -> None:
    """Write a report on runs as one HTML file, in the order of their gains.

    Args:
        runs: Runs, at least one.
        path: The .html file. An existing file is replaced when the new one is complete.
        sources: File of each run, whose sha256 is shown; empty if unknown.
        explanation: Causes of a metric of one run; its what-ifs are drawn as ghosts.
        checks: Results of a specification.
        command: Command that creates the report.

    Raises:
        ShowError: If there is no run, or the file cannot be written.
        LibraryError: If Bokeh is not installed.
    """
    if not runs:
        raise ShowError(f"{path}: a report needs at least one run")
    require_near(runs)
    load_library("bokeh")
    # The text of a URL lacks its signature; only the original object can be opened.
    texts = (source if isinstance(source, str) else str(source) for source in sources)
    known = [*texts] or [""] * len(runs)
    file_of = {id(run): file for run, file in zip(runs, known, strict=True)}
    runs = compare.order_by_gain(runs)
    metrics, names = [measure_run(run) for run in runs], compare.name_runs(runs)
    near, origin = move_near(runs)
    drawn = [
        Drawn(run=run, name=name, color=color)
        for run, name, color in zip(near, names, choose_colors_by_value(runs), strict=True)
    ]
    drawn += _list_ghosts(explanation)
    failed = [line for line in checks if line.verdict == "FAIL"]
    plots = draw_plots(drawn, metrics, failed)
    sentences = sections.conclude_runs(runs, names, metrics)
    sentences.append(
        sections.conclude_checks([(line.run, line.check, line.verdict) for line in checks])
    )
    cause = ""
    if explanation is not None:
        name = names[next(n for n, run in enumerate(runs) if run is explanation.run)]
        if explanation.attribution is not None:
            sentences.append(sections.conclude_cause(name, explanation.attribution))
            cause = sections.write_attribution(name, explanation.attribution)
        else:
            text = sections.show(f"{name} is not explained: {explanation.note}")
            cause = f'<section id="cause"><p class="note">{text}</p></section>'
    told = "".join(f"<p>{sections.show(text)}</p>" for text in filter(None, sentences))
    body = f'<section id="conclusion">{told}</section>' if told else ""
    body += sections.write_notes(runs, names) + _write_stage(plots, len(runs), origin) + cause
    body += sections.write_checks(checks) if checks else ""
    body += _write_tables(runs, names, metrics)
    keyed = [(file_of[id(run)], hash_file(file_of[id(run)])) for run in runs]
    versions = [
        f"turtlelog {__version__}", f"Bokeh {load_library('bokeh').__version__}",
        f"Python {platform.python_version()}",
    ]  # fmt: skip
    body += sections.write_provenance(runs, names, keyed, versions, command)
    if plots.thinned:
        body += (
            f'<p class="note">{describe_count(plots.thinned, "curve")} drawn with about'
            f" {plots.points} points; the least and greatest values of every part stay.</p>"
        )
    title = ", ".join(names) if len(names) <= _MOST_TITLED else f"{len(names)} runs"
    text = _assemble(title, body, plots)
    with replace_when_complete(path, raising=ShowError) as part:
        part.write_text(text, encoding="utf-8", newline="\n")


def _list_ghosts(explanation: Explanation | None) -> list[Drawn]:
    """Return the what-ifs as ghosts. Plots over time show the ghost with all causes removed."""
    if explanation is None or explanation.attribution is None:
        return []
    colors = choose_cause_colors(explanation.attribution.causes)
    last = [*explanation.what_ifs][-1:]
    return [
        Drawn(
            run=run,
            name=f"without {name}",
            color=GHOST if [name] == last else colors.get(name, GHOST),
            is_ghost=True,
            is_plotted=[name] == last,
        )
        for name, run in explanation.what_ifs.items()
    ]


def _write_stage(plots: Plots, count: int, origin: str) -> str:
    """Return the HTML of the plots' places and of the controls, which the script uses."""
    toggles = "".join(
        f'<label><input type="checkbox" checked data-run="{number}">'
        f'<span class="{"swatch ghost" if run["ghost"] else "swatch"}"'
        f' style="--ink:{run["color"]}"></span><span>{sections.show(run["name"])}</span></label>'
        for number, run in enumerate(plots.config["runs"])
    )
    places = {
        place: f'<div class="plot" id="{place}" role="figure"'
        f' aria-label="{sections.show(plots.alternatives[place])}"></div>'
        for place in plots.roots
    }
    planes = "".join(places.pop(place) for place in ("plane", "goal") if place in places)
    series = "".join(place for name, place in places.items() if name.startswith("plot-"))
    marks = '<label><input type="checkbox" checked id="marks">marks</label>'
    kinds = plots.kinds if count == 1 else {*plots.kinds} - {"applied", "measured"}
    told = [word for kind, word in _KINDS.items() if kind in kinds]
    words = "; ".join([*told, *([f"coordinates are counted: {origin}"] if origin else [])])
    note = f'<p class="note">{words[0].upper()}{words[1:]}.</p>' if words else ""
    note += _MARKS_NOTE if plots.config["marks"] else ""
    return f"""<section id="stage"><h2>{"The run" if count == 1 else "The runs"}</h2>
<div class="controls">
<button type="button" id="play" aria-pressed="false">Play</button>
<label class="time"><span>time</span><input type="range" id="time" min="0" max="1000" value="1000"
 step="1"></label><output id="now" for="time"></output>
<button type="button" id="closer">Zoom in</button><button type="button" id="wider">Zoom out</button>
<button type="button" id="whole">Whole run</button>{marks if plots.config["marks"] else ""}
</div>
<fieldset id="runs"><legend>Shown</legend>{toggles}
<button type="button" id="all">All</button><button type="button" id="none">None</button></fieldset>
<div class="planes">{planes}</div>
<div class="wide" tabindex="0" role="region" aria-label="Values at the time of the slider">
<table id="values"></table></div>
{note}<div class="series">{series}</div></section>"""


def _write_tables(
    runs: Sequence[Run], names: Sequence[str], metrics: Sequence[Mapping[str, Metric]]
) -> str:
    pairs = zip(runs, metrics, strict=True)
    summaries = [compare.summarise_run(run, metrics=measured) for run, measured in pairs]
    body = sections.write_table(compare.tabulate_runs(summaries))
    if len(runs) <= _MOST_COLUMNS:
        essentials = choose_essentials(runs, metrics)
        declarations = [run.declaration for run in runs]
        table = compare.tabulate_measured(names, essentials, declarations=declarations)
        body += f"<details><summary>Metrics</summary>{sections.write_table(table)}</details>"
    return f'<section id="tables"><h2>Side by side</h2>{body}</section>'


def hash_file(file: str) -> str:
    """Return the sha256 of a file, or of the files in a bag's folder; empty if unknown."""
    path = make_path(file)
    if file and path.is_dir():
        inner = sorted(one for one in path.iterdir() if one.is_file())
        return ", ".join(f"{one.name} {hash_file(str(one))}" for one in inner)
    if not file or not path.is_file():
        return ""
    with path.open("rb") as stream:
        return file_digest(stream, "sha256").hexdigest()


def _assemble(title: str, body: str, plots: Plots) -> str:
    document = load_library("bokeh.document").Document(title="")
    for figure in plots.roots.values():
        document.add_root(figure)
    drawing = load_library("bokeh.core.json_encoder").serialize_json(
        document.to_json(deferred=False)
    )
    resources = load_library("bokeh.resources").Resources(mode="inline", components=["bokeh"])
    config = plots.config | {"places": {place: one.id for place, one in plots.roots.items()}}
    code = files("turtlelog.draw").joinpath("report.js").read_text("utf-8")
    # An end tag in a text would end the script.
    library = "\n".join(resources.js_raw).replace("</script", "<\\/script")
    drawn, roles = (
        text.replace("<", "\\u003c") for text in (drawing, json.dumps(config, allow_nan=False))
    )
    scripts = f"""<script>{library}</script>
<script type="application/json" id="drawing">{drawn}</script>
<script type="application/json" id="config">{roles}</script>
<script>{code}</script>"""
    policy = write_policy_tag(library, code)
    return sections.write_page(title, "report", f"<main>\n{body}</main>\n{scripts}", policy=policy)


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
    kinds: list[tuple[MapKind, str]] = [("curves", "Against one key")]
    if view.y is not None:
        kinds.insert(0, ("map", f"{view.x.name} and {view.y.name}"))
    if sum(len(axis) > 1 for axis in view.results.axes) > 1:
        kinds.append(("tornado", "How far each key moves a metric"))
    body = _conclude_sweep(view, limits)
    for kind, title in kinds:
        picture = b64encode(draw_sweep_svg(view, limits, kind)).decode()
        image = f'<img alt="{sections.show(title)}" src="data:image/svg+xml;base64,{picture}">'
        body += f"<section><h2>{sections.show(title)}</h2><figure>{image}</figure></section>"
    file = str(view.results.path)
    versions = f"turtlelog {__version__}, Python {platform.python_version()}"
    digest = f"<p>{sections.show(file)}: sha256 <code>{hash_file(file)}</code></p>"
    body += sections.write_table(_tabulate_sweep(view))
    body += sections.wrap_provenance(versions, command, digest)
    text = sections.write_page(
        Path(view.results.path).name,
        "plot",
        f"<main>\n{body}</main>",
        policy=write_policy_tag(),
        style="\nfigure{margin:0;background:#fff;padding:8px}\n"
        "figure img{width:100%;max-width:1100px}",
    )
    with replace_when_complete(path, raising=ShowError) as part:
        part.write_text(text, encoding="utf-8", newline="\n")


def _conclude_sweep(view: SweptView, limits: Sequence[LoopLimits]) -> str:
    results, held = view.results, view.tell_held()
    first = f"{describe_count(results.row_count, 'row')}, {results.failed} failed"
    sentences = [f"{first}; shown at {held}." if held else f"{first}."]
    for metric in results.metrics:
        borders = find_borders(view, metric, limits)
        if borders is not None:
            sentences.append(f"{metric.name}: {tell_borders(borders)}.")
    notes = [*view.notes, *(note for one in limits for note in one.notes)]
    parts = "".join(f"<p>{sections.show(text)}</p>" for text in sentences)
    parts += "".join(f'<p class="note">{sections.show(text)}.</p>' for text in notes)
    return f'<section id="conclusion">{parts}</section>'


def _tabulate_sweep(view: SweptView) -> compare.Table:
    titles = ("metric", "unit", "least", "greatest", "without a value", "best row", "its keys")
    return compare.Table(
        title="Metrics of the rows that are shown",
        columns=tuple(compare.Column(title=title) for title in titles),
        rows=tuple(_list_cells(view, metric) for metric in view.results.metrics),
        notes=("A row is run again by turtlelog run --from TABLE --row NUMBER.",),
    )


def _list_cells(view: SweptView, metric: SweptMetric) -> tuple[str | float | None, ...]:
    values, best = list_shown_values(view, metric)[1], find_best_rows(view, metric)
    known = values[np.isfinite(values)]
    unit = show_angle(0.0, metric.unit)[1]
    ends = (show_angle(float(find(known)), metric.unit)[0] for find in (np.min, np.max))
    least, most = ends if len(known) else (None, None)
    rivals = count_rivals(view, metric)
    is_open = rivals is not None and rivals.is_open
    row = best[0] if best and not is_open else None
    if rivals is not None and not is_open and row is not None:  # a mean over seeds is no row
        axes = (*view.axes, *view.held)
        keys = f"mean with {', '.join(axis.tell_keys(axis.places[row]) for axis in axes)}"
        number = f"{view.results.row_numbers[row]} on"
    else:
        keys = "no clear best" if is_open else "" if row is None else view.results.tell_row(row)
        number = "" if row is None else str(view.results.row_numbers[row])
    missing = str(len(values) - len(known))
    return metric.name, unit, least, most, missing, number, keys
