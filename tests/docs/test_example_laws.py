"""The laws of examples/laws/: each runs as its head says, is measured, and answers a recording."""

import ast
import shlex
from pathlib import Path

import numpy as np
import pytest

import turtlelog as tl
from tests.cli.conftest import Call, call as call

ROOT = Path(__file__).parents[2]
LAWS = sorted((ROOT / "examples" / "laws").glob("*.py"))
NAMES = {"compiled_p": "P", "turn": "turn_and_drive"}
"""Of laws that are no class named as their file."""


def read_command(path: Path) -> list[str]:
    head = ast.get_docstring(ast.parse(path.read_text("utf-8"))) or ""
    (line,) = [line for line in head.splitlines() if line.startswith("turtlelog run ")]
    return shlex.split(line)[1:]


def simulate(name: str, **parameters: float) -> tl.Run:
    (path,) = [path for path in LAWS if path.stem == name]
    kind = f"{path}:{NAMES.get(name, name.capitalize())}"
    changes = {f"law.{key}": value for key, value in parameters.items()}
    scenario = tl.override_scenario(tl.load_scenario("textbook"), {"law.kind": kind})
    return tl.simulate_run(tl.override_scenario(scenario, changes))


@pytest.mark.parametrize("path", LAWS, ids=lambda path: path.stem)
def test_a_law_runs_as_its_head_says_and_answers_what_it_recorded(
    path: Path, call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(ROOT)
    recording, words = tmp_path / "a.mcap", read_command(path)
    answer = call(*words, "-o", recording)
    assert (answer.code, answer.err) == (0, f"wrote {recording}\n")
    law = words[words.index("--law") + 1]
    replay = call("replay", recording, "--law", law, "--expect-equal", "--json")
    assert replay.code == 0
    assert replay.json["first_difference"] is None
    signals = replay.json["signals"]
    assert {"wanted_speed", "wanted_turn_rate"} < {found["signal"] for found in signals}
    assert {found["largest"] for found in signals} == {0.0}


@pytest.mark.parametrize("path", LAWS, ids=lambda path: path.stem)
def test_a_law_comes_to_its_own_end_and_is_measured(path: Path) -> None:
    run = simulate(path.stem)
    is_function = path.stem == "turn"  # which has no word to end by
    ends = {"max_duration"} if is_function else {"arrived", "rounds_done"}
    assert run.stop_reason in ends
    metrics = tl.measure_run(run)
    for loop in run.declaration.loops:
        assert metrics[f"{loop.name}.iae"].value is not None


def test_p_turns_without_overshoot_and_arrives() -> None:
    metrics = tl.measure_run(simulate("p"))
    assert metrics["align.overshoot"].value == pytest.approx(0.0, abs=0.01)
    assert metrics["final.position_error"].value == pytest.approx(0.01, abs=0.016)


def test_pid_without_integral_and_derivative_is_p() -> None:
    found, expected = simulate("pid", ki=0.0, kd=0.0), simulate("p")
    assert found.poses.xy_m.tolist() == expected.poses.xy_m.tolist()


def test_the_integral_of_pid_stays_within_its_bounds() -> None:
    states = {most: simulate("pid", most_integral=most).samples.states for most in (0.1, 0.5, 9.0)}
    peaks = {
        most: np.abs(found).max(axis=0)[0] for most, found in states.items() if found is not None
    }
    assert (peaks[0.1], peaks[0.5]) == (0.1, 0.5)
    assert 0.5 < peaks[9.0] < 9.0


def test_tracking_catches_up_with_the_point_on_the_circle() -> None:
    run = simulate("tracking")
    samples = run.samples
    assert samples.reference_xy_m is not None
    around = samples.reference_xy_m - np.array(run.goal_xy_m)
    np.testing.assert_allclose(np.hypot(*around.T), 1.0, rtol=1e-12)
    away_m = samples.reference_xy_m - run.poses.xy_m[samples.pose_sequence]
    lag_m = np.hypot(*away_m.T)
    assert lag_m[0] > 4.0
    # What is left is below the way of one sample: 0.5 m/s for 16 ms.
    assert lag_m[-1] < 0.008
    assert not any(event.kind == "wall_hit" for event in run.events)
