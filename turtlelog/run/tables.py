"""A run as flat tables, in slices and in phases; values usable as tables by Arrow and pandas."""

import json
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from itertools import zip_longest
from numbers import Real
from typing import TYPE_CHECKING, Any, Final, NoReturn

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import RunError
from turtlelog.libraries import load_library
from turtlelog.run.columns import PAIRS, Columns, take_rows
from turtlelog.run.loops import PAUSE, format_declaration

if TYPE_CHECKING:
    from turtlelog.run.run import Run


Table = Mapping[str, NDArray[Any]]
"""Columns by name, all of one length: float64, int64, or objects for text."""

_UNITS: Final = {"_rad_s": "rad/s", "_m_s": "m/s", "_rad": "rad", "_ns": "ns", "_m": "m"}
"""Units by the end of a column's name, the longest end first."""


def _flatten(columns: Columns) -> Table:
    table: dict[str, NDArray[Any]] = {}
    for column in fields(columns):
        name, values = column.name, getattr(columns, column.name)
        if values is None or name == "states":
            continue
        if name in PAIRS:
            table |= zip(PAIRS[name], values.T, strict=True)
        else:
            table[name] = values
    return table


def _tabulate_samples(run: "Run") -> Table:
    labels = np.array(run.phase_names, dtype=object)
    table = dict(_flatten(run.samples)) | {"phase": labels[run.samples.phase]}
    states = () if run.samples.states is None else run.samples.states.T
    for name, values in zip(run.declaration.states, states, strict=True):
        table[name if name not in table else f"state_{name}"] = values
    return table


def _tabulate_events(run: "Run") -> Table:
    kinds = {"time_ns": np.int64, "kind": object, "text": object}
    return {
        name: np.array([getattr(event, name) for event in run.events], dtype=kind)
        for name, kind in kinds.items()
    }


TABLES: Final[Mapping[str, Callable[["Run"], Table]]] = {
    "poses": lambda run: _flatten(run.poses),
    "commands": lambda run: _flatten(run.commands),
    "samples": _tabulate_samples,
    "events": _tabulate_events,
}
"""Functions that make the tables of a run, by name."""


def tabulate_run(run: "Run", table: str) -> Table:
    """Return a table of a run: `poses`, `commands`, `samples` or `events`.

    A column that was not recorded is left out. The table of samples contains phase names and a
    column for each state of the law. A state with the name of another column gets the prefix
    `state_`.

    Raises:
        RunError: If there is no such table.
    """
    if table not in TABLES:
        raise RunError(f"table: expected one of {', '.join(TABLES)}, found {table}")
    return TABLES[table](run)


def list_units(run: "Run", table: str) -> dict[str, str]:
    """Return the units of a table's columns by name; counts and texts have no unit."""
    columns = _flatten(run.samples) if table == "samples" else tabulate_run(run, table)
    found = {name: [u for end, u in _UNITS.items() if name.endswith(end)] for name in columns}
    states = run.declaration.state_units if table == "samples" else {}
    return {name: units[0] for name, units in found.items() if units} | dict(states)


def list_facts(run: "Run") -> dict[str, str]:
    """Return the facts of a run that its tables do not contain, as texts or JSON by name."""
    # `scenario` contains the known parameters by dotted key, `declaration` the declaration of the
    # law.
    goal = None if run.goal_xy_m is None else [*run.goal_xy_m, run.goal_heading_rad]
    described = {
        "goal_m_m_rad": goal,
        "scenario": dict(run.parameters),
        "scenario_is_complete": run.scenario_is_complete,
        "stop_reason": run.stop_reason,
        "clock": None if run.clock is None else asdict(run.clock),
        "simulated_by": dict(run.simulated_by) or None,
    }
    declaration = format_declaration(run.declaration)
    return {"name": run.name, "source": run.source, "declaration": declaration} | {
        name: json.dumps(value) for name, value in described.items() if value is not None
    }


def iterate_arrow(run: "Run", table: str, most_rows: int | None = None) -> Iterator[Any]:
    """Yield a table of a run as `pyarrow.Table`s with a limited number of rows, with units.

    Parts are built lazily; a table without rows yields one part.
    """
    columns = tabulate_run(run, table)
    pa = load_library("pyarrow")
    kinds = {"f": pa.float64(), "i": pa.int64(), "O": pa.string()}
    units = list_units(run, table)
    described = {name: {"unit": unit} for name, unit in units.items()}
    schema = pa.schema(
        [
            pa.field(name, kinds[values.dtype.kind], metadata=described.get(name))
            for name, values in columns.items()
        ],
        metadata={f"turtlelog.{key}": text for key, text in list_facts(run).items()},
    )
    rows = max(1, len(columns["time_ns"]))
    step = most_rows or rows
    for first in range(0, rows, step):
        part = {name: values[first : first + step] for name, values in columns.items()}
        yield pa.table(part, schema=schema)


