import math
from typing import Any

import numpy as np
import pytest

import turtlelog as tl
from turtlelog.errors import LawError, ScenarioError
from turtlelog.laws import Pose
from turtlelog.laws.kanayama import PART as KANAYAMA, KanayamaParameters
from turtlelog.laws.pure_pursuit import PART as PURE_PURSUIT, PurePursuitParameters
from turtlelog.run.paths import Path
from turtlelog.scenario import build_scenario
from turtlelog.simulate.class_law import build_law

LINE: dict[str, Any] = {"kind": "line", "points": [[1.0, 5.0], [10.0, 5.0]]}
CIRCLE: dict[str, Any] = {"kind": "circle", "center_x_m": 5.5, "center_y_m": 5.5, "size_m": 2.0}
EXACT: dict[str, Any] = {
    "limits": {"speed_m_s": math.inf, "turn_rate_rad_s": math.inf},
    "loop": {"pose_precision": "float64"},
}
TRACKERS = ("kanayama", "pure-pursuit")


def track(
    law: dict[str, Any], path: dict[str, Any], start: tuple[float, float, float], **more: Any
) -> tl.Run:
    x_m, y_m, heading_rad = start
    at = {"x_m": x_m, "y_m": y_m, "heading_rad": heading_rad, "precision": "float64"}
    tables = {**EXACT, "law": law, "path": path, "start": at, **more}
    return tl.simulate_run(build_scenario(tables))


@pytest.mark.parametrize("ky", [4.0, 64.0])
def test_kanayama_closes_a_small_offset_as_the_critically_damped_second_order(ky: float) -> None:
    speed_m_s, offset_m = 0.3, 0.001
    law = {"kind": "kanayama", "ky": ky, "ktheta": 2.0 * math.sqrt(ky)}
    run = track(law, {**LINE, "speed_m_s": speed_m_s}, (1.0, 5.0 + offset_m, 0.0))
    time_s = run.poses.time_ns / 1e9
    rate = math.sqrt(ky) * speed_m_s
    expected_m = offset_m * (1.0 + rate * time_s) * np.exp(-rate * time_s)
    found_m = run.poses.xy_m[:, 1] - 5.0
    # Each command holds for a period and comes one late: the first-order error of the sampling.
    assert np.abs(found_m - expected_m).max() < 1.5 * 0.016 * rate * offset_m


@pytest.mark.parametrize("lookahead_m", [0.2, 0.5])
def test_pure_pursuit_closes_a_small_offset_with_a_damping_of_one_by_root_two(
    lookahead_m: float,
) -> None:
    speed_m_s, offset_m = 0.3, 0.001
    law = {"kind": "pure-pursuit", "lookahead_m": lookahead_m, "speed_m_s": speed_m_s}
    run = track(law, LINE, (1.0, 5.0 + offset_m, 0.0))
    time_s = run.poses.time_ns / 1e9
    # e'' + (2 v / L) e' + (2 v^2 / L^2) e = 0, begun at rest.
    rate = speed_m_s / lookahead_m
    expected_m = offset_m * np.exp(-rate * time_s) * (np.cos(rate * time_s) + np.sin(rate * time_s))
    found_m = run.poses.xy_m[:, 1] - 5.0
    assert np.abs(found_m - expected_m).max() < 1.5 * 0.016 * rate * offset_m
    assert found_m.min() < 0.9 * expected_m.min() < 0.0


