"""Arguments of the wrong kind: the error is one of ours, and begins with the argument's name."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
import pytest

import turtlelog as tl

TL: Final[Any] = tl
KEY: Final = "law.kp_linear"
RUNS: Final = [tl.simulate_run(f"paper-kp{kp}", changes={"max_duration_s": 1.0}) for kp in (4, 1)]
RUN: Final = RUNS[0]
SCENARIO: Final = tl.load_scenario("paper")

NO_RUN: Final[dict[str, Callable[[Any], object]]] = {
    "measure_run": tl.measure_run,
    "read_signal": lambda run: tl.read_signal(run, "heading"),
    "summarise_run": tl.summarise_run,
    "attribute_run": tl.attribute_run,
    "identify_run": tl.identify_run,
    "compare_runs": lambda run: tl.compare_runs(RUN, run),
    "replay_law": tl.replay_law,
    "replay_loop": tl.replay_loop,
    "replay_plant": tl.replay_plant,
    "show_run": tl.show_run,
    "write_recording": lambda run: tl.write_recording(run, "x.mcap"),
    "write_run_rrd": lambda run: tl.write_run_rrd(run, "x.rrd"),
}
"""Functions of one run, which they call `run`."""

NO_RUNS: Final[dict[str, Callable[[Any], object]]] = {
    "draw_figure": lambda runs: tl.draw_figure("heading", runs),
    "write_figures": lambda runs: tl.write_figures(runs, "figures", only=["heading"]),
    "write_comparison_rrd": lambda runs: tl.write_comparison_rrd(runs, "x.rrd"),
    "identify_robot": tl.identify_robot,
}
"""Functions of several runs, which they call `runs`."""

WRONG: Final[dict[str, tuple[Callable[[], object], str]]] = {
    "changes: a list": (lambda: TL.simulate_run("paper", changes=[1]), "changes: expected values"),
    "scenario: a run": (lambda: TL.simulate_run(RUN), "scenario: expected a Scenario, found <Run"),
    "scenario: a name": (
        lambda: TL.replay_loop(RUN, "paper"),
        "scenario: expected a Scenario, found 'paper'; load_scenario returns",
    ),
    "scenario to change": (lambda: TL.override_scenario("paper", {KEY: 1.0}), "scenario: expected"),
    "scenario to format": (lambda: TL.format_scenario("paper"), "scenario: expected a Scenario"),
    "scenario as text": (lambda: TL.parse_scenario(None), "scenario: not TOML: expected text"),
    "step_budget_s": (
        lambda: TL.simulate_run("textbook", step_budget_s="1"),
        "step_budget_s: expected a time above 0 s, found '1'",
    ),
    "sinks: one of them": (
        lambda: TL.simulate.run_live(SCENARIO, 3, realtime=False),
        "sinks: expected a list",
    ),
    "sinks: a number": (
        lambda: TL.simulate.run_live(SCENARIO, [3], realtime=False),
        "sinks: expected a list",
    ),
    "grid: two dimensions": (
        lambda: tl.sweep_scenario("paper", {KEY: np.ones((2, 2))}),
        f"grid: {KEY}: expected one dimension, found array",
    ),
    "metrics: a number": (
        lambda: TL.sweep_scenario("paper", {KEY: [1.0]}, metrics=3),
        "metrics: expected names or patterns, found 3",
    ),
    "evaluations: text": (
        lambda: TL.tune_scenario("paper", {KEY: (1, 6)}, minimise="run.duration", evaluations="8"),
        "evaluations: expected a whole number, found '8'",
    ),
    "evaluations: a half": (
        lambda: TL.tune_scenario("paper", {KEY: (1, 6)}, minimise="run.duration", evaluations=8.5),
        "evaluations: expected a whole number, found 8.5",
    ),
    "settings": (lambda: TL.measure_run(RUN, {"band": 0.05}), "settings: expected MeasureSettings"),
    "a signal": (lambda: TL.read_signal(RUN, 3), 'no signal "3"'),
    "width: text": (lambda: TL.show_run(RUN, width="100%"), "width: must be at least 1 pixel"),
    "width: nan": (lambda: TL.show_run(RUN, width=float("nan")), "width: must be at least 1 pixel"),
    "start_s": (lambda: TL.Run.slice(RUN, "a", 2), "start_s: expected a time in s, found 'a'"),
    "path: None": (lambda: TL.read_run(None), "path: expected text or a Path, found None"),
    "path: a list": (lambda: TL.read_run(["x.mcap"]), "path: expected text or a Path, found ["),
    "path: bytes": (lambda: TL.Recording(b"x.mcap"), "path: expected text or a Path, found b'x"),
    "path and run": (lambda: TL.write_recording("x.mcap", RUN), "run: expected a Run, found 'x."),
    "a formula": (lambda: TL.check_formula(RUN, 3), "expression: expected a formula, found 3"),
    "signals": (lambda: TL.check_formula("speed < 1", RUN), "signals: expected a Run or values"),
    "summaries: runs": (
        lambda: TL.tabulate_runs(RUNS),
        "summaries[0]: expected what summarise_run returns, found <Run",
    ),
    "reference": (lambda: TL.compare_runs(None, RUN), "reference: expected a Run, found None"),
    "first": (lambda: TL.explain_difference("a", RUN), "first: expected a Run, found 'a'"),
    "second": (lambda: TL.explain_difference(RUN, None), "second: expected a Run, found None"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_argument_is_named(name: str, tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.chdir(tmp_path)
    call, begin = WRONG[name]
    with pytest.raises(tl.TurtlelogError) as caught:
        call()
    assert str(caught.value).startswith(begin)
    assert "\n" not in str(caught.value)
    assert [*tmp_path.iterdir()] == []


@pytest.mark.parametrize("name", NO_RUN)
def test_what_is_no_run_is_named_with_what_returns_one(name: str) -> None:
    """The first loads what draws: 3 s."""
    for given, advice in (
        ("kp4.mcap", "read_run reads a file, simulate_run simulates a preset"),
        (Path("kp4.mcap"), "read_run reads a file, simulate_run simulates a preset"),
        (SCENARIO, "simulate_run simulates a scenario"),
        (None, "found None"),
        (RUNS, "found [<Run"),
    ):
        with pytest.raises(tl.TurtlelogError, match=r"^run: expected a Run, found") as caught:
            NO_RUN[name](given)
        assert advice in str(caught.value)


@pytest.mark.parametrize("name", NO_RUNS)
def test_one_that_is_no_run_is_named_by_its_number(name: str) -> None:
    """The first loads what draws: 4 s."""
    for given, begin in (
        ([RUN, None], "runs[1]: expected a Run, found None"),
        ("kp4.mcap", "runs: expected a Run, found 'kp4.mcap'; read_run reads a file"),
        (3, "runs: expected a Run, found 3"),
    ):
        with pytest.raises(tl.TurtlelogError) as caught:
            NO_RUNS[name](given)
        assert str(caught.value).startswith(begin)


_STAY: Final = (
    lambda time_ns, pose, goal: (0.0, 0.1),
    lambda time_ns, pose, goal: [0.0, 0.1],
    lambda time_ns, pose, goal: np.array([0.0, 0.1]),
)


def test_numbers_and_runs_may_come_from_other_libraries(tmp_path: Path) -> None:
    """Draws, sweeps and simulates a little of each: 3 s."""
    gains = pd.Series({KEY: 3.0, "law.kp_angular": 2.0})
    expected = tl.simulate_run("paper", changes={KEY: 3.0, "law.kp_angular": 2.0})
    given = {KEY: np.int64(3), "law.kp_angular": np.float32(2.0)}
    assert TL.simulate_run("paper", changes=gains).equals(expected)
    assert TL.simulate_run("paper", changes=given).equals(expected)
    stay = [TL.simulate_run("textbook", law=law, changes={"max_duration_s": 1.0}) for law in _STAY]
    assert [run.poses.heading_rad[-1].round(2) for run in stay] == [0.1, 0.1, 0.1]
    for values in (pd.Series([1.0, 2.0]), pd.Index([1, 2]), range(1, 3), (kp for kp in (1, 2))):
        table = TL.sweep_scenario("paper", {KEY: values}, metrics="run.duration")
        assert len(table) == 2
    [file] = TL.write_figures(iter(RUNS), tmp_path / "figures", only=["heading"], formats=["svg"])
    assert file.read_text("utf-8").startswith("<?xml")
    TL.write_comparison_rrd(iter(RUNS), tmp_path / "both.rrd")
    assert (tmp_path / "both.rrd").stat().st_size > 1000
    assert len(TL.tabulate_runs(tl.summarise_run(run) for run in RUNS).rows) == 2
