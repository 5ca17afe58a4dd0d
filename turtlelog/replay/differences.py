"""Differences of a run from a reference: signals paired row by row, and numbers of rows."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import fit_line, format_html, format_notebook, show_angle
from turtlelog.errors import ReplayError
from turtlelog.plants import find_plant
from turtlelog.run import PoseColumns, Run, SampleColumns
from turtlelog.run.angles import wrap_angle
from turtlelog.run.loops import Declaration
from turtlelog.run.stop_reasons import FROM_OUTSIDE

Value = float | int | str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Difference:
    """A value of the reference, and the value of a replay or another run in its place.

    Attributes:
        signal: Name of the signal.
        time_ns: Time of the values [ns]: on the recording's clock for a replay, on the common clock
            for two runs.
        recorded: Value of the reference, in the unit of the signal. A phase or stop reason is given
            by name, a declaration in words. None: no value.
        replayed: Value of the replay or the other run, in the same form.
    """

    signal: str
    time_ns: int
    recorded: Value
    replayed: Value


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalDifference:
    """Difference of a signal from the reference, over all rows.

    Attributes:
        signal: Name of the signal.
        unit: Unit of the values.
        rows: Number of compared rows.
        differing: Number of rows that differ by more than the limit, or have a value on one side
            only.
        largest: Largest magnitude of a difference, in `unit`; 1 for a label that differs. If limits
            differ from row to row, the difference in the row with the smallest margin.
        limit: Largest tolerated difference in that row, in `unit`.
        largest_difference: First row of the largest difference; None if the largest difference is
            0.
        first_difference: First row beyond its limit; None if no row is beyond its limit.
    """

    signal: str
    unit: str
    rows: int
    differing: int
    largest: float
    limit: float
    largest_difference: Difference | None
    first_difference: Difference | None

    @property
    def at_ns(self) -> int | None:
        """Time at which the largest difference is first reached [ns]; None if all are equal."""
        return None if self.largest_difference is None else self.largest_difference.time_ns

    @property
    def at_s(self) -> float | None:
        """Time at which the largest difference is first reached [s]."""
        return None if self.at_ns is None else self.at_ns / 1e9


@dataclass(frozen=True, slots=True, eq=False)
class Pairing:
    """Recorded and replayed values of a signal, row by row; NaN: no value.

    The time is that of the recording's clock and does not decrease. Differences of angles are in
    [-pi, pi); labels are names that are equal or not.
    """

    signal: str
    unit: str
    time_ns: NDArray[np.int64]
    recorded: NDArray[np.float64] | NDArray[np.int64] | NDArray[np.str_]
    replayed: NDArray[np.float64] | NDArray[np.int64] | NDArray[np.str_]
    kind: Literal["number", "angle", "label"] = "number"


def compare_pairing(pairing: Pairing, *, tolerance: float) -> SignalDifference:
    """Return the difference of a signal's rows. Unequal labels differ at any tolerance."""
    recorded, replayed = pairing.recorded, pairing.replayed
    if pairing.kind == "label":
        apart, is_one_sided = np.not_equal(recorded, replayed).astype(np.float64), np.False_
    else:
        missing = np.isnan(recorded), np.isnan(replayed)
        is_one_sided = missing[0] != missing[1]
        with np.errstate(over="ignore", invalid="ignore"):
            apart = np.subtract(replayed, recorded, dtype=np.float64)
            apart = np.abs(wrap_angle(apart) if pairing.kind == "angle" else apart)
        apart = np.where(missing[0] | missing[1], 0.0, apart)
    limit = 0.0 if pairing.kind == "label" else tolerance
    # What is not within: nan, which a difference beyond the largest number may be, is none.
    outside = ~(apart <= limit) | is_one_sided
    row = int(apart.argmax()) if len(apart) else 0
    largest = float(apart[row]) if len(apart) else 0.0
    return SignalDifference(
        signal=pairing.signal,
        unit=pairing.unit,
        rows=len(apart),
        differing=int(outside.sum()),
        largest=largest,
        limit=limit,
        largest_difference=_read_row(pairing, row) if largest else None,
        first_difference=_read_row(pairing, int(outside.argmax())) if outside.any() else None,
    )


def compare_pairings(pairings: Iterable[Pairing], tolerance: float) -> tuple[SignalDifference, ...]:
    """Return the differences of several signals."""
    return tuple(compare_pairing(one, tolerance=tolerance) for one in pairings)


def find_earliest(differences: Iterable[Difference | None]) -> Difference | None:
    """Return the earliest difference; of several at one time, the difference named first."""
    found = [difference for difference in differences if difference]
    return min(found, key=lambda difference: difference.time_ns, default=None)


