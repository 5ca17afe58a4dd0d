import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from tests.effects_cases import build_case
from tests.sequential import DECLARATION
from turtlelog.errors import MeasureError
from turtlelog.measure.signals import SIGNALS, explain_no_signal, find_signal, read_signal
from turtlelog.run import CommandColumns, PoseColumns, Run, SampleColumns
from turtlelog.simulate import simulate_run

XY_M = np.array([[1.0, 1.0], [2.0, 1.0], [2.0, 4.0]])
HEADING_RAD = np.array([3.0, -3.0, -2.5])
BEARING_RAD = math.atan2(4.0, 3.0)


def make_run(samples: int = 3, first_pose: int = 0, **changes: Any) -> Run:
    time_ns = np.array([0, 10, 20])
    zeros = np.zeros(samples)
    rows: dict[str, Any] = {
        "time_ns": time_ns[:samples] + 5,
        "sequence": np.arange(samples),
        "pose_sequence": np.minimum(np.arange(samples) + first_pose, 2),
        "phase": np.array([0, 2, 2])[:samples],
        "bearing_rad": zeros + BEARING_RAD,
        "heading_error_rad": zeros.copy(),
        "error_xy_m": np.zeros((samples, 2)),
        "distance_m": zeros.copy(),
        "speed_m_s": zeros + 0.5,
        "turn_rate_rad_s": zeros - 0.25,
        "world_velocity_m_s": np.zeros((samples, 2)),
        "wanted_speed_m_s": zeros + 5.0,
        "wanted_turn_rate_rad_s": zeros - 2.5,
    }
    return Run(
        name="run",
        source="test",
        poses=PoseColumns(time_ns=time_ns, xy_m=XY_M.copy(), heading_rad=HEADING_RAD.copy()),
        commands=CommandColumns(
            time_ns=np.array([0]),
            speed_m_s=np.zeros(1),
            lateral_speed_m_s=np.zeros(1),
            turn_rate_rad_s=np.zeros(1),
        ),
        samples=SampleColumns(**(rows | changes)),
        goal_xy_m=(4.0, 5.0),
        declaration=DECLARATION,
    )


def read_values(run: Run, name: str) -> list[float]:
    signal = read_signal(run, name)
    assert signal is not None
    return list(signal.values)


def test_signals_have_the_names_that_every_stage_shares() -> None:
    commands = "speed turn_rate wanted_speed wanted_turn_rate shaped_speed shaped_turn_rate"
    rates = "applied_speed applied_turn_rate measured_speed measured_turn_rate"
    poses = f"{rates} sensed_x sensed_y sensed_heading"
    names = f"x y heading {commands} {poses} error_x error_y distance"
    assert " ".join(SIGNALS) == f"{names} heading_error along_track cross_track phase"


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("x", [1.0, 2.0, 2.0]),
        ("y", [1.0, 1.0, 4.0]),
        ("heading", [3.0, math.tau - 3.0, math.tau - 2.5]),
        ("speed", [0.5, 0.5, 0.5]),
        ("turn_rate", [-0.25, -0.25, -0.25]),
        ("wanted_speed", [5.0, 5.0, 5.0]),
        ("wanted_turn_rate", [-2.5, -2.5, -2.5]),
        ("error_x", [3.0, 2.0, 2.0]),
        ("error_y", [4.0, 4.0, 1.0]),
        ("distance", [5.0, math.sqrt(20.0), math.sqrt(5.0)]),
        ("along_track", [0.0, 0.6, 3.0]),
        ("cross_track", [0.0, -0.8, 1.0]),
        ("phase", [0.0, 2.0, 2.0]),
    ],
)
def test_signal_is_read_from_its_columns(name: str, values: list[float]) -> None:
    assert read_values(make_run(), name) == pytest.approx(values)


def test_heading_error_is_wrapped() -> None:
    expected = [BEARING_RAD - 3.0, BEARING_RAD + 3.0 - math.tau, BEARING_RAD + 2.5 - math.tau]
    assert read_values(make_run(), "heading_error") == pytest.approx(expected)


