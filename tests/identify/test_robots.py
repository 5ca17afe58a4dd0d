"""Robots that others recorded, turtlesim, and simulated ones."""

import math

import pytest

import turtlelog as tl
from tests.known import known
from tests.log.runs import find_shared
from turtlelog.identify import Estimate

TB3 = {
    ("log", "speed"): (87.0, 15.0, 80.0, 19.0),
    ("stamp", "speed"): (80.0, 11.0, 83.0, 19.0),
    ("log", "turn_rate"): (57.0, 28.0, 94.0, 42.0),
    ("stamp", "turn_rate"): (67.0, 32.0, 67.0, 43.0),
}
"""Dead time and lag with their intervals of 95 % [ms], by another fit: a grid and soft L1."""


@pytest.mark.everyday("log-speed", "stamp-turn_rate")
@pytest.mark.parametrize(("clock", "axis"), TB3)
def test_a_real_turtlebot_has_the_delays_that_another_fit_found(clock: str, axis: str) -> None:
    run = tl.read_run(find_shared("robots", "tb3"), time=clock)  # type: ignore[arg-type]
    found = getattr(tl.identify_robot(run), axis)
    dead_time_ms, apart_ms, lag_ms, lag_apart_ms = TB3[clock, axis]
    assert agrees(found.dead_time_s, 1e-3 * dead_time_ms, 1e-3 * apart_ms)
    assert agrees(found.lag_s, 1e-3 * lag_ms, 1e-3 * lag_apart_ms)
    assert 0.13 - 0.01 <= found.total_delay_s.value <= 0.17 + 0.01
    assert found.total_delay_s.high - found.total_delay_s.low < found.total_delay_s.value


def agrees(found: Estimate, value: float, apart: float) -> bool:
    """Return whether two values differ by what both intervals allow, but for 1 ms of rounding.

    The other fit knows of no bound, which the speed of this robot has.
    """
    allowed = math.hypot(apart, found.high - found.value)
    return abs(found.value - value) <= allowed + 1e-3 and found.low <= value <= found.high


def test_ramps_in_half_of_a_real_drive_tell_no_speed() -> None:
    run = tl.read_run(find_shared("robots", "tb3"))
    model = tl.identify_robot(run.slice(end_s=(run.end_ns - run.start_ns) / 2e9))
    # It speeds up by 5 mm/s at a time, which shows no beginning.
    assert "commanded in ramps" in model.speed.reason
    assert model.turn_rate.is_known


def test_turtlesim_tells_which_tick_took_which_command() -> None:
    run = tl.simulate_run(tl.load_scenario("textbook"))
    model = tl.identify_robot(run)
    delays = known(model.tick_delays)
    assert (delays.least_s, delays.median_s, delays.largest_s) == (0.016, 0.016, 0.016)
    for axis in model.axes:
        assert (axis.status, known(axis.gain).value, known(axis.lag_s).value) == ("ok", 1.0, 0.0)
        assert known(axis.dead_time_s).value == 0.0


def test_each_axis_of_turtlesim_has_the_dead_time_that_the_metrics_measure() -> None:
    run = tl.simulate_run(tl.load_scenario("paper-kp10"))
    model, metrics = tl.identify_robot(run), tl.measure_run(run)
    for axis, loop in ((model.turn_rate, "rotate"), (model.speed, "translate")):
        assert known(axis.dead_time_s).value == pytest.approx(metrics[f"{loop}.dead_time"].value)


@pytest.mark.parametrize("ticks", [0, 3])
def test_a_transport_delay_of_turtlesim_is_found_in_ticks(ticks: int) -> None:
    scenario = tl.override_scenario(
        tl.load_scenario("textbook"), {"loop.transport_delay_ticks": ticks}, source="test"
    )
    delays = known(tl.identify_robot(tl.simulate_run(scenario)).tick_delays)
    assert delays.median_s == pytest.approx(0.016 * (ticks + 1))


def test_a_bag_of_turtlesim_is_exact() -> None:
    run = tl.read_run(find_shared("ros2", "turtlesim_jazzy"))
    delays = known(tl.identify_robot(run).tick_delays)
    assert (delays.shown, delays.commands) == (18, 18)
    assert 0.0 <= delays.least_s < delays.median_s < delays.largest_s < 0.0165


def test_a_simulated_robot_with_a_lag_is_found() -> None:
    changes = {"law.signal": "prbs", "plant.turn_gain": 0.9}
    scenario = tl.override_scenario(
        tl.load_scenario("lagged"), {"law.kind": "open-loop"}, source=""
    )
    run = tl.simulate_run(tl.override_scenario(scenario, changes, source="test"))
    found = tl.identify_robot(run).turn_rate
    assert known(found.gain).value == pytest.approx(0.9, abs=1e-5)
    assert known(found.dead_time_s).value == pytest.approx(0.08, abs=1e-5)
    assert known(found.lag_s).value == pytest.approx(0.1, abs=1e-5)


def test_an_estimate_compares_as_its_value_and_shows_its_interval() -> None:
    found = Estimate(value=0.12, low=0.1, high=0.14)
    assert found < 0.15
    assert found > 0.11
    assert found <= 0.12
    assert found >= 0.12
    assert not found < 0.12
    assert repr(found) == "<0.12 s, 0.1 to 0.14>"
    assert repr(Estimate(value=1.0, low=0.9, high=1.1, unit="1")) == "<1, 0.9 to 1.1>"
