"""Runs that checks are tried on, simulated once."""

from functools import cache

import turtlelog as tl


@cache
def simulate(name: str = "paper-kp4", **changes: object) -> tl.Run:
    values = {key.replace("__", "."): value for key, value in changes.items()}
    return tl.simulate_run(tl.override_scenario(tl.load_scenario(name), values))
