import csv
import json
import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.known import known
from tests.sequential import ROTATE, TRANSLATE
from turtlelog.run import Run
from turtlelog.scenario import get_preset
from turtlelog.simulate import simulate_run

PUBLISHED = Path(__file__).parents[2].parent / "shared" / "paper"
GAINS = [1, 2, 4, 10]
STATES = {"ROTACIONAR": ROTATE, "TRANSLADAR": TRANSLATE}

Values = NDArray[np.float64]


@cache
def simulate_gain(kp: int) -> Run:
    return simulate_run(get_preset(f"paper-kp{kp}"))


def list_columns(run: Run) -> dict[str, Values]:
    samples = run.samples
    x_m, y_m = run.poses.xy_m[samples.pose_sequence].T
    return {
        "pos_x": x_m,
        "pos_y": y_m,
        "pos_theta": run.poses.heading_rad[samples.pose_sequence],
        "target_angle_rad": known(samples.bearing_rad),
        "error_angle": known(samples.heading_error_rad),
        "error_x": known(samples.error_xy_m)[:, 0],
        "error_y": known(samples.error_xy_m)[:, 1],
        "error_distance": known(samples.distance_m),
        "vel_linear_x": samples.speed_m_s,
        "vel_angular_z": samples.turn_rate_rad_s,
        "vel_x_global": known(samples.world_velocity_m_s)[:, 0],
        "vel_y_global": known(samples.world_velocity_m_s)[:, 1],
    }


def require_published(name: str) -> str:
    path = PUBLISHED / name
    if not path.is_file():
        pytest.skip(f"the paper's published log {name} is not here")
    return path.read_text(encoding="utf-8")


@pytest.mark.parametrize("kp", GAINS)
def test_simulation_is_the_published_log_bit_for_bit(kp: int) -> None:
    published = json.loads(require_published(f"kp{kp}_210.json"))["data"]
    columns = list_columns(simulate_gain(kp))
    assert set(published) == {*columns, "time", "state"}
    different = [name for name, values in columns.items() if values.tolist() != published[name]]
    assert different == []


@pytest.mark.parametrize("kp", GAINS)
def test_simulation_is_the_published_table_bit_for_bit(kp: int) -> None:
    text = require_published(f"kp{kp}_210_main.csv")
    rows = list(csv.DictReader(text.splitlines()))
    columns = list_columns(simulate_gain(kp))
    columns["error_angle_rad"] = columns.pop("error_angle")
    assert {len(values) for values in columns.values()} == {len(rows)}
    for name, values in columns.items():
        assert values.tolist() == [float(row[name]) for row in rows], name


@pytest.mark.parametrize("kp", GAINS)
def test_published_state_is_the_phase_of_the_next_sample(kp: int) -> None:
    states = json.loads(require_published(f"kp{kp}_210.json"))["data"]["state"]
    phase = simulate_gain(kp).samples.phase
    assert [STATES[state] for state in states[:-1]] == phase[1:].tolist()
    assert states[-1] == "FINALIZADO"


@pytest.mark.parametrize(("kp", "samples"), [*zip(GAINS, [1265, 773, 681, 770], strict=True)])
def test_run_has_as_many_samples_as_published(kp: int, samples: int) -> None:
    run = simulate_gain(kp)
    assert len(run.samples) == len(run.commands) == samples


@pytest.mark.parametrize(
    ("kp", "length_s"), [*zip(GAINS, [20.53, 12.67, 11.18, 12.61], strict=True)]
)
def test_run_is_as_long_as_published(kp: int, length_s: float) -> None:
    run = simulate_gain(kp)
    assert (run.end_ns - run.start_ns) / 1e9 == pytest.approx(length_s, abs=0.005)


@pytest.mark.parametrize(
    ("kp", "error_deg"), [*zip(GAINS, [0.0253, 0.0076, 0.0857, 1.0739], strict=True)]
)
def test_run_ends_with_the_published_heading_error(kp: int, error_deg: float) -> None:
    run = simulate_gain(kp)
    error_rad = abs(known(run.samples.bearing_rad)[-1] - run.poses.heading_rad[-1])
    assert math.degrees(error_rad) == pytest.approx(error_deg, abs=0.00005)


@pytest.mark.parametrize(
    ("kp", "error_m"), [*zip(GAINS, [0.0025, 0.001011, 0.008520, 0.106728], strict=True)]
)
def test_run_ends_with_the_published_position_error(kp: int, error_m: float) -> None:
    digits = 0.00005 if kp == 1 else 0.0000005
    assert known(simulate_gain(kp).samples.distance_m)[-1] == pytest.approx(error_m, abs=digits)


@pytest.mark.parametrize(("kp", "error_m"), [(1, 0.082518), (10, 0.106728)])
def test_position_error_at_15_s_is_as_published(kp: int, error_m: float) -> None:
    samples = simulate_gain(kp).samples
    time_s = (samples.time_ns - samples.time_ns[0]) / 1e9
    at_15_s = np.interp(15.0, time_s, known(samples.distance_m))
    assert at_15_s == pytest.approx(error_m, abs=0.0000005)


@pytest.mark.parametrize(
    ("kp", "stop_reason"),
    [*zip(GAINS, ["standstill", "within_tolerance", "standstill", "standstill"], strict=True)],
)
def test_run_ends_by_its_own_stop_rule(kp: int, stop_reason: str) -> None:
    assert simulate_gain(kp).stop_reason == stop_reason
