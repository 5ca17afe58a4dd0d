"""Plots over time of a report as models of Bokeh, their marks, and their ids for the script."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np

from turtlelog.charts import curve_marks, palette, plotted_curves
from turtlelog.charts.close_up import find_close_up
from turtlelog.charts.curve_marks import Characteristic
from turtlelog.charts.curves import Values
from turtlelog.charts.many_runs import describe_restless, find_restless
from turtlelog.charts.palette import to_hex
from turtlelog.charts.plane_scene import list_seen_gaps
from turtlelog.charts.time_plots import TIME_PLOTS, find_plot
from turtlelog.draw import report_drawing as drawing
from turtlelog.draw.report_drawing import RING, Drawn, Plots
from turtlelog.draw.report_sections import CheckLine
from turtlelog.libraries import load_library
from turtlelog.measure import Metric
from turtlelog.run import Run

_MOST_OF_ALL: Final = 24_000  # points of a signal, 11 bytes each; 12 runs have all of their points

_LEAST_POINTS: Final = 200
_ROOM: Final = 0.012
"""Margin before and after the time axis, as a share, so that dots at its ends are complete."""

_MOST_STATES: Final = 6  # plots of law states
_MOST_TIPS: Final = 6  # curves with tips together; of more, which would hide the plot, only one has

_GHOST: Final[frozenset[plotted_curves.CurveKind]] = frozenset({"run"})
"""Kinds of curves that are drawn for a ghost: only its own."""

_DIMMED: Final = 0.3  # opacity of a run that never settles, below runs that settle

_WIDTH: Final = 1.8
_THIN: Final = 1.2  # width of all curves except the run's own curve [pixels]

_STROKES: Final[Mapping[palette.Dash, str]] = {
    "solid": "solid",
    "dashed": "dashed",
    "dotted": "dotted",
    "dash-dot": "dotdash",
}
"""Dashes of Bokeh."""

_RARE: Final = 1e-3
"""Largest share of rows that may be left out of view at either end; faults of a sensor are rare."""

_FAR_OFF: Final = 20.0
"""Ratio of heights of outliers and other rows, from which outliers are left out of view."""


def draw_plots(
    drawn: Sequence[Drawn],
    metrics: Sequence[Mapping[str, Metric]],
    failed: Sequence[CheckLine],
) -> Plots:
    """Return the plane, the close-up of the goal, if any, and the plots over time.

    `drawn` are the runs, whose metrics these are, and then the ghosts. `failed` are failed checks.
    """
    plots = Plots(points=max(_LEAST_POINTS, min(drawing.MOST_POINTS, _MOST_OF_ALL // len(drawn))))
    inks = [{"name": one.name, "color": to_hex(one.color), "ghost": one.is_ghost} for one in drawn]
    kinds = ("plots", "planes", "marks", "cursors", "figures", "words")
    plots.config = {"runs": inks, **{kind: [] for kind in kinds}}
    runs = [one.run for one in drawn]
    drawing.draw_planes(plots, drawn, find_close_up(runs))
    restless = find_restless([one.run for one in drawn if not one.is_ghost])
    lasting = [one.run for number, one in enumerate(drawn) if number not in restless]
    end_s = max(float(run.duration_s) for run in lasting) or 1.0
    plots.config["end_s"] = end_s
    x_range = load_library("bokeh.models").Range1d(
        -_ROOM * end_s, (1.0 + _ROOM) * end_s, bounds=None
    )
    plots.config["x_range"] = x_range.id
    plots.config["room_s"] = _ROOM * end_s
    pairs = zip(runs, metrics, strict=False)
    marks = [curve_marks.list_characteristics(run, known) for run, known in pairs]
    for name in _choose_plots(runs):
        _draw_plot(plots, drawn, name, x_range, (marks, failed), restless)
    colors = {one.name: one.color for one in drawn if not one.is_ghost}
    found = [(one.signal, colors.get(one.run)) for one in failed if one.signal is not None]
    drawing.draw_violations(plots, found, x_range)
    return plots


def _choose_plots(runs: Sequence[Run]) -> list[str]:
    """Return the plots over time of a report, including states that are not always 0."""
    names = [
        name
        for name, plot in TIME_PLOTS.items()
        if _is_due(runs, plot) and any(plotted_curves.has_own(run, plot) for run in runs)
    ]
    groups = plotted_curves.group_states(*(run.declaration for run in runs))
    states = [
        name
        for group in groups
        for name in group.names
        if any(
            curve.values.any()
            for run in runs
            for curve in plotted_curves.list_own(run, find_plot(name, runs))
        )
    ]
    return names + states[:_MOST_STATES]


def _is_due(runs: Sequence[Run], plot: plotted_curves.TimePlot) -> bool:
    """Return whether a report has a plot: always, or because the reference of the plot moves."""
    if plot.report != "moving":
        return plot.report == "always"
    aims = [entry for entry in plot.curves if entry.kind == "aim"]
    return any(True for run in runs for entry in aims for _ in entry.read(run))


def _draw_plot(
    plots: Plots,
    drawn: Sequence[Drawn],
    name: str,
    x_range: Any,
    marked: tuple[Sequence[Sequence[Characteristic]], Sequence[CheckLine]],
    restless: frozenset[int],
) -> None:
    """Draw a plot; `restless` are the indices of runs that never settle if others do."""
    models = load_library("bokeh.models")
    plot = find_plot(name, [one.run for one in drawn])
    label = plot.label if name in TIME_PLOTS else f"state {plot.label}"
    without = describe_restless([one.run for one in drawn if not one.is_ghost], restless)
    if without and plotted_curves.leaves_out(len(drawn), plot):
        label += f", without {without}"
    figure = drawing.make_figure(
        plots, f"plot-{name}", label, x_range=x_range, height=230,
        x_axis_label=plotted_curves.label_time([one.run for one in drawn]),
    )  # fmt: skip
    config: dict[str, Any] = {"title": label, "curves": []}
    plots.config["plots"].append(config)
    runs = [one.run for one in drawn]
    for level in plotted_curves.list_plot_levels(runs, plot):
        if level.kind == "target":
            span = models.Span(
                location=level.value, dimension="width", line_color=RING, line_dash="dashed"
            )
            figure.add_layout(span)
    listed = _list_plotted(drawn, plot, restless)
    source = models.ColumnDataSource(data=_list_curves(plots, drawn, listed, config, restless))
    config["source"] = source.id
    done = [
        (drawn[number].name, found.curve.values) for number, found in listed if found.kind == "run"
    ]
    plots.alternatives[f"plot-{name}"] = drawing.describe_plot(label, done)
    plots.kinds |= {found.kind for _, found in listed}
    lines = figure.multi_line(
        "xs", "ys", source=source, color="color", line_width="width", line_dash="dash",
        line_alpha="alpha",
    )  # fmt: skip
    _set_height(figure, drawn, plot, source.data["ys"], restless)
    _shade_gaps(figure, drawn)
    signals = {entry.signal for entry in plot.curves if entry.signal}
    mark_plots(plots, figure, drawn, signals, marked[0])
    for found in marked[1]:
        checked = {signal.removeprefix("measured_") for signal in found.names}
        # A violation without a signal is marked in all plots.
        is_here = name in checked or checked.isdisjoint(TIME_PLOTS)
        if found.first_violation_s is not None and is_here:
            figure.add_layout(
                models.Span(
                    location=found.first_violation_s, dimension="height",
                    line_color=drawing.RED, line_dash="dotted", line_width=2,
                )
            )  # fmt: skip
    drawing.add_cursor(plots, figure)
    value = f"$snap_y{{0.0000}} {plot.unit}"
    tips = [("", "@name"), ("time", "$snap_x{0.000} s"), (plot.title, value)]
    mode = "vline" if len(config["curves"]) <= _MOST_TIPS else "mouse"
    figure.add_tools(
        models.HoverTool(renderers=[lines], tooltips=tips, line_policy="nearest", mode=mode),
        models.CrosshairTool(overlay=plots.crosshair),
    )


def _list_plotted(
    drawn: Sequence[Drawn], plot: plotted_curves.TimePlot, restless: frozenset[int]
) -> list[tuple[int, plotted_curves.PlottedCurve]]:
    """Return the curves of a plot with the indices of their runs, in the order of drawing."""
    listed = [
        (number, found)
        for number, one in enumerate(drawn)
        if one.is_plotted
        and not (number in restless and plotted_curves.leaves_out(len(drawn), plot))
        for found in plotted_curves.list_plotted(
            one.run,
            plot,
            _GHOST if one.is_ghost else plotted_curves.choose_kinds(number, len(drawn)),
        )
        if found.kind not in plotted_curves.POINTS
    ]
    return sorted(listed, key=lambda pair: (pair[0] not in restless, pair[1].kind == "run"))


def _list_curves(
    plots: Plots,
    drawn: Sequence[Drawn],
    listed: Sequence[tuple[int, plotted_curves.PlottedCurve]],
    config: dict[str, Any],
    restless: frozenset[int],
) -> dict[str, list[Any]]:
    """Return curves as a table, a row per curve; the page's script turns held values into steps."""
    is_alone = len(drawn) == 1
    data: dict[str, list[Any]] = {
        key: [] for key in ("xs", "ys", "color", "name", "dash", "width", "alpha")
    }
    for number, found in listed:
        one, curve = drawn[number], found.curve
        is_main = found.kind in ("run", "measured")
        time_s, values = drawing.thin(plots, [curve.time_s, curve.values], curve.values)
        color = palette.choose_curve_color(found.kind, one.color, is_alone=is_alone)
        told = found.label if is_alone else f"{one.name}: {found.label}"
        row = {
            "xs": time_s,
            "ys": values,
            "color": to_hex(color),
            "name": one.name if is_main and not is_alone else told,
            "dash": _STROKES[
                palette.SUPPOSED_DASH if one.is_ghost else palette.choose_dash(found.kind)
            ],
            "width": _THIN if one.is_ghost or found.kind != "run" else _WIDTH,
            "alpha": _DIMMED if number in restless else 1.0,
        }
        for key, value in row.items():
            data[key].append(value)
        # A value is not held between thinned rows: steps would show values that never existed.
        holds = curve.holds and len(time_s) == len(curve.values)
        config["curves"].append({"run": number, "holds": holds, "aim": found.kind != "run"})
    return data


