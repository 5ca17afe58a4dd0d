"""What laws that track a path have in common: their loops, and where the robot should be."""

import math
from abc import ABC, abstractmethod
from typing import Any, ClassVar, NamedTuple

from turtlelog.angles import wrap_angle
from turtlelog.errors import LawError
from turtlelog.laws.base import Decision, Goal, Pose
from turtlelog.loops import ControlLoop, Declaration, Mechanism
from turtlelog.path_pieces import PathPoint
from turtlelog.paths import Path, PathFollower

_TRACK = "track"
_NO_GOAL = math.nan


class Target(NamedTuple):
    """The reference at one pose, and where the robot is on the path.

    Attributes:
        point: Where the robot should be: by time, or the point of the path nearest to it.
        speed_m_s: How fast that point moves along the path [m/s].
        behind_m: How far the robot is behind it along the path [m]; 0 where no time belongs to it.
        nearest_m: Arc length of the point that is nearest to the robot [m].
        is_over: Whether the reference is at the end of the path.
    """

    point: PathPoint
    speed_m_s: float
    behind_m: float
    nearest_m: float
    is_over: bool


class PathTracker(ABC):
    """A law with the phase `track` and the loops `along` and `cross`.

    Where the path has a speed, the reference leaves its beginning with the first sample and moves
    at that speed; the run ends when it reaches the end. Otherwise the reference is the point of the
    path nearest to the robot, and the run ends within a tolerance of the end.
    """

    kind: ClassVar[str]
    along_gain: ClassVar[str]
    mechanisms: ClassVar[tuple[Mechanism, ...]] = ()
    counts_samples: ClassVar[tuple[str, ...]] = ()

    @classmethod
    def declare(cls, parameters: Any, goal: Goal | None, path: Path | None) -> Declaration:
        """Return the loops along and across the path, which act at the same time."""
        del parameters, goal
        along = ControlLoop(
            name="along",
            signal="along_track",
            command="speed",
            reference="path",
            gain=cls._name_gain(cls._require(path)),
            is_proportional=False,
        )
        cross = ControlLoop(
            name="cross",
            signal="cross_track",
            command="turn_rate",
            reference="path",
            is_proportional=False,
        )
        phases = {_TRACK: ("along", "cross")}
        return Declaration(loops=(along, cross), phases=phases, uses_goal=False)

    def __init__(self, parameters: Any) -> None:
        """Take the parameters."""
        self._parameters = parameters

    def reset(self, start: Pose, goal: Goal | None, path: Path | None) -> None:
        """Begin at the beginning of the path."""
        del start, goal
        self._path = self._require(path)
        self._follower = PathFollower(self._path)
        self._first_ns: int | None = None
        self._begin_m: float | None = None

    def step(self, time_ns: int, pose: Pose) -> Decision:
        """Answer one pose."""
        target = self._find_target(time_ns, pose)
        speed_m_s, turn_rate_rad_s = (0.0, 0.0) if target.is_over else self._steer(pose, target)
        point = target.point
        return Decision(
            speed_m_s=speed_m_s,
            turn_rate_rad_s=turn_rate_rad_s,
            phase=_TRACK,
            bearing_rad=_NO_GOAL,
            heading_error_rad=wrap_angle(point.heading_rad - pose.heading_rad),
            error_x_m=_NO_GOAL,
            error_y_m=_NO_GOAL,
            reference=Pose(point.x_m, point.y_m, point.heading_rad),
            stop_reason="path_end" if target.is_over else None,
        )

    @abstractmethod
    def _steer(self, pose: Pose, target: Target) -> tuple[float, float]:
        """Return the wanted speed [m/s] and turn rate [rad/s]."""

    def _find_target(self, time_ns: int, pose: Pose) -> Target:
        path, length_m = self._path, self._path.length_m
        if path.speed_m_s is None:
            return self._find_nearest(pose)
        if self._first_ns is None:
            self._first_ns = time_ns
        due_m = min(path.speed_m_s * ((time_ns - self._first_ns) / 1e9), length_m)
        nearest_m = self._follower.advance(pose.x_m, pose.y_m, due_m).arc_m
        behind_m = due_m - nearest_m
        return Target(path.locate(due_m), path.speed_m_s, behind_m, nearest_m, due_m >= length_m)

    def _find_nearest(self, pose: Pose) -> Target:
        """Return the target on a path without a speed; a closed one is over after a whole lap."""
        path, follower = self._path, self._follower
        nearest_m = follower.advance(pose.x_m, pose.y_m).arc_m
        if self._begin_m is None and follower.arc_m is not None:
            self._begin_m = nearest_m if path.is_closed else 0.0
        end_m = (self._begin_m or 0.0) + path.length_m - self._parameters.end_tolerance_m
        is_over = self._begin_m is not None and nearest_m >= end_m
        # On a closed path the next lap begins with the direction of its first leg.
        point = path.locate(nearest_m if is_over else path.find_on_first_lap(nearest_m))
        return Target(point, self._parameters.speed_m_s, 0.0, nearest_m, is_over)

    @classmethod
    def _name_gain(cls, path: Path) -> str | None:
        """Return the scenario key of the gain along a path, None where there is no such error."""
        return None if path.speed_m_s is None else f"law.{cls.along_gain}"

    @classmethod
    def _require(cls, path: Path | None) -> Path:
        if path is None:
            raise LawError(f"{cls.kind}: expected a path to track, found no table [path]")
        return path
