"""A recording without a controller's samples: the exchangeable parts of its robot, and facts.

A robot's log is the response of its model to the recorded commands, from the recorded start. Two
logs therefore differ in the models' parameters, in noise, commands, start, goal and path. Facts
about its motion need no model.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import join_words
from turtlelog.errors import ReplayError
from turtlelog.identify.axis_fit import NORMAL_95
from turtlelog.identify.axis_model import AxisModel, Estimate
from turtlelog.identify.axis_motion import AXES, Axis, measure_axis_steps, read_axis_motion
from turtlelog.identify.held_response import HeldInput
from turtlelog.identify.robot_identification import identify_robot
from turtlelog.identify.robot_model import RobotModel
from turtlelog.identify.robot_noise import measure_disturbance_noise, measure_sensing_noise
from turtlelog.measure import Outlier, find_metric_kind, list_outliers
from turtlelog.measure.breaks import PoseGap, PoseJump, find_gaps, find_jumps
from turtlelog.replay import PlantReplay, follow_commands, moves_as_turtlesim, replay_plant
from turtlelog.run import Run
from turtlelog.run.loops import Cause

COMMANDS: Final = "commands"
NOISE: Final = "noise"
TIMES: Final = "pose times"
"""Parts that belong to no axis. A further one is named by its keys: start, goal and path."""

ROBOT: Final = "robot"
"""Basis of a robot's log: its model, driven by the recorded commands."""

CHANCE: Final = (NOISE, TIMES)
"""Parts that are chance instead of causes, because they do not belong to the robot."""

MOTIONS: Final[Mapping[Axis, str]] = {"speed": "driving", "turn_rate": "turning"}
"""Words for the motions of the axes, for names of parts."""

_FIELDS: Final[Mapping[str, tuple[str, ...]]] = {
    "gain": ("gain", "reverse_gain"),
    "dead time": ("dead_time_s",),
    "time constant": ("lag_s", "lag_product_s2", "model"),
    "limits": (
        *("bound", "bound_acts", "bound_beside"),
        *("rate_limit", "limit_acts", "rate_limit_beside", "jerk_time_s"),
    ),
    "friction": ("friction", "deadband"),
    "drift": ("drift",),
}
"""Fields of an axis that are exchanged together."""

_JOINED: Final[Mapping[str, tuple[str, ...]]] = {
    **{name: _FIELDS[name] for name in ("gain", "dead time")},
    "time constant and limits": (*_FIELDS["time constant"], *_FIELDS["limits"]),
    **{name: _FIELDS[name] for name in ("friction", "drift")},
}
"""Fields that are exchanged together if no model has one robot's time constant and the other's
limits."""

AXIS_PARTS: Final[Mapping[str, tuple[Axis, tuple[str, ...]]]] = {
    f"{part} {motion}": (axis, names)
    for axis, motion in MOTIONS.items()
    for part, names in {**_FIELDS, **_JOINED}.items()
}
"""Axis and fields of each part that belongs to an axis, by name: `gain turning`."""

_MOSTLY: Final = 0.98
"""Share of the steps between poses that are used; the fastest steps have the largest noise."""

_BEYOND: Final = 1.05  # factor on a bound that noise of poses does not exceed

_LEAST: Final = 1e-3
"""Smallest random value as a share of the value, so that no parameter is negative, however wide its
interval."""


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
    rates = {axis: measure_disturbance_noise(model, axis, [run]) for axis in AXES}
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
    found, names = [], ("bound", "bound_acts", "bound_beside")
    for log, other in zip(logs, reversed(logs), strict=True):
        taken: dict[str, Any] = {}
        for axis in AXES:
            own, known = get_axis(log.model, axis), get_axis(other.model, axis)
            if not own.is_known or own.bound is not None or known.bound is None:
                continue
            time_s, moved, is_sound = measure_axis_steps(log.run.poses, axis)
            rates = np.abs(moved / np.diff(time_s))[is_sound]
            reached = float(np.quantile(rates, _MOSTLY)) if len(rates) else 0.0
            if reached <= _BEYOND * known.bound.high:
                taken[axis] = replace(own, **{name: getattr(known, name) for name in names})
        found.append(replace(log, model=replace(log.model, **taken)) if taken else log)
    return found


def list_axes(metric: str) -> tuple[Axis, ...]:
    """Return the axes that a metric of a run depends on."""
    kind = find_metric_kind(metric)
    return AXES if kind is None or kind.axis is None else (kind.axis,)


