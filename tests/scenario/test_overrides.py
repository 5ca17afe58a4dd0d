import dataclasses
import math
import re
from pathlib import Path
from typing import Any

import pytest

from turtlelog.errors import ScenarioError
from turtlelog.scenario import (
    PRESETS,
    Scenario,
    complete_scenario,
    flatten_scenario,
    get_preset,
    override_scenario,
    parse_assignments,
    resolve_scenario,
    restore_scenario,
)
from turtlelog.simulate import simulate_run


def set_values(*assignments: str, preset: str = "paper-kp10") -> Scenario:
    return override_scenario(get_preset(preset), parse_assignments(assignments))


def match_whole(text: str) -> str:
    return rf"\A{re.escape(text)}\Z"


@pytest.mark.parametrize(
    ("assignment", "values"),
    [
        ("law.kp_linear=4", {"law.kp_linear": 4}),
        ("limits.speed_m_s=inf", {"limits.speed_m_s": math.inf}),
        ("loop.queue_policy=newest", {"loop.queue_policy": "newest"}),
        ("loop.queue_policy='newest'", {"loop.queue_policy": "newest"}),
        ("law.wrap_error=true", {"law.wrap_error": True}),
        ("law.kind=laws/mine.py:Law", {"law.kind": "laws/mine.py:Law"}),
        (" law.kp_linear = 4.5 ", {"law.kp_linear": 4.5}),
        ("law.kp_linear=.5", {"law.kp_linear": 0.5}),
        ("law.kp_linear=-5.", {"law.kp_linear": -5.0}),
        ("law.kp_linear=5.e-1", {"law.kp_linear": 0.5}),
        ("name=.", {"name": "."}),
        ("name=1.2.3", {"name": "1.2.3"}),
        ("name=a=b", {"name": "a=b"}),
        ("goal={x_m=1.0}", {"goal": {"x_m": 1.0}}),
    ],
)
def test_assignment_is_a_key_and_a_value(assignment: str, values: dict[str, Any]) -> None:
    assert parse_assignments([assignment]) == values


@pytest.mark.parametrize("assignment", ["seed", "=3", "  =1", "seed=", "seed= ", "", "="])
def test_assignment_without_key_or_value_is_refused(assignment: str) -> None:
    line = f"changes: expected key=value, found {assignment!r}"
    with pytest.raises(ScenarioError, match=match_whole(line)):
        parse_assignments([assignment])


def test_last_assignment_of_a_key_wins() -> None:
    assert parse_assignments(["seed=1", "seed=2"]) == {"seed": 2}


@pytest.mark.parametrize("name", PRESETS)
def test_setting_nothing_changes_nothing(name: str) -> None:
    assert override_scenario(get_preset(name), {}) == get_preset(name)


@pytest.mark.parametrize(
    ("assignment", "key", "value"),
    [
        ("law.kp_linear=4", "law.kp_linear", 4.0),
        ("loop.queue_policy=newest", "loop.queue_policy", "newest"),
        ("limits.speed_m_s=inf", "limits.speed_m_s", math.inf),
        ("goal.heading_rad=1.5", "goal.heading_rad", 1.5),
        ("name=mine", "name", "mine"),
    ],
)
def test_setting_a_key_changes_that_key_alone(assignment: str, key: str, value: object) -> None:
    before, after = flatten_scenario(get_preset("paper-kp10")), set_values(assignment)
    assert flatten_scenario(after) == before | {key: value}


def test_setting_leaves_the_scenario_it_came_from() -> None:
    scenario = get_preset("paper-kp10")
    override_scenario(scenario, {"law.kp_linear": 4.0, "loop.start_backlog": 1})
    assert scenario == get_preset("paper-kp10")


def test_setting_both_gains_of_the_tenth_run_gives_the_paper_preset() -> None:
    assert set_values("law.kp_linear=1", "law.kp_angular=1", "name=paper") == get_preset("paper")


def test_same_kind_keeps_the_parameters_of_the_law() -> None:
    assert set_values("law.kind=sequential-p") == get_preset("paper-kp10")


def test_another_kind_drops_the_parameters_of_the_law() -> None:
    scenario = set_values("law.kind=turtlelog.laws:SequentialP", "law.kp_linear=3")
    assert flatten_scenario(scenario)["law.kp_linear"] == 3
    parameters = resolve_scenario(scenario).law.parameters
    assert (parameters.kp_linear, parameters.kp_angular, parameters.pause_ticks) == (3.0, 1.0, 0)


