import math

import pytest

from turtlelog.laws import SequentialPParameters
from turtlelog.laws.posture import PostureParameters
from turtlelog.plants.turtlesim import SPAWN_XY_M
from turtlelog.scenario import (
    PAPER_RUNS,
    PRESETS,
    flatten_scenario,
    get_preset,
    iterate_paper_runs,
    load_scenario,
)


def test_presets_are_the_paper_as_built_the_textbook_and_other_laws() -> None:
    plant = ("plant-impulse", "plant-step", "plant-ramp")
    assert (
        *PAPER_RUNS,
        "paper",
        "textbook",
        "posture",
        "track-square",
        "lagged",
        *plant,
    ) == PRESETS


@pytest.mark.parametrize("name", PRESETS)
def test_preset_is_loaded_by_its_name(name: str) -> None:
    assert load_scenario(name) == get_preset(name)
    assert get_preset(name).name == name


@pytest.mark.parametrize(
    ("name", "kp", "start_backlog", "pause_ticks"),
    [
        ("paper-kp1", 1.0, 6, 34),
        ("paper-kp2", 2.0, 5, 34),
        ("paper-kp4", 4.0, 6, 34),
        ("paper-kp10", 10.0, 5, 33),
        ("paper", 1.0, 5, 33),
    ],
)
def test_paper_presets_hold_what_was_identified(
    name: str, kp: float, start_backlog: int, pause_ticks: int
) -> None:
    preset = get_preset(name)
    assert preset.law.parameters == SequentialPParameters(
        kp_angular=kp,
        kp_linear=kp,
        projection="bearing",
        wrap_error=False,
        pause_ticks=pause_ticks,
    )
    assert (preset.loop.start_backlog, preset.loop.queue_policy) == (start_backlog, "one-per-tick")


def test_textbook_keeps_limits_sampling_and_precision_alone() -> None:
    textbook = get_preset("textbook")
    assert textbook.law.parameters == SequentialPParameters(
        projection="heading", wrap_error=True, pause_ticks=0
    )
    assert (textbook.loop.start_backlog, textbook.loop.queue_policy) == (1, "newest")
    assert (textbook.limits.speed_m_s, textbook.limits.turn_rate_rad_s) == (1.0, 1.0)
    assert (textbook.loop.period_ticks, textbook.loop.pose_precision) == (1, "float32")


@pytest.mark.parametrize("name", [name for name in PRESETS if name != "track-square"])
def test_presets_drive_from_the_spawn_pose_to_the_goal_of_the_paper(name: str) -> None:
    preset = get_preset(name)
    assert (preset.start.x_m, preset.start.y_m) == (SPAWN_XY_M, SPAWN_XY_M)
    heading_rad = math.pi / 2.0 if name == "posture" else None
    assert (preset.goal.x_m, preset.goal.y_m, preset.goal.heading_rad) == (2.0, 10.0, heading_rad)


def test_square_is_tracked_by_time_from_its_first_corner() -> None:
    preset = get_preset("track-square")
    assert preset.path is not None
    assert preset.path.points == ((3.0, 3.0), (8.0, 3.0), (8.0, 8.0), (3.0, 8.0))
    assert (preset.start.x_m, preset.start.y_m, preset.start.heading_rad) == (3.0, 3.0, 0.0)
    assert (preset.law.kind, preset.path.speed_m_s) == ("pure-pursuit", 0.5)


def test_posture_drives_in_the_loop_of_the_textbook() -> None:
    posture, textbook = get_preset("posture"), get_preset("textbook")
    assert posture.law.parameters == PostureParameters()
    assert (posture.loop, posture.limits) == (textbook.loop, textbook.limits)


@pytest.mark.parametrize("signal", ["impulse", "step", "ramp"])
def test_plant_presets_excite_the_turn_rate_without_limits(signal: str) -> None:
    preset = get_preset(f"plant-{signal}")
    law = preset.law.parameters
    assert (law.signal, law.axis, law.amplitude, law.start_s) == (signal, "turn_rate", 1.0, 0.0)
    assert (preset.limits.speed_m_s, preset.limits.turn_rate_rad_s) == (math.inf, math.inf)
    assert preset.loop == get_preset("textbook").loop


def test_paper_runs_come_by_rising_gain() -> None:
    gains = [scenario.law.parameters.kp_linear for scenario in iterate_paper_runs()]
    assert gains == [1.0, 2.0, 4.0, 10.0]


def test_flat_scenario_leaves_out_what_is_none() -> None:
    values = flatten_scenario(get_preset("textbook"))
    assert "goal.heading_rad" not in values
    assert (values["law.kind"], values["law.kp_linear"]) == ("sequential-p", 1.0)


def test_robot_differs_from_the_textbook_in_its_plant_alone() -> None:
    robot, textbook = get_preset("lagged"), get_preset("textbook")
    plant = robot.plant
    assert (plant.kind, plant.period_s) == ("lagged", 0.05)
    assert (plant.speed_lag_s, plant.turn_lag_s) == (0.1, 0.1)
    assert (plant.speed_dead_time_s, plant.turn_dead_time_s) == (0.08, 0.08)
    assert (robot.law, robot.loop, robot.limits) == (textbook.law, textbook.loop, textbook.limits)
