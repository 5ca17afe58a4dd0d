import pytest

from tests.scenario.lines import match_whole
from turtlelog.errors import ScenarioError
from turtlelog.scenario import parse_scenario

KEYS = "kp_angular, kp_linear, heading_tolerance_rad, position_tolerance_m,"


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("gaol = 1", "gaol: unknown key; did you mean goal?"),
        ("goal.z_m = 1", "goal.z_m: unknown key; did you mean y_m or x_m?"),
        (
            "[loop]\nperiod = 1",
            "loop.period: unknown key; did you mean period_s?",
        ),
        ("law.kp_lin = 1", "law.kp_lin: unknown key; did you mean kp_linear?"),
        (
            "law.q = 1",
            f"law.q: unknown key; there are {KEYS} projection, wrap_error, pause_ticks, timeout_s,"
            " settled_within_m, settled_for_s, standstill_samples, standstill_below,"
            " reorient or schedule",
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
        ("goal.x_m = 'far'", "goal.x_m: expected a number, found 'far'"),
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
    with pytest.raises(
        ScenarioError, match=r"\Arun\.toml: [^\n]*(expected [^\n]*found|not TOML):? [^\n]*\Z"
    ):
        parse_scenario(f"{key} = {'9' * digits}", source="run.toml")


def test_number_of_many_hexadecimal_digits_is_refused_in_one_line() -> None:
    line = "run.toml: goal.x_m: expected a number, found a number of thousands of digits"
    with pytest.raises(ScenarioError, match=match_whole(line)):
        parse_scenario(f"goal.x_m = 0x{'f' * 50_000}", source="run.toml")


@pytest.mark.parametrize("heading_rad", [1e39, -1e300])
def test_heading_beyond_32_bits_is_refused(heading_rad: float) -> None:
    with pytest.raises(ScenarioError, match=r"\Arun\.toml: start\.heading_rad: expected "):
        parse_scenario(f"start.heading_rad = {heading_rad}", source="run.toml")


def test_unknown_key_with_a_line_break_is_told_in_one_line() -> None:
    with pytest.raises(ScenarioError, match=r"\Arun\.toml: [^\n]*unknown key; [^\n]*\Z"):
        parse_scenario('"a\\nb" = 1', source="run.toml")
