"""Short summaries of runs: conditions, results and ends, of runs or file by file."""

import sys
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache, partial
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from turtlelog import measure
from turtlelog.compare.ranking import Conditions, find_conditions
from turtlelog.display import fit_line, format_short, join_words
from turtlelog.errors import CompareError, TurtlelogError, release_frames
from turtlelog.log import NOTES, ReadChoice, read_as_chosen
from turtlelog.measure import MeasureSettings, Metric, Metrics
from turtlelog.measure.metric import Status
from turtlelog.processes import map_in_processes
from turtlelog.run import Origin, Parameter, Run, SourceKind, find_source_kind, require_run
from turtlelog.run.loops import Declaration
from turtlelog.run.stop_reasons import GoalEnd, describe_wall, find_goal_end

if TYPE_CHECKING:
    from concurrent.futures import Executor


TEXTS: Final = ("name", "source", "stop_reason")
"""Texts that filters and orders may use in addition to parameters and metrics."""


HOLDINGS: Final[Mapping[str, Callable[[Run], bool]]] = MappingProxyType(
    {
        "poses": lambda run: len(run.poses) > 0,
        "commands": lambda run: len(run.commands) > 0,
        "goal": lambda run: run.goal_xy_m is not None,
        "samples": lambda run: len(run.samples) > 0,
        "rates": lambda run: (
            {run.poses.measured_speed_m_s is None, run.poses.speed_m_s is None} != {True}
        ),
    }
)
"""Data that metrics need: poses, samples of a controller, commands, a goal, reported rates."""


_RATES: Final = ("speed_m_s", "measured_speed_m_s", "measured_turn_rate_rad_s")
"""Columns of poses with rates that a robot reports."""


def list_lacks(run: Run) -> tuple[str, ...]:
    """Return the elements of `HOLDINGS` that a run lacks."""
    return tuple(name for name, holds in HOLDINGS.items() if not holds(run))


@dataclass(frozen=True, slots=True, kw_only=True)
class RunSummary:
    """A run without its columns, so that thousands fit into memory. A summary can be pickled.

    Attributes:
        name: Name of the run.
        source: Source of the run, as in `Run`.
        law: Kind of the law; None if unknown.
        stop_reason: Stop reason, as in `Run`.
        parameters: Parameters by dotted key (`law.kp_linear`).
        metrics: Metrics by id.
        file: File from which the run was read; empty if unknown.
        origin: Origin, as in `Run`.
        notes: Notes, as in `Run`, and one on jumps that the path length contains.
        declaration: Declaration of the law, as in `Run`.
        lacks: Elements of `HOLDINGS` that the run lacks.
        reports_rate: Whether the robot reports at least one of its rates.
        conditions: Conditions that must agree before runs are ranked; None: unknown.
        goal_end: End of the run at its goal; None without poses or a goal.
    """

    name: str
    source: str
    law: str | None = None
    stop_reason: str | None
    parameters: Mapping[str, Parameter]
    metrics: Mapping[str, Metric]
    file: str = ""
    origin: Origin = field(default_factory=Origin)
    notes: Mapping[str, str] = field(default_factory=dict)
    declaration: Declaration = field(default_factory=Declaration)
    lacks: tuple[str, ...] = ()
    reports_rate: bool = False
    conditions: Conditions | None = None
    goal_end: GoalEnd | None = None

    def __post_init__(self) -> None:
        for name in ("parameters", "metrics", "notes"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))

    def __reduce__(self) -> tuple[Any, tuple[dict[str, Any]]]:
        values = {found.name: getattr(self, found.name) for found in fields(self)}
        packed = {
            "parameters": dict(self.parameters),
            "notes": dict(self.notes),
            "metrics": [
                (key, one.id, one.value, one.unit, one.status.value, one.reason, one.at_s)
                for key, one in self.metrics.items()
            ],
        }
        return _rebuild, (values | packed,)

    @property
    def is_lawless(self) -> bool:
        """Whether the controller of the run is unknown, as for a third-party bag."""
        return "samples" in self.lacks and not self.declaration.loops

    def find_value(self, name: str) -> Parameter | None:
        """Return a parameter, a metric's value, `name`, `source` or `stop_reason`; else None."""
        if name in TEXTS:
            text: str | None = getattr(self, name)
            return text
        metric = self.find_metric(name)
        return self.parameters.get(name) if metric is None else metric.value

    def find_metric(self, name: str) -> Metric | None:
        """Return a metric. The metric of an undeclared loop has the status `no_phase`.

        The result is None if the metric was not measured, or if the id belongs to a parameter.
        """
        if name in self.metrics or name in measure.list_metrics(self.declaration):
            return self.metrics.get(name)
        is_metric = name not in self.parameters and measure.find_metric_kind(name) is not None
        return measure.miss_metric(self.declaration, name) if is_metric else None

    def __repr__(self) -> str:
        ended = self.stop_reason or "end not recorded"
        return fit_line(f"<RunSummary {self.name}: {len(self.metrics)} metrics, {ended}>")

    def _repr_html_(self) -> str:
        first = measure.list_essential_metrics(self.declaration)
        return Metrics(self.metrics.items(), first=first)._repr_html_()


