from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings

from tests.log.runs import assert_same, find_shared, simulate_preset
from tests.replay.changes import change_scenario, change_value, scenarios
from turtlelog.errors import ScenarioError
from turtlelog.log import export_rosbag2, read_bag, read_recording, read_run, write_recording
from turtlelog.plants.turtlesim import TICK_NS
from turtlelog.replay import (
    LoopReplay,
    PoseError,
    ReplayError,
    RowCount,
    loop_replay,
    replay_law,
    replay_loop,
)
from turtlelog.run import Origin, Run, SampleColumns, take_rows
from turtlelog.scenario import Scenario, complete_scenario, get_preset, override_scenario
from turtlelog.simulate import simulate_run

RECORDINGS = Path(__file__).parents[2] / "recordings" / "paper"
PAPER_LOGS = ["kp1_210.json", "kp1_210_main.csv", "kp4_210.json", "kp4_210_main.csv"]
SIGNALS = 23


@pytest.fixture(scope="module")
def kp10() -> Run:
    return simulate_preset("paper-kp10")


def assert_equal(found: LoopReplay, *, signals: int) -> None:
    assert (found.first_difference, found.stop) == (None, None)
    assert [signal.largest for signal in found.signals] == [0.0] * signals
    assert found.max_abs_error == PoseError()


def cut_samples(run: Run, keep: np.ndarray) -> Run:
    columns = {name: getattr(run.samples, name) for name in run.samples.__dataclass_fields__}
    kept = {name: column[keep] for name, column in columns.items() if column is not None}
    return replace(run, samples=replace(run.samples, **kept))


@pytest.mark.parametrize("path", sorted(RECORDINGS.glob("*.mcap")), ids=lambda path: path.stem)
def test_the_papers_recordings_are_simulated_again_in_every_column(path: Path) -> None:
    run = read_recording(path)
    found = replay_loop(run)
    assert_equal(found, signals=SIGNALS)
    assert (found.by_tick, found.samples, found.absent) == (True, len(run.samples), ())
    assert found.counts["poses"] == RowCount(recorded=len(run.poses), replayed=len(run.poses))


