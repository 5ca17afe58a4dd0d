"""A scenario with an identified robot, and the source of each of its numbers."""

import math
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from turtlelog.display import describe_count, join_words
from turtlelog.errors import IdentifyError, ScenarioError
from turtlelog.escapes import escape_controls
from turtlelog.identify.axis_model import AxisModel
from turtlelog.identify.axis_motion import NAMES, OTHER, UNITS, Axis, get_commands
from turtlelog.identify.robot_model import RobotModel
from turtlelog.identify.robot_noise import WRITTEN_DIGITS, list_noise, round_written
from turtlelog.run import Run
from turtlelog.run.loops import LIMIT_KEYS, PLANT_KEYS
from turtlelog.scenario import Scenario, format_scenario, get_preset, override_scenario

_REGULAR: Final = 0.2
"""Largest relative difference of a timer's intervals from their median. A busy computer shifts a
message at 10 Hz by some milliseconds; manual input shifts messages by tenths of a second."""

_MOSTLY: Final = 0.8
"""Share of the intervals that must be regular; the others are lost messages and pauses."""

_FEWEST: Final = 10  # smallest number of intervals from which a period is computed

_DOUBT: Final = "Doubt: "
_NOTE: Final = "Note: "
"""Prefix of sentences that later answers repeat: the notes of the identification."""

_WHOLE: Final = 0.05
"""Largest relative difference of the timer's period from a multiple of the poses' period, for which
the multiple is used. Two clocks of one robot agree to less than a tenth of it; a scheduler shifts a
period by some percent."""

_FEWEST_ARRIVALS: Final = 3
"""Number of commands at exactly the largest value from which this value is a limit: two commands
may be two steps of one drive."""

_EXACT: Final = 1e-6  # relative difference of equal commands: single precision, or sums of steps

_RAMP_KEYS: Final[Mapping[Axis, tuple[str, str]]] = {
    "speed": ("limits.acceleration_m_s2", "limits.jerk_m_s3"),
    "turn_rate": ("limits.turn_acceleration_rad_s2", "limits.turn_jerk_rad_s3"),
}
"""Keys of the limits before the time constant."""

_DRIFT_KEYS: Final[Mapping[Axis, str]] = {
    "speed": "disturbance.speed_m_s",
    "turn_rate": "disturbance.turn_rate_rad_s",
}

_LONGEST_PERIOD_S: Final = 1.0
_SHORTEST_PERIOD_S: Final = 0.001  # shortest period of a scenario [s]


