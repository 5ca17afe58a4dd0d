"""`turtlelog compare --ate` and `--rpe`: errors of trajectories relative to a reference."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Literal

import numpy as np
from cyclopts import Group, Parameter

import turtlelog as tl
from turtlelog.cli import console
from turtlelog.cli.options import (
    Place,
    ReadingOptions,
    list_option_words,
    refuse_given,
    require_pictures,
)
from turtlelog.cli.work import show_progress
from turtlelog.display import LATEST_S, ROUNDING, describe_count, format_short, join_words
from turtlelog.errors import CompareError, TurtlelogError, UsageError

if TYPE_CHECKING:
    from turtlelog.cli.compare import ReferenceOptions
    from turtlelog.compare import ErrorStatistics, Table, TrajectoryComparison, TrajectorySettings
    from turtlelog.run import Trajectory


_APART_S: Final = 0.01
"""Default of `--max-difference` [s]."""


@Parameter(name="*", group=Group("Trajectories", sort_key=1))
@dataclass(frozen=True, slots=True, kw_only=True)
class TrajectoryOptions:
    """Errors of trajectories, and the pairing of poses.

    Attributes:
        ate: Absolute trajectory error of positions and rotations, after alignment to the reference.
        rpe: Relative pose error over this length of the reference. Examples: 1m, 30deg, 0.5s,
            10frames. Can be repeated.
        all_pairs: Begin a relative motion at every pose. Default: at the end of the previous
            motion.
        associate: How to pair poses: nearest in time, or linear interpolation of the trajectory
            with more poses at the times of the other. Default: nearest.
        max_difference: Largest difference in time between two paired poses. Default: 0.01. Unit: s.
        time_offset: Time to add to all files but the reference; start aligns the first poses.
            Default: 0. Unit: s.
        times: File with the time of each pose of a KITTI trajectory, one per line. Unit: s.
    """

    ate: bool = False
    rpe: Annotated[list[str] | None, Parameter(metavar="LENGTH", negative=())] = None
    all_pairs: Annotated[bool, Parameter(negative=())] = False
    associate: Literal["nearest", "linear"] | None = None
    max_difference: Annotated[float | None, Parameter(metavar="S")] = None
    time_offset: Annotated[str | None, Parameter(metavar="S", allow_leading_hyphen=True)] = None
    times: Place | None = None

    def require_sense(self) -> bool:
        """Return whether trajectories are compared; if not, refuse the options for them."""
        if self.ate or self.rpe:
            return True
        given = {
            "--all-pairs": self.all_pairs,
            "--associate": self.associate,
            "--max-difference": self.max_difference,
            "--time-offset": self.time_offset,
            "--times": self.times,
        }
        refuse_given(given, "needs --ate or --rpe LENGTH")
        return False

    def take_reference(self, reference: Path | None, files: Sequence[Path]) -> Path:
        """Return the reference, which must be given."""
        option = "--ate" if self.ate else "--rpe"
        if reference is None:
            raise UsageError(f"{option}: needs --reference FILE, the trajectory that is true")
        if not files:
            raise UsageError(f"{option}: needs a file beside the reference")
        return reference

    def build_settings(self, align: str | None) -> "TrajectorySettings":
        """Return the settings for comparing trajectories."""
        from turtlelog.compare.trajectory_comparison import ALIGN_IN

        known = next((one for one in ALIGN_IN if one == align), None)
        if align is not None and known is None:
            raise UsageError(
                f"--align {align[:60]}: must be {join_words(ALIGN_IN, 'or')} with --ate and --rpe"
            )
        most_s = _APART_S if self.max_difference is None else self.max_difference
        if not 0.0 <= most_s < LATEST_S:
            raise UsageError(
                f"--max-difference {most_s:g}: must be a time from 0 to {LATEST_S:g} s"
            )
        try:
            deltas = tuple(tl.compare.parse_delta(text) for text in self.rpe or ())
        except CompareError as err:
            raise UsageError(f"--rpe {err}") from err
        return tl.compare.TrajectorySettings(
            align=known,
            interpolates=self.associate == "linear",
            most_apart_s=most_s,
            offset_s=self._parse_offset(),
            deltas=deltas,
            overlaps=self.all_pairs,
        )

    def _parse_offset(self) -> float | None:
        if self.time_offset is None:
            return 0.0
        if self.time_offset == "start":
            return None
        try:
            offset_s = float(self.time_offset)
        except ValueError:
            offset_s = math.nan
        if not abs(offset_s) < LATEST_S:
            raise UsageError(f"--time-offset {self.time_offset}: must be a time in s, or start")
        return offset_s


def list_setting_words(settings: "TrajectorySettings") -> list[str]:
    """Return the words of a command that compares trajectories as a specification does."""
    from turtlelog.check.spec import USUAL_TRAJECTORY

    deltas = settings.deltas if settings.deltas != USUAL_TRAJECTORY.deltas else ()
    offset_s = "start" if settings.offset_s is None else f"{settings.offset_s!r}"
    options = TrajectoryOptions(
        ate=True,
        rpe=[f"{one.value:.10g}{one.unit}" for one in deltas],
        all_pairs=settings.overlaps,
        associate="linear" if settings.interpolates else None,
        max_difference=None if settings.most_apart_s == _APART_S else settings.most_apart_s,
        time_offset=offset_s if settings.offset_s != 0.0 else None,
    )
    align = [] if settings.align is None else [f"--align={settings.align}"]
    return [*list_option_words(options), *align]


def compare_with_trajectory(
    reference: Path,
    files: Sequence[Path],
    against: "ReferenceOptions",
    topics: ReadingOptions,
    *,
    plot: Path | None,
    kind: str,
) -> int:
    """Print the errors of the trajectories in files relative to a reference."""
    options = against.trajectories
    settings = options.build_settings(against.align)
    require_pictures(plot, None, [reference, *files], drawn=files, of="trajectory")
    choice = topics.build_choice()
    true = _read(reference, choice, options)
    found: list[tuple[Path, TrajectoryComparison]] = []
    for file in files:
        try:
            with show_progress("comparing"):
                estimate = _read(file, choice, options)
                found.append((file, tl.compare.compare_trajectories(true, estimate, settings)))
        except TurtlelogError as err:
            console.print_error(str(err))
    if found:
        words = list_option_words(replace(options, ate=True), topics)
        words += [] if against.align is None else [f"--align={against.align}"]
        _print(found, reference, options, words, kind)
        first = found[0][1]
        console.write_asked(plot, lambda path: tl.draw.write_trajectory_figure(first, path))
    return console.EXIT_FINE if len(found) == len(files) else console.EXIT_BAD_INPUT


def _read(file: Path, choice: "tl.log.ReadChoice", options: TrajectoryOptions) -> "Trajectory":
    """Return the trajectory in a file, named as typed, and print the chosen topics."""
    found = tl.log.read_trajectory(file, choice, times=options.times)
    if "chosen" in found.notes:
        console.print_note(f"{file}: {found.notes['chosen']}")
    return replace(found, name=str(file))


def _print(
    found: "Sequence[tuple[Path, TrajectoryComparison]]",
    reference: Path,
    options: TrajectoryOptions,
    words: Sequence[str],
    kind: str,
) -> None:
    """Print the errors. `words` are the options of a command that repeats the comparison."""
    if kind == "json":
        runs = [_build_answer(file, one) for file, one in found]
        console.print_json(TrajectoriesAnswer(reference=str(reference), runs=runs))
        return
    table = tl.compare.tabulate_trajectories([one for _, one in found])
    if kind != "txt":
        console.print_tables([table], kind)
        return
    heads = [line for _, one in found for line in _describe(one)]
    how = "the nearest in time"
    if options.associate == "linear":
        how = "interpolated linearly between the nearest"
    told = []
    for _, one in found:
        count, (ours, theirs) = len(one.estimate), one.poses
        what = "x, y and heading" if one.space == "plane" else "positions and rotations in space"
        told.append(
            f"Compared: {what} of {count} moments, {how}; {one.name} has {ours} poses,"
            f" {one.reference_name} {theirs}."
        )
    shown = next((file for file, _ in found if file != reference), found[0][0])
    again = console.quote_file(shown, "--reference", reference, *words)
    picture = f"Picture: turtlelog compare {again} --plot FILE.pdf"
    console.print_text(
        "\n".join(
            [
                console.fill_lines(heads, indent=2),
                "",
                console.fit_table(_shorten(table, console.find_width())),
                console.fill_lines([*told, *table.notes, picture], indent=2),
            ]
        )
    )


def _shorten(table: "Table", width: int) -> "Table":
    """Return a table that fits a line, without the only file and, if needed, the sum of squares."""
    first = 0 if len({row[0] for row in table.rows}) > 1 else 1
    rows = []
    for name, error, unit, *values in table.rows:
        texts = [f"{cell:.3g}" if isinstance(cell, float) else cell for cell in values]
        rows.append((name, f"{error} [{unit}]", *texts)[first:])
    columns = tuple(column for column in table.columns[first:] if column.title != "unit")
    short = replace(table, columns=columns, rows=tuple(rows), notes=())
    ranks = [0 if column.title == "sse" else None for column in columns]
    return tl.compare.narrow_table(short, width, ranks)


def _describe(one: "TrajectoryComparison") -> list[str]:
    """Return the errors in sentences: RMSE of positions and rotations."""
    from turtlelog.compare.trajectory_comparison import NAMES

    turn = "heading" if one.space == "plane" else "rotation"
    how = {"none": "without alignment", "origin": "with the first poses brought together"}
    after = how.get(one.align, f"after alignment in {NAMES.get(one.align, '')}")
    lines = [
        f"{one.name}: absolute trajectory error {_format(one.find_error('ate', 'position'), 'm')}"
        f" RMSE, {turn} {_format(one.find_error('ate', 'rotation'), 'rad')}, {after}."
    ]
    for error in one.errors:
        if error.kind == "rpe" and error.quantity == "position":
            rotation = one.find_error("rpe", "rotation", error.delta)
            lines.append(
                f"Relative pose error over {error.delta}: {_format(error.statistics, 'm')} RMSE,"
                f" {turn} {_format(rotation, 'rad')}, of"
                f" {describe_count(error.statistics.count, 'motion')}."
            )
    if one.align != "none":
        lines.append(
            f"The alignment {_describe_alignment(one)}. Without it the position error is"
            f" {format_short(one.before_m, 'm')} RMSE."
        )
    return lines


def _format(statistics: "ErrorStatistics | None", unit: str) -> str:
    return "-" if statistics is None else format_short(statistics.rmse, unit)


def _describe_alignment(one: "TrajectoryComparison") -> str:
    rotation = one.alignment.rotation
    skew = rotation - rotation.T
    sine = float(np.linalg.norm([skew[2, 1], skew[0, 2], skew[1, 0]]))
    turn_rad = math.atan2(sine, float(np.trace(rotation)) - 1.0)
    moved_m = float(np.linalg.norm(one.alignment.translation_m))
    scaled = f", scales it by {one.alignment.scale:.5g}" if one.align.startswith("sim") else ""
    turned, moved = (
        format_short(0.0 if value < ROUNDING else value, unit)
        for value, unit in ((turn_rad, "rad"), (moved_m, "m"))
    )
    return f"turns the estimate by {turned} about the origin{scaled} and moves it by {moved}"


@dataclass(frozen=True, slots=True, kw_only=True)
class TrajectoryErrorAnswer:
    """Statistics of one error over poses (ATE) or relative motions (RPE).

    Attributes:
        error: ATE or RPE.
        quantity: Positions, or the angle of rotations (of headings in the plane).
        unit: Unit of the statistics; `sse` has the square of this unit.
        delta: Length of the relative motions; None for the ATE.
        delta_unit: `frames`, `m`, `deg` or `s`; None for the ATE.
        count: Number of poses or motions.
        std: Standard deviation about the mean, divided by `count`.
        sse: Sum of squares.
    """

    error: Literal["ate", "rpe"]
    quantity: Literal["position", "rotation"]
    unit: Literal["m", "rad"]
    delta: float | None
    delta_unit: str | None
    count: int
    rmse: float
    mean: float
    median: float
    std: float
    min: float
    max: float
    sse: float


@dataclass(frozen=True, slots=True, kw_only=True)
class TrajectoryAnswer:
    """A trajectory compared with the reference.

    Attributes:
        file: File as typed.
        name: Name of the trajectory.
        space: `plane` if x, y and heading were compared, `space` if positions and rotations were.
        align: `none`, `origin`, `se2`, `se3`, `sim2` or `sim3`.
        rotation: Rotation matrix of the alignment, row by row.
        translation_m: Translation of the alignment [m].
        scale: Scale of the alignment; 1 unless it is fitted.
        associated: Number of compared pairs of poses.
        poses: Number of poses of the trajectory.
        reference_poses: Number of poses of the reference.
        rmse_before_m: RMSE of the positions without alignment.
        errors: ATE of positions and rotations, then the RPE of each length.
        notes: Notes, in sentences.
    """

    file: str
    name: str
    space: Literal["plane", "space"]
    align: str
    rotation: list[list[float]]
    translation_m: list[float]
    scale: float
    associated: int
    poses: int
    reference_poses: int
    rmse_before_m: float
    errors: list[TrajectoryErrorAnswer]
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class TrajectoriesAnswer:
    """Trajectories compared with a reference file."""

    reference: str
    runs: list[TrajectoryAnswer]


def _build_answer(file: Path, one: "TrajectoryComparison") -> TrajectoryAnswer:
    return console.copy_fields(
        TrajectoryAnswer,
        one,
        file=str(file),
        rotation=one.alignment.rotation.tolist(),
        translation_m=one.alignment.translation_m.tolist(),
        scale=one.alignment.scale,
        associated=len(one.estimate),
        poses=one.poses[0],
        reference_poses=one.poses[1],
        rmse_before_m=one.before_m,
        errors=[
            TrajectoryErrorAnswer(
                error=error.kind,
                quantity=error.quantity,
                unit="m" if error.quantity == "position" else "rad",
                delta=None if error.delta is None else error.delta.value,
                delta_unit=None if error.delta is None else error.delta.unit,
                **asdict(error.statistics),
            )
            for error in one.errors
        ],
    )
