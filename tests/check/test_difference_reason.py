import json
import re
import time
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import pytest

import turtlelog as tl
from tests.explain.robot_pairs import draw_robot_pair
from turtlelog.check import CheckResult, Tolerances, match_run
from turtlelog.check.failure_report import explain_failures
from turtlelog.check.reference import MetricsFile, format_metrics, read_metrics_file
from turtlelog.compare import Tolerance
from turtlelog.errors import CheckError
from turtlelog.run import Run, take_rows
from turtlelog.scenario import get_preset

NEAR = Tolerance(abs=1e-3, reason="a test")
ERROR = "final.position_error"


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
    found = explain_failures(
        simulate("paper-kp10"), simulate("paper-kp2"), results, place="good.mcap"
    )
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
    found = explain_failures(simulate("paper-kp10"), simulate("paper-kp2"), [result])
    assert read_why(found)[0].startswith("run.duration fell from 12.672 s to 12.608 s")


def test_without_a_metric_the_final_error_is_explained() -> None:
    results = match_run(simulate("paper-kp10"), simulate("paper-kp2"), file="new.mcap")
    found = explain_failures(simulate("paper-kp10"), simulate("paper-kp2"), results)
    assert read_why(found)[0].startswith("final.position_error rose from 0.0010 m")


@pytest.mark.parametrize(("beside_m", "is_near"), [(0.095, True), (0.115, False)])
def test_a_metric_that_nobody_asks_for_is_explained_only_if_it_differs(
    beside_m: float, *, is_near: bool
) -> None:
    """Takes some 2 s: two robots are identified, and driven with 32 draws of their parameters."""
    good = replace(draw_robot_pair("noise", 3, has_same_commands=True).first, goal_xy_m=(1.0, 0.0))
    xy_m = good.poses.xy_m.copy()
    xy_m[450:, 0] += beside_m
    bad = replace(good, poses=replace(good.poses, xy_m=xy_m))
    results = match_run(bad, good, Tolerances(signals={"x": NEAR}), file="bad.mcap")
    why = read_why(explain_failures(bad, good, results, place="good.mcap"))
    hardly = "Not explained: no failed check names a metric, and final.position_error hardly"
    assert why[0].startswith(
        hardly if is_near else "final.position_error fell from 1.0000 m to 0.88"
    )
    assert any(one.startswith("this run: 1 jump, ") for one in why) is not is_near
    assert why[-1].startswith("More: turtlelog compare good.mcap bad.mcap --why")


@pytest.mark.parametrize("who", ["the reference", "this run"])
def test_a_log_of_commands_alone_is_not_explained(who: str) -> None:
    run = simulate("paper-kp2")
    none = {name: take_rows(getattr(run, name), slice(0)) for name in ("poses", "samples")}
    alone = replace(run, **none, absent=("poses", "samples", "stop_reason"))
    pair = (run, alone) if who == "the reference" else (alone, run)
    found = explain_failures(*pair, judge("final.position_error"))
    assert read_why(found)[0] == f"Not explained: {who} has no poses."


def test_what_passes_has_no_reason() -> None:
    run = simulate("paper-kp10")
    results = match_run(run, run)
    assert not any(one.why for one in explain_failures(run, run, results))


def test_a_reason_that_takes_too_long_is_given_up() -> None:
    results = judge("final.position_error")
    began_s = time.perf_counter()
    runs = simulate("paper-kp10"), simulate("paper-kp2")
    why = read_why(explain_failures(*runs, results, limit_s=0.0))
    assert "simulations took 0 s" in why[0]
    assert why[1].startswith("More: turtlelog compare")
    assert time.perf_counter() - began_s < 5.0


def test_long_runs_are_not_simulated_again() -> None:
    run = simulate("paper-kp10")
    poses = replace(run.poses, time_ns=run.poses.time_ns * 100)
    commands = replace(run.commands, time_ns=run.commands.time_ns * 100)
    samples = replace(run.samples, time_ns=run.samples.time_ns * 100)
    long = replace(run, poses=poses, commands=commands, samples=samples)
    why = read_why(explain_failures(long, simulate("paper-kp2"), judge("final.position_error")))
    assert why[0] == "Not explained here: a run of 1267 s takes longer."


def test_laws_that_nobody_trusts_are_not_run_for_a_reason() -> None:
    run = simulate("paper-kp10")
    other = replace(run, parameters={**run.parameters, "law.kind": "mine.py:Law"})
    why = read_why(explain_failures(other, run, judge("final.position_error")))
    assert "mine.py:Law runs only if its code is trusted" in why[1]


def write_metrics(folder: Path, run: Run, **changes: Any) -> MetricsFile:
    """Return the file of metrics of a run, with entries changed; None leaves one out."""
    (entry,) = json.loads(format_metrics(run, "good.mcap"))
    entry |= changes
    file = folder / "good.json"
    file.write_text(json.dumps({k: v for k, v in entry.items() if v is not None}), "utf-8")
    found = read_metrics_file(file)
    assert found is not None
    return found