Part = tuple[dict[str, Any], list[str]]
"""Keys of the scenario, and sentences on them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotScenario:
    """A robot as a scenario.

    Attributes:
        scenario: Scenario with the plant `lagged`.
        notes: Sources of the scenario's numbers, and unknown values, in sentences.
    """

    scenario: Scenario
    notes: tuple[str, ...]

    @property
    def text(self) -> str:
        """The scenario as a file, with the notes as comments."""
        heads = (f"The robot of {self.scenario.name}, as identified from its log.", *self.notes)
        lines = [line for note in heads for line in _wrap(escape_controls(note))]
        return "".join(f"# {line}\n" for line in lines) + "\n" + format_scenario(self.scenario)


def read_robot_notes(text: str) -> list[str]:
    """Return the doubts and notes of the identification from comments of a scenario file."""
    found: list[str] = []
    is_told = False
    for line in text.splitlines():
        if not line.startswith("#"):
            break
        said = line.removeprefix("# ")
        begins = said.startswith((_DOUBT, _NOTE))
        is_told = begins or (is_told and said.startswith("  "))
        if begins:
            found.append(said)
        elif is_told:
            found[-1] += f" {said.strip()}"
    return found


def _wrap(note: str) -> list[str]:
    """Return the lines of a note with a mark, so that the end of the note can be found again."""
    indent = "  " if note.startswith((_DOUBT, _NOTE)) else ""
    return textwrap.wrap(note, 97, subsequent_indent=indent)


def build_robot_scenario(model: RobotModel, runs: Run | Sequence[Run]) -> RobotScenario:
    """Return a scenario whose plant follows commands like the robot.

    An axis that is never commanded is assumed to follow at once, with a note.

    Args:
        model: Model of the robot.
        runs: Runs from which the robot was identified; start and goal come from the first run.

    Raises:
        IdentifyError: If a commanded axis is unknown, no axis is known, or the robot is turtlesim.
    """
    runs = [runs] if isinstance(runs, Run) else [*runs]
    if not runs:
        raise IdentifyError("runs: must not be empty")
    _require_robot(model)
    parts = (
        _list_plant(model),
        _list_periods(runs),
        _list_limits(model, runs),
        list_noise(model, runs),
        _find_start_and_goal(runs[0]),
    )
    # Without changed keys in the name: this scenario has other values, and another law.
    name = " ".join(word for word in model.files[0].split() if "=" not in word)
    values: dict[str, Any] = {"name": name or "robot", "loop.pose_precision": "float64"}
    doubts = [doubt for axis in model.axes for doubt in axis.doubts]
    notes = [_DOUBT + doubt for doubt in doubts]
    notes += [_NOTE + note for note in model.notes if note not in doubts]
    for keys, sentences in parts:
        values |= keys
        notes += sentences
    for keys, sentences in (_delay_jerk(values), _choose_tolerances(values)):
        values |= keys
        notes += sentences
    notes.append(
        "The law and its gains are not those of the log: they are sequential-p and 1."
        " `turtlelog theory` recommends gains for this file."
    )
    # The plant first, because its world has no walls.
    base = replace(get_preset("lagged"), name="lagged")
    try:
        scenario = override_scenario(base, values, source="identified robot")
    except ScenarioError as err:
        raise IdentifyError(str(err)) from err
    return RobotScenario(scenario=scenario, notes=tuple(notes))


def _require_robot(model: RobotModel) -> None:
    if model.tick_delays is not None:
        raise IdentifyError(
            f"{model.files[0]}: expected a robot, found turtlesim, whose plant is that of the"
            " preset textbook; `turtlelog explain FILE --scenario X.toml` writes the scenario of a"
            " log with samples of a controller"
        )
    unknown = [axis for axis in model.axes if not axis.is_known]
    commanded = [axis for axis in unknown if not axis.is_idle]
    for axis in commanded or unknown:
        if commanded or len(unknown) == len(model.axes):
            advice = f"; to know it, {axis.advice}" if axis.advice else ""
            where = f"{model.files[0]}: {NAMES[axis.axis]}"
            raise IdentifyError(f"{where}: not identifiable: {axis.reason}{advice}")


def _list_plant(model: RobotModel) -> Part:
    values: dict[str, Any] = {}
    notes = [
        "Gains, dead times and time constants are those that `turtlelog identify` finds. The"
        " transport delay is 0, because the dead times already include it."
    ]
    for axis in model.axes:
        key, name = PLANT_KEYS[axis.axis], NAMES[axis.axis]
        total, lag = axis.total_delay_s, axis.lag_s
        gain, delay_s = axis.advised_gain, axis.advised_delay_s
        if gain is None or delay_s is None or total is None or lag is None:
            values |= {f"{key}gain": 1.0, f"{key}dead_time_s": 0.0, f"{key}lag_s": 0.0}
            values[f"{key}assumed"] = True
            notes.append(
                f"{_NOTE}The {name} is never commanded, and so its dynamics are unknown. The"
                " scenario lets it follow at once with a gain of 1, and theory recommends no"
                " gains for its loop until it is driven."
            )
            continue
        values |= {
            f"{key}gain": round_written(gain),
            f"{key}dead_time_s": round_written(
                max(delay_s - lag.value, 0.0) + axis.oscillation_delay_s
            ),
            f"{key}lag_s": round_written(max(lag.value, 0.0)),
        }
        values |= {f"{key}{name}": round_written(value) for name, value in _list_own_limits(axis)}
        if axis.drift is not None:
            values[_DRIFT_KEYS[axis.axis]] = round_written(axis.drift.value)
        if axis.model == "second_order":
            longer_s = axis.oscillation_delay_s
            longer = f" Its dead time is {1e3 * longer_s:.3g} ms longer, because it oscillates."
            notes.append(
                f"{_NOTE if longer_s else ''}The {name} is of second order, the plant of first: its"
                f" time constant is the sum of both.{longer if longer_s else ''}"
            )
            values |= {f"{key}oscillates": True} if longer_s else {}
        notes += [*_tell_plant(axis), *_tell_drift(axis)]
    return values, notes


def _list_own_limits(axis: AxisModel) -> Iterator[tuple[str, float]]:
    """Yield the limits of an axis that the plant supports, by the end of their keys."""
    if axis.bound is not None:
        yield "bound", axis.bound.value
    if axis.rate_limit is not None and axis.limit_acts != "before_lag":
        yield "acceleration", axis.rate_limit.value
    if axis.deadband is not None:
        yield "deadband", axis.deadband.value
    if axis.friction is not None:
        yield "friction", axis.friction.value
    if axis.advised_reverse_gain is not None:
        yield "reverse_gain", axis.advised_reverse_gain


def _tell_plant(axis: AxisModel) -> Iterator[str]:
    name = NAMES[axis.axis]
    if axis.doubts:
        yield f"In doubt, the {name} has the longest delay and the largest gain of its intervals."
    other = OTHER[axis.axis]
    if axis.rate_limit_beside is not None:
        yield (
            f"{_NOTE}The wheels limit the acceleration of both axes together. A {NAMES[other]} that"
            f" changes by {axis.rate_limit_beside.value:.3g} {axis.rate_limit_beside.unit} reaches"
            f" their limit alone, so the {name} beside it changes more slowly. The plant has no"
            " such limit."
        )
    if axis.bound_beside is not None:
        yield (
            f"{_NOTE}The wheels limit both axes together. A {NAMES[other]} of"
            f" {axis.bound_beside.value:.3g} {axis.bound_beside.unit} reaches their limit alone, so"
            f" the {name} beside it is smaller. The plant has no such limit."
        )
    limits = [key.replace("_", " ") for key, _ in _list_own_limits(axis)]
    if limits:
        yield (
            f"The {name} has limits of its own in the plant, as identified: {join_words(limits)}."
            " Gain, dead time and time constant are those without them."
        )
    if axis.bound_acts == "rate":
        yield (
            f"The {name} ends at its bound as it is reached; the plant approaches the bound with"
            " its time constant."
        )
    if axis.deadband is not None:
        low, high, unit = axis.deadband.low, axis.deadband.high, axis.deadband.unit
        yield (
            f"The deadband of the {name} is the middle between {low:.3g} {unit}, which moves"
            f" nothing, and {high:.3g} {unit}, which does."
        )


def _tell_drift(axis: AxisModel) -> Iterator[str]:
    if axis.drift is None or axis.gain is None:
        return
    unit, off = axis.drift.unit, abs(axis.drift.value / axis.gain.value)
    yield (
        f"{_NOTE}The {NAMES[axis.axis]} drifts by {axis.drift.value:.3g} {unit} at zero command, as"
        f" the scenario's disturbance. P control holds a goal only to {off:.3g} {unit} divided by"
        " Kp."
    )


def _list_periods(runs: Sequence[Run]) -> Part:
    pose_s = _find_period([run.poses.time_ns for run in runs])
    if pose_s is None or not _SHORTEST_PERIOD_S <= pose_s <= _LONGEST_PERIOD_S:
        found = "none" if pose_s is None else f"{pose_s:.3g} s"
        raise IdentifyError(
            f"{runs[0].name}: poses: expected a period from {_SHORTEST_PERIOD_S:g} to"
            f" {_LONGEST_PERIOD_S:g} s, found {found}"
        )
    timer_s = _find_period([run.commands.time_ns for run in runs], regular=True)
    told = f"Poses come every {1e3 * pose_s:.4g} ms"
    if timer_s is None or not _SHORTEST_PERIOD_S <= timer_s <= _LONGEST_PERIOD_S:
        note = f"{told}. Commands keep no period, so the controller answers each pose."
        return {"plant.period_s": round_written(pose_s)}, [note]
    timer_s, note = round_written(timer_s), f"{told}, commands every {1e3 * timer_s:.4g} ms"
    times = round(timer_s / pose_s)
    period_s = round_written(pose_s)
    if times and abs(timer_s / pose_s - times) <= _WHOLE * times:
        # Rounded down to whole nanoseconds, so that a pose comes before the timer that reads it.
        period_s = round(timer_s * 1e9) // times / 1e9
        if abs(period_s - pose_s) > 1e-4 * pose_s:
            part = "that period" if times == 1 else f"1/{times} of that"
            note += f"; the plant has {part}, so that each pose that is read is fresh"
    keys = {"plant.period_s": period_s, "loop.trigger": "timer", "loop.period_s": timer_s}
    return keys, [f"{note}."]


def _find_period(times_ns: Sequence[Any], *, regular: bool = False) -> float | None:
    """Return the period of messages [s]; None if messages are not periodic."""
    apart_s = np.concatenate([np.diff(time_ns) / 1e9 for time_ns in times_ns])
    if len(apart_s) < (_FEWEST if regular else 1):
        return None
    median_s = float(np.median(apart_s))
    if median_s <= 0.0:
        return None
    near = np.abs(apart_s - median_s) <= _REGULAR * median_s
    if regular and np.mean(near) < _MOSTLY:
        return None
    # As many are early as late; the others are gaps, or two messages at once.
    return float(apart_s[near].mean())


def _list_limits(model: RobotModel, runs: Sequence[Run]) -> Part:
    values: dict[str, Any] = {}
    notes = []
    for axis in model.axes:
        name, unit = NAMES[axis.axis], UNITS[axis.axis]
        largest, arrivals = _find_largest(runs, axis.axis)
        key, friction = LIMIT_KEYS[axis.axis], axis.friction.value if axis.friction else 0.0
        bound = math.inf  # the command from which the rate no longer increases
        bound = axis.bound.value / axis.gain.value + friction if axis.bound and axis.gain else bound
        is_limit = arrivals >= _FEWEST_ARRIVALS
        values[key] = largest if is_limit or axis.rate_limit else math.inf
        if axis.bound is not None and bound <= largest:
            values[key] = round_written(bound)
            notes.append(
                f"Commands of the {name} above {bound:.3g} {unit} do no more: the rate ends at"
                f" {axis.bound.value:.3g} {unit}. That is the limit."
            )
        elif is_limit:
            notes.append(
                f"Commands of the {name} arrive {describe_count(arrivals, 'time')} at exactly"
                f" {largest:.6g} {unit}, the largest: that is taken as the limit. Where the robot"
                f" can do more, set {key}."
            )
        elif axis.rate_limit:
            notes.append(
                f"The limit of the {name} is the largest command, {largest:.6g} {unit}: with its"
                " acceleration, gains that suit it may not suit larger ones."
            )
        elif largest:
            notes.append(
                f"No limit of the {name} shows: the largest command is {largest:.6g} {unit}."
                f" Where the robot has one, set {key}."
            )
        if axis.rate_limit is not None and axis.gain and axis.limit_acts == "before_lag":
            keys = _RAMP_KEYS[axis.axis]
            acceleration = axis.rate_limit.value / abs(axis.gain.value)
            values[keys[0]] = round_written(acceleration)
            jerk = ""
            if axis.jerk_time_s is not None and axis.jerk_time_s.value > 0.0:
                values[keys[1]] = round_written(acceleration / axis.jerk_time_s.value)
                jerk = " So does the limit of the jerk."
            notes.append(
                f"The limit of how fast the {name} changes acts before its time constant. It clips"
                f" commands, so it is that of the motion by the gain.{jerk}"
            )
    return values, notes


def _delay_jerk(values: Mapping[str, Any]) -> Part:
    """Return longer dead times of axes with a limit of the jerk, which the scenario has in its law.

    There a command has at once what the robot reaches at the end of a period: on average half a
    period early.
    """
    delays: dict[str, Any] = {}
    early_s = 0.5 * values.get("loop.period_s", values["plant.period_s"])
    axes = [axis for axis, (_, jerk) in _RAMP_KEYS.items() if jerk in values]
    for axis in axes:
        key = f"{PLANT_KEYS[axis]}dead_time_s"
        delays[key] = round_written(values[key] + early_s)
    names = join_words([NAMES[axis] for axis in axes])
    told = (
        "The robot limits the jerk all the time, the scenario once per period, which is half a"
        f" period earlier: the dead time of the {names} is {1e3 * early_s:.3g} ms longer for it."
    )
    return delays, [told] if axes else []


def _find_largest(runs: Sequence[Run], axis: Axis) -> tuple[float, int]:
    commands = [get_commands(run, axis) for run in runs]
    largest = max((float(np.abs(value).max()) for value in commands if len(value)), default=0.0)
    if not largest:
        return 0.0, 0
    near = _EXACT * largest
    arrivals = sum(
        int(np.count_nonzero((np.abs(value) >= largest - near) & (np.abs(change) > near)))
        for value, change in ((value, np.diff(value, prepend=0.0)) for value in commands)
    )
    return round_written(largest), arrivals


_TOLERANCE: Final = 0.01  # tolerance of the goal [m] and [rad], usual for wheeled robots

_ABOVE_NOISE: Final = 5.0
"""Smallest tolerance in standard deviations of the poses' noise: a smaller one is never met."""