def build_pandas(run: "Run", table: str) -> Any:
    """Return a table of a run as a `pandas.DataFrame`; `attrs` contain the units and the run."""
    columns = tabulate_run(run, table)
    frame = load_library("pandas").DataFrame(dict(columns))
    frame.attrs = {"turtlelog": list_facts(run), "units": list_units(run, table)}
    return frame


def build_xarray(run: "Run", table: str) -> Any:
    """Return a table of a run as an `xarray.Dataset` over the time from the first sample [s]."""
    columns, units = tabulate_run(run, table), list_units(run, table)
    described = {
        name: ("time_s", values, {"units": units[name]} if name in units else {})
        for name, values in columns.items()
    }
    time_s = ("time_s", (columns["time_ns"] - run.start_ns) / 1e9, {"units": "s"})
    xarray = load_library("xarray")
    return xarray.Dataset(described, coords={"time_s": time_s}, attrs=list_facts(run))


class Tabular(ABC):
    """Base class of values that pandas, polars and Arrow read as a table with units.

    `polars.DataFrame(value)`, `pyarrow.table(value)` and `pandas.DataFrame.from_arrow(value)` read
    such a value through the Arrow protocol. `pandas.DataFrame(value)` does not use this protocol
    and raises an error; use `value.to_pandas()`.
    """

    __slots__ = ()

    @abstractmethod
    def _tabulate(self) -> Mapping[str, Any]:
        """Return the columns by name, of one length: arrays, or lists with None if missing."""

    def _list_units(self) -> Mapping[str, str]:
        """Return the units of columns by name."""
        return {}

    def to_pandas(self) -> Any:
        """Return the table as a `pandas.DataFrame`; its `attrs` contain the `units` of its columns.

        Raises:
            LibraryError: If pandas is not installed. turtlelog does not install pandas.
        """
        columns = self._tabulate()
        frame = load_library("pandas").DataFrame(
            {name: _list_rows(cells) for name, cells in columns.items()}
        )
        frame.attrs = {"units": dict(self._list_units())}
        return frame

    def to_arrow(self) -> Any:
        """Return the table as a `pyarrow.Table`; the metadata of a column contain its `unit`.

        Raises:
            LibraryError: If pyarrow is not installed.
        """
        pa = load_library("pyarrow")
        units = self._list_units()
        arrays = {name: pa.array(_list_rows(cells)) for name, cells in self._tabulate().items()}
        fields = [
            pa.field(name, cells.type, metadata={"unit": units[name]} if name in units else None)
            for name, cells in arrays.items()
        ]
        return pa.table([*arrays.values()], schema=pa.schema(fields))

    def __arrow_c_stream__(self, requested_schema: Any = None) -> Any:
        """Return the table as an Arrow stream for polars, Arrow and pandas."""
        return self.to_arrow().__arrow_c_stream__(requested_schema)


def refuse_array(value: object) -> NoReturn:
    """Refuse conversion to a numpy array: numpy and pandas would read the column names as data."""
    kind = type(value).__name__
    raise TypeError(f"{kind} is a table, not an array: to_pandas() and to_arrow() return it")


def _list_rows(cells: Any) -> Any:
    return list(cells) if getattr(cells, "ndim", 1) > 1 else cells


def slice_run(run: "Run", *, start_ns: int | None = None, end_ns: int | None = None) -> "Run":
    """Return the rows of a run in [start_ns, end_ns]. The segment must contain a pose.

    Samples whose pose is outside the segment are dropped. The stop reason is dropped if the end is
    cut off. Times and sequence numbers do not change. If a row is missing, the parameters no longer
    determine the run.
    """
    start_ns = int(run.poses.time_ns[0]) if start_ns is None else start_ns
    end_ns = run.end_ns if end_ns is None else end_ns
    first = int(np.searchsorted(run.poses.time_ns, start_ns, side="left"))
    after = int(np.searchsorted(run.poses.time_ns, end_ns, side="right"))
    first = min(first, len(run.poses) - 1)
    after = max(after, first + 1)
    read = run.samples.pose_sequence
    kept = _select(run.samples.time_ns, start_ns, end_ns) & (read >= first) & (read < after)
    samples = take_rows(run.samples, kept)
    is_whole = first == 0 and end_ns >= run.end_ns
    return replace(
        run,
        scenario_is_complete=run.scenario_is_complete and is_whole,
        stop_reason=run.stop_reason if end_ns >= run.end_ns else None,
        poses=take_rows(run.poses, slice(first, after)),
        commands=take_rows(run.commands, _select(run.commands.time_ns, start_ns, end_ns)),
        samples=replace(samples, pose_sequence=samples.pose_sequence - first),
        events=tuple(event for event in run.events if start_ns <= event.time_ns <= end_ns),
    )


