"""Both faces of the rules for a loop's segment, bit for bit: numpy's and the compiled loop's."""

import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, Final

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.measure.test_reductions import tell
from tests.simulate.random_scenarios import build_random
from turtlelog import arithmetic
from turtlelog.measure import find_first_stretch, loop_segment
from turtlelog.measure.loop_segment import (
    Aim,
    LoopNumbers,
    Ticks,
    count_until,
    find_last_acting,
    find_segment,
    number_loop,
)
from turtlelog.measure.references import LastPose, find_last_heading_error
from turtlelog.run import angles
from turtlelog.simulate import simulate_run
from turtlelog.simulate.compiled_twins import take_twin

PERIOD_NS = 10


def draw_phases(seed: int, count: int) -> NDArray[np.int64]:
    random = np.random.default_rng(seed)
    return np.repeat(random.integers(0, 4, count), random.integers(1, 4, count))


def list_calls(seed: int) -> list[tuple[Callable[..., Any], tuple[Any, ...]]]:
    """Return what each rule with two faces is asked; each face gets arrays of its own."""
    random, phase = np.random.default_rng(seed), draw_phases(seed, 6)
    turned_rad = np.cumsum(random.normal(size=40)) * 2.0
    read, column = np.sort(random.integers(0, 40, 9)), random.normal(size=9)
    column[random.random(9) < 0.4] = math.nan
    column[4] = 1.0
    return [
        *((loop_segment.find_phase, (phase, first, 0b0101)) for first in range(len(phase) + 1)),
        (loop_segment.find_phase, (phase, 0, ~0b0101)),
        *((loop_segment.find_last_phase, (phase, mask)) for mask in (0b0010, 0b1000, 0)),
        (loop_segment.unwrap, (turned_rad.copy(),)),
        (loop_segment.follow_error, (turned_rad.copy(),)),
        (loop_segment.subtract_from, (0.3, turned_rad, np.empty(40))),
        (loop_segment.hold_column, (column, read, 40, np.empty(40))),
        *((loop_segment.find_last_beyond, (turned_rad, limit)) for limit in (1.0, 1e9)),
        *((angles.choose, (is_one, 1.0, 2.0)) for is_one in (True, False)),
    ]


OF_TIMES = {loop_segment.count_until, vars(loop_segment)["_ends_usual_step"]}
"""Rules that take `Ticks` instead of an array."""


@pytest.mark.parametrize("seed", range(20))
def test_a_loop_finds_what_numpy_finds(seed: int) -> None:
    for (function, arguments), (_, own) in zip(list_calls(seed), list_calls(seed), strict=True):
        loop = take_twin(function)
        assert loop is not function
        assert tell(loop(*own)) == tell(function(*arguments)), function.__name__


def test_every_rule_with_two_faces_is_compared() -> None:
    compared = {function for function, _ in list_calls(0)} | OF_TIMES
    marked = {
        one
        for module in (loop_segment, angles)
        for one in vars(module).values()
        if hasattr(one, "twin") and one.__module__ == module.__name__
    }
    assert marked == compared


@pytest.mark.parametrize("first", [0, 3])
def test_regular_times_are_counted_as_an_array_of_them(first: int) -> None:
    ticks, times_ns = Ticks(PERIOD_NS, first, 5), np.arange(first, first + 5) * PERIOD_NS
    for time_ns in range(-1, 100):
        assert take_twin(count_until)(ticks, time_ns) == count_until(times_ns, time_ns)
    for row in range(1, 6):
        is_usual = vars(loop_segment)["_ends_usual_step"]
        assert take_twin(is_usual)(ticks, row) == is_usual(times_ns, row)


