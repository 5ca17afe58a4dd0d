"""Which key of a scenario becomes which number of the compiled loop; tested to be whole."""

import math
from collections.abc import Mapping
from operator import attrgetter
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from turtlelog.angles import wrap_angle
from turtlelog.laws import SequentialP, SequentialPID, SequentialPIDParameters, find_law
from turtlelog.plants import LAGGED, Plant
from turtlelog.scenario import Scenario
from turtlelog.simulate.compiled.law_fields import (
    LAW_REAL,
    LAW_WHOLE,
    SCHEDULED,
    derive_law,
    fill_schedule,
    is_covered,
)
from turtlelog.simulate.transport import find_causal_ns, needs_time

CHOICES: Final[Mapping[str, tuple[Any, ...]]] = MappingProxyType(
    {
        "law.projection": ("bearing", "heading"),
        "law.wrap_error": (False, True),
        "law.reorient": (False, True),
        "law.anti_windup": ("none", "clamping", "back-calculation"),
    }
)
"""Keys of words and truths, of which the loop takes the number of the value in this order."""

WHOLE: Final = (
    "law.pause_ticks",
    "law.standstill_samples",
    "loop.period_ticks",
    "loop.pose_queue",
    "loop.command_queue",
    "loop.transport_delay_ticks",
)
"""Whole numbers that the loop takes as they are: `loop.pose_queue` as `loop_pose_queue`."""

REAL: Final = (
    "goal.x_m",
    "goal.y_m",
    "law.heading_tolerance_rad",
    "law.position_tolerance_m",
    "law.timeout_s",
    "law.settled_within_m",
    "law.settled_for_s",
    "law.standstill_below",
    "law.derivative_filter_s",
    "law.tracking_time_s",
    "loop.loss_probability",
    "loop.repeat_probability",
    "loop.late_probability",
    "sensing.noise_position_m",
    "sensing.noise_heading_rad",
    "sensing.bias_position_m",
    "sensing.bias_heading_rad",
    "sensing.quantum_position_m",
    "sensing.quantum_heading_rad",
    "sensing.dropout_probability",
    "sensing.outlier_probability",
    "sensing.outlier_m",
    "sensing.outlier_rad",
    "disturbance.speed_m_s",
    "disturbance.turn_rate_rad_s",
)
"""Numbers that it takes as they are."""

AXIS_KEYS: Final[Mapping[str, tuple[str, str]]] = MappingProxyType(
    {
        "limit": ("limits.speed_m_s", "limits.turn_rate_rad_s"),
        "acceleration": ("limits.acceleration_m_s2", "limits.turn_acceleration_rad_s2"),
        "jerk": ("limits.jerk_m_s3", "limits.turn_jerk_rad_s3"),
        "dead_zone": ("shaping.dead_zone_speed_m_s", "shaping.dead_zone_turn_rate_rad_s"),
        "quantum": ("shaping.quantum_speed_m_s", "shaping.quantum_turn_rate_rad_s"),
        "kp": ("law.kp_linear", "law.kp_angular"),
        "ki": ("law.ki_linear", "law.ki_angular"),
        "kd": ("law.kd_linear", "law.kd_angular"),
    }
)
"""Numbers of the two axes, speed and turn rate."""

ROBOT_KEYS: Final = (
    *("plant.speed_gain", "plant.turn_gain", "plant.speed_lag_s", "plant.turn_lag_s"),
    *("plant.speed_dead_time_s", "plant.turn_dead_time_s"),
)
"""Keys of the two rates of a lagged robot, which `fill_axes` makes numbers of the axes."""

DERIVED: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {
        "last_tick": ("max_duration_s",),
        "end_ns": ("max_duration_s",),
        "period_ns": ("plant.kind", "plant.period_s"),
        "is_lagged": ("plant.kind",),
        "tick_ns": ("plant.kind",),
        "block": ("plant.kind",),
        "is_exact": ("loop.pose_precision",),
        "newest_only": ("loop.queue_policy",),
        "timer_ns": ("loop.trigger", "loop.period_s"),
        "is_timed": (),
        "causal_ns": ("plant.kind",),
        "delays_poses": (),
        "has_sensor": (),
        "is_pushed": (),
        "finds_distance": (),
        "transport_ns": ("loop.transport_delay_s",),
        "late_ns": ("loop.late_s",),
        "sensing_delay_ns": ("sensing.delay_s",),
    }
)
"""Whole numbers that `_derive_whole` computes; with each the keys that no other field takes."""

