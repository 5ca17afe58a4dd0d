"""Comparison of two trajectories: the errors of one relative to the other (ATE and RPE)."""

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from turtlelog.compare import trajectory_errors
from turtlelog.compare.table import Cell, Column, Table
from turtlelog.compare.trajectory_errors import Alignment, DeltaUnit, ErrorStatistics, PoseErrors
from turtlelog.display import describe_count, fit_line, format_short, join_words
from turtlelog.errors import CompareError, suggest_names
from turtlelog.measure.breaks import find_gap_rows
from turtlelog.run.angles import Trajectory

AlignIn = Literal["none", "origin", "se2", "se3", "sim2", "sim3"]
ALIGN_IN: Final[tuple[AlignIn, ...]] = get_args(AlignIn)

LEAST_POSES: Final = 3
"""Smallest number of associated poses for an error: a turn and a scale align any two poses."""

_MOST_RMSE: Final = 0.5
"""Largest RMSE, as a share of the spread of the reference about its middle. Above this share, the
alignment explains less than three quarters of the variance: the two trajectories hardly have the
same shape and size."""

_LEAST_SHARE: Final = 0.5
"""Share of the shorter trajectory's poses below which a note says that most have no partner."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Delta:
    """Length of the relative motions for the RPE."""

    value: float
    unit: DeltaUnit

    def __str__(self) -> str:
        unit = "frame" if (self.value, self.unit) == (1.0, "frames") else self.unit
        return f"{self.value:g} {unit}"


@dataclass(frozen=True, slots=True, kw_only=True)
class TrajectorySettings:
    """Settings for comparing two trajectories.

    Attributes:
        align: Fitted transformation of the estimate: none; that of the first poses (origin); a
            rotation and translation in the plane (se2) or in space (se3); with a scale (sim2,
            sim3). Default: se3 if both trajectories are in space and one leaves the horizontal
            plane, otherwise se2.
        interpolates: Whether the trajectory with more poses is interpolated at the times of the
            other. Otherwise each pose is paired with the nearest in time.
        most_apart_s: Largest time difference between associated poses [s].
        offset_s: Offset added to the times of the estimate [s]. None: the first poses of both get
            the same time.
        deltas: Lengths of relative motions for the RPE, along the reference.
        overlaps: Whether a relative motion begins at every pose; otherwise each begins at the end
            of the last one.
    """

    align: AlignIn | None = None
    interpolates: bool = False
    most_apart_s: float = 0.01
    offset_s: float | None = 0.0
    deltas: tuple[Delta, ...] = ()
    overlaps: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class TrajectoryError:
    """One error with its statistics [m or rad]; in the plane a rotation is a heading."""

    kind: Literal["ate", "rpe"]
    quantity: Literal["position", "rotation"]
    delta: Delta | None
    statistics: ErrorStatistics


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrajectoryComparison:
    """Errors of an estimate relative to its reference.

    Attributes:
        name: Name of the estimate.
        reference_name: Name of the reference.
        space: `plane` if x, y and heading were compared; `space` if positions and rotations were
            compared.
        align: Alignment of the estimate.
        alignment: Transformation of the alignment.
        reference: Associated poses of the reference.
        estimate: Aligned poses of the estimate at the same times.
        whole_reference: All poses of the reference from the first to the last of these times.
        errors: ATE of positions and rotations, then the RPE of each delta.
        absolute: Errors of the ATE, pose by pose.
        before_m: RMSE of the positions without alignment [m].
        poses: Numbers of poses of the estimate and of the reference.
        notes: Notes for the reader.
    """

    name: str
    reference_name: str
    space: Literal["plane", "space"]
    align: AlignIn
    alignment: Alignment
    reference: Trajectory
    estimate: Trajectory
    whole_reference: Trajectory
    errors: tuple[TrajectoryError, ...]
    absolute: PoseErrors
    before_m: float
    poses: tuple[int, int]
    notes: tuple[str, ...] = ()

    def find_error(
        self, kind: str, quantity: str, delta: Delta | None = None
    ) -> ErrorStatistics | None:
        """Return the statistics of an error; by default those of the first delta."""
        for one in self.errors:
            if (one.kind, one.quantity) == (kind, quantity) and delta in {None, one.delta}:
                return one.statistics
        return None

    def __repr__(self) -> str:
        rmse = format_short(trajectory_errors.summarise_errors(self.absolute.position_m).rmse, "m")
        return fit_line(f"<TrajectoryComparison of {self.name}: ATE {rmse} RMSE ({self.align})>")


def parse_delta(text: str) -> Delta:
    """Return a delta: a number with its unit, as in `1 m`, `30 deg`, `0.5 s` or `10 frames`.

    Raises:
        CompareError: If the text is not a delta.
    """
    match = re.fullmatch(r"\s*(\d+\.?\d*|\.\d+)\s*([a-z]+)\s*", text[:60])
    unit = _UNITS.get(match[2]) if match else None
    value = float(match[1]) if match else 0.0
    if unit is None or not 0.0 < value < math.inf:
        raise CompareError(
            f"{text[:60]}: must be a length above 0 with its unit, as in 1m, 30deg, 0.5s or"
            " 10frames"
        )
    if unit == "frames" and value != int(value):
        raise CompareError(f"{text[:60]}: must be a whole number of frames")
    return Delta(value=value, unit=unit)


_UNITS: Final[dict[str, DeltaUnit]] = {
    **dict.fromkeys(("f", "frame", "frames"), "frames"),
    **dict.fromkeys(("d", "deg"), "deg"),
    "m": "m",
    "s": "s",
}


def compare_trajectories(
    reference: Trajectory, estimate: Trajectory, settings: TrajectorySettings | None = None
) -> TrajectoryComparison:
    """Return the absolute and relative errors of an estimate that is aligned to its reference.

    Args:
        reference: Trajectory that counts as true.
        estimate: Trajectory that is compared with the reference.
        settings: Settings of the comparison.

    Raises:
        CompareError: If fewer than three poses can be associated, the alignment is not determined,
            or no relative motion is as long as a delta.
    """
    settings = settings or TrajectorySettings()
    align = _choose_align(reference, estimate, settings.align)
    pair = _associate(reference, estimate, settings)
    is_planar = align in {"se2", "sim2"} or "plane" in {reference.space, estimate.space}
    if is_planar:
        pair = trajectory_errors.Associated(*map(trajectory_errors.project_trajectory, pair))
    before = trajectory_errors.measure_absolute_errors(*pair)
    alignment = _align(pair, align, estimate.name, reference.name)
    aligned = trajectory_errors.align_trajectory(pair.estimate, alignment)
    absolute = trajectory_errors.measure_absolute_errors(pair.reference, aligned)
    errors = [*_list_errors("ate", absolute, None)]
    if aligned.clock == "frame" and any(delta.unit == "s" for delta in settings.deltas):
        raise CompareError(f"{estimate.name}: has no times, so no relative motions in s")
    for delta in settings.deltas:
        # Along the reference: noise makes the way of an estimate many times as long.
        rows = trajectory_errors.choose_pairs(
            pair.reference, delta.value, delta.unit, overlaps=settings.overlaps
        )
        if not len(rows[0]):
            raise CompareError(
                f"{estimate.name}: no relative motion of {delta}: the {len(aligned)} associated"
                f" poses of {reference.name} {_describe_extent(pair.reference)}"
            )
        found = trajectory_errors.measure_relative_errors(pair.reference, aligned, rows)
        errors += _list_errors("rpe", found, delta)
    return TrajectoryComparison(
        name=estimate.name,
        reference_name=reference.name,
        space="plane" if is_planar else "space",
        align=align,
        alignment=alignment,
        reference=pair.reference,
        estimate=aligned,
        whole_reference=_cut_reference(reference, pair.reference.time_ns, is_planar=is_planar),
        errors=tuple(errors),
        absolute=absolute,
        before_m=trajectory_errors.summarise_errors(before.position_m).rmse,
        poses=(len(estimate), len(reference)),
        notes=tuple(_list_notes(reference, estimate, pair, absolute, align, settings)),
    )


def _cut_reference(
    reference: Trajectory, time_ns: NDArray[np.int64], *, is_planar: bool
) -> Trajectory:
    is_inside = (reference.time_ns >= time_ns[0]) & (reference.time_ns <= time_ns[-1])
    inside = trajectory_errors.take_poses(reference, np.flatnonzero(is_inside))
    return trajectory_errors.project_trajectory(inside) if is_planar else inside


def _choose_align(reference: Trajectory, estimate: Trajectory, asked: AlignIn | None) -> AlignIn:
    planar = [one.name for one in (estimate, reference) if one.space == "plane"]
    if asked is None:
        # Of two flat trajectories both alignments are one, but a line leaves that in space open.
        return "se2" if planar or (_is_flat(estimate) and _is_flat(reference)) else "se3"
    if asked not in ALIGN_IN:
        raise CompareError(f"align: expected {suggest_names(asked, ALIGN_IN)}, found {asked!r}")
    if asked in {"se3", "sim3"} and planar:
        raise CompareError(
            f"{planar[0]}: has x, y and heading alone, so it cannot be aligned in {asked.upper()};"
            f" take {asked[:-1]}2"
        )
    return asked


def _is_flat(trajectory: Trajectory) -> bool:
    """Return whether a robot stays upright in a horizontal plane."""
    turns = trajectory.orientation_quat_wxyz
    tilt_rad = 2.0 * np.hypot(turns[:, 1], turns[:, 2]).max()
    return bool(np.ptp(trajectory.xyz_m[:, 2]) <= _FLAT_M and tilt_rad <= _FLAT_RAD)


_FLAT_M, _FLAT_RAD = 1e-6, 1e-6
"""Heights and tilts that count as rounding: texts have at least six digits."""


def _associate(
    reference: Trajectory, estimate: Trajectory, settings: TrajectorySettings
) -> trajectory_errors.Associated:
    if reference.clock != estimate.clock:
        untimed, timed = sorted((reference, estimate), key=lambda one: one.clock != "frame")
        raise CompareError(
            f"{untimed.name}: has no times, but {timed.name} has; --times FILE gives the time of"
            " each pose, one a line"
        )
    offset_s = settings.offset_s
    offset_ns = reference.time_ns[0] - estimate.time_ns[0]
    offset_ns = offset_ns if offset_s is None else round(offset_s * 1e9)
    moved = replace(estimate, time_ns=estimate.time_ns + offset_ns)
    pair = trajectory_errors.associate_trajectories(
        reference,
        moved,
        most_apart_ns=round(settings.most_apart_s * 1e9),
        interpolates=settings.interpolates,
    )
    if len(pair.estimate) < LEAST_POSES:
        raise CompareError(
            f"{estimate.name}: {describe_count(len(pair.estimate), 'pose')} within"
            f" {settings.most_apart_s:g} s of a pose of {reference.name}, but {LEAST_POSES} are"
            f" needed; {_describe_times(reference, moved, offset_s)}"
        )
    return pair


def _describe_times(reference: Trajectory, estimate: Trajectory, offset_s: float | None) -> str:
    if len(reference) < LEAST_POSES or len(estimate) < LEAST_POSES:
        return f"they have {len(estimate)} and {len(reference)} poses"
    both = [(one.time_ns[0], one.time_ns[-1]) for one in (estimate, reference)]
    spans = [f"{begin / 1e9:.9g} to {end / 1e9:.9g} s" for begin, end in both]
    if max(begin for begin, _ in both) <= min(end for _, end in both):
        return f"a larger --max-difference takes more; their times are {spans[0]} and {spans[1]}"
    hint = "" if offset_s is None else "; --time-offset start brings the first poses together"
    return f"their times do not overlap: {spans[0]} and {spans[1]}{hint}"


def _align(
    pair: trajectory_errors.Associated, align: AlignIn, name: str, reference: str
) -> Alignment:
    if align == "none":
        return Alignment(rotation=np.eye(3), translation_m=np.zeros(3))
    if align == "origin":
        return trajectory_errors.find_origin_alignment(pair.reference, pair.estimate)
    try:
        return trajectory_errors.find_alignment(
            pair.reference.xyz_m,
            pair.estimate.xyz_m,
            dimensions=2 if align.endswith("2") else 3,
            scales=align.startswith("sim"),
        )
    except trajectory_errors.DegenerateError as err:
        stands = isinstance(err, trajectory_errors.StandstillError)
        other = "origin" if align.endswith("2") or stands else "se2"
        raise CompareError(
            f"{name}: not aligned to {reference}: {err}, so the rotation of an alignment in"
            f" {NAMES[align]} is not determined; align by {other} or none"
        ) from err


NAMES: Final[dict[AlignIn, str]] = {
    "se2": "SE(2)",
    "se3": "SE(3)",
    "sim2": "Sim(2)",
    "sim3": "Sim(3)",
}
"""Words for the groups of alignments."""


def _list_errors(
    kind: Literal["ate", "rpe"], found: PoseErrors, delta: Delta | None
) -> Iterator[TrajectoryError]:
    values = {"position": found.position_m, "rotation": found.rotation_rad}
    quantity: Literal["position", "rotation"]
    for quantity in ("position", "rotation"):
        statistics = trajectory_errors.summarise_errors(values[quantity])
        yield TrajectoryError(kind=kind, quantity=quantity, delta=delta, statistics=statistics)


def _describe_extent(trajectory: Trajectory) -> str:
    span_s = float(trajectory.time_ns[-1] - trajectory.time_ns[0]) / 1e9
    way_m = trajectory_errors.measure_way_steps(trajectory, "m").sum()
    turn_deg = trajectory_errors.measure_way_steps(trajectory, "deg").sum()
    told = [f"cover {way_m:.3g} m", *([] if trajectory.clock == "frame" else [f"{span_s:.3g} s"])]
    return f"{join_words(told)} and turn by {turn_deg:.3g} deg"


def _list_notes(
    reference: Trajectory,
    estimate: Trajectory,
    pair: trajectory_errors.Associated,
    absolute: PoseErrors,
    align: AlignIn,
    settings: TrajectorySettings,
) -> Iterator[str]:
    used, fewer = len(pair.estimate), min(len(estimate), len(reference))
    if used < _LEAST_SHARE * fewer:
        yield (
            f"Only {used} of {fewer} poses have a partner within {settings.most_apart_s:g} s: the"
            " errors are of these alone. A larger --max-difference takes more."
        )
    yield from _describe_gap(pair.reference, (estimate, reference))
    off_m = pair.reference.xyz_m - pair.reference.xyz_m.mean(axis=0)
    spread_m = float(np.sqrt((off_m**2).sum(axis=1).mean()))
    rmse_m = trajectory_errors.summarise_errors(absolute.position_m).rmse
    if align in NAMES and rmse_m > _MOST_RMSE * spread_m:
        yield (
            f"The alignment is weak: the error is {rmse_m / spread_m:.0%} of how far the reference"
            " spreads about its middle. The two differ in shape or size, or hardly move."
        )
    clocks = {
        one.name: one.notes["timed_by"] for one in (estimate, reference) if "timed_by" in one.notes
    }
    if len({*clocks.values()}) > 1:
        told = " and ".join(f"{name} by {clock}" for name, clock in clocks.items())
        yield f"Poses are timed by two clocks: {told}. Their offset is part of the errors."
    for one in (estimate, reference):
        for name, text in one.notes.items():
            if name not in {"chosen", "timed_by"}:
                yield f"{one.name}: {text}."
    if {estimate.space, reference.space} == {"plane", "space"}:
        planar = estimate if estimate.space == "plane" else reference
        yield f"{planar.name} has x, y and heading alone: both are compared in the plane."


_SEEN: Final = 0.01
"""Smallest share of the compared time, or of a trajectory's, that time without pairs must have to
be told."""


def _describe_gap(pairs: Trajectory, whole: Sequence[Trajectory]) -> Iterator[str]:
    """Yield trajectories that pairs cover in part, and the longest time inside without pairs."""
    if pairs.clock == "frame":
        return
    time_ns = pairs.time_ns
    covered_s = np.ptp(time_ns) / 1e9
    for one in whole:
        lasting_s = np.ptp(one.time_ns) / 1e9
        if lasting_s - covered_s >= _SEEN * lasting_s:
            yield (
                f"The compared poses cover {format_short(covered_s, 's')} of the"
                f" {format_short(lasting_s, 's')} of {one.name}: the errors leave the rest out."
            )
    rows = find_gap_rows(time_ns)
    lengths_s = (time_ns[rows] - time_ns[rows - 1]) / 1e9
    if not len(rows):
        return
    longest = int(lengths_s.argmax())
    if lengths_s[longest] >= _SEEN * covered_s:
        start_s = (time_ns[rows[longest] - 1] - time_ns[0]) / 1e9
        yield (
            f"No poses are compared for {format_short(lengths_s[longest], 's')}, from"
            f" {format_short(start_s, 's')} after the first: the errors leave this time out."
        )


def tabulate_trajectories(found: Sequence[TrajectoryComparison]) -> Table:
    """Return the statistics of all errors of several estimates, rotations in degrees."""
    rows: list[tuple[Cell, ...]] = []
    breaks = []
    for one in found:
        breaks += [len(rows)] if rows else []
        rows += [(one.name, *_list_cells(error, one.space)) for error in one.errors]
    return Table(
        title=f"Errors beside {found[0].reference_name}",
        columns=(
            *(Column(title=title) for title in ("trajectory", "error", "unit", "count")),
            *(Column(title=title) for title in STATISTICS),
        ),
        rows=tuple(rows),
        notes=tuple(note for one in found for note in one.notes),
        breaks=tuple(breaks),
    )


STATISTICS: Final = ("rmse", "mean", "median", "std", "min", "max", "sse")
"""Statistics of every error."""


def _list_cells(error: TrajectoryError, space: str) -> tuple[str | float | int, ...]:
    is_place = error.quantity == "position"
    quantity = "heading" if space == "plane" and not is_place else error.quantity
    name = f"ATE {quantity}" if error.delta is None else f"RPE {quantity}, {error.delta}"
    factor = 1.0 if is_place else math.degrees(1.0)
    values = [factor * getattr(error.statistics, one) for one in STATISTICS]
    values[-1] *= factor  # of squares
    return name, "m" if is_place else "deg", error.statistics.count, *values