def require_tolerance(tolerance: float) -> None:
    """Refuse an invalid tolerance."""
    if not 0.0 <= tolerance < float("inf"):
        raise ReplayError(f"tolerance: expected a finite number >= 0, found {tolerance}")


def _read_row(pairing: Pairing, row: int) -> Difference:
    values = (pairing.recorded[row].item(), pairing.replayed[row].item())
    # A NaN, which no other value equals, is no value.
    was, now = (value if value == value else None for value in values)  # noqa: PLR0124
    time_ns = int(pairing.time_ns[row])
    return Difference(signal=pairing.signal, time_ns=time_ns, recorded=was, replayed=now)


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseError:
    """Largest magnitudes of the differences between replayed and recorded poses."""

    x_m: float = 0.0
    y_m: float = 0.0
    heading_rad: float = 0.0


def find_pose_error(signals: Iterable[SignalDifference]) -> PoseError:
    """Return the largest differences of x, y and heading."""
    largest = {found.signal: found.largest for found in signals}
    return PoseError(x_m=largest["x"], y_m=largest["y"], heading_rad=largest["heading"])


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantStretch:
    """A part of the recording without a jump or gap, replayed from its first recorded pose.

    Attributes:
        start_ns: Time of the first pose [ns].
        end_ns: Time of the last pose [ns].
        ticks: Number of replayed steps.
        max_abs_error: Largest difference of the poses.
        signals: x, y [m] and heading [rad], with the differences that rounding explains as their
            limits.
        rounding_m: Largest error from 32-bit rounding of the first pose, and of velocities used as
            commands, along the distance driven [m]. The plant's own state has double precision and
            is not recorded. For a robot model, whose start is known, the error is one 32-bit step
            at the largest coordinate.
        rounding_rad: The same for the heading [rad].
    """

    start_ns: int
    end_ns: int
    ticks: int
    max_abs_error: PoseError
    signals: tuple[SignalDifference, ...]
    rounding_m: float
    rounding_rad: float

    @property
    def first_difference(self) -> Difference | None:
        """First difference that rounding does not explain; None if rounding explains all."""
        return find_earliest(found.first_difference for found in self.signals)

    @property
    def within_rounding(self) -> bool:
        """Whether rounding explains all differences."""
        return self.first_difference is None

    @property
    def of_rounding(self) -> float:
        """Largest difference, relative to the one that rounding explains [1]; inf for 0."""
        error, bounds = self.max_abs_error, (self.rounding_m, self.rounding_rad)
        pairs = zip((max(error.x_m, error.y_m), error.heading_rad), bounds, strict=True)
        return max((one / most if most else float("inf") for one, most in pairs if one), default=0)


class ReplayResult:
    """How a console and a notebook show a replay: its result and the signals that differ."""

    __slots__ = ()

    def _describe(self: Any) -> str:
        first: Difference | None = self.first_difference
        found = "no difference" if first is None else f"first differs in {first.signal}"
        return f"{self.samples} compared, {found}"

    def __repr__(self: Any) -> str:
        return fit_line(f"<{type(self).__name__} of {self.name}: {self._describe()}>")

    def _repr_html_(self: Any) -> str:
        rows = [
            (one.signal, *show_angle(one.largest, one.unit)[::-1], one.differing, one.rows)
            for one in self.signals
            if one.differing
        ]
        heads = ("signal", "unit", "largest difference", "rows that differ", "of")
        table = format_html(rows, heads=heads) if rows else ""
        return format_notebook(f"{self.name}: {self._describe()}.", table)


Rows = NDArray[np.int64]