def _shade_gaps(figure: Any, drawn: Sequence[Drawn]) -> None:
    """Shade gaps without poses of a single run, with their duration as text."""
    models = load_library("bokeh.models")
    for start_s, end_s, words in list_seen_gaps(drawn[0].run) if len(drawn) == 1 else ():
        box = models.BoxAnnotation(
            left=start_s, right=end_s, fill_color=RING, fill_alpha=0.12, line_color=None,
            hatch_pattern="/", hatch_color=RING, hatch_alpha=0.3, level="underlay",
        )  # fmt: skip
        text = models.Label(
            x=(start_s + end_s) / 2.0, y=4, y_units="screen", text=words, text_color=RING,
            text_font_size="11px", text_align="center",
        )  # fmt: skip
        figure.add_layout(box)
        figure.add_layout(text)


def _set_height(
    figure: Any,
    drawn: Sequence[Drawn],
    plot: plotted_curves.TimePlot,
    curves: Sequence[Values],
    restless: frozenset[int],
) -> None:
    """Set the height of a plot from the runs that settle, or from all runs if all are in view."""
    if not restless:
        _keep_in_view(figure, curves)
        return
    calm = [one.run for number, one in enumerate(drawn) if number not in restless]
    own = [curve.values for run in calm for curve in plotted_curves.list_own(run, plot)]
    found = plotted_curves.find_plot_range(own, plotted_curves.list_plot_levels(calm, plot))
    if found is not None:
        figure.y_range = load_library("bokeh.models").Range1d(*found)


