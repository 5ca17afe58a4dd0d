"""Why a run ended, how it ended at its goal, and the line to its goal.

The reasons have words, numbers in a loop, and a meaning for the run. A law of the user's own may
end a run with any other word.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

from turtlelog.display import format_short
from turtlelog.run.angles import wrap_angle

if TYPE_CHECKING:
    from turtlelog.run.run import Run

WITHIN_TOLERANCE: Final = "within_tolerance"
STANDSTILL: Final = "standstill"
SETTLED: Final = "settled"
PATH_END: Final = "path_end"
END_OF_SIGNAL: Final = "end_of_signal"
TIMEOUT: Final = "timeout"
"""The law exceeded its time."""

MAX_DURATION: Final = "max_duration"
"""The scenario's `max_duration_s` had passed."""

LAW_FAILED: Final = "law_failed"
STEP_BUDGET: Final = "step_budget"
"""The law exceeded the time limit of one answer."""

INTERRUPTED: Final = "interrupted"
"""The run was ended from outside."""

FINISHED: Final = "finished"
"""The controller ended the run; its log does not say why."""

OF_LOOP: Final = (MAX_DURATION, LAW_FAILED, STEP_BUDGET)
"""Stop reasons that the loop sets; their numbers are -1, -2, -3. Those of its law are 1, 2, ..."""

CUT_SHORT = frozenset({*OF_LOOP, INTERRUPTED})
"""Stop reasons of runs that the controller did not end itself."""

FROM_OUTSIDE: Final = (None, INTERRUPTED)
"""Stop reasons of runs that might have continued if the recording had not ended."""

AT_REST: Final = frozenset({WITHIN_TOLERANCE, STANDSTILL, PATH_END})
"""Stop reasons of a run that came to rest, or to the end of its path, by itself."""

AT_GOAL: Final = frozenset({WITHIN_TOLERANCE, STANDSTILL, SETTLED})
"""Stop reasons of a run whose law considered itself at the goal."""

MAY_MISS: Final = AT_GOAL | {TIMEOUT, MAX_DURATION}
"""Stop reasons of built-in laws in runs that do not reach the goal; `within_tolerance` of a law
that reads late or wrong poses."""


def number_stop(reason: str) -> int:
    """Return the number of a stop reason that the loop sets, which is below 0."""
    return -1 - OF_LOOP.index(reason)


def name_stop(number: int, of_law: Sequence[str]) -> str:
    """Return the stop reason with a number; `of_law` are the stop reasons of the law in order."""
    return OF_LOOP[-1 - number] if number < 0 else of_law[number - 1]


_CORNER: Final = math.sqrt(2.0)
"""Largest distance of a law's own end as a multiple of the position tolerance: x and y are each
within the tolerance."""

_STAYS_S: Final = 1.0
"""Time for which a robot that a time limit stops must stay within the tolerances at its last speed
[s]. A faster robot passes its goal."""

_ROUNDING_M: Final = 1e-9  # distance below which an error is rounding of numbers of 64 bits [m]

_NEAR: Final = 0.02
"""Largest distance of an end at the goal as a share of the distance from the start, beside the
position tolerance: the band of settling. A wider heading tolerance allows ends away from the
goal."""

