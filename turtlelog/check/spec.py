"""Specifications as values, the names that they may use, and values in a run other than metrics."""

import difflib
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import product
from pathlib import Path
from types import MappingProxyType
from typing import Final, Literal

from turtlelog import expressions
from turtlelog.compare import Delta, Tolerance, TrajectorySettings, compare_trajectories
from turtlelog.display import describe_count
from turtlelog.errors import CheckError, CompareError, LogError
from turtlelog.escapes import escape_controls
from turtlelog.files.text_files import name_key
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
    measure_run,
)
from turtlelog.measure.metric import NO_POSES, Missing, Status
from turtlelog.run import Run, Trajectory, build_planar_trajectory
from turtlelog.run.columns import Rebuilding, rebuild_value
from turtlelog.run.loops import DONE, NAME_PATTERN, Declaration
from turtlelog.scenario import Scenario, describe_unknown_key, flatten_scenario

FORMAT: Final = 1
"""Format of specifications; newer formats are refused."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """One requirement.

    Attributes:
        name: Name of the check's table.
        kind: `expect`: a formula over metrics and parameters. `holds`: a formula also over signals
            and time.
        formula: Formula to check.
        phase: Segment for `holds`: `pause`, or a phase of the run's law with the following pause;
            None for the whole run.
        when: Condition without which the check is skipped; None: the check is never skipped.
        reason: Reason for the limit.
        is_observed: Whether the bound comes from a good run and is not yet confirmed.
    """

    name: str
    kind: Literal["expect", "holds"]
    formula: expressions.Expression
    phase: str | None = None
    when: expressions.Expression | None = None
    reason: str = ""
    is_observed: bool = False

    def describe(self) -> str:
        """Return the requirement as a text, with its segment."""
        return self.formula.text if self.phase is None else f"{self.formula.text} in {self.phase}"


def list_formula_names(checks: Sequence[Check]) -> set[str]:
    """Return the names in the formulas of checks."""
    formulas = [found for check in checks for found in (check.formula, check.when) if found]
    return {name for formula in formulas for name in formula.names}


@dataclass(frozen=True, slots=True, kw_only=True)
class Tolerances:
    """Tolerances of the signals and metrics that are judged.

    Attributes:
        signals: Tolerances by the name of the signal, or of a law's state.
        metrics: Tolerances by the id of the metric. Ids of loops apply to any law.

    Raises:
        CompareError: If no law has such a signal or metric, or the tolerance does not fit it.
    """

    signals: Mapping[str, Tolerance] = field(default_factory=dict)
    metrics: Mapping[str, Tolerance] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for kind in ("signals", "metrics"):
            found = getattr(self, kind)
            for name, tolerance in found.items():
                place = f'{kind}."{name}"' if "." in name else f"{kind}.{name_key(name)}"
                if not is_known(kind, name):
                    known = list_nearby(kind, name)
                    raise CompareError(f"{place}: {describe_unknown_key(name, known)}")
                keys: tuple[str, ...] = ("time_s",) if kind == "metrics" else ()
                if kind == "signals" and is_label_signal(name):
                    keys = ("abs", "rel")
                for key in keys:
                    if value := getattr(tolerance, key):
                        what = "metric" if kind == "metrics" else "label"
                        raise CompareError(
                            f"{place}.{key}: expected none for a {what}, found {value}"
                        )
            object.__setattr__(self, kind, MappingProxyType(dict(found)))

    def __bool__(self) -> bool:
        return bool(self.signals or self.metrics)

    def __reduce__(self) -> Rebuilding:
        return rebuild_value(self)


USUAL_TRAJECTORY: Final = TrajectorySettings(deltas=(Delta(value=1.0, unit="m"),))
"""Default settings for errors of trajectories."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Spec:
    """A specification for recordings.

    Attributes:
        checks: Checks in the order of the file.
        tolerances: Allowed differences of signals and metrics from the reference.
        reference: Recording to which tolerances refer; None without tolerances.
        alignment: Alignment of runs and reference.
        trajectory: Settings for errors of trajectories relative to the reference.
        read: Topics, frames and goal to read from third-party files, also from the reference.
        source: Name of the file for messages.
    """

    checks: tuple[Check, ...] = ()
    tolerances: Tolerances = field(default_factory=Tolerances)
    reference: Path | None = None
    alignment: str = "first_sample"
    trajectory: TrajectorySettings = USUAL_TRAJECTORY
    read: ReadChoice = field(default_factory=ReadChoice)
    source: str = "specification"

    def __repr__(self) -> str:
        checks = describe_count(len(self.checks), "check")
        count = len(self.tolerances.signals) + len(self.tolerances.metrics)
        held = describe_count(count, "tolerance")
        return escape_controls(f"<Spec {self.source}: {checks}, {held}>")


