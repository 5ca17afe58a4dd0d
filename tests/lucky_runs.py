"""Runs whose luck is measured once for all tests."""

from functools import cache
from typing import Any

from turtlelog.explain import Attribution, Luck, attribute_run, identify_run, measure_luck
from turtlelog.run import Run
from turtlelog.scenario import get_preset, override_scenario
from turtlelog.simulate import simulate_run

METRIC = "final.position_error"
NOISY = (("sensing.noise_position_m", 0.002), ("sensing.noise_heading_rad", 0.002))
NEAR_HALF_A_TURN = (("start.heading_rad", 3.138),)

Changes = tuple[tuple[str, Any], ...]


@cache
def simulate_lucky(preset: str, changes: Changes = ()) -> Run:
    """Return a run of a preset with some other keys."""
    return simulate_run(override_scenario(get_preset(preset), dict(changes)))


@cache
def attribute_lucky(preset: str, changes: Changes = (), metric: str = METRIC) -> Attribution:
    """Return what caused its value."""
    return attribute_run(simulate_lucky(preset, changes), metric=metric)


@cache
def measure_lucky(preset: str, changes: Changes = (), metric: str = METRIC) -> Luck:
    """Return its luck."""
    run = simulate_lucky(preset, changes)
    found = attribute_lucky(preset, changes, metric)
    return measure_luck(run, identified=identify_run(run), found=found)