DERIVED_REAL: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {
        "goal_heading_rad": ("goal.heading_rad",),
        "period_s": (),
        "watchdog_ns": (),
        "first_s": (),
        "transport_jitter_ns": ("loop.jitter_s",),
        "sensing_jitter_ns": ("sensing.jitter_s",),
        "low_pass_s": ("shaping.low_pass_s",),
        "push_from_ns": ("disturbance.from_s",),
        "push_to_ns": ("disturbance.to_s",),
        "push_scale": ("disturbance.noise_speed",),
        "turn_push_scale": ("disturbance.noise_turn_rate",),
    }
)
"""Other numbers, which `_derive_real` computes, likewise."""

WITHOUT_EFFECT: Final = frozenset({"name", "path", "law.kind"})
"""Keys that change nothing of how these laws run."""

READ_ELSEWHERE: Final = frozenset(
    {
        *("start.x_m", "start.y_m", "start.heading_rad", "start.precision"),
        *("seed", "loop.start_backlog"),
    }
)
"""Keys of which `memory` makes the first state and the random numbers."""

NEVER_NS: Final = 2**63 - 1
"""Later than any time of a run."""

MOST_TICKS: Final = 1_000_000
"""Longer scenarios are interpreted: their arrays are made for all ticks at once, 400 bytes each."""


def _name(key: str) -> str:
    return key.replace(".", "_")


SETTINGS: Final = np.dtype(
    [(_name(key), np.int64) for key in (*CHOICES, *WHOLE, *DERIVED, *LAW_WHOLE)]
    + [(_name(key), np.float64) for key in (*REAL, *DERIVED_REAL, *LAW_REAL)]
)
"""A scenario as the compiled loop takes it."""

AXIS: Final = np.dtype(
    [(name, np.float64) for name in (*AXIS_KEYS, "robot_gain", "robot_lag_s")]
    + [(name, np.float64) for name in ("target", "transient", "push")]
    + [(name, np.int64) for name in ("dead_time_ns", "next_ns", "waiting_first")]
    + [(name, np.float64) for name in ("value", "rate", "low_pass")]
    + [(name, np.float64) for name in ("integral", "derivative", "error_rate", "excess")]
    + [("has_terms", np.int64), ("has_integral", np.int64), ("last_ns", np.int64)]
)
"""Speed or turn rate: its numbers, and its state, from the limits to the robot."""

_READ: Final = {
    key: attrgetter(key.replace("law.", "law.parameters."))
    for key in (*CHOICES, *WHOLE, *REAL, *(key for pair in AXIS_KEYS.values() for key in pair))
}
_OF_PID: Final = SequentialPIDParameters()


def is_compiled(scenario: Scenario, plant: Plant) -> bool:
    """Whether the compiled loop covers a scenario, whose law is resolved."""
    return (
        is_covered(scenario)
        and round(scenario.max_duration_s * 1e9) // plant.period_ns < MOST_TICKS
        and (scenario.loop.period_s or 1.0) * MOST_TICKS > scenario.max_duration_s
    )


def is_common(scenario: Scenario) -> bool:
    """Whether `sequential_loop` covers a scenario that is compiled; otherwise `any_loop` does."""
    return scenario.plant.kind == "turtlesim" and is_sequential(scenario)


def is_sequential(scenario: Scenario) -> bool:
    """Whether the law, which is a compiled one, is of the sequential kind."""
    return find_law(scenario.law.kind) in {SequentialP, SequentialPID}


def read_key(scenario: Scenario, key: str) -> Any:
    """Return the value of a key; those that a law lacks are those of `sequential-pid` as usual."""
    try:
        return _READ[key](scenario)
    except AttributeError:
        return getattr(_OF_PID, key.removeprefix("law."))


def fill_settings(scenario: Scenario, plant: Plant) -> np.ndarray[Any, Any]:
    """Return the settings of a scenario that the compiled loop covers, shape (1,)."""
    values: dict[str, float] = {
        _name(key): CHOICES[key].index(read_key(scenario, key)) for key in CHOICES
    }
    values |= {_name(key): read_key(scenario, key) for key in (*WHOLE, *REAL)}
    values |= _derive_whole(scenario, plant) | _derive_real(scenario, plant) | derive_law(scenario)
    return np.array([tuple(values[name] for name in SETTINGS.names or ())], dtype=SETTINGS)


