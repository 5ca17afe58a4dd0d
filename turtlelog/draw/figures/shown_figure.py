"""A figure that shows itself in a notebook, whatever matplotlib's backend there is."""

import io
from typing import Any, Final

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from turtlelog.draw.figures.page import use_looks

_DPI: Final = 192
"""Twice what browsers call an inch: sharp on screens of any kind."""

_BROWSER_DPI: Final = 96


class ShownFigure(Figure):
    """A `matplotlib.figure.Figure` that a notebook shows as the value of a cell.

    It takes no magic command, and does not stay in the memory of pyplot.
    """

    def _repr_png_(self) -> tuple[bytes, dict[str, Any]]:
        data, dpi = io.BytesIO(), self.dpi
        with use_looks():
            try:
                self.dpi = _DPI
                if (engine := self.get_layout_engine()) is not None:
                    engine.execute(self)
                FigureCanvasAgg(self).print_png(data)
            finally:
                self.dpi = dpi
        width, height = (round(float(inch) * _BROWSER_DPI) for inch in self.get_size_inches())
        return data.getvalue(), {"width": width, "height": height}
