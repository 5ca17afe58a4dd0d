"""The class `Run`: the columns that all stages exchange, and the software that simulated them."""

import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from turtlelog import display
from turtlelog.errors import PathError, RunError
from turtlelog.run.columns import (
    Clock,
    Columns,
    CommandColumns,
    Event,
    Origin,
    PoseColumns,
    Rebuilding,
    SampleColumns,
    rebuild_value,
)
from turtlelog.run.loops import Declaration
from turtlelog.run.paths import Path, restore_path
from turtlelog.run.stop_reasons import CUT_SHORT, GoalLine, find_goal_end, find_goal_line
from turtlelog.run.tables import (
    TABLES,
    PhaseSpan,
    build_pandas,
    build_xarray,
    describe_phase_lengths,
    find_phase_spans,
    iterate_arrow,
    locate_stretch,
    slice_run,
)

Parameter = bool | int | float | str | list[Any]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, weakref_slot=True)
class Run:
    """The data of one run.

    `==` and `hash` use the object's identity; `equals` compares the values of two runs.

    Attributes:
        name: Short name for tables and legends.
        source: Origin of the run: `simulation`, `replay of` a run, or the layout and name of an
            imported file.
        poses: Poses, at least one row. In a log of commands alone there is no row, and `absent`
            names `poses`.
        commands: Published commands; imported logs have one command per sample.
        samples: Values that the controller computed; no rows if the source lacks them.
        goal_xy_m: Goal position, world frame [m]; None if not recorded.
        goal_heading_rad: Goal heading [rad]; None if the goal has no heading.
        declaration: Loops, phases and states of the law; without loops if they are unknown.
        parameters: Known values of the scenario, by dotted key (`law.kp_linear`).
        scenario_is_complete: Whether the parameters determine the run.
        clock: Clock that times the poses of a bag; None if there is only one clock.
        stop_reason: Reason for the end: a word from the law or one of `CUT_SHORT`; None if not
            recorded.
        events: Events in order of time.
        simulated_by: Versions (`turtlelog`, `python`, `numpy`), `platform` and the digest of the
            code of a law that is not built in (`law`). Empty if the run was not simulated, or the
            recording does not contain them.
        absent: Names of the fields that the source lacks.
        origin: Facts on the source: topics, date, robot, losses. The default knows none.
        notes: Notes of the importer in sentences, by name (`clock`, `columns`, ...).
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
    clock: Clock | None = None
    stop_reason: str | None = None
    events: tuple[Event, ...] = ()
    simulated_by: Mapping[str, str] = field(default_factory=dict)
    absent: tuple[str, ...] = ()
    origin: Origin = field(default_factory=Origin)
    notes: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name or not self.name.isprintable():
            raise RunError(f"name: expected printable text, found {self.name!r}")
        kinds = {"poses": PoseColumns, "commands": CommandColumns, "samples": SampleColumns}
        for name, kind in kinds.items():
            if not isinstance(found := getattr(self, name), kind):
                raise RunError(f"{name}: expected {kind.__name__}, found {type(found).__name__}")
        self._require_goal()
        if not len(self.poses) and not (len(self.commands) and "poses" in self.absent):
            raise RunError("poses: must have at least one row")
        read = self.samples.pose_sequence
        outside = (read < 0) | (read >= len(self.poses))
        if outside.any():
            row = int(outside.argmax())
            raise RunError(
                f"controller sample {row} (pose_sequence): answers pose {read[row]}, but the poses"
                f" are numbered 0 to {len(self.poses) - 1}"
            )
        self._require_declared()
        for name in ("parameters", "simulated_by", "notes"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))

    def __reduce__(self) -> Rebuilding:
        return rebuild_value(self)

    def _require_goal(self) -> None:
        goal, heading = self.goal_xy_m, self.goal_heading_rad
        if goal is not None and not (
            isinstance(goal, tuple) and len(goal) == 2 and all(map(_is_finite, goal))
        ):
            raise RunError(f"goal_xy_m: expected two finite numbers [m], found {goal!r}")
        if heading is not None and not _is_finite(heading):
            raise RunError(f"goal_heading_rad: expected a finite number [rad], found {heading!r}")

    def _require_declared(self) -> None:
        samples, declaration = self.samples, self.declaration
        phase, last = samples.phase, len(declaration.phase_names) - 1
        outside = (phase < 0) | (phase > last)
        if outside.any():
            row = int(outside.argmax())
            raise RunError(f"sample.phase[{row}]: expected 0 to {last}, found {phase[row]}")
        try:
            _ = self.path
        except PathError as err:
            raise RunError(f"parameters: path.{err}") from err
        found = 0 if samples.states is None else samples.states.shape[1]
        if found != len(declaration.states):
            raise RunError(
                f"sample.states: expected {len(declaration.states)} columns, found {found}"
            )

    @property
    def phase_names(self) -> tuple[str, ...]:
        """Names of the phases by their index in samples."""
        return self.declaration.phase_names

    @property
    def goal_row(self) -> int:
        """Row of the pose at which the goal was given; 0 if this is unknown."""
        return self._find_row(self.origin.goal_given_ns)

    @property
    def path_row(self) -> int:
        """Row of the pose at which the path, or else the goal, was given; 0 if unknown."""
        origin = self.origin
        return self._find_row(origin.goal_given_ns if self.path is None else origin.path_given_ns)

    def _find_row(self, given_ns: int | None) -> int:
        if given_ns is None or not len(self.poses):
            return 0
        known_ns = self.poses.time_ns
        return int(np.searchsorted(known_ns, max(0, min(given_ns, int(known_ns[-1])))))

    @property
    def goal_line(self) -> GoalLine | None:
        """The line from the first pose that was read to the goal; None if there is no line.

        If the first sample is lost or the goal is unknown, the first recorded bearing gives the
        direction. Without samples and loops, the line starts where the goal was given, or else at
        the first recorded pose.
        """
        return find_goal_line(self)

    @property
    def path(self) -> Path | None:
        """The path to follow; None if the run follows no path or the path was not recorded.

        A run without samples has an unknown law; then the recorded path is used.
        """
        is_followed = self.declaration.follows_path or not len(self.samples)
        return restore_path(self.parameters) if is_followed else None

    @property
    def first_row(self) -> str:
        """Kind of row that defines time zero: `sample`, or else `pose`, or else `command`."""
        return "sample" if len(self.samples) else "pose" if len(self.poses) else "command"

    @property
    def start_ns(self) -> int:
        """Time zero of metrics, windows and alignment [ns]: the first sample, or else first pose.

        For a run without poses, time zero is the first command.
        """
        columns = (self.samples, self.poses, self.commands)
        return next(int(column.time_ns[0]) for column in columns if len(column))

    @property
    def source_start_ns(self) -> int:
        """Time zero on the clock of the source's poses [ns]; 0 if unknown, as in simulations."""
        start_ns, clock = self.origin.start_ns, self.clock
        is_stamped = clock is not None and clock.used == "stamp"
        offset_s = (clock.offset_s if clock and is_stamped else None) or 0.0
        return 0 if start_ns is None else start_ns - round(offset_s * 1e9)

    @property
    def begin_ns(self) -> int:
        """Time of the first row of any column [ns]."""
        columns = (self.poses, self.samples, self.commands)
        return int(min(column.time_ns[0] for column in columns if len(column)))

    @property
    def end_ns(self) -> int:
        """Time of the last row of any column [ns]."""
        columns = (self.poses, self.samples, self.commands)
        return int(max(column.time_ns[-1] for column in columns if len(column)))

    @property
    def is_complete(self) -> bool:
        """Whether the controller ended the run itself."""
        return self.stop_reason is not None and self.stop_reason not in CUT_SHORT

    @property
    def is_lawless(self) -> bool:
        """Whether the controller is unknown, as for a third-party bag: no samples and no loops."""
        return not len(self.samples) and not self.declaration.loops

    @property
    def duration_s(self) -> float:
        """The metric `run.duration` [s]: from the first sample, or else pose, to the last row."""
        return (self.end_ns - self.start_ns) / 1e9

    def slice(self, start_s: float | None = None, end_s: float | None = None) -> "Run":
        """Return the rows in a time segment, including both ends, as a new run.

        Times are not shifted. If the end is cut off, the slice has no stop reason, and its
        parameters no longer determine the slice: `explain` identifies the scenario from the
        samples.

        Args:
            start_s: Time since the first sample [s]; None: from the beginning.
            end_s: End of the slice [s]; None: the end of the run.

        Raises:
            RunError: If no pose was recorded in the segment.
        """
        start_ns, end_ns = locate_stretch(self, start_s, end_s)
        if start_ns <= self.poses.time_ns[0] and end_ns >= self.end_ns:
            return self
        first_s, last_s = ((time_ns - self.start_ns) / 1e9 for time_ns in (start_ns, end_ns))
        note = {"slice": f"{first_s:g} to {last_s:g} s after the first sample of its run"}
        part = slice_run(self, start_ns=start_ns, end_ns=end_ns)
        return replace(part, notes={**self.notes, **note})

    def to_arrow(self, table: str = "poses") -> Any:
        """Return a table of this run as a `pyarrow.Table`; `polars.from_arrow` reads it.

        The metadata of each column contains its `unit`; the table's metadata contain the run's
        name, goal and scenario.

        Args:
            table: `poses`, `commands`, `samples` or `events`.

        Raises:
            RunError: If there is no such table.
            LibraryError: If pyarrow is not installed.
        """
        return next(iterate_arrow(self, table))

    def to_pandas(self, table: str = "poses") -> Any:
        """Return a table of this run as a `pandas.DataFrame`; pandas must be installed separately.

        The `attrs` of the table contain the `units` of the columns and, under `turtlelog`, the
        run's name, goal and scenario.

        Args:
            table: `poses`, `commands`, `samples` or `events`.

        Raises:
            RunError: If there is no such table.
            LibraryError: If pandas is not installed.
        """
        return build_pandas(self, table)

    def to_xarray(self, table: str = "poses") -> Any:
        """Return a table of this run as an `xarray.Dataset`; xarray must be installed separately.

        The dimension of the dataset is `time_s`, the time from the first sample [s]:
        `sel(time_s=5.0, method="nearest")` selects the pose nearest to 5 s. Several samples may
        have the same time. The `attrs` of each variable contain its `units`; the `attrs` of the
        dataset contain the run's name, goal and scenario.

        Args:
            table: `poses`, `commands`, `samples` or `events`.

        Raises:
            RunError: If there is no such table.
            LibraryError: If xarray is not installed.
        """
        return build_xarray(self, table)

    def __arrow_c_stream__(self, requested_schema: Any = None) -> Any:
        """Return the poses as an Arrow stream for polars, Arrow and pandas."""
        return self.to_arrow().__arrow_c_stream__(requested_schema)

    def equals(self, other: object) -> bool:
        """Return whether another run has the same values; `==` compares identity only.

        All fields are compared, including the name and the notes; columns bit for bit.
        """
        return isinstance(other, Run) and all(
            _is_same(getattr(self, one.name), getattr(other, one.name)) for one in fields(self)
        )

    def __repr__(self) -> str:
        rows = display.describe_count(len(getattr(self, f"{self.first_row}s")), self.first_row)
        ended = self.stop_reason or "end not recorded"
        return display.fit_line(f"<Run {self.name}: {rows}, {self.duration_s:.1f} s, {ended}>")

    def _describe_end(self) -> str:
        ended = (self.stop_reason or "its end is not recorded").replace("_", " ")
        end = find_goal_end(self)
        how = f"{self.duration_s:.4g} s" if end is None else end.describe()
        return f"{self.name}: {how}, {ended}."

    def _repr_html_(self) -> str:
        goal = None if self.goal_xy_m is None else "({:g}, {:g}) m".format(*self.goal_xy_m)
        spans = ", ".join(describe_phase_lengths(self.find_phase_spans()))
        counts = [display.describe_count(len(getattr(self, name)), name[:-1]) for name in TABLES]
        rows = [
            ("source", self.source),
            ("goal", goal or "not recorded"),
            ("phases", spans or "none"),
            ("rows", ", ".join(counts)),
            ("not recorded", ", ".join(self.absent) or "nothing"),
        ]
        picture = (
            display.format_path_svg(self.poses.xy_m, self.goal_xy_m) if len(self.poses) else ""
        )
        return display.format_notebook(self._describe_end(), picture, display.format_html(rows))

    def find_phase_spans(self) -> tuple[PhaseSpan, ...]:
        """Return the phases in order; a longer time without samples after a phase is a `pause`.

        It is longer than 1.5 sampling periods: after one period, the next phase simply begins.
        If a run ends while its controller is blocked, the last phase is this pause.
        """
        return find_phase_spans(self)


