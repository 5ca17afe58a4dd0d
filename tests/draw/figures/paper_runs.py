"""The paper's runs, and what is drawn on axes."""

from dataclasses import fields, replace
from functools import cache
from pathlib import Path
from typing import TypeVar

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import turtlelog as tl
from turtlelog.run import CommandColumns, SampleColumns
from turtlelog.scenario import get_preset

Columns = TypeVar("Columns", SampleColumns, CommandColumns)

PAPER = Path(__file__).parents[3] / "recordings" / "paper"


@cache
def read(kp: int) -> tl.Run:
    return tl.read_run(PAPER / f"kp{kp}.mcap")


RUNS = [read(kp) for kp in (1, 2, 4, 10)]


def make_figure(width: float = 7.0) -> Figure:
    return Figure(figsize=(width, 4.0), layout="constrained")


def list_texts(axes: Axes) -> list[str]:
    return [text.get_text() for text in axes.texts]


def list_points(axes: Axes) -> np.ndarray:
    """Return the single points that runs are."""
    found = [line for line in axes.get_lines() if line.get_marker() == "o"]
    return np.concatenate([np.asarray(line.get_xydata()) for line in found])


@cache
def simulate(kp: int) -> tl.Run:
    return tl.simulate_run(get_preset(f"paper-kp{kp}"))


def keep_poses(run: tl.Run) -> tl.Run:
    samples, commands = _empty(run.samples), _empty(run.commands)
    return replace(run, samples=samples, commands=commands, goal_xy_m=None, parameters={})


def _empty(columns: Columns) -> Columns:
    tables = {field.name: getattr(columns, field.name) for field in fields(columns)}
    known = {name: table[:0] for name, table in tables.items() if table is not None}
    return replace(columns, **known)
