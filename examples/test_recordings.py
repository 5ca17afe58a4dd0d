"""A first test suite on replayed logs: copy it beside your recordings and change the figures."""

from pathlib import Path

import pytest

import turtlelog as tl

RECORDINGS = Path(__file__).parents[1] / "recordings" / "paper"


@pytest.fixture(scope="module", params=["kp1", "kp2", "kp4"])
def recording(request: pytest.FixtureRequest) -> tl.Run:
    return tl.read_recording(RECORDINGS / f"{request.param}.mcap")


def test_the_controller_comes_to_its_own_end(recording: tl.Run) -> None:
    assert recording.is_complete


def test_the_turtle_stops_within_a_centimetre_of_the_goal(recording: tl.Run) -> None:
    error = tl.measure_run(recording)["final.position_error"]
    assert error.status is tl.Status.OK, error.reason
    assert error.value is not None
    assert error.value < 0.01


def test_the_heading_overshoots_by_less_than_one_percent(recording: tl.Run) -> None:
    overshoot = tl.measure_run(recording)["rotate.overshoot"]
    assert overshoot.value is not None, overshoot.reason
    assert overshoot.value < 1.0


def test_no_command_exceeds_the_limits(recording: tl.Run) -> None:
    assert abs(recording.commands.speed_m_s).max() <= 1.0
    assert abs(recording.commands.turn_rate_rad_s).max() <= 1.0


def test_todays_simulation_still_gives_the_recorded_run(recording: tl.Run) -> None:
    today = tl.simulate_run(tl.load_scenario(recording.name))
    comparison = tl.compare_runs(recording, today)
    assert {
        found.signal: found.largest for found in comparison.signals if found.largest > 1e-6
    } == {}