def require_run(run: object, name: str = "run") -> None:
    """Raise a RunError for an argument that is not a run; the message says what returns a run."""
    if isinstance(run, Run):
        return
    advice = ""
    if isinstance(run, str | os.PathLike):
        advice = "; read_run reads a file, simulate_run simulates a preset"
    elif type(run).__name__ == "Scenario":
        advice = "; simulate_run simulates a scenario"
    raise RunError(f"{name}: expected a Run, found {run!r:.60}{advice}")


def list_runs(runs: object) -> list[Run]:
    """Return one run, or the runs of any iterable, as a list.

    Raises:
        RunError: If an item is not a run.
    """
    if isinstance(runs, str | os.PathLike) or not isinstance(runs, Iterable):
        require_run(runs, "runs")
        runs = [runs]
    listed = [*runs]
    for number, run in enumerate(listed):
        require_run(run, f"runs[{number}]")
    return listed


def _is_same(one: Any, other: Any) -> bool:
    if type(one) is not type(other):
        return False
    if isinstance(one, np.ndarray):
        same_kind = (one.dtype, one.shape) == (other.dtype, other.shape)
        return bool(same_kind and one.tobytes() == other.tobytes())
    if isinstance(one, Columns):
        return all(_is_same(getattr(one, at.name), getattr(other, at.name)) for at in fields(one))
    return bool(one == other)


