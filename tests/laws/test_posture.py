import math
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import turtlelog as tl
from turtlelog.errors import LawError, ScenarioError
from turtlelog.laws import Decision, Goal, Pose
from turtlelog.laws.posture import PART as POSTURE, PostureParameters
from turtlelog.run.angles import wrap_angle

PUBLISHED = {"law.gamma": 3.0, "law.k": 6.0, "law.h": 1.0}
FREE = {
    "limits.speed_m_s": math.inf,
    "limits.turn_rate_rad_s": math.inf,
    "loop.pose_precision": "float64",
}
POSES = 200


def change(**values: Any) -> tl.Scenario:
    return tl.override_scenario(tl.load_scenario("posture"), values)


def answer(pose: Pose, goal: Goal, **gains: float) -> Decision:
    return answer_later(pose, pose, goal, **gains)


def answer_later(start: Pose, pose: Pose, goal: Goal, **gains: float) -> Decision:
    law = POSTURE(PostureParameters(**gains))
    law.reset(start, goal, None)
    return law.step(0, pose)


def draw_scenarios(values: dict[str, Any]) -> list[tl.Scenario]:
    """Return scenarios of random starts and goals, 3 m and more from every wall."""
    rng = np.random.default_rng(1995)
    scenarios = []
    for _ in range(POSES):
        x_m, y_m, to_x_m, to_y_m = rng.uniform(3.0, 8.0, 4).tolist()
        heading_rad, to_heading_rad = rng.uniform(-math.pi, math.pi, 2).tolist()
        drawn = {
            "start.x_m": x_m,
            "start.y_m": y_m,
            "start.heading_rad": heading_rad,
            "goal.x_m": to_x_m,
            "goal.y_m": to_y_m,
            "goal.heading_rad": to_heading_rad,
        }
        scenarios.append(change(**drawn, **values))
    return scenarios


@cache
def drive_everywhere(*values: tuple[str, Any]) -> list[tl.Run]:
    return [tl.simulate_run(scenario) for scenario in draw_scenarios(dict(values))]


def list_misses(run: tl.Run) -> tuple[float, float]:
    """Return the larger error coordinate of the last sample [m], and its heading error [rad]."""
    assert run.goal_xy_m is not None
    assert run.goal_heading_rad is not None
    pose = run.samples.pose_sequence[-1]
    apart_rad = run.goal_heading_rad - run.poses.heading_rad[pose]
    return (
        float(np.abs(run.poses.xy_m[pose] - run.goal_xy_m).max()),
        abs(math.remainder(float(apart_rad), 2.0 * math.pi)),
    )


def read_lyapunov(run: tl.Run) -> NDArray[np.float64]:
    assert run.samples.states is not None
    return run.samples.states[:, 0]


def list_changes(run: tl.Run) -> NDArray[np.float64]:
    """Return how the Lyapunov function changes from sample to sample on the way to the goal."""
    drives = run.samples.phase == run.phase_names.index("drive")
    return np.diff(read_lyapunov(run)[drives])


@pytest.mark.thorough
@pytest.mark.everyday("no-limits")
@pytest.mark.parametrize("limits", [{}, FREE], ids=["limits", "no-limits"])
def test_law_reaches_every_pose_within_its_tolerances(limits: dict[str, Any]) -> None:
    """Two hundred runs are simulated."""
    runs = drive_everywhere(*limits.items())
    assert [run.stop_reason for run in runs] == ["within_tolerance"] * POSES
    misses = np.array([list_misses(run) for run in runs])
    assert (misses.max(axis=0) <= 0.001).all()


@pytest.mark.thorough
def test_walls_are_not_in_the_way() -> None:
    """Two hundred runs are simulated."""
    xy_m = np.concatenate([run.poses.xy_m for run in drive_everywhere()])
    assert xy_m.min() > 2.0
    assert xy_m.max() < 9.0


@pytest.mark.thorough
def test_the_final_heading_error_is_relative_to_the_heading_that_the_goal_asks_for() -> None:
    # A goal to the left, within reach of one sample: the bearing to it says nothing at the end.
    run = tl.simulate_run(change(**{"goal.x_m": 5.4, "goal.y_m": 5.5444, "goal.heading_rad": 0.0}))
    metrics = tl.measure_run(run, only=["final.*"])
    error_deg = metrics["final.goal_heading_error"].value
    assert error_deg is not None
    assert error_deg < 0.1
    assert metrics["final.heading_error"].value == pytest.approx(error_deg)


