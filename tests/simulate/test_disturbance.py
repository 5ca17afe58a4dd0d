"""What pushes a plant, and how the lagged robot takes its commands in the loop."""

import math
from typing import Any

import numpy as np
import pytest

from tests.effects_cases import build_case
from turtlelog.errors import SimulationError
from turtlelog.plants import TURTLESIM
from turtlelog.run import Run
from turtlelog.scenario import PlantChoice
from turtlelog.simulate import simulate_run

LAGGED: Any = {"plant__kind": "lagged", "plant__period_s": 0.05}


def simulate_speed(amplitude: float = 0.0, duration_s: float = 2.0, **changes: Any) -> Run:
    law: dict[str, Any] = {
        "law__kind": "open-loop",
        "law__axis": "speed",
        "law__amplitude": amplitude,
        "law__duration_s": duration_s,
        "loop__pose_precision": "float64",
    }
    return simulate_run(build_case(**law, max_duration_s=duration_s, **changes))


@pytest.mark.parametrize(
    ("from_s", "to_s", "first", "last"),
    # A step is pushed where its time lies in [from_s, to_s): that of tick 10 is 0.16 s.
    [
        (0.16, 0.32, 10, 19),
        (0.1600001, 0.32, 11, 19),
        (0.16, 0.3200001, 10, 20),
        (0.0, 0.016, 0, 0),
    ],
)
def test_turtle_is_pushed_in_the_steps_within(
    from_s: float, to_s: float, first: int, last: int
) -> None:
    times: dict[str, Any] = {"disturbance__from_s": from_s, "disturbance__to_s": to_s}
    run = simulate_speed(0.25, disturbance__speed_m_s=0.5, **times)
    speed = run.poses.speed_m_s
    assert speed is not None
    pushed = np.flatnonzero(speed >= 0.5)
    assert (pushed[0], pushed[-1], len(pushed)) == (first, last, last - first + 1)
    assert set(speed[pushed].tolist()) == {0.75 if first else 0.5}
    assert set(np.delete(speed, [0, *pushed]).tolist()) == {0.25}


def test_pushed_turtle_moves_by_the_velocities_that_it_reports() -> None:
    changes: dict[str, Any] = {"disturbance__turn_rate_rad_s": 0.5, "disturbance__speed_m_s": 0.1}
    run = simulate_speed(0.25, **changes)
    turned = np.diff(run.poses.heading_rad)
    assert np.abs(turned - 0.5 * 0.016).max() < 1e-12
    moved = np.hypot(*np.diff(run.poses.xy_m, axis=0).T)
    assert np.abs(moved - 0.35 * 0.016).max() < 1e-9


def test_push_goes_on_where_the_watchdog_stops_the_turtle() -> None:
    # Nothing arrives after the first command: it is held for 1 s, the push is not.
    law: dict[str, Any] = {
        "law__signal": "sequence",
        "law__time_s": (0.0, 3.0),
        "law__speed_m_s": (0.25, 0.0),
    }
    law |= {"law__kind": "open-loop", "loop__period_ticks": 200, "max_duration_s": 2.0}
    run = simulate_run(build_case(**law, disturbance__speed_m_s=0.5))
    plain = simulate_run(build_case(**law))
    assert run.poses.speed_m_s is not None
    assert plain.poses.speed_m_s is not None
    assert np.array_equal(run.poses.speed_m_s, plain.poses.speed_m_s + 0.5)
    assert plain.poses.speed_m_s[-1] == 0.0
    assert plain.poses.speed_m_s[1] == 0.25


@pytest.mark.parametrize("plant", [{}, LAGGED], ids=["turtlesim", "lagged"])
def test_noise_spreads_by_the_root_of_time(plant: dict[str, Any]) -> None:
    # Sixteen seconds of 0.01 m/s per root Hz would be 0.04 m; per step the velocity has its share.
    run = simulate_speed(duration_s=16.0, disturbance__noise_turn_rate=0.01, **plant)
    period_s = (run.poses.time_ns[1] - run.poses.time_ns[0]) / 1e9
    steps = np.diff(np.unwrap(run.poses.heading_rad))
    expected = 0.01 * math.sqrt(period_s)
    assert abs(steps.std() / expected - 1.0) < 4.0 / math.sqrt(2.0 * len(steps))
    assert abs(steps.mean()) < 4.0 * expected / math.sqrt(len(steps))
    stream = np.random.Generator(np.random.PCG64(np.random.SeedSequence(0, spawn_key=(8,))))
    drawn = stream.standard_normal((1024, 2))[: len(run.poses), 1]
    assert np.abs(steps - expected * drawn[1 : len(steps) + 1]).max() < 1e-12