def explain_metrics(reference: MetricsFile, run: Run, **options: Any) -> tuple[str, ...]:
    results = match_run(run, reference, Tolerances(metrics={ERROR: NEAR}), file="new.mcap")
    assert all(one.reference is reference for one in results)
    return read_why(explain_failures(run, reference, results, **options))


def test_a_file_of_metrics_with_its_scenario_is_simulated_again(tmp_path: Path) -> None:
    reference = write_metrics(tmp_path, simulate("paper-kp2"))
    assert explain_metrics(reference, simulate("paper-kp10")) == (
        "final.position_error rose from 0.0010 m to 0.1067 m: the gains add 0.1071 m, the shorter"
        " pause takes 0.0014 m away.",
        f"The scenario in good.json, simulated again, has the {len(reference.metrics)} metrics of"
        " that file.",
    )


def test_a_file_of_metrics_alone_has_no_cause_and_the_line_says_what_to_type(
    tmp_path: Path,
) -> None:
    reference = write_metrics(tmp_path, simulate("paper-kp2"), scenario=None)
    assert explain_metrics(reference, simulate("paper-kp10")) == (
        "Not explained: good.json has no scenario. Accept a good recording anew (--turtlelog-accept"
        " stores it), or with a good recording: turtlelog compare GOOD.mcap new.mcap --why"
        " final.position_error",
    )


@pytest.mark.parametrize(("part", "is_apart"), [(0.9e-6, False), (1.1e-6, True)])
def test_metrics_that_their_scenario_does_not_give_explain_nothing(
    tmp_path: Path, part: float, *, is_apart: bool
) -> None:
    good = simulate("paper-kp2")
    metrics = [
        one.to_dict()
        | ({"value": one.value * (1.0 + part)} if one.id == ERROR and one.value else {})
        for one in tl.measure_run(good).values()
    ]
    software = {**good.simulated_by, "numpy": "1.0"}
    reference = write_metrics(tmp_path, good, metrics=metrics, simulated_by=software)
    why = explain_metrics(reference, simulate("paper-kp10"))
    assert (why[0].startswith("Not explained: final.position_error is 0.00101132 m in")) == is_apart
    assert (f"differs: NumPy 1.0, then {good.simulated_by['numpy']}." in why[-1]) == is_apart
    assert "No setting differs between that scenario and this run." not in why


def test_a_run_of_the_same_settings_says_so_where_their_metrics_changed(tmp_path: Path) -> None:
    run = simulate("paper-kp10")
    metrics = [
        one.to_dict() | ({"value": 0.05} if one.id == ERROR else {})
        for one in tl.measure_run(run).values()
    ]
    why = explain_metrics(write_metrics(tmp_path, run, metrics=metrics), run)
    assert why == (
        "Not explained: final.position_error is 0.05 m in good.json, and 0.106728 m if its scenario"
        " is simulated again.",
        "No setting differs between that scenario and this run.",
    )


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("sequential-p", "mine.py:Law", "mine.py:Law, the law in "),
        ("max_duration_s = 60.0", "max_duration_s = 601.0", "a scenario of up to 601 s takes too"),
        ("[limits]", "[limits", "good.json: scenario: not TOML"),
        ("[limits]", "[limit]", "good.json: scenario: limit: "),
    ],
)
def test_a_scenario_that_cannot_run_says_why(tmp_path: Path, old: str, new: str, told: str) -> None:
    good = simulate("paper-kp2")
    (entry,) = json.loads(format_metrics(good, "good.mcap"))
    text = entry["scenario"]
    assert old in text
    reference = write_metrics(tmp_path, good, scenario=text.replace(old, new))
    (why,) = explain_metrics(reference, simulate("paper-kp10"))
    assert why.startswith("Not explained: ")
    assert told in why


@pytest.mark.parametrize(
    ("entry", "told"),
    [
        ({"scenario": 3}, "scenario: Expected `str`, got `int`"),
        ({"simulated_by": []}, "simulated_by: Expected `object`, got `array`"),
        ({"simulated_by": {"numpy": 2}}, "simulated_by: Expected `str`, got `int`"),
        ({"metrics": []}, "metrics: must not be empty"),
    ],
)
def test_wrong_entries_of_a_file_of_metrics_are_named(
    tmp_path: Path, entry: dict[str, Any], told: str
) -> None:
    with pytest.raises(CheckError, match=re.escape(f"good.json: {told}")):
        write_metrics(tmp_path, simulate("paper-kp2"), **entry)


@pytest.mark.parametrize("name", ["final.position_error", "run.duration"])
def test_results_know_what_they_were_held_to(name: str) -> None:
    good = simulate("paper-kp2")
    assert all(one.reference is good for one in judge(name, reference=good))
