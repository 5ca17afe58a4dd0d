"""Shares of a deviation by mechanism: the bars, and the table beside them."""

from collections.abc import Mapping
from typing import Final

import rerun as rr

from turtlelog.compare import Column, Table
from turtlelog.measure import Metric
from turtlelog.show import palette
from turtlelog.show.rerun import entities
from turtlelog.show.rerun.entities import join_path
from turtlelog.show.run_colors import Color
from turtlelog.show.table_formats import format_markdown

_BAR_WIDTH: Final = 0.8
_LEGEND_SHARE: Final = 0.35


def draw_shares(
    stream: rr.RecordingStream, shares: Mapping[str, float], colors: Mapping[str, Color]
) -> None:
    """Draw a bar per mechanism, in the colour of the run without it where there is one."""
    for number, (mechanism, share) in enumerate(shares.items(), start=1):
        # After the last bar, one of no height makes room for the legend.
        places = [number] if number < len(shares) else [number, number * (1.0 + _LEGEND_SHARE)]
        bar = rr.BarChart(
            [share, 0.0][: len(places)],
            abscissa=places,
            widths=[_BAR_WIDTH] * len(places),
            color=colors.get(mechanism, palette.REFERENCE),
        )
        entity = join_path(entities.SHARES, rr.escape_entity_path_part(mechanism))
        stream.log(entity, bar, static=True)


def tabulate_shares(
    shares: Mapping[str, float], recorded: Metric, without: Mapping[str, Metric]
) -> str:
    """Return a Markdown table of each mechanism's share, and of the metric without it."""
    table = Table(
        title=f"{recorded.id}: {_format(recorded)} as recorded",
        columns=(
            Column(title="mechanism"),
            Column(title="share", unit=recorded.unit),
            Column(title="without it alone", unit=recorded.unit),
        ),
        rows=tuple(
            (
                mechanism,
                shares.get(mechanism),
                without[mechanism].value if mechanism in without else None,
            )
            for mechanism in dict.fromkeys([*shares, *without])
        ),
    )
    return format_markdown(table)


def _format(metric: Metric) -> str:
    return metric.status.value if metric.value is None else f"{metric.value:.5g} {metric.unit}"
