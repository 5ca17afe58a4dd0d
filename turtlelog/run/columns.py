"""The columns and events of a run, checked; their clock and their origin."""

import math
from collections.abc import Callable
from dataclasses import MISSING, Field, dataclass, fields, replace
from enum import Enum
from functools import cache, partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Final, Literal, Self, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import RunError

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


@dataclass(frozen=True, slots=True, kw_only=True)
class SourceTopic:
    """A topic from which a run was read.

    Attributes:
        name: Name of the topic.
        type: Type of its messages.
        frames: World frame and robot frame of poses from transforms; None for other messages.
    """

    name: str
    type: str
    frames: tuple[str, str] | None = None

    def describe(self) -> str:
        """Return name, type and frames in one line."""
        frames = "" if self.frames is None else ": {} -> {}".format(*self.frames)
        return f"{self.name} ({self.type}){frames}"


class SourceKind(Enum):
    """What made a run, or what it was read from: the words with which `Run.source` begins."""

    SIMULATION = "simulation"
    REPLAY = "replay of "
    TABLE = "table: "
    TRAJECTORY = "tum: "

    def describe(self, name: str = "") -> str:
        """Return the source of a run, with the name of the replayed run or of the file."""
        return f"{self.value}{name}"


def find_source_kind(source: str) -> SourceKind | None:
    """Return the kind of a source that `SourceKind.describe` gave; None for any other source."""
    if source == SourceKind.SIMULATION.value:
        return SourceKind.SIMULATION
    named = (kind for kind in SourceKind if kind is not SourceKind.SIMULATION)
    return next((kind for kind in named if source.startswith(kind.value)), None)


Lost = Literal["nothing", "summary", "rows"]
"""What a file has lost, from least to most: only its summary, or perhaps rows."""


def find_greatest_loss(*lost: Lost) -> Lost:
    """Return the greatest of several losses."""
    return max(lost, key=get_args(Lost).index, default="nothing")


_LATEST_NS: Final = 2**62
"""Time beyond which no date is known [ns], in the year 2116: the sum of two fits into 64 bits."""

_MOST_ROWS: Final = 2**62
"""Number of rows that no file reaches, as each takes a byte."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Origin:
    """Facts on the source of a run; `Run.notes` tells them, and further remarks, in sentences.

    Attributes:
        began_ns: Time since 1970, UTC, at which the recording began [ns]; None if unknown.
        start_ns: Time zero of the run on the clock of its source [ns]; None if unknown.
        poses: Topic of the poses; None if they are not from a topic of a bag.
        commands: Topic of the commands; None if they are not from a topic of a bag.
        frame: Frame of the poses; empty if unknown.
        robot: Robot that was read by its name, of several; None if no name was given.
        table_run: Number of the run that was read, and number of runs, in a table of several.
        goal_given_ns: Time at which the goal was given during the run [ns]; None if unknown.
        path_given_ns: Time at which the path was given during the run [ns]; None if unknown.
        was_clock_set: Whether the recorder's clock was set while it recorded.
        has_courses: Whether headings are courses over ground, as of a satellite receiver.
        has_leaps: Whether the poses alternate between two places, as of two programs.
        sorted_rows: Number of rows that were out of order in time, and were sorted.
        dropped_duplicates: Number of rows that repeated another, and were dropped.
        unread_topics: Topics of turtlelog's own that were not read.
        lost: What the file has lost.
    """

    began_ns: int | None = None
    start_ns: int | None = None
    poses: SourceTopic | None = None
    commands: SourceTopic | None = None
    frame: str = ""
    robot: str | None = None
    table_run: tuple[int, int] | None = None
    goal_given_ns: int | None = None
    path_given_ns: int | None = None
    was_clock_set: bool = False
    has_courses: bool = False
    has_leaps: bool = False
    sorted_rows: int = 0
    dropped_duplicates: int = 0
    unread_topics: tuple[str, ...] = ()
    lost: Lost = "nothing"

    def __post_init__(self) -> None:
        for name in ("began_ns", "start_ns"):
            if abs(getattr(self, name) or 0) >= _LATEST_NS:
                object.__setattr__(self, name, None)
        for name in ("sorted_rows", "dropped_duplicates"):
            if not 0 <= getattr(self, name) < _MOST_ROWS:
                raise RunError(f"origin.{name}: expected a number of rows below {_MOST_ROWS}")


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
