"""A simulated robot beside a recorded one: near it where it is right, told where it is not."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np
import pytest

import turtlelog as tl
from tests.identify.robots import Log, draw_steps, make_run
from tests.log.runs import find_shared
from turtlelog.compare import ErrorBand, RobotComparison
from turtlelog.compare.robot_comparison import Quantity, cut_pieces
from turtlelog.compare.robot_prediction import _find_delay
from turtlelog.replay.plant_replay import sense_driven
from turtlelog.run import CommandColumns, PoseColumns, Run, take_rows
from turtlelog.scenario import Scenario

QUIET = Log(duration_s=40.0, noise_m=0.0, noise_rad=0.0, jitter_s=0.0)
NOISE: Mapping[str, float] = {
    "disturbance.noise_speed": 0.01,
    "disturbance.noise_turn_rate": 0.02,
    "sensing.noise_position_m": 1e-3,
    "sensing.noise_heading_rad": 2e-3,
}


def make_scenario(**changes: float) -> Scenario:
    """Return the scenario of a robot of known truth; names of keys have `__` for the dot."""
    truth = {
        f"plant.{name}_{key}": getattr(axis, key)
        for name, axis in (("speed", QUIET.speed), ("turn", QUIET.turn_rate))
        for key in ("gain", "dead_time_s", "lag_s")
    }
    changed = {name.replace("__", "."): value for name, value in changes.items()}
    values = {"name": "robot", "plant.period_s": 0.05, **truth, **changed}
    return tl.override_scenario(tl.load_scenario("lagged"), values, source="test")


def add_noise(scenario: Scenario, times: float = 1.0) -> Scenario:
    values = {name: times * value for name, value in NOISE.items()}
    return tl.override_scenario(scenario, values, source="test")


def simulate(scenario: Scenario, seed: int, duration_s: float = 30.0) -> Run:
    """Return the run of a robot that the project itself simulates, as odometry at 25 Hz."""
    run = make_run(replace(QUIET, duration_s=duration_s, poses_hz=25.0), seed)
    states = sense_driven(replace(scenario, seed=seed), run.commands, run.poses.time_ns)
    poses = PoseColumns(time_ns=run.poses.time_ns, xy_m=states[:, :2], heading_rad=states[:, 2])
    return replace(run, poses=poses)


@pytest.mark.parametrize(
    ("limits", "left", "fading_s"),
    [
        ({}, 0.5, 0.1 * np.log(2.0)),
        ({"acceleration": 2.0}, 0.5, 0.25),
        ({"acceleration": 2.0}, 0.1, 0.4 + 0.1 * np.log(2.0)),
        ({"acceleration": 20.0}, 0.5, 0.1 * np.log(2.0)),
        ({"acceleration": 2.0, "bound": 0.6}, 0.5, 0.15),
        ({"acceleration": 2.0, "reverse_gain": 1.5}, 0.5, 0.375),
    ],
)
def test_a_rate_fades_as_the_limits_of_the_robot_let_it(
    limits: Mapping[str, float], left: float, fading_s: float
) -> None:
    keys = {f"plant__turn_{name}": value for name, value in limits.items()}
    found = _find_delay(make_scenario(**keys), "turn_rate", 1.0, left)
    assert found == pytest.approx(QUIET.turn_rate.dead_time_s + fading_s)


def list_verdicts(found: RobotComparison) -> list[str]:
    return [band.verdict for band in found.bands]


def find_share(found: list[RobotComparison]) -> float:
    """Return the share of all errors that lie within the band."""
    bands = [band for one in found for band in one.bands]
    inside = [band.within_share * len(band.recorded) for band in bands if band.within_share]
    return sum(inside) / sum(len(band.recorded) for band in bands)


def test_a_robot_without_noise_moves_as_its_scenario_says() -> None:
    found = tl.compare.compare_robot(make_run(QUIET, 2), make_scenario())
    assert [(band.quantity, band.horizon_s, len(band.recorded)) for band in found.bands] == [
        *(("position", 1.0, 40), ("heading", 1.0, 40), ("position", 5.0, 8), ("heading", 5.0, 8))
    ]
    # 32 bits hold the simulated poses, up to 10 m away.
    assert all(band.largest < 2e-6 for band in found.bands)
    assert (found.seeds, list_verdicts(found)) == (0, ["no noise"] * 4)
    assert found.bands[0].within_share is None
    assert "no noise that acts on it" in found.bands[0].text


@pytest.mark.thorough
def test_the_band_holds_95_percent_of_the_errors_of_a_robot_with_the_right_noise() -> None:
    scenario = add_noise(make_scenario())
    found = [tl.compare.compare_robot(simulate(scenario, seed), scenario) for seed in (1, 2)]
    assert 0.92 <= find_share(found) <= 0.98
    assert all(one.seeds == 39 for one in found)
    assert {verdict for one in found for verdict in list_verdicts(one)} == {"as simulated"}
    # Errors of all of them are those of the simulations, in the middle too.
    growth = found[0].growth[0]
    assert growth.simulated is not None
    assert growth.recorded[-1, 1] == pytest.approx(growth.simulated[-1, 1], rel=0.5)


@pytest.mark.thorough
def test_sensed_noise_of_an_independent_simulator_is_held() -> None:
    log = replace(QUIET, noise_m=1e-3, noise_rad=2e-3)
    noise = {"sensing__noise_position_m": 1e-3, "sensing__noise_heading_rad": 2e-3}
    scenario = make_scenario(**noise)
    found = [tl.compare.compare_robot(make_run(log, seed), scenario) for seed in (1, 2)]
    assert 0.92 <= find_share(found) <= 0.98
    assert {verdict for one in found for verdict in list_verdicts(one)} == {"as simulated"}


@pytest.mark.everyday("speed_gain-0.9-position", "turn_dead_time_s-0.2-heading")
@pytest.mark.parametrize(
    ("key", "value", "quantity"),
    [
        ("turn_dead_time_s", 0.2, "heading"),
        ("speed_dead_time_s", 0.2, "position"),
        ("turn_gain", 0.9, "heading"),
        ("speed_gain", 0.9, "position"),
    ],
)
def test_errors_of_a_wrong_robot_leave_the_band(key: str, value: float, quantity: Quantity) -> None:
    right = add_noise(make_scenario(), 0.5)
    wrong = tl.override_scenario(right, {f"plant.{key}": value}, source="test")
    band = tl.compare.compare_robot(simulate(right, 1), wrong).find_band(quantity, 1.0)
    assert band.verdict == "larger"
    assert band.within_share is not None
    assert band.within_share < 0.8
    assert "otherwise than the scenario says, or with more noise" in band.text
    assert band.simulated_median is not None
    assert band.median > 1.5 * band.simulated_median


@pytest.mark.thorough
def test_noise_that_is_too_small_or_too_large_is_told() -> None:
    scenario = make_scenario()
    noisy = tl.compare.compare_robot(simulate(add_noise(scenario, 10.0), 1), add_noise(scenario))
    assert list_verdicts(noisy) == ["larger"] * 4
    calm = tl.compare.compare_robot(simulate(add_noise(scenario), 1), add_noise(scenario, 10.0))
    assert calm.bands[0].verdict == "smaller"
    assert "the scenario has more noise than the robot" in calm.bands[0].text


def test_noise_of_one_axis_leaves_the_other_without_a_band() -> None:
    scenario = make_scenario(disturbance__noise_speed=0.01)
    found = tl.compare.compare_robot(simulate(scenario, 1, 20.0), scenario)
    assert list_verdicts(found) == ["as simulated", "no noise"] * 2


@pytest.mark.thorough
def test_a_prediction_is_the_same_each_time() -> None:
    scenario = add_noise(make_scenario())
    run = simulate(scenario, 3, 15.0)
    one, other = (tl.compare.compare_robot(run, scenario) for _ in range(2))
    for mine, others in zip(one.bands, other.bands, strict=True):
        assert np.array_equal(mine.recorded, others.recorded)
        assert mine.high is not None
        assert others.high is not None
        assert np.array_equal(mine.high, others.high)


def test_predicted_pieces_begin_at_recorded_poses_and_end_off_by_the_errors() -> None:
    run = make_run(QUIET, 2)
    found = tl.compare.compare_robot(run, make_scenario(plant__turn_gain=0.8))
    band = found.find_band("position", 5.0)
    for piece, begin, end, error in zip(
        found.predict_pieces(), found.begins, found.ends, band.recorded, strict=True
    ):
        assert piece[0] == pytest.approx(run.poses.xy_m[begin])
        assert np.hypot(*(piece[-1] - run.poses.xy_m[end])) == pytest.approx(error)
    assert band.largest > 0.1
    with pytest.raises(KeyError, match="position after 2 s"):
        found.find_band("position", 2.0)


def test_where_a_robot_stands_and_of_what_clock_it_is_does_not_matter() -> None:
    run, scenario = make_run(QUIET, 2), make_scenario(plant__turn_gain=0.8)
    turn_rad, later_ns = 2.0, 1_700_000_000_000_000_000
    cosine, sine = np.cos(turn_rad), np.sin(turn_rad)
    moved = PoseColumns(
        time_ns=run.poses.time_ns + later_ns,
        xy_m=run.poses.xy_m @ np.array([[cosine, sine], [-sine, cosine]]) + [5e6, -7.0],
        heading_rad=np.mod(run.poses.heading_rad + turn_rad + np.pi, 2.0 * np.pi) - np.pi,
    )
    commands = replace(run.commands, time_ns=run.commands.time_ns + later_ns)
    found = tl.compare.compare_robot(replace(run, poses=moved, commands=commands), scenario)
    for mine, others in zip(
        found.bands, tl.compare.compare_robot(run, scenario).bands, strict=True
    ):
        assert mine.recorded == pytest.approx(others.recorded, abs=1e-6)
        assert mine.time_s == pytest.approx(others.time_s)


def test_a_bag_that_begins_while_the_robot_moves_is_predicted_once_its_rates_are_known() -> None:
    run = make_run(QUIET, 2).slice(start_s=11.0)
    assert np.hypot(*(run.poses.xy_m[15] - run.poses.xy_m[0])) > 0.05
    found = tl.compare.compare_robot(run, make_scenario())
    # Dead time and seven lags of 0.1 s each.
    assert "Predictions begin at 0.8" in found.notes[0]
    assert found.bands[0].time_s[0] == pytest.approx(1.8, abs=0.1)
    # A thousandth of a rate of 1.5 rad/s is left for a lag.
    assert all(band.largest < 1e-3 for band in found.bands)


def test_gaps_of_the_poses_are_not_predicted_over() -> None:
    run = make_run(QUIET, 2)
    time_s = run.poses.time_ns / 1e9
    kept = (time_s < 10.3) | (time_s > 14.0)
    poses = PoseColumns(
        time_ns=run.poses.time_ns[kept],
        xy_m=run.poses.xy_m[kept],
        heading_rad=run.poses.heading_rad[kept],
    )
    found = tl.compare.compare_robot(replace(run, poses=poses), make_scenario())
    assert "After 1 s: 1 gap of the poses, over which nothing is predicted." in found.notes
    times_s = found.bands[0].time_s
    assert not ((times_s > 10.5) & (times_s < 14.9)).any()
    assert all(band.largest < 2e-6 for band in found.bands)


def test_jumps_are_named_and_their_pieces_do_not_count() -> None:
    log = replace(QUIET, jumps=2)
    found = tl.compare.compare_robot(make_run(log, 2), make_scenario())
    assert "After 1 s: 2 outliers, as the poses jump meanwhile; not counted." in found.notes
    assert sum(note.startswith("Jump: the pose at") for note in found.notes) == 2
    assert all(band.largest < 2e-6 for band in found.bands)


def test_lost_commands_show_as_errors_where_they_acted() -> None:
    run = make_run(QUIET, 2)
    time_s = run.commands.time_ns / 1e9
    kept = (time_s < 20.0) | (time_s > 22.0)
    commands = CommandColumns(
        time_ns=run.commands.time_ns[kept],
        speed_m_s=run.commands.speed_m_s[kept],
        lateral_speed_m_s=run.commands.lateral_speed_m_s[kept],
        turn_rate_rad_s=run.commands.turn_rate_rad_s[kept],
    )
    band = tl.compare.compare_robot(replace(run, commands=commands), make_scenario()).bands[0]
    assert 20.0 < band.largest_at_s < 24.5
    assert band.largest > 0.01
    assert band.recorded[band.time_s < 20.0].max() < 2e-6


def compare_silent(later_ns: int) -> RobotComparison:
    """Compare a robot that nobody tells to stop, as it does by itself in a silence of 10 s."""
    log = replace(QUIET, duration_s=30.0)
    time_s, value = draw_steps(np.random.default_rng(1), log, 0.5)
    forward = np.where(time_s < 9.5, np.abs(value) + 0.2, 0.3)
    is_sent = (time_s <= 10.0) | (time_s >= 20.0)
    stop_s, before = 10.5, int((time_s <= 10.0).sum())
    does_s = np.insert(time_s[is_sent], before, stop_s)
    does = np.insert(forward[is_sent], before, 0.0)
    run = make_run(log, 1, (does_s, does), (does_s, np.zeros(len(does_s))))
    told = does_s != stop_s
    commands = CommandColumns(
        time_ns=run.commands.time_ns[told] + later_ns,
        speed_m_s=run.commands.speed_m_s[told],
        lateral_speed_m_s=run.commands.lateral_speed_m_s[told],
        turn_rate_rad_s=run.commands.turn_rate_rad_s[told],
    )
    poses = replace(run.poses, time_ns=run.poses.time_ns + later_ns)
    return tl.compare.compare_robot(replace(run, commands=commands, poses=poses), make_scenario())


def test_a_robot_that_stops_by_itself_is_stopped() -> None:
    found = compare_silent(0)
    assert "The speed stops by itself where no command comes, 1 time; the simulated" in " ".join(
        found.notes
    )
    # Held for 9.5 s more, 0.3 m/s would lead 2.9 m too far; half the rate is found within 50 ms.
    assert all(band.largest < 0.03 for band in found.bands)


def test_sensed_poses_of_a_recording_are_what_is_compared() -> None:
    scenario = add_noise(make_scenario(max_duration_s=20.0, seed=7))
    run = tl.simulate_run(scenario)
    assert run.poses.sensed_xy_m is not None
    found = tl.compare.compare_robot(run, scenario)
    assert np.array_equal(found.recorded.xy_m, run.poses.sensed_xy_m)
    assert set(list_verdicts(found)) == {"as simulated"}


@pytest.mark.thorough
def test_a_long_run_is_compared_for_ten_minutes() -> None:
    run = make_run(replace(QUIET, duration_s=20.0), 2)
    slow = replace(run, poses=replace(run.poses, time_ns=run.poses.time_ns * 40))
    found = tl.compare.compare_robot(slow, make_scenario(), [20.0])
    assert found.notes[0] == "The first 600 s of 799 s are compared."
    assert found.bands[0].time_s[-1] <= 600.0
    fine = tl.compare.compare_robot(run, make_scenario(plant__period_s=0.001))
    assert fine.notes == ()
    slow = replace(run, poses=replace(run.poses, time_ns=run.poses.time_ns * 2))
    fine = tl.compare.compare_robot(slow, make_scenario(plant__period_s=0.001))
    assert fine.notes[0] == "The first 30 s of 40 s are compared."


@pytest.mark.thorough
def test_half_of_a_real_drive_predicts_the_other_half() -> None:
    run = tl.read_run(find_shared("robots", "tb3"))
    half_s = (run.end_ns - run.start_ns) / 2e9
    second = run.slice(start_s=half_s)
    scenario = tl.identify.build_robot_scenario(tl.identify_robot(second), second).scenario
    found = tl.compare.compare_robot(run.slice(end_s=half_s), scenario)
    assert found.find_band("position", 1.0).median < 3e-3
    assert found.find_band("position", 5.0).median < 15e-3


def test_what_cannot_be_compared_is_refused_in_one_line() -> None:
    run, scenario = make_run(replace(QUIET, duration_s=4.0), 2), make_scenario()
    none = CommandColumns(
        time_ns=run.commands.time_ns[:0],
        speed_m_s=run.commands.speed_m_s[:0],
        lateral_speed_m_s=run.commands.lateral_speed_m_s[:0],
        turn_rate_rad_s=run.commands.turn_rate_rad_s[:0],
    )
    late = replace(run.commands, time_ns=run.commands.time_ns + 10_000_000_000)
    rows = {name: take_rows(getattr(run, name), slice(0)) for name in ("poses", "samples")}
    alone = replace(run, **rows, absent=("poses", "samples", "stop_reason"))
    for refused, robot, horizons_s, message in (
        (run, tl.load_scenario("textbook"), [1.0], 'with plant.kind = "lagged", found turtlesim'),
        (replace(run, commands=none), scenario, [1.0], "robot: no commands to drive"),
        (alone, scenario, [1.0], "robot: the recording holds no poses"),
        (replace(run, commands=late), scenario, [1.0], "s after the last pose on"),
        (run, scenario, [30.0], "robot: expected at least 30 s of poses to predict"),
        (run, scenario, [], "horizons_s: expected times above 0 s, found"),
        (run, scenario, [float("nan")], "horizons_s: expected times above 0 s, found"),
    ):
        with pytest.raises(tl.errors.CompareError, match=message):
            tl.compare.compare_robot(refused, robot, horizons_s)


@pytest.mark.parametrize(("above", "verdict"), [(6, "as simulated"), (7, "larger")])
def test_so_many_errors_beyond_the_band_are_no_chance(above: int, verdict: str) -> None:
    # Of 30 errors 7 or more are outside with a probability of 0.0006, 6 or more of 0.003.
    recorded = np.where(np.arange(30) < above, 2.0, 0.5)
    band = ErrorBand(
        quantity="position",
        horizon_s=1.0,
        time_s=np.arange(30.0),
        recorded=recorded,
        simulated=np.full(30, 0.5),
        low=np.full(30, 0.5),
        high=np.full(30, 1.0),
    )
    assert (band.above, band.below, band.verdict) == (above, 0, verdict)
    below = replace(band, recorded=np.where(recorded > 1.0, 0.4, 0.5))
    assert (below.above, below.below) == (0, above)
    assert below.verdict == ("smaller" if verdict == "larger" else verdict)


NO_JUMPS: Final = np.empty(0, np.int64)


@pytest.mark.parametrize(("late_s", "pieces"), [(0.09, 2), (0.11, 1)])
def test_a_pose_ends_a_piece_within_a_tenth_of_the_horizon(late_s: float, pieces: int) -> None:
    around_s = 0.01 * np.arange(5)
    time_s = np.concatenate([around_s - 0.04, around_s + 1.0 + late_s, around_s + 2.04 + late_s])
    time_ns = np.rint((time_s + 0.04) * 1e9).astype(np.int64)
    cut, gaps, _ = cut_pieces(time_ns, int(time_ns[4]), NO_JUMPS, 1.0)
    assert (cut.shape[1], gaps) == (pieces, 2 - pieces)


@pytest.mark.parametrize(("step_s", "pieces"), [(0.4, 8), (0.48, 10), (0.7, 0)])
def test_of_sparse_poses_the_nearest_ends_a_piece_within_a_quarter(
    step_s: float, pieces: int
) -> None:
    time_ns = np.rint(np.arange(0.0, 9.9, step_s) * 1e9).astype(np.int64)
    assert cut_pieces(time_ns, 0, NO_JUMPS, 1.0)[0].shape[1] == pieces


@pytest.mark.parametrize(("further_m", "jumps"), [(0.9, 0), (1.1, 1)])
def test_a_jump_is_further_than_twice_what_the_largest_command_leads_to(
    further_m: float, jumps: int
) -> None:
    run = make_run(QUIET, 2)
    row = int(np.searchsorted(run.poses.time_ns, 10_000_000_000))
    step_s = float(np.median(np.diff(run.poses.time_ns))) / 1e9
    far_m = 2.0 * further_m * float(np.abs(run.commands.speed_m_s).max()) * step_s
    xy_m = run.poses.xy_m.copy()
    xy_m[row:, 0] += far_m
    found = tl.compare.compare_robot(
        replace(run, poses=replace(run.poses, xy_m=xy_m)), make_scenario()
    )
    assert sum(note.startswith("Jump: the pose at") for note in found.notes) == jumps


@pytest.mark.parametrize(("gain", "simulated"), [(1.0, 0.3), (4.0, 1.0), (1.0, 1.0)])
def test_a_motion_that_lasts_is_no_jump_however_wrong_the_gain_of_the_scenario(
    gain: float, simulated: float
) -> None:
    """The robot turns in a small part of the log."""
    lagged = tl.load_scenario("lagged")
    run = tl.simulate_run(
        tl.override_scenario(lagged, {"plant.turn_gain": gain, "law.kp_angular": 2.0 / gain})
    )
    scenario = tl.override_scenario(lagged, {"plant.turn_gain": simulated})
    found = tl.compare.compare_robot(run, scenario)
    assert not any("Jump:" in note or "outlier" in note for note in found.notes)


@pytest.mark.parametrize(("share", "begins_s"), [(0.015, 0.0), (0.025, 1.3)])
def test_a_robot_stands_before_its_first_command_below_2_percent_of_the_largest(
    share: float, begins_s: float
) -> None:
    run = make_run(QUIET, 2)
    first_s = float(run.commands.time_ns[0]) / 1e9
    creep_m = share * float(np.abs(run.commands.speed_m_s).max())
    xy_m = run.poses.xy_m.copy()
    xy_m[:, 0] += creep_m * np.minimum(run.poses.time_ns / 1e9, first_s)
    found = tl.compare.compare_robot(
        replace(run, poses=replace(run.poses, xy_m=xy_m)), make_scenario()
    )
    assert found.find_band("position", 1.0).time_s[0] - 1.0 == pytest.approx(begins_s, abs=0.05)


def test_the_command_that_ends_a_silence_acts_on_a_clock_since_1970() -> None:
    later_ns = 1_700_000_000_123_456_789
    found = [compare_silent(later_ns), compare_silent(0)]
    for one, other in zip(found[0].bands, found[1].bands, strict=True):
        assert one.recorded == pytest.approx(other.recorded, abs=1e-5)
        assert one.recorded[one.time_s > 21.5].max() < 1e-5


def test_a_run_that_is_too_short_for_a_horizon_says_so() -> None:
    found = tl.compare.compare_robot(make_run(replace(QUIET, duration_s=4.0), 2), make_scenario())
    assert {band.horizon_s for band in found.bands} == {1.0}
    assert found.notes == ("No piece of 5 s is left to predict.",)


def test_a_comparison_shows_its_median_errors() -> None:
    found = tl.compare.compare_robot(make_run(QUIET, 2), make_scenario(plant__turn_gain=0.8))
    assert repr(found).startswith("<RobotComparison of robot with robot: median error ")
    assert "mm after 1 s" in repr(found)
    assert "<table" in found._repr_html_()


@pytest.mark.parametrize(
    ("above", "told"), [(4, "no other level of noise"), (3, "more noise than")]
)
def test_errors_on_both_sides_are_not_called_less_noise(above: int, told: str) -> None:
    recorded = np.array([0.1] * 8 + [5.0] * above + [1.0] * (31 - 8 - above))
    ends = np.full(31, 0.5), np.full(31, 2.0)
    band = tl.compare.ErrorBand(
        quantity="position",
        horizon_s=1.0,
        time_s=np.arange(31.0),
        recorded=recorded,
        simulated=np.ones(31),
        low=ends[0],
        high=ends[1],
    )
    assert band.verdict == "smaller"
    assert told in band.text
