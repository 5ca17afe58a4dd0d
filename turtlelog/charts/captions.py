"""Text alternatives of pictures: what a plot or a plane shows, in sentences."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import describe_count

_MOST_NAMED: Final = 6
"""Largest number of runs that are described one by one; with more, a listener forgets the first."""


def describe_plot(title: str, curves: Sequence[tuple[str, NDArray[np.float64]]]) -> str:
    """Return a description of a plot over time: start, end and range of each curve.

    Args:
        title: Title of the plot, with the unit of its values.
        curves: Name and values of each run, shape (n,). Values that are not finite are gaps.
    """
    finite = [(name, values[np.isfinite(values)]) for name, values in curves]
    known = [(name, values) for name, values in finite if len(values)]
    if not known:
        return f"{title}: no values."
    if len(known) <= _MOST_NAMED:
        said = [f"{name}: {_describe_values(values)}" for name, values in known]
        return f"{title} over time. {'; '.join(said)}."
    values = np.concatenate([values for _, values in known])
    return (
        f"{title} over time of {describe_count(len(known), 'run')},"
        f" between {_write(values.min())} and {_write(values.max())}."
    )


def _describe_values(values: NDArray[np.float64]) -> str:
    return (
        f"from {_write(values[0])} to {_write(values[-1])},"
        f" between {_write(values.min())} and {_write(values.max())}"
    )


def _write(value: float) -> str:
    return f"{value + 0.0:.4g}"  # + 0.0: no negative zero


def describe_plane(title: str, ends: Sequence[tuple[str, NDArray[np.float64]]]) -> str:
    """Return a description of a plane: start and end of each run.

    Args:
        title: Title of the plane.
        ends: Name of each run, with its poses [m], shape (n, 2).
    """
    if len(ends) > _MOST_NAMED:
        return f"{title}: the paths of {describe_count(len(ends), 'run')} in the plane."
    said = [
        f"{name} drives from {_write_place(xy_m[0])} to {_write_place(xy_m[-1])} m"
        for name, xy_m in ends
    ]
    return f"{title}. {'; '.join(said)}."


def _write_place(xy_m: NDArray[np.float64]) -> str:
    return f"({xy_m[0]:.4g}, {xy_m[1]:.4g})"
