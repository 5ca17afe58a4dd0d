import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import turtlelog as tl
from tests import sequential
from tests.log.runs import find_shared
from tests.simulate.random_scenarios import build_random
from turtlelog.explain.scenario_from_log import find_dead_times
from turtlelog.log import import_log
from turtlelog.measure import DeadTime, DeadTimeChange, Missing, Status, find_dead_time, measure_run
from turtlelog.measure.dead_time import model_run_loops
from turtlelog.plants import Turtle
from turtlelog.plants.turtlesim import TICK_NS
from turtlelog.run import CommandColumns, PoseColumns, Run, SampleColumns
from turtlelog.run.angles import wrap_angle
from turtlelog.scenario import get_preset, override_scenario
from turtlelog.simulate import simulate_run

ROTATE, TRANSLATE = "rotate", "translate"


def simulate(name: str, **changes: Any) -> Run:
    values = {key.replace("__", "."): value for key, value in changes.items()}
    return simulate_run(override_scenario(get_preset(name), values))


def read_ticks(run: Run, phase: str) -> int | Status:
    found = find_dead_time(run, phase)
    return found.status if isinstance(found, Missing) else found.ticks


def require_found(run: Run, phase: str) -> DeadTime:
    found = find_dead_time(run, phase)
    assert isinstance(found, DeadTime), found
    return found


def add_noise(run: Run, size: float, seed: int = 0) -> Run:
    rng = np.random.default_rng(seed)
    poses = run.poses
    noisy = replace(
        poses,
        xy_m=poses.xy_m + rng.normal(0.0, size, poses.xy_m.shape),
        heading_rad=wrap_angle(poses.heading_rad + rng.normal(0.0, size, len(poses))),
    )
    return replace(run, poses=noisy)


@pytest.mark.parametrize(
    ("name", "rotating"), [("paper-kp1", 5), ("paper-kp2", 4), ("paper-kp4", 5), ("paper-kp10", 4)]
)
def test_the_runs_of_the_paper_have_four_or_five_ticks_then_six(name: str, rotating: int) -> None:
    run = simulate(name)
    found = require_found(run, ROTATE), require_found(run, TRANSLATE)
    assert [(phase.ticks, phase.is_exact, phase.changes) for phase in found] == [
        (rotating, True, ()),
        (6, True, ()),
    ]
    assert max(phase.residual for phase in found) < 3e-7
    assert min(phase.margin for phase in found) > 200.0


@pytest.mark.parametrize("file", ["kp1_210.json", "kp4_210.json", "kp4_210_main.csv"])
def test_a_log_of_the_papers_has_five_ticks_then_six(file: str) -> None:
    run = import_log(find_shared("paper", file))
    assert (read_ticks(run, ROTATE), read_ticks(run, TRANSLATE)) == (5, 6)
    assert require_found(run, ROTATE).is_exact


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("file", ["kp1_210.json", "kp4_210.json"])
def test_noise_of_a_millimetre_and_a_milliradian_leaves_the_dead_time(file: str, seed: int) -> None:
    run = add_noise(import_log(find_shared("paper", file)), 1e-3, seed)
    for phase, ticks in ((ROTATE, 5), (TRANSLATE, 6)):
        found = require_found(run, phase)
        assert (found.ticks, found.is_exact) == (ticks, False)
        assert found.residual == pytest.approx(1e-3, rel=0.15)
        assert found.margin > 4.0


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"loop__queue_policy": "newest"}, (0, 0)),
        ({"loop__transport_delay_ticks": 5}, (10, 11)),
        ({"loop__start_backlog": 9}, (6, 6)),
        ({"loop__start_backlog": 12, "loop__command_queue": 30}, (9, 10)),
        ({"law__pause_ticks": 0}, (5, 5)),
        ({"loop__pose_precision": "float64"}, (5, 6)),
        ({"loop__period_ticks": 3, "loop__transport_delay_ticks": 7}, (7, 7)),
    ],
    ids=str,
)
def test_the_queues_settings_show(changes: dict[str, Any], expected: tuple[int, int]) -> None:
    run = simulate("paper-kp4", **changes)
    assert (read_ticks(run, ROTATE), read_ticks(run, TRANSLATE)) == expected


