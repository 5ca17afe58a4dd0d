"""The fit of one command: the gain from unclipped commands, the limit from clipped commands."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import describe_count
from turtlelog.explain.scenario_from_log import (
    Finding,
    bound_value,
    find_exactly,
    fit_value,
    miss,
)
from turtlelog.explain.scenario_from_log.trace import estimate_trace_noise, find_pose_resolution
from turtlelog.measure.motion import measure_whiteness

Values = NDArray[np.float64]

DIGITS: Final = 17
"""Significant digits that distinguish all doubles."""

_ROUNDING: Final = 1e-13
"""Difference of commands between platforms, as a share of the largest command: the last bits of a
cosine, 2e-16 each, times the few operations that follow."""

_TYPED_DIGITS: Final = 8
"""Largest number of digits of a typed gain. Two commands fit many gains, so that a gain with few
digits is required."""

_NEIGHBOURS: Final = 16
"""Number of doubles on either side of a ratio that rounding may reach: a ratio of two products with
three roundings each is wrong by a few doubles."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GainFit:
    """A gain estimated from commands.

    Attributes:
        value: Shortest decimal that reproduces every command, or else the least-squares value.
        is_exact: Whether only this value reproduces every command, bit for bit.
        is_close: Whether several doubles do, or the value does within the rounding of platforms.
        interval: All values that reproduce the commands, or else the 95 % interval.
        noise: Standard deviation of the residual error, in the error's unit.
        whiteness: Mean square of the changes of the residual, divided by twice its mean square: 1
            for noise, near 0 for a curve.
        rows: Number of commands used.
    """

    value: float
    is_exact: bool = False
    is_close: bool = False
    interval: tuple[float, float]
    noise: float = 0.0
    whiteness: float = 1.0
    rows: int


def fit_gain(command: Values, reproduce: Callable[[float], Values]) -> GainFit:
    """Return the gain with which `reproduce` gives the commands; both have shape (n,), n >= 1."""
    error = reproduce(1.0)
    return _find_exact_gain(command, reproduce, error) or _fit_least_squares(command, error)


def _find_exact_gain(
    command: Values, reproduce: Callable[[float], Values], error: Values
) -> GainFit | None:
    largest = int(np.abs(error).argmax())
    if error[largest] == 0.0:
        return None
    ratio = float(command[largest] / error[largest])
    slack = _ROUNDING * float(np.abs(command).max())
    if (np.abs(reproduce(ratio) - command) > slack).any():
        return None
    digits = DIGITS if len(np.unique(error)) > 2 else _TYPED_DIGITS
    decimals = [float(f"{ratio:.{count}g}") for count in range(1, digits + 1)]
    near = [ratio + step * math.ulp(ratio) for step in range(-_NEIGHBOURS, _NEIGHBOURS + 1)]
    fitting = [gain for gain in {*decimals, *near} if np.array_equal(reproduce(gain), command)]
    typed = [gain for gain in decimals if gain in fitting]
    if digits < DIGITS and not typed:
        return None
    apart = _ROUNDING * abs(ratio)
    low, high = (min(fitting), max(fitting)) if fitting else (ratio - apart, ratio + apart)
    inside = typed or fitting or [gain for gain in decimals if low <= gain <= high]
    return GainFit(
        value=[*inside, ratio][0],
        is_exact=len(fitting) == 1,
        is_close=len(fitting) != 1,
        interval=(low, high),
        rows=len(command),
    )


def _fit_least_squares(command: Values, error: Values) -> GainFit:
    """Regress the errors on the commands, which are exact: the inverse makes gains too small."""
    slope, reach, noise, whiteness = _fit_slope(command, error)
    is_clear = slope > reach
    return GainFit(
        value=1.0 / slope if slope else 0.0,
        # The interval of the gain is that of the slope, inverted.
        interval=(1.0 / (slope + reach), 1.0 / (slope - reach)) if is_clear else (0.0, math.inf),
        noise=noise,
        whiteness=whiteness,
        rows=len(command),
    )


def _fit_slope(exact: Values, noisy: Values) -> tuple[float, float, float, float]:
    """Regress noisy values on exact ones.

    The result is a slope through 0, half of its 95 % interval, and size and whiteness of the
    residual.
    """
    square, rows = float(exact @ exact), len(exact)
    slope = float(noisy @ exact) / square if square > 0.0 else 0.0
    left = noisy - slope * exact
    noise = float(np.sqrt(left @ left / max(rows - 1, 1)))
    whiteness = float(measure_whiteness(left, fitted=1)) if rows > 1 else 1.0
    spread = noise / math.sqrt(square) if square > 0.0 else math.inf
    reach = find_quantile(rows) * spread * float(widen_for_runs(np.asarray(whiteness)))
    return slope, reach, noise, whiteness


def find_quantile(rows: int) -> float:
    """Return the half-width of a 95 % interval in standard errors."""
    from scipy.special import stdtrit

    return float(stdtrit(max(rows - 1, 1), 0.975))