_MOST_NAMED: Final = 3
"""Largest number of runs that a clause names."""


def describe_reached(summaries: Sequence[RunSummary]) -> str:
    """Return which runs reach the goal, as a clause; empty if the tolerances of one are unknown."""
    ends = [(one.name, one.goal_end) for one in summaries if one.goal_end is not None]
    if not ends or len(ends) < len(summaries) or any(end.verdict == "ended" for _, end in ends):
        return ""
    names = [name for name, end in ends if end.verdict == "reached"]
    if len(names) in {0, len(ends)}:
        return "all reach the goal" if names else "none reaches the goal"
    if len(names) > _MOST_NAMED:
        return f"{len(names)} of {len(ends)} reach the goal"
    return f"only {join_words(names)} {'reaches' if len(names) == 1 else 'reach'} the goal"


def complete_parameters(run: Run) -> Mapping[str, Parameter]:
    """Return the parameters of a run, including defaults that files leave out.

    Defaults are unknown if the run does not contain its whole scenario, or if its law is not built
    in.
    """
    from turtlelog.laws import ABSENT_BY_DEFAULT, LAWS  # who only measures spares them
    from turtlelog.scenario import Start

    kind = run.parameters.get("law.kind")
    if not run.scenario_is_complete or kind not in LAWS:
        return run.parameters
    defaults: dict[str, Any] = {
        f"{table}.{found.name}": found.default
        for table, values in (("start", Start), ("law", LAWS[str(kind)].Parameters))
        for found in fields(values)
        if found.metadata.keys() & ABSENT_BY_DEFAULT.keys() and found.default is not None
    }
    absent = {key: value for key, value in defaults.items() if key not in run.parameters}
    return {**run.parameters, **absent}


def _rebuild(values: dict[str, Any]) -> RunSummary:
    # What thousands of runs have in common is in memory once, though each was pickled alone.
    named: dict[str, Any] = {
        "parameters": {
            sys.intern(key): _share(one) if isinstance(one, str) else one
            for key, one in values["parameters"].items()
        },
        "metrics": {
            sys.intern(key): Metric(
                id=sys.intern(name),
                value=value,
                unit=sys.intern(unit),
                status=Status(status),
                reason=_share(reason),
                at_s=at_s,
            )
            for key, name, value, unit, status, reason, at_s in values["metrics"]
        },
        **{name: _share(values[name]) for name in ("declaration", "conditions", "origin")},
    }
    return RunSummary(**values | named)


_share: Callable[[Any], Any] = lru_cache(maxsize=1024)(lambda value: value)


def summarise_run(
    run: Run, *, file: str = "", metrics: Mapping[str, Metric] | None = None
) -> RunSummary:
    """Return the summary of a run; `metrics` are its metrics if they are already measured."""
    require_run(run)
    return summarise_measured(run, file, measure.measure_run(run) if metrics is None else metrics)


def summarise_measured(
    run: Run, file: str, metrics: Mapping[str, Metric], *, with_parameters: bool = True
) -> RunSummary:
    """Return the summary of a run, with all its parameters or with its gains only."""
    known = complete_parameters(run) if with_parameters else run.parameters
    gains, wall = run.declaration.list_gains(), describe_wall(run)
    return RunSummary(
        name=run.name,
        source=run.source,
        law=None if (law := run.parameters.get("law.kind")) is None else str(law),
        stop_reason=run.stop_reason,
        parameters=known if with_parameters else {key: known[key] for key in gains if key in known},
        metrics=metrics,
        file=file,
        origin=run.origin,
        notes={
            **run.notes,
            **_describe_poses(run, metrics),
            **_describe_since(run),
            **({"wall": wall} if wall else {}),
        },
        declaration=run.declaration,
        lacks=list_lacks(run),
        reports_rate=any(getattr(run.poses, name) is not None for name in _RATES),
        conditions=find_conditions(run, known) if len(run.poses) else None,
        goal_end=find_goal_end(run),
    )