def is_known(kind: str, name: str) -> bool:
    """Return whether runs of any law can have a signal or metric with this name."""
    return could_be_signal(name) if kind == "signals" else find_metric_kind(name) is not None


def list_nearby(kind: str, name: str) -> list[str]:
    """Return the names among which corrections of a misspelled name are searched."""
    return list(SIGNALS) if kind == "signals" else [*METRICS, *list_ids_like(name)]


def is_label_signal(name: str) -> bool:
    """Return whether a signal is a label, which is either equal or not."""
    return name in SIGNALS and SIGNALS[name].compared_as == "label"


ASSOCIATIONS: Final = ("nearest", "linear")
"""Methods of finding poses at equal times."""

READ_TEXTS: Final[Mapping[str, str]] = MappingProxyType(
    {
        "pose_topic": "Poses.",
        "command_topic": "Commands: Twist, TwistStamped, or Ackermann's with a wheelbase.",
        "robot": "Of several robots in a bag the one of this name.",
        "path_topic": "The path to be followed: nav_msgs/Path.",
        "pose_frame": "The robot's frame, of poses from transforms.",
        "world_frame": "The frame in which poses from transforms are given.",
        "wheel_joints": "Joints of the left and the right wheel, whose odometry poses are.",
    }
)
"""Keys of `[read]` with text values, and their meanings."""

_ROBOT_FIELDS: Final = {
    "gain": ("gain", "1"),
    "dead_time": ("dead_time_s", "s"),
    "time_constant": ("lag_s", "s"),
    "total_delay": ("total_delay_s", "s"),
}
_INTERVAL_ENDS: Final = {"": "value", ".low": "low", ".high": "high"}
_ROBOT_NAMES: Final = [*product(("speed", "turn_rate"), _ROBOT_FIELDS, _INTERVAL_ENDS)]

ROBOT_VALUES: Final[Mapping[str, tuple[str, str, str]]] = MappingProxyType(
    {
        f"robot.{axis}.{name}{end}": (axis, _ROBOT_FIELDS[name][0], _INTERVAL_ENDS[end])
        for axis, name, end in _ROBOT_NAMES
    }
)
"""Axis, field of its model and end of the 95 % interval, by the names in checks."""

_ERROR_UNITS: Final = {"position": ("m", 1.0), "rotation": ("deg", math.degrees(1))}
_STATISTICS: Final = ("rmse", "mean", "median", "std", "min", "max")

TRAJECTORY_VALUES: Final[Mapping[str, tuple[str, str, str]]] = MappingProxyType(
    {".".join(parts): parts for parts in product(("ate", "rpe"), _ERROR_UNITS, _STATISTICS)}
)
"""Error, quantity and statistic, by the names in checks."""

OTHER_UNITS: Final[Mapping[str, str]] = MappingProxyType(
    {
        **{f"robot.{axis}.{name}{end}": _ROBOT_FIELDS[name][1] for axis, name, end in _ROBOT_NAMES},
        **{name: _ERROR_UNITS[parts[1]][0] for name, parts in TRAJECTORY_VALUES.items()},
    }
)
"""Units of the values in addition to the metrics of a single run, by name."""


@cache
def _list_parameters() -> tuple[str, ...]:
    return (*flatten_scenario(Scenario()), "goal.heading_rad")  # user laws have other keys


