"""The project's own recordings, guarded by its own plugin."""

from pathlib import Path

import pytest

import turtlelog as tl

PAPER = Path(__file__).parents[1] / "recordings" / "paper"

pytestmark = pytest.mark.recordings(PAPER / "*.mcap")


def test_the_turtle_turns_and_drives_as_in_the_paper(turtlelog_recording: tl.Recording) -> None:
    rotate, translate = turtlelog_recording.phase("rotate"), turtlelog_recording.phase("translate")
    assert -0.1 < rotate.overshoot < 1.1
    assert rotate.settling_time(band=0.02) < 4.5
    assert translate.saturated_share < 0.9
    assert translate.settling_time < 8.5


def test_it_comes_close_and_only_the_highest_gain_goes_astray(
    turtlelog_recording: tl.Recording,
) -> None:
    is_highest = turtlelog_recording.run.parameters["law.kp_linear"] == 10.0
    assert turtlelog_recording.metric("final.position_error") < (0.11 if is_highest else 0.01)
    assert bool(turtlelog_recording.holds("always(abs(cross_track) <= 0.01)")) is not is_highest


def test_commands_stay_within_the_limits_at_all_times(turtlelog_recording: tl.Recording) -> None:
    assert turtlelog_recording.holds("always(abs(speed) <= 1 and abs(turn_rate) <= 1)")


def test_the_turtle_stands_while_it_turns(turtlelog_recording: tl.Recording) -> None:
    assert turtlelog_recording.holds("always(phase == 'rotate' implies speed == 0)")
    assert turtlelog_recording.holds("eventually[0, 30](distance <= 0.11)")


def test_todays_law_answers_the_recorded_poses_as_recorded(
    turtlelog_recording: tl.Recording,
) -> None:
    assert turtlelog_recording.driven_by().matches(
        turtlelog_recording, tolerance=tl.Tolerance(abs=1e-9)
    )


def test_todays_simulation_is_the_recorded_run(turtlelog_recording: tl.Recording) -> None:
    assert turtlelog_recording.matches(
        tl.simulate_run(tl.load_scenario(turtlelog_recording.run.name))
    )
