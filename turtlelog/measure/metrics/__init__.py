"""The metrics of a run by id: the one table for measuring and checks."""

import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from fnmatch import fnmatchcase
from functools import lru_cache
from typing import Final

import numpy as np

from turtlelog.display import NamedValues
from turtlelog.errors import MeasureError, describe_unknown
from turtlelog.measure.metric import NO_POSES, Found, Metric, Metrics, Missing, Result, Status
from turtlelog.measure.metric_kinds import LOOP_METRICS, RUN_METRICS, MetricKind
from turtlelog.measure.run_context import MeasureSettings, RunContext
from turtlelog.run import Run, require_run
from turtlelog.run.loops import ControlLoop, Declaration, is_loop_name

# isort: split
# Importing a file of metrics enters them in the registry, in the order of display.
from turtlelog.measure.metrics import loop_metrics, commands_and_theory  # noqa: F401, I001
from turtlelog.measure.metrics import goal_and_path, travel, following, sampling_times  # noqa: F401

ANY_LOOP: Final = "<loop>"
"""Placeholder for the name of a loop in the ids of `METRICS`."""

METRICS: Final[Mapping[str, MetricKind]] = NamedValues(
    "metric",
    {
        **{f"{ANY_LOOP}.{name}": kind.describe() for name, kind in LOOP_METRICS.items()},
        **RUN_METRICS,
    },
)
"""Every metric by id, loop metrics as `<loop>.overshoot`; `list_metrics` returns the ids of a
law."""

_ESSENTIAL_OF_LOOP: Final = (
    *("duration", "rise_time", "overshoot", "settling_time", "final_error", "rms_error"),
    *("largest_error", "lag", "corner_overshoot", "iae", "saturated_share", "dead_time"),
)

_OF_MOVING: Final = frozenset({"rms_error", "largest_error", "lag", "corner_overshoot"})
"""Metrics that are essential only if there are no metrics of a step, which show more."""

_ESSENTIAL_OF_RUN: Final = (
    *("final.heading_error", "final.position_error"),
    *("run.duration", "run.path_length", "run.cross_track_max", "run.largest_gap"),
)

_ESSENTIAL_OF_PATH: Final = _ESSENTIAL_OF_RUN[2:]
"""Essential metrics of laws without a goal that follow a path."""

_ESSENTIAL_WITHOUT_GOAL: Final = (
    *("run.duration", "run.path_length", "run.speed_effort", "run.turn_rate_effort"),
    "run.largest_gap",
)
"""Essential metrics of laws without goal and path: distance and commands."""

_ESSENTIAL_OF_MOTION: Final = (
    *("run.duration", "run.path_length", "run.total_turning", "run.rest_share"),
    *("run.measured_speed_max", "run.measured_turn_rate_max", "run.spectral_arc_length"),
    "run.largest_pose_gap",
)
"""Essential metrics of a robot with known poses only."""

_ESSENTIAL_IN_SPACE: Final = ("run.path_length_in_space", "run.height_range", "run.tilt_max")
"""Further essential metrics of a robot that leaves the plane."""

_ESSENTIAL_OF_COMMANDS: Final = (
    *("run.duration", "run.sample_rate", "run.largest_gap"),
    *(
        f"run.{axis}_{figure}"
        for axis in ("speed", "turn_rate")
        for figure in ("effort", "total_variation", "largest_jump", "largest_slew_rate", "steps")
    ),
)
"""Essential metrics of a log of commands alone."""

_ESSENTIAL_WITH_GOAL: Final = ("final.position_error", "run.time_to_goal")
_ESSENTIAL_WITH_PATH: Final = ("run.cross_track_max", "run.cross_track_rms")
_ESSENTIAL_WITH_COMMANDS: Final = (
    *("run.speed_tracking_rms", "run.speed_lag", "run.speed_steps", "run.speed_rise_time"),
    *("run.turn_rate_tracking_rms", "run.turn_rate_lag", "run.turn_rate_steps"),
    *("run.turn_rate_rise_time", "run.largest_gap"),
)
"""Further essential metrics if commands, a goal or a path are known."""


def list_metrics(*declarations: Declaration) -> Mapping[str, MetricKind]:
    """Return every metric of runs with these laws by id: of each loop, the end and the run."""
    return _list_metrics(tuple(dict.fromkeys(declarations)))


