"""A first test suite on replayed logs: copy it beside your recordings and change the figures.

Run: pytest examples/test_recordings.py
"""

import pytest

from turtlelog import Recording, load_scenario, simulate_run
from turtlelog.compare import Tolerance

pytestmark = pytest.mark.recordings("../recordings/paper/kp[124].mcap")


def test_the_controller_comes_to_its_own_end(turtlelog_recording: Recording) -> None:
    assert turtlelog_recording.run.is_complete


def test_it_turns_without_overshoot_and_settles_in_time(turtlelog_recording: Recording) -> None:
    rotate = turtlelog_recording.phase("rotate")
    assert rotate.overshoot <= 1.0
    assert rotate.settling_time(band=0.02) < 4.5


def test_it_stops_within_a_centimetre_of_the_goal(turtlelog_recording: Recording) -> None:
    assert turtlelog_recording.metric("final.position_error") < 0.01


def test_it_stays_on_its_line_and_within_the_limits(turtlelog_recording: Recording) -> None:
    assert turtlelog_recording.holds("always(abs(cross_track) <= 0.05)", phase="translate")
    assert turtlelog_recording.holds("always(abs(speed) <= 1 and abs(turn_rate) <= 1)")


def test_todays_law_still_answers_as_it_did(turtlelog_recording: Recording) -> None:
    assert turtlelog_recording.driven_by().matches(
        turtlelog_recording, tolerance=Tolerance(abs=1e-9)
    )


def test_todays_simulation_still_gives_the_recorded_run(turtlelog_recording: Recording) -> None:
    assert turtlelog_recording.matches(simulate_run(load_scenario(turtlelog_recording.run.name)))