def test_the_textbook_has_none() -> None:
    run = simulate("textbook")
    assert (read_ticks(run, ROTATE), read_ticks(run, TRANSLATE)) == (0, 0)


def test_commands_at_their_limit_throughout_tell_nothing() -> None:
    found = find_dead_time(simulate("paper-kp4", limits__speed_m_s=0.01), TRANSLATE)
    assert isinstance(found, Missing)
    assert found.status is Status.UNDETERMINED
    assert found.reason == "the commands hardly change: dead times of 0 to 33 ticks fit alike"


def test_a_turtle_that_already_faces_the_goal_does_not_rotate() -> None:
    assert read_ticks(simulate("textbook", goal__x_m=9.0, goal__y_m=5.545), ROTATE) is (
        Status.TOO_SHORT
    )


def test_a_run_without_the_phase_says_so() -> None:
    run = simulate("paper-kp1", max_duration_s=2.0)
    assert read_ticks(run, TRANSLATE) is Status.NO_PHASE


def test_noise_that_hides_the_dead_time_is_said() -> None:
    found = find_dead_time(add_noise(simulate("paper-kp1"), 0.1), ROTATE)
    assert isinstance(found, Missing)
    assert found.status is Status.UNDETERMINED


def test_a_robot_that_does_not_obey_is_not_explained() -> None:
    run = simulate("paper-kp4")
    backward = replace(run.samples, speed_m_s=-run.samples.speed_m_s)
    found = find_dead_time(replace(run, samples=backward), TRANSLATE)
    assert isinstance(found, Missing)
    assert "no dead time up to 40 ticks explains the motion" in found.reason


@pytest.mark.parametrize(
    ("share", "reason"), [(0.049, "dead times of "), (0.051, "no dead time up to")]
)
def test_a_dead_time_may_leave_a_twentieth_of_the_way_unexplained(
    share: float, reason: str
) -> None:
    """The robot goes ahead and falls back twice; the first tenth of its way does not count."""
    run = drive(lambda tick: 4)
    ahead = np.sin(np.linspace(0.0, 4.0 * np.pi, len(run.poses)))
    way_m = np.hypot(*(run.poses.xy_m - run.poses.xy_m[0]).T)
    ahead *= share * way_m[-1] / float(ahead[way_m >= 0.1 * way_m[-1]].std())
    xy_m = run.poses.xy_m + np.outer(ahead, [np.cos(0.7), np.sin(0.7)])
    found = find_dead_time(replace(run, poses=replace(run.poses, xy_m=xy_m)), TRANSLATE)
    assert isinstance(found, Missing)
    assert found.reason.startswith(reason)


def test_a_change_of_the_dead_time_is_placed() -> None:
    found = require_found(drive(lambda tick: 3 if tick < 200 else 8), TRANSLATE)
    change = DeadTimeChange(time_ns=found.changes[0].time_ns, before=3, after=8)
    assert (found.ticks, found.is_exact, found.changes) == (8, True, (change,))
    assert 192 <= change.time_ns / TICK_NS <= 208


@pytest.mark.parametrize(("steps", "expected"), [(12, 8), (11, Status.UNDETERMINED)])
def test_a_dead_time_is_another_one_from_twelve_steps_on(
    steps: int, expected: int | Status
) -> None:
    run = drive(lambda tick: 3 if tick < 400 - steps else 8)
    assert read_ticks(run, TRANSLATE) == expected


def test_a_gap_in_the_recording_costs_only_its_own_steps() -> None:
    run = drive(lambda tick: 4)
    keep = np.r_[0:150, 163 : len(run.poses)]
    poses = PoseColumns(
        time_ns=run.poses.time_ns[keep].copy(),
        xy_m=run.poses.xy_m[keep].copy(),
        heading_rad=run.poses.heading_rad[keep].copy(),
    )
    samples = SampleColumns(
        **{
            name: getattr(run.samples, name)[keep].copy()
            for name in run.samples.__dataclass_fields__
            if getattr(run.samples, name) is not None
        }
        | {"pose_sequence": np.arange(len(keep))}
    )
    found = require_found(replace(run, poses=poses, samples=samples), TRANSLATE)
    assert (found.ticks, found.is_exact) == (4, True)
    assert found.rows < require_found(run, TRANSLATE).rows - 12