@lru_cache(maxsize=64)
def _list_metrics(declarations: tuple[Declaration, ...]) -> Mapping[str, MetricKind]:
    of_loops: dict[str, MetricKind] = {}
    for loop in _list_loops(declarations):
        for name, kind in LOOP_METRICS.items():
            if kind.applies(loop):
                of_loops.setdefault(f"{loop.name}.{name}", kind.bind(loop))
    return NamedValues("metric", {**of_loops, **RUN_METRICS})


def list_essential_metrics(*of: Declaration | Run) -> tuple[str, ...]:
    """Return the ids of the metrics to look at first, for the given laws or runs.

    If the law of a run is unknown and the run has no samples, these are the metrics of poses,
    commands and goal.
    """
    lawless = [run for run in of if isinstance(run, Run) and run.is_lawless]
    laws = [run.declaration if isinstance(run, Run) else run for run in of if run not in lawless]
    of_laws = _list_of_laws(*laws) if laws or not of else ()
    return tuple(dict.fromkeys([*of_laws, *_list_of_motion(lawless)]))


def _list_of_motion(runs: Collection[Run]) -> tuple[str, ...]:
    if not runs:
        return ()
    if not any(len(run.poses) for run in runs):
        return _ESSENTIAL_OF_COMMANDS
    has_goal = any(run.goal_xy_m is not None for run in runs)
    has_path = any(run.path is not None for run in runs)
    has_commands = any(len(run.commands) for run in runs)
    has_space = any(run.poses.height_m is not None for run in runs)
    return (
        *(_ESSENTIAL_WITH_GOAL if has_goal else ()),
        *_ESSENTIAL_OF_MOTION[:-1],
        *(_ESSENTIAL_IN_SPACE if has_space else ()),
        *(_ESSENTIAL_WITH_PATH if has_path else ()),
        *(_ESSENTIAL_WITH_COMMANDS if has_commands else ()),
        *_ESSENTIAL_OF_MOTION[-1:],
    )


@lru_cache(maxsize=64)
def _list_of_laws(*declarations: Declaration) -> tuple[str, ...]:
    loops = _list_loops(declarations)
    of_loops = (
        f"{loop.name}.{name}"
        for loop in loops
        for name in _ESSENTIAL_OF_LOOP
        if LOOP_METRICS[name].applies(loop) and (loop.moves or name not in _OF_MOVING)
    )
    of_run: tuple[str, ...] = _ESSENTIAL_OF_RUN
    if declarations and not any(one.uses_goal for one in declarations):
        follows = any(loop.reference == "path" for loop in loops)
        of_run = _ESSENTIAL_OF_PATH if follows else _ESSENTIAL_WITHOUT_GOAL
    return (*dict.fromkeys(of_loops), *of_run)


def _list_loops(declarations: Iterable[Declaration]) -> list[ControlLoop]:
    return [loop for declaration in declarations for loop in declaration.loops]


def find_metric_kind(name: str) -> MetricKind | None:
    """Return the kind of a metric for any law; metrics of loops are described as in `METRICS`.

    The result is None if the name cannot be the id of a metric.
    """
    if name in RUN_METRICS:
        return RUN_METRICS[name]
    loop, _, plain = name.rpartition(".")
    return METRICS.get(f"{ANY_LOOP}.{plain}") if is_loop_name(loop) else None


def choose_metrics(patterns: Collection[str], declaration: Declaration) -> tuple[str, ...]:
    """Return the ids that names or patterns select, in the order of `list_metrics`.

    Patterns may contain `*`, `?` and `[...]`. A full name also selects a metric whose loop the law
    does not declare; this metric has a reason instead of a value. A pattern that matches only loops
    of other laws selects nothing.

    Raises:
        MeasureError: If a name is not the id of a metric. The message names the nearest ids.
    """
    if not isinstance(patterns, Iterable):
        raise MeasureError(f"metrics: expected names or patterns, found {patterns!r:.60}")
    return _choose((patterns,) if isinstance(patterns, str) else tuple(patterns), declaration)


@lru_cache(maxsize=64)
def _choose(patterns: tuple[str, ...], declaration: Declaration) -> tuple[str, ...]:
    known = list_metrics(declaration)
    chosen: dict[str, None] = {}
    for pattern in patterns:
        found = [name for name in known if name == pattern or fnmatchcase(name, pattern)]
        if not found and find_metric_kind(pattern) is not None:
            found = [pattern]
        if not found and not _matches_any_loop(pattern):
            ids = dict.fromkeys([*known, *list_ids_like(pattern)])
            raise MeasureError(describe_no_metric(pattern, ids))
        chosen |= dict.fromkeys(found)
    others = (name for name in chosen if name not in known)
    return (*(name for name in known if name in chosen), *others)


