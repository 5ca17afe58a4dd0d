import math
import re
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, strategies as st

from turtlelog.plants.turtlesim import WORLD_SIZE_M
from turtlelog.scenario import (
    PRESETS,
    Scenario,
    build_scenario,
    format_scenario,
    get_preset,
    load_scenario,
    nest_scenario,
    override_scenario,
    parse_scenario,
    read_scenario,
)

PAPER_KP10 = """
name = "paper-kp10"
max_duration_s = 60.0
seed = 0

[start]                      # float32 spawn pose by default
x_m = 5.544444561004639
y_m = 5.544444561004639
heading_rad = 0.0

[goal]
x_m = 2.0
y_m = 10.0                   # heading_rad is optional

[law]
kind = "sequential-p"        # the rest of the table belongs to the law
kp_angular = 10.0
kp_linear = 10.0
heading_tolerance_rad = 0.001
position_tolerance_m = 0.001
projection = "bearing"       # "heading": as equation 16 says
wrap_error = false
pause_ticks = 33             # 0: no blocking pause

[limits]
speed_m_s = 1.0              # inf: no saturation
turn_rate_rad_s = 1.0

[loop]
period_ticks = 1             # the controller answers every n-th pose
start_backlog = 5            # 1: none
pose_queue = 10
command_queue = 7
queue_policy = "one-per-tick"  # "newest": the newest command wins, the rest is dropped
transport_delay_ticks = 0
pose_precision = "float32"   # "float64"
"""


def test_whole_file_is_the_preset_of_the_recorded_run() -> None:
    assert parse_scenario(PAPER_KP10) == get_preset("paper-kp10")


def test_file_is_read_as_its_text(tmp_path: Path) -> None:
    path = tmp_path / "run.toml"
    path.write_text(PAPER_KP10, encoding="utf-8")
    assert read_scenario(path) == load_scenario(str(path)) == get_preset("paper-kp10")


def test_formatted_preset_holds_every_key_of_the_whole_file() -> None:
    text = re.sub(r" +#.*", "", PAPER_KP10)
    assert format_scenario(get_preset("paper-kp10")).split() == text.split()


@pytest.mark.parametrize("name", PRESETS)
def test_preset_round_trips(name: str) -> None:
    preset = get_preset(name)
    assert parse_scenario(format_scenario(preset)) == preset


def test_infinite_limits_round_trip() -> None:
    limits = {"limits.speed_m_s": math.inf, "limits.turn_rate_rad_s": math.inf}
    scenario = override_scenario(get_preset("paper"), limits)
    assert parse_scenario(format_scenario(scenario)) == scenario
    assert scenario.limits.speed_m_s == scenario.limits.turn_rate_rad_s == math.inf


def test_goal_heading_round_trips() -> None:
    scenario = override_scenario(get_preset("textbook"), {"goal.heading_rad": 1.5})
    assert parse_scenario(format_scenario(scenario)) == scenario


def test_empty_file_is_the_textbook() -> None:
    assert parse_scenario("") == Scenario() == get_preset("textbook")


def test_whole_numbers_serve_as_numbers() -> None:
    scenario = parse_scenario("goal.x_m = 3\nlaw.kp_linear = 4")
    assert (scenario.goal.x_m, scenario.law.parameters.kp_linear) == (3.0, 4.0)


positive = st.floats(0.0, exclude_min=True, allow_infinity=False)
coordinate = st.floats(0.0, WORLD_SIZE_M)
heading = st.floats(-6.2, 6.2)
limit = st.floats(0.0, exclude_min=True)
count = st.integers(1, 1_000_000)
probability = st.floats(0.0, 1.0)
delay = st.floats(0.0, 1.0)
gain = st.floats(-2.0, 2.0)


def choose_table(**keys: st.SearchStrategy[Any]) -> st.SearchStrategy[dict[str, Any]]:
    return st.fixed_dictionaries({}, optional=keys)


scenario_tables = choose_table(
    name=st.text(st.characters(exclude_categories=["Cs"])),
    max_duration_s=st.floats(1e3, 1e6),
    seed=st.integers(0, 2**63 - 1),
    start=choose_table(x_m=coordinate, y_m=coordinate, heading_rad=heading),
    goal=choose_table(x_m=coordinate, y_m=coordinate, heading_rad=heading),
    law=choose_table(
        kind=st.just("sequential-p"),
        kp_angular=positive,
        kp_linear=positive,
        heading_tolerance_rad=positive,
        position_tolerance_m=positive,
        projection=st.sampled_from(["bearing", "heading"]),
        wrap_error=st.booleans(),
        pause_ticks=st.integers(0, 1000),
        timeout_s=st.sampled_from([45.0, math.inf]),
        settled_for_s=st.sampled_from([2.0, math.inf]),
        standstill_samples=st.integers(101, 200),
    ),
    limits=choose_table(speed_m_s=limit, turn_rate_rad_s=limit),
    loop=choose_table(
        period_ticks=count,
        start_backlog=count,
        pose_queue=count,
        command_queue=count,
        queue_policy=st.sampled_from(["one-per-tick", "newest"]),
        transport_delay_ticks=st.integers(0, 1000),
        pose_precision=st.sampled_from(["float32", "float64"]),
        transport_delay_s=delay,
        jitter_s=delay,
        loss_probability=probability,
        repeat_probability=probability,
    ),
    plant=choose_table(
        kind=st.just("lagged"),
        period_s=st.floats(0.001, 0.05),
        speed_gain=st.floats(-2.0, 2.0),
        turn_lag_s=delay,
    ).filter(lambda table: not table or "kind" in table),
    disturbance=choose_table(speed_m_s=gain, from_s=delay, to_s=st.floats(1.5), noise_speed=delay),
    sensing=choose_table(
        noise_position_m=st.floats(0.0, 1.0),
        bias_heading_rad=gain,
        dropout_probability=probability,
        delay_s=delay,
    ),
    shaping=choose_table(low_pass_s=delay),
)


@given(scenario_tables)
def test_every_scenario_round_trips(tables: dict[str, Any]) -> None:
    scenario = build_scenario(tables)
    assert parse_scenario(format_scenario(scenario)) == scenario
    assert build_scenario(nest_scenario(scenario)) == scenario


@given(scenario_tables)
def test_scenario_keeps_every_value_it_was_given(tables: dict[str, Any]) -> None:
    scenario = build_scenario(tables)
    nested, usual = nest_scenario(scenario), Scenario()
    for key, value in tables.items():
        if not isinstance(value, dict):
            assert nested[key] == value
            continue
        left_out = value.keys() - nested.get(key, {}).keys()
        assert all(value[name] == getattr(getattr(usual, key), name) for name in left_out)
        kept = {name: entry for name, entry in value.items() if name not in left_out}
        assert kept.items() <= nested.get(key, {}).items()


def test_a_stop_rule_stands_in_a_file_where_it_is_not_the_usual_one() -> None:
    usual = build_scenario({"law": {"timeout_s": 30.0, "settled_for_s": 5.0}})
    assert (
        not {"timeout_s", "settled_for_s", "standstill_below"} & nest_scenario(usual)["law"].keys()
    )
    changed = build_scenario({"law": {"timeout_s": 45.0}})
    assert "timeout_s = 45.0\n" in format_scenario(changed)
    assert parse_scenario(format_scenario(changed)).law.parameters.timeout_s == 45.0


def test_a_short_list_of_points_stands_in_one_line() -> None:
    text = format_scenario(get_preset("track-square"))
    assert "\npoints = [[3.0, 3.0], [8.0, 3.0], [8.0, 8.0], [3.0, 8.0]]\n" in text