def test_published_gains_reach_every_pose_as_well() -> None:
    runs = drive_everywhere(*PUBLISHED.items())
    assert [run.stop_reason for run in runs] == ["within_tolerance"] * POSES


@pytest.mark.thorough
@pytest.mark.parametrize("gains", [{}, PUBLISHED], ids=["ours", "published"])
def test_lyapunov_function_falls_at_every_sample_without_limits(gains: dict[str, Any]) -> None:
    """Two hundred runs are simulated."""
    runs = drive_everywhere(*{**FREE, **gains}.items())
    assert max(list_changes(run).max() for run in runs) < 0.0


def test_lyapunov_function_falls_where_an_angle_is_wrapped() -> None:
    """Two hundred runs are simulated."""
    # It holds the squares of the angles, so it does not jump with them; the command does.
    wrapped = 0
    for run in drive_everywhere(*FREE.items()):
        assert run.samples.bearing_rad is not None
        drives = run.samples.phase == run.phase_names.index("drive")
        phi = wrap_angle(run.samples.bearing_rad[drives] - (run.goal_heading_rad or 0.0))
        jumps = np.abs(np.diff(phi)) > math.pi
        wrapped += int(jumps.sum())
        assert (list_changes(run)[jumps] < 0.0).all()
    assert wrapped >= 3


@pytest.mark.thorough
def test_limits_let_the_lyapunov_function_rise() -> None:
    runs = drive_everywhere(*{"loop.pose_precision": "float64"}.items())
    rises = [list_changes(run).max() for run in runs]
    assert sum(rise > 1e-3 for rise in rises) > POSES // 4


def test_lyapunov_function_is_that_of_the_paper() -> None:
    decision = answer(Pose(1.0, 1.0, 0.5), Goal(4.0, 5.0, 2.0), h=3.0)
    alpha, phi = math.atan2(4.0, 3.0) - 0.5, math.atan2(4.0, 3.0) - 2.0
    assert decision.states == pytest.approx(((25.0 + alpha**2 + 3.0 * phi**2) / 2.0,))


def test_command_is_that_of_the_paper() -> None:
    decision = answer(Pose(1.0, 1.0, 0.5), Goal(4.0, 5.0, 2.0), gamma=3.0, k=6.0, h=1.0)
    alpha, phi = math.atan2(4.0, 3.0) - 0.5, math.atan2(4.0, 3.0) - 2.0
    swing = 3.0 * math.cos(alpha) * math.sin(alpha) / alpha
    assert decision.speed_m_s == pytest.approx(3.0 * math.cos(alpha) * 5.0)
    assert decision.turn_rate_rad_s == pytest.approx(6.0 * alpha + swing * (alpha + phi))


def test_speed_is_negative_where_the_goal_is_behind() -> None:
    assert answer(Pose(5.0, 5.0, 0.0), Goal(2.0, 5.0, 0.0)).speed_m_s == pytest.approx(-3.0)


def test_distance_decays_as_theory_says_on_a_straight_way() -> None:
    # alpha = phi = 0: rho' = -gamma rho, sampled and held: a factor of 1 - gamma T each sample.
    line = {"start.y_m": 5.0, "goal.x_m": 8.0, "goal.y_m": 5.0, "goal.heading_rad": 0.0}
    run = tl.simulate_run(change(**FREE, **line))
    distance = run.samples.distance_m
    assert distance is not None
    wanted = distance[0] * (1.0 - 0.016) ** np.arange(len(distance))
    assert distance == pytest.approx(wanted, rel=1e-9)
    # Of exp(-gamma t) that is t gamma^2 T / 2 behind: 0.8 % a second.
    time_s = (run.samples.time_ns - run.start_ns) / 1e9
    ideal = distance[0] * np.exp(-time_s)
    assert distance / ideal == pytest.approx(np.exp(-0.00808688 * time_s), rel=1e-4)