def get_axis(model: RobotModel, axis: Axis) -> AxisModel:
    """Return the model of an axis."""
    return model.speed if axis == "speed" else model.turn_rate


def find_parts(first: RobotLog, second: RobotLog, axes: Iterable[Axis]) -> dict[str, Cause]:
    """Return the parts in which two logs differ, with the first log's values as neutral values."""
    values: dict[str, dict[str, object]] = {}
    for axis in axes:
        models = [get_axis(log.model, axis) for log in (first, second)]
        if not all(model.is_known for model in models):
            continue
        # Each robot may have to take the other's time constant without its limits.
        mixed = (
            replace(one, **{name: getattr(other, name) for name in _FIELDS["limits"]})
            for one, other in (models, models[::-1])
        )
        is_possible = all(model.structure.is_possible for model in mixed)
        for part, fields in (_FIELDS if is_possible else _JOINED).items():
            before, after = ({key: show_value(getattr(m, key)) for key in fields} for m in models)
            if before != after:
                name = f"{part} {MOTIONS[axis]}"
                values[name] = {f"{axis}.{key}": value for key, value in before.items()}
    noise, noise_after = asdict(first.noise), asdict(second.noise)
    places, places_after = _get_places(first.run), _get_places(second.run)
    if not any(one["goal"] or one["path"] for one in (places, places_after)):
        places = {}  # without a goal and a path, the start is not used
    values |= {
        NOISE: {f"{NOISE}.{key}": one for key, one in noise.items() if one != noise_after[key]},
        TIMES: {"poses": len(first.run.poses)},
        COMMANDS: {"commands": len(first.run.commands)},
    }
    moved = {key: one for key, one in places.items() if one != places_after[key]}
    values[join_words([*moved])] = moved
    return {
        name: Cause(name=name, kind="effect", neutral=found, meaning=f"as in {first.run.name}")
        for name, found in values.items()
        if found
    }


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
        one, other = (log.run.commands for log in logs)
        sides = ((one.speed_m_s, other.speed_m_s), (one.turn_rate_rad_s, other.turn_rate_rad_s))
        return not all(np.array_equal(*side) for side in sides)

    def lie_apart(key: str) -> bool:
        axis, _, name = key.partition(".")
        one, other = (getattr(getattr(log.model, axis), name) for log in logs)
        if one is None or other is None or isinstance(one, str):
            return bool(one != other)
        return bool(one.high < other.low or other.high < one.low)

    return is_place(keys) or any(lie_apart(key) for key in keys)


def is_place(keys: Iterable[str]) -> bool:
    """Return whether keys belong to the part that is exchanged as a whole: start, goal and path."""
    return not {"start", "goal", "path"}.isdisjoint(keys)


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
    tied = 0.0  # the correlation of total and time constant, from the errors of all three values
    if of_total and of_lag:
        tied = (of_total**2 + of_lag**2 - of_dead_time**2) / (2.0 * of_total * of_lag)
        tied = min(max(tied, -1.0), 1.0)
    total_s = max(total.value + of_total * numbers[0], 0.0)
    aside = tied * numbers[0] + math.sqrt(1.0 - tied * tied) * numbers[1]
    lag_s = min(max(lag.value + of_lag * aside, 0.0), total_s)
    product, ratio = model.lag_product_s2, lag_s / lag.value if lag.value else 1.0
    if product is not None:
        product = replace(product, value=product.value * ratio * ratio)
    drift = model.drift
    if drift is not None:  # the only value that may be negative
        moved = _find_error(drift) * sign * float(rng.standard_normal())
        drift = replace(drift, value=drift.value + moved)
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
        drift=drift,
    )


def _find_error(one: Estimate) -> float:
    """Return the standard error. An interval that ends at 0 is truncated there."""
    return max(one.high - one.value, one.value - one.low) / NORMAL_95


def _move(one: Estimate | None, number: float) -> Estimate | None:
    if one is None:
        return None
    value = one.value + _find_error(one) * float(number)
    return replace(one, value=max(value, _LEAST * one.value))


_SPREAD: Final = (5.0, 95.0)  # percentiles that bound the central 90 % of periods


