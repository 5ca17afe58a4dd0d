import math
import re
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, strategies as st

from turtlelog.errors import ScenarioError
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
from turtlelog.turtlesim import WORLD_SIZE_M

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

LAW_TEXT = """
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Gains:
    gain: float
    bias: float = 0.0


class Steady:
    Parameters = Gains

    def __init__(self, parameters):
        self.parameters = parameters

    def reset(self, start, goal):
        pass

    def step(self, time_ns, pose):
        pass
"""


def match_whole(text: str) -> str:
    return rf"\A{re.escape(text)}\Z"


@pytest.fixture
def law_kind(tmp_path: Path) -> str:
    path = tmp_path / "steady.py"
    path.write_text(LAW_TEXT, encoding="utf-8")
    return f"{path}:Steady"


def test_whole_file_is_the_preset_of_the_recorded_run() -> None:
    assert parse_scenario(PAPER_KP10) == get_preset("paper-kp10")


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


def test_law_of_a_file_round_trips(law_kind: str) -> None:
    values = {"law.kind": law_kind, "law.gain": 2.0}
    scenario = override_scenario(get_preset("textbook"), values)
    assert parse_scenario(format_scenario(scenario)) == scenario


def test_empty_file_is_the_textbook() -> None:
    assert parse_scenario("") == Scenario() == get_preset("textbook")


def test_whole_numbers_serve_as_numbers() -> None:
    scenario = parse_scenario("goal.x_m = 3\nlaw.kp_linear = 4")
    assert (scenario.goal.x_m, scenario.law.parameters.kp_linear) == (3.0, 4.0)


KEYS = "kp_angular, kp_linear, heading_tolerance_rad, position_tolerance_m,"


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("gaol = 1", "gaol: expected goal, found an unknown key"),
        ("goal.z_m = 1", "goal.z_m: expected y_m or x_m, found an unknown key"),
        ("[loop]\nperiod = 1", "loop.period: expected period_ticks, found an unknown key"),
        ("law.kp_lin = 1", "law.kp_lin: expected kp_linear, found an unknown key"),
        (
            "law.q = 1",
            f"law.q: expected {KEYS} projection, wrap_error or pause_ticks, found an unknown key",
        ),
    ],
)
def test_unknown_key_is_named_with_the_nearest(text: str, line: str) -> None:
    with pytest.raises(ScenarioError, match=match_whole(f"run.toml: {line}")):
        parse_scenario(text, source="run.toml")


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("name = 3", "name: expected text, found 3"),
        ("seed = 1.5", "seed: expected a whole number >= 0, found 1.5"),
        ("seed = 1.0", "seed: expected a whole number >= 0, found 1.0"),
        ("seed = true", "seed: expected a whole number >= 0, found true"),
        (
            "max_duration_s = true",
            "max_duration_s: expected a number > 0 and up to 1e+06, found true",
        ),
        (
            "max_duration_s = [1]",
            "max_duration_s: expected a number > 0 and up to 1e+06, found [1]",
        ),
        ("goal.x_m = 'far'", "goal.x_m: expected a number from 0 to 11.08888912, found 'far'"),
        (
            "goal.heading_rad = 'n'",
            "goal.heading_rad: expected a number from -6.283185307 to 6.283185307, found 'n'",
        ),
        ("goal = 3", "goal: expected a table, found 3"),
        ("goal = [1, 2]", "goal: expected a table, found [1, 2]"),
        ("[[limits]]\nspeed_m_s = 1", "limits: expected a table, found [{'speed_m_s': 1}]"),
        ("law = 3", "law: expected a table, found 3"),
        ("law.kind = 3", "law.kind: expected text, found 3"),
        ("law.kp_linear = '4'", "law.kp_linear: expected a number > 0, found '4'"),
        ("law.kp_linear = {a = 1}", "law.kp_linear: expected a number > 0, found {'a': 1}"),
        ("law.wrap_error = 1", "law.wrap_error: expected true or false, found 1"),
        (
            "law.pause_ticks = 33.0",
            "law.pause_ticks: expected a whole number from 0 to 1000000, found 33.0",
        ),
        ("law.projection = 3", "law.projection: expected bearing or heading, found 3"),
        ("loop.pose_precision = 32", "loop.pose_precision: expected float32 or float64, found 32"),
    ],
)
def test_value_of_another_type_is_named(text: str, line: str) -> None:
    with pytest.raises(ScenarioError, match=match_whole(f"run.toml: {line}")):
        parse_scenario(text, source="run.toml")


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("law.projection = 'up'", "law.projection: expected bearing or heading, found 'up'"),
        (
            "loop.queue_policy = 'old'",
            "loop.queue_policy: expected one-per-tick or newest, found 'old'",
        ),
        (
            "loop.pose_precision = 'half'",
            "loop.pose_precision: expected float32 or float64, found 'half'",
        ),
    ],
)
def test_unknown_choice_is_named_with_those_that_are_known(text: str, line: str) -> None:
    with pytest.raises(ScenarioError, match=match_whole(f"run.toml: {line}")):
        parse_scenario(text, source="run.toml")