def widen_for_runs(whiteness: Values) -> Values:
    """Return the factor by which autocorrelated errors widen an interval."""
    alike = np.clip(1.0 - whiteness, 0.0, 0.99)
    return np.asarray(np.sqrt((1.0 + alike) / (1.0 - alike)))


Reproduce = Callable[[float], Values]
"""Function from a gain to the commands that the law wants."""

_FEWEST: Final = 8
"""Smallest number of commands that distinguishes noise from a curve. With fewer commands, the
whiteness of noise may be as small as that of a curve."""

_WHITE: Final = 0.4
"""Largest deviation of noise's whiteness from 1. Residuals of an integral, a derivative or a bend
are smooth, with a whiteness below 0.1; residuals of a switch alternate, with up to 2."""

_WHITE_SURE: Final = 4.0
"""The same deviation in standard deviations, which are 1 / sqrt(rows). One of 16,000 logs exceeds
it."""

_LARGER: Final = 2.0
"""Largest residual as a multiple of the poses' noise. With 8 rows, 2 is four standard deviations of
an estimate; with more rows, it is more."""

_BEYOND: Final = 5.0
"""Change of the error during equal commands that shows clipping, in standard deviations. Noise
alone reaches this change in one of a million logs."""

_TINY: Final = 1e-9

_CLEAN: Final = 10.0
"""Noise of the poses that the controller read, as a multiple of the noise of the logged poses,
above which these differ."""

_ALTERNATES: Final = 0.25
"""Largest excess over 1 of the whiteness of read noise; a derivative's whiteness is 1.5. With 34
rows, which a gain of 10 leaves unclipped, noise exceeds this limit in one of fourteen logs."""

_CLEAR: Final = 4.0
"""Distance from the limit beyond which hardly any command is clipped, in standard deviations of
noise."""

_REFITS: Final = 3  # number of rounds until gain and rows converge


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseNoise:
    """Noise of the logged poses [m or rad].

    Attributes:
        size: Standard deviation, with the curvature of the motion between rows.
        least: The same from fourth differences, which contain almost none of the motion.
        grain: Quantisation step of the log.
    """

    size: float
    least: float
    grain: float