def is_metric_pattern(pattern: str) -> bool:
    """Return whether a name or pattern (`*.overshoot`) matches metrics of some law."""
    try:
        choose_metrics([pattern], Declaration())
    except MeasureError:
        return False
    return True


def list_ids_like(pattern: str) -> list[str]:
    """Return the metrics of the loop in a name, for any law."""
    loop, dot, _ = pattern.partition(".")
    if not dot or not is_loop_name(loop):
        return []
    return [f"{loop}.{name}" for name in LOOP_METRICS]


def _matches_any_loop(pattern: str) -> bool:
    """Return whether a pattern matches metrics of a loop with any valid name."""
    if not any(sign in pattern for sign in "*?["):
        return False
    loop, dot, plain = pattern.rpartition(".")
    if not dot:  # the first `*` may stand for the loop and the dot: `*time`
        begin = pattern.partition("*")[0]
        return any(fnmatchcase(f"{begin}.{name}", pattern) for name in LOOP_METRICS)
    is_loop = is_loop_name(loop) or any(sign in loop for sign in "*?[")
    return is_loop and any(fnmatchcase(name, plain) for name in LOOP_METRICS)


def describe_no_metric(pattern: str, known: Iterable[str]) -> str:
    """Return an error line for a name that is not a metric, with the nearest ids."""
    return describe_unknown("metric", pattern, known, place="turtlelog list metrics")


def measure_run(
    run: Run, settings: MeasureSettings | None = None, *, only: Collection[str] | None = None
) -> Metrics:
    """Return the metrics of a run by id, in the order of `list_metrics(run.declaration)`.

    Args:
        run: Run to measure. Metrics that need missing data get a status instead of a value.
        settings: Settings of the metrics. Default: `MeasureSettings()`.
        only: Ids or patterns (`translate.*`); no other metric is computed.

    Raises:
        MeasureError: If `only` names no metric, or the settings name a loop that is not declared.
    """
    require_run(run)
    kinds = list_metrics(run.declaration)
    names = kinds if only is None else choose_metrics(only, run.declaration)
    settings = MeasureSettings() if settings is None else settings
    if not isinstance(settings, MeasureSettings):
        example = "MeasureSettings(band=0.05)"
        raise MeasureError(f"settings: expected {example} or similar, found {settings!r:.60}")
    settings.require_loops(run.declaration)
    context = RunContext(run, settings)
    # Values at the limits of a float become statuses, not warnings.
    with np.errstate(all="ignore"):
        found = [(name, _measure(context, name, kinds.get(name))) for name in names]
    return Metrics(found, first=list_essential_metrics(run))


def miss_metric(declaration: Declaration, name: str) -> Metric:
    """Return a metric without a value: the law does not declare its loop, or the loop lacks it."""
    loop, _, plain = name.rpartition(".")
    declared = declaration.find_loop(loop)
    known = ", ".join(found.name for found in declaration.loops) or "none"
    reason = f"the run declares no loop {loop} (it declares {known})"
    if declared is not None:
        what = f"a loop of {declared.signal} with the reference {declared.reference}"
        reason = f"{what} has no {plain}"
    unit = LOOP_METRICS[plain].describe_unit(declared)
    return Metric(id=name, value=None, unit=unit, status=Status.NO_PHASE, reason=reason)


def _measure(context: RunContext, name: str, kind: MetricKind | None) -> Metric:
    if kind is None:
        missing = miss_metric(context.run.declaration, name)
        if not context.run.is_lawless:
            return missing
        reason = "no samples of a controller were read"
        return replace(missing, status=Status.ABSENT, reason=reason)
    if kind.needs_poses and not len(context.run.poses):
        result: Result = NO_POSES
    else:
        result = kind.compute(context)
        if isinstance(result, Found) and not math.isfinite(result.value):
            result = Missing(Status.TOO_LARGE, "the value is beyond the largest float")
    if isinstance(result, Missing):
        status, reason = result.status, result.reason
        return Metric(id=name, value=None, unit=kind.unit, status=status, reason=reason)
    return Metric(id=name, value=result.value, unit=kind.unit, at_s=result.at_s)
