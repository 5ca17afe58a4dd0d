"""A constant rate beside the response to commands: found where there is one, and nowhere else."""

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np
import pytest

import turtlelog as tl
from tests.known import known
from turtlelog.cli.identify import format_robot
from turtlelog.explain.robot_log import draw_model
from turtlelog.identify import AxisModel, Estimate, build_robot_scenario
from turtlelog.identify.axis_fit import AxisFit, fit_axis, refit_axis, solve_part
from turtlelog.identify.axis_motion import AXES, Axis, find_rests, read_axis_motion
from turtlelog.identify.fit_values import cover_parts, describe_fit
from turtlelog.identify.held_response import Structure, hold_commands
from turtlelog.identify.robot_noise import measure_sensing_noise
from turtlelog.identify.structure_choice import (
    is_distinct,
    measure_effect,
    shows_drift,
    shows_friction,
)
from turtlelog.run import Run
from turtlelog.run.angles import wrap_angle

SIZES: Final = (0.5, -0.5, 0.3, -0.3, 0.4, -0.2)
BOTH: Final = ("plain", 0.05, -0.1)
DRIFT: Final = Structure(has_drift=True)
ROBOT: Final[Mapping[str, Any]] = MappingProxyType(
    {
        "plant.speed_gain": 0.9,
        "plant.speed_dead_time_s": 0.12,
        "plant.speed_lag_s": 0.25,
        "plant.turn_gain": 1.1,
        "plant.turn_dead_time_s": 0.07,
        "plant.turn_lag_s": 0.15,
    }
)
OTHERS: Final[Mapping[str, Mapping[str, Any]]] = MappingProxyType(
    {
        "plain": {},
        "reverse gain": {"plant.turn_reverse_gain": 0.9},
        "deadband": {"plant.turn_deadband": 0.5},
        "acceleration": {"plant.turn_acceleration": 2.0},
        "noise of the rate": {"disturbance.noise_turn_rate": 5e-3},
    }
)
LIMITS: Final = MappingProxyType(
    {
        "reverse gain": ["reverse_gain"],
        "deadband": ["deadband"],
        "acceleration": ["rate_limit"],
    }
)


def drive(
    keys: Mapping[str, Any] | None = None,
    *,
    axes: tuple[Axis, ...] = ("turn_rate",),
    rest_s: float = 1.0,
    noise_rad: float = 0.0,
) -> Run:
    """Return the recommended drive of one axis after the other: steps of 2 s, and rests."""
    rows, at_s = [(0.0, 0.0, 0.0)], 3.0
    for axis in axes:
        turns = float(axis == "turn_rate")
        for size in SIZES:
            rows += [(at_s, (1.0 - turns) * size, 2.0 * turns * size), (at_s + 2.0, 0.0, 0.0)]
            at_s += 2.0 + rest_s
    columns = zip(("time_s", "speed_m_s", "turn_rate_rad_s"), zip(*rows, strict=True), strict=True)
    steps = {f"law.{name}": list(values) for name, values in columns}
    law = {"law.kind": "open-loop", "law.signal": "sequence", "plant.period_s": 0.05}
    changes = {**law, **steps, **ROBOT, **(keys or {})}
    run = tl.simulate_run(tl.override_scenario(tl.load_scenario("lagged"), changes))
    noise = np.random.default_rng(1).normal(0.0, noise_rad, len(run.poses))
    return replace(run, poses=replace(run.poses, heading_rad=run.poses.heading_rad + noise))


def push(speed_m_s: float, turn_rate_rad_s: float) -> dict[str, float]:
    return {
        "disturbance.speed_m_s": speed_m_s,
        "disturbance.turn_rate_rad_s": turn_rate_rad_s,
    }


@cache
def identify(kind: str, speed_m_s: float = 0.0, turn_rate_rad_s: float = 0.0) -> tl.RobotModel:
    """Return the model of a robot that is driven if it drifts forward, and otherwise only turns."""
    axes: tuple[Axis, ...] = ("speed", "turn_rate") if speed_m_s else ("turn_rate",)
    keys = {**OTHERS[kind], **push(speed_m_s, turn_rate_rad_s)}
    return tl.identify_robot(drive(keys, axes=axes))