def test_angles_have_the_double_pole_of_their_linear_equations() -> None:
    # Small angles at gamma 3, h 1, k 6: alpha' = -6 alpha - 3 phi, phi' = 3 alpha, poles -3 and -3,
    # so phi = phi0 (1 + 3 t) exp(-3 t) from alpha = 0.
    run = tl.simulate_run(
        change(
            **FREE,
            **PUBLISHED,
            **{"start.x_m": 2.0, "start.y_m": 5.0, "goal.x_m": 9.0, "goal.y_m": 5.0},
            **{"goal.heading_rad": -0.01},
        )
    )
    time_s = (run.samples.time_ns - run.start_ns) / 1e9
    bearing = run.samples.bearing_rad
    assert bearing is not None
    phi, rows = bearing + 0.01, time_s < 1.5
    wanted = 0.01 * (1.0 + 3.0 * time_s) * np.exp(-3.0 * time_s)
    # Sampling at 16 ms moves the poles by 5 %: within 3 % of the first value.
    assert np.abs(phi - wanted)[rows].max() < 0.0003


def test_sampled_loop_follows_the_continuous_equations_at_a_finer_clock() -> None:
    # The differential equations by a fourth-order rule, gamma 3, h 1, k 6, against the law's own
    # commands at a period of 1 ms.
    goal, state, law = Goal(9.0, 5.0, 1.0), np.array([2.0, 3.0, -1.0]), PUBLISHED
    gains = {key.removeprefix("law."): value for key, value in law.items()}

    def slope(xyh: NDArray[np.float64]) -> NDArray[np.float64]:
        found = answer(Pose(*xyh.tolist()), goal, **gains)
        heading = xyh[2]
        v_m_s = found.speed_m_s
        return np.array(
            [v_m_s * math.cos(heading), v_m_s * math.sin(heading), found.turn_rate_rad_s]
        )

    values = []
    for _ in range(2000):
        values.append(answer(Pose(*state.tolist()), goal, **gains).states[0])
        first = slope(state)
        second = slope(state + 0.0005 * first)
        third = slope(state + 0.0005 * second)
        fourth = slope(state + 0.001 * third)
        state = state + 0.001 / 6.0 * (first + 2.0 * second + 2.0 * third + fourth)
    assert all(after < before for before, after in pairwise(values))
    assert math.dist(state[:2], (9.0, 5.0)) < 0.05


@pytest.mark.parametrize("angle", [0.0, 1e-300, 0.99e-4, 1.01e-4, -0.99e-4, 1e-3, 1.0, -math.pi])
def test_sine_ratio_is_right_on_both_sides_of_its_series(angle: float) -> None:
    # With next to no k the turn rate is cos(alpha) sin(alpha) / alpha (alpha + phi).
    goal = Goal(1.0, 0.0, -0.5)
    found = answer(Pose(0.0, 0.0, -angle), goal, gamma=1.0, k=1e-300, h=1.0).turn_rate_rad_s
    ratio = float(np.sinc(angle / math.pi))
    assert found == pytest.approx(math.cos(angle) * ratio * (angle + 0.5), abs=1.2e-16)


def test_goal_without_heading_is_reached_along_the_line_from_the_start() -> None:
    tables = tl.override_scenario(tl.load_scenario("textbook"), {"law.kind": "posture"})
    run = tl.simulate_run(tables)
    assert run.stop_reason == "within_tolerance"
    line_rad = math.atan2(10.0 - 5.544444561004639, 2.0 - 5.544444561004639)
    assert run.poses.heading_rad[-1] == pytest.approx(line_rad, abs=0.01)


def test_goal_without_heading_ends_at_any_heading() -> None:
    found = answer_later(Pose(2.0, 5.0, 0.0), Pose(5.0, 5.0, 3.0), Goal(5.0, 5.0))
    assert found.stop_reason == "within_tolerance"


def test_robot_at_the_goal_turns_on_the_spot_to_its_heading() -> None:
    decision = answer(Pose(5.0, 5.0, 1.0), Goal(5.0, 5.0, 2.0), gamma=1.0, k=4.0)
    assert decision.speed_m_s == 0.0
    assert decision.turn_rate_rad_s == pytest.approx(4.0 + math.cos(1.0) * math.sin(1.0))
    assert decision.phase == "turn"
    assert decision.stop_reason is None