def drive(dead_time: Any) -> Run:
    """Return a run whose speed swings and whose commands take `dead_time(tick)` ticks."""
    ticks = np.arange(400)
    command = 0.4 + 0.3 * np.sin(ticks / 20.0) + 0.1 * np.cos(ticks / 7.0)
    turtle = Turtle(x_m=1.0, y_m=1.0, heading_rad=0.7)
    rows = []
    for tick in ticks.tolist():
        answered = tick - 1 - dead_time(tick)
        turtle.take_command(float(command[answered]) if answered >= 0 else 0.0, 0.0)
        turtle.step()
        rows.append(turtle.state[:3])
    x, y, heading = np.array(rows, dtype=np.float32).astype(np.float64).T
    time_ns, zeros = ticks * TICK_NS, np.zeros(len(ticks))
    return Run(
        name="swing",
        source="test",
        poses=PoseColumns(time_ns=time_ns, xy_m=np.column_stack([x, y]), heading_rad=heading),
        commands=CommandColumns(
            time_ns=time_ns, speed_m_s=command, lateral_speed_m_s=zeros, turn_rate_rad_s=zeros
        ),
        samples=SampleColumns(
            time_ns=time_ns,
            sequence=ticks,
            pose_sequence=ticks,
            phase=np.full(len(ticks), sequential.TRANSLATE),
            bearing_rad=zeros,
            heading_error_rad=zeros,
            error_xy_m=np.zeros((len(ticks), 2)),
            distance_m=zeros,
            speed_m_s=command,
            turn_rate_rad_s=zeros,
            world_velocity_m_s=np.zeros((len(ticks), 2)),
        ),
        declaration=sequential.DECLARATION,
    )


@pytest.mark.parametrize(("off_rad", "is_exact"), [(1.9e-8, True), (2.2e-8, False)])
def test_a_step_in_double_precision_is_exact_to_2e_8(off_rad: float, is_exact: bool) -> None:  # noqa: FBT001
    run = simulate("paper-kp4", loop__pose_precision="float64")
    heading = run.poses.heading_rad.copy()
    heading[60] += off_rad
    found = find_dead_time(replace(run, poses=replace(run.poses, heading_rad=heading)), ROTATE)
    assert (isinstance(found, DeadTime) and found.is_exact and not found.changes) == is_exact


@pytest.mark.parametrize(("steps", "lost"), [(3.9, 0), (4.1, 6)])
def test_a_silence_of_more_than_four_steps_of_a_log_is_a_gap(steps: float, lost: int) -> None:
    log = import_log(find_shared("paper", "kp4_210.json"))
    time_ns = log.poses.time_ns.copy()
    usual_ns = float(np.median(np.diff(time_ns)))
    time_ns[90:] += int((steps - 1.0) * usual_ns) - (time_ns[90] - time_ns[89] - int(usual_ns))
    found = require_found(replace(log, poses=replace(log.poses, time_ns=time_ns)), ROTATE)
    whole = require_found(log, ROTATE)
    assert whole.rows - found.rows == (1 if lost else 0)


@pytest.mark.parametrize(("seed", "is_found"), [(0, True), (34, False)])
def test_a_dead_time_counts_as_found_from_10_of_log_likelihood(seed: int, is_found: bool) -> None:  # noqa: FBT001
    # With these seeds the best dead time is 10.07 and 9.69 ahead of the second.
    found = find_dead_time(add_noise(simulate("paper-kp1"), 0.025, seed), ROTATE)
    assert isinstance(found, DeadTime) == is_found
    if isinstance(found, DeadTime):
        assert 10.0 < found.rows * np.log(found.margin) < 10.1


@pytest.mark.parametrize(("noise", "is_exact"), [(0.0, True), (1e-2, False)])
def test_steps_whose_commands_are_not_known_explain_nothing(noise: float, is_exact: bool) -> None:  # noqa: FBT001
    # A rotation of 27 samples: of a dead time of 27 and more no command is known.
    run = simulate("textbook", goal__x_m=8.0, goal__y_m=5.3, law__kp_angular=7.865)
    assert 0 < np.count_nonzero(run.samples.phase == sequential.ROTATE) < 40
    found = find_dead_time(add_noise(run, noise, seed=1) if noise else run, ROTATE)
    assert (isinstance(found, DeadTime) and found.is_exact) == is_exact


