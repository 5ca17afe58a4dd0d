"""Names that specifications and tests may use, and their values in a run other than metrics."""

import difflib
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from types import MappingProxyType
from typing import Final

from turtlelog.compare import TrajectorySettings, compare_trajectories
from turtlelog.errors import CheckError, CompareError, LogError
from turtlelog.expressions import (
    Expression,
    Name,
    Temporal,
    Until,
    describe_unknown_name,
    fail_at,
    iterate_nodes,
)
from turtlelog.log import ReadChoice, read_trajectory
from turtlelog.measure import (
    METRICS,
    SIGNALS,
    Metric,
    MetricKind,
    could_be_signal,
    find_metric_kind,
    list_ids_like,
    list_metrics,
    list_signals,
)
from turtlelog.measure.metric import NO_POSES, Status
from turtlelog.run import Run, Trajectory, build_planar_trajectory
from turtlelog.run.loops import DONE, NAME_PATTERN, Declaration
from turtlelog.scenario import Scenario, flatten_scenario

_ROBOT_AXES: Final = ("speed", "turn_rate")

_ROBOT_FIELDS: Final = MappingProxyType(
    {
        "gain": ("gain", "1"),
        "dead_time": ("dead_time_s", "s"),
        "time_constant": ("lag_s", "s"),
        "total_delay": ("total_delay_s", "s"),
    }
)

_INTERVAL_ENDS: Final = MappingProxyType({"": "value", ".low": "low", ".high": "high"})


ROBOT_VALUES: Final[Mapping[str, tuple[str, str, str]]] = MappingProxyType(
    {
        f"robot.{axis}.{name}{end}": (axis, name, end)
        for axis, name, end in product(_ROBOT_AXES, _ROBOT_FIELDS, _INTERVAL_ENDS)
    }
)
"""Axis, parameter and end of its 95 % interval, by the names in checks."""

_ERROR_KINDS: Final = ("ate", "rpe")


_ERROR_QUANTITIES: Final = MappingProxyType(
    {"position": ("m", 1.0), "rotation": ("deg", math.degrees(1))}
)

_STATISTICS: Final = ("rmse", "mean", "median", "std", "min", "max")


TRAJECTORY_VALUES: Final[Mapping[str, tuple[str, str, str]]] = MappingProxyType(
    {".".join(parts): parts for parts in product(_ERROR_KINDS, _ERROR_QUANTITIES, _STATISTICS)}
)
"""Error, quantity and statistic, by the names in checks."""

OTHER_VALUES: Final = frozenset({*ROBOT_VALUES, *TRAJECTORY_VALUES})
"""Values in addition to the metrics of a single run."""


@cache
def _list_parameters() -> tuple[str, ...]:
    """Return the dotted keys of scenarios; user laws have other keys."""
    return (*flatten_scenario(Scenario()), "goal.heading_rad")


def find_kind(run: Run, name: str) -> MetricKind | None:
    """Return the kind of a run's metric; None if the name is not that of a metric.

    The metric of an undeclared loop has no value, unless the name belongs to a parameter.
    """
    own = list_metrics(run.declaration).get(name)
    return own or (None if name in run.parameters else find_metric_kind(name))


def require_known_names(formula: Expression, *, over_time: bool, run: Run | None = None) -> None:
    """Raise an error for names that no run has, or that this run does not have.

    Without a run, any loop may have the existing metrics, and the parameters and states of a law
    may have any name. With `over_time`, the formula may contain signals and temporal operators.
    """
    for node in iterate_nodes(formula.root):
        if isinstance(node, Temporal | Until) and not over_time:
            word = node.operator if isinstance(node, Temporal) else "until"
            fail_at(formula, node, f"expected metrics, found {word}: it stands in holds = ...")
        if not isinstance(node, Name) or _is_known(node.name, over_time=over_time, run=run):
            continue
        signals = SIGNALS if run is None else list_signals(run.declaration)
        if node.name in signals:
            problem = f"expected a metric, found the signal {node.name}: it stands in holds = ..."
            fail_at(formula, node, problem)
        known = _list_known(node.name, over_time=over_time, run=run)
        problem = describe_unknown_name(node.name, known)
        if run is not None and over_time and could_be_signal(node.name):
            states = ", ".join(run.declaration.states) or "no states"
            problem = f"{problem} (the law of this run has {states})"
        fail_at(formula, node, problem)


