"""The curves of a run's commands: wanted, clipped, applied."""

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.measure import read_signal
from turtlelog.run import Run
from turtlelog.show import palette
from turtlelog.show.aims import list_limit_keys
from turtlelog.show.commanded import Command, read_commanded
from turtlelog.show.rerun import entities
from turtlelog.show.rerun.series import Series
from turtlelog.show.run_colors import Color

_COMMANDED_WIDTH: Final = 3.0
_THIN_WIDTH: Final = 1.25


def list_commands(run: Run, plot: str) -> Iterator[Series]:
    """Yield what was wanted, commanded and applied; the thick one shows beneath the others."""
    poses = run.poses
    applied = poses.speed_m_s if plot == entities.SPEED else poses.turn_rate_rad_s
    wanted = read_signal(run, f"wanted_{plot}")
    if wanted is not None:
        yield _build(plot, entities.WANTED, wanted.time_ns, wanted.values, palette.WANTED)
    commanded = read_commanded(run, "speed" if plot == entities.SPEED else "turn_rate")
    if commanded is not None:
        yield _build(plot, entities.COMMANDED, *commanded, palette.MAIN)
    if applied is not None:
        yield _build(plot, entities.APPLIED, poses.time_ns, applied, palette.SECOND)


def find_limits(runs: Sequence[Run], command: Command) -> set[float]:
    """Return the limits of runs with both signs, none where they are infinite or not known."""
    limits = {run.parameters.get(key) for run in runs for key in list_limit_keys(run, command)}
    sizes = {float(limit) for limit in limits if isinstance(limit, int | float)}
    return {sign * size for size in sizes if np.isfinite(size) for sign in (-1.0, 1.0)}


def _build(
    plot: str,
    kind: str,
    time_ns: NDArray[np.int64],
    values: NDArray[np.float64],
    color: Color,
) -> Series:
    return Series(
        entity=f"{plot}/{kind}",
        labels=(kind,),
        colors=(color,),
        time_ns=time_ns,
        values=values[:, np.newaxis],
        width=_COMMANDED_WIDTH if kind == entities.COMMANDED else _THIN_WIDTH,
        holds=True,
        is_main=kind == entities.COMMANDED,
    )