_SMALL: Final = 0.01
"""Share of the error below which a part of it, across or along the line to the goal, is left out:
squares add, so it changes the error by less than 0.01 %."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GoalEnd:
    """End of a run at its goal.

    Attributes:
        verdict: `reached`; `missed`; `allowed` if only a wide heading tolerance allows the error;
            or `ended` if the run has no tolerances to judge the error by.
        error_m: Metric `final.position_error` [m].
        allowed_m: Final position error that the tolerances of the law allow [m]; 0 without them.
        left_m: Distance of the end to the left of the line from start to goal [m]; 0 without a
            line, because the run starts within `allowed_m` of its goal.
        short_m: Distance by which the end is short of the goal along this line [m]; negative
            beyond; 0 without a line.
        duration_s: Metric `run.duration` [s].
        turned_rad: Difference from the heading of the goal [rad], if the position is within the
            tolerances but the heading is not; otherwise None.
    """

    verdict: Literal["reached", "missed", "allowed", "ended"]
    error_m: float
    allowed_m: float
    left_m: float
    short_m: float
    duration_s: float
    turned_rad: float | None = None

    @property
    def is_away(self) -> bool:
        """Whether the run ended away from its goal, allowed or not."""
        return self.verdict in {"missed", "allowed"}

    def describe(self) -> str:
        """Return a sentence without a subject: verdict, distance to the goal and duration."""
        verb = "ended " if self.verdict in {"ended", "allowed"} else ""
        return f"{verb}{self.describe_distance()} {self.describe_duration()}"

    def describe_duration(self) -> str:
        """Return the duration as text: `after 12.7 s`."""
        return f"after {self.duration_s:.3g} s"

    def describe_distance(self) -> str:
        """Return verdict and distance to the goal; of a run that only ended, its distance alone."""
        size = format_short(self.error_m, "m")
        if self.verdict == "reached":
            return f"reached the goal within {size}"
        if self.verdict == "ended":
            turned = self.turned_rad
            off = "" if turned is None else f" and {format_short(turned, 'rad')} off its heading"
            where = "at the goal" if self.error_m < _ROUNDING_M else f"{size} from the goal"
            return f"{where}{off}"
        # In the same unit as the error, so that both compare at a glance.
        unit = size.rpartition(" ")[2]
        allowed = f"{self.allowed_m * (1e3 if unit == 'mm' else 1.0):.3g} {unit}"
        if self.verdict == "allowed":
            return f"{size} from the goal (its tolerances allow {allowed})"
        return f"missed the goal by {size} (allowed: {allowed})"

    def describe_place(self) -> str:
        """Return a sentence on the place of the end: across and along the line to the goal.

        It is empty for a run that starts at its goal, because there is no line.
        """
        parts = []
        if abs(self.left_m) > _SMALL * self.error_m:
            side = "left" if self.left_m > 0.0 else "right"
            size = format_short(abs(self.left_m), "m")
            parts.append(f"{size} {side} of the line from start to goal")
        if abs(self.short_m) > _SMALL * self.error_m:
            side = "short of" if self.short_m > 0.0 else "beyond"
            parts.append(f"{format_short(abs(self.short_m), 'm')} {side} the goal")
        return f"The end is {' and '.join(parts)}." if parts else ""


def find_goal_end(run: "Run") -> GoalEnd | None:
    """Return how a run ended at its goal; None without poses or a goal to reach."""
    if run.goal_xy_m is None or not run.declaration.uses_goal or not len(run.poses):
        return None
    error_m, allowed_m, near_m = math.dist(run.goal_xy_m, run.poses.xy_m[-1]), 0.0, 0.0
    heading_rad = run.parameters.get("law.heading_tolerance_rad")
    position_m = run.parameters.get("law.position_tolerance_m")
    if isinstance(heading_rad, float | int) and isinstance(position_m, float | int):
        distance_m = math.dist(run.goal_xy_m, run.poses.xy_m[0])
        allowed_m = allow_position(heading_rad, position_m, distance_m)
        near_m = _CORNER * position_m + _NEAR * distance_m
    # A law that reads late or wrong poses stops where it believes the goal to be.
    is_seen = run.poses.sensed_xy_m is None
    is_own_end = run.stop_reason == WITHIN_TOLERANCE and is_seen and error_m <= _CORNER * allowed_m
    is_within = is_own_end or (error_m <= allowed_m and _stays(run, error_m, allowed_m))
    turned_rad = None if is_own_end or not is_within else _find_turned(run)
    verdict: Literal["reached", "missed", "allowed", "ended"] = "ended"
    if is_within and turned_rad is None:
        verdict = "reached" if error_m <= near_m else "allowed"
    elif error_m > allowed_m and run.stop_reason in MAY_MISS and allowed_m:
        verdict = "missed"
    left_m, short_m = _find_place(run, allowed_m)
    return GoalEnd(
        verdict=verdict,
        error_m=error_m,
        allowed_m=allowed_m,
        left_m=left_m,
        short_m=short_m,
        duration_s=run.duration_s,
        turned_rad=turned_rad,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class GoalLine:
    """The line from start to goal, which defines along-track and cross-track coordinates.

    Attributes:
        start_xy_m: Position of the first pose that was read, or else recorded, world frame [m].
        bearing_rad: Bearing of the goal from the start, counter-clockwise from +x [rad].
        length_m: Distance from the start to the goal [m]; None if unknown.
    """

    start_xy_m: tuple[float, float]
    bearing_rad: float
    length_m: float | None


_LOOP: Final = 0.1
"""Distance of the goal as a share of the robot's farthest way from the start up to which the robot
drives laps, as no line leads to its goal. The direction of the line would be chance."""


def find_goal_line(run: "Run") -> GoalLine | None:
    """Return the line from start to goal of a run, as `Run.goal_line`."""
    samples = run.samples
    is_unknown = not len(samples) and bool(run.declaration.loops)
    if run.goal_xy_m is None:  # an unknown controller may take its bearing from a wrong pose
        is_unknown = not len(samples) or "declaration" in run.absent
    if is_unknown or not len(run.poses):
        return None
    first = run.goal_row if run.is_lawless else 0
    x_m, y_m = map(float, run.poses.xy_m[[*samples.pose_sequence[:1], first][0]])
    length_m = bearing_rad = None
    if run.goal_xy_m is not None:
        line = draw_goal_line((x_m, y_m), run.goal_xy_m)
        length_m, bearing_rad = line.length_m, line.bearing_rad
        if (
            run.is_lawless
            and length_m <= _LOOP * np.hypot(*(run.poses.xy_m[first:] - (x_m, y_m)).T).max()
        ):
            return None
    if (
        len(samples)
        and samples.bearing_rad is not None
        and (samples.sequence[0] != 0 or bearing_rad is None)
    ):
        bearing_rad = float(samples.bearing_rad[0])
    if bearing_rad is None:
        return None
    if length_m is None and samples.error_xy_m is not None:
        length_m = float(np.hypot(*samples.error_xy_m[0]))
    return GoalLine(start_xy_m=(x_m, y_m), bearing_rad=bearing_rad, length_m=length_m)


def draw_goal_line(start_xy_m: tuple[float, float], goal_xy_m: tuple[float, float]) -> GoalLine:
    """Return the line from a start to a goal."""
    ahead_m, left_m = goal_xy_m[0] - start_xy_m[0], goal_xy_m[1] - start_xy_m[1]
    length_m, bearing_rad = float(np.hypot(ahead_m, left_m)), math.atan2(left_m, ahead_m)
    return GoalLine(start_xy_m=start_xy_m, bearing_rad=bearing_rad, length_m=length_m)


def _stays(run: "Run", error_m: float, allowed_m: float) -> bool:
    """Return whether a robot stopped by a time limit would stay within the tolerances."""
    if run.stop_reason in AT_GOAL or len(run.poses) < 2:
        return True
    moved_m = math.dist(*run.poses.xy_m[-2:])
    lasted_s = float(run.poses.time_ns[-1] - run.poses.time_ns[-2]) / 1e9
    return error_m + moved_m / lasted_s * _STAYS_S <= allowed_m if lasted_s > 0.0 else True


def _find_turned(run: "Run") -> float | None:
    """Return the difference from the goal's heading [rad] if it is beyond the law's tolerance."""
    if run.goal_heading_rad is None:
        return None
    turned_rad = abs(wrap_angle(float(run.poses.heading_rad[-1]) - run.goal_heading_rad))
    tolerance_rad = run.parameters.get("law.heading_tolerance_rad")
    is_within = isinstance(tolerance_rad, float | int) and turned_rad <= tolerance_rad
    return None if is_within else turned_rad


def _find_place(run: "Run", allowed_m: float) -> tuple[float, float]:
    """Return how far the end is left of the line from start to goal, and short of the goal [m]."""
    line = run.goal_line
    if line is None or line.length_m is None or line.length_m <= allowed_m:
        return 0.0, 0.0
    (x_m, y_m), (end_x_m, end_y_m) = line.start_xy_m, run.poses.xy_m[-1].tolist()
    cos, sin = math.cos(line.bearing_rad), math.sin(line.bearing_rad)
    gone_x_m, gone_y_m = end_x_m - x_m, end_y_m - y_m
    along_m = cos * gone_x_m + sin * gone_y_m
    return cos * gone_y_m - sin * gone_x_m, line.length_m - along_m


def allow_position(heading_rad: float, position_m: float, distance_m: float) -> float:
    """Return the final position error that tolerances allow at a distance from the goal [m]."""
    return heading_rad * distance_m + position_m


def describe_wall(run: "Run") -> str:
    """Return a sentence on the first time that the robot hit a wall of its world; empty without."""
    hits = [event for event in run.events if event.kind == "wall_hit"]
    if not hits:
        return ""
    at_s = (hits[0].time_ns - run.start_ns) / 1e9
    more = f", the first of {len(hits)} contacts" if len(hits) > 1 else ""
    return f"{hits[0].text.removesuffix('.')}, at {at_s:.1f} s{more}: the wall held it back."