def measure_pose_noise(values: Values) -> PoseNoise:
    """Return the noise of logged coordinates, shape (n, axes)."""
    return PoseNoise(
        size=estimate_trace_noise(values),
        least=estimate_trace_noise(values, order=4),
        grain=max(find_pose_resolution(column) for column in values.T),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandFit:
    """Gain and limit of one command.

    Attributes:
        gain: Fitted gain; None if all commands are clipped, or the error never changes.
        limit: Limit at which commands are clipped; None if no command is clipped.
        least: Smallest gain that explains every command, if there is no fitted gain.
        largest: Largest published magnitude.
        rows: Number of commands in the phase.
        noise: Noise of the poses.
        has_signs: Whether every command has the sign of its error.
        is_read: Whether the noise is in the poses that the controller read instead of the log.
    """

    gain: GainFit | None
    limit: float | None
    least: float = 0.0
    largest: float
    rows: int
    noise: PoseNoise
    has_signs: bool
    is_read: bool = False

    @property
    def is_certain(self) -> bool:
        """Whether the commands follow the logged errors bit for bit."""
        return self.gain is not None and (self.gain.is_exact or self.gain.is_close)

    @property
    def obstacle(self) -> str | None:
        """Why the commands are not proportional to the error; None if they may be proportional."""
        found = self.gain
        if found is None:
            return None
        if not found.value > 0.0:
            return f"the commands are not proportional: their gain would be {found.value:.4g}"
        if self.is_certain:
            return None
        if found.rows < _FEWEST:
            return f"{found.rows} unclipped commands cannot tell noise from another law"
        reach = max(_WHITE, _WHITE_SURE / math.sqrt(found.rows))
        is_pattern = abs(found.whiteness - 1.0) > reach and found.noise > self.noise.grain
        leaves = ""
        if is_pattern:
            leaves = f"a pattern of {found.noise:.2g} and no noise"
        elif not self.is_read and found.noise > _LARGER * max(self.noise.size, self.noise.grain):
            leaves = f"{found.noise:.2g}, more than the poses have of noise"
        reason = "the commands are not proportional to the error of the logged poses"
        return f"{reason}: a gain of {found.value:.4g} leaves {leaves}" if leaves else None


def fit_command(command: Values, reproduce: Reproduce, noise: PoseNoise) -> CommandFit:
    """Find the clipped commands, and fit a gain to the other commands."""
    size, error = np.abs(command), reproduce(1.0)
    largest = float(size.max())
    below = size < largest
    has_signs = bool((error * command > 0.0).all())
    known: dict[str, Any] = {"largest": largest, "noise": noise, "has_signs": has_signs}
    known["rows"] = len(command)
    whole = fit_gain(command, reproduce)
    if (whole.is_exact or whole.is_close) and np.ptp(error) > 0.0:
        return CommandFit(gain=whole, limit=None, **known)
    if not below.any():
        least = largest / max(float(np.abs(error).min()), _TINY)
        return CommandFit(gain=None, limit=None, least=least, **known)
    fit = fit_gain(command[below], lambda gain: reproduce(gain)[below])
    if fit.is_exact or fit.is_close:
        is_clipped = bool((np.abs(reproduce(fit.value))[~below] >= largest).all())
    else:
        fit = _fit_noisy(command, error, below)
        # The error changes during equal commands by more than its noise.
        clipped, third = error[~below], int((~below).sum()) // 3
        change = abs(clipped[:third].mean() - clipped[-third:].mean()) if third else 0.0
        is_clipped = bool(third and change > _BEYOND * fit.noise * math.sqrt(2.0 / third))
    # White noise that the logged poses do not contain: the controller read other poses. With a
    # derivative, noisy poses also leave a larger residual, but its noise alternates.
    is_white = 1.0 - _WHITE < fit.whiteness < 1.0 + _ALTERNATES
    own = max(
        _LARGER * noise.size, _LARGER * noise.grain, _CLEAN * noise.least, _CLEAN * noise.grain
    )
    if is_white and fit.noise > own:
        limit = largest if is_clipped else None
        read = _fit_read(command, error, fit, limit or math.inf)
        return CommandFit(gain=read, limit=limit, is_read=True, **known)
    if is_clipped:
        return CommandFit(gain=fit, limit=largest, **known)
    every = _fit_noisy(command, error, np.ones_like(below))
    return CommandFit(gain=every, limit=None, **known)


def _fit_noisy(command: Values, error: Values, rows: NDArray[np.bool_]) -> GainFit:
    """Fit commands by least squares. Equal successive commands count once: rounding repeats."""
    first = np.flatnonzero(np.diff(command[rows], prepend=np.nan) != 0.0)
    means = np.add.reduceat(error[rows], first) / np.diff(np.append(first, rows.sum()))
    return fit_gain(command[rows][first], lambda gain: gain * means)


def _fit_read(command: Values, error: Values, fit: GainFit, limit: float) -> GainFit:
    """Regress the commands on the logged errors: noise in the read poses is in the commands.

    Rows are selected by their errors. A selection by commands would bias the fit, because noise
    keeps some commands off the limit.
    """
    found = fit
    for _ in range(_REFITS):
        rows = np.abs(error) < limit / abs(found.value) - _CLEAR * fit.noise
        if int(rows.sum()) < _FEWEST:
            break
        # The noise of the commands is independent of earlier errors.
        gain, reach, noise, whiteness = _fit_slope(error[rows], command[rows])
        found = GainFit(
            value=gain,
            interval=(gain - reach, gain + reach),
            noise=noise / abs(gain) if gain else math.inf,
            whiteness=whiteness,
            rows=int(rows.sum()),
        )
    return found


def describe_fitted_gain(fit: CommandFit) -> Finding:
    """Return the gain in words, or how far the commands determine it and why not further."""
    if fit.gain is None:
        return miss(
            f"all {fit.rows} commands are at {fit.largest:g}: at least {fit.least:.4g}",
            max(1.0, math.ceil(fit.least * 1.001)),
            (fit.least, math.inf),
        )
    if fit.obstacle:
        return miss(fit.obstacle, max(fit.gain.value, _TINY))
    found = fit.gain
    shown = f"reproduces {describe_count(found.rows, 'unclipped command')}"
    if found.is_exact:
        return find_exactly(found.value, shown)
    if found.is_close:
        return bound_value(found.value, f"{shown} to rounding", found.interval)
    return fit_value(found.value, f"least squares of {found.rows}, 95 %", found.interval)


def describe_limit(fit: CommandFit) -> Finding:
    """Return the limit in words, or the largest command if no command is clipped."""
    if fit.gain is None:
        reason = f"all {fit.rows} commands are at {fit.largest:g}: a limit, or the law's only one"
        return miss(reason, fit.largest)
    if fit.limit is None:
        return miss(f"no command is clipped; the largest is {fit.largest:.4g}", math.inf)
    clipped = int(fit.rows - fit.gain.rows)
    return find_exactly(fit.limit, f"{clipped} of {fit.rows} commands are there")


def compute_gain_misfit(fit: CommandFit, command: Values, error: Values) -> float:
    """Return the root mean square of the residual of a fit, including clipped commands."""
    gain = math.inf if fit.gain is None else max(fit.gain.value, 0.0)
    limit = fit.largest if fit.gain is None else (fit.limit or math.inf)
    with np.errstate(invalid="ignore"):
        wanted = np.clip(np.nan_to_num(gain * error), -limit, limit)
    return float(np.sqrt(np.mean((wanted - command) ** 2)))
