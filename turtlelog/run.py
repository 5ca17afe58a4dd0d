"""Run: the columns that every stage hands on."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import RunError
from turtlelog.loops import PAUSE, Declaration

Parameter = bool | int | float | str | list[Any]

_PAIRS = frozenset({"xy_m", "error_xy_m", "world_velocity_m_s", "reference_xy_m"})
_MAY_BE_NAN = frozenset({"world_velocity_m_s", "reference_xy_m", "reference_heading_rad"})
"""Columns whose rows are NaN where a sample does not have them."""

_LARGEST_HEADING_RAD = np.pi + 1e-6


CUT_SHORT = frozenset({"max_duration", "interrupted", "law_failed"})
"""Stop reasons of runs whose controller did not come to its own end."""

_Rebuilding = tuple[Any, tuple[type, dict[str, Any]]]
"""How a value is pickled: built again from its fields, so that it is checked and frozen again."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseColumns:
    """The turtle's pose, one row per tick (imported logs: one row per sample).

    Takes its arrays over and makes them read-only.

    Attributes:
        time_ns: Time [ns], shape (n,), strictly increasing.
        xy_m: Position in the world frame [m], shape (n, 2).
        heading_rad: Counter-clockwise from +x [rad], within a float32 step of [-pi, pi),
            shape (n,).
        speed_m_s: Magnitude of the applied velocity [m/s], shape (n,); None where not recorded.
        turn_rate_rad_s: Applied turn rate [rad/s], shape (n,); None where not recorded.
    """

    time_ns: NDArray[np.int64]
    xy_m: NDArray[np.float64]
    heading_rad: NDArray[np.float64]
    speed_m_s: NDArray[np.float64] | None = None
    turn_rate_rad_s: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        _freeze(self, "pose")
        _require_finite(self, "pose")
        _require_rising(self.time_ns, "pose.time_ns", strictly=True)
        outside = np.abs(self.heading_rad) > _LARGEST_HEADING_RAD
        if outside.any():
            row = int(outside.argmax())
            found = self.heading_rad[row]
            raise RunError(f"pose.heading_rad[{row}]: expected -pi to pi, found {found}")

    def __len__(self) -> int:
        return len(self.time_ns)

    def __reduce__(self) -> _Rebuilding:
        return _rebuild, (type(self), _list_fields(self))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CommandColumns:
    """The commands as published, one row per command. Makes its arrays read-only.

    Attributes:
        time_ns: Time of publication [ns], shape (n,), not decreasing.
        speed_m_s: Forward along the heading [m/s], shape (n,).
        lateral_speed_m_s: To the left of the heading [m/s], shape (n,).
        turn_rate_rad_s: Counter-clockwise [rad/s], shape (n,).
    """

    time_ns: NDArray[np.int64]
    speed_m_s: NDArray[np.float64]
    lateral_speed_m_s: NDArray[np.float64]
    turn_rate_rad_s: NDArray[np.float64]

    def __post_init__(self) -> None:
        _freeze(self, "command")
        _require_finite(self, "command")
        _require_rising(self.time_ns, "command.time_ns", strictly=False)

    def __len__(self) -> int:
        return len(self.time_ns)

    def __reduce__(self) -> _Rebuilding:
        return _rebuild, (type(self), _list_fields(self))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SampleColumns:
    """What the controller computed, one row per sample. Makes its arrays read-only.

    The errors are the controller's own: a law may hold the last one it computed.

    Attributes:
        time_ns: Time at which the pose was answered [ns], shape (n,), not decreasing; the samples
            of a burst share one time.
        sequence: Number of the sample, shape (n,), strictly increasing.
        pose_sequence: Row of `Run.poses` that the sample read, shape (n,).
        phase: Index into `Run.phase_names` of the phase in which the command was computed,
            shape (n,).
        bearing_rad: Goal bearing [rad], shape (n,); None where not recorded, as the next three.
        heading_error_rad: Bearing minus heading [rad], shape (n,).
        error_xy_m: Goal minus position, world frame [m], shape (n, 2).
        distance_m: Length of that error [m], shape (n,).
        wanted_speed_m_s: Forward speed before clipping [m/s], shape (n,); None where not recorded.
        wanted_turn_rate_rad_s: Before clipping [rad/s], shape (n,); None where not recorded.
        speed_m_s: Forward speed as commanded [m/s], shape (n,).
        turn_rate_rad_s: As commanded [rad/s], shape (n,).
        world_velocity_m_s: Gain times error before projection, world frame [m/s], shape (n, 2);
            NaN where a sample has none, None where no sample has.
        states: Numbers of the law's own, in the order of the declaration, shape (n, k); None where
            it declares none.
        reference_xy_m: Position of the reference pose, world frame [m], shape (n, 2); NaN where a
            sample has none, None where none is declared.
        reference_heading_rad: Its heading [rad], shape (n,), likewise.
    """

    time_ns: NDArray[np.int64]
    sequence: NDArray[np.int64]
    pose_sequence: NDArray[np.int64]
    phase: NDArray[np.int64]
    speed_m_s: NDArray[np.float64]
    turn_rate_rad_s: NDArray[np.float64]
    bearing_rad: NDArray[np.float64] | None = None
    heading_error_rad: NDArray[np.float64] | None = None
    error_xy_m: NDArray[np.float64] | None = None
    distance_m: NDArray[np.float64] | None = None
    world_velocity_m_s: NDArray[np.float64] | None = None
    wanted_speed_m_s: NDArray[np.float64] | None = None
    wanted_turn_rate_rad_s: NDArray[np.float64] | None = None
    states: NDArray[np.float64] | None = None
    reference_xy_m: NDArray[np.float64] | None = None
    reference_heading_rad: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        _freeze(self, "sample")
        _require_finite(self, "sample")
        _require_rising(self.time_ns, "sample.time_ns", strictly=False)
        _require_rising(self.sequence, "sample.sequence", strictly=True)

    def __len__(self) -> int:
        return len(self.time_ns)

    def __reduce__(self) -> _Rebuilding:
        return _rebuild, (type(self), _list_fields(self))