@cache
def fit_both(drift: float, noise_rad: float = 0.0) -> tuple[AxisFit, AxisFit]:
    """Return the fits of a drifting turn rate without and with a drift."""
    run = drive(push(0.0, drift), noise_rad=noise_rad)
    plain = fit_axis([read_axis_motion(run, "turn_rate")])
    return plain, refit_axis(plain, DRIFT, [(0.0,)])


def fit_drift(drift: float, noise_rad: float = 0.0) -> AxisFit:
    return fit_both(drift, noise_rad)[1]


def test_a_drift_of_each_axis_is_identified_beside_its_gain() -> None:
    """Both axes are driven and fitted with limits, of which there are none."""
    for axis, drift, gain in zip(identify(*BOTH).axes, BOTH[1:], (0.9, 1.1), strict=True):
        found = known(axis.drift)
        assert found.value == pytest.approx(drift, abs=1e-6)
        assert found.low - 1e-6 <= drift <= found.high + 1e-6
        assert known(axis.gain).value == pytest.approx(gain, abs=1e-5)
        assert list_limits(axis) == []


@pytest.mark.parametrize("drift", [-0.05, 0.02])
@pytest.mark.parametrize("kind", OTHERS)
def test_a_drift_is_identified_beside_other_parameters(kind: str, drift: float) -> None:
    """A robot with limits is fitted with many structures."""
    axis = identify(kind, 0.0, drift).turn_rate
    found, allowed = known(axis.drift), 5e-3 if "noise" in kind else 1e-6
    assert found.value == pytest.approx(drift, abs=allowed)
    assert found.low - 1e-6 <= drift <= found.high + 1e-6
    assert known(axis.gain).value == pytest.approx(1.1, abs=1e-5 + 2.0 * allowed)
    assert list_limits(axis) == LIMITS.get(kind, [])


@pytest.mark.parametrize("kind", OTHERS)
def test_no_drift_is_found_where_there_is_none(kind: str) -> None:
    """A robot with limits is fitted with many structures."""
    axis = identify(kind).turn_rate
    assert axis.drift is None
    assert list_limits(axis) == LIMITS.get(kind, [])


def list_limits(axis: AxisModel) -> list[str]:
    names = "rate_limit", "bound", "deadband", "reverse_gain", "friction", "lag_product_s2"
    return [name for name in names if getattr(axis, name) is not None]


@pytest.mark.parametrize(("share", "matters"), [(0.0018, False), (0.0022, True)])
def test_a_drift_matters_from_a_five_hundredth_of_the_largest_rate(
    share: float, *, matters: bool
) -> None:
    pair = fit_both(0.002)
    plain, drifting = fit_both(0.002 * share / measure_effect(*pair))
    assert measure_effect(plain, drifting) == pytest.approx(share, rel=0.01)
    assert is_distinct(plain, drifting) is matters


def test_a_robot_that_veers_as_it_drives_does_not_drift() -> None:
    """A heading that grows with the speed looks like a drift to steps without rests."""
    run = drive()
    poses = run.poses
    way_m = np.cumsum(np.hypot(*np.diff(poses.xy_m, axis=0, prepend=poses.xy_m[:1]).T))
    veered = replace(run, poses=replace(poses, heading_rad=poses.heading_rad + 0.05 * way_m))
    assert tl.identify_robot(veered).turn_rate.drift is None


@pytest.mark.parametrize(("share", "shows"), [(0.45, False), (0.55, True)])
def test_the_rests_show_at_least_half_of_a_drift(share: float, *, shows: bool) -> None:
    fit = fit_drift(-0.1)
    assert shows_drift(move_at_rest(fit, share)) is shows


def move_at_rest(fit: AxisFit, share: float) -> AxisFit:
    """Return a fit of a robot that has a share of its drift at rest."""
    rests = find_rests(fit.model.motions, *fit.parameters[1:3].tolist())
    off = (share - 1.0) * fit.parameters[0] * fit.parameters[3] * fit.model.duration_s
    return replace(fit, residual=np.where(rests, off, fit.residual))


@pytest.mark.parametrize(("rested_s", "shows"), [(0.9, True), (1.1, False)])
def test_a_second_of_rest_decides_whether_a_robot_drifts(rested_s: float, *, shows: bool) -> None:
    fit = move_at_rest(fit_drift(0.1), 0.0)
    rests = np.flatnonzero(find_rests(fit.model.motions, *fit.parameters[1:3].tolist()))
    is_outlier = np.zeros(len(fit.residual), dtype=bool)
    is_outlier[rests[round(rested_s / 0.05) :]] = True
    assert shows_drift(replace(fit, is_outlier=is_outlier)) is shows