def locate_stretch(run: "Run", start_s: float | None, end_s: float | None) -> tuple[int, int]:
    """Convert a segment relative to the run's time zero, which must have poses, to [ns, ns]."""
    for name, value in (("start_s", start_s), ("end_s", end_s)):
        if value is not None and not (isinstance(value, Real) and math.isfinite(value)):
            raise RunError(f"{name}: expected a time in s, found {value!r:.60}")
    poses_ns = run.poses.time_ns
    if not len(poses_ns):
        raise RunError("slice: expected a run with poses, found commands alone")
    start_ns = int(poses_ns[0]) if start_s is None else run.start_ns + round(start_s * 1e9)
    end_ns = run.end_ns if end_s is None else run.start_ns + round(end_s * 1e9)
    if start_s is not None and end_s is not None and end_s < start_s:
        raise RunError(f"end_s: expected start_s = {start_s:g} or later, found {end_s:g}")
    if not ((poses_ns >= start_ns) & (poses_ns <= end_ns)).any():
        first_s, last_s = ((int(time) - run.start_ns) / 1e9 for time in (poses_ns[0], poses_ns[-1]))
        found = f"{(start_ns - run.start_ns) / 1e9:g} to {(end_ns - run.start_ns) / 1e9:g} s"
        raise RunError(
            f"slice: expected a segment with poses, which are from {first_s:g} to {last_s:g} s,"
            f" found {found}"
        )
    return start_ns, end_ns


def _select(time_ns: NDArray[np.int64], start_ns: int, end_ns: int) -> NDArray[np.bool_]:
    return np.asarray((time_ns >= start_ns) & (time_ns <= end_ns))


@dataclass(frozen=True, slots=True, kw_only=True)
class PhaseSpan:
    """A segment of time in one phase, [start_ns, end_ns].

    Attributes:
        phase: Name of the phase.
        start_ns: Time of the first sample in the phase [ns]; for a pause, of the last sample before
            the pause.
        end_ns: Start time of the next span, or end time of the run [ns].
    """

    phase: str
    start_ns: int
    end_ns: int


def describe_phase_lengths(spans: Sequence[PhaseSpan]) -> Iterator[str]:
    """Yield the length of each phase with its pause, as metrics count it."""
    for span, after in zip_longest(spans, spans[1:]):
        if span.phase == PAUSE:
            continue
        is_paused = after is not None and after.phase == PAUSE
        last = after if after is not None and is_paused else span
        text = f"{span.phase} {(last.end_ns - span.start_ns) / 1e9:.4g} s"
        pause_s = (last.end_ns - span.end_ns) / 1e9
        yield f"{text} with its pause of {pause_s:.3g} s" if is_paused else text


_SILENT: Final = 1.5
"""Shortest pause, in sampling periods: above one period and its jitter, below two periods."""


def find_phase_spans(run: "Run", *, has_all: bool = False) -> tuple[PhaseSpan, ...]:
    """Return the phases of a run in order, as `Run.find_phase_spans` describes them.

    With `has_all`, every time between the samples of two phases is a pause, as in recordings.
    """
    phase, time_ns, names = run.samples.phase, run.samples.time_ns, run.phase_names
    if not len(phase):
        return ()
    firsts = [0, *(np.flatnonzero(np.diff(phase)) + 1).tolist()]
    afters = [*firsts[1:], len(phase)]
    ends_ns = [*time_ns[firsts[1:]].tolist(), run.end_ns]
    least_ns = _SILENT * _find_period(run) if len(firsts) > 1 and not has_all else 0.0
    spans = []
    for first, after, end_ns in zip(firsts, afters, ends_ns, strict=True):
        name, start_ns = names[phase[first]], int(time_ns[first])
        last_ns = int(time_ns[after - 1])
        is_paused = end_ns - last_ns >= least_ns if after < len(phase) else ends_blocked(run)
        if is_paused:
            spans.append(PhaseSpan(phase=name, start_ns=start_ns, end_ns=last_ns))
            name, start_ns = PAUSE, last_ns
        spans.append(PhaseSpan(phase=name, start_ns=start_ns, end_ns=end_ns))
    return tuple(spans)


def _find_period(run: "Run") -> float:
    """Return the median sampling period within phases [ns]; of poses if no phase has two samples.

    The time between two phases is left out: it is the pause, if there is one.
    """
    samples = run.samples
    apart_ns = np.diff(samples.time_ns)[np.diff(samples.phase) == 0]
    if not len(apart_ns):
        apart_ns = np.diff(run.poses.time_ns)
    return float(np.median(apart_ns)) if len(apart_ns) else 0.0


def ends_blocked(run: "Run") -> bool:
    """Return whether the last sample's command was published after its time, or never."""
    published, answered = run.commands.time_ns, run.samples.time_ns
    if len(published) < len(answered):
        return run.end_ns > int(answered[-1])
    return len(published) == len(answered) and bool(published[-1] > answered[-1])