@dataclass(frozen=True, slots=True, kw_only=True)
class Event:
    """Something worth a line in the log.

    Attributes:
        time_ns: When [ns].
        kind: `wall_hit`, `commands_dropped`, `poses_dropped` or `stop`.
        text: One sentence for people.
    """

    time_ns: int
    kind: str
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class PhaseSpan:
    """A stretch of time in one phase, [start_ns, end_ns].

    Attributes:
        phase: Its name.
        start_ns: Time of its first sample; of a pause, of the last sample before [ns].
        end_ns: Time of the next span's start, or the end of the run [ns].
    """

    phase: str
    start_ns: int
    end_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class GoalLine:
    """The line from start to goal, which along-track and cross-track coordinates belong to.

    Attributes:
        start_xy_m: The first pose that was read, world frame [m].
        bearing_rad: Of the goal from there, counter-clockwise from +x [rad].
        length_m: Distance from there to the goal [m], None where it is not known.
    """

    start_xy_m: tuple[float, float]
    bearing_rad: float
    length_m: float | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Run:
    """Everything that is known of one run.

    Attributes:
        name: Short name for tables and legends.
        source: Where it comes from: `simulation`, `replay of` a run, or the layout and name of an
            imported file.
        poses: At least one row.
        commands: As published; imported logs hold one per sample.
        samples: What the controller computed; no rows where the source does not hold it.
        goal_xy_m: Goal position, world frame [m], None where not recorded.
        goal_heading_rad: Goal heading [rad], None where none was asked for.
        declaration: The loops, phases and states of its law; without a loop where they are not
            known.
        parameters: What is known of the scenario, by dotted key (`law.kp_linear`).
        scenario_is_complete: Whether the parameters determine the run.
        stop_reason: Why it ended, in the law's word, or one of `CUT_SHORT`; None where not
            recorded.
        events: In order of time.
        absent: Names of the fields that the source does not hold.
        notes: What an importer did or found, by name (`original_timestamp`, `sorted_rows`, ...).
    """

    name: str
    source: str
    poses: PoseColumns
    commands: CommandColumns
    samples: SampleColumns
    goal_xy_m: tuple[float, float] | None = None
    goal_heading_rad: float | None = None
    declaration: Declaration = field(default_factory=Declaration)
    parameters: Mapping[str, Parameter] = field(default_factory=dict)
    scenario_is_complete: bool = False
    stop_reason: str | None = None
    events: tuple[Event, ...] = ()
    absent: tuple[str, ...] = ()
    notes: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.name or not self.name.isprintable():
            raise RunError(f"name: expected printable text, found {self.name!r}")
        if not len(self.poses):
            raise RunError("poses: expected at least one row, found none")
        read = self.samples.pose_sequence
        outside = (read < 0) | (read >= len(self.poses))
        if outside.any():
            row = int(outside.argmax())
            raise RunError(
                f"sample.pose_sequence[{row}]: expected a row of the {len(self.poses)} poses,"
                f" found {read[row]}"
            )
        self._require_declared()
        object.__setattr__(self, "parameters", MappingProxyType(dict(self.parameters)))
        object.__setattr__(self, "notes", MappingProxyType(dict(self.notes)))

    def __reduce__(self) -> _Rebuilding:
        return _rebuild, (type(self), _list_fields(self))

    def _require_declared(self) -> None:
        """Refuse samples that are not of the law that is declared."""
        samples, declaration = self.samples, self.declaration
        phases = len(declaration.phase_names)
        unknown = (samples.phase < 0) | (samples.phase >= phases)
        if unknown.any():
            row = int(unknown.argmax())
            raise RunError(
                f"sample.phase[{row}]: expected 0 to {phases - 1}, found {samples.phase[row]}"
            )
        found = 0 if samples.states is None else samples.states.shape[1]
        if found != len(declaration.states):
            raise RunError(
                f"sample.states: expected {len(declaration.states)} columns, found {found}"
            )

    @property
    def phase_names(self) -> tuple[str, ...]:
        """Names of the phases by the index that samples hold."""
        return self.declaration.phase_names

    @property
    def goal_line(self) -> GoalLine | None:
        """The line from the first pose that was read to the goal; None where it is not known.

        Where the first sample is lost, or the goal is not known, the first bearing that was
        recorded gives the direction.
        """
        samples = self.samples
        if not len(samples):
            return None
        x_m, y_m = map(float, self.poses.xy_m[samples.pose_sequence[0]])
        length_m = bearing_rad = None
        if self.goal_xy_m is not None:
            ahead_m, left_m = self.goal_xy_m[0] - x_m, self.goal_xy_m[1] - y_m
            length_m = float(np.hypot(ahead_m, left_m))
            bearing_rad = math.atan2(left_m, ahead_m)
        if samples.bearing_rad is not None and (samples.sequence[0] != 0 or bearing_rad is None):
            bearing_rad = float(samples.bearing_rad[0])
        if bearing_rad is None:
            return None
        if length_m is None and samples.error_xy_m is not None:
            length_m = float(np.hypot(*samples.error_xy_m[0]))
        return GoalLine(start_xy_m=(x_m, y_m), bearing_rad=bearing_rad, length_m=length_m)

    @property
    def start_ns(self) -> int:
        """Time zero of metrics, windows and alignment: the first sample, or else pose [ns]."""
        return int([*self.samples.time_ns[:1], self.poses.time_ns[0]][0])

    @property
    def end_ns(self) -> int:
        """Time of the last row of any column [ns]."""
        columns = (self.poses, self.samples, self.commands)
        return int(max(column.time_ns[-1] for column in columns if len(column)))

    @property
    def is_complete(self) -> bool:
        """Whether the controller came to its own end."""
        return self.stop_reason is not None and self.stop_reason not in CUT_SHORT

    def find_phase_spans(self) -> tuple[PhaseSpan, ...]:
        """Return the phases in order; the silence after a phase's last sample is its pause.

        A run that ends while its controller is blocked ends in that silence.
        """
        phase, time_ns, names = self.samples.phase, self.samples.time_ns, self.phase_names
        if not len(phase):
            return ()
        firsts = [0, *(np.flatnonzero(np.diff(phase)) + 1).tolist()]
        afters = [*firsts[1:], len(phase)]
        ends_ns = [*time_ns[firsts[1:]].tolist(), self.end_ns]
        spans = []
        for first, after, end_ns in zip(firsts, afters, ends_ns, strict=True):
            name, start_ns = names[phase[first]], int(time_ns[first])
            if after < len(phase) or self._ends_blocked():
                last_ns = int(time_ns[after - 1])
                spans.append(PhaseSpan(phase=name, start_ns=start_ns, end_ns=last_ns))
                name, start_ns = PAUSE, last_ns
            spans.append(PhaseSpan(phase=name, start_ns=start_ns, end_ns=end_ns))
        return tuple(spans)

    def _ends_blocked(self) -> bool:
        """Whether the last sample's command went out later than its pose was answered, or never."""
        published, answered = self.commands.time_ns, self.samples.time_ns
        if len(published) < len(answered):
            return self.end_ns > int(answered[-1])
        return len(published) == len(answered) and bool(published[-1] > answered[-1])