LAGGED = {"plant__kind": "lagged"}


@pytest.mark.parametrize(
    ("changes", "ticks"),
    [
        ({}, (0, 0)),
        ({"plant__period_s": 0.048, "loop__transport_delay_ticks": 3}, (3, 3)),
        ({"plant__turn_dead_time_s": 0.1, "plant__speed_dead_time_s": 0.15}, (2, 3)),
        ({"plant__turn_gain": 0.8, "plant__speed_gain": 0.7}, (0, 0)),
        ({"loop__transport_delay_s": 0.1}, (2, 2)),
        ({"plant__turn_bound": 0.5, "plant__speed_bound": 0.4}, (0, 0)),
        ({"plant__turn_reverse_gain": 0.5, "goal__x_m": 7.0, "goal__y_m": 4.0}, (0, 0)),
    ],
    ids=["none", "transport", "own", "gain", "seconds", "bound", "reverse"],
)
def test_robot_without_lag_has_the_dead_time_of_its_scenario(
    changes: dict[str, Any], ticks: tuple[int, int]
) -> None:
    run = simulate("textbook", **LAGGED, **changes)
    found = require_found(run, ROTATE), require_found(run, TRANSLATE)
    assert (found[0].ticks, found[1].ticks) == ticks
    assert all(one.is_exact for one in found)


def test_dead_time_of_a_robot_with_a_lag_is_not_guessed() -> None:
    run = simulate("textbook", **LAGGED, plant__turn_lag_s=0.1)
    found = find_dead_time(run, ROTATE)
    assert isinstance(found, Missing)
    assert found.reason == (
        "it cannot be separated from the robot's time constant (plant.turn_lag_s = 0.1)"
    )


def test_commands_within_a_deadband_do_not_hide_the_dead_time() -> None:
    run = simulate("textbook", **LAGGED, plant__turn_deadband=0.02, max_duration_s=8.0)
    assert (np.abs(run.samples.turn_rate_rad_s[-10:]) < 0.02).all()
    found = require_found(run, ROTATE)
    assert (found.ticks, found.is_exact) == (0, True)


def test_dead_time_of_a_robot_with_an_acceleration_limit_is_not_guessed() -> None:
    run = simulate("textbook", **LAGGED, plant__turn_acceleration=2.0)
    found = find_dead_time(run, ROTATE)
    assert isinstance(found, Missing)
    assert found.reason == (
        "it cannot be separated from the limit of the robot's acceleration"
        " (plant.turn_acceleration = 2)"
    )


def test_dead_time_that_is_no_whole_number_of_periods_is_not_rounded() -> None:
    found = find_dead_time(simulate("textbook", **LAGGED, loop__transport_delay_s=0.12), ROTATE)
    assert isinstance(found, Missing)
    assert found.reason == "no whole number of periods up to 40 explains every step"


@pytest.mark.parametrize("kind", ["turtlesim", "lagged"])
def test_known_pushes_do_not_hide_the_dead_time(kind: str) -> None:
    changes = {"disturbance__turn_rate_rad_s": 0.1, "disturbance__speed_m_s": -0.3}
    times = {"disturbance__from_s": 1.01, "disturbance__to_s": 9.99}
    run = simulate("paper-kp1", plant__kind=kind, max_duration_s=14.0, **changes, **times)
    assert read_ticks(run, ROTATE) == 5
    assert require_found(run, TRANSLATE).is_exact


def test_random_pushes_make_a_dead_time_uncertain() -> None:
    # Least squares of the way found 3 ticks here, where there are 6.
    noise = {"disturbance__noise_speed": 0.01, "disturbance__noise_turn_rate": 0.003}
    found = find_dead_time(simulate("paper-kp1", seed=4, **noise), TRANSLATE)
    assert isinstance(found, Missing)
    assert found.reason == "the disturbance is random and adds up along the way"


