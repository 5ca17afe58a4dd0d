"""Runs of the lagged robot, driven again."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from turtlelog.errors import ReplayError
from turtlelog.replay import LoopReplay, PoseError, replay_loop, replay_plant
from turtlelog.run import CommandColumns, Run, take_rows
from turtlelog.scenario import get_preset, override_scenario
from turtlelog.simulate import simulate_run

ROBOT = {
    "plant.kind": "lagged",
    "plant.turn_gain": 0.9,
    "plant.turn_lag_s": 0.1,
    "plant.turn_dead_time_s": 0.08,
    "plant.speed_lag_s": 0.2,
    "goal.x_m": 8.0,
    "goal.y_m": 6.0,
    "max_duration_s": 6.0,
}


def simulate(**changes: Any) -> Run:
    values = {key.replace("__", "."): value for key, value in changes.items()}
    return simulate_run(override_scenario(get_preset("textbook"), ROBOT | values))


@pytest.fixture(scope="module")
def run() -> Run:
    return simulate()


EFFECTS: dict[str, dict[str, Any]] = {
    "none": {},
    "queue": {"loop__queue_policy": "one-per-tick", "loop__start_backlog": 4},
    "transport": {"loop__transport_delay_ticks": 1, "loop__transport_delay_s": 0.0333},
    "random transport": {"loop__jitter_s": 0.07, "loop__loss_probability": 0.1},
    "repeat and late": {"loop__repeat_probability": 0.2, "loop__late_probability": 0.1}
    | {"loop__late_s": 0.2},
    "timer": {"loop__trigger": "timer", "loop__period_s": 0.033},
    "pause": {"law__pause_ticks": 10},
    "push": {"disturbance__speed_m_s": 0.1, "disturbance__from_s": 1.01, "disturbance__to_s": 2.34},
    "random push": {"disturbance__noise_speed": 0.02, "disturbance__noise_turn_rate": 0.02},
    "sensing": {"sensing__noise_heading_rad": 0.01, "sensing__delay_s": 0.03},
    "double": {"loop__pose_precision": "float64", "plant__period_s": 0.032},
}


@pytest.mark.parametrize("changes", EFFECTS.values(), ids=EFFECTS)
def test_recorded_commands_drive_the_robot_where_it_was(changes: dict[str, Any]) -> None:
    found = replay_plant(simulate(**changes))
    assert (found.max_abs_error, found.first_difference) == (PoseError(), None)
    assert found.commands.taken > 0


@pytest.mark.parametrize("changes", EFFECTS.values(), ids=EFFECTS)
def test_closed_loop_is_replayed_without_a_difference(changes: dict[str, Any]) -> None:
    found = replay_loop(simulate(**changes))
    assert (found.by_tick, found.first_difference) == (True, None)
    assert {"applied_speed", "pose_read", "sample_time"} <= {one.signal for one in found.signals}


def test_commands_that_never_come_or_come_twice_are_counted_once() -> None:
    lossy = simulate(loop__loss_probability=0.1, loop__repeat_probability=0.2)
    use = replay_plant(lossy).commands
    lost = sum(
        int(event.text.split()[3]) for event in lossy.events if event.kind == "commands_lost"
    )
    # the last command leaves after the last pose
    assert (use.taken + use.unseen, use.unseen) == (len(lossy.commands), lost + 1)


def find_signal(found: LoopReplay, name: str) -> int:
    return next(one.rows for one in found.signals if one.signal == name)


def test_poses_of_another_period_are_compared_where_both_have_one(run: Run) -> None:
    # 50 and 16 ms meet every 400 ms
    scenario = override_scenario(get_preset("textbook"), {**ROBOT, "plant.period_s": 0.016})
    found = replay_loop(run, scenario)
    assert find_signal(found, "x") == run.poses.time_ns[-1] // 400_000_000 + 1
    assert found.max_abs_error.x_m < 0.05


def test_another_command_leads_the_robot_elsewhere(run: Run) -> None:
    speed = run.commands.speed_m_s.copy()
    speed[60] += 0.01
    changed = replace(run, commands=replace(run.commands, speed_m_s=speed))
    first = replay_plant(changed).first_difference
    assert first is not None
    assert first.signal in {"x", "y"}
    assert first.time_ns > run.commands.time_ns[60]


def test_missing_poses_are_gaps_that_the_robot_is_driven_through(run: Run) -> None:
    kept = np.r_[0:20, 25 : len(run.poses)]
    poses = take_rows(run.poses, kept)
    none = take_rows(run.samples, slice(0, 0))
    found = replay_plant(replace(run, poses=poses, samples=none))
    assert [gap.missing_ticks for gap in found.gaps] == [5]
    assert found.max_abs_error == PoseError()


def test_part_of_a_run_is_not_driven(run: Run) -> None:
    with pytest.raises(ReplayError, match="a whole scenario to drive"):
        replay_plant(run.slice(1.0))


def test_run_that_does_not_begin_at_0_is_not_driven(run: Run) -> None:
    late = replace(
        run,
        poses=take_rows(run.poses, slice(10, None)),
        samples=take_rows(run.samples, slice(0, 0)),
    )
    with pytest.raises(ReplayError, match=r"from 0 s on .*, found the first at 0\.5 s"):
        replay_plant(late)


def test_run_that_lacks_commands_is_not_driven(run: Run) -> None:
    few: CommandColumns = take_rows(run.commands, slice(0, 50))
    with pytest.raises(
        ReplayError, match=f"a command per sample .*, found 50 of {len(run.samples)}"
    ):
        replay_plant(replace(run, commands=few))
    alone = replace(
        run, commands=take_rows(few, slice(0, 0)), samples=take_rows(run.samples, slice(0, 0))
    )
    with pytest.raises(ReplayError, match=r"no commands"):
        replay_plant(alone)