def fill_axes(scenario: Scenario) -> np.ndarray[Any, Any]:
    """Return the numbers of speed and turn rate, from rest, shape (2,)."""
    axes = np.zeros(2, dtype=AXIS)
    for name, keys in AXIS_KEYS.items():
        axes[name] = [read_key(scenario, key) for key in keys]
    robot = scenario.plant
    axes["robot_gain"] = [1.0 if k is None else k for k in (robot.speed_gain, robot.turn_gain)]
    axes["robot_lag_s"] = robot.speed_lag_s or 0.0, robot.turn_lag_s or 0.0
    dead_times_s = robot.speed_dead_time_s or 0.0, robot.turn_dead_time_s or 0.0
    axes["dead_time_ns"] = [round(time_s * 1e9) for time_s in dead_times_s]
    axes["next_ns"] = NEVER_NS
    mark_terms(axes, fill_schedule(scenario))
    return axes


def mark_terms(axes: np.ndarray[Any, Any], schedule: np.ndarray[Any, Any]) -> None:
    """Enter which loops have integral and derivative: by a gain, or by a schedule of one.

    Args:
        axes: Shape (..., 2).
        schedule: As `fill_schedule` returns it.
    """
    varies = ~np.isnan(schedule[0, 1:]) if len(schedule) else np.zeros(len(SCHEDULED), bool)
    of_speed_and_turn = dict(zip(("kp", "ki", "kd"), varies.reshape(-1, 2), strict=True))
    axes["has_integral"] = (axes["ki"] != 0.0) | of_speed_and_turn["ki"]
    derives = (axes["kd"] != 0.0) | of_speed_and_turn["kd"]
    axes["has_terms"] = (axes["has_integral"] != 0) | derives


def _derive_whole(scenario: Scenario, plant: Plant) -> dict[str, int]:
    """Return the values of `DERIVED`."""
    loop, sensing = scenario.loop, scenario.sensing
    duration_ns, tick_ns = round(scenario.max_duration_s * 1e9), scenario.plant.facts.period_ns
    delays_poses = loop.period_s is not None or sensing.delays_poses
    delay_ns = loop.transport_delay_ticks * plant.period_ns + round(loop.transport_delay_s * 1e9)
    return {
        "last_tick": duration_ns // plant.period_ns,
        "end_ns": duration_ns + 1,
        "period_ns": plant.period_ns,
        "is_lagged": scenario.plant.kind == LAGGED,
        "tick_ns": tick_ns,
        "block": tick_ns if delays_poses else plant.steps_per_tick,
        "is_exact": loop.pose_precision == "float64",
        "newest_only": loop.queue_policy == "newest",
        "timer_ns": round((loop.period_s or 0.0) * 1e9),
        "is_timed": needs_time(scenario),
        "causal_ns": find_causal_ns(scenario, plant),
        "delays_poses": delays_poses,
        "has_sensor": sensing.changes_poses,
        "is_pushed": scenario.disturbance.acts,
        "finds_distance": True,
        "transport_ns": delay_ns,
        "late_ns": round(loop.late_s * 1e9),
        "sensing_delay_ns": round(sensing.delay_s * 1e9),
    }


def _derive_real(scenario: Scenario, plant: Plant) -> dict[str, float]:
    """Return the values of `DERIVED_REAL`."""
    loop, disturbance, to_s = scenario.loop, scenario.disturbance, scenario.disturbance.to_s
    root = math.sqrt(plant.period_ns / 1e9)
    return {
        "goal_heading_rad": wrap_angle(scenario.goal.heading_rad or 0.0),
        "period_s": plant.period_s,
        "watchdog_ns": plant.watchdog_ns,
        "first_s": loop.period_s or loop.period_ticks * plant.period_ns / 1e9,
        "transport_jitter_ns": loop.jitter_s * 1e9,
        "sensing_jitter_ns": scenario.sensing.jitter_s * 1e9,
        "low_pass_s": scenario.shaping.low_pass_s,
        "push_from_ns": round(disturbance.from_s * 1e9),
        "push_to_ns": to_s if math.isinf(to_s) else round(to_s * 1e9),
        "push_scale": disturbance.noise_speed / root,
        "turn_push_scale": disturbance.noise_turn_rate / root,
    }
