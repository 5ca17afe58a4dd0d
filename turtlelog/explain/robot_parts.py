"""The exchangeable parts of two recorded robots, and their uncertainty.

A robot's log is the response of its model to the recorded commands, from the recorded start. Two
logs therefore differ in the models' parameters, in noise, commands, start, goal and path.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from turtlelog.identify.axis_fit import NORMAL_95
from turtlelog.identify.axis_motion import AXES, Axis, measure_axis_steps, read_axis_motion
from turtlelog.identify.held_response import HeldInput
from turtlelog.identify.robot_identification import identify_robot
from turtlelog.identify.robot_model import AxisModel, Estimate, RobotModel
from turtlelog.identify.robot_noise import measure_rate_noise, measure_sensing_noise
from turtlelog.run import Run
from turtlelog.run.loops import Cause

COMMANDS: Final = "commands"
NOISE: Final = "noise"
PATH: Final = "path"
TIMES: Final = "pose times"
"""Parts that belong to no axis."""

CHANCE: Final = (NOISE, TIMES)
"""Parts that are chance instead of causes, because they do not belong to the robot."""

MOTIONS: Final[Mapping[Axis, str]] = MappingProxyType({"speed": "driving", "turn_rate": "turning"})
"""Words for the motions of the axes, for names of parts."""

FIELDS: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {
        "gain": ("gain", "reverse_gain"),
        "dead time": ("dead_time_s",),
        "time constant": ("lag_s", "lag_product_s2", "model"),
        "limits": (
            *("bound", "bound_acts", "bound_beside"),
            *("rate_limit", "limit_acts", "rate_limit_beside", "jerk_time_s"),
        ),
        "friction": ("friction", "deadband"),
    }
)
"""Fields of an axis that are exchanged together."""

_MIXED: Final = ("gain", "dead time", "time constant and limits", "friction")
"""Names of parts that are used if no model has one robot's time constant and the other's limits."""

_MOSTLY: Final = 0.98
"""Share of the steps between poses that are used; the fastest steps have the largest noise."""

_BEYOND: Final = 1.05
"""Factor on a bound that noise of poses does not exceed."""

_LEAST: Final = 1e-3
"""Smallest random value as a share of the value, so that no parameter is negative, however wide its
interval."""

_TURNS: Final = ("turn_rate", "total_turning", "heading_error")
_DRIVES: Final = ("run.speed_", "run.measured_speed_")


@dataclass(frozen=True, slots=True, kw_only=True)
class LogNoise:
    """Noise of a robot, as its log shows it; of the rates in m/s^0.5 and rad/s^0.5."""

    position_m: float = 0.0
    heading_rad: float = 0.0
    speed: float = 0.0
    turn_rate: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RobotLog:
    """A robot's log without controller samples, its model, its noise, and its commands.

    The commands of each axis have a 0 where the robot stops by itself.
    """

    run: Run
    model: RobotModel
    noise: LogNoise = field(default_factory=LogNoise)
    commands: Mapping[Axis, HeldInput]


def read_robot_log(run: Run) -> RobotLog:
    """Return a robot's log with its model."""
    model = identify_robot(run)
    sensing = measure_sensing_noise(model, [run]) if any(a.is_known for a in model.axes) else None
    rates = {axis: measure_rate_noise(model, axis, [run]) for axis in AXES}
    return RobotLog(
        run=run,
        model=model,
        noise=LogNoise(
            position_m=0.0 if sensing is None else sensing.position.size,
            heading_rad=0.0 if sensing is None else sensing.heading.size,
            **{axis: 0.0 if noise is None else noise.size for axis, noise in rates.items()},
        ),
        commands={axis: read_axis_motion(run, axis).commands for axis in AXES},
    )


def share_unseen_bounds(logs: Sequence[RobotLog]) -> list[RobotLog]:
    """Return two logs that share a bound which one robot never exceeds, so cannot show."""
    return [_take_bounds(log, other) for log, other in zip(logs, reversed(logs), strict=True)]


