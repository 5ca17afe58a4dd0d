"""All effects together: every pair runs, runs repeat, and no stream hangs on another."""

from itertools import combinations
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.effects_cases import EFFECTS, RANDOM, SENSED, SHAPED, build_case
from turtlelog.run import Run
from turtlelog.scenario import format_scenario, parse_scenario
from turtlelog.simulate import simulate_run
from turtlelog.simulate.loop_parts import list_streams

PAIRS = list(combinations(EFFECTS, 2))


def simulate_pair(*effects: str, **changes: Any) -> Run:
    """Simulate 1.6 s from a start at which the goal is almost ahead, so that both phases occur."""
    start: dict[str, Any] = {"start__heading_rad": 2.2, "max_duration_s": 1.6}
    return simulate_run(build_case(*effects, **(start | changes)))


def list_columns(run: Run) -> list[bytes]:
    """Return the bytes of all columns and the texts of all events."""
    tables = (run.poses, run.commands, run.samples)
    values = [getattr(table, name) for table in tables for name in table.__slots__]
    texts = [f"{event.time_ns} {event.text}".encode() for event in run.events]
    return [value.tobytes() for value in values if value is not None] + texts


def draw(number: int, count: int, width: int = 1, *, normal: bool = False) -> NDArray[np.float64]:
    """Return what the stream of an effect begins with, drawn apart from the loop."""
    sequence = np.random.SeedSequence(0, spawn_key=(number,))
    generator = np.random.Generator(np.random.PCG64(sequence))
    drawn = generator.standard_normal if normal else generator.random
    return drawn((count, width)) if width > 1 else drawn(count)


@pytest.mark.parametrize("effects", PAIRS, ids="-".join)
def test_every_pair_of_effects_runs(effects: tuple[str, str]) -> None:
    run = simulate_pair(*effects)
    assert len(run.samples) > 10
    assert run.poses.time_ns[-1] >= 1_550_000_000
    assert (run.poses.sensed_xy_m is None) == SENSED.isdisjoint(effects)
    assert (run.samples.shaped_speed_m_s is None) == SHAPED.isdisjoint(effects)
    assert (np.diff(run.samples.sequence) == 1).all()
    assert (np.diff(run.samples.pose_sequence) >= 0).all()
    assert (run.samples.time_ns >= run.poses.time_ns[run.samples.pose_sequence]).all()
    # Where the law blocks its command goes out later: here it never does.
    assert np.array_equal(run.commands.time_ns, run.samples.time_ns)


@pytest.mark.parametrize("effect", EFFECTS)
def test_each_effect_changes_the_run_and_repeats(effect: str) -> None:
    run, again = (simulate_pair(effect) for _ in range(2))
    assert list_columns(run) == list_columns(again)
    without: dict[str, Any] = {
        "loop__queue_policy": EFFECTS[effect].get("loop.queue_policy", "newest")
    }
    assert list_columns(run) != list_columns(simulate_pair(**without))
    other = list_columns(simulate_pair(effect, seed=1))
    assert (other != list_columns(run)) == (effect in RANDOM)
    assert bool(list_streams(build_case(effect))) == (effect in RANDOM)


def test_each_stream_is_the_same_whatever_else_is_on() -> None:
    run = simulate_pair(*(RANDOM - {"sensing_jitter"}), start__x_m=3.0, start__y_m=3.0)
    poses, count = run.poses, len(run.poses)
    assert poses.sensed_xy_m is not None
    lost = np.isnan(poses.sensed_xy_m).any(axis=1)
    assert np.array_equal(lost, draw(1, count) < 0.2)
    is_outlier = draw(2, count, 3)[:, 0] < 0.05
    left = (poses.sensed_xy_m - poses.xy_m)[~lost & ~is_outlier]
    noise = 0.01 * draw(0, count, 3, normal=True)[~lost & ~is_outlier, :2]
    assert np.abs(left - noise).max() < 1e-6
    lost_commands = draw(5, len(run.commands)) < 0.2
    told = [event for event in run.events if event.kind == "commands_lost"]
    assert sum(int(event.text.split()[3]) for event in told) == lost_commands.sum()


def test_all_effects_together_run_twice_alike() -> None:
    runs = [simulate_pair(*EFFECTS, loop__queue_policy="one-per-tick") for _ in range(2)]
    assert list_columns(runs[0]) == list_columns(runs[1])


@pytest.mark.parametrize("effect", EFFECTS)
def test_scenario_with_an_effect_is_written_and_read(effect: str) -> None:
    scenario = build_case(effect)
    assert parse_scenario(format_scenario(scenario)) == scenario


def test_pause_of_the_law_counts_periods_of_the_lagged_robot() -> None:
    law: dict[str, Any] = {"law__pause_ticks": 7, "law__heading_tolerance_rad": 0.05}
    run = simulate_run(build_case("lagged", **law))
    blocked = np.flatnonzero(run.commands.time_ns != run.samples.time_ns)
    assert len(blocked) == 1
    paused_ns = run.commands.time_ns[blocked[0]] - run.samples.time_ns[blocked[0]]
    assert paused_ns == 7 * 50_000_000
