"""Of a law that is not the sequential proportional one nothing is claimed."""

from dataclasses import replace
from typing import Any

import pytest

from turtlelog.explain import Certainty, Identification, identify_run
from turtlelog.explain.identification import LAW_KEYS
from turtlelog.run import Run
from turtlelog.scenario import build_scenario, nest_parameters
from turtlelog.simulate import simulate_run

PID = "tests/explain/other_laws.py:SequentialPid"
TURN_AND_DRIVE = "examples/turn_and_drive.py:TurnAndDrive"


def simulate_law(kind: str, **parameters: Any) -> Run:
    values = {"law.kind": kind, **{f"law.{key}": value for key, value in parameters.items()}}
    return simulate_run(build_scenario(nest_parameters(values), trust_law=True))


def forget(run: Run) -> Run:
    """Return a run that does not name its law."""
    return replace(run, parameters={}, scenario_is_complete=False)


def list_claims(found: Identification) -> list[str]:
    return [key for key in LAW_KEYS if found.findings[key].certainty is not Certainty.UNKNOWN]


@pytest.mark.parametrize("forgotten", [False, True], ids=["named", "unnamed"])
@pytest.mark.parametrize(
    ("kind", "parameters"),
    [
        (TURN_AND_DRIVE, {}),
        (PID, {"ki": 0.2, "kd": 0.1}),
        (PID, {"ki": 0.0, "kd": 0.002}),
        (PID, {"ki": 0.001, "kd": 0.0}),
    ],
    ids=["turn and drive", "PID", "little D", "little I"],
)
def test_nothing_is_claimed_of_another_law(
    kind: str, parameters: dict[str, float], *, forgotten: bool
) -> None:
    run = simulate_law(kind, **parameters)
    found = identify_run(forget(run) if forgotten else run)
    assert list_claims(found) == []
    assert found.notes


def test_another_law_leaves_the_dead_time_standing() -> None:
    found = identify_run(simulate_law(TURN_AND_DRIVE))
    assert found.findings["dead_time.translate"].value == 0
    assert found.scenario is None
