"""Values that contradict each other: refused on one side of the border, taken on the other."""

import pytest

from turtlelog.errors import ScenarioError
from turtlelog.scenario import format_scenario, override_scenario, parse_scenario

LAGGED = "[plant]\nkind = 'lagged'\n"

REFUSED = [
    ("[plant]\nperiod_s = 0.1", "plant.period_s: expected none, for kind is turtlesim, found 0.1"),
    (f"{LAGGED}period_s = 0", "plant.period_s: expected a number from 0.001 to 1, found 0"),
    (f"{LAGGED}turn_lag_s = -1", "plant.turn_lag_s: expected a number from 0 to 1000000, found -1"),
    (f"{LAGGED}[goal]\nx_m = 1e7", "goal.x_m: expected a number from -1000000 to 1000000,"),
    ("[loop]\ntrigger = 'timer'", "loop.period_s: expected a period, for loop.trigger is timer,"),
    ("[loop]\ntrigger = 'timer'\nperiod_s = 0", "loop.period_s: expected a number from 0.001 to 1"),
    (
        "[loop]\ntrigger = 'timer'\nperiod_s = 0.1\nperiod_ticks = 2",
        "loop.period_ticks: expected 1, for loop.trigger is timer, found 2",
    ),
    ("[loop]\nperiod_s = 0.1", "loop.period_s: expected none, for loop.trigger is pose, found 0.1"),
    (
        "[loop]\ntransport_delay_s = 60.1",
        "loop.transport_delay_s: expected no longer than max_duration_s = 60 s, found 60.1 s",
    ),
    (
        "[loop]\ntransport_delay_ticks = 3751",
        "loop.transport_delay_ticks: expected no longer than max_duration_s = 60 s, found 60.016 s",
    ),
    ("[sensing]\ndelay_s = 61", "sensing.delay_s: expected no longer than max_duration_s = 60 s,"),
    (
        f"{LAGGED}turn_dead_time_s = 61",
        "plant.turn_dead_time_s: expected no longer than max_duration_s = 60 s, found 61 s",
    ),
    (
        "[disturbance]\nfrom_s = 2\nto_s = 2",
        "disturbance.to_s: expected a time after from_s = 2, found 2",
    ),
    ("[loop]\nloss_probability = 1.01", "loop.loss_probability: expected a number from 0 to 1,"),
    (
        "[loop]\nlate_probability = 0.1",
        "loop.late_s: expected a time above 0 beside late_probability, found 0",
    ),
    (
        "[sensing]\noutlier_probability = 0.1",
        "sensing.outlier_probability: expected outlier_m or outlier_rad above 0 beside it,",
    ),
    (
        "[shaping]\ndead_zone_speed_m_s = 1.1",
        "shaping.dead_zone_speed_m_s: expected no more than limits.speed_m_s = 1, found 1.1",
    ),
    (
        "[sensing]\nbias_position_m = -1.1e6",
        "sensing.bias_position_m: expected a number from -1000000 to 1000000, found -1100000.0",
    ),
    (
        "[disturbance]\nnoise_speed = 1.1e6",
        "disturbance.noise_speed: expected a number from 0 to 1000000, found 1100000.0",
    ),
    (
        "[disturbance]\nturn_rate_rad_s = -1001",
        "disturbance.turn_rate_rad_s: expected a number from -1000 to 1000, found -1001",
    ),
    (
        f"{LAGGED}turn_gain = 1.1e6",
        "plant.turn_gain: expected a number from -1000000 to 1000000, found 1100000.0",
    ),
    ("[limits]\njerk_m_s3 = 0", "limits.jerk_m_s3: expected a number > 0, found 0"),
    ("[sensing]\nnoise_heading_rad = nan", "sensing.noise_heading_rad: expected a finite number,"),
    (
        "[disturbance]\nspeed_m_s = inf",
        "disturbance.speed_m_s: expected a finite number, found inf",
    ),
]

TAKEN = [
    "[plant]\nkind = 'turtlesim'",
    f"{LAGGED}period_s = 0.001\n[goal]\nx_m = -1e6",
    "[loop]\ntrigger = 'timer'\nperiod_s = 1.0",
    "[loop]\ntransport_delay_s = 60.0",
    "[loop]\ntransport_delay_ticks = 3750",
    "[disturbance]\nfrom_s = 2\nto_s = 2.001",
    "[loop]\nloss_probability = 1\nlate_probability = 1\nlate_s = 0.001",
    "[sensing]\noutlier_probability = 1\noutlier_rad = 0.001",
    "[shaping]\ndead_zone_speed_m_s = 1.0",
    "[disturbance]\nto_s = inf",
    "[disturbance]\nturn_rate_rad_s = -1000\nnoise_speed = 1e6",
    f"{LAGGED}turn_gain = 1e6\n[sensing]\nbias_position_m = -1e6",
]


@pytest.mark.parametrize(("text", "complaint"), REFUSED)
def test_a_contradiction_is_refused_in_one_line_that_names_the_key(
    text: str, complaint: str
) -> None:
    with pytest.raises(ScenarioError) as caught:
        parse_scenario(text)
    assert str(caught.value).startswith(f"scenario: {complaint}")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", TAKEN)
def test_what_lies_just_within_is_taken_and_comes_back(text: str) -> None:
    scenario = parse_scenario(text)
    assert parse_scenario(format_scenario(scenario)) == scenario


def test_another_kind_of_plant_drops_the_keys_of_the_old_one() -> None:
    robot = parse_scenario(f"{LAGGED}turn_lag_s = 0.1")
    assert override_scenario(robot, {"plant.kind": "turtlesim"}) == parse_scenario("")
    assert override_scenario(robot, {"plant.turn_gain": 2}).plant.turn_lag_s == 0.1
