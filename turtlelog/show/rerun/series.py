"""What a plot is made of, before anything is drawn: curves and level lines."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.show import palette
from turtlelog.show.rerun import entities
from turtlelog.show.run_colors import Color

LINE_WIDTH: Final = 1.5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Series:
    """Curves that share their times and their plot.

    Attributes:
        entity: Entity path below the run's prefix; its first part names the plot, of a state of a
            law its first two.
        labels: Legend, one per curve.
        colors: One per curve.
        time_ns: The run's own time [ns], shape (n,), not decreasing.
        values: One column per curve, shape (n, curves); NaN where there is nothing to draw.
        width: Of the lines [points].
        holds: Whether a value lasts until the next, rather than leading to it in a line.
        is_main: Whether a comparison shows it too.
        is_measured: Whether it is the run's own, so that the plot must have room for it.
    """

    entity: str
    labels: tuple[str, ...]
    colors: tuple[Color, ...] = (palette.MAIN,)
    time_ns: NDArray[np.int64]
    values: NDArray[np.float64]
    width: float = LINE_WIDTH
    holds: bool = False
    is_main: bool = True
    is_measured: bool = True

    @property
    def plot(self) -> str:
        """The plot it stands in: each state of a law has one of its own."""
        parts = self.entity.split("/")
        return "/".join(parts[: 1 + (parts[0] == entities.STATE)])


@dataclass(frozen=True, slots=True, kw_only=True)
class Reference:
    """Level lines across a plot.

    Attributes:
        plot: Entity that the plot is named after.
        labels: Legend, one per level.
        levels: In the plot's unit.
    """

    plot: str
    labels: tuple[str, ...]
    levels: tuple[float, ...]