def _list_fields(value: Any) -> dict[str, Any]:
    values = {found.name: getattr(value, found.name) for found in fields(value)}
    return {
        name: dict(inner) if isinstance(inner, MappingProxyType) else inner
        for name, inner in values.items()
    }


def _rebuild(kind: type, values: dict[str, Any]) -> Any:
    return kind(**values)


def _freeze(columns: PoseColumns | CommandColumns | SampleColumns, table: str) -> None:
    rows = len(columns.time_ns)
    for column in fields(columns):
        values = getattr(columns, column.name)
        if values is None:
            continue
        shape = (rows, 2) if column.name in _PAIRS else (rows,)
        if column.name == "states":
            shape = (rows, values.shape[-1])
        if values.shape != shape:
            raise RunError(f"{table}.{column.name}: expected shape {shape}, found {values.shape}")
        values.flags.writeable = False


def _require_finite(columns: PoseColumns | CommandColumns | SampleColumns, table: str) -> None:
    for column in fields(columns):
        values = getattr(columns, column.name)
        if values is None or values.dtype.kind != "f":
            continue
        bad = np.isinf(values) if column.name in _MAY_BE_NAN else ~np.isfinite(values)
        if values.ndim > 1:
            bad = bad.any(axis=1)
        if bad.any():
            row = int(bad.argmax())
            raise RunError(f"{table}.{column.name}[{row}]: expected a number, found {values[row]}")


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
