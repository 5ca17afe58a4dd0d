"""Short summaries of runs for large tables: conditions and results, read file by file."""

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from fnmatch import fnmatchcase
from functools import lru_cache
from types import MappingProxyType
from typing import Any, Final

from turtlelog import expressions
from turtlelog.compare.like_loops import order_ids
from turtlelog.compare.ranking import Conditions, find_conditions
from turtlelog.display import fit_line, join_words
from turtlelog.errors import CompareError, describe_unknown
from turtlelog.measure import (
    Metric,
    Metrics,
    find_metric_kind,
    is_lawless,
    is_metric_pattern,
    list_essential_metrics,
    list_metrics,
    measure_run,
    miss_metric,
)
from turtlelog.measure.metric import Status
from turtlelog.run import Parameter, Run, require_run
from turtlelog.run.ending import GoalEnd, find_goal_end
from turtlelog.run.loops import Declaration

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


def list_lacks(run: Run) -> tuple[str, ...]:
    """Return the elements of `HOLDINGS` that a run lacks."""
    return tuple(name for name, holds in HOLDINGS.items() if not holds(run))


_MAPPINGS: Final = ("parameters", "metrics", "notes")


@dataclass(frozen=True, slots=True, kw_only=True)
class RunSummary:
    """A run without its columns, so that thousands fit into memory. A summary can be pickled.

    Attributes:
        name: Name of the run.
        source: Source of the run, as in `Run`.
        stop_reason: Stop reason, as in `Run`.
        parameters: Parameters by dotted key (`law.kp_linear`).
        metrics: Metrics by id.
        file: File from which the run was read; empty if unknown.
        notes: Notes, as in `Run`.
        declaration: Declaration of the law, as in `Run`.
        lacks: Elements of `HOLDINGS` that the run lacks.
        conditions: Conditions that must agree before runs are ranked; None: unknown.
        goal_end: End of the run at its goal; None without poses or a goal.
    """

    name: str
    source: str
    stop_reason: str | None
    parameters: Mapping[str, Parameter]
    metrics: Mapping[str, Metric]
    file: str = ""
    notes: Mapping[str, str] = field(default_factory=dict)
    declaration: Declaration = field(default_factory=Declaration)
    lacks: tuple[str, ...] = ()
    conditions: Conditions | None = None
    goal_end: GoalEnd | None = None

    def __post_init__(self) -> None:
        for name in _MAPPINGS:
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))

    def __reduce__(self) -> tuple[Any, tuple[dict[str, Any]]]:
        values = {found.name: getattr(self, found.name) for found in fields(self)}
        packed = {
            "parameters": dict(self.parameters),
            "notes": dict(self.notes),
            "metrics": [_pack(key, metric) for key, metric in self.metrics.items()],
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
        if name in self.metrics or name in list_metrics(self.declaration):
            return self.metrics.get(name)
        is_metric = name not in self.parameters and find_metric_kind(name) is not None
        return miss_metric(self.declaration, name) if is_metric else None

    def __repr__(self) -> str:
        ended = self.stop_reason or "end not recorded"
        return fit_line(f"<RunSummary {self.name}: {len(self.metrics)} metrics, {ended}>")

    def _repr_html_(self) -> str:
        first = list_essential_metrics(self.declaration)
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
        "parameters": {sys.intern(k): _share(one) for k, one in values["parameters"].items()},
        "metrics": dict(map(_unpack, values["metrics"])),
        "declaration": _share_declaration(values["declaration"]),
        "conditions": _share_conditions(values["conditions"]),
    }
    return RunSummary(**values | named)


_Packed = tuple[str, str, float | None, str, str, str, float | None]


def _pack(key: str, metric: Metric) -> _Packed:
    status = metric.status.value
    return key, metric.id, metric.value, metric.unit, status, metric.reason, metric.at_s


def _unpack(packed: _Packed) -> tuple[str, Metric]:
    key, name, value, unit, status, reason, at_s = packed
    metric = Metric(
        id=sys.intern(name),
        value=value,
        unit=sys.intern(unit),
        status=Status(status),
        reason=_share(reason),
        at_s=at_s,
    )
    return sys.intern(key), metric


def _share(value: Any) -> Any:
    """Return a shared copy of an equal text; other values unchanged."""
    return _keep_text(value) if isinstance(value, str) else value


@lru_cache(maxsize=1024)
def _keep_text(text: str) -> str:
    return text


@lru_cache(maxsize=1024)
def _share_conditions(conditions: Conditions | None) -> Conditions | None:
    return conditions