_DRIVE_S: Final = 5.0  # duration of a drive towards the goal, in which the heading drifts [s]

_ABOVE_DRIFT: Final = 2.0
"""Standard deviations of that drift within the tolerance: 1 drive of 20 drifts further."""

_AHEAD_M: Final = 1.0  # distance of the goal ahead and to the left, if the bag has none [m]


def _find_start_and_goal(run: Run) -> Part:
    (x_m, y_m), heading_rad = run.poses.xy_m[0].tolist(), float(run.poses.heading_rad[0])
    goal_m = run.goal_xy_m
    note = "It starts at the first pose of the log, and has the log's goal."
    if goal_m is None:
        ahead, left = _AHEAD_M * math.cos(heading_rad), _AHEAD_M * math.sin(heading_rad)
        goal_m = x_m + ahead - left, y_m + left + ahead
        note = (
            "It starts at the first pose of the log. The log has no goal: one is set"
            f" {_AHEAD_M:g} m ahead and {_AHEAD_M:g} m to the left."
        )
    values = {"start.x_m": x_m, "start.y_m": y_m, "start.heading_rad": heading_rad}
    values |= {"goal.x_m": goal_m[0], "goal.y_m": goal_m[1]}
    return {key: round(value, WRITTEN_DIGITS) for key, value in values.items()}, [note]


def _choose_tolerances(values: dict[str, Any]) -> Part:
    """Return tolerances of the goal that a robot with this noise can meet."""
    noise_m = values.get("sensing.noise_position_m", 0.0)
    noise_rad = values.get("sensing.noise_heading_rad", 0.0)
    heading_rad = max(_TOLERANCE, _ABOVE_NOISE * noise_rad)
    way_m = math.hypot(
        *(values[f"goal.{axis}"] - values[f"start.{axis}"] for axis in ("x_m", "y_m"))
    )
    drift_rad = _ABOVE_DRIFT * math.sqrt(_DRIVE_S) * values["disturbance.noise_turn_rate"]
    position_m = max(_TOLERANCE, _ABOVE_NOISE * noise_m, way_m * (heading_rad + drift_rad))
    keys = {
        "law.heading_tolerance_rad": float(f"{heading_rad:.2g}"),
        "law.position_tolerance_m": float(f"{position_m:.2g}"),
    }
    told = f"{1e3 * position_m:.2g} mm and {1e3 * heading_rad:.2g} mrad"
    return keys, [
        f"The tolerance of the goal is {told}: what a robot with such noise keeps that turns first"
        " and then drives."
    ]
