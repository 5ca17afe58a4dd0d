"""Marks on the time axes: metrics that have a place, on their curves, and lines across plots."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, Literal

import numpy as np
import rerun as rr

from turtlelog.measure import Metric
from turtlelog.run import Run
from turtlelog.show.rerun import entities, palette
from turtlelog.show.rerun.run_stream import RunStream
from turtlelog.show.rerun.series import Series
from turtlelog.show.run_colors import Color

Shape = Literal["Circle", "Diamond", "Right", "Up"]

_SIGNS: Final[Mapping[Shape, str]] = {"Circle": "●", "Diamond": "◆", "Right": "▶", "Up": "▲"}
"""How the marks look, for the legend, which has but a dot for each."""

_SIZE: Final = 4.0  # [points]
_LINE_WIDTH: Final = 1.0
_ROUNDING_NS: Final = 1_000
_DECADES: Final = 10.0 ** -np.arange(8.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class _MarkKind:
    """Where a metric is marked: the entity of its curve, what it is called there, and its shape."""

    curve: str
    word: str
    shape: Shape


_COMMANDED_TURN_RATE: Final = f"{entities.TURN_RATE}/{entities.COMMANDED}"
_COMMANDED_SPEED: Final = f"{entities.SPEED}/{entities.COMMANDED}"

MARKED: Final[Mapping[str, _MarkKind]] = MappingProxyType(
    {
        "rotate.settling_time": _MarkKind(curve=entities.HEADING, word="settled", shape="Circle"),
        "rotate.overshoot": _MarkKind(curve=entities.HEADING, word="overshoot", shape="Diamond"),
        "rotate.rise_time": _MarkKind(curve=entities.HEADING, word="rise", shape="Up"),
        "rotate.final_error": _MarkKind(
            curve=entities.HEADING_ERROR, word="when driving off", shape="Circle"
        ),
        "rotate.longest_saturation": _MarkKind(
            curve=_COMMANDED_TURN_RATE, word="saturated for", shape="Right"
        ),
        "translate.settling_time": _MarkKind(
            curve=entities.ALONG_TRACK, word="settled", shape="Circle"
        ),
        "translate.overshoot": _MarkKind(
            curve=entities.ALONG_TRACK, word="overshoot", shape="Diamond"
        ),
        "translate.rise_time": _MarkKind(curve=entities.ALONG_TRACK, word="rise", shape="Up"),
        "translate.longest_saturation": _MarkKind(
            curve=_COMMANDED_SPEED, word="saturated for", shape="Right"
        ),
        "translate.cross_track_max": _MarkKind(
            curve=entities.CROSS_TRACK, word="furthest", shape="Diamond"
        ),
        "run.time_to_goal": _MarkKind(curve=entities.DISTANCE, word="at the goal", shape="Up"),
        "final.position_error": _MarkKind(
            curve=entities.DISTANCE, word="at the end", shape="Circle"
        ),
    }
)
"""The metrics that are marked on a curve, by id; the document gives the places of the others."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Mark:
    """One metric on its curve.

    Attributes:
        plot: Where the curve stands.
        label: Legend: what it is, with its value.
        unit: Of the value.
        shape: Rerun's name of a marker.
        time_ns: In the run's own time [ns].
        level: In the unit of the curve.
    """

    plot: str
    label: str
    unit: str
    shape: Shape
    time_ns: int
    level: float

    @property
    def entity(self) -> str:
        """Entity path of all marks of the plot, below the run's prefix."""
        return f"{self.plot}/{entities.MARKS}"


def list_marks(
    run: Run, series: Sequence[Series], metrics: Mapping[str, Metric]
) -> tuple[Mark, ...]:
    """Return the metrics that have a place on a curve that is drawn."""
    curves = {curve.entity: curve for curve in series}
    marks = []
    for name, kind in MARKED.items():
        metric, curve = metrics.get(name), curves.get(kind.curve)
        if metric is None or metric.value is None or metric.at_s is None or curve is None:
            continue
        time_ns = run.start_ns + round(metric.at_s * 1e9)
        marks.append(
            Mark(
                plot=curve.plot,
                label=f"{kind.word} {metric.value:.3g} {metric.unit}",
                unit=metric.unit,
                shape=kind.shape,
                time_ns=time_ns,
                level=_read_level(curve, time_ns),
            )
        )
    return tuple(marks)


def draw_marks(run_stream: RunStream, marks: Sequence[Mark]) -> None:
    """Draw each metric as a point whose name, in the legend, holds the value."""
    for entity in dict.fromkeys(mark.entity for mark in marks):
        found = [mark for mark in marks if mark.entity == entity]
        style = rr.SeriesPoints(
            names=_name_marks(found),
            colors=palette.pack_colors([palette.MARK] * len(found)),
            markers=[mark.shape for mark in found],
            marker_sizes=[_SIZE] * len(found),
        )
        run_stream.log(entity, style)
        # A row for each, in which the others are nowhere.
        levels = np.full((len(found), len(found)), np.nan)
        np.fill_diagonal(levels, [mark.level for mark in found])
        times_ns = [mark.time_ns for mark in found]
        run_stream.send_few(entity, times_ns, rr.Scalars.columns(scalars=levels))


def _name_marks(marks: Sequence[Mark]) -> list[str]:
    """Return a name for each mark; those of one unit share it, and so a line of the legend."""
    of_unit: dict[str, list[str]] = {}
    for mark in sorted(marks, key=lambda found: found.time_ns):
        of_unit.setdefault(mark.unit, []).append(f"{_SIGNS[mark.shape]} {mark.label}")
    return ["  ".join(of_unit[mark.unit]) for mark in marks]


def draw_lines(
    run_stream: RunStream,
    entity: str,
    label: str,
    color: Color,
    times_ns: Sequence[int],
    *,
    largest: float,
) -> None:
    """Draw upright lines at times of the run [ns], up to the `largest` value of any plot.

    Every plot that shows them needs a fixed range.
    """
    style = rr.SeriesLines(
        names=[label],
        colors=palette.pack_colors([color]),
        widths=[_LINE_WIDTH],
        aggregation_policy="Off",
    )
    run_stream.log(entity, style)
    # The viewer cannot draw a line of many thousand plots' height: it goes by powers of ten.
    steps = largest * _DECADES
    line = [*-steps, *steps[::-1], np.nan]
    levels = np.tile(line, len(times_ns))
    run_stream.send_few(entity, np.repeat(times_ns, len(line)), rr.Scalars.columns(scalars=levels))


def _read_level(curve: Series, time_ns: int) -> float:
    values = curve.values[:, 0]
    if curve.holds:
        row = int(np.searchsorted(curve.time_ns, time_ns + _ROUNDING_NS, side="right")) - 1
        return float(values[max(row, 0)])
    return float(np.interp(time_ns, curve.time_ns, values))
