"""What the commands say of the law: gains, limits, tolerances, projection, wrapping."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.angles import wrap_angle
from turtlelog.explain.finding import Certainty, Finding, find_exactly, miss
from turtlelog.explain.numbers import GainFit, find_round_number, fit_gain
from turtlelog.explain.trace import Trace

Values = NDArray[np.float64]
Reproduce = Callable[[float], Values]

_PROPORTIONAL: Final = 0.05
"""Residual above which commands are not proportional to the error, as a share of their own size."""

_BEYOND: Final = 1.02
"""How far a wanted command lies beyond a plateau that noise cannot make."""

_CERTAIN: Final = 10.0
"""Difference of log-likelihoods from which the better of two models counts as found."""

_LAST_TWO: Final = "the errors at the end and before it"

_TINY: Final = 1e-9

_DEFAULT_TOLERANCE: Final = 0.001


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


def identify_rotation(trace: Trace) -> dict[str, Finding]:
    """Return gain, limit, tolerance and wrapping of the heading loop, by key of the scenario."""
    rows = slice(1, trace.rotating - trace.ended_rotation)
    error = trace.bearing_rad - trace.heading_rad
    command = trace.turn_rate_rad_s[rows]
    if not np.any(command):
        reason = "the run has no command that turns"
        return {
            "law.kp_angular": miss(reason, 1.0),
            "limits.turn_rate_rad_s": miss(reason, math.inf),
            **_bracket_heading_tolerance(trace, error),
            "law.wrap_error": miss(reason, assumed=False),
        }
    wraps, wrap_finding = _choose_wrapping(command, error[rows])
    if wraps:
        error = wrap_angle(error)
    fit = _fit_command(command, partial(np.multiply, error[rows]))
    if fit.gain and not fit.gain.is_exact and fit.is_proportional:
        tolerance = _bound_heading_tolerance(float(np.abs(command).min()) / fit.gain.value)
    else:
        tolerance = _bracket_heading_tolerance(trace, error)
    return {
        "law.kp_angular": _describe_gain(fit),
        "limits.turn_rate_rad_s": _describe_limit(fit),
        **tolerance,
        "law.wrap_error": wrap_finding,
    }


def identify_translation(trace: Trace) -> dict[str, Finding]:
    """Return gain, limit, tolerance and projection of the position loop, by key of the scenario."""
    rows = slice(trace.rotating, trace.rotating + trace.translating)
    command = trace.speed_m_s[rows]
    driven = command != 0.0
    if trace.goal_xy_m is None or not driven.any():
        known = "the log does not hold the goal" if driven.any() else "no command drives"
        return {
            "law.kp_linear": miss(known, 1.0),
            "limits.speed_m_s": miss(known, math.inf),
            "law.position_tolerance_m": miss(known, _DEFAULT_TOLERANCE),
            "law.projection": miss(known, "heading"),
        }
    errors = np.subtract(trace.goal_xy_m, trace.xy_m[rows])
    along = {
        "bearing": np.full(int(driven.sum()), trace.bearing_rad),
        "heading": trace.heading_rad[rows][driven],
    }
    fits = {
        name: _fit_command(command[driven], _project(errors[driven], headings))
        for name, headings in along.items()
    }
    projection = _choose_projection(fits)
    fit = fits[projection.used]
    return {
        "law.kp_linear": _describe_gain(fit),
        "limits.speed_m_s": _describe_limit(fit),
        "law.position_tolerance_m": _bracket_position_tolerance(errors, command),
        "law.projection": projection,
    }


def _project(errors: Values, headings: Values) -> Reproduce:
    """Return the law's own arithmetic, in its order; numpy's cosine differs in the last bit."""
    cosine = np.array([math.cos(heading) for heading in headings.tolist()])
    sine = np.array([math.sin(heading) for heading in headings.tolist()])
    x, y = errors.T.copy()

    def reproduce(gain: float) -> Values:
        return np.asarray(gain * x * cosine + gain * y * sine)

    return reproduce


def _fit_command(command: Values, reproduce: Reproduce) -> CommandFit:
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


def _describe_gain(fit: CommandFit) -> Finding:
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


def _describe_limit(fit: CommandFit) -> Finding:
    if fit.limit is None:
        return miss(f"no command is clipped; the largest is {fit.largest:.4g}", math.inf)
    clipped = fit.rows - (fit.gain.rows if fit.gain else 0)
    return find_exactly(fit.limit, f"{clipped} of {fit.rows} commands stand there")


def _choose_wrapping(command: Values, error: Values) -> tuple[bool, Finding]:
    if (np.abs(error) < math.pi).all():
        return False, miss("the heading error stays within half a turn", assumed=False)
    plain, wrapped = (
        _fit_command(command, partial(np.multiply, values)) for values in (error, wrap_angle(error))
    )
    wraps = _compute_misfit(wrapped, command, wrap_angle(error)) < _compute_misfit(
        plain, command, error
    )
    return wraps, find_exactly(wraps, "the heading error exceeds half a turn")


def _compute_misfit(fit: CommandFit, command: Values, error: Values) -> float:
    """Return the root mean square of what a fit leaves, clipped commands included."""
    gain = math.inf if fit.gain is None else max(fit.gain.value, 0.0)
    limit = math.inf if fit.limit is None else fit.limit
    with np.errstate(invalid="ignore"):
        wanted = np.clip(np.nan_to_num(gain * error), -limit, limit)
    return float(np.sqrt(np.mean((wanted - command) ** 2)))


def _choose_projection(fits: dict[str, CommandFit]) -> Finding:
    bearing, heading = fits["bearing"].gain, fits["heading"].gain
    if bearing is None or heading is None:
        return miss("every command stands at its limit", "bearing")
    if bearing.is_exact and heading.is_exact and bearing.is_bitwise == heading.is_bitwise:
        return _leave_open(tuple(fits), "both reproduce every command", "heading")
    for name, gain in (("bearing", bearing), ("heading", heading)):
        if gain.is_bitwise or (gain.is_exact and not (bearing.is_bitwise or heading.is_bitwise)):
            return find_exactly(name, f"reproduces {gain.rows} unclipped commands")
    better = "bearing" if bearing.residual <= heading.residual else "heading"
    gain = bearing if better == "bearing" else heading
    ratio = max(bearing.residual, heading.residual) / gain.residual
    if gain.rows * math.log(ratio) < _CERTAIN:
        return _leave_open(tuple(fits), "noise hides the difference", better)
    return Finding(
        value=better, certainty=Certainty.FITTED, evidence=f"the other leaves {ratio:.3g} times"
    )


def _leave_open(candidates: tuple[str, ...], evidence: str, likeliest: str) -> Finding:
    return Finding(
        value=likeliest,
        certainty=Certainty.AMBIGUOUS,
        evidence=evidence,
        candidates=candidates,
    )


def _bracket_heading_tolerance(trace: Trace, error: Values) -> dict[str, Finding]:
    key = "law.heading_tolerance_rad"
    moving = np.abs(error[1 : trace.rotating - trace.ended_rotation])
    if not trace.ended_rotation:
        high = float(moving.min()) if len(moving) else math.inf
        return {key: _bracket(0.0, high, "the rotation has no end", "rad")}
    ended = float(abs(error[trace.rotating - 1]))
    high = float(moving.min()) if len(moving) else math.inf
    return {key: _bracket(ended, high, _LAST_TWO, "rad")}


def _bound_heading_tolerance(high: float) -> dict[str, Finding]:
    """The commands tell the error that the law saw, the poses one with noise."""
    return {
        "law.heading_tolerance_rad": _bracket(0.0, high, "noise; the last command and gain", "rad")
    }


def _bracket_position_tolerance(errors: Values, command: Values) -> Finding:
    larger = np.abs(errors).max(axis=1)
    high = float(larger[command != 0.0].min())
    if command[-1] != 0.0:
        return _bracket(0.0, high, "the run ends outside it", "m")
    return _bracket(float(larger[-1]), high, _LAST_TWO, "m")


def _bracket(low: float, high: float, evidence: str, unit: str) -> Finding:
    if low >= high:
        return miss("noise: errors that moved are no larger than the one that ended", low)
    rounded = _DEFAULT_TOLERANCE
    if not low <= rounded < high:
        rounded = find_round_number(low, min(high, 10.0 * low) if low > 0.0 else high)
    if low <= 0.0 or math.isinf(high):
        bound = f"below {high:.4g} {unit}" if low <= 0.0 else f"at least {low:.4g} {unit}"
        return Finding(
            certainty=Certainty.UNKNOWN,
            evidence=f"{evidence}: {bound}",
            interval=(low, high),
            assumed=rounded,
        )
    return Finding(
        value=rounded, certainty=Certainty.BRACKETED, evidence=evidence, interval=(low, high)
    )
