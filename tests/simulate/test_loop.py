import math
from functools import cache
from typing import Any

import numpy as np
import pytest

from tests.known import known
from tests.sequential import ROTATE, TRANSLATE
from turtlelog.plants.turtlesim import TICK_NS
from turtlelog.run import Run
from turtlelog.scenario import Scenario, get_preset, override_scenario
from turtlelog.simulate import iterate_ticks, simulate_run
from turtlelog.simulate.rows import EventRow, SampleRow, TickRow, find_maker

BACKLOGS = {"paper-kp1": 6, "paper-kp2": 5, "paper-kp4": 6, "paper-kp10": 5}
PAUSES = {"paper-kp1": 34, "paper-kp2": 34, "paper-kp4": 34, "paper-kp10": 33}


@cache
def simulate_preset(name: str) -> Run:
    return simulate_run(get_preset(name))


def change_preset(name: str, **values: Any) -> Scenario:
    dotted = {key.replace("__", "."): value for key, value in values.items()}
    return override_scenario(get_preset(name), dotted)


def simulate_change(name: str, **values: Any) -> Run:
    return simulate_run(change_preset(name, **values))


def find_dead_times(run: Run, phase: int) -> list[int]:
    """Return the delays [ticks] with which the applied column follows the commands exactly."""
    samples, rotating = run.samples, phase == ROTATE
    command = samples.turn_rate_rad_s if rotating else samples.speed_m_s
    applied = run.poses.turn_rate_rad_s if rotating else run.poses.speed_m_s
    assert applied is not None
    # Saturated commands are all alike, and those of the burst are partly lost.
    alone = run.poses.time_ns[samples.pose_sequence] == samples.time_ns
    tells = (samples.phase == phase) & alone & (np.abs(command) < 1.0) & (command != 0.0)
    read = samples.pose_sequence[tells]
    expected = command[tells] if rotating else np.abs(command[tells])
    last = len(run.poses) - 1
    return [
        delay
        for delay in range(30)
        if np.array_equal(
            applied[np.minimum(read + delay + 1, last)][read + delay < last],
            expected[read + delay < last].astype(np.float32),
        )
    ]


@pytest.mark.parametrize(("name", "start_backlog"), BACKLOGS.items())
def test_dead_time_while_rotating_comes_from_the_start_backlog(
    name: str, start_backlog: int
) -> None:
    assert find_dead_times(simulate_preset(name), ROTATE) == [start_backlog - 1]


@pytest.mark.parametrize("name", BACKLOGS)
def test_dead_time_while_translating_is_six_ticks(name: str) -> None:
    assert find_dead_times(simulate_preset(name), TRANSLATE) == [6]


@pytest.mark.parametrize("phase", [ROTATE, TRANSLATE])
def test_textbook_has_no_dead_time(phase: int) -> None:
    assert find_dead_times(simulate_preset("textbook"), phase) == [0]


@pytest.mark.parametrize("phase", [ROTATE, TRANSLATE])
@pytest.mark.parametrize("ticks", [1, 3, 8])
def test_dead_time_of_the_textbook_is_the_transport_delay(ticks: int, phase: int) -> None:
    run = simulate_change("textbook", loop__transport_delay_ticks=ticks)
    assert find_dead_times(run, phase) == [ticks]


@pytest.mark.parametrize("start_backlog", [1, 2, 7, 9])
def test_dead_time_is_at_most_what_the_command_queue_holds(start_backlog: int) -> None:
    run = simulate_change("paper", loop__start_backlog=start_backlog)
    assert find_dead_times(run, ROTATE) == [min(start_backlog, 7) - 1]


@pytest.mark.parametrize("depth", [1, 3, 9])
def test_burst_fills_the_command_queue(depth: int) -> None:
    run = simulate_change("paper", loop__command_queue=depth)
    assert find_dead_times(run, TRANSLATE) == [depth - 1]


def test_newest_command_wins_over_every_backlog() -> None:
    run = simulate_change("paper", loop__queue_policy="newest")
    assert find_dead_times(run, ROTATE) == find_dead_times(run, TRANSLATE) == [0]