SENSED: Final = ("sensed_x", "sensed_y", "sensed_heading")
"""Signals of sensed poses."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RowCount:
    """Numbers of rows of one kind in a recording and in its replay."""

    recorded: int
    replayed: int


def has_ticks(run: Run) -> bool:
    """Return whether a run contains its poses tick by tick, like a simulation."""
    is_whole = not (run.poses.time_ns % find_plant(run).period_ns).any()
    return run.poses.speed_m_s is not None and is_whole


def pair_by_tick(run: Run, replayed: Run) -> Iterator[Pairing]:
    """Yield signals of poses matched by time of tick, samples by number, commands by order."""
    _, rows, others = np.intersect1d(
        run.poses.time_ns, replayed.poses.time_ns, assume_unique=True, return_indices=True
    )
    time_ns = run.poses.time_ns[rows]
    yield from _pair_poses(run.poses, replayed.poses, time_ns, rows, others)
    for name, unit, column in (
        ("applied_speed", "m/s", "speed_m_s"),
        ("applied_turn_rate", "rad/s", "turn_rate_rad_s"),
    ):
        was, now = getattr(run.poses, column), getattr(replayed.poses, column)
        if was is not None and now is not None:
            yield Pairing(name, unit, time_ns, was[rows], now[others])
    if len(run.samples):
        rows, others = _match_samples(run, replayed)
        yield from _pair_answers(run, replayed, rows, others)
        time_ns, again_ns = run.samples.time_ns[rows], replayed.samples.time_ns[others]
        yield Pairing("sample_time", "s", time_ns, time_ns / 1e9, again_ns / 1e9)
        read, read_again = (  # the number of the tick whose pose each sample read
            one.poses.time_ns[one.samples.pose_sequence] // find_plant(one).period_ns
            for one in (run, replayed)
        )
        yield Pairing("pose_read", "tick", time_ns, read[rows], read_again[others])
    if not len(run.commands) or not has_all_commands(run):
        return
    old, new = run.commands, replayed.commands
    count = min(len(old), len(new))
    time_ns, again_ns = old.time_ns[:count], new.time_ns[:count]
    yield Pairing("command_time", "s", time_ns, time_ns / 1e9, again_ns / 1e9)
    for name, (unit, column) in _OF_COMMANDS.items():
        was, now = (getattr(one, column)[:count] for one in (old, new))
        yield Pairing(name, unit, time_ns, was, now)


def pair_by_sample(run: Run, replayed: Run) -> Iterator[Pairing]:
    """Yield signals of samples and of the poses that they read, matched by the sample's number."""
    rows, others = _match_samples(run, replayed)
    read = run.samples.pose_sequence[rows], replayed.samples.pose_sequence[others]
    yield from _pair_poses(run.poses, replayed.poses, run.samples.time_ns[rows], *read)
    yield from _pair_answers(run, replayed, rows, others)


def _pair_answers(run: Run, replayed: Run, rows: Rows, others: Rows) -> Iterator[Pairing]:
    was, now = (Answers(one.samples, one.declaration) for one in (run, replayed))
    return pair_samples(was, now, rows=rows, others=others)


def count_recorded_rows(run: Run, replayed: Run, *, by_tick: bool) -> dict[str, RowCount]:
    """Return the number of rows of each kind that is recorded."""
    kinds = ("samples", "poses", "commands") if by_tick else ("samples",)
    return {
        name: RowCount(recorded=count, replayed=len(getattr(replayed, name)))
        for name in kinds
        if (count := len(getattr(run, name)))
    }


def find_count_difference(run: Run, name: str, count: RowCount) -> Difference | None:
    """Return the difference of two counts; lost rows or a truncated recording explain fewer."""
    if count.recorded == count.replayed:
        return None
    was, now, ticks = count.recorded, count.replayed, run.poses.time_ns // find_plant(run).period_ns
    has_holes = count_missing_samples(run.samples) > 0
    has_holes |= has_ticks(run) and int(ticks[-1]) + 1 != len(run.poses)
    if was < now and (run.stop_reason in FROM_OUTSIDE or has_holes):
        return None
    return Difference(signal=name, time_ns=run.end_ns, recorded=was, replayed=now)


def _match_samples(run: Run, replayed: Run) -> tuple[Rows, Rows]:
    numbers = run.samples.sequence
    rows = np.flatnonzero((numbers >= 0) & (numbers < len(replayed.samples)))
    return rows, numbers[rows]


def _pair_poses(
    recorded: PoseColumns, replayed: PoseColumns, time_ns: Rows, rows: Rows, others: Rows
) -> Iterator[Pairing]:
    """Yield the poses, and the sensed ones if both runs have a sensor; NaN: a lost pose."""
    for names, xy, heading in (
        (("x", "y", "heading"), "xy_m", "heading_rad"),
        (SENSED, "sensed_xy_m", "sensed_heading_rad"),
    ):
        was, now = ((getattr(one, xy), getattr(one, heading)) for one in (recorded, replayed))
        if was[0] is None or now[0] is None:
            continue
        for axis, name in enumerate(names[:2]):
            yield Pairing(name, "m", time_ns, was[0][rows, axis], now[0][others, axis])
        yield Pairing(names[2], "rad", time_ns, was[1][rows], now[1][others], "angle")


_Read = Callable[[SampleColumns], NDArray[np.float64] | None]


def _take(columns: NDArray[np.float64] | None, row: int) -> NDArray[np.float64] | None:
    return None if columns is None else columns[:, row]


