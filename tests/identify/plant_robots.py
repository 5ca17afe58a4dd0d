"""Robots with limits by the simulator's own plant: driven by random steps, seen with noise."""

import math
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any, Final

import numpy as np

import turtlelog as tl
from tests.identify.limited_robots import TURNS_RAD
from tests.identify.robots import Log, draw_steps, wrap
from turtlelog.identify import AxisModel, build_robot_scenario
from turtlelog.run import Run
from turtlelog.theory import recommend_gains

Keys = Mapping[str, Any]

KINDS: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {
        "no limit": (),
        "acceleration": ("acceleration",),
        "bound": ("bound",),
        "deadband": ("deadband",),
        "friction": ("friction",),
        "reverse gain": ("reverse_gain",),
        "two": ("acceleration", "bound"),
        "all": ("acceleration", "bound", "deadband", "reverse_gain"),
    }
)
"""The limits of a kind of robot, on both axes."""

_LARGEST: Final = 1.5
"""Largest command [m/s] and [rad/s]."""

_STARTS: Final = {"speed": "plant.speed_", "turn_rate": "plant.turn_"}


def draw_robot(kind: str, seed: int) -> tuple[Keys, Log]:
    """Return the plant of a robot, and how it is recorded."""
    rng = np.random.default_rng([seed, 71])
    keys: dict[str, Any] = {"plant.kind": "lagged"}
    for key in _STARTS.values():
        gain = float(rng.uniform(0.8, 1.1))
        keys |= {
            f"{key}gain": gain,
            f"{key}dead_time_s": float(rng.uniform(0.03, 0.12)),
            f"{key}lag_s": float(rng.uniform(0.05, 0.25)),
        }
        limits = {
            "acceleration": float(rng.uniform(1.5, 5.0)),
            "bound": gain * float(rng.uniform(0.5, 1.2)),
            "deadband": float(rng.uniform(0.1, 0.4)),
            "friction": float(np.random.default_rng([seed, 72]).uniform(0.1, 0.3)),
            "reverse_gain": gain * float(rng.uniform(0.75, 0.92)),
        }
        keys |= {f"{key}{name}": limits[name] for name in KINDS[kind]}
    log = Log(
        duration_s=40.0,
        poses_hz=float(rng.uniform(20.0, 50.0)),
        noise_m=2e-4 * 10.0 ** float(rng.uniform(-0.7, 0.7)),
        noise_rad=5e-4 * 10.0 ** float(rng.uniform(-0.7, 0.7)),
    )
    return keys, log


def drive_robot(keys: Keys, log: Log, seed: int) -> Run:
    """Return the run of a plant with these keys, driven by random steps on both axes."""
    rng = np.random.default_rng(seed)
    time_s, speeds = draw_steps(rng, log, _LARGEST)
    turns = draw_steps(rng, log, _LARGEST)[1]
    steps = {
        "law.kind": "open-loop",
        "law.signal": "sequence",
        "law.time_s": time_s.round(9).tolist(),
        "law.speed_m_s": speeds.tolist(),
        "law.turn_rate_rad_s": turns.tolist(),
        "plant.period_s": 1.0 / log.poses_hz,
        "loop.pose_precision": "float64",
        "limits.speed_m_s": math.inf,
        "limits.turn_rate_rad_s": math.inf,
    }
    run = tl.simulate_run(tl.override_scenario(tl.load_scenario("lagged"), {**keys, **steps}))
    poses = run.poses
    xy_m = poses.xy_m + rng.normal(0.0, log.noise_m, poses.xy_m.shape)
    heading_rad = wrap(poses.heading_rad + rng.normal(0.0, log.noise_rad, len(poses)))
    return replace(run, poses=replace(poses, xy_m=xy_m, heading_rad=heading_rad))


def list_truth(keys: Keys, axis: AxisModel) -> dict[str, float]:
    """Return the true values of an axis by the names of its model's fields."""
    start = _STARTS[axis.axis]
    found = {key.removeprefix(start): one for key, one in keys.items() if key.startswith(start)}
    names = {"acceleration": "rate_limit"}
    true = {names.get(name, name): value for name, value in found.items()}
    return {**true, "total_delay_s": true["dead_time_s"] + true["lag_s"]}


def turn_as_advised(model: tl.RobotModel, run: Run, keys: Keys) -> list[float]:
    """Return by how much a small and a large turn of the plant overshoot by the gain for 5 % [%].

    The advice is that of `turtlelog theory` for the scenario that `identify --scenario` writes.
    """
    scenario = build_robot_scenario(model, run).scenario
    declaration = tl.simulate.declare_scenario(scenario)
    loops = tl.theory.model_loops(declaration, tl.scenario.flatten_scenario(scenario))
    loop = next(loop for loop in loops if loop.loop.name == "rotate")
    advised = recommend_gains(**loop.require_latest(), overshoot_percent=5.0, limits=loop.limits)
    kp = next(one.gains.kp for one in advised if one.controller == "P" and one.gains)
    # The law lets go within the tolerance, and what then still turns is no overshoot of P control.
    changes = {"law.kp_angular": kp, "law.heading_tolerance_rad": 1e-9, "max_duration_s": 12.0}
    real = tl.override_scenario(_without_plant(scenario), {**keys, **changes})
    return [_overshoot(real, angle_rad) for angle_rad in TURNS_RAD]


def _without_plant(scenario: tl.Scenario) -> tl.Scenario:
    """Return a scenario whose robot has no limits, and poses without noise."""
    plant = {name: None for name in tl.scenario.flatten_scenario(scenario) if "plant." in name}
    kept = {"plant.kind": "lagged", "plant.period_s": scenario.plant.period_s}
    silent = {"sensing.noise_position_m": 0.0, "sensing.noise_heading_rad": 0.0}
    silent |= {"disturbance.noise_speed": 0.0, "disturbance.noise_turn_rate": 0.0}
    return tl.override_scenario(scenario, {**plant, **kept, **silent})


def _overshoot(scenario: tl.Scenario, angle_rad: float) -> float:
    """Return by how much a turn overshoots [%]."""
    goal_m = math.cos(angle_rad), math.sin(angle_rad)
    places = {"goal.x_m": goal_m[0], "goal.y_m": goal_m[1]}
    places |= dict.fromkeys(("start.x_m", "start.y_m", "start.heading_rad"), 0.0)
    run = tl.simulate_run(tl.override_scenario(scenario, places))
    turned = float(np.unwrap(run.poses.heading_rad).max())
    return 100.0 * max(turned / angle_rad - 1.0, 0.0)