def test_transport_adds_to_the_backlog() -> None:
    run = simulate_change("paper-kp10", loop__transport_delay_ticks=3)
    assert find_dead_times(run, ROTATE) == [4 + 3]


@pytest.mark.parametrize(("name", "start_backlog"), BACKLOGS.items())
def test_controller_starts_with_its_backlog(name: str, start_backlog: int) -> None:
    samples = simulate_preset(name).samples
    assert (samples.time_ns == samples.time_ns[0]).sum() == start_backlog
    assert samples.time_ns[0] == (start_backlog - 1) * TICK_NS
    assert samples.pose_sequence[: start_backlog + 2].tolist() == list(range(start_backlog + 2))


@pytest.mark.parametrize(("name", "pause_ticks"), PAUSES.items())
def test_pause_holds_its_command_and_ends_in_a_burst(name: str, pause_ticks: int) -> None:
    run = simulate_preset(name)
    last = int(np.flatnonzero(run.samples.phase == ROTATE)[-1])
    back_ns = run.samples.time_ns[last] + pause_ticks * TICK_NS
    assert (run.samples.time_ns[last + 1 : last + 11] == back_ns).all()
    assert (run.commands.time_ns == back_ns).sum() == 11
    assert run.samples.time_ns[last + 11] == back_ns + TICK_NS


@pytest.mark.parametrize(("name", "pause_ticks"), PAUSES.items())
def test_burst_answers_the_last_ten_poses(name: str, pause_ticks: int) -> None:
    samples = simulate_preset(name).samples
    last = int(np.flatnonzero(samples.phase == ROTATE)[-1])
    newest = samples.pose_sequence[last] + pause_ticks
    assert samples.pose_sequence[last + 1 : last + 11].tolist() == list(
        range(newest - 9, newest + 1)
    )


def test_turtle_keeps_turning_with_the_last_queued_command_during_the_pause() -> None:
    run = simulate_preset("paper-kp10")
    turn_rate = run.poses.turn_rate_rad_s
    assert turn_rate is not None
    last = int(np.flatnonzero(run.samples.phase == ROTATE)[-1])
    row = int(run.samples.pose_sequence[last])
    held = np.float32(run.samples.turn_rate_rad_s[last - 1])
    assert held != 0.0
    assert (turn_rate[row + 5 : row + 34] == held).all()
    assert turn_rate[row + 34] == 0.0


def test_watchdog_stops_the_turtle_in_a_long_pause() -> None:
    run = simulate_change("textbook", law__pause_ticks=100)
    last = int(np.flatnonzero(run.samples.phase == ROTATE)[-1])
    row = int(run.samples.pose_sequence[last])
    turn_rate = run.poses.turn_rate_rad_s
    assert turn_rate is not None
    # The tick that published pose `row` took the last command before the pause.
    assert (turn_rate[row : row + 63] != 0.0).all()
    assert (turn_rate[row + 63 : row + 101] == 0.0).all()


@pytest.mark.parametrize("name", BACKLOGS)
def test_turtle_stands_still_before_the_controller_answers(name: str) -> None:
    run = simulate_preset(name)
    waits = run.poses.time_ns <= run.start_ns
    assert (run.poses.xy_m[waits] == run.poses.xy_m[0]).all()
    assert (run.poses.heading_rad[waits] == 0.0).all()


def test_events_tell_what_the_full_queues_dropped() -> None:
    run = simulate_preset("paper-kp10")
    pause = run.find_phase_spans()[1]
    assert [(event.kind, event.time_ns) for event in run.events] == [
        ("poses_dropped", pause.end_ns),
        ("commands_dropped", pause.end_ns),
        ("stop", run.end_ns),
    ]
    assert "dropped 23 poses" in run.events[0].text
    assert "dropped 4 commands" in run.events[1].text
    assert run.events[2].text == "The run ended: standstill."


def test_textbook_drops_nothing() -> None:
    assert [event.kind for event in simulate_preset("textbook").events] == ["stop"]


def test_wall_hit_is_told_once_per_contact() -> None:
    run = simulate_change("textbook", law__kp_linear=150.0, limits__speed_m_s=math.inf)
    hits = [event for event in run.events if event.kind == "wall_hit"]
    on_wall = ((run.poses.xy_m == 0.0) | (run.poses.xy_m > 11.0888)).any(axis=1)
    contacts = int((np.diff(on_wall.astype(int)) == 1).sum())
    assert len(hits) == contacts > 0
    assert hits[0].text.startswith("The turtle hit the wall at x = ")