def test_lag_of_a_robot_that_is_not_known_is_no_dead_time() -> None:
    run = replace(simulate("lagged"), parameters={}, scenario_is_complete=False)
    found = measure_run(run, only=["rotate.dead_time"])["rotate.dead_time"]
    assert (found.value, found.status) == (None, Status.UNDETERMINED)
    shorter = "with a lag a shorter dead time explains the motion better than 4 ticks without a lag"
    assert found.reason == shorter
    noisy = add_noise(simulate("paper-kp1"), 1e-4)
    assert measure_run(noisy, only=["rotate.dead_time"])["rotate.dead_time"].value == 5 * 0.016


def test_lost_commands_are_not_called_noise() -> None:
    changes = {"loop__loss_probability": 0.9, "seed": 2, "law__kp_angular": 6.0}
    found = find_dead_time(simulate("textbook", **changes, max_duration_s=4.0), ROTATE)
    assert isinstance(found, Missing)
    assert found.reason == "dead times of 14 and 15 ticks fit alike"


def test_lost_commands_that_shorten_a_queue_are_not_called_a_lag() -> None:
    changes = {"sensing__noise_position_m": 0.02, "loop__loss_probability": 0.1}
    run = simulate("paper-kp4", **changes)
    found = measure_run(run, only=["translate.dead_time"])["translate.dead_time"]
    assert found.reason == (
        "no single dead time explains the motion (2 ticks come nearest): commands were lost, or"
        " their delay changed"
    )
    # Explanations and theory give the same verdict.
    assert find_dead_times(run)["translate"] == Missing(Status.UNDETERMINED, found.reason)
    assert model_run_loops(run)[1].reason == f"the dead time cannot be measured: {found.reason}"


@pytest.mark.parametrize(
    ("share", "is_found"), [(0.515, True), (0.53, False), (-0.48, True), (-0.49, False)]
)
def test_a_dead_time_leaves_noise_of_a_whiteness_between_a_half_and_one_and_a_half(
    share: float, *, is_found: bool
) -> None:
    """Of each error a share returns in the next: their whiteness is about 1 less the share."""
    run = drive(lambda tick: 4)
    along_m = np.random.default_rng(0).normal(0.0, 1e-3, len(run.poses))
    for row in range(1, len(along_m)):
        along_m[row] += share * along_m[row - 1]
    xy_m = run.poses.xy_m + np.outer(along_m, [np.cos(0.7), np.sin(0.7)])
    found = find_dead_time(replace(run, poses=replace(run.poses, xy_m=xy_m)), TRANSLATE)
    assert isinstance(found, DeadTime) == is_found
    if isinstance(found, DeadTime):
        assert (found.ticks, found.is_exact) == (4, False)
        assert found.whiteness == pytest.approx(0.51 if share > 0.0 else 1.4936, abs=1e-3)


def test_a_delay_between_two_ticks_is_not_rounded_where_the_command_switches() -> None:
    ticks = np.arange(400)
    command = 0.4 + 0.1 * np.sin(ticks / 20.0) + 0.3 * np.where(ticks % 2, 1.0, -1.0)
    late, later = np.r_[np.zeros(4), command[:-4]], np.r_[np.zeros(5), command[:-5]]
    way_m = np.cumsum(0.7 * late + 0.3 * later) * 0.016
    run = drive(lambda tick: 3)
    poses = replace(run.poses, xy_m=1.0 + np.outer(way_m, [np.cos(0.7), np.sin(0.7)]))
    poses = replace(poses, heading_rad=np.full(400, 0.7))
    samples = replace(run.samples, speed_m_s=command)
    run = replace(run, poses=poses, samples=samples, scenario_is_complete=True)
    assert find_dead_time(run, TRANSLATE) == Missing(
        Status.UNDETERMINED,
        "no single dead time explains the motion (3 ticks come nearest): its error alternates",
    )