@pytest.mark.parametrize("name", PAPER_LOGS)
def test_the_published_logs_are_simulated_again_once_their_scenario_is_known(name: str) -> None:
    run = read_run(find_shared("paper", name))
    scenario = complete_scenario(run, get_preset(f"paper-{name.partition('_')[0]}"))
    found = replay_loop(run, scenario)
    assert_equal(found, signals=13)
    assert (found.by_tick, found.samples) == (False, len(run.samples))
    assert {"applied_speed", "pose_read", "wanted_speed"} < {*found.absent}


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(scenario=scenarios)
def test_any_simulation_is_simulated_again_in_every_column(
    scenario: Scenario, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("loop") / "a.mcap"
    run = simulate_run(scenario)
    write_recording(run, path)
    found = replay_loop(read_recording(path))
    assert_equal(found, signals=SIGNALS)
    assert_same(replace(found.run, source="simulation"), run)


def test_a_replay_says_what_it_is_a_replay_of(kp10: Run, tmp_path: Path) -> None:
    found = replay_loop(kp10, change_scenario("paper-kp10", name="newest", law__pause_ticks=0))
    write_recording(found.run, tmp_path / "a.mcap")
    again = read_recording(tmp_path / "a.mcap")
    assert (again.name, again.source) == ("newest", "replay of paper-kp10")
    assert_equal(replay_loop(again), signals=SIGNALS)


def test_a_changed_queue_is_what_if(kp10: Run) -> None:
    found = replay_loop(kp10, change_scenario("paper-kp10", loop__queue_policy="newest"))
    first = found.first_difference
    assert first is not None
    assert (first.signal, first.time_ns) == ("heading", 5 * TICK_NS)
    assert found.counts["samples"] == RowCount(recorded=770, replayed=666)
    assert found.max_abs_error.heading_rad == pytest.approx(0.03619, abs=1e-4)


def test_another_start_differs_from_the_first_tick_on(kp10: Run) -> None:
    found = replay_loop(kp10, change_scenario("paper-kp10", start__x_m=5.0))
    first = found.first_difference
    assert first is not None
    assert (first.signal, first.time_ns, first.replayed) == ("x", 0, 5.0)


@pytest.mark.parametrize(
    ("table", "column", "row", "signal"),
    [
        ("poses", "heading_rad", 300, "heading"),
        ("poses", "turn_rate_rad_s", 500, "applied_turn_rate"),
        ("samples", "distance_m", 700, "distance"),
        ("samples", "wanted_speed_m_s", 0, "wanted_speed"),
        ("commands", "lateral_speed_m_s", 769, "command_lateral_speed"),
    ],
)
def test_a_changed_value_is_found_where_it_stands(
    kp10: Run, table: str, column: str, row: int, signal: str
) -> None:
    found = replay_loop(change_value(kp10, table, column, row, 0.25)).first_difference
    assert found is not None
    time_ns = int(getattr(kp10, table).time_ns[row])
    assert (found.signal, found.time_ns, found.recorded) == (signal, time_ns, 0.25)


def test_headings_are_subtracted_across_the_seam() -> None:
    scenario = change_scenario("textbook", start__heading_rad=3.14, max_duration_s=1.0)
    run = change_value(simulate_run(scenario), "poses", "heading_rad", 0, -3.14)
    assert replay_loop(run).max_abs_error.heading_rad == pytest.approx(2.0 * np.pi - 6.28, abs=1e-6)


@pytest.mark.parametrize("stop_reason", ["interrupted", None])
def test_a_recording_that_was_cut_may_end_before_its_replay(kp10: Run, stop_reason: str) -> None:
    found = replay_loop(replace(cut_samples(kp10, np.arange(500)), stop_reason=stop_reason))
    assert (found.first_difference, found.samples) == (None, 500)
    assert found.counts["samples"] == RowCount(recorded=500, replayed=770)


def test_a_recording_that_came_to_its_end_may_not(kp10: Run) -> None:
    found = replay_loop(cut_samples(kp10, np.arange(500))).first_difference
    assert found is not None
    assert (found.signal, found.recorded, found.replayed) == ("samples", 500, 770)


def test_samples_are_matched_by_their_number_where_some_are_lost(kp10: Run) -> None:
    found = replay_loop(cut_samples(kp10, np.r_[0:100, 200:770]))
    assert (found.first_difference, found.samples) == (None, 670)
    assert "command_speed" not in {signal.signal for signal in found.signals}


def test_ticks_are_matched_by_their_number_where_some_are_lost(kp10: Run) -> None:
    keep = np.r_[0:100, 200 : len(kp10.poses)]
    none = cut_samples(kp10, np.arange(0))
    found = replay_loop(replace(none, poses=take_rows(kp10.poses, keep)))
    assert (found.first_difference, found.samples, found.max_abs_error) == (None, 0, PoseError())


def test_a_run_that_ends_otherwise_is_told() -> None:
    run = simulate_preset("paper-kp4", max_duration_s=5.0)
    found = replay_loop(run, change_scenario("paper-kp4"))
    assert found.stop is not None
    assert (found.stop.recorded, found.stop.replayed) == ("max_duration", "standstill")
    assert found.first_difference is not None
    assert found.first_difference.signal == "samples"


def test_a_strangers_bag_of_a_simulation_is_compared_tick_by_tick(
    kp10: Run, tmp_path: Path
) -> None:
    export_rosbag2(kp10, tmp_path / "bag")
    bag = replace(read_bag(tmp_path / "bag"), samples=SampleColumns.build_empty())
    found = replay_loop(bag, get_preset("paper-kp10"))
    assert_equal(found, signals=9)
    assert (found.samples, {*found.counts}) == (0, {"poses", "commands"})


def test_a_bag_by_the_wall_clock_is_refused() -> None:
    run = read_run(find_shared("ros2", "turtlesim_jazzy"))
    with pytest.raises(
        ReplayError, match=r"turtlesim's pose of each tick \(16 ms\) or the samples"
    ):
        replay_loop(run, get_preset("textbook"))


def test_a_log_without_its_whole_scenario_is_refused() -> None:
    run = read_run(find_shared("paper", "kp4_210_main.csv"))
    with pytest.raises(ScenarioError, match=r"without law\.heading_tolerance_rad, law\.kind"):
        replay_loop(run)


@pytest.mark.parametrize(("most_s", "is_simulated"), [(1.0, True), (20.0, True), (20.1, False)])
def test_a_recording_asks_for_no_run_that_is_much_longer_than_itself(
    kp10: Run, monkeypatch: pytest.MonkeyPatch, most_s: float, *, is_simulated: bool
) -> None:
    monkeypatch.setattr(loop_replay, "_LONGEST_S", 20.0)
    # A law that never ends: it is slow, and reaches nothing before the time is up.
    slow = {"law.kp_linear": 1e-3, "law.kp_angular": 1e-3, "max_duration_s": most_s}
    run = replace(kp10, parameters={**kp10.parameters, **slow})
    if is_simulated:
        assert replay_loop(run).run.stop_reason == "max_duration"
        return
    said = r"the replay goes on after 20 s, .* ends after 12\..* --set max_duration_s=20\.1 sim"
    with pytest.raises(ReplayError, match=said):
        replay_loop(run)


def test_a_long_time_limit_that_is_not_reached_changes_nothing(kp10: Run) -> None:
    run = replace(kp10, parameters={**kp10.parameters, "max_duration_s": 1e6})
    found = replay_loop(run)
    assert_equal(found, signals=SIGNALS)
    assert (found.scenario.max_duration_s, found.run.parameters["max_duration_s"]) == (1e6, 1e6)


def test_a_tolerance_is_a_number(kp10: Run) -> None:
    with pytest.raises(ReplayError, match="tolerance: expected a finite number >= 0"):
        replay_loop(kp10, tolerance=-1.0)


def test_a_tolerance_hides_what_is_smaller(kp10: Run) -> None:
    scenario = override_scenario(get_preset("paper-kp10"), {"start.x_m": 5.544445037841797})
    assert replay_loop(kp10, scenario).first_difference is not None
    assert replay_loop(kp10, scenario, tolerance=1e-4).first_difference is None


def test_commands_are_left_out_where_some_are_lost(kp10: Run) -> None:
    keep = np.r_[0:100, 200:770]
    columns = {
        name: getattr(kp10.commands, name)[keep] for name in kp10.commands.__dataclass_fields__
    }
    run = replace(kp10, commands=replace(kp10.commands, **columns))
    found = replay_loop(replace(run, stop_reason=None))
    assert found.first_difference is None
    assert {"command_speed", "command_time"}.isdisjoint(signal.signal for signal in found.signals)
    assert "command_time" in found.absent
    by_law = replay_law(run)  # answers one command per sample; nothing says that rows are lost
    assert by_law.commands == by_law.first_difference is not None
    lossy = replay_law(replace(run, origin=Origin(lost="rows")))
    assert lossy.first_difference is None
    assert "command_speed" in lossy.absent