def find_kind(run: Run, name: str) -> MetricKind | None:
    """Return the kind of a run's metric; None if the name is not that of a metric.

    The metric of an undeclared loop has no value, unless the name belongs to a parameter.
    """
    own = list_metrics(run.declaration).get(name)
    return own or (None if name in run.parameters else find_metric_kind(name))


def require_known_names(
    formula: expressions.Expression, *, over_time: bool, run: Run | None = None
) -> None:
    """Raise an error for names that no run has, or that this run does not have.

    Without a run, any loop may have the existing metrics, and the parameters and states of a law
    may have any name. With `over_time`, the formula may contain signals and temporal operators.
    """
    signals = SIGNALS if run is None else list_signals(run.declaration)
    own = {} if run is None else run.parameters
    for node in expressions.iterate_nodes(formula.root):
        if isinstance(node, expressions.Temporal | expressions.Until) and not over_time:
            word = node.operator if isinstance(node, expressions.Temporal) else "until"
            expressions.fail_at(
                formula, node, f"expected metrics, found {word}: it stands in holds = ..."
            )
        if not isinstance(node, expressions.Name):
            continue
        name = node.name
        of_law = name in own if run is not None else name.startswith("law.")
        of_time = name in signals or (run is None and could_be_signal(name))
        of_all = is_in_tables(name) and name not in SIGNALS
        if of_all or of_law or (over_time and of_time):
            continue
        if name in signals:
            problem = f"expected a metric, found the signal {name}: it stands in holds = ..."
            expressions.fail_at(formula, node, problem)
        ids = [*(METRICS if run is None else list_metrics(run.declaration)), *list_ids_like(name)]
        known = [*(signals if over_time else ()), *ids, *OTHER_UNITS, *_list_parameters(), *own]
        problem = expressions.describe_unknown_name(name, dict.fromkeys(known))
        if run is not None and over_time and could_be_signal(name):
            states = ", ".join(run.declaration.states) or "no states"
            problem = f"{problem} (the law of this run has {states})"
        expressions.fail_at(formula, node, problem)


def names_metrics_alone(formula: expressions.Expression) -> bool:
    """Return whether a formula names only metrics and nothing that changes with time."""
    names = formula.names
    are_metrics = all(name in OTHER_UNITS or find_metric_kind(name) is not None for name in names)
    return not formula.is_temporal and are_metrics


def build_spec(formulas: Iterable[str], source: str = "--expect") -> Spec:
    """Return the specification of formulas; those of metrics alone are checked as `expect`."""
    checks = []
    for text in formulas:
        formula = expressions.parse_expression(text, source=source)
        require_known_names(formula, over_time=True)
        kind: Literal["expect", "holds"] = "expect" if names_metrics_alone(formula) else "holds"
        checks.append(Check(name=text, kind=kind, formula=formula))
    return Spec(checks=tuple(checks), source=source)


def is_in_tables(name: str) -> bool:
    """Return whether a name is a signal, a metric or a key that every run may have."""
    tables = {*SIGNALS, *OTHER_UNITS, *_list_parameters()}
    return name in tables or find_metric_kind(name) is not None


def require_phase(phase: str, run: Run | None = None) -> None:
    """Raise CheckError for an invalid phase; for a known run, also for a misspelled phase."""
    if phase == DONE or not re.fullmatch(NAME_PATTERN, phase):
        raise CheckError(f"phase: expected one of the run's law or pause, found {phase!r}")
    known = [] if run is None else [name for name in run.phase_names if name != DONE]
    if phase not in known and difflib.get_close_matches(phase, known):
        raise CheckError(f"phase: {describe_nearest(phase, known)}")


def describe_missing_phase(run: Run, phase: str) -> str:
    """Return why a phase is missing: it takes no time, is not reached, or not the law's."""
    if any(span.phase == phase for span in run.find_phase_spans()):
        return f"no_phase (the phase {phase} takes 0 s: the next phase begins at its time)"
    known = [name for name in run.phase_names if name != DONE]
    if phase in known:
        return f"no_phase (the run has no phase {phase})"
    return f"no_phase (the law of this run has no phase {phase}; it has {', '.join(known)})"


