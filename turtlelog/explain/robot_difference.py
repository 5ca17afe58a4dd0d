"""Why two logs of robots differ: what each part of the identified robots contributes."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from statistics import fmean, stdev
from typing import Final

from turtlelog.display import join_words
from turtlelog.explain.attribute import divide_game
from turtlelog.explain.attribution import Attribution, Contribution, Resolution
from turtlelog.explain.explained_difference import (
    ROBOT,
    Change,
    ExplainedDifference,
    Side,
)
from turtlelog.explain.game import SEEDS, Work
from turtlelog.explain.robot_game import RobotGame
from turtlelog.explain.robot_parts import (
    RobotLog,
    differs_surely,
    find_parts,
    get_axis,
    list_axes,
    list_values,
    read_robot_log,
    share_unseen_bounds,
)
from turtlelog.explain.sampled_orders import ORDERS, sample_game
from turtlelog.identify.axis_motion import NAMES, Axis
from turtlelog.identify.axis_values import NORMAL_95
from turtlelog.measure import measure_run
from turtlelog.run import Run
from turtlelog.run.columns import take_rows
from turtlelog.run.loops import Cause, Declaration

_MOST_EXACT: Final = 5
"""Parts whose combinations are all driven, with every draw: some thousand times."""

_MOST_UNEXPLAINED: Final = 1.0 / 3.0
"""Of the difference: where the models leave more, they do not say what makes it."""

_ACTS: Final = 1e-3
"""Of the difference: a part that changes the metric by less, from either side, does not act."""

_SAME: Final = 1e-6
"""Of a value: a smaller difference is none."""

_LAW_ACTS: Final = "its controller is known, the other one's is not, so its law counts as commands"

_BY_CHANCE: Final = 2.0
"""Standard deviations of what two logs of the same two robots differ by: less is no difference."""


def is_robot_log(run: Run) -> bool:
    """Return whether nothing is known of the controller, but poses and commands are there."""
    return not len(run.samples) and not run.declaration.loops


def explain_robots(
    first: Run, second: Run, metric: str, unit: str, work: Work | None = None
) -> ExplainedDifference:
    """Explain why a metric differs between two logs whose robots are identified.

    Each robot's model is driven with recorded commands, with every set of parts as in the other
    log. What the models leave of the difference is a part of its own.
    """
    runs = [_leave_controller(run) for run in (first, second)]
    left = [run is not given for run, given in zip(runs, (first, second), strict=True)]
    sides = [
        _measure_side(run, metric, note=_LAW_ACTS if is_left and not all(left) else "")
        for run, is_left in zip(runs, left, strict=True)
    ]
    found = ExplainedDifference(
        metric=metric,
        unit=unit,
        first=sides[0],
        second=sides[1],
        resolution=Resolution(size=0.0, reason="no scenario is known"),
    )
    one, other = (side.as_logged for side in sides)
    if one is None or other is None:
        return replace(found, withheld="one log has no value")
    found = replace(found, difference=other - one)
    if abs(other - one) <= _SAME * max(abs(one), abs(other)):
        return found
    lacking = [run.name for run in runs if not len(run.commands)]
    if lacking:
        reason = f"{join_words(lacking)}: no commands are recorded, so no robot can be identified"
        return replace(found, withheld=reason)
    logs = share_unseen_bounds([read_robot_log(run) for run in runs])
    axes = list_axes(metric)
    found = replace(
        found,
        first=replace(found.first, unknown=_list_idle(logs, axes, 0)),
        second=replace(found.second, unknown=_list_idle(logs, axes, 1)),
    )
    obstacles = [text for log in logs for axis in axes if (text := _find_obstacle(log, axis))]
    if obstacles:
        return replace(found, withheld="; ".join(obstacles))
    parts = find_parts(logs[0], logs[1], axes)
    return _divide(found, logs, parts, work)


def _leave_controller(run: Run) -> Run:
    """Return a run as a robot's log: its poses and commands, goal and path."""
    if is_robot_log(run):
        return run
    kept = {key: value for key, value in run.parameters.items() if key.startswith("path.")}
    return replace(
        run,
        samples=take_rows(run.samples, slice(0, 0)),
        declaration=Declaration(),
        parameters=kept,
        scenario_is_complete=False,
    )


def _measure_side(run: Run, metric: str, note: str) -> Side:
    logged = measure_run(run, only=[metric])[metric]
    return Side(name=run.name, as_logged=logged.value, reason=logged.reason, basis=ROBOT, note=note)


def _list_idle(logs: Sequence[RobotLog], axes: Sequence[Axis], row: int) -> tuple[str, ...]:
    """Return the axes that one robot is never commanded of, and the other is."""
    one, other = logs[row].model, logs[1 - row].model
    return tuple(
        axis for axis in axes if get_axis(one, axis).is_idle and get_axis(other, axis).is_known
    )