@lru_cache(maxsize=64)
def _share_declaration(declaration: Declaration) -> Declaration:
    return declaration


def summarise_run(
    run: Run, *, file: str = "", metrics: Mapping[str, Metric] | None = None
) -> RunSummary:
    """Return the summary of a run; `metrics` are its metrics if they are already measured."""
    require_run(run)
    return summarise_measured(run, file, measure_run(run) if metrics is None else metrics)


def summarise_measured(
    run: Run, file: str, metrics: Mapping[str, Metric], *, with_parameters: bool = True
) -> RunSummary:
    """Return the summary of a run, with all its parameters or with its gains only."""
    known = complete_parameters(run) if with_parameters else run.parameters
    return RunSummary(
        name=run.name,
        source=run.source,
        stop_reason=run.stop_reason,
        parameters=known if with_parameters else _take_gains(run, known),
        metrics=metrics,
        file=file,
        notes=run.notes,
        declaration=run.declaration,
        lacks=list_lacks(run),
        conditions=find_conditions(run, known) if len(run.poses) else None,
        goal_end=find_goal_end(run),
    )


def _take_gains(run: Run, known: Mapping[str, Parameter]) -> Mapping[str, Parameter]:
    return {key: known[key] for key in run.declaration.list_gains() if key in known}


def select_runs(
    summaries: Sequence[RunSummary], where: str, *, source: str = "where"
) -> tuple[tuple[RunSummary, ...], tuple[str, ...]]:
    """Return the runs for which an expression is true, and notes on runs without its values.

    Args:
        summaries: Runs to choose from.
        where: Expression over parameters, metric ids, `name`, `source` and `stop_reason`:
            `law.kp_linear >= 2 and run.duration < 20`.
        source: Beginning of error lines.

    Raises:
        ExpressionError: If the expression does not parse, or contains a name that no run has.
        CompareError: If the expression is not a condition.
    """
    expression = expressions.parse_expression(where, source=source)
    others = (name for name in expression.names if find_metric_kind(name) is not None)
    known = dict.fromkeys([*_list_names(summaries), *others])
    chosen, lacking = [], {}
    for summary in summaries:
        values = {name: summary.find_value(name) for name in known.keys() & expression.names}
        truth = expressions.evaluate_expression(expression, {**known, **values})
        if truth is None:
            lacking[summary.file or summary.name] = _describe_lack(summary, values)
        elif not isinstance(truth, bool):
            raise CompareError(f"{source}: expected a condition, found {truth!r}")
        elif truth:
            chosen.append(summary)
    notes = [f"{run} is left out: {lack}." for run, lack in lacking.items()]
    if len(notes) > _MOST_NOTES:
        more = len(notes) - _MOST_NOTES
        notes = [*notes[:_MOST_NOTES], f"{more} more are left out for lack of values."]
    return tuple(chosen), tuple(notes)


def sort_runs(
    summaries: Sequence[RunSummary], by: str, *, source: str = "sort"
) -> tuple[RunSummary, ...]:
    """Return the runs in rising order of a metric, parameter, `name`, `source` or `stop_reason`.

    Runs without a value come last; runs with equal values keep their order.

    Args:
        summaries: Runs to sort.
        by: Sort key; with a leading minus, in falling order.
        source: Beginning of error lines.

    Raises:
        CompareError: If no run has the sort key.
    """
    name = by.removeprefix("-")
    if find_metric_kind(name) is None:
        _require_name(name, _list_names(summaries), source)
    valued = [found for found in summaries if found.find_value(name) is not None]
    rest = [found for found in summaries if found.find_value(name) is None]
    valued.sort(key=lambda found: _rank(found.find_value(name)), reverse=by != name)
    return (*valued, *rest)


def choose_columns(
    summaries: Sequence[RunSummary], only: Sequence[str], *, source: str = "only"
) -> tuple[str, ...]:
    """Return the metrics and parameters that names and patterns (`translate.*`) select.

    A full name selects a metric also if none of the runs has its loop. A pattern that matches only
    loops of other laws selects nothing.

    Raises:
        CompareError: If a name or pattern is invalid, or all together select nothing.
    """
    parameters, metrics = _list_parameters(summaries), _list_ids(summaries)
    chosen: dict[str, None] = {}
    for pattern in only:
        found = [name for name in metrics if fnmatchcase(name, pattern)]
        found += [pattern] if pattern in parameters else []
        if not found and find_metric_kind(pattern) is not None:
            found = [pattern]
        if not found and not is_metric_pattern(pattern):
            _require_name(pattern, [*metrics, *parameters], source)
        chosen |= dict.fromkeys(found)
    if only and not chosen:
        asked = ", ".join(only)
        raise CompareError(f"{source}: these runs have no metric {asked}")
    return tuple(chosen)