def describe_nearest(text: str, known: Sequence[str]) -> str:
    """Return the end of an error line for an unknown word."""
    return expressions.describe_unknown_name(text, dict.fromkeys(known))


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
            part, rest = name.split(".", 1)
            loop = declaration.find_loop(part)
            usual: tuple[str, ...] = _OF_END if part == "final" else _OF_RUN
            if loop is not None:
                usual = (*_OF_SIGNAL.get(loop.signal, (loop.signal,)), loop.command)
            named = (signals for start, signals in _OF_NAME.items() if rest.startswith(start))
            chosen += next(named, usual)
    return tuple(dict.fromkeys(chosen))[:_MOST_SIGNALS]


def measure_robot(run: Run, names: Iterable[str]) -> dict[str, Metric]:
    """Return values of a run's robot, or the reason for each value that is not identified."""
    names, found = [*names], {}
    if not names or not len(run.poses):
        return {name: _build(name, None, NO_POSES) for name in names}
    from turtlelog.identify import identify_robot  # few checks need it

    model = identify_robot(run)
    for name in names:
        axis, field_name, end = ROBOT_VALUES[name]
        of_axis = getattr(model, axis)
        estimate = getattr(of_axis, field_name)
        value = None if estimate is None else getattr(estimate, end)
        lack = of_axis.reason or "the model has no such parameter"
        found[name] = _build(name, value, Missing(Status.UNDETERMINED, lack))
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
            own = read_trajectory(file, self.choice) if self.reads_files else None
            own = replace(own or build_planar_trajectory(run), name=file)
            found = compare_trajectories(self.reference, own, self.settings)
        except (CompareError, LogError) as err:
            lack = Missing(Status.UNDETERMINED, str(err))
            return {name: _build(name, None, lack) for name in names}
        values = {}
        for name in names:
            kind, quantity, statistic = TRAJECTORY_VALUES[name]
            statistics = found.find_error(kind, quantity)
            assert statistics is not None  # the settings have a length for each kind
            value = _ERROR_UNITS[quantity][1] * float(getattr(statistics, statistic))
            values[name] = Metric(id=name, value=value, unit=OTHER_UNITS[name])
        return values


def _build(name: str, value: float | None, lack: Missing) -> Metric:
    """Return a value as a metric, or why it is missing."""
    status, reason = (lack.status, lack.reason) if value is None else (Status.OK, "")
    return Metric(id=name, value=value, unit=OTHER_UNITS[name], status=status, reason=reason)


def find_formula_unit(name: str, declaration: Declaration) -> str | None:
    """Return the unit of a signal or metric, empty if it depends on the loop; None for others."""
    own = list_signals(declaration).get(name) or list_metrics(declaration).get(name)
    if own is not None or name in OTHER_UNITS:
        return OTHER_UNITS[name] if own is None else own.unit
    kind = find_metric_kind(name)
    return None if kind is None else "" if " or " in kind.unit else kind.unit


def find_common_unit(node: expressions.Node, units: Mapping[str, str]) -> str:
    """Return the unit of the measured value; empty if the unit is not simple."""
    if isinstance(node, expressions.Call) and node.function in {"abs", "min", "max"}:
        found = {find_common_unit(argument, units) for argument in node.arguments}
        return found.pop() if len(found) == 1 else ""
    if isinstance(node, expressions.Call) and node.function == "deg":
        return "deg"
    return units.get(node.name, "") if isinstance(node, expressions.Name) else ""


def measure_named(
    checks: Sequence[Check],
    run: Run,
    *,
    trajectories: TrajectoryJudge | None = None,
    file: str = "",
) -> Mapping[str, Metric]:
    """Return the metrics of a run that checks name; `trajectories` measures errors of positions."""
    names = list_formula_names(checks)
    ids = sorted(name for name in names if find_kind(run, name) is not None)
    of_robot = measure_robot(run, sorted(names & ROBOT_VALUES.keys()))
    errors = sorted(names & TRAJECTORY_VALUES.keys())
    beside = trajectories.measure(run, errors, file) if trajectories and errors else {}
    return {**(measure_run(run, only=ids) if ids else {}), **of_robot, **beside}
