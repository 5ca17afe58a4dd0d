"""Figures for print with matplotlib: the figures of the paper, from any recordings.

`figure_kinds` defines the figures, `figure_curves` and the files of panels draw them, `page` sets
size and style, and `writing` writes the files.
"""

from turtlelog.libraries import load_library

load_library("matplotlib")

from turtlelog.draw.figures.explanation_figures import write_difference_figure
from turtlelog.draw.figures.figure_kinds import FIGURES, FigureKind
from turtlelog.draw.figures.page import Page
from turtlelog.draw.figures.robot_figures import (
    write_prediction_figure,
    write_robot_figure,
    write_trajectory_figure,
)
from turtlelog.draw.figures.sweep_figures import draw_map, write_map_figure
from turtlelog.draw.figures.writing import (
    draw_figure,
    list_left_out,
    list_unmarked,
    write_figures,
    write_tables,
)

__all__ = [
    "FIGURES",
    "FigureKind",
    "Page",
    "draw_figure",
    "draw_map",
    "list_left_out",
    "list_unmarked",
    "write_difference_figure",
    "write_figures",
    "write_map_figure",
    "write_prediction_figure",
    "write_robot_figure",
    "write_tables",
    "write_trajectory_figure",
]