@dataclass(frozen=True, slots=True, kw_only=True)
class Periods:
    """Times between successive rows of a table.

    Attributes:
        usual_ns: Median period [ns].
        low_ns: Lower end of the central 90 % [ns].
        high_ns: Upper end of the central 90 % [ns].
        longest_ns: Longest period [ns].
        longest_at_ns: Start of the longest period [ns].
    """

    usual_ns: float
    low_ns: float
    high_ns: float
    longest_ns: int
    longest_at_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Largest:
    """The command of the largest magnitude on an axis.

    Attributes:
        signal: `speed`, `lateral_speed` or `turn_rate`.
        unit: Unit of the signal.
        value: Signed value of the command.
        time_ns: Time of its first publication [ns].
    """

    signal: str
    unit: str
    value: float
    time_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Delays:
    """Delays from the publication of commands to the poses of turtlesim that show them.

    Attributes:
        counts: Number of commands by ticks of dead time: 0 is the first pose after the command.
        low_ns: Shortest time from a command to the pose that shows it [ns].
        median_ns: Median delay [ns].
        high_ns: Longest delay [ns].
    """

    counts: dict[int, int]
    low_ns: int
    median_ns: float
    high_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionFacts:
    """Facts about poses and commands, without the samples of a controller.

    Attributes:
        name: Name of the run.
        kind: Kind of robot that the poses belong to.
        poses: Times from one pose to the next; None for fewer than two poses.
        commands: Times from one command to the next; None for fewer than two commands.
        largest: Command of the largest magnitude on each used axis.
        outliers: Measured rates that their neighbours contradict.
        jumps: Steps that a robot cannot have driven; for turtlesim, the replay contains them.
        gaps: Segments without poses; for turtlesim, the replay contains them.
        replay: Result of replaying the commands in turtlesim's plant; None for another robot.
        refused: Reason why the replay in turtlesim's plant failed; empty after success, or for
            another robot.
        delays: Delays of turtlesim; None if no pose shows a command.
    """

    name: str
    kind: Literal["turtlesim", "robot"]
    poses: Periods | None
    commands: Periods | None
    largest: tuple[Largest, ...]
    outliers: tuple[Outlier, ...]
    jumps: tuple[PoseJump, ...]
    gaps: tuple[PoseGap, ...]
    replay: PlantReplay | None
    refused: str
    delays: Delays | None


def read_motion_facts(run: Run) -> MotionFacts:
    """Return facts from the poses and commands of a run, with or without samples."""
    is_turtlesim = moves_as_turtlesim(run)
    replay, refused = None, ""
    if is_turtlesim:
        try:
            replay = replay_plant(run)
        except ReplayError as err:
            refused = str(err)
    commands, largest = run.commands, list[Largest]()
    for signal, unit, values in (
        ("speed", "m/s", commands.speed_m_s),
        ("lateral_speed", "m/s", commands.lateral_speed_m_s),
        ("turn_rate", "rad/s", commands.turn_rate_rad_s),
    ):
        if values.any():
            row = int(np.abs(values).argmax())
            value, time_ns = float(values[row]), int(commands.time_ns[row])
            largest.append(Largest(signal=signal, unit=unit, value=value, time_ns=time_ns))
    return MotionFacts(
        name=run.name,
        kind="turtlesim" if is_turtlesim else "robot",
        poses=_measure_periods(run.poses.time_ns),
        commands=_measure_periods(run.commands.time_ns),
        largest=tuple(largest),
        outliers=list_outliers(run),
        jumps=find_jumps(run) if replay is None else (),
        gaps=find_gaps(run) if replay is None else (),
        replay=replay,
        refused=refused,
        delays=None if replay is None else _measure_delays(run),
    )


def _measure_periods(time_ns: NDArray[np.int64]) -> Periods | None:
    if len(time_ns) < 2:
        return None
    period_ns = np.diff(time_ns)
    low_ns, high_ns = np.percentile(period_ns, _SPREAD)
    longest = int(period_ns.argmax())
    return Periods(
        usual_ns=float(np.median(period_ns)),
        low_ns=float(low_ns),
        high_ns=float(high_ns),
        longest_ns=int(period_ns[longest]),
        longest_at_ns=int(time_ns[longest]),
    )


def _measure_delays(run: Run) -> Delays | None:
    command, pose = follow_commands(run).T
    if not len(command):
        return None
    published_ns = run.commands.time_ns[command]
    # A command may answer the pose at its own time. A recorder may write a command after the pose
    # that shows it, which is no dead time.
    ticks = np.maximum(pose - np.searchsorted(run.poses.time_ns, published_ns, "right"), 0)
    delay_ns = run.poses.time_ns[pose] - published_ns
    values, counts = np.unique(ticks, return_counts=True)
    return Delays(
        counts=dict(zip(values.tolist(), counts.tolist(), strict=True)),
        low_ns=int(delay_ns.min()),
        median_ns=float(np.median(delay_ns)),
        high_ns=int(delay_ns.max()),
    )