def _describe_since(run: Run) -> dict[str, str]:
    """Return a note on when the goal and the path were given, if that was during the run."""
    if not run.is_lawless or not len(run.poses):
        return {}
    goal_row = 0 if run.goal_xy_m is None else run.goal_row
    rows = {"goal": goal_row, "path": 0 if run.path is None else run.path_row}
    times_s = {name: (run.poses.time_ns[row] - run.start_ns) / 1e9 for name, row in rows.items()}
    said = [f"the {name} given at {at_s:.1f} s" for name, at_s in times_s.items() if rows[name]]
    return {"counts_since": join_words(said)} if said else {}


def _describe_poses(run: Run, metrics: Mapping[str, Metric]) -> dict[str, str]:
    if run.poses.speed_m_s is not None:
        return {}
    from turtlelog.measure.pose_quality import describe_poses  # only bags need it

    return describe_poses(run, metrics)


Choice = Collection[str] | Callable[[Run], Collection[str]] | None
"""Metrics to compute: ids and patterns, or a function that returns the metrics of a run. None: all
metrics."""


def summarise_files(
    paths: Sequence[str | Path],
    settings: MeasureSettings | None = None,
    *,
    only: Choice = None,
    topics: ReadChoice | None = None,
    jobs: "int | Executor" = 1,
    with_parameters: bool = True,
) -> Iterator[RunSummary | TurtlelogError]:
    """Yield the summary of every file in the given order, or the error if it cannot be read.

    Each process has one run at a time in memory.

    Args:
        paths: Any files that `read_run` takes.
        settings: Settings of the metrics, as in `measure_run`.
        only: Metrics, as in `measure_run`; a pattern selects the metrics that each run has. A
            function may choose the metrics of each run.
        topics: Topics to read from bags, the same for all files.
        jobs: Number of processes, at least 1, or a pool. Processes import the main module: a script
            that uses several processes keeps its own work under `if __name__ == "__main__":`.
        with_parameters: Whether summaries contain all parameters, which are half of their size, or
            only the gains.

    Raises:
        MeasureError: If `only` names no metric.
        CompareError: If `jobs` is not a number of processes.
    """
    if isinstance(jobs, int) and jobs < 1:
        raise CompareError(f"jobs: expected at least 1 process, found {jobs}")
    if only is not None and not callable(only):
        measure.choose_metrics(only, Declaration())  # refuses what names no metric of any law
        only = (only,) if isinstance(only, str) else tuple(only)
    measure_file = partial(
        _measure_file,
        settings=settings,
        only=only,
        topics=topics or ReadChoice(),
        with_parameters=with_parameters,
    )
    return map_in_processes(measure_file, [str(path) for path in paths], jobs)


def _measure_file(
    path: str,
    *,
    settings: MeasureSettings | None,
    only: Choice,
    topics: ReadChoice,
    with_parameters: bool,
) -> RunSummary | TurtlelogError:
    try:
        run = read_as_chosen(path, topics)
    except TurtlelogError as err:
        return release_frames(err)
    chosen = only(run) if callable(only) else only
    metrics = measure.measure_run(run, settings, only=chosen)
    return summarise_measured(run, path, metrics, with_parameters=with_parameters)


def complete_summaries(
    summaries: Sequence[RunSummary],
    settings: MeasureSettings | None = None,
    *,
    topics: ReadChoice | None = None,
) -> tuple[RunSummary, ...]:
    """Return runs with all metrics of `final` and `run` that any of the runs has.

    If third-party bags are compared with runs of a law, the files are read again; otherwise nothing
    changes.
    """
    if len({found.is_lawless for found in summaries}) < 2:
        return tuple(summaries)
    ids = dict.fromkeys(name for found in summaries for name in found.metrics)
    shared = [name for name in ids if name.partition(".")[0] in {"final", "run"}]
    completed = []
    for found in summaries:
        lacking = [name for name in shared if name not in found.metrics]
        if lacking:
            run = read_as_chosen(found.file, topics or ReadChoice())
            more = measure.measure_run(run, settings, only=lacking)
            completed.append(replace(found, metrics={**found.metrics, **more}))
        else:
            completed.append(found)
    return tuple(completed)


