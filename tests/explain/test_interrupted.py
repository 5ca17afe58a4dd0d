"""What jumps of the pose, cuts and noise leave to be said, and what they take away."""

import math
import re
from dataclasses import replace

import pytest

import turtlelog as tl
from tests.explain.logs import as_log, simulate
from tests.explain.truth import Log, Truth, make_log
from turtlelog.explain import Certainty, attribute_run, identify_run

END = 177
"""Sample that ends the rotation of the default truth."""


def cut_rows(log: Log, rows: int) -> Log:
    return log.drop(range(rows, len(log.rows)))


def jump_at(tick: int, turned_rad: float) -> dict[int, tuple[float, float, float]]:
    x_m, y_m, heading_rad = make_log(Truth()).poses[tick]
    return {tick: (x_m, y_m, heading_rad + turned_rad)}


@pytest.mark.everyday("0", "1")
@pytest.mark.parametrize("seed", range(3))
def test_how_far_the_robot_turned_is_an_interval_where_there_is_noise(seed: int) -> None:
    """Many seeds are tried where the noise is large."""
    log = make_log(Truth(log_noise=1e-2, seed=seed))
    turned = identify_run(log.to_run()).findings["pause.turned_rad"]
    low, high = turned.interval or (0.0, 0.0)
    truth = log.poses[log.read[-1]][2] - log.poses[log.read[END]][2]
    assert turned.certainty is Certainty.FITTED
    assert low < truth < high < low + 0.1


@pytest.mark.thorough
def test_a_turn_that_nobody_commanded_is_not_counted_as_the_robots() -> None:
    found = identify_run(make_log(Truth(teleports=jump_at(450, 0.5))).to_run())
    turned = found.findings["pause.turned_rad"]
    assert turned.value is None
    assert "jumps after the rotation" in turned.evidence


@pytest.mark.parametrize(
    "truth",
    [
        Truth(teleports=jump_at(90, -0.8)),
        Truth(teleports={450: (4.0, 7.0, 2.4)}, noise=1e-4, seed=3),
    ],
    ids=["turned to a wall", "moved towards a wall, with noise"],
)
def test_a_wall_that_only_the_driven_plant_would_meet_does_not_matter(truth: Truth) -> None:
    found = identify_run(make_log(truth).to_run()).findings
    keys = ("loop.start_backlog", "law.pause_ticks", "loop.command_queue", "law.kp_linear")
    assert [found[key].value for key in keys] == [6, 34, 7, 4.0]


@pytest.mark.parametrize("rows", [1, 3, 9])
def test_a_burst_that_is_cut_off_does_not_tell_the_depth_of_the_pose_queue(rows: int) -> None:
    run = cut_rows(make_log(Truth()), END + 1 + rows).to_recording()
    found = identify_run(run).findings["loop.pose_queue"]
    assert (found.value, found.certainty) == (10, Certainty.EXACT)


def test_two_runs_in_one_file_are_named_as_such() -> None:
    log = make_log(Truth())
    later = [(row[0] + 12.0, *row[1:]) for row in log.rows]
    found = identify_run(replace(log, rows=[*log.rows, *later]).to_run())
    assert found.findings["law.kp_linear"].value == 4.0
    assert "the pose jumps by 5.69 m" in found.notes[0]
    assert found.notes[1].endswith(": rotate, translate, done, rotate, translate")


def test_a_jump_is_named_where_the_commands_contradict_the_law() -> None:
    log = as_log(simulate("paper-kp4"))
    xy_m = log.poses.xy_m.copy()
    xy_m[400:, 0] += 0.5
    found = identify_run(replace(log, poses=replace(log.poses, xy_m=xy_m)))
    assert re.match(r"the pose jumps by 0\.4\d+ m", found.notes[0])
    assert "translating: the commands are not proportional" in found.notes[1]


def test_a_command_of_zero_within_a_noisy_rotation_bounds_nothing() -> None:
    log = make_log(Truth(log_noise=1e-2)).to_run()
    turn_rate = log.samples.turn_rate_rad_s.copy()
    turn_rate[END - 1] = 0.0
    found = identify_run(replace(log, samples=replace(log.samples, turn_rate_rad_s=turn_rate)))
    low, high = found.findings["law.heading_tolerance_rad"].interval or (0.0, 0.0)
    assert low == 0.0
    assert 0.0 < high < 0.01


def test_a_log_that_begins_on_the_way_may_miss_commands() -> None:
    log = make_log(Truth())
    found = identify_run(log.drop(range(49)).to_run())
    assert found.notes[-1].endswith("commands that the log does not contain")


def test_one_sample_is_a_run() -> None:
    run = cut_rows(make_log(Truth()), 1).to_run()
    assert attribute_run(run).as_logged == pytest.approx(5.6934, abs=1e-4)


def test_a_goal_at_the_start_is_reached_without_a_warning() -> None:
    run = simulate("paper-kp4", goal__x_m=5.544444561004639, goal__y_m=5.544444561004639)
    found = identify_run(run).findings["law.heading_tolerance_rad"]
    assert found.evidence == "as recorded: the run has no command that turns"


def test_what_would_be_without_a_limit_is_not_known_where_every_command_is_clipped() -> None:
    run = replace(simulate("paper-kp4", max_duration_s=6.3), scenario_is_complete=False)
    found = attribute_run(run)
    saturation = next(share for share in found.others if share.cause == "saturation")
    assert (saturation.alone, saturation.ending) == (None, "the log does not show law.kp_linear")
    shared = attribute_run(run, causes=["saturation"])
    assert "law.kp_linear" in shared.doubts[0]


def test_recorded_settings_count_where_the_samples_do_not_show_them() -> None:
    """The heading error is too small for any command that turns: any gain fits."""
    changes = {"law__kp_angular": 20.0, "law__kp_linear": 20.0, "law__wrap_error": True}
    run = simulate("paper", goal__x_m=10.0, goal__y_m=5.55, **changes)
    found = identify_run(run)
    assert found.resimulation is not None
    assert found.resimulation.is_exact
    assert found.findings["law.kp_angular"].certainty == "as recorded"
    known = attribute_run(run)
    unlimited = tl.override_scenario(
        tl.load_scenario("paper"), {key.replace("__", "."): value for key, value in changes.items()}
    )
    goal = {"goal.x_m": 10.0, "goal.y_m": 5.55}
    free = {"limits.speed_m_s": math.inf, "limits.turn_rate_rad_s": math.inf}
    metric = tl.measure_run(tl.simulate_run(tl.override_scenario(unlimited, goal | free)))
    alone = {share.cause: share.alone for share in (*known.contributions, *known.others)}
    assert alone["saturation"] == pytest.approx(metric["final.position_error"].value)
    assert "wrap" not in alone