@pytest.mark.parametrize(
    ("pose", "stop_reason"),
    [
        (Pose(5.00099, 5.0, 2.00099), "within_tolerance"),
        (Pose(5.00099, 4.99901, 2.0), "within_tolerance"),
        (Pose(5.00101, 5.0, 2.0), None),
        (Pose(5.0, 5.0, 2.00101), None),
    ],
    ids=["both-inside", "corner-inside", "position-outside", "heading-outside"],
)
def test_run_ends_within_both_tolerances(pose: Pose, stop_reason: str | None) -> None:
    assert answer(pose, Goal(5.0, 5.0, 2.0)).stop_reason == stop_reason


def test_heading_tolerance_knows_full_turns() -> None:
    goal = Goal(5.0, 5.0, -math.pi + 0.0004)
    assert answer(Pose(5.0, 5.0, math.pi - 0.0004), goal).stop_reason == "within_tolerance"


@pytest.mark.parametrize(("time_ns", "reason"), [(2_000_000_000, None), (2_000_000_001, "timeout")])
def test_run_ends_after_its_timeout(time_ns: int, reason: str | None) -> None:
    law = POSTURE(PostureParameters(timeout_s=2.0))
    law.reset(Pose(1.0, 1.0, 0.0), Goal(9.0, 9.0), None)
    law.step(0, Pose(1.0, 1.0, 0.0))
    assert law.step(time_ns, Pose(1.0, 1.0, 0.0)).stop_reason == reason


def test_law_forgets_its_run() -> None:
    law = POSTURE(PostureParameters(timeout_s=1.0))
    for _ in range(2):
        law.reset(Pose(1.0, 1.0, 0.0), Goal(9.0, 9.0), None)
        assert law.step(5_000_000_000, Pose(1.0, 1.0, 0.0)).stop_reason is None


@pytest.mark.thorough
def test_turn_rate_limit_lets_published_gains_spiral() -> None:
    """Two hundred runs are simulated with each of two sets of gains."""
    # gamma sin(2 alpha) / 2 exceeds the limit of 1 rad/s where gamma > 2: alpha does not fall.
    ways = {
        gamma: [run.samples for run in drive_everywhere(*gains.items())]
        for gamma, gains in {1.0: {}, 3.0: PUBLISHED}.items()
    }
    medians = {
        gamma: np.median([(one.time_ns[-1] - one.time_ns[0]) / 1e9 for one in found])
        for gamma, found in ways.items()
    }
    assert medians[3.0] > 1.4 * medians[1.0]


@pytest.mark.parametrize(
    ("key", "value", "line"),
    [
        ("gamma", 0.0, "expected a number > 0 and up to 1e+06, found 0.0"),
        ("k", -1.0, "expected a number > 0 and up to 1e+06, found -1.0"),
        ("h", 0, "expected a number > 0 and up to 1e+06, found 0"),
        ("gamma", 1.1e6, "expected a number > 0 and up to 1e+06, found 1100000.0"),
        ("k", math.nan, "expected a finite number, found nan"),
        ("h", math.inf, "expected a finite number, found inf"),
        ("position_tolerance_m", 0.0, "expected a number > 0, found 0.0"),
        ("heading_tolerance_rad", -1.0, "expected a number > 0, found -1.0"),
    ],
)
def test_wrong_parameter_is_refused(key: str, value: float, line: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        change(**{f"law.{key}": value})
    assert str(caught.value) == f"changes: law.{key}: {line}"


def test_largest_gains_give_finite_commands() -> None:
    decision = answer(Pose(0.0, 0.0, 0.1), Goal(11.0, 11.0, 3.0), gamma=1e6, k=1e6, h=1e6)
    assert math.isfinite(decision.speed_m_s + decision.turn_rate_rad_s + decision.states[0])


def test_law_without_a_goal_says_so() -> None:
    with pytest.raises(LawError, match=r"\Athe law needs a goal: set goal.x_m and goal.y_m\Z"):
        POSTURE(PostureParameters()).reset(Pose(1.0, 1.0, 0.0), None, None)


def test_scenario_keeps_its_law_in_its_text() -> None:
    scenario = change(**PUBLISHED)
    assert tl.parse_scenario(tl.format_scenario(scenario)) == scenario
