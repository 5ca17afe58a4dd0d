"""A controller that a timer asks for answers: its grid, what it reads, what a block does to it."""

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pytest

from tests.effects_cases import build_case
from turtlelog.laws import Decision, Goal, Pose
from turtlelog.plants import TURTLESIM
from turtlelog.run import Run
from turtlelog.run.loops import Declaration
from turtlelog.run.paths import Path
from turtlelog.scenario import Scenario
from turtlelog.simulate import PlainLoop, SampleRow, TickRow, loop, simulate_run

TICK_NS = TURTLESIM.period_ns


@dataclass(frozen=True)
class _NoParameters:
    pass


class Blocking:
    """Blocks for some ticks at one sample."""

    Parameters: ClassVar = _NoParameters

    def __init__(self, at: int = -1, ticks: int = 0, stops_at: int = -1) -> None:
        self._at, self._ticks, self._stops_at, self._next = at, ticks, stops_at, 0

    @classmethod
    def declare(cls, parameters: Any, goal: Goal | None, path: Path | None) -> Declaration:
        del parameters, goal, path
        return Declaration(phases={"control": ()})

    def reset(self, start: Pose, goal: Goal | None, path: Path | None) -> None:
        pass

    def step(self, time_ns: int, pose: Pose) -> Decision:
        number, self._next = self._next, self._next + 1
        return Decision(
            speed_m_s=0.0,
            turn_rate_rad_s=0.0,
            phase="control",
            bearing_rad=0.0,
            heading_error_rad=0.0,
            error_x_m=pose.x_m,
            error_y_m=0.0,
            blocks_ticks=self._ticks if number == self._at else 0,
            stop_reason="end" if number == self._stops_at else None,
        )


def make_controller(law: Blocking, **changes: Any) -> PlainLoop:
    scenario: Scenario = build_case(**changes)
    law_choice = replace(scenario.law, parameters=None)
    return PlainLoop(replace(scenario, law=law_choice), law=law)


