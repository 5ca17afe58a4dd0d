"""How deep queues must be to push nothing out, from which depth on runs are simulated once."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from turtlelog.explain.scenario_from_log import resimulation
from turtlelog.explain.scenario_from_log.resimulation import Depths, QueueGauge, list_lost_commands
from turtlelog.scenario import Scenario, get_preset, override_scenario
from turtlelog.simulate import Tick, iterate_ticks, simulate_run
from turtlelog.simulate.step_budget import StepBudgetError

DEEP = {"loop.command_queue": 90, "loop.pose_queue": 90}


def build(**changes: Any) -> Scenario:
    return override_scenario(get_preset("paper-kp4"), {**DEEP, **changes})


def gauge(scenario: Scenario) -> Depths:
    found = QueueGauge(scenario)
    for number, tick in enumerate(iterate_ticks(scenario)):
        found.receive(number)
        found.answer(tick)
    return found.needed


def is_same_run(scenario: Scenario, commands: int, poses: int) -> bool:
    changes = {"loop.command_queue": commands, "loop.pose_queue": poses}
    runs = [simulate_run(one) for one in (scenario, override_scenario(scenario, changes))]
    sent, moved = ([getattr(run, name) for run in runs] for name in ("samples", "poses"))
    return np.array_equal(sent[0].pose_sequence, sent[1].pose_sequence) and np.array_equal(
        moved[0].xy_m, moved[1].xy_m
    )


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"loop.transport_delay_ticks": 3},
        {"loop.period_ticks": 2},
        {"law.pause_ticks": 3, "loop.start_backlog": 9},
    ],
    ids=str,
)
def test_queues_as_deep_as_needed_make_the_same_run_and_shallower_ones_do_not(
    changes: dict[str, Any],
) -> None:
    scenario = build(**changes)
    needed = gauge(scenario)
    assert min(needed.commands, needed.poses) > 2
    assert is_same_run(scenario, needed.commands, needed.poses)
    assert not is_same_run(scenario, needed.commands - 1, needed.poses)
    assert not is_same_run(scenario, needed.commands, needed.poses - 1)


def test_who_takes_the_newest_command_needs_room_for_one() -> None:
    scenario = build(**{"loop.queue_policy": "newest"})
    needed = gauge(scenario)
    assert needed.commands == 1
    assert is_same_run(scenario, 1, needed.poses)


def test_no_depth_is_enough_where_commands_travel_for_a_time_of_their_own() -> None:
    assert not Depths(90, 90).hold(gauge(build(**{"loop.jitter_s": 0.01})))


@pytest.mark.parametrize(("less", "simulated"), [(0, 1), (1, 2)])
def test_of_runs_whose_queues_are_deep_enough_one_is_simulated(
    less: int, simulated: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    needed, asked = gauge(build()), []

    def simulate(scenario: Scenario, **options: Any) -> Iterator[Tick]:
        asked.append(scenario)
        return iterate_ticks(scenario, **options)

    monkeypatch.setattr(resimulation, "iterate_ticks", simulate)
    shallow = build(**{"loop.command_queue": needed.commands - less})
    counts = list_lost_commands([build(), shallow])
    assert len(asked) == simulated
    assert counts == [0, less]


def test_lost_commands_of_a_law_are_counted_within_its_budget(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    law = "import time\n\ndef law(time_ns, pose, goal):\n    time.sleep(0.3)\n    return 0.0, 0.0\n"
    (tmp_path / "slow.py").write_text(law, "utf-8")
    slow = {"law.kind": f"{tmp_path / 'slow.py'}:law", "max_duration_s": 0.05}
    monkeypatch.setattr(resimulation, "iterate_ticks", partial(iterate_ticks, step_budget_s=0.1))
    with pytest.raises(StepBudgetError, match="of a budget of 100 ms"):
        list_lost_commands([override_scenario(get_preset("textbook"), slow)])
