"""The columns and events of a run, and the poses of a trajectory, checked; their clock."""

import math
from collections.abc import Callable, Mapping
from dataclasses import MISSING, Field, dataclass, field, fields, replace
from functools import cache, partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Final, Literal, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import describe_count, fit_line
from turtlelog.errors import RunError
from turtlelog.run.angles import turn_headings

if TYPE_CHECKING:
    from turtlelog.run.run import Run


PAIRS: Final = {
    "xy_m": ("x_m", "y_m"),
    "sensed_xy_m": ("sensed_x_m", "sensed_y_m"),
    "error_xy_m": ("error_x_m", "error_y_m"),
    "world_velocity_m_s": ("world_velocity_x_m_s", "world_velocity_y_m_s"),
    "reference_xy_m": ("reference_x_m", "reference_y_m"),
}
"""Words for the two columns of a pair."""

_WHOLE = frozenset({"time_ns", "sequence", "pose_sequence", "phase"})

_MAY_BE_NAN = frozenset(
    {
        "world_velocity_m_s",
        "reference_xy_m",
        "reference_heading_rad",
        "sensed_xy_m",
        "sensed_heading_rad",
        "height_m",
        "tilt_rad",
    }
)
"""Columns that contain NaN in rows of samples without such a value."""

_LARGEST_HEADING_RAD = np.pi + 1e-6
Values = NDArray[np.float64]

Rebuilding = tuple[Any, tuple[()]]
"""Pickled form of a value: a new value is built from the fields, so that it is checked and frozen
again."""


