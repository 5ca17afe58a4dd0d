"""What becomes of commands between controller and plant."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.effects_cases import build_case
from turtlelog.run import Run
from turtlelog.simulate import simulate_run


def simulate_numbers(count: int = 600, **changes: Any) -> Run:
    """Send the commands 1, 2, 3 ... [mm/s], one per pose, so that each names itself."""
    times = tuple(0.016 * number for number in range(count + 1))
    speeds = tuple(0.001 * number for number in range(1, count + 1))
    law: dict[str, Any] = {
        "law__kind": "open-loop",
        "law__signal": "sequence",
        "law__time_s": times,
        "law__speed_m_s": (*speeds, 0.0),
        "start__x_m": 0.1,
    }
    return simulate_run(build_case(**law, **changes))


def read_numbers(run: Run) -> NDArray[np.int64]:
    """Return the number of the command that each step applied, 0 for none."""
    assert run.poses.speed_m_s is not None
    return np.round(1000.0 * run.poses.speed_m_s).astype(np.int64)


def draw_uniform(number: int, count: int) -> NDArray[np.float64]:
    """Return what the stream of an effect begins with, drawn apart from the loop."""
    sequence = np.random.SeedSequence(0, spawn_key=(number,))
    return np.random.Generator(np.random.PCG64(sequence)).random(count)


@pytest.mark.parametrize(
    ("ticks", "delay_s", "dead_time"),
    [
        (0, 0.0, 0),
        (0, 0.015999999, 0),
        (0, 0.016, 1),
        (6, 0.0, 6),
        (0, 0.096, 6),
        (0, 0.095999999, 5),
        (0, 0.111999999, 6),
        (3, 0.048, 6),
        (3, 0.047999999, 5),
    ],
)
def test_dead_time_is_the_delay_in_whole_ticks(ticks: int, delay_s: float, dead_time: int) -> None:
    delays: dict[str, Any] = {
        "loop__transport_delay_ticks": ticks,
        "loop__transport_delay_s": delay_s,
    }
    applied = read_numbers(simulate_numbers(20, **delays))
    assert not applied[: 1 + dead_time].any()
    assert np.array_equal(applied[1 + dead_time :], np.arange(1, len(applied) - dead_time))


def test_lost_commands_are_published_and_never_arrive() -> None:
    run = simulate_numbers(loop__loss_probability=0.3)
    is_lost = draw_uniform(5, 601)[: len(run.commands)] < 0.3
    assert abs(is_lost.mean() - 0.3) < 4.0 * math.sqrt(0.3 * 0.7 / len(is_lost))
    assert len(run.commands) == len(run.samples) == len(run.poses) == 601
    arrived = np.where(is_lost, 0, np.arange(1, 602))[:-1]
    assert np.array_equal(read_numbers(run)[1:], np.maximum.accumulate(arrived))
    events = [event for event in run.events if event.kind == "commands_lost"]
    assert len(events) == np.count_nonzero(np.diff(is_lost.astype(int), prepend=0) == 1)
    assert sum(int(event.text.split()[3]) for event in events) == is_lost.sum()


def test_commands_without_a_loss_are_those_of_a_loop_without_transport() -> None:
    steady = read_numbers(simulate_numbers(50))
    assert np.array_equal(read_numbers(simulate_numbers(50, loop__jitter_s=1e-9)), steady)


@pytest.mark.parametrize("policy", ["one-per-tick", "newest"])
def test_jittered_commands_never_overtake(policy: str) -> None:
    jitter: dict[str, Any] = {"loop__jitter_s": 0.08, "loop__queue_policy": policy}
    run = simulate_numbers(**jitter)
    applied = read_numbers(run)
    assert (np.diff(applied) >= 0).all()
    arrivals_ns = run.commands.time_ns + np.round(0.08e9 * draw_uniform(4, len(run.commands)))
    arrivals_ns = np.maximum.accumulate(arrivals_ns)
    if policy == "newest":
        newest = np.searchsorted(arrivals_ns, run.poses.time_ns, side="left")
        assert np.array_equal(applied, newest)


def test_late_command_holds_up_those_behind_it() -> None:
    run = simulate_numbers(200, loop__late_probability=0.05, loop__late_s=0.07)
    is_late = draw_uniform(7, len(run.commands)) < 0.05
    assert 0 < is_late.sum() < 20
    arrivals_ns = np.maximum.accumulate(run.commands.time_ns + 70_000_000 * is_late)
    newest = np.searchsorted(arrivals_ns, run.poses.time_ns, side="left")
    assert np.array_equal(read_numbers(run), newest)
    # Late by 70 ms is 4 ticks more: the command before it holds for five steps.
    late = int(np.flatnonzero(is_late)[0])
    assert np.count_nonzero(read_numbers(run) == late) == 5


def test_lagged_robot_takes_late_commands_and_those_behind_them_at_one_time() -> None:
    changes: dict[str, Any] = {"loop__late_probability": 0.05, "loop__late_s": 0.07}
    plant: dict[str, Any] = {"plant__kind": "lagged", "plant__period_s": 0.016}
    run = simulate_numbers(200, **changes, **plant, loop__pose_precision="float64")
    is_late = draw_uniform(7, len(run.commands)) < 0.05
    arrivals_ns = np.maximum.accumulate(run.commands.time_ns + 70_000_000 * is_late)
    time_s, begins_s = run.poses.time_ns / 1e9, arrivals_ns / 1e9
    held_s = np.diff(np.minimum(np.append(begins_s, 1e9), time_s[:, None]), axis=1)
    moved = run.poses.xy_m[:, 0] - run.poses.xy_m[0, 0]
    assert np.abs(moved - held_s @ run.commands.speed_m_s).max() < 1e-9


def test_repeated_command_is_taken_twice_where_one_is_taken_per_tick() -> None:
    changes: dict[str, Any] = {
        "loop__repeat_probability": 0.1,
        "loop__queue_policy": "one-per-tick",
    }
    run = simulate_numbers(40, **changes)
    is_repeated = draw_uniform(6, 41)[:40] < 0.1
    assert 0 < is_repeated.sum() < 7
    queue = np.repeat(np.arange(1, 41), 1 + is_repeated)
    assert np.array_equal(read_numbers(run)[1:], queue[: len(run.poses) - 1])


def test_dropped_commands_are_one_event_per_stretch() -> None:
    changes: dict[str, Any] = {
        "loop__repeat_probability": 0.5,
        "loop__queue_policy": "one-per-tick",
    }
    run = simulate_numbers(400, **changes)
    events = [event for event in run.events if event.kind == "commands_dropped"]
    assert len(events) == 1
    # Each of 400 steps takes one of the 400 commands that came before and their repetitions; after
    # the last one six wait.
    dropped = int((draw_uniform(6, 400) < 0.5).sum()) - 6
    assert events[0].text.startswith(f"The plant's queue dropped {dropped} commands from ")
    assert events[0].time_ns == run.poses.time_ns[-1]
