"""Figures for print: the paper's, from any recordings, with matplotlib.

`catalogue` names them, `theory`, `series` and `plane` draw them, `page` gives them their size and
looks, `files` writes them.
"""

from turtlelog.show.figures.catalogue import FIGURES, FigureKind, list_left_out
from turtlelog.show.figures.files import FIGURE_FORMATS, draw_figure, write_figures, write_tables
from turtlelog.show.figures.page import Page

__all__ = [
    "FIGURES",
    "FIGURE_FORMATS",
    "FigureKind",
    "Page",
    "draw_figure",
    "list_left_out",
    "write_figures",
    "write_tables",
]