def test_track_leads_from_the_first_pose_that_was_read_to_the_goal() -> None:
    run, root = make_run(first_pose=1), math.sqrt(5.0)
    assert read_values(run, "along_track") == pytest.approx([-1.0 / root, 0.0, 6.0 / root])
    assert read_values(run, "cross_track") == pytest.approx([2.0 / root, 0.0, 3.0 / root])


def test_without_the_first_sample_the_recorded_bearing_gives_the_direction() -> None:
    run = make_run(first_pose=1, sequence=np.arange(3) + 1)
    assert read_values(run, "along_track") == pytest.approx([-0.6, 0.0, 2.4])
    assert read_values(run, "cross_track") == pytest.approx([0.8, 0.0, 1.8])


@pytest.mark.parametrize("name", SIGNALS)
def test_signal_has_one_value_per_row_of_its_source(name: str) -> None:
    run = simulate_run(build_case("dropout", "low_pass", preset="paper-kp10", max_duration_s=1.0))
    rates = run.poses.speed_m_s
    poses = dataclasses.replace(run.poses, measured_speed_m_s=rates, measured_turn_rate_rad_s=rates)
    run = dataclasses.replace(run, poses=poses)
    assert run.poses.sensed_heading_rad is not None
    signal = read_signal(run, name)
    assert signal is not None
    assert (signal.name, signal.kind) == (name, SIGNALS[name])
    times = {
        "pose": run.poses.time_ns,
        "sample": run.samples.time_ns,
        "sensed pose": run.poses.time_ns[~np.isnan(run.poses.sensed_heading_rad)],
    }
    assert signal.values.shape == signal.time_ns.shape
    assert np.isfinite(signal.values).all()
    assert (signal.time_ns == times[signal.kind.source]).all()
    assert 0 < len(times["sensed pose"]) < len(run.poses)


@pytest.mark.parametrize(("name", "kind"), SIGNALS.items(), ids=SIGNALS)
def test_commands_are_held_and_poses_joined_by_lines(name: str, kind: Any) -> None:
    is_joined = kind.source == "pose" and not name.startswith(("applied_", "measured_"))
    assert kind.resampling == ("line" if is_joined else "hold")
    assert kind.unit in {"m", "rad", "m/s", "rad/s", "1"}


def test_unknown_signal_is_refused_with_those_that_are_known() -> None:
    with pytest.raises(MeasureError, match=r'\Ano signal "z"; list: turtlelog list signals\Z'):
        read_signal(make_run(), "z")
    with pytest.raises(MeasureError, match=r'no signal "headin"; did you mean heading\?'):
        read_signal(make_run(), "headin")


@pytest.mark.parametrize(
    ("name", "column"),
    [("wanted_speed", "wanted_speed_m_s"), ("wanted_turn_rate", "wanted_turn_rate_rad_s")],
)
def test_signal_that_was_not_recorded_is_none(name: str, column: str) -> None:
    changes: dict[str, Any] = {column: None}
    assert find_signal(make_run(**changes), name) is None


@pytest.mark.parametrize("name", ["error_x", "error_y", "distance"])
def test_signal_without_a_goal_is_none(name: str) -> None:
    assert find_signal(dataclasses.replace(make_run(), goal_xy_m=None), name) is None


@pytest.mark.parametrize("name", ["heading_error", "along_track", "cross_track"])
def test_signal_without_a_bearing_is_none(name: str) -> None:
    assert find_signal(make_run(samples=0), name) is None


def test_poses_alone_have_signals() -> None:
    assert read_values(make_run(samples=0), "distance") == pytest.approx(
        [5.0, math.sqrt(20.0), math.sqrt(5.0)]
    )