@pytest.mark.parametrize(
    ("assignment", "line"),
    [
        ("goal=3", "goal: expected a table, found 3"),
        ("law=3", "law: expected a table, found 3"),
        ("law.kind=4", "law.kind: expected text, found 4"),
        ("law.kp_linear=fast", "law.kp_linear: expected a number > 0, found 'fast'"),
        ("law.kp_lin=4", "law.kp_lin: unknown key; did you mean kp_linear?"),
        ("gaol.x_m=1", "gaol: unknown key; did you mean goal?"),
        ("goal.x_m=nan", "goal.x_m: expected a finite number, found nan"),
        ("goal.x_m.y=1", "goal.x_m: expected a value, found a key below it"),
        (
            "law.kind=nosuch",
            'law.kind: no law "nosuch"; list: turtlelog list laws. A law of your own is'
            " path.py:Class or package.module:Class",
        ),
    ],
)
def test_wrong_assignment_is_named(assignment: str, line: str) -> None:
    with pytest.raises(ScenarioError, match=match_whole(f"changes: {line}")):
        set_values(assignment)


@pytest.mark.parametrize("assignment", ["law.=4", ".x_m=1", "law..kp_linear=4"])
def test_key_with_an_empty_part_is_refused(assignment: str) -> None:
    with pytest.raises(
        ScenarioError, match=match_whole(f"changes: expected key=value, found '{assignment}'")
    ):
        set_values(assignment)


def test_errors_name_the_source_they_are_given() -> None:
    with pytest.raises(ScenarioError, match=r"\Asweep\.toml: seed: expected a whole number >= 0"):
        override_scenario(get_preset("paper"), {"seed": -1}, source="sweep.toml")


def test_a_run_gives_its_scenario_back() -> None:
    scenario = override_scenario(get_preset("paper-kp4"), {"limits.speed_m_s": math.inf})
    assert restore_scenario(simulate_run(scenario)) == scenario


def test_a_run_without_its_whole_scenario_gives_none() -> None:
    run = dataclasses.replace(simulate_run(get_preset("textbook")), scenario_is_complete=False)
    with pytest.raises(ScenarioError, match="textbook: expected a run with its whole scenario"):
        restore_scenario(run)


def test_a_run_is_completed_with_what_it_does_not_know() -> None:
    known = {"law.kp_linear": 3.0, "limits.speed_m_s": 0.5, "goal.x_m": 4.0}
    run = dataclasses.replace(
        simulate_run(get_preset("textbook")),
        parameters=known,
        scenario_is_complete=False,
        goal_xy_m=None,
    )
    values = flatten_scenario(complete_scenario(run, get_preset("paper-kp10")))
    expected = flatten_scenario(get_preset("paper-kp10")) | known
    assert values == expected


def test_the_goal_of_a_run_completes_where_no_parameter_tells_it() -> None:
    run = dataclasses.replace(
        simulate_run(get_preset("textbook")), parameters={}, goal_xy_m=(3.0, 4.0)
    )
    goal = complete_scenario(run, get_preset("paper")).goal
    assert (goal.x_m, goal.y_m) == (3.0, 4.0)


def test_what_a_law_does_not_have_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / "law.py"
    path.write_text(
        "import dataclasses\n"
        "@dataclasses.dataclass(frozen=True)\n"
        "class Own:\n    kp_angular: float = 1.0\n"
        "class Law:\n    Parameters = Own\n    reset = step = lambda *_: None\n"
    )
    base = override_scenario(get_preset("textbook"), {"law.kind": f"{path}:Law"})
    run = dataclasses.replace(
        simulate_run(get_preset("textbook")),
        parameters={"law.kp_angular": 3.0, "law.kp_linear": 4.0},
    )
    found = flatten_scenario(complete_scenario(run, base))
    law = {key: value for key, value in found.items() if key.startswith("law.")}
    assert law == {"law.kind": f"{path}:Law", "law.kp_angular": 3.0}


def test_a_wrong_value_of_a_run_is_named() -> None:
    run = dataclasses.replace(
        simulate_run(get_preset("textbook")), parameters={"law.kp_linear": -1.0}
    )
    with pytest.raises(ScenarioError, match=r"textbook: law\.kp_linear: expected a number > 0"):
        complete_scenario(run, get_preset("paper"))


@pytest.mark.parametrize(
    ("key", "line"),
    [
        (
            "speed_m_s",
            "changes: speed_m_s: unknown key; did you mean limits.speed_m_s or path.speed_m_s?",
        ),
        ("kp_lin", "changes: kp_lin: unknown key; did you mean law.kp_linear?"),
        ("nosuch.key", "changes: nosuch: unknown key; there are "),
    ],
)
def test_key_without_its_table_is_answered_with_the_whole_key(key: str, line: str) -> None:
    with pytest.raises(ScenarioError, match=re.escape(line)):
        override_scenario(get_preset("textbook"), {key: 2})