def test_turtle_that_presses_on_a_wall_hits_it_once() -> None:
    start = {"start__x_m": 9.0, "start__y_m": 9.0, "goal__x_m": 11.0, "goal__y_m": 11.0}
    # So wide a tolerance lets it drive along its first heading, past the goal.
    run = simulate_change("paper", law__heading_tolerance_rad=1.0, max_duration_s=10.0, **start)
    assert (run.poses.xy_m[-100:, 0] > 11.0888).all()
    assert [event.kind for event in run.events].count("wall_hit") == 1


def test_tolerance_stop_sends_zero() -> None:
    run = simulate_preset("paper-kp2")
    assert run.stop_reason == "within_tolerance"
    assert run.commands.speed_m_s[-1] == 0.0 != run.commands.speed_m_s[-2]


def test_standstill_sends_its_last_command() -> None:
    run = simulate_preset("paper-kp1")
    assert run.stop_reason == "standstill"
    assert run.commands.speed_m_s[-1] == run.samples.wanted_speed_m_s[-1] != 0.0  # type: ignore[index]


def test_timeout_ends_a_translation_that_never_arrives() -> None:
    run = simulate_change("paper", limits__speed_m_s=0.05)
    assert run.stop_reason == "timeout"
    assert 30_000_000_000 < run.end_ns - run.start_ns <= 30_000_000_000 + 2 * TICK_NS


def test_limits_are_the_controllers() -> None:
    run = simulate_change("paper-kp10", limits__speed_m_s=0.5, limits__turn_rate_rad_s=0.25)
    assert np.abs(run.commands.speed_m_s).max() == 0.5
    assert np.abs(run.commands.turn_rate_rad_s).max() == 0.25
    assert run.samples.wanted_speed_m_s is not None
    assert np.abs(run.samples.wanted_speed_m_s).max() > 40.0


def test_poses_are_published_in_32_bits_on_request() -> None:
    single, double = (
        simulate_change("textbook", loop__pose_precision=name).poses.xy_m
        for name in ("float32", "float64")
    )
    assert (single == single.astype(np.float32)).all()
    assert (double != double.astype(np.float32)).any()


def test_period_spaces_the_samples() -> None:
    run = simulate_change("textbook", loop__period_ticks=4)
    assert set(np.diff(run.samples.time_ns).tolist()) == {4 * TICK_NS}
    assert set(np.diff(run.samples.pose_sequence).tolist()) == {4}
    assert set(np.diff(run.poses.time_ns).tolist()) == {TICK_NS}


def test_heading_error_at_the_end_explains_the_position_error() -> None:
    run = simulate_preset("paper-kp10")
    error_rad = known(run.samples.bearing_rad)[-1] - run.poses.heading_rad[-1]
    expected_m = known(run.samples.distance_m)[0] * math.sin(abs(error_rad))
    assert known(run.samples.distance_m)[-1] == pytest.approx(expected_m, rel=2e-3)


def test_without_both_causes_a_high_gain_is_as_accurate_as_a_low_one() -> None:
    changes = {"loop__queue_policy": "newest", "law__pause_ticks": 0}
    errors_m = [
        known(simulate_change(name, **changes).samples.distance_m)[-1]
        for name in ("paper-kp1", "paper-kp10")
    ]
    assert max(errors_m) < 0.006


def test_ticks_come_one_by_one() -> None:
    ticks = iterate_ticks(get_preset("textbook"))
    first, second = next(ticks), next(ticks)
    assert (first.time_ns, second.time_ns) == (0, TICK_NS)
    assert first.stop_reason is None
    assert [sample.sequence for sample in second.published] == [1]


@pytest.mark.parametrize("kind", [TickRow, SampleRow, EventRow])
def test_made_row_has_the_defaults_of_its_class(kind: Any) -> None:
    make = find_maker(kind)
    first, second = make(), make()
    assert type(first) is kind
    assert first is not second
    assert repr(first) == repr(kind())