_NUMBERS: Final[Mapping[str, tuple[str, _Read]]] = {
    "wanted_speed": ("m/s", lambda samples: samples.wanted_speed_m_s),
    "wanted_turn_rate": ("rad/s", lambda samples: samples.wanted_turn_rate_rad_s),
    "shaped_speed": ("m/s", lambda samples: samples.shaped_speed_m_s),
    "shaped_turn_rate": ("rad/s", lambda samples: samples.shaped_turn_rate_rad_s),
    "speed": ("m/s", lambda samples: samples.speed_m_s),
    "turn_rate": ("rad/s", lambda samples: samples.turn_rate_rad_s),
    "bearing": ("rad", lambda samples: samples.bearing_rad),
    "heading_error": ("rad", lambda samples: samples.heading_error_rad),
    "error_x": ("m", lambda samples: _take(samples.error_xy_m, 0)),
    "error_y": ("m", lambda samples: _take(samples.error_xy_m, 1)),
    "distance": ("m", lambda samples: samples.distance_m),
    "world_v_x": ("m/s", lambda samples: _take(samples.world_velocity_m_s, 0)),
    "world_v_y": ("m/s", lambda samples: _take(samples.world_velocity_m_s, 1)),
    "reference_x": ("m", lambda samples: _take(samples.reference_xy_m, 0)),
    "reference_y": ("m", lambda samples: _take(samples.reference_xy_m, 1)),
    "reference_heading": ("rad", lambda samples: samples.reference_heading_rad),
}
"""Numbers that a controller computes, by name: commands first, then errors."""

_ANGLES: Final = frozenset({"bearing", "reference_heading"})
"""Signals whose values differ by less than half a turn."""

_OF_COMMANDS: Final = {
    "command_speed": ("m/s", "speed_m_s"),
    "command_lateral_speed": ("m/s", "lateral_speed_m_s"),
    "command_turn_rate": ("rad/s", "turn_rate_rad_s"),
}
"""Unit and column of each signal of the published commands."""

PUBLISHED: Final = tuple(_OF_COMMANDS)

COMMANDS: Final = ("speed", "turn_rate", *PUBLISHED)
"""Signals of the controller's output: commands in the samples, and published commands."""


class Answers(NamedTuple):
    """Samples, with the declaration that names their phases and states."""

    samples: SampleColumns
    declaration: Declaration


def pair_samples(
    recorded: Answers, replayed: Answers, *, rows: Rows | slice, others: Rows | slice
) -> Iterator[Pairing]:
    """Yield the signals in both runs; `rows` of one run are paired with `others` of the other."""
    time_ns = recorded.samples.time_ns[rows]
    were, are = _read_numbers(recorded), _read_numbers(replayed)
    for name, (unit, was) in were.items():
        if name in are:
            kind: Literal["angle", "number"] = "angle" if name in _ANGLES else "number"
            yield Pairing(name, unit, time_ns, was[rows], are[name][1][others], kind)
    sides = (recorded, replayed)
    was, now = (np.array(one.declaration.phase_names)[one.samples.phase] for one in sides)
    yield Pairing("phase", "1", time_ns, was[rows], now[others], kind="label")


def _read_numbers(answers: Answers) -> dict[str, tuple[str, NDArray[np.float64]]]:
    """Return unit and column of each existing signal, with states by their names."""
    samples, names = answers
    found = {name: (unit, read(samples)) for name, (unit, read) in _NUMBERS.items()}
    for row, name in enumerate(names.states):
        found[name] = (names.state_units.get(name, "1"), _take(samples.states, row))
    return {name: (unit, column) for name, (unit, column) in found.items() if column is not None}


def pair_published(run: Run, answers: SampleColumns) -> Iterator[Pairing]:
    """Yield the n-th published command paired with the answer of sample n, if they match."""
    if not has_published(run):
        return
    commands, numbers = run.commands, run.samples.sequence[: len(answers)]
    rows = np.flatnonzero(numbers < len(commands))
    published, none = numbers[rows], np.zeros(len(answers))
    for name, (unit, column) in _OF_COMMANDS.items():
        # No law moves sideways: answers have no such column.
        was, now = getattr(commands, column), getattr(answers, column, none)
        yield Pairing(name, unit, commands.time_ns[published], was[published], now[rows])


def has_published(run: Run) -> bool:
    """Return whether there is one command per sample, lost or not; the last may be missing."""
    count = int(run.samples.sequence[-1]) + 1
    return count - 1 <= len(run.commands) <= count


def list_unrecorded(recorded: Answers, replayed: Answers) -> tuple[str, ...]:
    """Return the names of the signals that a replay has and its recording does not have."""
    held = _read_numbers(recorded)
    return tuple(name for name in _read_numbers(replayed) if name not in held)


def count_missing_samples(samples: SampleColumns) -> int:
    """Return how many samples before the last one are missing, by their numbers from 0."""
    return int(samples.sequence[-1]) + 1 - len(samples) if len(samples) else 0


def has_all_commands(run: Run) -> bool:
    """Return whether the n-th command belongs to the n-th sample; the last may be missing."""
    is_whole = not count_missing_samples(run.samples)
    return not len(run.samples) or (is_whole and has_published(run))