def _is_finite(value: object) -> bool:
    return isinstance(value, int | float | np.floating) and math.isfinite(value)


LAW: Final = "law"
"""Entry for a law that is not built in: a digest of its code."""

_WORDS: Final = {"python": "Python", "numpy": "NumPy", "platform": ""}
"""Words for the entries; a platform needs no word, and `turtlelog` is one itself."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SoftwareChange:
    """An entry of `Run.simulated_by` that differs between two runs.

    Attributes:
        name: Name of the entry: `turtlelog`, `python`, `numpy`, `platform` or `law`.
        first: Value in the first run; None if that run has no such entry.
        second: Value in the second run; None if that run has no such entry.
    """

    name: str
    first: str | None
    second: str | None


def list_software_changes(
    first: Mapping[str, str], second: Mapping[str, str]
) -> tuple[SoftwareChange, ...]:
    """Return the entries that differ between two runs; empty if one run names no software."""
    if not first or not second:
        return ()
    return tuple(
        SoftwareChange(name=name, first=first.get(name), second=second.get(name))
        for name in {**first, **second}
        if first.get(name) != second.get(name)
    )


def describe_software(software: Mapping[str, str]) -> str:
    """Return versions and platform: `turtlelog 0.1.0, Python 3.12.3, NumPy 2.1.3, Linux x86_64`."""
    return ", ".join(_name(name, text) for name, text in software.items() if name != LAW)


def describe_changes(changes: Sequence[SoftwareChange]) -> str:
    """Return the differences as text, versions with both values: `NumPy 2.1.3, then 2.2.0`."""
    return "; ".join(
        "the code of the law"
        if one.name == LAW
        else _name(one.name, f"{one.first or 'unknown'}, then {one.second or 'unknown'}")
        for one in changes
    )


def _name(name: str, text: str) -> str:
    return f"{_WORDS.get(name, name)} {text}".strip()
