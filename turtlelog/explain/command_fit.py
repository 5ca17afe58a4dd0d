"""One command of the law: its gain where it is not clipped, and its limit where it is."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.explain.finding import Certainty, Finding, find_exactly, miss
from turtlelog.explain.numbers import GainFit, fit_gain
from turtlelog.explain.trace import Values

Reproduce = Callable[[float], Values]
"""The commands that the law wants, by its gain."""

_PROPORTIONAL: Final = 0.05
"""Residual above which commands are not proportional to the error, as a share of their own size."""

_BEYOND: Final = 1.02
"""How far a wanted command lies beyond a plateau that noise cannot make."""

_TINY: Final = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandFit:
    """One command's gain and limit.

    Attributes:
        gain: None where all commands are clipped, or the error never changes.
        limit: Where the commands are clipped, None where none is.
        least: The least gain that explains every command, where there is none.
        largest: The largest magnitude published.
        rows: Commands in the phase.
    """

    gain: GainFit | None
    limit: float | None
    least: float = 0.0
    largest: float
    rows: int

    @property
    def is_proportional(self) -> bool:
        """Whether the commands follow the error at all."""
        if self.gain is None:
            return False
        return self.gain.value > 0.0 and self.gain.residual <= _PROPORTIONAL * self.largest


def fit_command(command: Values, reproduce: Reproduce) -> CommandFit:
    """Fit a gain to the commands that are not clipped; find out which are."""
    size = np.abs(command)
    largest = float(size.max())
    below = size < largest
    whole = _fit_rows(command, reproduce, np.ones_like(below))
    if whole.is_exact and np.ptp(reproduce(1.0)) > 0.0:
        return CommandFit(gain=whole, limit=None, largest=largest, rows=len(command))
    if not below.any():
        per_unit = np.abs(reproduce(1.0))
        return CommandFit(
            gain=None,
            limit=largest if np.ptp(per_unit) > 0.0 else None,
            least=largest / max(float(per_unit.min()), _TINY),
            largest=largest,
            rows=len(command),
        )
    fit = _fit_rows(command, reproduce, below)
    wanted = np.abs(reproduce(fit.value))[~below]
    is_clipped = wanted.min() >= largest if fit.is_exact else wanted.max() > _BEYOND * largest
    if is_clipped:
        return CommandFit(gain=fit, limit=largest, largest=largest, rows=len(command))
    return CommandFit(gain=whole, limit=None, largest=largest, rows=len(command))


def _fit_rows(command: Values, reproduce: Reproduce, rows: NDArray[np.bool_]) -> GainFit:
    return fit_gain(command[rows], lambda gain: reproduce(gain)[rows])


def describe_gain(fit: CommandFit) -> Finding:
    """Return the gain, or by how much or why the commands do not tell it."""
    if fit.gain is None and fit.limit is None:
        return miss("the error never changes", fit.least)
    if fit.gain is None:
        return Finding(
            certainty=Certainty.UNKNOWN,
            evidence=f"all {fit.rows} commands stand at {fit.largest:g}: at least {fit.least:.4g}",
            interval=(fit.least, math.inf),
            assumed=max(1.0, math.ceil(fit.least * 1.001)),
        )
    found = fit.gain
    if not fit.is_proportional:
        if found.value <= 0.0:
            return miss(f"the commands are not proportional: their gain would be {found.value:.4g}")
        share = found.residual / fit.largest if fit.largest else math.inf
        return miss(
            f"the commands are not proportional to the error: {share:.0%} of their size is left",
            1.0,
        )
    if found.is_exact:
        noun = "command" if found.rows == 1 else "commands"
        return find_exactly(found.value, f"reproduces {found.rows} unclipped {noun}")
    return Finding(
        value=found.value,
        certainty=Certainty.FITTED,
        evidence=f"least squares of {found.rows}, standard error {found.standard_error:.2g}",
    )


def describe_limit(fit: CommandFit) -> Finding:
    """Return the limit, or the largest command where none is clipped."""
    if fit.limit is None:
        return miss(f"no command is clipped; the largest is {fit.largest:.4g}", math.inf)
    clipped = fit.rows - (fit.gain.rows if fit.gain else 0)
    return find_exactly(fit.limit, f"{clipped} of {fit.rows} commands stand there")


def compute_misfit(fit: CommandFit, command: Values, error: Values) -> float:
    """Return the root mean square of what a fit leaves, clipped commands included."""
    gain = math.inf if fit.gain is None else max(fit.gain.value, 0.0)
    limit = math.inf if fit.limit is None else fit.limit
    with np.errstate(invalid="ignore"):
        wanted = np.clip(np.nan_to_num(gain * error), -limit, limit)
    return float(np.sqrt(np.mean((wanted - command) ** 2)))