def _keep_in_view(figure: Any, curves: Sequence[Values]) -> None:
    """Leave a few extreme rows out of view, with a note in the title."""
    values = np.concatenate([*curves, np.empty(0)])
    values = values[np.isfinite(values)]
    if not len(values):
        return
    rest = np.quantile(values, [_RARE, 1.0 - _RARE])
    room = float(np.ptp(rest))
    if room == 0.0 or np.ptp(values) < _FAR_OFF * room:
        return
    figure.y_range = load_library("bokeh.models").Range1d(
        float(rest[0]) - 0.1 * room, float(rest[1]) + 0.1 * room
    )
    far = float(values[np.abs(values - rest.mean()).argmax()])
    figure.title.text += f", close up: single values go to {far:.4g}"


MOST_MARKED: Final = 4  # runs with marks; with more runs, marks would hide each other

_DEAD: Final = to_hex(palette.DEAD_TIME)

_WORDS: Final = "#767676"
"""Colour of text, with a contrast of 4.5 to white and 4.6 to black."""

_LINE_PX: Final = 17

_NEAR: Final = 0.2
"""Distance between dots, as a share of the width, below which their texts are one below another."""

_LATE: Final = 0.6
"""Share of the width from which text is left of its dot, because it would leave the plot."""

_SHAPES: Final[Mapping[curve_marks.MarkShape, str]] = {
    "disc": "circle",
    "square": "square",
    "cross": "x",
}
"""Mark shapes of Bokeh."""


