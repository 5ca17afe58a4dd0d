"""Many runs are named by a bar of their colours, by gain, in place of a legend."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure

from turtlelog.charts.many_runs import find_gain_scale, group_by_gain
from turtlelog.charts.palette import FEW
from turtlelog.draw.figures.page import choose_colors, label_runs
from turtlelog.run import Run

_BAR_INCH: Final = 0.42
"""What a bar with its numbers and its name takes of the height of a figure."""
_MOST_TICKS: Final = 7
"""As many gains of three digits as a column has room for."""


def add_gain_bar(figure: Figure, runs: Sequence[Run]) -> frozenset[str]:
    """Add a bar of colours where a figure names more runs than have a hue of their own.

    Returns:
        What the bar names, which the legend need not.
    """
    names = label_runs(runs)
    drawn = [axes for axes in figure.axes if _names_all(axes.get_legend_handles_labels()[1], names)]
    if len(runs) <= len(FEW) or not drawn:
        return frozenset()
    count = len(runs)
    colors = ListedColormap(choose_colors(count))
    norm = BoundaryNorm(np.arange(count + 1) - 0.5, count)
    width, height = figure.get_size_inches()
    figure.set_size_inches(width, height + _BAR_INCH)
    bar = figure.colorbar(
        ScalarMappable(norm, colors),
        ax=figure.axes,
        location="top",
        fraction=0.04,
        aspect=width / 0.09,
        pad=0.02,
    )
    bar.outline.set_visible(False)
    bar.ax.minorticks_off()
    scale = find_gain_scale(runs)
    if scale is not None:
        shown = np.unique(np.linspace(0, count - 1, min(count, _MOST_TICKS)).round().astype(int))
        bar.set_ticks(shown.tolist(), labels=[f"{scale.values[row]:.3g}" for row in shown])
        unit = f" [{scale.unit}]" if scale.unit else ""
        bar.set_label(f"{scale.word} of {count} runs{unit}")
    elif len(groups := group_by_gain(runs)) > 1:
        gains = sorted(groups)
        shown = np.unique(np.linspace(0, len(gains) - 1, min(len(gains), _MOST_TICKS)).round())
        told = [gains[int(row)] for row in shown]
        bar.set_ticks(
            [float(np.mean(groups[kp])) for kp in told], labels=[f"{kp:.3g}" for kp in told]
        )
        bar.set_label(f"Kp of {count} runs")
    else:
        bar.set_ticks([])
        bar.set_label(f"{count} runs, from {names[0]} to {names[-1]}")
    return frozenset(names)


def _names_all(labels: Sequence[str], names: Sequence[str]) -> bool:
    return len({*names} & {*labels}) > len(FEW)