def _take_bounds(log: RobotLog, other: RobotLog) -> RobotLog:
    taken: dict[str, Any] = {}
    for axis in AXES:
        own, known = get_axis(log.model, axis), get_axis(other.model, axis)
        if not own.is_known or own.bound is not None or known.bound is None:
            continue
        if _find_reached_rate(log.run, axis) <= _BEYOND * known.bound.high:
            names = ("bound", "bound_acts", "bound_beside")
            taken[axis] = replace(own, **{name: getattr(known, name) for name in names})
    return replace(log, model=replace(log.model, **taken)) if taken else log


def _find_reached_rate(run: Run, axis: Axis) -> float:
    """Return the rate that a robot exceeds for 2 % of its time [m/s or rad/s]."""
    time_s, moved, is_sound = measure_axis_steps(run.poses, axis)
    rates = np.abs(moved / np.diff(time_s))[is_sound]
    return float(np.quantile(rates, _MOSTLY)) if len(rates) else 0.0


def list_axes(metric: str) -> tuple[Axis, ...]:
    """Return the axes that a metric of a run depends on."""
    if metric.startswith(_DRIVES):
        return ("speed",)
    return ("turn_rate",) if any(word in metric for word in _TURNS) else AXES


def get_axis(model: RobotModel, axis: Axis) -> AxisModel:
    """Return the model of an axis."""
    return model.speed if axis == "speed" else model.turn_rate


def find_parts(first: RobotLog, second: RobotLog, axes: Iterable[Axis]) -> dict[str, Cause]:
    """Return the parts in which two logs differ, with the first log's values as neutral values."""
    values: dict[str, dict[str, object]] = {
        **{name: found for axis in axes for name, found in _list_axis_parts(first, second, axis)},
        NOISE: _list_noise(first, second),
        TIMES: {"poses": len(first.run.poses)},
        COMMANDS: {"commands": len(first.run.commands)},
        PATH: _list_places(first.run, second.run),
    }
    return {
        name: Cause(name=name, kind="effect", neutral=found, meaning=f"as in {first.run.name}")
        for name, found in values.items()
        if found
    }


def _list_axis_parts(
    first: RobotLog, second: RobotLog, axis: Axis
) -> Iterator[tuple[str, dict[str, object]]]:
    models = [get_axis(log.model, axis) for log in (first, second)]
    if not all(model.is_known for model in models):
        return
    names = [*FIELDS] if _can_mix(*models) else [*_MIXED]
    for name in names:
        fields = list_part_fields(name)
        before, after = ({key: show_value(getattr(m, key)) for key in fields} for m in models)
        if before != after:
            found: dict[str, object] = {f"{axis}.{key}": value for key, value in before.items()}
            yield f"{name} {MOTIONS[axis]}", found


def list_part_fields(part: str) -> tuple[str, ...]:
    """Return the fields of an axis that belong to a part, by its name without the motion."""
    return tuple(name for one in part.split(" and ") for name in FIELDS[one])


def _can_mix(first: AxisModel, second: AxisModel) -> bool:
    """Return whether each robot may take the other's time constant without its limits."""
    fields = FIELDS["limits"]
    mixed = (
        replace(one, **{name: getattr(other, name) for name in fields})
        for one, other in ((first, second), (second, first))
    )
    return all(bool(model.structure.is_possible) for model in mixed)


def list_part_values(log: RobotLog, keys: Iterable[str]) -> dict[str, Any]:
    """Return the values of a log for the keys of a part."""
    run, found = log.run, {}
    for key in keys:
        axis, _, name = key.partition(".")
        if axis in AXES:
            found[key] = show_value(getattr(getattr(log.model, axis), name))
        elif axis == NOISE:
            found[key] = getattr(log.noise, name)
        else:
            counts = {"commands": len(run.commands), "poses": len(run.poses)}
            found[key] = counts[key] if key in counts else _get_places(run)[key]
    return found


def differs_surely(part: str, keys: Iterable[str], logs: Sequence[RobotLog]) -> bool:
    """Return whether two logs differ in a part by more than the intervals of its values."""
    if part in CHANCE:
        return False
    if part == COMMANDS:
        return not _have_same_commands(*(log.run for log in logs))
    return part == PATH or any(_lie_apart(key, logs) for key in keys)