def test_the_sensed_heading_has_the_turns_of_the_heading() -> None:
    run = make_run()
    poses = dataclasses.replace(
        run.poses,
        sensed_xy_m=np.array([[1.5, 1.0], [np.nan, np.nan], [2.5, 4.0]]),
        sensed_heading_rad=np.array([-3.1, np.nan, -2.4]),
    )
    run = dataclasses.replace(run, poses=poses)
    assert read_values(run, "heading") == pytest.approx([3.0, math.tau - 3.0, math.tau - 2.5])
    assert read_values(run, "sensed_heading") == pytest.approx([math.tau - 3.1, math.tau - 2.4])
    assert read_values(run, "sensed_x") == [1.5, 2.5]
    assert read_values(run, "sensed_y") == [1.0, 4.0]


def test_a_run_of_which_nothing_was_sensed_has_no_such_signal() -> None:
    run = make_run()
    nothing = np.full(3, np.nan)
    poses = dataclasses.replace(
        run.poses, sensed_xy_m=np.column_stack([nothing] * 2), sensed_heading_rad=nothing
    )
    for found in (run, dataclasses.replace(run, poses=poses)):
        for name in ("sensed_x", "sensed_y", "sensed_heading", "shaped_speed"):
            assert find_signal(found, name) is None


def test_what_is_applied_includes_a_disturbance_and_is_not_what_odometry_measures() -> None:
    run = simulate_run(build_case("disturbance", max_duration_s=0.5))
    applied, commanded = (read_signal(run, name) for name in ("applied_turn_rate", "turn_rate"))
    assert applied is not None
    assert commanded is not None
    assert applied.values[20:].max() == pytest.approx(0.95)  # -0.05 rad/s from 0.3 s on
    assert commanded.values.max() == 1.0
    poses = dataclasses.replace(
        run.poses,
        speed_m_s=None,
        turn_rate_rad_s=None,
        measured_speed_m_s=run.poses.speed_m_s,
        measured_turn_rate_rad_s=run.poses.turn_rate_rad_s,
    )
    odometry = dataclasses.replace(run, poses=poses)
    assert find_signal(odometry, "applied_turn_rate") is None
    measured = read_signal(odometry, "measured_turn_rate")
    assert measured is not None
    assert (measured.values == applied.values).all()


def test_commands_of_a_run_without_samples_are_those_published() -> None:
    run = make_run(samples=0)
    commands = CommandColumns(
        time_ns=np.array([4, 12]),
        speed_m_s=np.array([0.5, 1.5]),
        lateral_speed_m_s=np.zeros(2),
        turn_rate_rad_s=np.array([-1.0, 0.0]),
    )
    run = dataclasses.replace(run, commands=commands)
    speed, turn_rate = read_signal(run, "speed"), read_signal(run, "turn_rate")
    assert speed is not None
    assert turn_rate is not None
    assert (speed.kind.source, speed.kind.resampling) == ("command", "hold")
    assert (speed.time_ns.tolist(), speed.values.tolist()) == ([4, 12], [0.5, 1.5])
    assert turn_rate.values.tolist() == [-1.0, 0.0]


def test_commands_of_a_run_with_samples_are_those_of_its_samples() -> None:
    assert read_values(make_run(), "speed") == [0.5, 0.5, 0.5]  # what was published is 0


def test_without_commands_there_is_no_signal_of_them() -> None:
    none = np.zeros(0)
    commands = CommandColumns(
        time_ns=np.zeros(0, dtype=np.int64),
        speed_m_s=none,
        lateral_speed_m_s=none.copy(),
        turn_rate_rad_s=none.copy(),
    )
    run = dataclasses.replace(make_run(samples=0), commands=commands)
    assert find_signal(run, "speed") is None
    assert explain_no_signal(run, "speed") == "the recording holds no commands"


def test_a_signal_that_a_run_lacks_is_an_error_that_says_why() -> None:
    run = dataclasses.replace(make_run(), goal_xy_m=None, name="lab")
    with pytest.raises(MeasureError, match="lab: has no signal distance: the goal is not known"):
        read_signal(run, "distance")
