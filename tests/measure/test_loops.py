"""Metrics of laws with other loops: held against what numpy says of the columns."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

import turtlelog as tl
from tests.measure.runs import make_straight_run, set_times
from tests.strange_law import simulate_strange
from turtlelog.laws import Decision, Goal, Pose
from turtlelog.run.angles import wrap_angle
from turtlelog.run.loops import ControlLoop, Declaration
from turtlelog.run.paths import Path

STRANGE = simulate_strange()
DRIVE = "examples/turn_and_drive.py:TurnAndDrive"


def simulate_drive(**changes: Any) -> tl.Run:
    values = {key.replace("__", "."): value for key, value in changes.items()}
    scenario = tl.override_scenario(tl.load_scenario("textbook"), {"law.kind": DRIVE, **values})
    return tl.simulate_run(scenario)


def read(run: tl.Run, name: str) -> float:
    value = tl.measure_run(run, only=[name])[name].value
    assert value is not None
    return value


def average_square(time_s: Any, error: Any) -> float:
    """Return the mean over time of the square of the line through the errors."""
    before, after, step_s = error[:-1], error[1:], np.diff(time_s)
    squares = (before**2 + before * after + after**2) / 3.0
    return float((squares * step_s).sum() / step_s.sum())


def take_first_loop() -> tuple[Any, Any]:
    """Return times and errors of loop `a`: its reference is that of the last sample that read."""
    run, samples = STRANGE, STRANGE.samples
    assert samples.reference_heading_rad is not None
    own = np.flatnonzero(samples.phase == 0)
    rows = np.flatnonzero(run.poses.time_ns <= samples.time_ns[own[-1] + 1])
    latest = np.searchsorted(samples.pose_sequence[own], rows, side="right") - 1
    wanted = samples.reference_heading_rad[own][latest]
    return run.poses.time_ns[rows] / 1e9, wrap_angle(wanted - run.poses.heading_rad[rows])


def test_loop_with_a_moving_reference_has_no_metric_of_a_step() -> None:
    names = [name for name in tl.measure_run(STRANGE) if name.startswith("a.")]
    assert {"a.rms_error", "a.largest_error", "a.final_error", "a.dead_time"} <= set(names)
    assert not {"a.overshoot", "a.settling_time", "a.rise_time", "a.peak"} & set(names)
    assert not [name for name in names if "deviation" in name or "cross_track" in name]


def test_loop_with_more_than_a_gain_is_not_measured_against_theory() -> None:
    declared = STRANGE.declaration
    loops = tuple(dataclasses.replace(loop, is_proportional=False) for loop in declared.loops)
    run = dataclasses.replace(STRANGE, declaration=dataclasses.replace(declared, loops=loops))
    names, known = set(tl.measure_run(run)), set(tl.measure_run(STRANGE))
    left_out = {f"b.{theory}_deviation" for theory in ("ideal", "sampled", "delayed")}
    assert known - names == {f"{name}_{kind}" for name in left_out for kind in ("max", "rms")}
    assert names < known


def test_moving_reference_is_measured_against_its_own_pose() -> None:
    time_s, error_rad = take_first_loop()
    assert read(STRANGE, "a.rms_error") == pytest.approx(
        math.degrees(math.sqrt(average_square(time_s, error_rad))), rel=1e-9
    )
    assert read(STRANGE, "a.largest_error") == pytest.approx(np.degrees(abs(error_rad).max()))
    assert read(STRANGE, "a.final_error") == pytest.approx(np.degrees(abs(error_rad[-1])))


def test_distance_loop_answers_a_step_to_zero() -> None:
    run, samples = STRANGE, STRANGE.samples
    start_ns = samples.time_ns[np.flatnonzero(samples.phase == 1)[0]]
    first = int(np.searchsorted(run.poses.time_ns, start_ns))
    time_s = run.poses.time_ns[first:] / 1e9
    away_m = np.hypot(*(np.array(run.goal_xy_m) - run.poses.xy_m[first:]).T)
    assert read(run, "b.rms_error") == pytest.approx(math.sqrt(average_square(time_s, away_m)))
    assert read(run, "b.final_error") == pytest.approx(away_m[-1])
    inside = np.flatnonzero(away_m > 0.02 * away_m[0])[-1]
    assert read(run, "b.settling_time") == pytest.approx(time_s[inside + 1] - time_s[0], abs=0.016)


def test_distance_cannot_pass_its_reference() -> None:
    names = tl.measure_run(STRANGE)
    assert not {"b.overshoot", "b.crossings", "b.decay_ratio"} & set(names)
    assert {"b.undershoot", "b.ideal_deviation_max", "b.cross_track_rms"} <= set(names)


def test_share_of_saturated_samples_is_that_of_the_loops_own_command() -> None:
    samples = STRANGE.samples
    driving = samples.phase == 1
    share = (np.abs(samples.speed_m_s[driving]) >= 1.0).mean()
    assert read(STRANGE, "b.saturated_share") == pytest.approx(share)
    assert 0.0 < share < 1.0


def test_no_metric_is_of_a_loop_that_is_not_declared() -> None:
    parts = {name.partition(".")[0] for name in tl.measure_run(STRANGE)}
    assert parts == {"a", "b", "final", "run"}


def test_metric_of_a_loop_that_is_not_declared_says_so() -> None:
    metric = tl.measure_run(STRANGE, only=["rotate.overshoot"])["rotate.overshoot"]
    assert (metric.status, metric.value) == (tl.measure.Status.NO_PHASE, None)
    assert metric.reason == "the run declares no loop rotate (it declares a, b)"


def test_metric_that_a_declared_loop_does_not_have_says_so() -> None:
    metric = tl.measure_run(STRANGE, only=["a.overshoot"])["a.overshoot"]
    assert metric.reason == "a loop of heading with the reference recorded has no overshoot"


def test_pattern_of_other_loops_chooses_nothing() -> None:
    assert tl.measure_run(STRANGE, only=["translate.*"]) == {}


def test_heading_error_is_the_recorded_one_of_the_loop_that_acts() -> None:
    signal = tl.read_signal(STRANGE, "heading_error")
    assert signal is not None
    _, error_rad = take_first_loop()
    assert signal.values[: len(error_rad)] == pytest.approx(error_rad, abs=1e-12)
    # Afterwards the loop that acted last is that of phase one: its reference stays.
    samples = STRANGE.samples
    assert samples.reference_heading_rad is not None
    last_rad = samples.reference_heading_rad[samples.phase == 0][-1]
    expected = wrap_angle(last_rad - STRANGE.poses.heading_rad[-1])
    assert signal.values[-1] == pytest.approx(expected)
    assert read(STRANGE, "final.heading_error") == pytest.approx(abs(math.degrees(expected)))


def test_bearing_now_is_that_of_every_pose() -> None:
    run = simulate_drive()
    signal = tl.read_signal(run, "heading_error")
    assert signal is not None
    assert run.goal_xy_m is not None
    ahead_m, left_m = (np.array(run.goal_xy_m) - run.poses.xy_m).T
    # To the last bit, which numpy's `arctan2` does not have on every processor.
    bearing_rad = np.array([math.atan2(y, x) for x, y in zip(ahead_m, left_m, strict=True)])
    assert np.array_equal(signal.values, wrap_angle(bearing_rad - run.poses.heading_rad))
    recorded = run.samples.heading_error_rad
    assert recorded is not None
    assert signal.values[run.samples.pose_sequence] == pytest.approx(recorded, abs=1e-12)


@pytest.mark.parametrize(
    ("times_s", "weights"),
    [
        ((0, 10, 20), (0.0, 0.5, 0.5)),
        ((0, 15, 20), (0.0, 1.0, 0.0)),
        ((0, 5, 10), (0.0, 0.0, 1.0)),
    ],
)
def test_bearing_at_15_s_lies_between_the_poses_around_it(
    times_s: tuple[int, ...], weights: tuple[float, ...]
) -> None:
    align = ControlLoop(
        name="align", signal="heading", command="turn_rate", reference="bearing_now"
    )
    declared = Declaration(loops=(align,), phases={"one": ("align",), "two": (), "three": ()})
    along_m = np.array([0.0, 2.0, 4.0])
    run = make_straight_run(along_m, declaration=declared, goal_xy_m=(6.0, 6.0))
    bearing_rad = np.arctan2(1.0, 5.0 - along_m)
    found = read(
        set_times(run, [time_s * 10**9 for time_s in times_s]), "final.heading_error_at_15s"
    )
    assert found == pytest.approx(math.degrees(np.dot(weights, bearing_rad)))


def test_step_towards_a_bearing_that_moves_is_one_of_the_error() -> None:
    run = simulate_drive()
    ahead_m, left_m = (np.array(run.goal_xy_m) - run.poses.xy_m).T
    error_rad = wrap_angle(np.arctan2(left_m, ahead_m) - run.poses.heading_rad)
    time_s = run.poses.time_ns / 1e9
    last = np.flatnonzero(np.abs(error_rad) > 0.02 * abs(error_rad[0]))[-1]
    assert read(run, "align.settling_time") == pytest.approx(time_s[last + 1], abs=0.016)
    assert read(run, "align.rms_error") == pytest.approx(
        math.degrees(math.sqrt(average_square(time_s, error_rad))), rel=1e-6
    )


def test_states_are_signals_by_name() -> None:
    signal = tl.read_signal(STRANGE, "memory")
    assert signal is not None
    assert STRANGE.samples.states is not None
    assert signal.values.tolist() == STRANGE.samples.states[:, 0].tolist()
    assert (signal.kind.source, signal.kind.resampling) == ("sample", "hold")
    assert "memory" in tl.measure.list_signals(STRANGE.declaration)
    with pytest.raises(tl.TurtlelogError, match='no signal "memory"; '):
        tl.read_signal(simulate_drive(), "memory")


@dataclasses.dataclass(frozen=True)
class Speeds:
    speed_m_s: float = 0.3


class Blind:
    """Drives on without a goal."""

    Parameters = Speeds

    @classmethod
    def declare(cls, parameters: Speeds, goal: Goal | None, path: Path | None) -> Declaration:
        return Declaration(uses_goal=False)

    def __init__(self, parameters: Speeds) -> None:
        self.parameters = parameters

    def reset(self, start: Pose, goal: Goal | None, path: Path | None) -> None:
        assert goal is None

    def step(self, time_ns: int, pose: Pose) -> Decision:
        stop_reason = "enough" if time_ns > 1_000_000_000 else None
        return Decision(
            speed_m_s=self.parameters.speed_m_s, turn_rate_rad_s=0.1, stop_reason=stop_reason
        )


def test_law_without_a_goal_has_no_geometry_and_no_errors() -> None:
    values = {"law.kind": f"{__file__}:Blind"}
    run = tl.simulate_run(tl.override_scenario(tl.load_scenario("textbook"), values))
    assert (run.goal_xy_m, run.goal_line, run.samples.error_xy_m) == (None, None, None)
    assert (run.samples.bearing_rad, run.samples.distance_m) == (None, None)
    assert all(tl.measure.find_signal(run, name) is None for name in ("distance", "along_track"))
    metrics = tl.measure_run(run)
    assert metrics["final.position_error"].status is tl.measure.Status.ABSENT
    assert metrics["final.heading_error"].status is tl.measure.Status.ABSENT
    assert not [name for name in metrics if name.partition(".")[0] not in {"final", "run"}]


TWO = Declaration(
    loops=(
        ControlLoop(name="aim", signal="heading", command="turn_rate", reference="goal_heading"),
        ControlLoop(name="keep", signal="heading", command="turn_rate", reference="zero"),
    ),
    phases={"rotate": ("aim",), "pause": (), "translate": ("keep",)},
)


def test_heading_error_follows_the_loop_that_acts() -> None:
    run = tl.simulate_run(
        tl.override_scenario(tl.load_scenario("paper-kp4"), {"goal.heading_rad": 1.0})
    )
    run = dataclasses.replace(run, declaration=TWO)
    signal = tl.read_signal(run, "heading_error")
    assert signal is not None
    switch = run.samples.pose_sequence[np.flatnonzero(run.samples.phase == 2)[0]]
    heading_rad = run.poses.heading_rad
    assert signal.values[:switch] == pytest.approx(wrap_angle(1.0 - heading_rad[:switch]))
    assert signal.values[switch:] == pytest.approx(wrap_angle(-heading_rad[switch:]))


def test_loop_of_a_goal_heading_that_is_not_asked_for_is_absent() -> None:
    run = dataclasses.replace(tl.simulate_run(tl.load_scenario("paper-kp4")), declaration=TWO)
    metric = tl.measure_run(run)["aim.overshoot"]
    assert metric.status is tl.measure.Status.ABSENT
    assert metric.reason == "the reference goal_heading of heading is not known"