@pytest.mark.parametrize("kind", TRACKERS)
@pytest.mark.parametrize("by_time", [False, True], ids=["by arc length", "by time"])
def test_tracker_stays_on_a_circle_at_the_curvature_of_the_circle(
    kind: str, *, by_time: bool
) -> None:
    path = CIRCLE | ({"speed_m_s": 0.5} if by_time else {})
    run = track({"kind": kind}, path, (7.5, 5.5, math.pi / 2.0))
    late = slice(len(run.samples) // 2, -1)
    ratio = run.samples.turn_rate_rad_s[late] / run.samples.speed_m_s[late]
    radius_m = np.hypot(*(run.poses.xy_m - 5.5).T)
    # A command holds while the robot goes 8 mm on: that is 0.4 % of the radius.
    assert ratio == pytest.approx(0.5, rel=0.01)
    assert np.abs(radius_m - 2.0).max() < 0.005
    assert run.stop_reason == "path_end"
    assert run.duration_s == pytest.approx(4.0 * math.pi / 0.5, rel=0.005)


@pytest.mark.parametrize("kind", TRACKERS)
def test_by_time_the_reference_is_the_path_at_its_speed(kind: str) -> None:
    run = track({"kind": kind}, {**LINE, "speed_m_s": 0.25}, (1.0, 5.0, 0.0))
    reference_m = run.samples.reference_xy_m
    assert reference_m is not None
    due_m = 1.0 + 0.25 * (run.samples.time_ns - run.samples.time_ns[0]) / 1e9
    assert reference_m[:, 0] == pytest.approx(np.minimum(due_m, 10.0), abs=1e-12)
    assert run.stop_reason == "path_end"


@pytest.mark.parametrize("kind", TRACKERS)
def test_by_arc_length_the_reference_is_the_nearest_point_and_the_speed_is_the_laws(
    kind: str,
) -> None:
    run = track({"kind": kind, "speed_m_s": 0.4}, LINE, (1.0, 5.3, 0.2))
    samples = run.samples
    assert samples.reference_xy_m is not None
    nearest_m = run.poses.xy_m[samples.pose_sequence, 0]
    assert samples.reference_xy_m[:, 0] == pytest.approx(np.clip(nearest_m, 1.0, 10.0), abs=1e-12)
    assert samples.speed_m_s[-50:-1] == pytest.approx(0.4, rel=0.01)
    assert float(run.poses.xy_m[-1, 0]) == pytest.approx(10.0 - 0.01, abs=0.4 * 0.016)


def test_pure_pursuit_adds_speed_where_it_is_behind() -> None:
    law = PURE_PURSUIT(PurePursuitParameters(kp_along=2.0))
    law.reset(
        Pose(1.0, 5.0, 0.0),
        None,
        Path(kind="line", points=((1.0, 5.0), (10.0, 5.0)), speed_m_s=0.5),
    )
    law.step(0, Pose(1.0, 5.0, 0.0))
    assert law.step(1_000_000_000, Pose(1.2, 5.0, 0.0)).speed_m_s == pytest.approx(0.5 + 2.0 * 0.3)


def test_kanayama_answers_as_its_equation_says() -> None:
    law = KANAYAMA(KanayamaParameters(kx=2.0, ky=3.0, ktheta=4.0))
    path = Path(kind="line", points=((1.0, 5.0), (10.0, 5.0)), speed_m_s=0.5)
    law.reset(Pose(1.0, 5.0, 0.0), None, path)
    law.step(0, Pose(1.0, 5.0, 0.0))
    decision = law.step(1_000_000_000, Pose(1.2, 4.8, 0.1))
    ahead_m = 0.3 * math.cos(0.1) + 0.2 * math.sin(0.1)
    left_m = 0.2 * math.cos(0.1) - 0.3 * math.sin(0.1)
    turn_rate = 0.5 * (3.0 * left_m - 4.0 * math.sin(0.1))
    assert decision.speed_m_s == pytest.approx(0.5 * math.cos(0.1) + 2.0 * ahead_m)
    assert decision.turn_rate_rad_s == pytest.approx(turn_rate)
    assert decision.heading_error_rad == pytest.approx(-0.1)


@pytest.mark.parametrize("kind", TRACKERS)
def test_tracker_forgets_its_last_run(kind: str) -> None:
    scenario = build_scenario({"law": {"kind": kind}, "path": {**CIRCLE, "speed_m_s": 0.5}})
    law = build_law(scenario.law)
    answers = []
    for _ in range(2):
        law.reset(Pose(5.5, 5.5, 0.0), None, scenario.path)
        answers.append([law.step(16_000_000 * n, Pose(5.5 + 0.01 * n, 5.5, 0.0)) for n in range(9)])
    assert answers[0] == answers[1]


@pytest.mark.parametrize("kind", TRACKERS)
def test_tracker_without_a_path_is_refused_before_anything_runs(kind: str) -> None:
    told = rf"{kind}: expected a path to track, found no table \[path\]; the preset track-square"
    with pytest.raises(LawError, match=told):
        tl.simulate_run(build_scenario({"law": {"kind": kind}}))


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        (
            {"law.lookahead_m": 0.0},
            "law.lookahead_m: expected a number > 0 and up to 1e.06, found 0.0",
        ),
        ({"law.lookahead_m": math.nan}, "law.lookahead_m: expected a finite number, found nan"),
        ({"law.kp_along": -1.0}, "law.kp_along: expected a number from 0 to 1000000, found -1.0"),
        (
            {"law.speed_m_s": "fast"},
            "law.speed_m_s: expected a number > 0 and up to 1e.06, found 'fast'",
        ),
        (
            {"path.speed_m_s": -1.0},
            "path.speed_m_s: expected a speed > 0 and up to 1e.06, found -1.0",
        ),
        ({"path.size_m": 9.0}, "path: expected x from 0 to 11.08888912 m, found -3.5 to 14.5 m"),
        ({"path.size_m": math.nan}, "path.size_m: expected a finite number, found nan"),
        ({"path.kind": "line"}, "path.points: missing; a path of kind line needs it"),
        ({"path.radius": 1.0}, "path.radius: unknown key; .*"),
    ],
)
def test_wrong_key_is_one_line(changes: dict[str, Any], line: str) -> None:
    scenario = build_scenario({"law": {"kind": "pure-pursuit"}, "path": CIRCLE})
    with pytest.raises(ScenarioError, match=line):
        tl.override_scenario(scenario, changes)