def _lie_apart(key: str, logs: Sequence[RobotLog]) -> bool:
    axis, _, name = key.partition(".")
    one, other = (getattr(getattr(log.model, axis), name) for log in logs)
    if one is None or other is None or isinstance(one, str):
        return bool(one != other)
    return bool(one.high < other.low or other.high < one.low)


def _have_same_commands(first: Run, second: Run) -> bool:
    one, other = first.commands, second.commands
    return len(one) == len(other) and all(
        np.array_equal(getattr(one, name), getattr(other, name))
        for name in ("speed_m_s", "turn_rate_rad_s")
    )


def _list_noise(first: RobotLog, second: RobotLog) -> dict[str, object]:
    before, after = asdict(first.noise), asdict(second.noise)
    return {f"{NOISE}.{key}": value for key, value in before.items() if value != after[key]}


def show_value(value: Any) -> Any:
    """Return the value of an estimate; None for an empty text."""
    if isinstance(value, Estimate):
        return value.value
    return value or None


def _get_places(run: Run) -> dict[str, object]:
    x_m, y_m = run.poses.xy_m[0].tolist()
    return {
        "start": (x_m, y_m, float(run.poses.heading_rad[0])),
        "goal": None if run.goal_xy_m is None else (*run.goal_xy_m, run.goal_heading_rad),
        "path": tuple(sorted((k, repr(v)) for k, v in run.parameters.items() if "path." in k)),
    }


def _list_places(first: Run, second: Run) -> dict[str, object]:
    """Return start, goal and path if they differ and are used."""
    before, after = _get_places(first), _get_places(second)
    if not any(one["goal"] or one["path"] for one in (before, after)):
        return {}
    return {key: value for key, value in before.items() if value != after[key]}


def draw_model(model: AxisModel, rng: np.random.Generator, sign: float) -> AxisModel:
    """Return an axis with parameters sampled from their intervals: normal, and not negative.

    Dead time and time constant are sampled jointly: the intervals of both and of their sum give
    their correlation. The same numbers with the other sign give the mirrored sample.
    """
    numbers = sign * rng.standard_normal(7)
    gain, lag, dead_time, total = model.gain, model.lag_s, model.dead_time_s, model.total_delay_s
    if gain is None or lag is None or dead_time is None or total is None:
        return model
    of_total, of_lag, of_dead_time = (_find_error(one) for one in (total, lag, dead_time))
    tied = _find_correlation(of_total, of_lag, of_dead_time)
    total_s = max(total.value + of_total * numbers[0], 0.0)
    aside = tied * numbers[0] + math.sqrt(1.0 - tied * tied) * numbers[1]
    lag_s = min(max(lag.value + of_lag * aside, 0.0), total_s)
    product, ratio = model.lag_product_s2, lag_s / lag.value if lag.value else 1.0
    if product is not None:
        product = replace(product, value=product.value * ratio * ratio)
    return replace(
        model,
        gain=_move(gain, numbers[2]),
        lag_s=replace(lag, value=lag_s),
        dead_time_s=replace(dead_time, value=total_s - lag_s),
        lag_product_s2=product,
        reverse_gain=_move(model.reverse_gain, numbers[3]),
        bound=_move(model.bound, numbers[4]),
        rate_limit=_move(model.rate_limit, numbers[5]),
        friction=_move(model.friction, numbers[6]),
    )


def _find_error(one: Estimate) -> float:
    """Return the standard error. An interval that ends at 0 is truncated there."""
    return max(one.high - one.value, one.value - one.low) / NORMAL_95


def _find_correlation(of_total: float, of_lag: float, of_rest: float) -> float:
    """Return the correlation of total and time constant, from the errors of all three values."""
    if not of_total or not of_lag:
        return 0.0
    tied = (of_total**2 + of_lag**2 - of_rest**2) / (2.0 * of_total * of_lag)
    return min(max(tied, -1.0), 1.0)


def _move(one: Estimate | None, number: float) -> Estimate | None:
    if one is None:
        return None
    value = one.value + _find_error(one) * float(number)
    return replace(one, value=max(value, _LEAST * one.value))