def run_controller(made: PlainLoop, ticks: int) -> tuple[list[SampleRow], list[SampleRow]]:
    """Return the samples computed and those published, each in the tick that owns its time."""
    now, rows = made.now, made.rows
    for tick in range(ticks):
        before, sent = now.samples, now.published
        row = rows.ticks[tick] = TickRow(float(tick))
        now.ticks += 1
        loop.send_pose(made.settings, made.state, rows, made.parts, row, tick)
        loop.answer_poses(made.settings, made.state, rows, made.parts, tick)
        times = [rows.samples[number].time_ns for number in range(before, now.samples)]
        times += [rows.samples[number].published_ns for number in range(sent, now.published)]
        assert all(tick == time_ns // TICK_NS for time_ns in times)
    samples = [rows.samples[number] for number in range(now.samples)]
    return samples, samples[: now.published]


def list_times_ms(samples: list[SampleRow]) -> list[float]:
    return [sample.time_ns / 1e6 for sample in samples]


def simulate_timer(period_s: float, **changes: Any) -> Run:
    return simulate_run(build_case("timer", loop__period_s=period_s, **changes))


def test_timer_fires_first_when_the_poses_it_waits_for_have_come() -> None:
    run = simulate_timer(0.03, loop__start_backlog=5, max_duration_s=0.2)
    assert run.samples.time_ns.tolist() == [64_000_000 + 30_000_000 * k for k in range(5)]


def test_firings_end_with_the_run() -> None:
    run = simulate_timer(0.05, max_duration_s=0.1)
    assert run.samples.time_ns.tolist() == [0, 50_000_000, 100_000_000]
    run = simulate_timer(0.05, max_duration_s=0.0999)
    assert run.samples.time_ns.tolist() == [0, 50_000_000]


@pytest.mark.parametrize(("period_s", "step"), [(0.008, 0.5), (0.016, 1.0), (0.04, 2.5)])
def test_timer_reads_the_newest_pose_twice_or_never(period_s: float, step: float) -> None:
    run = simulate_timer(period_s, max_duration_s=0.4)
    numbers = np.arange(len(run.samples))
    assert np.array_equal(run.samples.pose_sequence, np.floor(step * numbers))


def test_timer_reads_only_poses_that_have_arrived() -> None:
    run = simulate_timer(0.016, sensing__delay_s=0.0161, max_duration_s=0.4)
    late_ns = run.samples.time_ns - run.poses.time_ns[run.samples.pose_sequence]
    assert run.samples.time_ns[0] == 16_100_000
    assert set(late_ns.tolist()) == {16_100_000}
    run = simulate_timer(0.016, sensing__delay_s=0.016, max_duration_s=0.4)
    late_ns = run.samples.time_ns - run.poses.time_ns[run.samples.pose_sequence]
    assert set(late_ns.tolist()) == {16_000_000}


def test_one_firing_waits_while_the_law_blocks_then_the_grid_goes_on() -> None:
    timer: dict[str, Any] = {"loop__trigger": "timer", "loop__period_s": 0.01}
    controller = make_controller(Blocking(at=2, ticks=3), **timer)
    computed, published = run_controller(controller, 6)
    # Sample 2 at 20 ms blocks for 48 ms, until 68 ms; the grid is at 70 ms.
    assert list_times_ms(computed) == [0, 10, 20, 68, 70, 80, 90]
    assert [s.pose_sequence for s in computed] == [0, 0, 1, 4, 4, 5, 5]
    assert [s.published_ns / 1e6 for s in published] == [0, 10, 68, 68, 70, 80, 90]


def test_firing_at_the_end_of_a_block_is_answered_once() -> None:
    timer: dict[str, Any] = {"loop__trigger": "timer", "loop__period_s": 0.008}
    computed, _ = run_controller(make_controller(Blocking(at=0, ticks=2), **timer), 4)
    assert list_times_ms(computed) == [0, 32, 40, 48, 56]


def test_block_between_two_firings_leaves_the_grid_alone() -> None:
    timer: dict[str, Any] = {"loop__trigger": "timer", "loop__period_s": 0.05}
    computed, published = run_controller(make_controller(Blocking(at=0, ticks=2), **timer), 8)
    assert list_times_ms(computed) == [0, 50, 100]
    assert [s.published_ns / 1e6 for s in published] == [32, 50, 100]


def test_nothing_is_answered_after_the_end_though_the_tick_goes_on() -> None:
    timer: dict[str, Any] = {"loop__trigger": "timer", "loop__period_s": 0.004}
    computed, _ = run_controller(make_controller(Blocking(stops_at=2), **timer), 1)
    assert list_times_ms(computed) == [0, 4, 8]


def test_blocked_end_is_published_when_the_block_ends() -> None:
    timer: dict[str, Any] = {"loop__trigger": "timer", "loop__period_s": 0.004}
    controller = make_controller(Blocking(at=1, ticks=1, stops_at=1), **timer)
    computed, published = run_controller(controller, 2)
    assert list_times_ms(computed) == [0, 4]
    assert [s.published_ns / 1e6 for s in published] == [0, 20]


def test_delayed_poses_wait_while_the_law_blocks_and_come_in_one_burst() -> None:
    controller = make_controller(Blocking(at=1, ticks=3), sensing__delay_s=0.005)
    computed, published = run_controller(controller, 6)
    # Pose 1 arrives at 21 ms and blocks until 69 ms; pose 4, of 64 ms, arrives then as well.
    assert list_times_ms(computed) == [5, 21, 69, 69, 69, 85]
    assert [s.pose_sequence for s in computed] == [0, 1, 2, 3, 4, 5]
    assert [s.published_ns / 1e6 for s in published] == [5, 69, 69, 69, 69, 85]


def test_delayed_poses_beyond_the_queue_are_dropped() -> None:
    changes: dict[str, Any] = {"sensing__delay_s": 0.005, "loop__pose_queue": 2}
    controller = make_controller(Blocking(at=0, ticks=5), **changes)
    computed, _ = run_controller(controller, 7)
    assert [s.pose_sequence for s in computed] == [0, 4, 5, 6]
    assert controller.now.poses_dropped == 3