def test_push_of_the_lagged_robot_begins_and_ends_between_poses() -> None:
    times: dict[str, Any] = {"disturbance__from_s": 0.123, "disturbance__to_s": 0.777}
    run = simulate_speed(disturbance__speed_m_s=0.3, **times, **LAGGED)
    moved = run.poses.xy_m[:, 0] - run.poses.xy_m[0, 0]
    time_s = run.poses.time_ns / 1e9
    assert np.abs(moved - 0.3 * np.clip(time_s - 0.123, 0.0, 0.777 - 0.123)).max() < 1e-9


@pytest.mark.parametrize(
    ("policy", "delay_s", "begins_s"),
    [
        ("newest", 0.0, 0.0),
        ("newest", 0.012345678, 0.012345678),
        ("newest", 0.05, 0.05),
        ("one-per-tick", 0.0, 0.0),
        ("one-per-tick", 0.0123, 0.05),
        ("one-per-tick", 0.05, 0.05),
        ("one-per-tick", 0.050000001, 0.1),
    ],
)
def test_lagged_robot_takes_commands_on_arrival_or_at_its_periods(
    policy: str, delay_s: float, begins_s: float
) -> None:
    changes: dict[str, Any] = {"loop__queue_policy": policy, "loop__transport_delay_s": delay_s}
    run = simulate_speed(0.5, **changes, **LAGGED)
    moved = run.poses.xy_m[:, 0] - run.poses.xy_m[0, 0]
    expected = 0.5 * np.maximum(run.poses.time_ns / 1e9 - begins_s, 0.0)
    assert np.abs(moved - expected).max() < 1e-9


def test_lagged_robot_follows_a_step_as_its_table_says() -> None:
    table = {"speed_gain": 0.9, "speed_dead_time_s": 0.08, "speed_lag_s": 0.1}
    run = simulate_speed(0.5, **LAGGED, **{f"plant__{key}": value for key, value in table.items()})
    since_s = np.maximum(run.poses.time_ns / 1e9 - 0.08, 0.0)
    expected = 0.45 * (1.0 - np.exp(-since_s / 0.1))
    assert run.poses.speed_m_s is not None
    assert np.abs(run.poses.speed_m_s - expected).max() < 1e-7


def test_start_of_the_lagged_robot_is_rounded_only_as_the_scenario_says() -> None:
    rounded = simulate_speed(duration_s=0.1, **LAGGED, start__x_m=0.1)
    changes: dict[str, Any] = {"start__x_m": 0.1, "start__precision": "float64"}
    exact = simulate_speed(duration_s=0.1, **LAGGED, **changes)
    assert rounded.poses.xy_m[0, 0] == float(np.float32(0.1))
    assert exact.poses.xy_m[0, 0] == 0.1


@pytest.mark.parametrize("plant", [{}, LAGGED], ids=["turtlesim", "lagged"])
def test_finer_clock_leaves_delays_in_seconds_as_they_are(plant: dict[str, Any]) -> None:
    delays: dict[str, Any] = {
        "loop__transport_delay_s": 0.1,
        "sensing__delay_s": 0.1,
        "max_duration_s": 1.0,
    }
    law: dict[str, Any] = {"law__kind": "open-loop", "law__axis": "speed", "law__amplitude": 0.5}
    scenario = build_case(**law, law__duration_s=1.0, **delays, **plant)
    clock = scenario.plant.facts if plant else TURTLESIM
    for times in (1, 8):
        run = simulate_run(scenario, clock.refine(times))
        assert run.poses.speed_m_s is not None
        begins_s = run.poses.time_ns[np.flatnonzero(run.poses.speed_m_s > 0.4)[0]] / 1e9
        assert 0.2 <= begins_s <= 0.2 + 1.001 * clock.period_s / times + 1e-9
        assert run.samples.time_ns[0] == 100_000_000


def test_plant_choice_of_the_lagged_robot_has_no_watchdog() -> None:
    assert math.isinf(PlantChoice(kind="lagged").facts.watchdog_ns)


def test_robot_that_runs_away_ends_the_run_in_one_line() -> None:
    # Driven the wrong way at twice the speed, without limits: its speed overflows first.
    changes: dict[str, Any] = {"plant__speed_gain": -2.0, "limits__speed_m_s": math.inf}
    gains: dict[str, Any] = {"law__kp_linear": 4.0, "law__timeout_s": math.inf}
    with pytest.raises(SimulationError, match=r"the robot runs away: at [\d.]+ s x = ") as err:
        simulate_run(build_case(**LAGGED, **changes, **gains))
    assert err.value.run is not None
    assert len(err.value.run.poses) > 100
    assert "\n" not in str(err.value)