def list_unlocks(summaries: Sequence[RunSummary]) -> list[str]:
    """Return which inputs would add metrics, if all runs are third-party bags without them."""
    if not summaries or not all(found.is_lawless for found in summaries):
        return []
    is_table = all(find_source_kind(found.source) is SourceKind.TABLE for found in summaries)
    unlocks = {**UNLOCKS, "commands": _COMMAND_COLUMN} if is_table else UNLOCKS
    return [
        f"No {unlock}."
        for lack, unlock in unlocks.items()
        if all(lack in one.lacks and can_unlock(lack, one.lacks) for one in summaries)
    ]


def can_unlock(lack: str, lacks: Sequence[str]) -> bool:
    """Return whether adding a missing input would help: a goal needs poses."""
    return lack != "goal" or "poses" not in lacks


UNLOCKS: Final = MappingProxyType(
    {
        "poses": "poses: a recorded Odometry, PoseStamped or /tf adds the path, measured rates and"
        " how the robot follows its commands",
        "commands": "commands: a recorded Twist or TwistStamped (--command-topic TOPIC) adds lags,"
        " tracking errors and steps",
        "goal": "goal: --goal X,Y adds final.position_error and run.time_to_goal",
        "samples": "samples of a controller: only recordings of turtlelog have them, and with them"
        " metrics of loops",
    }
)
"""Inputs that a bag may lack, by `HOLDINGS`, and what adds the metrics that need them."""

_COMMAND_COLUMN: Final = (
    "commands: a column of set-points (--column command_speed=NAME, command_turn_rate=NAME) adds"
    " lags, tracking errors and steps"
)


def describe_end(summary: RunSummary) -> str:
    """Return place and time of a run's end; without a goal, the length of its path."""
    doubts = [kind.doubt for name, kind in NOTES.items() if name in summary.notes]
    if summary.origin.table_run is not None:
        doubts.append(", in run {} of {} in the table".format(*summary.origin.table_run))
    return f"{_describe_end(summary)}{''.join(doubts)}"


def _describe_end(summary: RunSummary) -> str:
    def show(name: str) -> str | None:
        metric = summary.metrics.get(name)
        if metric is None or metric.value is None:
            return None
        return format_short(metric.value, metric.unit)

    length, off, duration = show(_LENGTH), show(_FURTHEST), show(_DURATION)
    if "poses" in summary.lacks:
        return f"commands for {duration}, no poses"
    if summary.goal_end is not None:
        return summary.goal_end.describe()
    if off is not None and not summary.is_lawless:
        rms, along = (next(map(show, names), None) for names in _list_errors(summary))
        sizes = f"{off} at most" if rms is None else f"{rms} RMS, {off} at most"
        if along is not None and _is_further_along(summary):
            sizes = f"{sizes}, along-track error {along} at most"
        return f"cross-track error {sizes}, in {duration}"
    if length is None:
        return f"lasts {duration}"
    jumps, median, gaps = map(
        summary.notes.get, ("jumped_share", "path_without_scatter", "large_gaps")
    )
    beside = f", {jumps} of it jumps" if jumps else ""
    beside += f", {median} through the median of each second" if median else ""
    beside += "," if beside else ""
    without = f", {gaps} of it without poses" if gaps else ""
    return f"the path is {length} long{beside} and takes {duration}{without}"


_LENGTH, _FURTHEST, _DURATION = "run.path_length", "run.cross_track_max", "run.duration"


def describe_run_end(run: Run) -> str:
    """Return place and time of a run's end, as `describe_end` does; it measures what that reads."""
    furthest = [_FURTHEST] if run.path is not None else []
    errors = [name for names in _list_errors(run) for name in names]
    needed = [_LENGTH, *furthest, _DURATION, *errors]
    return describe_end(summarise_run(run, metrics=measure.measure_run(run, only=needed)))


def _list_errors(run: Run | RunSummary) -> tuple[list[str], list[str]]:
    """Return the RMS of the first loop across the track, and the largest error along the track."""
    loops = run.declaration.loops
    across = [one.name for one in loops if one.signal == "cross_track"]
    along = [one.name for one in loops if one.signal == "along_track"]
    return [f"{one}.rms_error" for one in across[:1]], [f"{one}.largest_error" for one in along[:1]]


def _is_further_along(summary: RunSummary) -> bool:
    """Return whether the largest error along the track is larger than the one across it."""
    found = [summary.metrics.get(name) for name in (*_list_errors(summary)[1], _FURTHEST)]
    along_m, across_m = [0.0 if one is None else one.value or 0.0 for one in found]
    return along_m > across_m