@pytest.mark.parametrize(("errors", "shows"), [(3.6, False), (4.4, True)])
def test_without_rests_four_standard_deviations_show_a_drift(errors: float, *, shows: bool) -> None:
    fit = fit_drift(0.1, 2e-3)
    rests = find_rests(fit.model.motions, *fit.parameters[1:3].tolist())
    alone = np.concatenate([one.is_alone(fit.parameters[1]) for one in fit.model.motions])
    fit = replace(fit, parameters=fit.parameters.copy(), is_outlier=rests)
    for _ in range(20):  # the drift itself changes its error a little
        moves, covariance = solve_part(fit, alone & ~rests)
        fit.parameters[3] = errors * math.sqrt(covariance[3, 3]) - moves[3]
    assert shows_drift(fit) is shows


def test_a_drift_that_always_acts_against_the_commands_is_no_friction() -> None:
    """Both robots wait while they turn, and stop where the command cancels the drift."""
    keys = {"law.kp_linear": 2.0, "law.kp_angular": 2.0, **push(-0.1, 0.0)}
    run = tl.simulate_run(tl.override_scenario(tl.load_scenario("textbook"), keys))
    speed = tl.identify_robot(run).speed
    assert speed.friction is None
    assert known(speed.drift).value == pytest.approx(-0.1, abs=1e-5)
    assert not speed.doubts


@pytest.mark.parametrize(
    ("waited_s", "share", "shows"),
    [(1.1, 0.55, False), (1.1, 0.45, True), (0.9, 0.55, True), (1.1, -0.55, False)],
)
def test_a_motion_before_the_first_command_excludes_friction(
    waited_s: float, share: float, *, shows: bool
) -> None:
    plain = fit_both(0.0, 1e-3)[0]
    fit = refit_axis(plain, Structure(has_friction=True), [(0.1,)])
    fit.parameters[3] = 0.1
    moved = share * 0.1 * float(fit.parameters[0]) * waited_s
    fit.model.motions = [replace(one, waited=(waited_s, moved)) for one in fit.model.motions]
    assert shows_friction(fit) is shows
    assert shows_friction(plain)


@pytest.mark.parametrize("lever_m", [0.0, 0.05])
def test_a_lever_is_no_drift_where_the_other_axis_never_rests(lever_m: float) -> None:
    """A robot that reports a point beside its axle moves as it turns; a drift always moves it."""
    drift = 0.0 if lever_m else 0.03
    motion = read_axis_motion(drive(push(0.0, drift), noise_rad=1e-4), "turn_rate")
    rates = np.array([0.4, 0.6, 0.5, 0.8, 0.3])
    beside = hold_commands(np.arange(60.0), np.resize(rates, 60))
    way = beside.place(motion.time_s - ROBOT["plant.turn_dead_time_s"]).way
    moved = motion.moved + lever_m * np.diff(way)[motion.first]
    fit = fit_axis([replace(motion, beside=beside, moved=moved)])
    assert shows_drift(refit_axis(fit, DRIFT, [(0.0,)])) is (lever_m == 0.0)


def test_a_rest_begins_three_time_constants_after_the_dead_time() -> None:
    motion = fit_drift(0.1).model.motions[0]
    begins_s = motion.time_s[motion.first[find_rests([motion], 0.07, 0.15)]]
    stops_s = motion.commands.time_s[1:][motion.commands.value[1:] == 0.0]
    since_s = [float(begins_s[begins_s > stop_s].min() - stop_s) for stop_s in stops_s[:-1]]
    assert min(since_s) >= 0.07 + 0.45
    assert max(since_s) <= 0.07 + 0.45 + 0.06


def test_a_drift_that_a_law_holds_is_no_friction_and_a_note_says_that_no_rest_shows_it() -> None:
    """P control stops a drifting robot where the command cancels the drift."""
    keys = {**push(0.0, 0.05), "sensing.noise_heading_rad": 0.002, "max_duration_s": 20.0}
    run = tl.simulate_run(tl.override_scenario(tl.load_scenario("lagged"), keys))
    model = tl.identify_robot(run)
    assert known(model.turn_rate.drift).value == pytest.approx(0.05, abs=1e-4)
    assert model.turn_rate.friction is None
    told = "The robot never rests long enough in this log. The drift of the turn rate"
    assert told in " ".join(model.notes)
    assert not any("never rests" in note for note in identify("plain", 0.0, 0.02).notes)