@pytest.mark.parametrize("seed", range(30))
def test_the_segment_is_the_first_one_of_its_phases_with_the_pauses_between(seed: int) -> None:
    phase = draw_phases(seed, 8)
    samples = SimpleNamespace(phase=phase, time_ns=np.arange(len(phase)) * 7)
    loop, run_end_ns = LoopNumbers(0b0011, 0b0100, 0, 0, turns=True), 7 * len(phase)
    found = find_segment(samples, np.arange(40) * PERIOD_NS, loop, run_end_ns)
    own = [row for row, one in enumerate(phase) if one in {0, 1}]
    if not own:
        assert found.first_sample == found.after_sample == len(phase)
        return
    others = [row for row, one in enumerate(phase) if row > own[0] and one == 3]
    end = others[0] if others else len(phase)
    assert (found.first_sample, found.start_ns) == (own[0], 7 * own[0])
    assert found.is_last == (end == len(phase))
    assert found.end_ns == 7 * end
    after = next((row for row in range(own[0], len(phase)) if phase[row] > 1), len(phase))
    assert found.after_sample == after
    assert (found.first, found.after) == (7 * own[0] // PERIOD_NS, 7 * end // PERIOD_NS + 1)


def test_the_loop_that_acted_last_is_found_among_the_known_ones() -> None:
    loops = [LoopNumbers(phases, 0b1000, 0, 0, turns=True) for phases in (0b001, 0b010, 0b010)]
    phase = np.array([0, 1, 1, 2])
    found = [find_last_acting(phase, loops, known) for known in (0b111, 0b101, 0b001, 0b000)]
    assert found == [1, 2, 0, -1]
    assert find_last_acting(phase[3:], loops, 0b110) == 1


TURNED: Final = LastPose(1.0, 1.0, -3.1, 2.0 * math.pi - 3.1, 0.5)
"""A last pose whose heading passed half a turn."""


@pytest.mark.parametrize(
    ("reference", "goal_heading_rad", "wanted_rad"),
    [
        ("zero", 1.0, -(2.0 * math.pi - 3.1)),
        ("goal_bearing", 1.0, 0.25 - (2.0 * math.pi - 3.1)),
        ("bearing_now", 1.0, 1.0 + 3.1),
        ("bearing_now", math.nan, math.pi / 2.0 - (2.0 * math.pi - 3.1)),
        ("recorded", 1.0, 0.5 - (2.0 * math.pi - 3.1)),
    ],
)
def test_the_heading_at_the_end_is_held_to_the_reference_of_the_last_loop(
    reference: str, goal_heading_rad: float, wanted_rad: float
) -> None:
    number = loop_segment.REFERENCES.index(reference)
    loops = [LoopNumbers(0b1, 0b10, loop_segment.HEADING, number, turns=True)]
    aim = Aim(0.0, 0.0, 1.0, 0.0, 1.0, 0.25, 1.0, 2.0, goal_heading_rad)
    found_rad = find_last_heading_error(np.array([0, 1]), loops, aim, TURNED)
    assert found_rad.hex() == arithmetic.wrap_angle(wanted_rad).hex()


@pytest.mark.parametrize(("reference", "phase"), [("zero", []), ("goal_heading", [0, 1])])
def test_no_samples_or_no_reference_leave_the_heading_at_the_end_unjudged(
    reference: str, phase: list[int]
) -> None:
    number = loop_segment.REFERENCES.index(reference)
    loops = [LoopNumbers(0b1, 0b10, loop_segment.HEADING, number, turns=True)]
    aim = Aim(0.0, 0.0, 1.0, 0.0, 1.0, 0.25, 1.0, 2.0, math.nan)
    assert math.isnan(find_last_heading_error(np.array(phase, np.int64), loops, aim, TURNED))


@pytest.mark.parametrize("seed", range(8))
def test_the_segment_lasts_as_long_as_the_first_spans_of_its_phases(seed: int) -> None:
    run = simulate_run(build_random(seed))
    for loop in run.declaration.loops:
        numbers = number_loop(run.declaration, loop)
        found = find_segment(run.samples, run.poses.time_ns, numbers, run.end_ns)
        spans = find_first_stretch(run, loop)
        assert (found.first_sample < found.after_sample) == bool(spans)
        if spans:
            assert (found.start_ns, found.end_ns) == (spans[0].start_ns, spans[-1].end_ns)
