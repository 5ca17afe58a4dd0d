"""Scenarios of all laws, plants and effects, each drawn by a number that never gives another."""

import math
import random
from collections.abc import Mapping
from typing import Any, Final

from tests.effects_cases import EFFECTS
from turtlelog.scenario import Scenario, get_preset, override_scenario

DRAWN_EFFECTS: Final = (
    *("acceleration", "bias", "command_quantum", "dead_zone", "disturbance", "disturbance_noise"),
    *("dropout", "jerk", "lagged", "late", "loss", "low_pass", "noise", "outlier", "quantum"),
    *("repeat", "sensing_delay", "sensing_jitter", "timer", "transport_delay"),
    "transport_jitter",
)
"""In this order for good: another one, or one more, would draw other scenarios."""

PRESETS: Final = ("paper", "textbook")

OTHER_LAWS: Final = ("posture", "kanayama", "pure-pursuit", "open-loop")


def build_random(seed: int) -> Scenario:
    """Return a scenario of a sequential law with some effects, drawn by a seed."""
    draw = random.Random(seed)
    changes: dict[str, Any] = {
        "max_duration_s": draw.choice([1.2, 6.0, 25.0]),
        "seed": draw.randrange(2**40),
        "start.x_m": draw.uniform(0.0, 11.0),
        "start.y_m": draw.uniform(0.0, 11.0),
        "start.heading_rad": draw.uniform(-3.2, 3.2),
        "goal.x_m": draw.uniform(0.0, 11.0),
        "goal.y_m": draw.uniform(0.0, 11.0),
        "goal.heading_rad": draw.uniform(-3.2, 3.2),
        "law.kp_angular": draw.choice([0.8, 4.0, 20.0]),
        "law.kp_linear": draw.choice([0.8, 4.0, 20.0]),
        "law.pause_ticks": draw.choice([0, 7, 34]),
        "law.projection": draw.choice(["bearing", "heading"]),
        "law.wrap_error": draw.random() < 0.5,
        "law.reorient": draw.random() < 0.4,
        "law.timeout_s": draw.choice([3.0, 30.0, math.inf]),
        "law.settled_for_s": draw.choice([0.1, 5.0]),
        "law.standstill_samples": draw.choice([3, 100]),
        "law.heading_tolerance_rad": draw.choice([0.001, 0.05]),
        "law.position_tolerance_m": draw.choice([0.001, 0.05]),
        "limits.speed_m_s": draw.choice([0.5, 1.0, math.inf]),
        "limits.turn_rate_rad_s": draw.choice([0.5, 1.0, math.inf]),
        "loop.period_ticks": draw.choice([1, 1, 3]),
        "loop.start_backlog": draw.choice([1, 5]),
        "loop.pose_queue": draw.choice([1, 5, 10]),
        "loop.command_queue": draw.choice([1, 3, 7]),
        "loop.queue_policy": draw.choice(["one-per-tick", "newest"]),
        "loop.transport_delay_ticks": draw.choice([0, 0, 4]),
        "loop.pose_precision": draw.choice(["float32", "float64"]),
        "start.precision": draw.choice(["float32", "float64"]),
    }
    if has_pid := draw.random() < 0.6:
        changes |= build_pid(draw)
    if draw.random() < 0.3:
        changes["law.schedule"] = build_schedule(draw, has_pid=has_pid)
    for effect in draw.sample(DRAWN_EFFECTS, draw.choice([0, 1, 2, 5])):
        changes |= EFFECTS[effect]
    if "plant.kind" in changes:
        changes |= build_robot(draw)
    if "loop.period_s" in changes:
        changes["loop.period_ticks"] = 1
    return override_scenario(get_preset(draw.choice(PRESETS)), changes)