@pytest.mark.parametrize("drift", [0.0, 0.05])
def test_commands_of_one_size_without_rests_do_not_tell_a_drift_from_a_gain_backwards(
    drift: float,
) -> None:
    other = push(0.0, drift) if drift else {"plant.turn_reverse_gain": 0.9}
    law = {"law.kind": "open-loop", "law.signal": "prbs", "law.axis": "turn_rate"}
    keys = {**law, **other}
    run = tl.simulate_run(tl.override_scenario(tl.load_scenario("lagged"), keys))
    axis = tl.identify_robot(run.slice(1.0)).turn_rate  # the first step shows a rest
    # Rounding decides which of the two is found.
    backwards = 1.0 if drift else 0.9
    pairs = [(axis.gain, 1.0)]
    pairs += [(axis.drift, drift)] if axis.drift else [(axis.reverse_gain, backwards)]
    for found, truth in pairs:
        assert known(found).low - 1e-6 <= truth <= known(found).high + 1e-6
    both = "another gain backwards", "a drift"
    pairs_told = (" or ".join(pair) for pair in (both, both[::-1]))
    told = [f"what acts on the turn rate: {pair}. The intervals cover" for pair in pairs_told]
    assert any(one in axis.doubts[0] for one in told)
    assert axis.doubts[0].endswith("A rest of some seconds between commands would show a drift.")


def test_the_scenario_disturbs_the_robot_by_its_drift_and_names_what_that_costs() -> None:
    run = drive(push(0.0, -0.1), noise_rad=1e-3)
    robot = build_robot_scenario(tl.identify_robot(run), run)
    values = tl.scenario.flatten_scenario(robot.scenario)
    assert values["disturbance.turn_rate_rad_s"] == pytest.approx(-0.1, abs=1e-3)
    said = " ".join(robot.notes)
    assert "Note: The turn rate drifts by -0.1 rad/s at zero command" in said
    assert "holds a goal only to 0.0909 rad/s divided by Kp" in said
    assert tl.scenario.parse_scenario(robot.text) == robot.scenario


def test_p_control_holds_a_goal_to_the_drift_divided_by_gain_and_kp() -> None:
    keys = {**ROBOT, **push(0.0, 0.1), "law.kp_angular": 2.0, "max_duration_s": 10.0}
    run = tl.simulate_run(tl.override_scenario(tl.load_scenario("lagged"), keys))
    (x_m, y_m), last = known(run.goal_xy_m) - run.poses.xy_m[-1], run.poses.heading_rad[-1]
    off_rad = abs(math.remainder(math.atan2(y_m, x_m) - float(last), math.tau))
    assert off_rad == pytest.approx(0.1 / 1.1 / 2.0, rel=0.02)


@pytest.mark.parametrize("drift", [0.0, 0.1])
def test_a_drift_is_not_taken_for_noise_of_poses_nor_hides_it(drift: float) -> None:
    run = drive(push(0.0, drift), rest_s=3.0, noise_rad=2e-3)
    robot = build_robot_scenario(tl.identify_robot(run), run)
    values = tl.scenario.flatten_scenario(robot.scenario)
    assert values["sensing.noise_heading_rad"] == pytest.approx(2e-3, rel=0.3)


def test_the_model_with_its_drift_predicts_the_turns() -> None:
    model = identify(*BOTH)
    run = drive(push(*BOTH[1:]), axes=("speed", "turn_rate"))
    for axis, name in zip(model.axes, AXES, strict=True):
        motion = read_axis_motion(run, name)
        way, _ = tl.identify.predict_axis(axis, run, motion.time_s)
        steps = way[motion.first + 1] - way[motion.first]
        np.testing.assert_allclose(steps, motion.moved, atol=1e-6)


def test_the_answer_tells_the_drift_beside_the_gain() -> None:
    told = " ".join(format_robot(identify(*BOTH), [Path("a")]).split())
    assert "Gains: speed 0.900 with a drift of 0.05 m/s, turn rate 1.100 with a drift of -0.1" in (
        told
    )
    assert "90 % of the commanded speed plus 0.05 m/s and turns at 110 %" in told
    assert "of the commanded rate minus 0.1 rad/s." in told
    assert "Turn rate drifts by -0.1 rad/s (-0.1 to -0.1) at zero command." in told


