"""Digests of 2,000 random runs: what holds the simulation to the last bit while its code changes.

`python -m tests.simulate.run_digests write` makes the file of digests anew, `compare` says which
runs are others now; both take about two minutes. A change that is right makes the file anew in a
commit of its own, which says what changed and why.
"""

import hashlib
import math
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from tests.simulate.random_scenarios import OTHER_LAWS, build_other, build_random
from tests.simulate.run_values import list_values
from turtlelog.errors import ScenarioError, SimulationError
from turtlelog.measure import measure_run
from turtlelog.plants import Plant
from turtlelog.processes import count_cores, map_in_processes
from turtlelog.run import Run
from turtlelog.scenario import (
    Scenario,
    flatten_scenario,
    get_preset,
    override_scenario,
    resolve_scenario,
)
from turtlelog.simulate import simulate_run

FILE: Final = Path(__file__).with_name("run_digests.npz")
COUNT: Final = 2000
PARTS: Final = ("poses", "samples", "commands", "events", "metrics")
"""What has a digest of its own; events with all that is no column."""

_OWN_LAWS: Final = ("examples/laws/p.py:P", "examples/laws/pid.py:Pid")
_ENDS: Final = ("ticks", "samples", "commands", "x_m", "y_m", "heading_rad")

_UNITS: Final = re.compile(r"state_units=mappingproxy\(\{[^}]*\}\), ")
"""The units of states, which say how they are shown: no run is another one for them."""

_IN_SPACE: Final = frozenset(
    {"poses.height_m", "poses.tilt_rad", "run.path_length_in_space", "run.height_range"}
    | {"run.tilt_max"}
)
"""Columns and metrics of robots that leave the plane, which no simulated one does."""

Simulate = Callable[[Scenario, Plant], Run]


def build_case(number: int) -> tuple[Scenario, Plant]:
    """Return the scenario of a number, and the plant on whose clock it runs."""
    scenario = _build_scenario(number)
    plant = scenario.plant.facts
    if number % 25 == 3:  # on a finer clock, as without sampling
        return override_scenario(scenario, {"max_duration_s": 2.0}), plant.refine(8)
    return scenario, plant


def _build_scenario(number: int) -> Scenario:
    if number % 50 == 7:
        kind = _OWN_LAWS[number // 50 % len(_OWN_LAWS)]
        own = override_scenario(get_preset("textbook"), {"law.kind": kind}, trust_law=True)
        return override_scenario(own, _list_effects(build_other("posture", number)))
    if number % 100 == 11:  # no pose is answered
        return override_scenario(build_random(number), {"loop.start_backlog": 9000})
    if number % 100 == 13:  # the law's answer is no number any more
        changes: dict[str, Any] = {"law.kp_linear": 1e308, "law.kp_angular": 1e308}
        return override_scenario(build_random(number), changes)
    if number % 2:
        return build_random(number)
    try:
        return build_other(OTHER_LAWS[number // 2 % len(OTHER_LAWS)], number)
    except ScenarioError:  # a path that turns back on itself
        return build_other("posture", number)


def _list_effects(scenario: Scenario) -> dict[str, Any]:
    """Return what a scenario has beside its law and path."""
    kept = flatten_scenario(scenario).items()
    return {key: value for key, value in kept if not key.startswith(("law.", "path.", "name"))}


def digest_run(number: int, simulate: Simulate = simulate_run) -> tuple[list[int], list[float]]:
    """Return the digests of `PARTS` of the run of a number, and how it ends, as `_ENDS` lists.

    Of a scenario that is refused it is that of the kind of its error, whose words may change.
    """
    scenario, plant = build_case(number)
    try:
        run = simulate(resolve_scenario(scenario), plant)
    except SimulationError as err:
        return [_digest(type(err).__name__)] * len(PARTS), [math.nan] * len(_ENDS)
    values = {key: value for key, value in list_values(run).items() if key not in _IN_SPACE}
    values["parameters"] = sorted(values["parameters"].items())  # their order says nothing
    values.pop("simulated_by")  # versions and the platform say nothing of the run
    values["declaration"] = _Written(_UNITS.sub("", repr(values["declaration"])))
    columns: dict[str, dict[str, Any]] = {name: {} for name in PARTS}
    for key, value in values.items():
        part = key.partition(".")[0]
        columns[part if part in columns else "events"][key] = value
    found = measure_run(run).items()
    columns["metrics"] = {
        name: (_write_value(name, one.value), one.status)
        for name, one in found
        if name not in _IN_SPACE
    }
    end = len(run.poses), len(run.samples), len(run.commands)
    pose = *run.poses.xy_m[-1], run.poses.heading_rad[-1]
    return [_digest(columns[name]) for name in PARTS], [*map(float, (*end, *pose))]


def _write_value(name: str, value: float | None) -> float | None:
    """Return a value as it was when the digests were made: a lag was a number of numpy's."""
    return np.float64(value) if value is not None and name.endswith(".lag") else value


class _Written(str):
    """A text that stands without quotation marks where it is written."""

    __slots__ = ()
    __repr__ = str.__str__


def _digest(values: object) -> int:
    return int.from_bytes(hashlib.sha256(repr(values).encode()).digest()[:8], "little")


def probe_platform() -> int:
    """Return a digest of what libm and numpy compute here: another one gives other last bits."""
    numbers = np.random.default_rng(5).uniform(-7.0, 7.0, 20_000)
    found: list[Any] = []
    for name in ("cos", "sin", "tan", "exp", "expm1", "atan"):
        found.append([getattr(math, name)(value) for value in numbers.tolist()])
        found.append(getattr(np, "arctan" if name == "atan" else name)(numbers).tolist())
    found += [np.hypot(numbers, numbers[::-1]).tolist(), float(numbers.sum()), numbers.std()]
    found += [np.arctan2(numbers, numbers[::-1]).tolist(), float(numbers @ numbers[::-1])]
    return _digest(found)


def read_digests() -> tuple[int, NDArray[np.uint64], NDArray[np.float64]]:
    """Return the platform's digest, those of all runs, shape (n, 5), and their ends."""
    with np.load(FILE) as kept:
        return int(kept["platform"]), kept["digests"], kept["ends"]


def main(action: str) -> int:
    """Write the file, or say which runs are others now."""
    found = [*map_in_processes(digest_run, range(COUNT), count_cores())]
    digests = np.array([one for one, _ in found], np.uint64)
    ends = np.array([end for _, end in found])
    if action == "write":
        np.savez_compressed(FILE, platform=np.uint64(probe_platform()), digests=digests, ends=ends)
        return 0
    _, kept, _ = read_digests()
    differs = kept != digests
    for number in np.flatnonzero(differs.any(axis=1)).tolist():
        parts = [name for name, is_other in zip(PARTS, differs[number], strict=True) if is_other]
        sys.stdout.write(f"run {number}: other {', '.join(parts)}\n")
    sys.stdout.write(f"{int((~differs.any(axis=1)).sum())} of {COUNT} runs are the same\n")
    return int(differs.any())


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
