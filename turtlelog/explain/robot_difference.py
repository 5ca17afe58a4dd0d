"""Explanation of the difference between two robots' logs by parts of the robots."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from statistics import fmean, stdev
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import join_words
from turtlelog.explain import answers, robot_log
from turtlelog.explain.answers import Change, Contribution, Side
from turtlelog.explain.contributions import ORDERS, divide_game, sample_game
from turtlelog.explain.difference_report import ExplainedDifference
from turtlelog.explain.game import SEEDS, Coalition, Game, Outcome, Work
from turtlelog.explain.robot_log import COMMANDS, ROBOT, RobotLog
from turtlelog.identify.axis_fit import NORMAL_95
from turtlelog.identify.axis_model import AxisModel, predict_response
from turtlelog.identify.axis_motion import AXES, NAMES, Axis
from turtlelog.measure import measure_run
from turtlelog.measure.pose_quality import describe_breaks
from turtlelog.run import PoseColumns, Run
from turtlelog.run.angles import wrap_angle
from turtlelog.run.columns import take_rows
from turtlelog.run.loops import Cause, Declaration

_MOST_EXACT: Final = 5
"""Largest number of parts for which all combinations are driven, with every draw: some thousand
drives."""

_MOST_UNEXPLAINED: Final = 1.0 / 3.0
"""Largest share of the difference that the models may leave unexplained."""

_ACTS: Final = 1e-3
"""Share of the difference below which a part does not act, when it is changed in either log."""

_LAW_ACTS: Final = "its controller is known, the other one's is not, so its law counts as commands"

_BY_CHANCE: Final = 2.0
"""Difference of two logs, in standard deviations, below which robots count as equal."""


def explain_robots(
    first: Run, second: Run, metric: str, unit: str, work: Work | None = None
) -> ExplainedDifference:
    """Explain why a metric differs between two logs whose robots are identified.

    Each robot's model is driven with recorded commands, with every set of parts taken from the
    other log. The remaining difference is a part of its own.
    """
    runs = _leave_paths([_leave_controller(run) for run in (first, second)], metric)
    left = [not given.is_lawless for given in (first, second)]
    logged = [measure_run(run, only=[metric])[metric] for run in runs]
    laws = [_LAW_ACTS if is_left and not all(left) else "" for is_left in left]
    jumps = [describe_breaks(run).get("jumps", "") for run in runs]  # which no model explains
    notes = ["; ".join(filter(None, pair)) for pair in zip(laws, jumps, strict=True)]
    sides = [
        Side(name=run.name, as_logged=one.value, reason=one.reason, basis=ROBOT, note=note)
        for run, one, note in zip(runs, logged, notes, strict=True)
    ]
    found = ExplainedDifference(
        metric=metric,
        unit=unit,
        first=sides[0],
        second=sides[1],
        resolution=answers.Resolution(size=0.0, reason=answers.ResolutionReason.NO_SCENARIO),
    )
    one, other = (side.as_logged for side in sides)
    if one is None or other is None:
        return replace(found, withheld="one log has no value")
    found = replace(found, difference=other - one)
    if abs(other - one) <= answers.SAME * max(abs(one), abs(other)):
        return found
    lacking = [run.name for run in runs if not len(run.commands)]
    if lacking:
        reason = f"{join_words(lacking)}: no commands are recorded, so no robot can be identified"
        return replace(found, withheld=reason)
    logs = robot_log.share_unseen_bounds([robot_log.read_robot_log(run) for run in runs])
    axes = robot_log.list_axes(metric)
    models = [{axis: robot_log.get_axis(log.model, axis) for axis in axes} for log in logs]
    # Axes that are commanded in only one of the logs.
    first_idle, second_idle = (
        tuple(axis for axis in axes if own[axis].is_idle and other[axis].is_known)
        for own, other in (models, models[::-1])
    )
    found = replace(
        found,
        first=replace(found.first, unknown=first_idle),
        second=replace(found.second, unknown=second_idle),
    )
    obstacles = [
        f"the {NAMES[axis]} of {log.run.name} cannot be identified: {model.reason}"
        for log, own in zip(logs, models, strict=True)
        for axis, model in own.items()
        if not (model.is_known or model.is_idle)
    ]
    if obstacles:
        return replace(found, withheld="; ".join(obstacles))
    parts = robot_log.find_parts(logs[0], logs[1], axes)
    return _divide(found, logs, parts, work)


def _leave_controller(run: Run) -> Run:
    """Return a run reduced to a robot's log: its poses and commands, goal and path."""
    if run.is_lawless:
        return run
    kept = {key: value for key, value in run.parameters.items() if key.startswith("path.")}
    return replace(
        run,
        samples=take_rows(run.samples, slice(0, 0)),
        declaration=Declaration(),
        parameters=kept,
        scenario_is_complete=False,
    )


