"""The period of a plant is a value: a finer clock is the same plant."""

from dataclasses import replace

import numpy as np
import pytest

from turtlelog.plants import TURTLESIM, Turtle
from turtlelog.plants.turtlesim import TICK_NS, TICK_S, WORLD_SIZE_M
from turtlelog.scenario import Scenario, get_preset
from turtlelog.simulate import simulate_run

FINE = TURTLESIM.refine(8)


def test_turtlesim_ticks_every_16_ms_in_its_world() -> None:
    assert (TURTLESIM.period_ns, TURTLESIM.period_s, TURTLESIM.steps_per_tick) == (
        TICK_NS,
        TICK_S,
        1,
    )
    assert (TURTLESIM.low_m, TURTLESIM.high_m) == (0.0, WORLD_SIZE_M)


def test_a_finer_clock_has_the_same_facts() -> None:
    assert (FINE.period_ns, FINE.period_s, FINE.steps_per_tick) == (2_000_000, 0.002, 8)
    assert replace(FINE, period_ns=TICK_NS, steps_per_tick=1) == TURTLESIM


def test_a_clock_that_no_whole_nanosecond_makes_is_refused() -> None:
    with pytest.raises(ValueError, match="expected a divisor of 16000000 ns, found 3"):
        TURTLESIM.refine(3)


def test_a_finer_step_moves_an_eighth() -> None:
    coarse, fine = (Turtle(x_m=5.0, y_m=5.0, plant=plant) for plant in (TURTLESIM, FINE))
    for turtle in (coarse, fine):
        turtle.take_command(1.0, 0.0)
    coarse.step()
    for _ in range(8):
        fine.step()
    assert fine.state[0] == pytest.approx(coarse.state[0], abs=1e-14)


@pytest.mark.parametrize("plant", [TURTLESIM, FINE], ids=["16 ms", "2 ms"])
def test_the_watchdog_waits_for_a_second_whatever_the_clock(plant: object) -> None:
    period_ns = 2_000_000 if plant is FINE else TICK_NS
    turtle = Turtle(x_m=5.0, y_m=5.0, plant=FINE if plant is FINE else TURTLESIM)
    turtle.take_command(0.0, 0.1)
    steps = 0
    while turtle.turn_rate_rad_s:
        turtle.step()
        steps += 1
    # The step that takes the command is the first of those that hold it.
    assert (steps - 2) * period_ns <= 1_000_000_000 < (steps - 1) * period_ns


def find_silence_s(scenario: Scenario, *, steps_per_tick: int) -> float:
    run = simulate_run(scenario, TURTLESIM.refine(steps_per_tick))
    pause = next(span for span in run.find_phase_spans() if span.phase == "pause")
    return (pause.end_ns - pause.start_ns) / 1e9


def test_a_law_blocks_for_as_long_whatever_the_clock() -> None:
    scenario = get_preset("paper-kp10")
    silences = [find_silence_s(scenario, steps_per_tick=steps) for steps in (1, 8)]
    assert silences == [33 * TICK_S, 33 * TICK_S]


def test_the_standard_clock_is_the_default() -> None:
    scenario = get_preset("paper-kp4")
    usual, named = simulate_run(scenario), simulate_run(scenario, TURTLESIM)
    assert np.array_equal(usual.poses.xy_m, named.poses.xy_m)
    assert np.array_equal(usual.poses.time_ns, named.poses.time_ns)