def test_path_with_one_point_is_one_line() -> None:
    path = {"kind": "waypoints", "points": [[1.0, 1.0]]}
    with pytest.raises(ScenarioError, match=r"path\.points: expected 2 to 3000 points, found 1"):
        build_scenario({"law": {"kind": "kanayama"}, "path": path})


@pytest.mark.parametrize(
    ("kind", "start"),
    [
        ("kanayama", (5.5, 5.5, 0.0)),
        ("kanayama", (7.5, 5.5, -1.5)),
        ("kanayama", (1.0, 1.0, 3.0)),
        ("pure-pursuit", (5.5, 5.5, 0.0)),
        ("pure-pursuit", (7.5, 5.5, -1.5)),
    ],
)
def test_tracker_comes_to_the_path(kind: str, start: tuple[float, float, float]) -> None:
    scenario = build_scenario(
        {
            "law": {"kind": kind},
            "path": {**CIRCLE, "speed_m_s": 0.4},
            "start": dict(zip(("x_m", "y_m", "heading_rad"), start, strict=True)),
        }
    )
    run = tl.simulate_run(scenario)
    assert run.stop_reason == "path_end"
    late = tl.measure.read_signal(run, "cross_track")
    assert np.abs(late.values[-len(late.values) // 4 :]).max() < 0.02


@pytest.mark.parametrize("kind", TRACKERS)
@pytest.mark.parametrize("first", [1, 2, 3])
def test_closed_path_is_tracked_alike_wherever_it_begins(kind: str, first: int) -> None:
    corners = [[4.0, 4.0], [6.0, 4.3], [6.5, 6.0], [4.5, 6.5]]
    paths = [{"kind": "polygon", "points": corners[at:] + corners[:at]} for at in (0, first)]
    runs = [track({"kind": kind}, path, (5.0, 4.15, 0.1489)) for path in paths]
    xy_m = [run.poses.xy_m for run in runs]
    assert xy_m[1] == pytest.approx(xy_m[0], abs=1e-6)
    found = [tl.measure_run(run, only=["cross.*"]) for run in runs]
    for name in ("cross.corner_overshoot", "cross.largest_error", "cross.rms_error"):
        assert found[1][name].value == pytest.approx(found[0][name].value, abs=1e-6)
