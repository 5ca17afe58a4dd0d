"""Two recorded robots as a game: models, noise, commands and places of one in the other's log."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.explain.game import SEEDS, Coalition, Game, Outcome, Work
from turtlelog.explain.robot_parts import (
    COMMANDS,
    MOTIONS,
    NOISE,
    PATH,
    TIMES,
    RobotLog,
    draw_model,
    get_axis,
    list_fields,
)
from turtlelog.identify.axis_motion import AXES, Axis
from turtlelog.identify.motion_prediction import predict_response
from turtlelog.identify.robot_model import AxisModel
from turtlelog.measure import measure_run
from turtlelog.run import PoseColumns, Run
from turtlelog.run.angles import wrap_angle
from turtlelog.run.loops import Cause

Values = NDArray[np.float64]
Times = NDArray[np.int64]

_MIRRORED: Final = len(SEEDS) // 2
"""Draws that have a mirrored one each: their mean is that of the identified values."""


class RobotGame(Game):
    """Drives one robot's model with recorded commands, with some parts as another log has them.

    Each seed is a draw: of both robots' parameters within their intervals, and of the noise. What
    is measured is the recording whose commands are in, with the model's poses at its poses' times.
    """

    def __init__(
        self,
        first: RobotLog,
        second: RobotLog,
        metric: str,
        parts: Mapping[str, Cause],
        work: Work | None = None,
    ) -> None:
        """Take the logs; without a part, the second has the first one's."""
        super().__init__(parts, tuple(parts), work, is_random=True)
        self._logs, self._metric = (first, second), metric
        self._models: dict[int | None, list[dict[Axis, AxisModel]]] = {}
        self._ways: dict[object, tuple[Values, Values]] = {}

    def list_seeds(self, out: Coalition) -> tuple[int | None, ...]:  # noqa: ARG002
        """Return every draw: what is left of two robots is as uncertain as all of it."""
        return SEEDS

    def describe_ending(self, name: str) -> str:  # noqa: ARG002
        """Return nothing: a robot's log has no phases."""
        return ""

    def _play(self, plays: Sequence[tuple[Coalition, int | None]]) -> Iterator[Outcome]:
        for out, seed in plays:
            run = self.drive(out, seed)
            found = measure_run(run, only=[self._metric])[self._metric]
            yield Outcome(value=found.value, reason=found.reason, ended=())

    def drive(self, out: Coalition, seed: int | None = None) -> Run:
        """Return the recording of the commands with the poses of the robot without some parts."""
        base, places = self._get(COMMANDS, out).run, self._get(PATH, out).run
        noise = self._get(NOISE, out).noise
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
        return replace(
            base,
            poses=PoseColumns(
                time_ns=time_ns,
                xy_m=poses[:, :2],
                heading_rad=wrap_angle(poses[:, 2]),
                **{name: motions[axis][1] for name, axis in self._list_reported(out)},
            ),
            goal_xy_m=places.goal_xy_m,
            goal_heading_rad=places.goal_heading_rad,
            parameters=places.parameters,
        )

    def _get(self, part: str, out: Coalition) -> RobotLog:
        """Return the log that a part is of."""
        return self._logs[part not in out]

    def _list_reported(self, out: Coalition) -> list[tuple[str, Axis]]:
        """Return the rates that a robot itself reports beside its poses."""
        poses = self._get(TIMES, out).run.poses
        names: dict[str, Axis] = {
            "measured_speed_m_s": "speed",
            "measured_turn_rate_rad_s": "turn_rate",
        }
        return [pair for pair in names.items() if getattr(poses, pair[0]) is not None]

    def _find_times(self, out: Coalition) -> Times:
        base, timed = self._get(COMMANDS, out).run, self._get(TIMES, out).run
        return place_times(base, timed)

    def _predict(self, axis: Axis, out: Coalition, seed: int | None) -> tuple[Values, Values]:
        """Return the way or turn, and the rate, at each pose of what is recorded."""
        parts = frozenset(name for name in out if name.endswith(MOTIONS[axis]))
        log = self._get(COMMANDS, out)
        key = axis, parts, COMMANDS in out, TIMES in out, seed
        if key not in self._ways:
            time_s = self._find_times(out) / 1e9
            model = self._exchange(axis, parts, seed)
            still = np.zeros(len(time_s))
            self._ways[key] = (
                predict_response(model, log.commands[axis], time_s)
                if model.is_known
                else (still, still)
            )
        return self._ways[key]

    def _exchange(self, axis: Axis, parts: Coalition, seed: int | None) -> AxisModel:
        """Return an axis of the second robot with some parts as the first has them."""
        if seed not in self._models:
            self._models[seed] = _draw_models(self._logs, seed)
        first, second = (models[axis] for models in self._models[seed])
        if not second.is_known or not first.is_known:
            return second if second.is_known else first
        motion = f" {MOTIONS[axis]}"
        fields = [name for part in parts for name in list_fields(part.removesuffix(motion))]
        return replace(second, **{name: getattr(first, name) for name in fields})


def _draw_models(logs: Sequence[RobotLog], seed: int | None) -> list[dict[Axis, AxisModel]]:
    """Return the axes of both robots, as identified or drawn from their intervals."""
    models = [{axis: get_axis(log.model, axis) for axis in AXES} for log in logs]
    if seed is None:
        return models
    number = SEEDS.index(seed)
    rng = np.random.default_rng(number % _MIRRORED)
    sign = 1.0 if number < _MIRRORED else -1.0
    return [{axis: draw_model(model, rng, sign) for axis, model in one.items()} for one in models]


def place_times(base: Run, timed: Run) -> Times:
    """Return times for the poses of a recording [ns], at which those of another one were recorded.

    The first commands of both are at one time. What the other one does not last for has its times
    once more; half a period more or less at the ends counts for nothing.
    """
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


def _integrate(ways_m: Values, turns_rad: Values, places: Run) -> Values:
    """Return x, y [m] and heading [rad] along steps from a recorded start on, shape (n, 3)."""
    poses = np.empty((len(ways_m) + 1, 3))
    poses[0, :2], poses[0, 2] = places.poses.xy_m[0], places.poses.heading_rad[0]
    poses[1:, 2] = poses[0, 2] + np.cumsum(turns_rad)
    middle_rad = poses[:-1, 2] + 0.5 * turns_rad
    # The chord of an arc is shorter than the way along it.
    chords_m = ways_m * np.sinc(turns_rad / (2.0 * np.pi))
    poses[1:, 0] = poses[0, 0] + np.cumsum(chords_m * np.cos(middle_rad))
    poses[1:, 1] = poses[0, 1] + np.cumsum(chords_m * np.sin(middle_rad))
    return poses