class Columns:
    """Columns of one length: a frozen dataclass of arrays, or None for a column not recorded."""

    __slots__ = ()

    if TYPE_CHECKING:
        __dataclass_fields__: ClassVar[dict[str, Field[Any]]]
        time_ns: NDArray[np.int64]

    @classmethod
    def build_empty(cls) -> Self:
        """Return columns without rows; columns that may be missing are None."""
        return cls(
            **{
                name: np.zeros(
                    (0, 2) if name in PAIRS else 0, np.int64 if name in _WHOLE else np.float64
                )
                for name, one in cls.__dataclass_fields__.items()
                if one.default is MISSING
            }
        )

    def __len__(self) -> int:
        return len(self.time_ns)

    def __repr__(self) -> str:
        names = [one.name for one in fields(self) if getattr(self, one.name) is not None]
        return f"<{type(self).__name__}: {len(self)} rows of {', '.join(names)}>"

    def __reduce__(self) -> Rebuilding:
        return rebuild_value(self)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class PoseColumns(Columns):
    """The turtle's pose, one row per tick (imported logs: one row per sample).

    The arrays are made read-only without a copy.

    Attributes:
        time_ns: Time [ns], shape (n,), strictly increasing.
        xy_m: Position in the world frame [m], shape (n, 2).
        heading_rad: Heading, counter-clockwise from +x [rad], within a float32 step of [-pi, pi),
            shape (n,).
        speed_m_s: Magnitude of the applied velocity [m/s], shape (n,); None if not recorded.
        turn_rate_rad_s: Applied turn rate [rad/s], shape (n,); None if not recorded.
        measured_speed_m_s: Forward speed that the robot reports, negative when it drives backward
            [m/s], shape (n,); None if not reported.
        measured_turn_rate_rad_s: Turn rate that the robot reports [rad/s], shape (n,).
        sensed_xy_m: Sensed position, which the controller reads [m], shape (n, 2); NaN for a lost
            pose. None if the controller reads the true pose.
        sensed_heading_rad: Sensed heading [rad], shape (n,).
        height_m: Height above the plane of x and y [m], shape (n,); NaN for poses without a height.
            None if the robot stays in the plane.
        tilt_rad: Angle between the robot's vertical axis and the world's [rad], shape (n,).
    """

    time_ns: NDArray[np.int64]
    xy_m: NDArray[np.float64]
    heading_rad: NDArray[np.float64]
    speed_m_s: NDArray[np.float64] | None = None
    turn_rate_rad_s: NDArray[np.float64] | None = None
    measured_speed_m_s: NDArray[np.float64] | None = None
    measured_turn_rate_rad_s: NDArray[np.float64] | None = None
    sensed_xy_m: NDArray[np.float64] | None = None
    sensed_heading_rad: NDArray[np.float64] | None = None
    height_m: NDArray[np.float64] | None = None
    tilt_rad: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        _freeze(self, "pose")
        _require_rising(self.time_ns, "pose.time_ns", strictly=True)
        outside = np.abs(self.heading_rad) > _LARGEST_HEADING_RAD
        if outside.any():
            row = int(outside.argmax())
            found = self.heading_rad[row]
            raise RunError(f"pose.heading_rad[{row}]: expected -pi to pi, found {found}")

    @property
    def read_xy_m(self) -> NDArray[np.float64]:
        """Position that the controller reads [m], shape (n, 2): the sensed or the true one."""
        return self.xy_m if self.sensed_xy_m is None else self.sensed_xy_m

    @property
    def read_heading_rad(self) -> NDArray[np.float64]:
        """Heading that the controller reads [rad], shape (n,)."""
        return self.heading_rad if self.sensed_heading_rad is None else self.sensed_heading_rad

    @property
    def dropped_out(self) -> NDArray[np.bool_]:
        """Whether each pose failed to reach the controller, shape (n,)."""
        rows = np.isnan(self.read_xy_m).any(axis=1) | np.isnan(self.read_heading_rad)
        return np.asarray(rows)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class CommandColumns(Columns):
    """The published commands, one row per command. The arrays become read-only.

    Attributes:
        time_ns: Time of publication [ns], shape (n,), not decreasing.
        speed_m_s: Speed along the heading, forward positive [m/s], shape (n,).
        lateral_speed_m_s: Speed to the left of the heading [m/s], shape (n,).
        turn_rate_rad_s: Turn rate, counter-clockwise positive [rad/s], shape (n,).
    """

    time_ns: NDArray[np.int64]
    speed_m_s: NDArray[np.float64]
    lateral_speed_m_s: NDArray[np.float64]
    turn_rate_rad_s: NDArray[np.float64]

    def __post_init__(self) -> None:
        _freeze(self, "command")
        _require_rising(self.time_ns, "command.time_ns", strictly=False)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class SampleColumns(Columns):
    """Values that the controller computed, one row per sample. The arrays become read-only.

    The fields have the order of the table columns.

    The errors are the values of the controller; a law may repeat its last computed error.

    Attributes:
        time_ns: Time at which the pose was answered [ns], shape (n,), not decreasing; the samples
            of a burst share one time.
        sequence: Sample number, shape (n,), strictly increasing.
        pose_sequence: Row of `Run.poses` that the sample read, shape (n,).
        phase: Index into `Run.phase_names` of the phase in which the command was computed,
            shape (n,).
        bearing_rad: Goal bearing [rad], shape (n,). None if not recorded. The next two fields are
            None in the same case.
        heading_error_rad: Goal bearing minus heading [rad], shape (n,).
        error_xy_m: Goal minus position, world frame [m], shape (n, 2).
        distance_m: Length of `error_xy_m` [m], shape (n,); None if not recorded.
        wanted_speed_m_s: Forward speed before clipping [m/s], shape (n,); None if not recorded.
        wanted_turn_rate_rad_s: Turn rate before clipping [rad/s], shape (n,); None if not recorded.
        speed_m_s: Commanded forward speed [m/s], shape (n,).
        turn_rate_rad_s: Commanded turn rate [rad/s], shape (n,).
        shaped_speed_m_s: Forward speed after shaping, before the limits [m/s], shape (n,); None if
            there is no shaping.
        shaped_turn_rate_rad_s: Turn rate after shaping, before the limits [rad/s], shape (n,).
        world_velocity_m_s: Gain times error before projection, world frame [m/s], shape (n, 2); NaN
            for samples without this value, None if no sample has it.
        states: State values of the law, in the order of the declaration, shape (n, k); None if the
            law declares no states.
        reference_xy_m: Position of the reference pose, world frame [m], shape (n, 2); NaN for
            samples without a reference, None if no reference is declared.
        reference_heading_rad: Heading of the reference pose [rad], shape (n,); NaN or None as for
            `reference_xy_m`.
    """

    time_ns: NDArray[np.int64]
    sequence: NDArray[np.int64]
    pose_sequence: NDArray[np.int64]
    phase: NDArray[np.int64]
    bearing_rad: NDArray[np.float64] | None = None
    heading_error_rad: NDArray[np.float64] | None = None
    error_xy_m: NDArray[np.float64] | None = None
    distance_m: NDArray[np.float64] | None = None
    speed_m_s: NDArray[np.float64]
    turn_rate_rad_s: NDArray[np.float64]
    world_velocity_m_s: NDArray[np.float64] | None = None
    wanted_speed_m_s: NDArray[np.float64] | None = None
    wanted_turn_rate_rad_s: NDArray[np.float64] | None = None
    shaped_speed_m_s: NDArray[np.float64] | None = None
    shaped_turn_rate_rad_s: NDArray[np.float64] | None = None
    reference_xy_m: NDArray[np.float64] | None = None
    reference_heading_rad: NDArray[np.float64] | None = None
    states: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        _freeze(self, "sample")
        _require_rising(self.time_ns, "sample.time_ns", strictly=False)
        _require_rising(self.sequence, "sample.sequence", strictly=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class Event:
    """A notable event of a run.

    Attributes:
        time_ns: Time of the event [ns].
        kind: `wall_hit`, `commands_dropped`, `poses_dropped`, `commands_lost`, `poses_lost` or
            `stop`.
        text: Description in one sentence.
    """

    time_ns: int
    kind: str
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Clock:
    """The clock that times the poses of a bag, and its relation to the recorder's clock.

    Attributes:
        used: `stamp`: the time when the robot measured each pose, mapped to the recorder's clock.
            `log`: the time when the recorder received the pose.
        ratio: Stamp seconds per second of the recorder's clock; None if poses have no stamps.
        offset_s: Recorder's time minus stamp at the first pose, for the shortest transport delay
            [s]; None if poses have no stamps.
        jitter_s: Median transport delay minus the shortest transport delay [s]; None if unknown.
    """

    used: Literal["log", "stamp"]
    ratio: float | None = None
    offset_s: float | None = None
    jitter_s: float | None = None


AnyColumns = TypeVar("AnyColumns", PoseColumns, CommandColumns, SampleColumns)


def take_rows(
    columns: AnyColumns, rows: slice | NDArray[np.bool_] | NDArray[np.int64]
) -> AnyColumns:
    """Return the selected rows of every column."""
    taken = {
        one.name: values[rows]
        for one in fields(columns)
        if (values := getattr(columns, one.name)) is not None
    }
    return replace(columns, **taken)


def rebuild_value(value: Any, **others: Any) -> Rebuilding:
    """Return the pickled form of a frozen dataclass, with other values of some fields."""
    kind: Any = type(value)
    values = {found.name: getattr(value, found.name) for found in fields(kind)}
    proxies = {name: dict(one) for name, one in values.items() if isinstance(one, MappingProxyType)}
    return partial(kind, **values | proxies | others), ()


_list_fields: Final[Callable[[type], tuple[Field[Any], ...]]] = cache(fields)


def _freeze(columns: Columns, table: str) -> None:
    """Require arrays of one length: integers for times and counts, floats for all other columns."""
    for column in _list_fields(type(columns)):
        values, place = getattr(columns, column.name), f"{table}.{column.name}"
        if values is None and column.default is None:
            continue
        if not isinstance(values, np.ndarray):
            raise RunError(f"{place}: expected a numpy array, found {type(values).__name__}")
        kinds, expected = ("iu", "whole numbers") if column.name in _WHOLE else ("f", "floats")
        if len(values) and values.dtype.kind not in kinds:
            raise RunError(f"{place}: expected {expected}, found {values.dtype}")
        shape: tuple[int, ...] = (len(columns),)
        if column.name in PAIRS:
            shape = (*shape, 2)
        elif column.name == "states":
            shape = (*shape, values.shape[-1])
        if values.shape != shape:
            raise RunError(f"{place}: expected shape {shape}, found {values.shape}")
        values.flags.writeable = False
    _require_finite(columns, table)


def _require_finite(columns: Columns, table: str) -> None:
    with np.errstate(all="ignore"):
        for column in _list_fields(type(columns)):
            values = getattr(columns, column.name)
            if values is None or values.dtype.kind != "f":
                continue
            # Of finite values only a sum beyond the largest float is not: one pass clears most.
            if math.isfinite(np.add.reduce(values, axis=None)):
                continue
            bad = np.isinf(values) if column.name in _MAY_BE_NAN else ~np.isfinite(values)
            if values.ndim > 1:
                bad = bad.any(axis=1)
            if bad.any():
                row, place = int(bad.argmax()), f"{table}.{column.name}"
                raise RunError(f"{place}[{row}]: expected a number, found {values[row]}")


def _require_rising(values: NDArray[np.int64], name: str, *, strictly: bool) -> None:
    before, after = values[:-1], values[1:]
    wrong = after <= before if strictly else after < before
    if wrong.any():
        row = int(wrong.argmax()) + 1
        order = "strictly increasing" if strictly else "not decreasing"
        raise RunError(
            f"{name}: expected {order} values, found {values[row]} after {values[row - 1]}"
            f" at row {row}"
        )


_UNIT_LENGTH: Final = 1e-6
"""Largest deviation of a quaternion's length from 1; built quaternions are normalised."""

_FARTHEST_M: Final = 1e12
"""Largest coordinate of a robot [m]: the sun is at 1.5e11 m, and squares of 1e155 overflow."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trajectory:
    """Poses of a robot. The arrays are made read-only without a copy.

    Attributes:
        name: Name of the trajectory in answers.
        time_ns: Time of each pose as in the file [ns], shape (n,), strictly increasing. For a
            trajectory without times, the number of the pose in units of 1 s.
        xyz_m: Position in the world frame [m], shape (n, 3).
        orientation_quat_wxyz: Unit quaternion of the rotation from the robot's frame to the world
            frame, shape (n, 4).
        space: `space` if the file has heights and rotations; `plane` if it has only x, y and
            heading.
        clock: `time`, or `frame` for poses that are only numbered.
        notes: Notes on rows omitted in reading, by keyword.
    """

    name: str
    time_ns: NDArray[np.int64]
    xyz_m: Values
    orientation_quat_wxyz: Values
    space: Literal["plane", "space"]
    clock: Literal["time", "frame"] = "time"
    notes: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        count = len(self.time_ns)
        shapes = (self.xyz_m.shape, self.orientation_quat_wxyz.shape)
        if shapes != ((count, 3), (count, 4)):
            raise RunError(
                f"trajectory: expected rows of 3 and 4 for {count} times, found {shapes}"
            )
        if (np.diff(self.time_ns) <= 0).any():
            row = int((np.diff(self.time_ns) <= 0).argmax()) + 1
            raise RunError(f"trajectory.time_ns[{row}]: expected a time after the one before")
        for name in ("xyz_m", "orientation_quat_wxyz"):
            if not np.isfinite(getattr(self, name)).all():
                raise RunError(f"trajectory.{name}: expected finite numbers")
        if (farthest_m := float(np.abs(self.xyz_m).max(initial=0.0))) > _FARTHEST_M:
            raise RunError(
                f"trajectory: expected positions within {_FARTHEST_M:g} m, found {farthest_m:g} m"
            )
        lengths = np.linalg.norm(self.orientation_quat_wxyz, axis=1)
        if (np.abs(lengths - 1.0) > _UNIT_LENGTH).any():
            raise RunError("trajectory.orientation_quat_wxyz: expected quaternions of length 1")
        for array in (self.time_ns, self.xyz_m, self.orientation_quat_wxyz):
            array.flags.writeable = False
        object.__setattr__(self, "notes", MappingProxyType(dict(self.notes)))

    def __len__(self) -> int:
        return len(self.time_ns)

    def __repr__(self) -> str:
        return fit_line(f"<Trajectory {self.name}: {len(self)} poses in {self.space}>")

    def __reduce__(self) -> Rebuilding:
        return rebuild_value(self)


def build_planar_trajectory(run: "Run") -> Trajectory:
    """Return the poses of a run as a planar trajectory, with its source's times."""
    return Trajectory(
        name=run.name,
        time_ns=run.poses.time_ns + run.source_start_ns,
        xyz_m=np.column_stack([run.poses.xy_m, np.zeros(len(run.poses))]),
        orientation_quat_wxyz=turn_headings(run.poses.heading_rad),
        space="plane",
    )


def build_trajectory(
    name: str,
    time_ns: NDArray[np.int64],
    xyz_m: Values,
    turns: Values,
    *,
    notes: Mapping[str, str],
) -> Trajectory:
    """Return a trajectory of the finite rows in order of time, one row for each time.

    Args:
        name: Name of the trajectory.
        time_ns: Time of each row [ns], shape (n,), in any order.
        xyz_m: Position [m], shape (n, 3).
        turns: Rotation as a quaternion w, x, y, z of any length, shape (n, 4).
        notes: Notes, to which the numbers of rows left out or sorted are added.

    Raises:
        RunError: If no row has a position and a rotation, or the rows are no trajectory.
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        turns = turns / np.linalg.norm(turns, axis=1, keepdims=True)
    is_pose = np.isfinite(xyz_m).all(axis=1) & np.isfinite(turns).all(axis=1)
    if not is_pose.any():
        raise RunError("no row has a position of finite numbers and a rotation")
    time_ns, xyz_m, turns = time_ns[is_pose], xyz_m[is_pose], turns[is_pose]
    late = int((time_ns < np.maximum.accumulate(time_ns)).sum())
    if late:
        order = np.argsort(time_ns, kind="stable")
        time_ns, xyz_m, turns = time_ns[order], xyz_m[order], turns[order]
    is_first = np.concatenate([[True], np.diff(time_ns) > 0])
    counts = {
        "without a time, a position or a rotation": int((~is_pose).sum()),
        "out of order in time, sorted": late,
        "at a time that an earlier pose has, left out": int((~is_first).sum()),
    }
    told = {name: f"{describe_count(count, 'pose')} {name}" for name, count in counts.items()}
    return Trajectory(
        name=name,
        time_ns=time_ns[is_first],
        xyz_m=xyz_m[is_first],
        orientation_quat_wxyz=turns[is_first],
        space="space",
        notes={**notes, **{key: text for key, text in told.items() if counts[key]}},
    )