def names_metrics_alone(formula: Expression) -> bool:
    """Return whether a formula names only metrics and nothing that changes with time."""
    names = formula.names
    are_metrics = all(name in OTHER_VALUES or find_metric_kind(name) is not None for name in names)
    return not formula.is_temporal and are_metrics


def is_in_tables(name: str) -> bool:
    """Return whether a name is a signal, a metric or a key that every run may have."""
    return name in {*SIGNALS, *OTHER_VALUES, *_list_parameters()} or (
        find_metric_kind(name) is not None
    )


def _is_known(name: str, *, over_time: bool, run: Run | None) -> bool:
    if is_in_tables(name) and name not in SIGNALS:
        return True
    if run is None:
        return name.startswith("law.") or (over_time and could_be_signal(name))
    return name in run.parameters or (over_time and name in list_signals(run.declaration))


def _list_known(name: str, *, over_time: bool, run: Run | None) -> Mapping[str, object]:
    """Return the names among which corrections of a misspelled name are searched."""
    signals = SIGNALS if run is None else list_signals(run.declaration)
    ids = [*(METRICS if run is None else list_metrics(run.declaration)), *list_ids_like(name)]
    own = () if run is None else run.parameters
    known = [*(signals if over_time else ()), *ids, *OTHER_VALUES, *_list_parameters(), *own]
    return dict.fromkeys(known)


def require_phase(phase: str, run: Run | None = None) -> None:
    """Raise CheckError for an invalid phase; for a known run, also for a misspelled phase."""
    if phase == DONE or not re.fullmatch(NAME_PATTERN, phase):
        raise CheckError(f"phase: expected one of the run's law or pause, found {phase!r}")
    known = [] if run is None else [name for name in run.phase_names if name != DONE]
    if phase not in known and difflib.get_close_matches(phase, known):
        raise CheckError(f"phase: {describe_nearest(phase, known)}")


def describe_missing_phase(run: Run, phase: str) -> str:
    """Return why a phase is missing: the run does not reach it, or the law has other phases."""
    known = [name for name in run.phase_names if name != DONE]
    if phase in known:
        return f"no_phase (the run has no phase {phase})"
    return f"no_phase (the law of this run has no phase {phase}; it has {', '.join(known)})"


def describe_nearest(text: str, known: Sequence[str]) -> str:
    """Return the end of an error line for an unknown word."""
    return describe_unknown_name(text, dict.fromkeys(known))


_MOST_SIGNALS: Final = 4

_OF_SIGNAL: Final = {"heading": ("heading_error",), "along_track": ("along_track", "cross_track")}
_OF_END: Final = ("distance", "heading_error")
_OF_RUN: Final = ("distance", "speed", "turn_rate")
_OF_NAME: Final = {
    "cross_track": ("cross_track",),
    "measured_speed": ("measured_speed", "speed"),
    "measured_turn_rate": ("measured_turn_rate", "turn_rate"),
    "speed_tracking": ("speed", "measured_speed"),
    "speed_lag": ("speed", "measured_speed"),
    "turn_rate_tracking": ("turn_rate", "measured_turn_rate"),
    "turn_rate_lag": ("turn_rate", "measured_turn_rate"),
    "speed": ("speed",),
    "turn_rate": ("turn_rate",),
}


