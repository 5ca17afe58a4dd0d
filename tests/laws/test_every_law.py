"""Every law under every setting of the loop: it runs, is recorded, and replays to no difference.

The settings are combined so that every two values of two settings meet in some run.
"""

import math
import random
from collections.abc import Iterator, Mapping
from itertools import combinations, product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import turtlelog as tl
from turtlelog.laws import LAWS
from turtlelog.scenario import build_scenario, parse_scenario, resolve_scenario

SQUARE = {
    "kind": "polygon",
    "points": [[5.5, 5.5], [6.5, 5.5], [6.5, 6.5], [5.5, 6.5]],
}
VARIANTS: dict[str, tuple[dict[str, Any], ...]] = {
    "sequential-p": ({}, {"law": {"pause_ticks": 33, "projection": "bearing", "kp_linear": 10.0}}),
    "sequential-pid": (
        {"law": {"ki_linear": 0.5, "kd_angular": 0.1, "derivative_filter_s": 0.05}},
        {"law": {"ki_angular": 1.0, "kd_linear": 0.2, "anti_windup": "back-calculation"}},
    ),
    "pure-pursuit": ({"path": SQUARE}, {"path": {**SQUARE, "speed_m_s": 0.4}}),
    "kanayama": ({"path": SQUARE}, {"path": {**SQUARE, "speed_m_s": 0.4}}),
    "posture": ({"goal": {"heading_rad": 1.5}}, {}),
    "open-loop": (
        {"law": {"signal": "prbs", "duration_s": 5.0}},
        {"law": {"signal": "sequence", "time_s": [0.0, 1.0], "turn_rate_rad_s": [0.5, -0.5]}},
    ),
}
"""Scenarios by law, each with what it needs."""

SETTINGS: dict[str, tuple[Any, ...]] = {
    "variant": tuple(
        (kind, number) for kind, found in VARIANTS.items() for number in range(len(found))
    ),
    "loop.period_ticks": (1, 3),
    "loop.start_backlog": (1, 5),
    "loop.pose_queue": (10, 2),
    "loop.command_queue": (7, 1),
    "loop.queue_policy": ("newest", "one-per-tick"),
    "loop.transport_delay_ticks": (0, 4),
    "loop.pose_precision": ("float32", "float64"),
    "limits.speed_m_s": (1.0, math.inf),
    "limits.turn_rate_rad_s": (1.0, math.inf),
    "start.precision": ("float32", "float64"),
}

Case = Mapping[str, Any]


def list_pairs(case: Case) -> set[tuple[Any, ...]]:
    return {(a, case[a], b, case[b]) for a, b in combinations(SETTINGS, 2)}


def combine() -> Iterator[Case]:
    """Yield cases until every pair of values has met: of many drawn, that with most new pairs."""
    draw = random.Random(20)
    left = {
        (a, one, b, other)
        for a, b in combinations(SETTINGS, 2)
        for one, other in product(SETTINGS[a], SETTINGS[b])
    }
    while left:
        a, one, b, other = min(left, key=repr)
        drawn = [
            {name: draw.choice(values) for name, values in SETTINGS.items()} | {a: one, b: other}
            for _ in range(30)
        ]
        best = max(drawn, key=lambda case: len(list_pairs(case) & left))
        left -= list_pairs(best)
        yield best


CASES = tuple(combine())


def build(case: Case) -> tl.Scenario:
    kind, number = case["variant"]
    tables = VARIANTS[kind][number]
    law = {"kind": kind, **tables.get("law", {})}
    scenario = build_scenario({**tables, "law": law, "name": "pair", "max_duration_s": 6.0})
    changes = {key: value for key, value in case.items() if key != "variant"}
    return tl.override_scenario(scenario, changes)


def name_case(case: Case) -> str:
    return ",".join(str(value) for value in case.values())


def test_every_built_in_law_is_here() -> None:
    assert set(VARIANTS) == set(LAWS)


def test_every_two_values_meet() -> None:
    met = set().union(*(list_pairs(case) for case in CASES))
    values = [len(values) for values in SETTINGS.values()]
    assert len(met) == sum(one * other for one, other in combinations(values, 2))


@pytest.mark.parametrize("case", CASES, ids=name_case)
def test_recording_of_any_law_in_any_loop_replays_to_no_difference(
    case: Case, tmp_path: Path
) -> None:
    scenario = build(case)
    file = tmp_path / "run.mcap"
    run = tl.simulate_run(scenario)
    tl.write_recording(run, file)
    found = tl.read_run(file)
    for columns in ("poses", "commands", "samples"):
        recorded, simulated = getattr(found, columns), getattr(run, columns)
        for name in recorded.__dataclass_fields__:
            np.testing.assert_array_equal(getattr(recorded, name), getattr(simulated, name))
    loop = tl.replay_loop(found)
    law = tl.replay_law(found)
    assert (loop.first_difference, law.first_difference) == (None, None)
    assert loop.run.stop_reason == run.stop_reason


@pytest.mark.parametrize("variant", SETTINGS["variant"], ids=lambda found: f"{found[0]}-{found[1]}")
def test_scenario_of_any_law_comes_back_from_its_text(variant: tuple[str, int]) -> None:
    kind, number = variant
    tables = VARIANTS[kind][number]
    scenario = build_scenario({**tables, "law": {"kind": kind, **tables.get("law", {})}})
    again = parse_scenario(tl.format_scenario(scenario))
    assert resolve_scenario(again) == resolve_scenario(scenario)
    assert tl.format_scenario(again) == tl.format_scenario(scenario)


@pytest.mark.parametrize("variant", SETTINGS["variant"], ids=lambda found: f"{found[0]}-{found[1]}")
def test_two_simulations_of_any_law_are_one_run(variant: tuple[str, int], tmp_path: Path) -> None:
    kind, number = variant
    tables = VARIANTS[kind][number]
    scenario = build_scenario({**tables, "law": {"kind": kind, **tables.get("law", {})}})
    files = [tmp_path / name for name in ("one.mcap", "two.mcap")]
    for file in files:
        tl.write_recording(tl.simulate_run(scenario), file)
    assert files[0].read_bytes() == files[1].read_bytes()


OTHERS = [found for found in SETTINGS["variant"] if found[0] != "sequential-p"]
"""Of laws whose parameters cannot be identified from their commands."""


@pytest.mark.parametrize("variant", OTHERS, ids=lambda found: f"{found[0]}-{found[1]}")
def test_explain_claims_no_parameter_of_a_law_that_it_cannot_identify(
    variant: tuple[str, int],
) -> None:
    kind, number = variant
    tables = VARIANTS[kind][number]
    scenario = build_scenario(
        {**tables, "law": {"kind": kind, **tables.get("law", {})}, "max_duration_s": 6.0}
    )
    found = tl.identify_run(tl.simulate_run(scenario))
    claimed = [
        key
        for key, one in found.findings.items()
        if key.startswith("law.") and one.value is not None
    ]
    assert claimed in ([], ["law.pause_ticks"])
    assert found.resimulation is not None
    assert found.resimulation.is_exact