@pytest.mark.parametrize(("steps", "is_found"), [(0.46, True), (0.6, False)])
def test_rounding_up_to_one_and_a_quarter_steps_may_alternate(
    steps: float, *, is_found: bool
) -> None:
    # Poses that alternate by 0.46 and 0.6 steps, rounded, leave errors within 1.16 and 1.31 steps.
    run = simulate("paper-kp10")
    aside = steps * np.where(np.arange(len(run.poses)) % 2, 0.5, -0.5)
    heading_rad = np.rint(run.poses.heading_rad / 1e-4 + aside) * 1e-4
    run = replace(run, poses=replace(run.poses, heading_rad=heading_rad))
    assert read_ticks(run, ROTATE) == (4 if is_found else Status.UNDETERMINED)


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("paper-kp10", {}),
        ("paper-kp4", {"limits__speed_m_s": 0.01}),  # several fit
        ("paper-kp2", {"disturbance__speed_m_s": 0.05}),
        ("paper-kp1", {"disturbance__noise_speed": 0.01}),  # none is exact
    ],
)
def test_short_way_finds_what_the_long_one_does(name: str, changes: dict[str, Any]) -> None:
    run = simulate(name, **changes)
    for phase in (ROTATE, TRANSLATE):
        found, short = find_dead_time(run, phase), find_dead_time(run, phase, is_short=True)
        if isinstance(found, Missing) or isinstance(short, Missing):
            assert short == found
            continue
        assert (short.ticks, short.is_exact, short.rows) == (
            found.ticks,
            found.is_exact,
            found.rows,
        )
        assert (short.whiteness, short.changes) == (found.whiteness, found.changes)


def test_of_motion_among_gaps_alone_no_dead_time_is_known() -> None:
    run = simulate_run(build_random(1975))  # late commands, and every third pose is answered
    found = find_dead_time(run, "translate")
    assert isinstance(found, Missing)
    assert found.reason == "gaps of the poses come no more than 40 ticks after each other"


FAST = {
    "law.kp_angular": 1.99,
    "plant.period_s": 1.0,
    "plant.turn_dead_time_s": 0.0,
    "limits.turn_rate_rad_s": math.inf,
}


def test_a_robot_that_turns_by_more_than_half_a_turn_between_poses_is_measured() -> None:
    # It turns by 4.46 rad in the first second: 0.1 to 0.9 of the step of 2.24 rad in 0.4 s.
    run = simulate("lagged", **FAST, **{"plant.turn_lag_s": 0.0})
    found = measure_run(run, only=["rotate.rise_time", "rotate.decay_ratio", "rotate.stable"])
    assert found["rotate.rise_time"].value == pytest.approx(0.8 / 1.99, abs=1e-4)
    assert found["rotate.decay_ratio"].value == pytest.approx(0.99**2, abs=1e-4)
    assert found["rotate.stable"].value == 1.0
    assert (require_found(run, "rotate").ticks, require_found(run, "rotate").is_exact) == (0, True)


@pytest.mark.parametrize(
    ("name", "loop", "changes"),
    [
        ("lagged", "rotate", {**FAST, "plant.turn_lag_s": 0.3}),  # the rate changes in a step
        ("posture", "align", {"law.k": 900.0, "limits.turn_rate_rad_s": math.inf}),
    ],
)
def test_full_turns_that_the_log_hides_are_said(
    name: str, loop: str, changes: dict[str, Any]
) -> None:
    metrics = measure_run(simulate(name, **changes), only=[f"{loop}.rise_time"])
    metric = metrics[f"{loop}.rise_time"]
    assert (metric.value, metric.status) == (None, Status.UNDETERMINED)
    assert "hides full turns" in metric.reason


@pytest.mark.parametrize(("factor", "is_told"), [(0.94, True), (0.96, False), (-1.0, True)])
def test_commands_that_contradict_the_declared_gain_leave_the_loop_without_a_model(
    factor: float, *, is_told: bool
) -> None:
    run = tl.simulate_run("paper-kp2")
    wanted = run.samples.wanted_turn_rate_rad_s
    assert wanted is not None
    samples = replace(run.samples, wanted_turn_rate_rad_s=factor * wanted)
    rotate, translate = model_run_loops(replace(run, samples=samples))
    reason = (
        f"its recorded commands are {factor:g} times law.kp_angular times the error (median),"
        " not 1 as the law declares"
    )
    assert (rotate.reason, rotate.gains is None) == ((reason if is_told else ""), is_told)
    assert translate.reason == ""
