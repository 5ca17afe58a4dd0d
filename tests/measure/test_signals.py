import math
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.sequential import DECLARATION
from turtlelog.errors import MeasureError
from turtlelog.measure.signals import SIGNALS, read_signal
from turtlelog.run import CommandColumns, PoseColumns, Run, SampleColumns
from turtlelog.scenario import get_preset
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
    names = "x y heading speed turn_rate wanted_speed wanted_turn_rate error_x error_y distance"
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
    run = simulate_run(get_preset("paper-kp10"))
    signal = read_signal(run, name)
    assert signal is not None
    rows = run.poses if signal.kind.source == "pose" else run.samples
    assert (signal.name, signal.kind) == (name, SIGNALS[name])
    assert signal.values.shape == signal.time_ns.shape == (len(rows),)
    assert (signal.time_ns == rows.time_ns).all()


@pytest.mark.parametrize("kind", SIGNALS.values(), ids=SIGNALS)
def test_commands_are_held_and_poses_joined_by_lines(kind: Any) -> None:
    assert kind.resampling == {"sample": "hold", "pose": "line"}[kind.source]
    assert kind.unit in {"m", "rad", "m/s", "rad/s", "1"}


def test_unknown_signal_is_refused_with_those_that_are_known() -> None:
    *others, last = SIGNALS
    line = f"signal 'z': expected {', '.join(others)} or {last}"
    with pytest.raises(MeasureError, match=rf"\A{re.escape(line)}\Z"):
        read_signal(make_run(), "z")
    with pytest.raises(MeasureError, match=r"'headin': expected heading or heading_error\Z"):
        read_signal(make_run(), "headin")


@pytest.mark.parametrize(
    ("name", "column"),
    [("wanted_speed", "wanted_speed_m_s"), ("wanted_turn_rate", "wanted_turn_rate_rad_s")],
)
def test_signal_that_was_not_recorded_is_none(name: str, column: str) -> None:
    changes: dict[str, Any] = {column: None}
    assert read_signal(make_run(**changes), name) is None


@pytest.mark.parametrize("name", ["error_x", "error_y", "distance"])
def test_signal_without_a_goal_is_none(name: str) -> None:
    assert read_signal(replace(make_run(), goal_xy_m=None), name) is None


@pytest.mark.parametrize("name", ["heading_error", "along_track", "cross_track"])
def test_signal_without_a_bearing_is_none(name: str) -> None:
    assert read_signal(make_run(samples=0), name) is None


def test_poses_alone_have_signals() -> None:
    assert read_values(make_run(samples=0), "distance") == pytest.approx(
        [5.0, math.sqrt(20.0), math.sqrt(5.0)]
    )