@pytest.mark.parametrize("value", ["nan", "inf", "-inf"])
@pytest.mark.parametrize(
    "key", ["max_duration_s", "start.heading_rad", "goal.x_m", "goal.heading_rad", "law.kp_angular"]
)
def test_number_that_is_not_finite_is_refused(key: str, value: str) -> None:
    line = f"run.toml: {key}: expected a finite number, found {value}"
    with pytest.raises(ScenarioError, match=match_whole(line)):
        parse_scenario(f"{key} = {value}", source="run.toml")


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("goal.x_m = 11.1", "goal.x_m: expected a number from 0 to 11.08888912, found 11.1"),
        ("goal.y_m = -0.1", "goal.y_m: expected a number from 0 to 11.08888912, found -0.1"),
        ("start.x_m = 12", "start.x_m: expected a number from 0 to 11.08888912, found 12"),
        ("max_duration_s = 0", "max_duration_s: expected a number > 0 and up to 1e+06, found 0"),
        (
            "max_duration_s = 1e7",
            "max_duration_s: expected a number > 0 and up to 1e+06, found 10000000.0",
        ),
        ("seed = -1", "seed: expected a whole number >= 0, found -1"),
        ("law.kp_linear = 0", "law.kp_linear: expected a number > 0, found 0"),
        ("law.kp_angular = -1.0", "law.kp_angular: expected a number > 0, found -1.0"),
        (
            "law.heading_tolerance_rad = 0.0",
            "law.heading_tolerance_rad: expected a number > 0, found 0.0",
        ),
        (
            "law.pause_ticks = -1",
            "law.pause_ticks: expected a whole number from 0 to 1000000, found -1",
        ),
        ("limits.speed_m_s = 0.0", "limits.speed_m_s: expected a number > 0, found 0.0"),
        ("limits.speed_m_s = -inf", "limits.speed_m_s: expected a number > 0, found -inf"),
        ("limits.speed_m_s = nan", "limits.speed_m_s: expected a finite number, found nan"),
        (
            "loop.period_ticks = 0",
            "loop.period_ticks: expected a whole number from 1 to 1000000, found 0",
        ),
        (
            "loop.start_backlog = 0",
            "loop.start_backlog: expected a whole number from 1 to 1000000, found 0",
        ),
        (
            "loop.command_queue = 0",
            "loop.command_queue: expected a whole number from 1 to 1000000, found 0",
        ),
    ],
)
def test_value_out_of_its_range_is_named(text: str, line: str) -> None:
    with pytest.raises(ScenarioError, match=match_whole(f"run.toml: {line}")):
        parse_scenario(text, source="run.toml")


@pytest.mark.parametrize(
    ("key", "digits"), [("limits.speed_m_s", 400), ("loop.command_queue", 20), ("seed", 5000)]
)
def test_number_of_many_digits_is_refused_in_one_line(key: str, digits: int) -> None:
    with pytest.raises(ScenarioError, match=r"\Arun\.toml: [^\n]*expected [^\n]*found:? [^\n]*\Z"):
        parse_scenario(f"{key} = {'9' * digits}", source="run.toml")


@pytest.mark.parametrize("heading_rad", [1e39, -1e300])
def test_heading_beyond_32_bits_is_refused(heading_rad: float) -> None:
    with pytest.raises(ScenarioError, match=r"\Arun\.toml: start\.heading_rad: expected "):
        parse_scenario(f"start.heading_rad = {heading_rad}", source="run.toml")


def test_unknown_key_with_a_line_break_is_told_in_one_line() -> None:
    with pytest.raises(ScenarioError, match=r"\Arun\.toml: [^\n]*found an unknown key\Z"):
        parse_scenario('"a\\nb" = 1', source="run.toml")


def test_unknown_law_is_named() -> None:
    line = "run.toml: law.kind: expected sequential-p, path.py:Class or package.module:Class"
    with pytest.raises(ScenarioError, match=match_whole(f"{line}, found 'pid'")):
        parse_scenario("law.kind = 'pid'", source="run.toml")


def test_law_of_a_missing_file_is_named() -> None:
    line = "run.toml: law.kind: expected a Python file at nowhere.py, found none"
    with pytest.raises(ScenarioError, match=match_whole(line)):
        parse_scenario("law.kind = 'nowhere.py:Law'", source="run.toml")


def test_law_of_a_file_takes_its_own_parameters(law_kind: str) -> None:
    scenario = build_scenario({"law": {"kind": law_kind, "gain": 3}})
    assert (scenario.law.parameters.gain, scenario.law.parameters.bias) == (3.0, 0.0)