def build_pid(draw: random.Random) -> Mapping[str, Any]:
    return {
        "law.kind": "sequential-pid",
        "law.ki_angular": draw.choice([0.0, 0.3]),
        "law.kd_angular": draw.choice([0.0, 0.1]),
        "law.ki_linear": draw.choice([0.0, 0.3]),
        "law.kd_linear": draw.choice([0.0, 0.1]),
        "law.derivative_filter_s": draw.choice([0.0, 0.05]),
        "law.anti_windup": draw.choice(["none", "clamping", "back-calculation"]),
        "law.tracking_time_s": draw.choice([0.001, 1.0]),
    }


def build_schedule(draw: random.Random, *, has_pid: bool) -> Mapping[str, Any]:
    """Return a table of one gain or more."""
    at = sorted({draw.choice([0.0, draw.uniform(0.0, 9.0)]) for _ in range(6)} | {1.0, 0.5})
    gains = ["kp_angular", "kp_linear"]
    if has_pid:
        gains += ["ki_angular", "kd_angular", "ki_linear", "kd_linear"]
    chosen = draw.sample(gains, draw.randint(1, len(gains)))
    table = {gain: [draw.uniform(0.01, 3.0) for _ in at] for gain in chosen}
    return {"over": draw.choice(["distance", "heading_error"]), "at": at, **table}


def build_robot(draw: random.Random) -> Mapping[str, Any]:
    return {
        "plant.period_s": draw.choice([0.016, 0.05, 0.21]),
        "plant.speed_gain": draw.choice([0.9, 1.0]),
        "plant.speed_dead_time_s": draw.choice([0.0, 0.033, 0.3]),
        "plant.speed_lag_s": draw.choice([0.0, 1e-9, 0.002, 0.1, 2.0]),
        "plant.turn_gain": draw.choice([1.1, 1.0]),
        "plant.turn_dead_time_s": draw.choice([0.0, 0.05, 0.3]),
        "plant.turn_lag_s": draw.choice([0.0, 1e-9, 0.002, 0.15, 2.0]),
    }


def build_limits(draw: random.Random) -> Mapping[str, Any]:
    """Return limits of a robot; a reverse gain of None is that of the other direction."""
    return {
        "plant.turn_bound": draw.choice([math.inf, 0.3, 1.0]),
        "plant.speed_bound": draw.choice([math.inf, 0.4]),
        "plant.turn_acceleration": draw.choice([math.inf, 0.5, draw.uniform(1.0, 20.0)]),
        "plant.speed_acceleration": draw.choice([math.inf, 0.2, draw.uniform(0.5, 10.0)]),
        "plant.turn_deadband": draw.choice([0.0, 0.05]),
        "plant.speed_deadband": draw.choice([0.0, 0.02]),
        "plant.turn_reverse_gain": draw.choice([None, 0.0, draw.uniform(0.5, 1.5)]),
        "plant.speed_reverse_gain": draw.choice([None, draw.uniform(0.5, 1.5)]),
    }


def build_law(draw: random.Random, kind: str) -> Mapping[str, Any]:
    """Return a law that is no sequential one, with numbers of its own."""
    builders = {"posture": build_posture, "open-loop": build_open_loop}
    if kind in builders:
        return {"law.kind": kind, **builders[kind](draw)}
    changes = {
        "law.speed_m_s": draw.choice([0.5, 2.0]),
        "law.end_tolerance_m": draw.choice([0.01, 0.3]),
        **build_path(draw),
    }
    if kind == "kanayama":
        changes |= {"law.kx": draw.uniform(0.5, 10.0), "law.ky": draw.uniform(1.0, 64.0)}
        changes["law.ktheta"] = draw.uniform(1.0, 16.0)
    else:
        changes |= {"law.lookahead_m": draw.choice([0.1, 0.3, 1.5, 20.0])}
        changes["law.kp_along"] = draw.choice([0.0, 1.0])
    return {"law.kind": kind, **changes}


