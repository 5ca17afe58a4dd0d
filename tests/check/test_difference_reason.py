import time
from dataclasses import replace
from functools import cache

import pytest

import turtlelog as tl
from turtlelog.check import CheckResult, Tolerances, match_run
from turtlelog.check.difference_reason import add_reason
from turtlelog.compare import Tolerance
from turtlelog.run import Run
from turtlelog.scenario import get_preset

NEAR = Tolerance(abs=1e-3, reason="a test")


@cache
def simulate(name: str) -> Run:
    return tl.simulate_run(get_preset(name))


def judge(*metrics: str, reference: Run | None = None) -> list[CheckResult]:
    tolerances = Tolerances(metrics=dict.fromkeys(metrics, NEAR))
    good = reference or simulate("paper-kp2")
    return match_run(simulate("paper-kp10"), good, tolerances, file="new.mcap")


def read_why(results: list[CheckResult]) -> tuple[str, ...]:
    (why,) = [one.why for one in results if one.why]
    return why


def test_the_check_of_the_metric_that_matters_most_has_the_reason() -> None:
    results = judge("run.duration", "final.position_error", "run.path_length")
    found = add_reason(simulate("paper-kp10"), simulate("paper-kp2"), results, place="good.mcap")
    assert [bool(one.why) for one in found] == [False, True, False]
    assert read_why(found) == (
        "final.position_error rose from 0.0010 m to 0.1067 m: the gains add 0.1071 m, the shorter"
        " pause takes 0.0014 m away.",
        "The recorded scenarios reproduce all samples of both runs.",
        "More: turtlelog compare good.mcap new.mcap --why final.position_error",
    )


def test_a_formula_is_explained_by_the_metric_that_it_names() -> None:
    spec = tl.parse_spec('format = 1\n[checks.time]\nexpect = "run.duration > 20"\n')
    (result,) = tl.check_runs(spec, [("new.mcap", simulate("paper-kp10"))])
    found = add_reason(simulate("paper-kp10"), simulate("paper-kp2"), [result])
    assert read_why(found)[0].startswith("run.duration fell from 12.672 s to 12.608 s")


def test_without_a_metric_the_final_error_is_explained() -> None:
    results = match_run(simulate("paper-kp10"), simulate("paper-kp2"), file="new.mcap")
    found = add_reason(simulate("paper-kp10"), simulate("paper-kp2"), results)
    assert read_why(found)[0].startswith("final.position_error rose from 0.0010 m")


def test_what_passes_has_no_reason() -> None:
    run = simulate("paper-kp10")
    results = match_run(run, run)
    assert not any(one.why for one in add_reason(run, run, results))


def test_a_reason_that_takes_too_long_is_given_up() -> None:
    results = judge("final.position_error")
    began_s = time.perf_counter()
    runs = simulate("paper-kp10"), simulate("paper-kp2")
    why = read_why(add_reason(*runs, results, limit_s=0.0))
    assert "simulations took 0 s" in why[0]
    assert why[1].startswith("More: turtlelog compare")
    assert time.perf_counter() - began_s < 5.0


def test_long_runs_are_not_simulated_again() -> None:
    run = simulate("paper-kp10")
    poses = replace(run.poses, time_ns=run.poses.time_ns * 100)
    commands = replace(run.commands, time_ns=run.commands.time_ns * 100)
    samples = replace(run.samples, time_ns=run.samples.time_ns * 100)
    long = replace(run, poses=poses, commands=commands, samples=samples)
    why = read_why(add_reason(long, simulate("paper-kp2"), judge("final.position_error")))
    assert why[0] == "Not explained here: a run of 1267 s takes longer."


def test_laws_that_nobody_trusts_are_not_run_for_a_reason() -> None:
    run = simulate("paper-kp10")
    other = replace(run, parameters={**run.parameters, "law.kind": "mine.py:Law"})
    why = read_why(add_reason(other, run, judge("final.position_error")))
    assert "mine.py:Law runs only if its code is trusted" in why[1]


@pytest.mark.parametrize("name", ["final.position_error", "run.duration"])
def test_results_know_what_they_were_held_to(name: str) -> None:
    good = simulate("paper-kp2")
    assert all(one.reference is good for one in judge(name, reference=good))
