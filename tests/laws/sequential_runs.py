"""Runs of the sequential laws in loops that are linear: no limits, poses of 64 bits."""

from typing import Any

import turtlelog as tl
from turtlelog.scenario import override_scenario

LINEAR = {
    "limits.speed_m_s": float("inf"),
    "limits.turn_rate_rad_s": float("inf"),
    "loop.pose_precision": "float64",
    "start.precision": "float64",
    "law.heading_tolerance_rad": 1e-300,
    "law.position_tolerance_m": 1e-300,
    "law.settled_for_s": float("inf"),
    "law.standstill_samples": 1_000_000,
}
"""The loop of the textbook, without limits and tolerances."""


def build_run(
    preset: str = "textbook", *, kind: str = "sequential-pid", **changes: Any
) -> tl.Scenario:
    """Return a preset with another law; keywords are its parameters, or keys with __ for dots."""
    scenario = override_scenario(tl.load_scenario(preset), {"law.kind": kind})
    values = {
        key.replace("__", ".") if "__" in key else f"law.{key}": value
        for key, value in changes.items()
    }
    return override_scenario(scenario, values)


def keep_law(preset: str) -> dict[str, Any]:
    """Return the parameters of a preset's law."""
    parameters = tl.scenario.flatten_scenario(tl.load_scenario(preset))
    return {
        key.removeprefix("law."): value
        for key, value in parameters.items()
        if key.startswith("law.") and key != "law.kind"
    }


def simulate(preset: str = "textbook", **changes: Any) -> tl.Run:
    """Simulate `build_run`."""
    return tl.simulate_run(build_run(preset, **changes))
