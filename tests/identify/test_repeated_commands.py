"""Robots whose commands repeat, so that a dead time is known up to a period only."""

import numpy as np
import pytest

import turtlelog as tl
from tests.identify.robots import Log, Truth, Values, make_run
from turtlelog.identify import AxisModel
from turtlelog.identify.axis_motion import find_repetition, read_axis_motion


def switch(time_s: Values, period_s: float, low: float = -1.0) -> Values:
    """Return a square wave from 1 to `low`."""
    return np.where((time_s - 1.0) % period_s < 0.5 * period_s, 1.0, low)


def identify(
    value: Values, time_s: Values, *, gain: float = 0.9, is_whole: bool = True
) -> AxisModel:
    log = Log(turn_rate=Truth(gain=gain, dead_time_s=0.06), duration_s=30.0, poses_hz=20.0)
    run = make_run(log, 5, (time_s, 0.0 * value), (time_s, value))
    # Beginning and end tell what no wave in between does.
    return tl.identify_robot(run if is_whole else run.slice(start_s=5.2, end_s=25.2)).turn_rate


TIME_S = np.arange(1.0, 29.5, 0.05)


@pytest.mark.parametrize("period_s", [0.8, 1.0, 2.0])
def test_the_beginning_of_a_square_wave_tells_the_sign(period_s: float) -> None:
    right, wrong = (identify(switch(TIME_S, period_s), TIME_S, gain=gain) for gain in (0.9, -0.9))
    assert right.gain is not None
    assert right.dead_time_s is not None
    assert right.gain.value == pytest.approx(0.9, abs=0.01)
    assert right.dead_time_s.value == pytest.approx(0.06, abs=0.005)
    assert wrong.status == "not_identifiable"
    assert "the turn rate follows its commands with the opposite sign: gain -0." in wrong.reason
    assert "dead time 0.06" in wrong.reason


@pytest.mark.parametrize("gain", [0.9, -0.9])
def test_a_square_wave_without_its_beginning_does_not_tell_the_sign(gain: float) -> None:
    found = identify(switch(TIME_S, 1.0), TIME_S, gain=gain, is_whole=False)
    assert (found.status, found.gain) == ("not_identifiable", None)
    assert "the commands repeat every 0.5 s with the other sign, so gains of 0." in found.reason
    assert "and -0." in found.reason
    assert found.reason.endswith("explain the motion alike")
    assert found.advice == "step the turn rate ten times for 2 s"


def test_pulses_are_known_up_to_their_period() -> None:
    pulses = switch(TIME_S, 1.0, low=0.0)
    whole = identify(pulses, TIME_S)
    assert whole.dead_time_s is not None
    assert whole.dead_time_s.value == pytest.approx(0.06, abs=0.005)
    part = identify(pulses, TIME_S, is_whole=False)
    assert "the commands repeat every 1 s, so gains of 0." in part.reason


def test_a_slow_wave_has_one_delay() -> None:
    # Half of its period is beyond the largest dead time.
    found = identify(switch(TIME_S, 4.0), TIME_S, is_whole=False)
    assert found.dead_time_s is not None
    assert found.dead_time_s.value == pytest.approx(0.06, abs=0.005)


@pytest.mark.parametrize(("odd", "repeats"), [(2, True), (4, False)])
def test_commands_that_are_hardly_alike_do_not_repeat(odd: int, repeats: bool) -> None:  # noqa: FBT001
    # Each of 28 waves that does not change its sign lowers the correlation by 2/28.
    value = switch(TIME_S, 1.0)
    for number in range(odd):
        value[100 * number + 100 : 100 * number + 120] = 1.0
    log = Log(duration_s=30.0, poses_hz=20.0)
    run = make_run(log, 5, (TIME_S, 0.0 * value), (TIME_S, value))
    assert (find_repetition([read_axis_motion(run, "turn_rate")]) is not None) == repeats


def test_one_step_does_not_repeat() -> None:
    value = np.where(TIME_S < 10.0, 0.0, 1.0)
    run = make_run(Log(duration_s=30.0, poses_hz=20.0), 5, (TIME_S, value), (TIME_S, value))
    for end_s in (12.0, 29.0):
        motion = read_axis_motion(run.slice(end_s=end_s), "turn_rate")
        assert find_repetition([motion]) is None