def _find_obstacle(log: RobotLog, axis: Axis) -> str:
    """Return why an axis is not known though it is commanded; empty where it is known, or idle."""
    model = get_axis(log.model, axis)
    if model.is_known or model.is_idle:
        return ""
    return f"the {NAMES[axis]} of {log.run.name} cannot be identified: {model.reason}"


def _divide(
    found: ExplainedDifference,
    logs: Sequence[RobotLog],
    parts: Mapping[str, Cause],
    work: Work | None,
) -> ExplainedDifference:
    """Return the difference divided among the parts that act, or why it is not."""
    difference = found.difference or 0.0
    acting = _find_acting(found, logs, parts)
    game = RobotGame(logs[0], logs[1], found.metric, acting, work)
    base = Attribution(
        metric=found.metric,
        unit=found.unit,
        resimulated=game.play_as_recorded().value,
        without_all=game.play_as_recorded(acting).value,
        causes=tuple(acting),
        contributions=(),
        others=(),
        resolution=found.resolution,
    )
    if base.resimulated is None or base.without_all is None:
        return replace(found, withheld="the robots' models have no value of this metric")
    is_exact = len(acting) <= _MOST_EXACT
    divided = divide_game(base, game) if is_exact else sample_game(base, game)
    values = [[one.value for one in game.take_out_each(out)] for out in (acting, ())]
    ends = [[value for value in side if value is not None] for side in values]
    changes = [_describe(one, logs) for one in parts.values()]
    surely = tuple(one for one in changes if differs_surely(one.name, one.keys, logs))
    found = replace(found, changes=surely, seeds=len(SEEDS))
    if divided.withheld:
        return replace(found, withheld=divided.withheld)
    listed = {one.name: one for one in changes}
    shares = sorted(divided.contributions, key=lambda one: -abs(one.contribution or 0.0))
    contributions = tuple(_complete(listed[one.cause], one) for one in shares)
    explained = math.fsum(one.contribution or 0.0 for one in contributions)
    sides = [
        replace(side, resimulated=fmean(drawn))
        for side, drawn in zip((found.first, found.second), ends, strict=True)
    ]
    found = replace(
        found,
        first=sides[0],
        second=sides[1],
        unexplained=difference - explained,
        orders=None if is_exact else ORDERS,
    )
    chance = _BY_CHANCE * math.hypot(*(stdev(drawn) for drawn in ends))
    if abs(difference) <= chance:
        reason = f"noise and the identified intervals alone make up to {chance:.2g} {found.unit}"
        return replace(found, withheld=reason.removesuffix(" 1"))
    share = abs(found.unexplained or 0.0) / abs(difference)
    if share > _MOST_UNEXPLAINED:
        reason = f"the robots' models leave {100.0 * share:.0f} % of the difference unexplained"
        return replace(found, withheld=reason)
    idle = tuple(key for name in parts if name not in acting for key in listed[name].keys)
    return replace(
        found,
        contributions=contributions,
        changes=(),
        idle=idle,
        together=divided.together,
    )


def _find_acting(
    found: ExplainedDifference, logs: Sequence[RobotLog], parts: Mapping[str, Cause]
) -> dict[str, Cause]:
    """Return the parts that change the metric alone, in the one log or in the other."""
    game = RobotGame(logs[0], logs[1], found.metric, parts)
    least = _ACTS * abs(found.difference or 0.0)

    def moves(out: frozenset[str], other: frozenset[str]) -> bool:
        one, two = (game.play_as_recorded(names).value for names in (out, other))
        return (one is None) != (two is None) or abs((one or 0.0) - (two or 0.0)) > least

    every, none = frozenset(parts), frozenset[str]()
    return {
        name: part
        for name, part in parts.items()
        if moves(none, frozenset({name})) or moves(every, every - {name})
    }


def _describe(part: Cause, logs: Sequence[RobotLog]) -> Change:
    keys = tuple(part.neutral)
    first, second = (tuple(list_values(log, keys).values()) for log in logs)
    return Change(name=part.name, keys=keys, first=first, second=second)


def _complete(change: Change, share: Contribution) -> Change:
    """Return a change with its contribution; each draw may be the truth, so they are not averaged.

    The error of a mean over draws is smaller than that of one by the root of their number.
    """
    error = (share.standard_error or 0.0) * math.sqrt(len(SEEDS))
    size = share.contribution or 0.0
    return replace(
        change,
        contribution=size,
        standard_error=error,
        low=size - NORMAL_95 * error,
        high=size + NORMAL_95 * error,
        undone=share.alone,
    )
