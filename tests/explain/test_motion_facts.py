from dataclasses import replace

import numpy as np
import pytest

from tests.log.runs import simulate_preset
from turtlelog.explain import read_motion_facts
from turtlelog.run import CommandColumns, Run


@pytest.mark.parametrize(("delay_ticks", "ticks"), [(0, 0), (3, 3)])
def test_the_dead_time_of_commands_is_counted_in_ticks(delay_ticks: int, ticks: int) -> None:
    run = simulate_preset(
        "textbook", loop__transport_delay_ticks=delay_ticks, loop__queue_policy="newest"
    )
    found = read_motion_facts(run).delays
    assert found is not None
    # A command of the sample that read pose i acts in the step to pose i + 1 at the earliest.
    assert [*found.counts] == [ticks]
    assert found.low_ns == found.high_ns == (ticks + 1) * 16_000_000


def test_a_command_that_changes_nothing_has_no_dead_time() -> None:
    run = simulate_preset("textbook")
    same = replace(run.commands, speed_m_s=np.zeros(len(run.commands)))
    held = replace(same, turn_rate_rad_s=np.zeros(len(run.commands)))
    poses = replace(
        run.poses,
        speed_m_s=np.zeros(len(run.poses)),
        turn_rate_rad_s=np.zeros(len(run.poses)),
        xy_m=np.zeros((len(run.poses), 2)),
        heading_rad=np.zeros(len(run.poses)),
    )
    found = read_motion_facts(replace(run, poses=poses, commands=held))
    assert (found.delays, found.largest) == (None, ())


def test_rates_hold_nine_of_ten_periods_and_the_longest_silence() -> None:
    run = make_times(np.cumsum([0, *[100_000_000] * 90, *[110_000_000] * 5, *[500_000_000] * 5]))
    found = read_motion_facts(run).commands
    assert found is not None
    assert (found.usual_ns, found.low_ns) == (1e8, 1e8)
    assert found.high_ns == pytest.approx(129.5e6)
    assert (found.longest_ns, found.longest_at_ns) == (500_000_000, 9_550_000_000)


def make_times(time_ns: np.ndarray) -> Run:
    none = np.zeros(len(time_ns))
    commands = CommandColumns(
        time_ns=time_ns, speed_m_s=none, lateral_speed_m_s=none.copy(), turn_rate_rad_s=none.copy()
    )
    return replace(simulate_preset("textbook"), commands=commands)