def choose_signals(names: Iterable[str], declaration: Declaration) -> tuple[str, ...]:
    """Return the signals of a law to show for signals, metrics and parameters."""
    known = list_signals(declaration)
    chosen: list[str] = []
    for name in names:
        if name in known:
            chosen.append(name)
        elif name in TRAJECTORY_VALUES:
            chosen += ["x", "y"]
        elif name in ROBOT_VALUES:
            axis = ROBOT_VALUES[name][0]
            chosen += [axis, f"measured_{axis}"]
        elif find_metric_kind(name) is not None:
            chosen += _choose_for_metric(name, declaration)
    return tuple(dict.fromkeys(chosen))[:_MOST_SIGNALS]


def _choose_for_metric(name: str, declaration: Declaration) -> Sequence[str]:
    part, rest = name.split(".", 1)
    for start, signals in _OF_NAME.items():
        if rest.startswith(start):
            return signals
    loop = declaration.find_loop(part)
    if loop is not None:
        return (*_OF_SIGNAL.get(loop.signal, (loop.signal,)), loop.command)
    return _OF_END if part == "final" else _OF_RUN


def find_other_unit(name: str) -> str | None:
    """Return the unit of a robot value or an error of a trajectory; None for any other name."""
    if name in ROBOT_VALUES:
        return _ROBOT_FIELDS[ROBOT_VALUES[name][1]][1]
    if name in TRAJECTORY_VALUES:
        return _ERROR_QUANTITIES[TRAJECTORY_VALUES[name][1]][0]
    return None


def measure_robot(run: Run, names: Iterable[str]) -> dict[str, Metric]:
    """Return values of a run's robot, or the reason for each value that is not identified."""
    names = [*names]
    if not names:
        return {}
    from turtlelog.identify import identify_robot  # few checks need it

    model = identify_robot(run) if len(run.poses) else None
    found = {}
    for name in names:
        axis, parameter, end = ROBOT_VALUES[name]
        field, unit = _ROBOT_FIELDS[parameter]
        if model is None:
            status, reason = NO_POSES.status, NO_POSES.reason
            found[name] = Metric(id=name, value=None, unit=unit, status=status, reason=reason)
            continue
        of_axis = getattr(model, axis)
        estimate = getattr(of_axis, field)
        value = None if estimate is None else getattr(estimate, _INTERVAL_ENDS[end])
        reason = "" if value is not None else of_axis.reason or "the model has no such parameter"
        status = Status.UNDETERMINED if value is None else Status.OK
        found[name] = Metric(id=name, value=value, unit=unit, status=status, reason=reason)
    return found


@dataclass(frozen=True, slots=True, kw_only=True)
class TrajectoryJudge:
    """Measurement of the errors of recordings relative to one reference, which counts as true.

    With `reads_files`, recordings are named by their files, from which poses in space are read.
    """

    reference: Trajectory
    settings: TrajectorySettings
    choice: ReadChoice
    reads_files: bool

    def measure(self, run: Run, names: Iterable[str], file: str) -> dict[str, Metric]:
        """Return the named values of a recording, or the reason for each missing one."""
        names = [*names]
        try:
            found = compare_trajectories(self.reference, self._read(run, file), self.settings)
        except (CompareError, LogError) as err:
            return {name: _build(name, None, str(err)) for name in names}
        values = {}
        for name in names:
            kind, quantity, statistic = TRAJECTORY_VALUES[name]
            statistics = found.find_error(kind, quantity)
            assert statistics is not None  # the settings have a length for each kind
            values[name] = _build(name, float(getattr(statistics, statistic)), "")
        return values

    def _read(self, run: Run, file: str) -> Trajectory:
        found = (
            read_trajectory(file, self.choice) if self.reads_files else build_planar_trajectory(run)
        )
        return replace(found, name=file)


def _build(name: str, value: float | None, reason: str) -> Metric:
    unit, factor = _ERROR_QUANTITIES[TRAJECTORY_VALUES[name][1]]
    status = Status.UNDETERMINED if value is None else Status.OK
    shown = None if value is None else factor * value
    return Metric(id=name, value=shown, unit=unit, status=status, reason=reason)