def _leave_paths(runs: list[Run], metric: str) -> list[Run]:
    """Return runs without their paths, if the metric does not depend on them."""
    bare = [
        replace(run, parameters={k: v for k, v in run.parameters.items() if "path." not in k})
        for run in runs
    ]
    values = [[measure_run(run, only=[metric])[metric].value for run in of] for of in (runs, bare)]
    return bare if values[0] == values[1] else runs


def _divide(
    found: ExplainedDifference,
    logs: Sequence[RobotLog],
    parts: Mapping[str, Cause],
    work: Work | None,
) -> ExplainedDifference:
    """Return the difference divided among the parts that act, or why it is withheld."""
    acting = _find_acting(found, logs, parts)
    game = RobotGame(logs[0], logs[1], found.metric, acting, work)
    base = answers.AttributedValue(
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
    played = [game.take_out_each(out) for out in (acting, ())]
    ends = [[one.value for one in side if one.value is not None] for side in played]
    changes = _list_changes(logs, parts)
    surely = tuple(one for one in changes if robot_log.differs_surely(one.name, one.keys, logs))
    idle = tuple(
        key
        for one in surely
        if one.name not in acting
        for key in one.keys
        if robot_log.differs_surely(one.name, [key], logs)
    )
    found = replace(found, changes=surely, seeds=len(SEEDS))
    if divided.withheld:
        return replace(found, withheld=divided.withheld)
    listed = {one.name: one for one in changes}
    shares = sorted(divided.contributions, key=lambda one: -abs(one.size))
    contributions = tuple(_complete(listed[one.cause], one) for one in shares)
    explained = math.fsum(one.size for one in contributions)
    found = replace(
        found,
        first=replace(found.first, resimulated=fmean(ends[0])),
        second=replace(found.second, resimulated=fmean(ends[1])),
        unexplained=(found.difference or 0.0) - explained,
        orders=None if is_exact else ORDERS,
    )
    if doubt := _find_doubt(found, chance=_BY_CHANCE * math.hypot(*map(stdev, ends))):
        return replace(found, withheld=doubt)
    return replace(
        found, contributions=contributions, changes=(), idle=idle, together=divided.together
    )


def _list_changes(logs: Sequence[RobotLog], parts: Mapping[str, Cause]) -> list[Change]:
    """Return the parts of the robots with their values in both logs."""
    changes = []
    for part in parts.values():
        first, second = (
            tuple(robot_log.list_part_values(log, part.neutral).values()) for log in logs
        )
        keys = tuple(part.neutral)
        changes.append(Change(name=part.name, keys=keys, first=first, second=second))
    return changes


def _find_doubt(found: ExplainedDifference, *, chance: float) -> str:
    """Return why the contributions to a difference mean nothing; empty if they do."""
    difference = abs(found.difference or 0.0)
    if difference <= chance:
        reason = f"noise and the identified intervals alone make up to {chance:.2g} {found.unit}"
        return reason.removesuffix(" 1")
    share = abs(found.unexplained or 0.0) / difference
    if share > _MOST_UNEXPLAINED:
        return f"the robots' models leave {100.0 * share:.0f} % of the difference unexplained"
    return ""


def _find_acting(
    found: ExplainedDifference, logs: Sequence[RobotLog], parts: Mapping[str, Cause]
) -> dict[str, Cause]:
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


def _complete(change: Change, share: Contribution) -> Change:
    """Return a change with its contribution, with the standard error of a single draw.

    That of the mean over draws would be too small by the root of their number.
    """
    error = (share.standard_error or 0.0) * math.sqrt(len(SEEDS))
    size = share.size
    return replace(
        change,
        contribution=size,
        standard_error=error,
        low=size - NORMAL_95 * error,
        high=size + NORMAL_95 * error,
        undone=share.alone,
    )


Values = NDArray[np.float64]
Times = NDArray[np.int64]

_MIRRORED: Final = len(SEEDS) // 2
"""Number of draws that have a mirrored draw each, so that the mean equals the identified values."""


class RobotGame(Game):
    """Simulations of one robot's model with recorded commands and some parts from the other log.

    Each seed draws both robots' parameters within their intervals, and the noise. The measured run
    has the commands of a recording, and the model's poses at its times.
    """

    def __init__(
        self,
        first: RobotLog,
        second: RobotLog,
        metric: str,
        parts: Mapping[str, Cause],
        work: Work | None = None,
    ) -> None:
        """Store the logs. A removed part gives the second robot the first robot's values."""
        super().__init__(parts, tuple(parts), work, is_random=True)
        self._logs, self._metric = (first, second), metric
        self._place = next((n for n, one in parts.items() if robot_log.is_place(one.neutral)), "")
        self._models: dict[int | None, list[dict[Axis, AxisModel]]] = {}
        self._ways: dict[object, tuple[Values, Values]] = {}

    def list_seeds(self, out: Coalition) -> tuple[int | None, ...]:  # noqa: ARG002
        """Return all seeds, because each seed samples the uncertain parameters of both robots."""
        return SEEDS

    def describe_ending(self, name: str) -> str:  # noqa: ARG002
        """Return an empty text, because a robot's log has no phases."""
        return ""

    def _play(self, plays: Sequence[tuple[Coalition, int | None]]) -> Iterator[Outcome]:
        for out, seed in plays:
            run = self.drive(out, seed)
            found = measure_run(run, only=[self._metric])[self._metric]
            yield Outcome(value=found.value, reason=found.reason, ended=())

    def drive(self, out: Coalition, seed: int | None = None) -> Run:
        """Return the recording of the commands, with the poses of the robot without some parts."""
        base, places = self._get(COMMANDS, out).run, self._get(self._place, out).run
        noise = self._get(robot_log.NOISE, out).noise
        rng = np.random.default_rng(0 if seed is None else seed)
        time_ns = self._find_times(out)
        root_s = np.sqrt(np.diff(time_ns) / 1e9)
        motions = {axis: self._predict(axis, out, seed) for axis in AXES}
        speed, turn_rate = (
            np.diff(motions[axis][0])
            + getattr(noise, axis) * root_s * rng.standard_normal(len(root_s))
            for axis in AXES
        )
        poses = _integrate(speed, turn_rate, places)
        sizes = noise.position_m, noise.position_m, noise.heading_rad
        poses += rng.standard_normal(poses.shape) * sizes
        timed = self._get(robot_log.TIMES, out).run.poses
        rates = zip(("measured_speed_m_s", "measured_turn_rate_rad_s"), AXES, strict=True)
        return replace(
            base,
            poses=PoseColumns(
                time_ns=time_ns,
                xy_m=poses[:, :2],
                heading_rad=wrap_angle(poses[:, 2]),
                **{
                    name: motions[axis][1]
                    for name, axis in rates
                    if getattr(timed, name) is not None
                },
            ),
            goal_xy_m=places.goal_xy_m,
            goal_heading_rad=places.goal_heading_rad,
            parameters=places.parameters,
        )

    def _get(self, part: str, out: Coalition) -> RobotLog:
        return self._logs[part not in out]

    def _find_times(self, out: Coalition) -> Times:
        """Return times for the poses of a recording [ns], taken from those of another recording.

        The first commands of both are at one time. Beyond the end of the other recording, its times
        repeat. Half a period at either end is ignored.
        """
        base, timed = self._get(COMMANDS, out).run, self._get(robot_log.TIMES, out).run
        time_ns = timed.poses.time_ns
        if timed is base or len(time_ns) < 2:
            return base.poses.time_ns
        period_ns = int(np.median(np.diff(time_ns)))
        first_ns = int(base.poses.time_ns[0]) - period_ns // 2
        last_ns = int(base.poses.time_ns[-1]) + period_ns // 2
        time_ns = time_ns - timed.commands.time_ns[0] + base.commands.time_ns[0]
        again_ns = int(time_ns[-1] - time_ns[0]) + period_ns
        low, high = (int((end_ns - time_ns[0]) // again_ns) for end_ns in (first_ns, last_ns))
        repeated = (time_ns + np.arange(low, high + 1)[:, None] * again_ns).ravel()
        return np.asarray(repeated[(repeated >= first_ns) & (repeated <= last_ns)])

    def _predict(self, axis: Axis, out: Coalition, seed: int | None) -> tuple[Values, Values]:
        """Return the distance or turn, and the rate, at each pose of the recording."""
        own = {name for name, (of, _) in robot_log.AXIS_PARTS.items() if of == axis}
        parts = frozenset(out & own)
        log = self._get(COMMANDS, out)
        key = axis, parts, COMMANDS in out, robot_log.TIMES in out, seed
        if key not in self._ways:
            time_s = self._find_times(out) / 1e9
            model = self._exchange(axis, parts, seed)
            still = np.zeros(len(time_s))
            beside = log.commands["turn_rate" if axis == "speed" else "speed"]
            self._ways[key] = (
                predict_response(model, log.commands[axis], time_s, beside)
                if model.is_known
                else (still, still)
            )
        return self._ways[key]

    def _exchange(self, axis: Axis, parts: Coalition, seed: int | None) -> AxisModel:
        """Return an axis of the second robot with some parts from the first."""
        if seed not in self._models:
            models = [
                {name: robot_log.get_axis(log.model, name) for name in AXES} for log in self._logs
            ]
            if seed is not None:  # drawn from the intervals
                number = SEEDS.index(seed)
                rng = np.random.default_rng(number % _MIRRORED)
                sign = 1.0 if number < _MIRRORED else -1.0
                models = [
                    {name: robot_log.draw_model(a, rng, sign) for name, a in one.items()}
                    for one in models
                ]
            self._models[seed] = models
        first, second = (one[axis] for one in self._models[seed])
        if not second.is_known or not first.is_known:
            return second if second.is_known else first
        fields = [name for part in parts for name in robot_log.AXIS_PARTS[part][1]]
        return replace(second, **{name: getattr(first, name) for name in fields})


def _integrate(ways_m: Values, turns_rad: Values, places: Run) -> Values:
    """Return x, y [m] and heading [rad] after each step from a recorded start, shape (n, 3)."""
    poses = np.empty((len(ways_m) + 1, 3))
    poses[0, :2], poses[0, 2] = places.poses.xy_m[0], places.poses.heading_rad[0]
    poses[1:, 2] = poses[0, 2] + np.cumsum(turns_rad)
    middle_rad = poses[:-1, 2] + 0.5 * turns_rad
    # The chord of an arc is shorter than the arc.
    chords_m = ways_m * np.sinc(turns_rad / (2.0 * np.pi))
    poses[1:, 0] = poses[0, 0] + np.cumsum(chords_m * np.cos(middle_rad))
    poses[1:, 1] = poses[0, 1] + np.cumsum(chords_m * np.sin(middle_rad))
    return poses