def mark_plots(
    plots: Plots,
    figure: Any,
    drawn: Sequence[Drawn],
    signals: Collection[str],
    found: Sequence[Sequence[Characteristic]],
) -> None:
    """Mark the characteristics of a plot's signals, and pauses, for each of the first runs drawn.

    For a single run, names are next to the dots.
    """
    if len(found) > MOST_MARKED:
        return
    is_alone = len(found) == 1
    dots = []
    for number, marks in enumerate(found):
        run = drawn[number].run
        if all(curve_marks.read_marked_curve(run, signal) is None for signal in signals):
            continue
        color = to_hex(drawn[number].color)
        own = [mark for mark in marks if mark.signal in signals and mark.level is not None]
        shades = [*_shade_spans(figure, marks, own, RING if is_alone else color)]
        made = [*_draw_dots(figure, own, drawn[number].name, color)]
        dots += made
        words = _write_words(plots, figure, own) if is_alone else []
        ids = [one.id for one in (*shades, *made, *words)]
        plots.config["marks"] += [{"run": number, "renderer": key} for key in ids]
    if dots:
        hover = load_library("bokeh.models").HoverTool(renderers=dots, tooltips="@text")
        hover.visible = False
        figure.add_tools(hover)


def _shade_spans(
    figure: Any, marks: Sequence[Characteristic], own: Sequence[Characteristic], color: str
) -> Iterator[Any]:
    """Shade pauses; of its own marks, settling bands from the loop's start on, and dead times."""
    shaded = [mark for mark in own if mark.kind in {"settling_time", "dead_time"}]
    for mark in (*(mark for mark in marks if mark.kind == "pause"), *shaded):
        if mark.span_s is None or (mark.kind == "settling_time" and mark.levels is None):
            continue
        edges = dict(zip(("left", "right"), mark.span_s, strict=True))
        ink, alpha = (_DEAD, 0.3) if mark.kind == "dead_time" else (color, 0.14)
        if mark.kind == "settling_time" and mark.levels is not None:
            edges |= {"left": mark.start_s, "bottom": mark.levels[0], "top": mark.levels[1]}
            alpha = 0.18
        box = load_library("bokeh.models").BoxAnnotation(
            fill_color=ink, fill_alpha=alpha, line_color=None, level="underlay", **edges
        )
        figure.add_layout(box)
        yield box


def _draw_dots(
    figure: Any, marks: Sequence[Characteristic], name: str, color: str
) -> Iterator[Any]:
    """Draw a dot at the place of each metric on the curve, for metrics that have a dot."""
    for mark in marks:
        text = ", ".join(curve_marks.list_mark_texts(mark, marks))
        if mark.shape is None or not text:
            continue
        source = load_library("bokeh.models").ColumnDataSource(
            data={"x": [mark.marked_s], "y": [mark.level], "text": [f"{name}: {text}"]}
        )
        yield figure.scatter(
            "x", "y", source=source, marker=_SHAPES[mark.shape], size=9, line_color=color,
            line_width=1.8, fill_color=color, fill_alpha=0.25,
        )  # fmt: skip


def _write_words(plots: Plots, figure: Any, marks: Sequence[Characteristic]) -> Iterator[Any]:
    """Write the name of each dot next to it. The names of close dots form a column."""
    end_s = float(plots.config["end_s"])
    known = sorted((mark for mark in marks if mark.shape), key=lambda mark: mark.marked_s)
    told = [(mark, ", ".join(curve_marks.list_mark_texts(mark, marks))) for mark in known]
    words = [(mark, text) for mark, text in told if text]
    levels = [float(mark.level or 0.0) for mark, _ in words]
    curves = [ys for one in figure.renderers for ys in one.data_source.data.get("ys", [])]
    ends = [float(end) for ys in curves for end in (np.nanmin(ys), np.nanmax(ys))]
    middle = (min(ends) + max(ends)) / 2.0 if ends else np.inf
    cluster: list[int] = []
    was_low = False
    for number, (mark, text) in enumerate(words):
        is_low = levels[number] <= middle
        if cluster and (
            mark.marked_s - words[cluster[0]][0].marked_s > _NEAR * end_s or is_low != was_low
        ):
            cluster = []
        cluster.append(number)
        was_low, first = is_low, words[cluster[0]][0]
        is_late = first.marked_s > _LATE * end_s
        step = _LINE_PX * (len(cluster) - 1)
        word = figure.text(
            [(first if is_late else words[cluster[-1]][0]).marked_s], [levels[cluster[0]]],
            text=[f"{mark.sign} {text}"], text_color=_DEAD if mark.kind == "dead_time" else _WORDS,
            text_font_size="12px", text_align="right" if is_late else "left",
            x_offset=-10 if is_late else 12, y_offset=(-12 - step) if is_low else (12 + step),
            text_baseline="bottom" if is_low else "top",
        )  # fmt: skip
        plots.config["words"].append(word.glyph.id)
        yield word