def list_usual_of_run(run: Run | RunSummary) -> tuple[str, ...]:
    """Return the ids of the metrics that characterise a run."""
    has_no_law = run.is_lawless if isinstance(run, RunSummary) else is_lawless(run)
    return USUAL_OF_MOTION if has_no_law else list_usual_metrics(run.declaration)


def list_usual_metrics(*declarations: Declaration) -> tuple[str, ...]:
    """Return the ids of the metrics that characterise runs of these laws.

    The metrics describe the final state and the response of the loops that turn the robot; for laws
    without such loops, the response of all loops. The final position shows the response of the
    driving loops. For laws without a goal, the distance driven is included.
    """
    chosen: dict[str, None] = {}
    for declaration in declarations:
        turning = [loop.name for loop in declaration.loops if loop.command == "turn_rate"]
        loops = turning or [loop.name for loop in declaration.loops]
        essential = list_essential_metrics(declaration)
        usual = (f"{loop}.{name}" for loop in loops for name in _USUAL_OF_LOOP)
        chosen |= dict.fromkeys(name for name in usual if name in essential)
    is_free = bool(declarations) and not any(one.uses_goal for one in declarations)
    of_run = _USUAL_WITHOUT_GOAL if is_free else _USUAL_OF_RUN
    return order_ids([*chosen, *of_run], declarations)


def list_needed_metrics(
    columns: Sequence[str] = (),
    *,
    where: str | None = None,
    sort: str | None = None,
    source: str = "where",
) -> tuple[str, ...]:
    """Return ids and patterns of the metrics that a table across runs needs.

    Other metrics are not measured; the law of a run decides which of these the run has.

    Args:
        columns: Columns as for `choose_columns`; empty: the default ones.
        where: Expression as for `select_runs`.
        sort: Sort key as for `sort_runs`.
        source: Beginning of error lines.

    Raises:
        ExpressionError: If `where` does not parse; the meaning of its names is not checked.
    """
    named = [] if where is None else list(expressions.parse_expression(where, source=source).names)
    named += [] if sort is None else [sort.removeprefix("-")]
    wanted = dict.fromkeys([*(columns or _USUAL_PATTERNS), *named])
    return tuple(name for name in wanted if is_metric_pattern(name))


_MOST_NOTES: Final = 5

_USUAL_OF_LOOP: Final = ("settling_time", "overshoot", "rms_error")
_USUAL_OF_RUN: Final = ("final.heading_error", "final.position_error", "run.duration")
_USUAL_WITHOUT_GOAL: Final = ("run.duration", "run.path_length", "run.turn_rate_effort")
USUAL_OF_MOTION: Final = (
    *("final.position_error", "run.duration", "run.path_length", "run.measured_speed_max"),
    *("run.speed_lag", "run.turn_rate_lag"),
)
"""Default metrics of runs with an unknown law."""
_USUAL_PATTERNS: Final = (*(f"*.{name}" for name in _USUAL_OF_LOOP), *_USUAL_OF_RUN)
"""Patterns of the default metrics for any law, before the runs are read."""


def _list_ids(summaries: Sequence[RunSummary]) -> list[str]:
    return list(list_metrics(*(found.declaration for found in summaries)))


def _list_parameters(summaries: Sequence[RunSummary]) -> list[str]:
    return list(dict.fromkeys(name for found in summaries for name in found.parameters))


def _list_names(summaries: Sequence[RunSummary]) -> list[str]:
    return [*TEXTS, *_list_ids(summaries), *_list_parameters(summaries)]


def _require_name(name: str, known: Sequence[str], source: str) -> None:
    if name not in known:
        problem = describe_unknown("metric or parameter", name, known)
        raise CompareError(f"{source}: {problem}")


def _describe_lack(summary: RunSummary, values: Mapping[str, Any]) -> str:
    lacks = []
    for name in sorted(values):
        if values[name] is None:
            metric = summary.find_metric(name)
            lacks.append(
                f"{name} is {metric.status.value}" if metric is not None else f"{name} is not known"
            )
    return ", ".join(lacks) or "the expression has no value"


def _rank(value: Any) -> tuple[int, Any]:
    """Return a sort key that places numbers before texts."""
    return (0, value) if isinstance(value, int | float) else (1, str(value))
