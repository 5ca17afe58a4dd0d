"""What stands beside the plane: curves, levels, phases, events, documents, names of many runs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from turtlelog.loops import DONE, PAUSE
from turtlelog.run import Run
from turtlelog.show import palette
from turtlelog.show.palette import Color
from turtlelog.show.rerun import entities
from turtlelog.show.rerun.entities import join_path
from turtlelog.show.rerun.plots import LevelLines, Series
from turtlelog.show.rerun.timelines import RunStream, Times, Values, build_index

_REFERENCE_WIDTH: Final = 1.0  # [points]
_LEGEND_WIDTH: Final = 12.0  # in heights of a row
_LEGEND_LETTERS: Final = 48
_MOST_COLUMNS: Final = 4
_LEGEND_RADIUS: Final = 5.0  # [points]
_MOST_NAMES: Final = 28
"""In four columns and seven lines, which a window of 1200 x 860 has room for."""


def draw_series(run_stream: RunStream, series: Series) -> None:
    """Draw curves into their plot."""
    style = rr.SeriesLines(
        names=series.labels,
        colors=palette.pack_colors(series.colors),
        widths=[series.width] * len(series.labels),
        interpolation_mode="StepAfter" if series.holds else "Linear",
        aggregation_policy="MinMax",
    )
    run_stream.log(series.entity, style)
    run_stream.send(series.entity, series.time_ns, series.values, _build_scalars)


def draw_references(
    stream: rr.RecordingStream, references: Sequence[LevelLines], span: Mapping[str, Times]
) -> None:
    """Draw level lines across plots, over a span of every timeline."""
    index = build_index(span)
    for reference in references:
        entity = join_path(entities.REFERENCE, reference.plot)
        count = len(reference.levels)
        style = rr.SeriesLines(
            names=list(reference.labels),
            colors=palette.pack_colors([palette.REFERENCE] * count),
            widths=[_REFERENCE_WIDTH] * count,
        )
        stream.log(entity, style, static=True)
        columns = rr.Scalars.columns(scalars=np.tile(reference.levels, (2, 1)))
        stream.send_columns(entity, index, columns)


def draw_phases(run_stream: RunStream, run: Run) -> None:
    """Draw the phases as a bar that ends in `done`, or in nothing where the run was cut."""
    spans = run.find_phase_spans()
    if not spans:
        return
    style = rr.StateConfiguration(
        values=list(run.phase_names),
        # The pause is too short for its name; the title of the view explains its colour.
        labels=[" " if name == PAUSE else name for name in run.phase_names],
        colors=[found.bar for found in palette.choose_phase_colors(run.phase_names)],
    )
    run_stream.log(entities.PHASE, style)
    last = DONE if run.is_complete else ""
    columns = rr.StateChange.columns(state=[*(span.phase for span in spans), last])
    starts_ns = [*(span.start_ns for span in spans), run.end_ns]
    run_stream.send_few(entities.PHASE, starts_ns, columns)


def draw_events(run_stream: RunStream, run: Run, speaker: str = "") -> None:
    """List the events as a text log, each after the speaker's name if there is one."""
    if not run.events:
        return
    columns = rr.TextLog.columns(
        text=[f"{speaker}: {event.text}" if speaker else event.text for event in run.events],
        level=["INFO" if event.kind == "stop" else "WARN" for event in run.events],
    )
    run_stream.send_few(entities.EVENTS, [event.time_ns for event in run.events], columns)


def draw_documents(stream: rr.RecordingStream, documents: Mapping[str, str]) -> None:
    """Store Markdown documents under their titles."""
    for title, text in documents.items():
        document = rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)
        stream.log(name_document(title), document, static=True)


def name_document(title: str) -> str:
    """Return the entity path of a document."""
    return join_path(entities.DOCUMENTS, rr.escape_entity_path_part(title))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LegendGrid:
    """Where the names stand.

    Attributes:
        places: One per name, y downward, shape (n, 2).
        x_range: What the view shows.
        y_range: What the view shows.
    """

    places: NDArray[np.float64]
    x_range: tuple[float, float]
    y_range: tuple[float, float]


def choose_names(count: int) -> tuple[int, ...]:
    """Return which of many runs are named: as many as there is room for, the last among them.

    Colours of many runs follow their order, so that those between are known from their neighbours.
    """
    if count <= _MOST_NAMES:
        return tuple(range(count))
    return tuple(np.unique(np.linspace(0, count - 1, _MOST_NAMES).round().astype(int)).tolist())


def arrange_names(names: Sequence[str]) -> LegendGrid:
    """Return a grid with as many columns as the longest name allows."""
    longest = max(len(name) for name in names)
    columns = max(1, min(_MOST_COLUMNS, _LEGEND_LETTERS // longest))
    number = np.arange(len(names))
    step = _LEGEND_WIDTH / columns
    places = np.column_stack([(number % columns + 0.5) * step, number // columns])
    return LegendGrid(
        places=places, x_range=(0.0, _LEGEND_WIDTH), y_range=(-0.5, float(places[-1, 1]) + 1.0)
    )


def draw_legend(stream: rr.RecordingStream, names: Sequence[str], colors: Sequence[Color]) -> None:
    """Draw runs' names in their colours."""
    chosen = choose_names(len(names))
    shown = [names[number] for number in chosen]
    points = rr.Points2D(
        arrange_names(shown).places,
        radii=rr.Radius.ui_points(_LEGEND_RADIUS),
        colors=[colors[number] for number in chosen],
        labels=shown,
        show_labels=True,
    )
    stream.log(join_path(entities.LEGEND), points, static=True)


def _build_scalars(values: Values) -> rr.ComponentColumnList:
    return rr.Scalars.columns(scalars=values)