def test_random_drifts_scatter_to_both_sides_of_0() -> None:
    drift = Estimate(value=-0.01, low=-0.05, high=0.03, unit="rad/s")
    axis = replace(identify("plain").turn_rate, drift=drift)
    drawn = [
        known(draw_model(axis, np.random.default_rng(seed), 1.0).drift).value for seed in range(40)
    ]
    assert np.mean(drawn) == pytest.approx(-0.01, abs=0.01)
    assert np.std(drawn) == pytest.approx(0.04 / 1.96, rel=0.3)
    assert min(drawn) < 0.0 < max(drawn)


def test_neither_dead_time_nor_time_constant_exceeds_their_sum_in_doubt() -> None:
    """A residual that is a curve widens all intervals, those of unseparated delays most."""
    fit = fit_drift(0.1, 1e-3)
    curve = np.sin(np.arange(len(fit.white)) / 20.0)
    axis = cover_parts(describe_fit("turn_rate", fit, 12), replace(fit, white=curve))
    loose: AxisModel = replace(axis, lag_s=replace(known(axis.lag_s), high=9.0))
    loose = cover_parts(loose, replace(fit, white=curve))
    assert known(loose.lag_s).high <= known(loose.total_delay_s).high


@pytest.mark.parametrize(("share", "shows"), [(0.55, True), (0.45, False)])
@pytest.mark.parametrize("rested_s", [1.1, 0.9])
def test_a_rest_before_the_first_command_decides_whether_a_robot_drifts(
    rested_s: float, share: float, *, shows: bool
) -> None:
    fit = fit_drift(0.1)
    rests = find_rests(fit.model.motions, *fit.parameters[1:3].tolist())
    moved = share * float(fit.parameters[0] * fit.parameters[3]) * rested_s
    fit.model.motions = [replace(one, rested=(rested_s, moved)) for one in fit.model.motions]
    assert shows_drift(replace(fit, is_outlier=rests)) is (shows or rested_s < 1.0)


@cache
def drive_without_rests() -> Run:
    """Return a robot that rests for 3 s; then one axis or the other changes every second."""
    rng = np.random.default_rng(0)
    rows, speed, turn = [(0.0, 0.0, 0.0)], 0.0, 0.0
    for second in range(3, 50):
        size = float(rng.choice([-1.0, -0.7, -0.4, 0.4, 0.7, 1.0]))
        speed, turn = (0.5 * size, turn) if second % 2 else (speed, size)
        rows.append((float(second), speed, turn))
    names = "law.time_s", "law.speed_m_s", "law.turn_rate_rad_s"
    steps = {
        name: list(values) for name, values in zip(names, zip(*rows, strict=True), strict=True)
    }
    law = {"law.kind": "open-loop", "law.signal": "sequence", "plant.period_s": 0.05}
    robot = {**ROBOT, "plant.turn_acceleration": 1.5, "plant.turn_lag_s": 0.3}
    changes = {**law, **steps, **robot, **push(0.0, 0.01)}
    run = tl.simulate_run(tl.override_scenario(tl.load_scenario("lagged"), changes))
    noisy = run.poses.heading_rad + rng.normal(0.0, 5e-4, len(run.poses))
    return replace(run, poses=replace(run.poses, heading_rad=wrap_angle(noisy)))


def test_a_drift_beside_a_limit_is_no_other_gain_backwards() -> None:
    """The robot rests only before its first command."""
    model = tl.identify_robot(drive_without_rests())
    axis = model.turn_rate
    assert (axis.reverse_gain, axis.doubts) == (None, ())
    assert known(axis.gain).value == pytest.approx(1.1, abs=2e-3)
    assert known(axis.drift).value == pytest.approx(0.01, abs=1e-3)
    assert known(axis.rate_limit).value == pytest.approx(1.5, abs=0.03)
    assert not any("never rests" in note for note in model.notes)


def test_a_rest_before_the_first_command_shows_the_noise_of_poses() -> None:
    """The first command is 0, and is recorded with the first pose."""
    run = drive_without_rests()
    sensing = known(measure_sensing_noise(tl.identify_robot(run), [run]))
    assert sensing.standing_s == pytest.approx(3.0, abs=0.2)
    assert sensing.heading.size == pytest.approx(5e-4, rel=0.3)