@pytest.mark.parametrize(
    ("law", "line"),
    [
        ({"gain": "a"}, "law.gain: expected a number, found 'a'"),
        ({"gain": 1, "gian": 1}, "law.gian: expected gain, found an unknown key"),
        ({"gain": 1, "kp_linear": 1}, "law.kp_linear: expected gain or bias, found an unknown key"),
        ({"gain": math.nan}, "law.gain: expected a finite number, found nan"),
    ],
)
def test_wrong_parameter_of_a_law_of_a_file_is_named(
    law_kind: str, law: dict[str, Any], line: str
) -> None:
    with pytest.raises(ScenarioError, match=match_whole(f"run.toml: {line}")):
        build_scenario({"law": {"kind": law_kind, **law}}, source="run.toml")


def test_missing_parameter_of_a_law_of_a_file_is_named(law_kind: str) -> None:
    with pytest.raises(ScenarioError, match=r"\Arun\.toml: law\.gain: expected .*, found none\Z"):
        build_scenario({"law": {"kind": law_kind}}, source="run.toml")


def test_text_that_is_no_toml_is_told_with_its_place() -> None:
    line = r"\Arun\.toml: expected TOML, found: [^\n]*\(at line 2, column 6\)\Z"
    with pytest.raises(ScenarioError, match=line):
        parse_scenario("seed = 1\nname turtle\n", source="run.toml")


def test_file_is_read_as_its_text(tmp_path: Path) -> None:
    path = tmp_path / "run.toml"
    path.write_text(PAPER_KP10, encoding="utf-8")
    assert read_scenario(path) == load_scenario(str(path)) == get_preset("paper-kp10")


@pytest.mark.parametrize("start", [b"\xef\xbb\xbf", b"\r\n"], ids=["byte-order-mark", "windows"])
def test_file_of_a_windows_editor_is_read(tmp_path: Path, start: bytes) -> None:
    path = tmp_path / "run.toml"
    path.write_bytes(start + b"seed = 3\r\n")
    assert read_scenario(path).seed == 3


def test_empty_file_on_disk_is_the_textbook(tmp_path: Path) -> None:
    path = tmp_path / "empty.toml"
    path.touch()
    assert read_scenario(path) == get_preset("textbook")


def test_wrong_value_in_a_file_is_named_with_the_file(tmp_path: Path) -> None:
    path = tmp_path / "run.toml"
    path.write_text("seed = -1", encoding="utf-8")
    line = f"{path}: seed: expected a whole number >= 0, found -1"
    with pytest.raises(ScenarioError, match=match_whole(line)):
        read_scenario(path)


def test_binary_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.toml"
    path.write_bytes(b"\x89MCAP0\r\n\xff\xfe")
    line = f"{path}: expected TOML, found bytes that are no text"
    with pytest.raises(ScenarioError, match=match_whole(line)):
        read_scenario(path)


def test_missing_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "none.toml"
    line = f"{path}: expected a scenario file, found: No such file or directory"
    with pytest.raises(ScenarioError, match=match_whole(line)):
        read_scenario(path)


def test_folder_is_no_scenario(tmp_path: Path) -> None:
    # The rest of the line is the operating system's.
    line = re.escape(f"{tmp_path}: expected a scenario file")
    with pytest.raises(ScenarioError, match=rf"\A{line}[^\n]+\Z"):
        load_scenario(tmp_path)


def test_name_that_is_neither_preset_nor_file_is_refused() -> None:
    line = f"papre: expected a scenario file (.toml) or one of {', '.join(PRESETS)}"
    with pytest.raises(ScenarioError, match=match_whole(line)):
        load_scenario("papre")


positive = st.floats(0.0, exclude_min=True, allow_infinity=False)
coordinate = st.floats(0.0, WORLD_SIZE_M)
heading = st.floats(-6.2, 6.2)
limit = st.floats(0.0, exclude_min=True)
count = st.integers(1, 1_000_000)


def choose_table(**keys: st.SearchStrategy[Any]) -> st.SearchStrategy[dict[str, Any]]:
    return st.fixed_dictionaries({}, optional=keys)


scenario_tables = choose_table(
    name=st.text(st.characters(exclude_categories=["Cs"])),
    max_duration_s=st.floats(0.0, 1e6, exclude_min=True),
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
    ),
)


@given(scenario_tables)
def test_every_scenario_round_trips(tables: dict[str, Any]) -> None:
    scenario = build_scenario(tables)
    assert parse_scenario(format_scenario(scenario)) == scenario
    assert build_scenario(nest_scenario(scenario)) == scenario


@given(scenario_tables)
def test_scenario_keeps_every_value_it_was_given(tables: dict[str, Any]) -> None:
    nested = nest_scenario(build_scenario(tables))
    for key, value in tables.items():
        expected = nested[key] | value if isinstance(value, dict) else value
        assert nested[key] == expected
