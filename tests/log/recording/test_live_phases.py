from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.log.live import read_messages
from tests.log.recording.ticks import assert_same_columns, make_scenario, record
from turtlelog.log import write_recording
from turtlelog.log.recording.recorder import Recorder
from turtlelog.log.recording.topics import PHASE, list_topics
from turtlelog.scenario import Scenario
from turtlelog.simulate import Tick, iterate_ticks, simulate_run

LAW = """
from msgspec.structs import replace
from turtlelog.laws import SequentialP

class Law(SequentialP):
    samples = 0

    def step(self, time_ns, pose):
        self.samples += 1
        return replace(super().step(time_ns, pose), CHANGES)
"""


def make_law(folder: Path, changes: str, max_duration_s: float) -> Scenario:
    """Return a scenario of the paper's law whose decisions are changed."""
    path = folder / "law.py"
    path.write_text(LAW.replace("CHANGES", changes), encoding="utf-8")
    return make_scenario(
        law__kind=f"{path}:Law",
        law__kp_angular=10.0,
        law__pause_ticks=33,
        max_duration_s=max_duration_s,
    )


def list_phases(path: Path) -> list[tuple[str, int]]:
    """Return the phases that a file tells of so far, and when they began [ns]."""
    number = list_topics(None).index(PHASE) + 1
    found = [message for message in read_messages(path) if message.channel_id == number]
    return [(message.data[8:-1].decode(), message.log_time) for message in found]


def iterate_until_blocked(scenario: Scenario) -> Iterator[Tick]:
    for tick in iterate_ticks(scenario):
        yield tick
        if any(sample.blocks_ticks for sample in tick.computed):
            return


def test_a_pause_is_told_when_it_begins(tmp_path: Path) -> None:
    path, scenario = tmp_path / "a.mcap", make_scenario("paper-kp10")
    with Recorder(path, scenario) as recorder:
        for tick in iterate_until_blocked(scenario):
            recorder.receive(tick)
        recorder.flush()
        assert list_phases(path) == [("rotate", 64_000_000), ("pause", tick.time_ns)]


@pytest.mark.parametrize("period_ticks", [1, 50], ids=["each pose", "every 50th"])
@pytest.mark.parametrize("after_ticks", [0, 1, 20, 33, 34, 60])
def test_a_run_that_is_cut_near_a_pause_tells_the_same_live_and_at_once(
    after_ticks: int, period_ticks: int, tmp_path: Path
) -> None:
    loop = {"loop__period_ticks": period_ticks, "loop__start_backlog": 1}
    *_, blocked = iterate_until_blocked(make_scenario("paper-kp1", **loop))
    end_s = blocked.time_ns / 1e9 + 0.016 * after_ticks
    scenario = make_scenario("paper-kp1", **loop, max_duration_s=end_s)
    assert_same_live_and_at_once(scenario, tmp_path)
    assert list_phases(tmp_path / "live.mcap")[1] == ("pause", blocked.time_ns)


@pytest.mark.parametrize(
    "changes",
    [
        "ends_phase=False",
        "blocks_ticks=2 * (self.samples % 40 == 7)",
        "blocks_ticks=1",
        "blocks_ticks=9, stop_reason='enough' if self.samples == 20 else None",
    ],
    ids=["silent", "blocks amid a rotation", "blocks each time", "stops"],
)
@pytest.mark.parametrize("max_duration_s", [2.4, 4.8, 20.0])
def test_whatever_a_law_says_a_live_recording_equals_one_written_at_once(
    changes: str, max_duration_s: float, tmp_path: Path
) -> None:
    assert_same_live_and_at_once(make_law(tmp_path, changes, max_duration_s), tmp_path)


def assert_same_live_and_at_once(scenario: Scenario, folder: Path) -> None:
    live, once = folder / "live.mcap", folder / "once.mcap"
    record(live, scenario)
    write_recording(simulate_run(scenario), once)
    assert_same_columns(live, once)