def build_posture(draw: random.Random) -> Mapping[str, Any]:
    return {
        "law.gamma": draw.uniform(0.3, 2.0),
        "law.k": draw.uniform(1.0, 6.0),
        "law.h": draw.uniform(0.5, 5.0),
        "law.timeout_s": draw.choice([3.0, math.inf]),
        "law.position_tolerance_m": draw.choice([0.001, 0.05]),
    }


def build_open_loop(draw: random.Random) -> Mapping[str, Any]:
    signal = draw.choice(["impulse", "step", "ramp", "prbs", "sequence"])
    if signal == "sequence":
        times = sorted({round(draw.uniform(0.0, 4.0), 3) for _ in range(8)})
        found: dict[str, Any] = {"law.time_s": times}
        if draw.random() < 0.7:
            found["law.speed_m_s"] = [draw.uniform(-2.0, 2.0) for _ in times]
        if draw.random() < 0.7:
            found["law.turn_rate_rad_s"] = [draw.uniform(-2.0, 2.0) for _ in times]
        return {"law.signal": signal, **found}
    found = {"law.axis": draw.choice(["turn_rate", "speed", "both"])}
    found |= {"law.amplitude": draw.uniform(-1.0, 1.0), "law.start_s": draw.choice([0.0, 0.5])}
    found["law.duration_s"] = draw.choice([0.7, 3.0])
    if signal == "prbs":
        found |= {"law.order": draw.choice([2, 7, 9]), "law.register": draw.randint(1, 3)}
        found["law.bit_s"] = draw.choice([0.032, 0.1])
    if signal == "impulse":
        found["law.width_s"] = draw.choice([0.016, 0.1])
    return {"law.signal": signal, **found}


def build_path(draw: random.Random) -> Mapping[str, Any]:
    kind = draw.choice(["line", "polygon", "waypoints", "circle", "figure-eight"])
    path: dict[str, Any] = {"path.kind": kind}
    if draw.random() < 0.5:
        path["path.speed_m_s"] = draw.choice([0.4, 1.5])
    if kind in {"circle", "figure-eight"}:
        center = {"path.center_x_m": draw.uniform(3.0, 8.0), "path.center_y_m": 5.5}
        return {**path, **center, "path.size_m": draw.choice([0.05, 0.4, 1.5])}
    count = {"line": 2, "polygon": draw.randint(3, 5)}.get(kind, draw.randint(2, 6))
    points = [(draw.uniform(2.0, 9.0), draw.uniform(2.0, 9.0)) for _ in range(count)]
    if kind == "waypoints" and draw.random() < 0.4:
        path["path.closed"] = count > 2
    return {**path, "path.points": points}


def build_other(kind: str, seed: int) -> Scenario:
    """Return a scenario of such a law with some effects, on a turtle or a robot."""
    draw = random.Random(f"{kind} {seed}")
    changes: dict[str, Any] = {
        "max_duration_s": draw.choice([2.0, 12.0]),
        "seed": draw.randrange(2**40),
        "start.x_m": draw.uniform(1.0, 10.0),
        "start.y_m": draw.uniform(1.0, 10.0),
        "start.heading_rad": draw.uniform(-3.2, 3.2),
        "goal.x_m": draw.uniform(1.0, 10.0),
        "goal.y_m": draw.uniform(1.0, 10.0),
        "limits.speed_m_s": draw.choice([1.0, math.inf]),
        "limits.turn_rate_rad_s": draw.choice([1.0, math.inf]),
        "loop.pose_precision": draw.choice(["float32", "float64"]),
    }
    if draw.random() < 0.5:
        changes["goal.heading_rad"] = draw.uniform(-4.0, 4.0)
    for effect in draw.sample(DRAWN_EFFECTS, draw.choice([0, 1, 3])):
        changes |= EFFECTS[effect]
    if "plant.kind" in changes:
        changes |= build_robot(draw)
    return override_scenario(get_preset("textbook"), changes | {**build_law(draw, kind)})
