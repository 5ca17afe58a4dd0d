"""Errors of a simulated robot beside a recorded one: pieces of a run, bands, noise, the table."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from turtlelog.compare.table import Cell, Column, Table
from turtlelog.display import describe_count, fit_line, format_html, format_notebook
from turtlelog.identify import AxisTraces
from turtlelog.measure.reductions import Rows, Values
from turtlelog.run import Clock, PoseColumns

SEEDS: Final = 39
"""Number of simulations of one motion. Another motion of the same kind lies between the smallest
and the largest of them in 38 of 40 cases, or 95 %."""

_CENTRAL: Final = (SEEDS - 1) / (SEEDS + 1)
"""Share of cases between the smallest and the largest simulation [1]."""

_CHANCE: Final = 1e-3
"""Probability below which few errors within the band are not chance [1]. For a robot with the right
noise, one of a thousand bands is judged wrongly."""

SHOWN_UNITS: Final = {"position": ("mm", 1e3), "heading": ("deg", 180.0 / np.pi)}
"""Unit and factor for showing the errors of a quantity; values are in m and rad."""

Quantity = Literal["position", "heading"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ErrorBand:
    """Recorded errors after a time, with the errors of simulations of the same pieces.

    An error is the magnitude of the difference between the pose and its prediction. The prediction
    is the simulation without noise that starts one horizon earlier at the recorded pose.

    Attributes:
        quantity: `position` [m] or `heading` [rad].
        horizon_s: Prediction time [s].
        time_s: End time of each piece, since the run's time zero [s], shape (n,).
        recorded: Recorded errors, shape (n,).
        simulated: Median of the simulated errors of each piece, shape (n,); None if the simulation
            has no noise.
        low: Smallest simulated error of each piece, shape (n,); None if the simulation has no
            noise.
        high: Largest simulated error of each piece, shape (n,); None if the simulation has no
            noise.
    """

    quantity: Quantity
    horizon_s: float
    time_s: Values
    recorded: Values
    simulated: Values | None = None
    low: Values | None = None
    high: Values | None = None

    @property
    def median(self) -> float:
        """Median of the recorded errors [m or rad]."""
        return float(np.median(self.recorded))

    @property
    def largest(self) -> float:
        """Largest recorded error [m or rad]."""
        return float(self.recorded.max())

    @property
    def largest_at_s(self) -> float:
        """Time of the largest recorded error, since the run's time zero [s]."""
        return float(self.time_s[int(self.recorded.argmax())])

    @property
    def simulated_median(self) -> float | None:
        """Median of the simulated medians [m or rad]; None without noise."""
        return None if self.simulated is None else float(np.median(self.simulated))

    @property
    def above(self) -> int | None:
        """Number of recorded errors above the central 95 % of the simulated ones."""
        return None if self.high is None else int(np.count_nonzero(self.recorded > self.high))

    @property
    def below(self) -> int | None:
        """Number of recorded errors below the central 95 % of the simulated ones."""
        return None if self.low is None else int(np.count_nonzero(self.recorded < self.low))

    @property
    def within_share(self) -> float | None:
        """Fraction of recorded errors in the central 95 % of simulated ones; None without noise."""
        if self.above is None or self.below is None:
            return None
        return 1.0 - (self.above + self.below) / len(self.recorded)

    @property
    def verdict(self) -> Literal["as simulated", "larger", "smaller", "no noise"]:
        """Whether the recorded errors agree with the simulation, or how they differ."""
        from scipy.special import bdtr

        if self.above is None or self.below is None:
            return "no noise"
        count = len(self.recorded)
        if bdtr(count - self.above - self.below, count, _CENTRAL) >= _CHANCE:
            return "as simulated"
        return "larger" if self.above >= self.below else "smaller"

    @property
    def text(self) -> str:
        """Meaning of the verdict, in a sentence."""
        head = f"{self.quantity.capitalize()} after {self.horizon_s:g} s: "
        count = len(self.recorded)
        if self.above is None or self.below is None:
            return f"{head}the scenario has no noise that acts on it, so there is no band."
        few, many = sorted((self.above, self.below))
        if self.verdict != "as simulated" and 2 * few >= many:
            # Noise of another level moves most errors to one side.
            return (
                f"{head}{self.below} of {count} errors are smaller and {self.above} larger than the"
                " central 95 % of simulated ones: no other level of noise explains them."
            )
        if self.verdict != "as simulated":
            means = "the scenario has more noise than the robot"
            if self.verdict == "larger":
                means = "the robot follows its commands otherwise than the scenario says, or with"
                means += " more noise"
            than = f"{self.verdict} than the central 95 % of simulated ones"
            return f"{head}{many} of {count} errors are {than}: {means}."
        return (
            f"{head}{count - self.above - self.below} of {count} errors lie within the central"
            " 95 % of simulated ones, as chance allows."
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ErrorGrowth:
    """Growth of the errors with the time since an anchor.

    Attributes:
        quantity: `position` [m] or `heading` [rad].
        since_s: Time since the anchor [s], shape (k,).
        recorded: Percentiles 2.5, 50 and 97.5 of the recorded errors of all pieces, shape (k, 3).
        simulated: The same percentiles of simulated errors over all pieces and seeds; None: without
            noise.
    """

    quantity: Quantity
    since_s: Values
    recorded: Values
    simulated: Values | None


Level = Literal["as simulated", "noisier", "quieter"]


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseLevel:
    """Noise of a recorded robot, compared with the noise of the simulated robot.

    Attributes:
        quantity: `position` or `heading`.
        after_s: Time over which motions are compared [s].
        ratio: Median recorded error divided by median simulated error [1].
        low: Lower end of the 95 % interval of the ratio over seeds [1].
        high: Upper end of the interval [1].
        level: `as simulated`, or how the noise differs.
    """

    quantity: Quantity
    after_s: float
    ratio: float
    low: float
    high: float
    level: Level

    @property
    def text(self) -> str:
        """Comparison of the noise with the scenario's noise, in a sentence; empty if they agree."""
        if self.level == "as simulated":
            return ""
        more = "more" if self.level == "noisier" else "less"
        return (
            f"Over {self.after_s:.2g} s, the {self.quantity} has {more} noise than the scenario:"
            f" {_round(self.ratio)} times as much ({_round(self.low)} to {_round(self.high)})."
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RobotComparison:
    """A recorded robot compared with a simulated one driven by the recorded commands.

    Attributes:
        name: Name of the run.
        scenario: Name of the scenario.
        seeds: Number of simulations of each motion; 0 if the scenario has no noise.
        clock: Clock of the poses; None if there is only one clock.
        bands: Errors of position and of heading by horizon.
        noise: Noise of position and heading compared with the simulation, if it is visible.
        growth: Growth of the errors of position and heading, over the pieces of the longest
            horizon.
        recorded: Recorded poses, n rows; the sensed poses if they are recorded.
        simulated: Poses of the simulation without noise at the same times, from the origin on, n
            rows. `predict_pieces` moves them to the pieces.
        begins: Row of the first pose of each piece of the longest horizon.
        ends: Row of the last pose of each piece.
        traces: Commanded, recorded and simulated (`modelled`) rates of both axes, in the log's
            time.
        start_s: The run's time zero on the log's clock [s].
        notes: Further notes, in sentences.
    """

    name: str
    scenario: str
    seeds: int
    clock: Clock | None = None
    bands: tuple[ErrorBand, ...]
    noise: tuple[NoiseLevel, ...] = ()
    growth: tuple[ErrorGrowth, ErrorGrowth]
    recorded: PoseColumns
    simulated: PoseColumns
    begins: NDArray[np.int64]
    ends: NDArray[np.int64]
    traces: tuple[AxisTraces, ...]
    start_s: float
    notes: tuple[str, ...] = ()

    def find_band(self, quantity: Quantity, horizon_s: float) -> ErrorBand:
        """Return the errors of a quantity after a time [s].

        Raises:
            KeyError: If there are no such errors.
        """
        for band in self.bands:
            if (band.quantity, band.horizon_s) == (quantity, horizon_s):
                return band
        raise KeyError(f"{quantity} after {horizon_s:g} s")

    def predict_pieces(self) -> Iterator[Values]:
        """Yield the predicted positions of each piece of the longest horizon [m], shape (m, 2).

        Each piece begins at its recorded pose.
        """
        for begin, end in zip(self.begins.tolist(), self.ends.tolist(), strict=True):
            turn_rad = self.recorded.heading_rad[begin] - self.simulated.heading_rad[begin]
            cosine, sine = np.cos(turn_rad), np.sin(turn_rad)
            moved_m = self.simulated.xy_m[begin : end + 1] - self.simulated.xy_m[begin]
            turned_m = moved_m @ np.array([[cosine, sine], [-sine, cosine]])
            yield self.recorded.xy_m[begin] + turned_m

    def __repr__(self) -> str:
        return fit_line(
            f"<RobotComparison of {self.name} with {self.scenario}: {self._describe()}>"
        )

    def _describe(self) -> str:
        told = ", ".join(
            f"{1e3 * band.median:.3g} mm after {band.horizon_s:g} s"
            for band in self.bands
            if band.quantity == "position"
        )
        return f"median error {told}"

    def _repr_html_(self) -> str:
        table = tabulate_robots([self])
        heads = tuple(column.title for column in table.columns)
        answer = f"{self.name} beside {self.scenario}: {self._describe()}"
        return format_notebook(answer, format_html(table.rows, heads=heads))


def tabulate_robots(found: Sequence[RobotComparison]) -> Table:
    """Return a table of the errors between recorded and simulated robots, with their meaning."""
    first = found[0]
    rows: list[tuple[Cell, ...]] = []
    notes, breaks = [], []
    for one in found:
        breaks += [len(rows)] if rows else []
        rows += [(one.name, *_list_cells(band)) for band in one.bands]
        before = f"{one.name}: " if len(found) > 1 else ""
        told = (*(level.text for level in one.noise), *(band.text for band in one.bands))
        notes += [before + text for text in (*filter(None, told), *one.notes)]
    seeds = f", {first.seeds} seeds" if first.seeds else ""
    return Table(
        title=(
            f"{describe_count(len(found), 'recorded robot')} beside {first.scenario}, driven with"
            f" the recorded commands{seeds}"
        ),
        columns=(
            *(Column(title=title) for title in ("run", "error", "unit")),
            Column(title="after", unit="s"),
            Column(title="pieces"),
            *(Column(title=title, digits=3) for title in ("median", "largest", "simulated")),
            Column(title="within", unit="%", digits=0),
            *(Column(title=title) for title in ("above", "below")),
        ),
        rows=tuple(rows),
        notes=tuple(notes),
        breaks=tuple(breaks),
    )


def _list_cells(band: ErrorBand) -> tuple[Cell, ...]:
    unit, factor = SHOWN_UNITS[band.quantity]
    simulated, share = band.simulated_median, band.within_share
    return (
        band.quantity,
        unit,
        band.horizon_s,
        len(band.recorded),
        factor * band.median,
        factor * band.largest,
        None if simulated is None else factor * simulated,
        None if share is None else 100.0 * share,
        band.above,
        band.below,
    )


_NOTED: Final = float(np.sqrt(2.0))
"""Boundary between equal noise and double or half noise, halfway in powers of two [1]. Noise
identified from 60 s is 0.85 to 1.25 times the true noise."""

_SURE: Final = 3.0
"""Student's t with 38 degrees of freedom that chance exceeds once in 200 cases [1]."""

_T_95: Final = 2.024
"""Student's t with 38 degrees of freedom that chance does not exceed in 95 of 100 cases [1]."""

_FEWEST: Final = 30
"""Smallest number of errors of a moving robot whose median is reported."""

_GROWN: Final = 2.0
"""Student's t that chance exceeds once in 20 cases: in doubt, nothing is reported [1]."""

_GROWTH: Final = 1.25
"""Growth of errors that shows a wrong model [1]. Doubled noise is doubled after any time. Between
0.1 s and 1 s, the error of a wrong model grows by ten, that of noise by three at most."""


def _round(ratio: float) -> str:
    """Return a ratio with two digits, without an exponent."""
    return f"{float(f'{ratio:.2g}'):g}"


def compare_noise(
    quantity: Quantity, after_s: float, short: tuple[Values, Values], long: tuple[Values, Values]
) -> NoiseLevel | None:
    """Return the noise level of a recorded robot; None if there are too few errors.

    `short` has the recorded errors after a time, shape (n,), and the simulated ones, shape (seeds,
    n); `long` has them after a time several times longer, at which a wrong model shows.
    """
    if len(short[0]) < _FEWEST or not len(long[0]):
        return None
    ratio, spread = _compare(*short)
    growth, growth_spread = _compare(*long, short)
    if not np.isfinite([ratio, spread, growth, growth_spread]).all() or spread == 0.0:
        return None
    level: Level = "as simulated"
    if abs(ratio) > np.log(_NOTED) and abs(ratio) > _SURE * spread:
        level = "noisier" if ratio > 0.0 else "quieter"
    if level == "noisier" and growth > max(np.log(_GROWTH), _GROWN * growth_spread):
        level = "as simulated"
    low, high = np.exp(ratio + np.array([-1.0, 1.0]) * _T_95 * spread)
    return NoiseLevel(
        quantity=quantity,
        after_s=after_s,
        ratio=float(np.exp(ratio)),
        low=float(low),
        high=float(high),
        level=level,
    )


def _compare(
    recorded: Values, simulated: Values, beside: tuple[Values, Values] | None = None
) -> tuple[float, float]:
    """Return the logarithm of the ratio of medians, and its standard deviation over seeds.

    With `beside`, the ratio is divided by the ratio of those errors.
    """
    with np.errstate(divide="ignore", invalid="ignore"):  # Without noise an error may be 0.
        one = np.log(np.median(recorded))
        each = np.log(np.median(simulated, axis=1))
        if beside is not None:
            one = one - np.log(np.median(beside[0]))
            each = each - np.log(np.median(beside[1], axis=1))
        # One more draw of the same kind differs from the mean of others by this.
        spread = each.std(ddof=1) * np.sqrt(1.0 + 1.0 / len(each))
        return float(one - each.mean()), float(spread)


_NEAR: Final = 0.1
"""Share of the horizon within which a pose must lie to end a piece. Errors grow by the same
share."""

_SPARSE: Final = 0.25
"""The same share for sparse poses, of which the nearest may be further away."""

_HALF_STEP: Final = 0.55
"""Largest distance of the nearest pose, relative to the usual time between poses: half, plus
jitter."""

_MOST_GROWTH: Final = 20
"""Number of points of the curve of errors over time."""


def cut_pieces(
    time_ns: Rows, known_ns: int, jumps: Rows, horizon_s: float
) -> tuple[Rows, int, int]:
    """Return first and last rows of pieces, shape (2, n), and the numbers of gaps and of jumps.

    Each piece begins where the previous one ends. Pieces with jumps are left out.
    """
    horizon_ns = round(horizon_s * 1e9)
    row, gaps = int(np.searchsorted(time_ns, known_ns)), 0
    begins, ends = [], []
    last = len(time_ns) - 1
    apart_ns = float(np.median(np.diff(time_ns))) if last else 0.0
    near_ns = min(max(_NEAR * horizon_ns, _HALF_STEP * apart_ns), _SPARSE * horizon_ns)
    while row < last and time_ns[last] - time_ns[row] >= horizon_ns - near_ns:
        wanted_ns = int(time_ns[row]) + horizon_ns
        after = min(int(np.searchsorted(time_ns, wanted_ns)), last)
        is_before = wanted_ns - time_ns[after - 1] < abs(time_ns[after] - wanted_ns)
        end = after - int(is_before)
        if end > row and abs(int(time_ns[end]) - wanted_ns) <= near_ns:
            begins.append(row)
            ends.append(end)
            row = end
        else:
            gaps += 1
            row = after if after > row else row + 1
    cut = np.array([begins, ends], dtype=np.int64).reshape(2, -1)
    inside = np.diff(np.searchsorted(jumps, cut, side="right"), axis=0)[0]
    return cut[:, inside == 0], gaps, int(np.count_nonzero(inside))


def list_growth_rows(time_ns: Rows, cut: Rows, horizon_s: float) -> Rows:
    """Return rows at equal times after each beginning, shape (pieces, points)."""
    usual_s = float(np.median(np.diff(time_ns))) / 1e9
    points = max(min(_MOST_GROWTH, int(horizon_s / (2.0 * usual_s))), 1)
    share = np.arange(points + 1) / points
    wanted_ns = time_ns[cut[0]][:, None] + np.rint(share * horizon_s * 1e9).astype(np.int64)
    after = np.clip(np.searchsorted(time_ns, wanted_ns), 1, len(time_ns) - 1)
    is_before = wanted_ns - time_ns[after - 1] < time_ns[after] - wanted_ns
    rows = np.clip(after - is_before, cut[0][:, None], cut[1][:, None])
    rows[:, 0] = cut[0]
    return np.asarray(rows)
