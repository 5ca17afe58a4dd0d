"""Tuning in one call; errors name the argument."""

import math
from typing import Any

import pytest

import turtlelog as tl

SMALL: dict[str, Any] = {"evaluations": 16, "changes": {"max_duration_s": 20.0}}


def test_two_gains_are_tuned_in_one_call() -> None:
    """Simulates some hundred candidates: 4 s."""
    ranges = {"law.kp_linear": (1, 6), "law.kp_angular": (1.0, 6.0)}
    found = tl.tune_scenario(
        "textbook", ranges, minimise="run.duration", subject_to="rotate.overshoot <= 2", **SMALL
    )
    assert found.is_feasible
    assert all(1.0 <= value <= 6.0 for value in found.values.values())
    run = tl.simulate_run(found.scenario)
    assert tl.measure_run(run)["run.duration"] == found.objective
    assert repr(found).startswith("<TunedScenario: run.duration is ")
    assert len(repr(found)) <= 80
    assert "law.kp_angular" in found._repr_html_()


@pytest.mark.parametrize(
    ("ranges", "words", "match"),
    [
        ({"law.kp_linear": (1, 6)}, {}, "expected minimise or maximise, one of them"),
        (
            {"law.kp_linear": (1, 6)},
            {"minimise": "run.duration", "maximise": "run.duration"},
            "expected minimise or maximise, one of them",
        ),
        ({}, {"minimise": "run.duration"}, "ranges: expected bounds by key, as in"),
        ({"law.kp_linear": 1}, {"minimise": "run.duration"}, "ranges: law.kp_linear: expected two"),
        (
            {"law.kp_linear": (1, math.inf)},
            {"minimise": "run.duration"},
            "ranges: law.kp_linear: expected two finite numbers",
        ),
        (
            {"law.kp_linear": (6, 1)},
            {"minimise": "run.duration"},
            "ranges: law.kp_linear: no value from 6 to 1",
        ),
        ({"law.kp": (1, 6)}, {"minimise": "run.duration"}, "ranges: law.kp: unknown key"),
        ({"law.kp_linear": (-3, -1)}, {"minimise": "run.duration"}, "ranges: law.kp_linear: exp"),
        ({"law.kp_linear": (1, 6)}, {"minimise": "foo"}, 'minimise: column 1: unknown name "foo"'),
        (
            {"law.kp_linear": (1, 6)},
            {"minimise": "run.duration", "subject_to": "rotate.overshot < 1"},
            "subject_to: column 1: unknown name",
        ),
        (
            {"law.kp_linear": (1, 6)},
            {"minimise": "run.duration", "evaluations": 2},
            "evaluations: expected at least 8, found 2",
        ),
        (
            {"law.kp_linear": (1, 6)},
            {"minimise": "run.duration", "seed": -1},
            "seed: expected at least 0, found -1",
        ),
    ],
    ids=[
        *("no goal", "two goals", "empty", "one bound", "infinite", "backward", "key", "negative"),
        *("metric", "constraint", "few", "seed"),
    ],
)
def test_arguments_that_do_not_fit_are_refused_by_name(
    ranges: Any, words: dict[str, Any], match: str
) -> None:
    with pytest.raises(tl.TurtlelogError, match=match):
        tl.tune_scenario("textbook", ranges, **words)
