from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from tests.log.runs import find_shared, make_run, simulate_preset
from tests.replay.changes import change_scenario, change_value, scenarios, write_law
from turtlelog.errors import LawError, ScenarioError, SimulationError
from turtlelog.laws import LAWS, Pose
from turtlelog.log import read_recording, read_run, write_recording
from turtlelog.plants.turtlesim import TICK_NS
from turtlelog.replay import LawReplay, ReplayError, replay_law
from turtlelog.replay.differences import count_missing_samples
from turtlelog.run import Origin, Run, SampleColumns
from turtlelog.scenario import (
    PAPER_RUNS,
    Scenario,
    complete_scenario,
    get_preset,
    override_scenario,
    restore_scenario,
)
from turtlelog.simulate import simulate_run

RECORDINGS = Path(__file__).parents[2] / "recordings" / "paper"
PAPER_LOGS = ["kp1_210.json", "kp1_210_main.csv", "kp4_210.json", "kp4_210_main.csv"]


@pytest.fixture(scope="module")
def kp4() -> Run:
    return simulate_preset("paper-kp4")


def use_law(kind: str, **parameters: int) -> Scenario:
    scenario = override_scenario(get_preset("paper-kp4"), {"law.kind": kind})
    return override_scenario(scenario, {f"law.{key}": value for key, value in parameters.items()})


def count_differing(found: LawReplay) -> dict[str, int]:
    return {signal.signal: signal.differing for signal in found.signals if signal.differing}


@pytest.mark.parametrize("path", sorted(RECORDINGS.glob("*.mcap")), ids=lambda path: path.stem)
def test_the_papers_recordings_hold_what_their_law_commands(path: Path) -> None:
    run = read_recording(path)
    found = replay_law(run)
    assert (found.samples, found.first_difference, found.stop) == (len(run.samples), None, None)
    assert {signal.largest for signal in found.signals} == {0.0}


@pytest.mark.parametrize("name", PAPER_LOGS)
def test_the_published_logs_hold_what_the_papers_law_commands(name: str) -> None:
    run = read_run(find_shared("paper", name))
    found = replay_law(run, complete_scenario(run, get_preset(f"paper-{name.partition('_')[0]}")))
    assert (found.samples, found.first_difference) == (len(run.samples), None)
    assert {signal.largest for signal in found.signals} == {0.0}
    assert found.absent == ("wanted_speed", "wanted_turn_rate")


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(scenario=scenarios)
def test_any_simulation_is_what_its_law_commands(
    scenario: Scenario, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("law") / "a.mcap"
    write_recording(simulate_run(scenario), path)
    found = replay_law(read_recording(path))
    assert (found.first_difference, count_differing(found)) == (None, {})


@pytest.mark.parametrize("name", PAPER_RUNS)
def test_a_gain_changed_by_a_millionth_shows_in_the_first_unsaturated_command(name: str) -> None:
    run = simulate_preset(name)
    scenario = restore_scenario(run)
    kp = scenario.law.parameters.kp_linear
    found = replay_law(run, override_scenario(scenario, {"law.kp_linear": kp * (1.0 + 1e-6)}))
    wanted = run.samples.wanted_speed_m_s
    assert wanted is not None
    translating = run.samples.phase == run.phase_names.index("translate")
    unsaturated = int(np.flatnonzero(translating & (np.abs(wanted) < 1.0))[0])
    first, command = found.first_difference, found.first_command_difference
    assert first is not None
    assert command is not None
    assert (first.signal, command.signal) == ("wanted_speed", "speed")
    assert first.time_ns == run.samples.time_ns[int(np.flatnonzero(translating)[0])]
    assert command.time_ns == run.samples.time_ns[unsaturated]
    assert command.recorded == run.samples.speed_m_s[unsaturated]


@settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    column=st.sampled_from(["speed_m_s", "turn_rate_rad_s", "distance_m", "wanted_speed_m_s"]),
    row=st.integers(min_value=0, max_value=680),
    change=st.floats(min_value=1e-9, max_value=1e3),
)
def test_any_changed_value_is_found_where_it_stands(
    kp4: Run, column: str, row: int, change: float
) -> None:
    value = float(getattr(kp4.samples, column)[row]) + change
    found = replay_law(change_value(kp4, "samples", column, row, value))
    first = found.first_difference
    assert first is not None
    assert (first.time_ns, first.recorded) == (kp4.samples.time_ns[row], value)
    assert first.signal == column.removesuffix("_m_s").removesuffix("_rad_s").removesuffix("_m")
    assert sum(count_differing(found).values()) == 1


def test_a_tolerance_hides_what_is_smaller_and_nothing_else(kp4: Run) -> None:
    scenario = change_scenario("paper-kp4", law__kp_linear=4.000004)
    wide = replay_law(kp4, scenario, tolerance=1e-4)
    narrow = replay_law(kp4, scenario, tolerance=1e-7)
    assert (wide.first_difference, count_differing(wide)) == (None, {})
    assert max(signal.largest for signal in wide.signals) == pytest.approx(2.277e-5, rel=1e-3)
    assert narrow.first_difference is not None


def test_a_changed_phase_is_told_by_its_name_whatever_the_tolerance(kp4: Run) -> None:
    run = change_value(kp4, "samples", "phase", 400, kp4.phase_names.index("rotate"))
    first = replay_law(run, tolerance=9.0).first_difference
    assert first is not None
    assert (first.signal, first.recorded, first.replayed) == ("phase", "rotate", "translate")


def test_a_changed_limit_shows_in_the_commands_only(kp4: Run) -> None:
    found = replay_law(kp4, change_scenario("paper-kp4", limits__speed_m_s=0.9))
    assert {*count_differing(found)} == {"speed", "command_speed"}
    assert found.first_difference == found.first_command_difference


def test_a_changed_pause_shows_as_ticks(kp4: Run) -> None:
    found = replay_law(kp4, change_scenario("paper-kp4", law__pause_ticks=33))
    first = found.first_difference
    assert count_differing(found) == {"pause": 1}
    assert first is not None
    assert (first.signal, first.recorded, first.replayed) == ("pause", 34, 33)


def test_a_law_that_stops_early_ends_the_comparison(kp4: Run) -> None:
    found = replay_law(kp4, change_scenario("paper-kp4", law__position_tolerance_m=0.1))
    assert found.stop is not None
    assert (found.stop.recorded, found.stop.replayed) == (None, "within_tolerance")
    assert found.samples < len(kp4.samples)
    assert found.stop.time_ns == kp4.samples.time_ns[found.samples - 1]


def test_a_law_that_goes_on_differs_at_the_recorded_end(kp4: Run, tmp_path: Path) -> None:
    found = replay_law(kp4, use_law(write_law(tmp_path / "law.py")))
    assert found.stop is not None
    assert (found.stop.recorded, found.stop.replayed) == ("standstill", None)
    assert found.samples == len(kp4.samples)


@pytest.mark.parametrize("stop_reason", [None, "interrupted"])
def test_a_recording_that_was_cut_has_no_end_to_compare(kp4: Run, stop_reason: str) -> None:
    assert replay_law(replace(kp4, stop_reason=stop_reason)).stop is None


def test_a_log_that_ended_for_its_own_reason_asks_for_any(kp4: Run, tmp_path: Path) -> None:
    run = replace(kp4, stop_reason="finished")
    assert replay_law(run).stop is None
    stop = replay_law(run, use_law(write_law(tmp_path / "law.py"))).stop
    assert stop is not None
    assert (stop.recorded, stop.replayed) == ("finished", None)


def test_the_time_that_was_up_is_no_stop_of_the_law() -> None:
    run = simulate_preset("paper-kp4", max_duration_s=2.0)
    assert (run.stop_reason, replay_law(run).first_difference) == ("max_duration", None)


def test_lost_samples_are_counted(kp4: Run) -> None:
    keep = np.r_[0:100, 110 : len(kp4.samples)]
    columns = {name: column[keep] for name, column in _list_columns(kp4.samples).items()}
    found = replay_law(replace(kp4, samples=replace(kp4.samples, **columns)))
    assert (found.missing_samples, found.samples) == (10, len(keep))
    assert found.first_difference is None  # P control forgets


def test_the_answers_are_columns(kp4: Run) -> None:
    found = replay_law(kp4, change_scenario("paper-kp4", limits__speed_m_s=0.5))
    assert found.answers.speed_m_s.max() == 0.5
    assert (found.answers.pose_sequence == kp4.samples.pose_sequence).all()


@pytest.mark.parametrize(
    ("law", "line"),
    [
        (
            {"fails": "1 / 0"},
            r"law .*law\.py:Law, sample 3: .*law\.py, line 23: ZeroDivisionError: division by",
        ),
        ({"fails": "raise SystemExit(3)"}, "sample 3: .*line 23: SystemExit: 3"),
        (
            {"fails": "return None"},
            "sample 3: expected a Decision, or speed and turn rate, found None",
        ),
        ({"also": ", world_v_x_m_s=float('inf')"}, "sample 0: expected finite numbers"),
    ],
    ids=str,
)
def test_a_law_that_fails_is_named_with_its_sample(
    kp4: Run, tmp_path: Path, law: dict[str, str], line: str
) -> None:
    kind = write_law(tmp_path / "law.py", **law)
    with pytest.raises(SimulationError, match=line):
        replay_law(kp4, use_law(kind))


def test_a_law_that_is_gone_is_named(kp4: Run) -> None:
    run = replace(kp4, parameters={**kp4.parameters, "law.kind": "gone.py:Law"})
    with pytest.raises(ScenarioError, match=r"no Python file gone\.py"):
        replay_law(run, trust_law=True)


def test_a_bag_has_no_samples_and_is_told_so() -> None:
    run = read_run(find_shared("ros2", "turtlesim_jazzy"))
    with pytest.raises(ReplayError, match=r"topic /turtle1/control\):.*--plant"):
        replay_law(run)


def test_a_log_without_its_whole_scenario_names_what_is_missing() -> None:
    run = read_run(find_shared("paper", "kp1_210.json"))
    with pytest.raises(ScenarioError, match=r"without law\.kind, law\.pause_ticks.*--scenario"):
        replay_law(run)


def test_recorded_poses_beyond_all_measure_are_told_by_sample() -> None:
    run = make_run(np.array([-1e308, 1e308, 0.0]))
    with pytest.raises(SimulationError, match="sample 1: expected finite numbers"):
        replay_law(run, get_preset("textbook"))


@pytest.mark.parametrize("tolerance", [-1.0, float("nan"), float("inf")])
def test_a_tolerance_is_a_number(kp4: Run, tolerance: float) -> None:
    with pytest.raises(ReplayError, match="tolerance: expected a finite number >= 0"):
        replay_law(kp4, tolerance=tolerance)


def keep_commands(run: Run, rows: slice) -> Run:
    names = ("time_ns", "speed_m_s", "lateral_speed_m_s", "turn_rate_rad_s")
    kept = {name: getattr(run.commands, name)[rows] for name in names}
    return replace(run, commands=replace(run.commands, **kept))


@pytest.mark.parametrize(
    ("column", "unit"), [("speed", "m_s"), ("lateral_speed", "m_s"), ("turn_rate", "rad_s")]
)
@pytest.mark.parametrize("row", [0, 300, 680])
def test_a_command_that_was_published_otherwise_is_found_where_it_stands(
    kp4: Run, row: int, column: str, unit: str
) -> None:
    value = float(getattr(kp4.commands, f"{column}_{unit}")[row]) + 1e-9
    found = replay_law(change_value(kp4, "commands", f"{column}_{unit}", row, value))
    first = found.first_difference
    assert first is not None
    assert (first.signal, first.recorded) == (f"command_{column}", value)
    assert first.time_ns == kp4.commands.time_ns[row]
    assert found.first_command_difference == first
    assert count_differing(found) == {f"command_{column}": 1}


def test_commands_that_are_not_one_per_sample_are_a_difference(kp4: Run) -> None:
    count = len(kp4.samples)
    assert replay_law(keep_commands(kp4, slice(count - 1))).first_difference is None
    for rows in (slice(count - 2), slice(0)):
        found = replay_law(keep_commands(kp4, rows))
        assert found.commands == found.first_difference
        assert found.commands is not None
        assert (found.commands.signal, found.commands.recorded) == ("commands", rows.stop)
        assert {"command_speed", "command_turn_rate"} < {*found.absent}


def test_commands_of_a_recording_that_lost_rows_are_compared_only_where_they_belong(
    kp4: Run,
) -> None:
    fewer = replace(keep_commands(kp4, slice(9)), origin=Origin(lost="rows"))
    assert replay_law(fewer).first_difference is None
    assert "command_speed" in replay_law(fewer).absent
    kept = np.arange(len(kp4.samples)) != 400
    columns = {f: v[kept] for f, v in _list_columns(kp4.samples).items()}
    lost = replace(kp4, samples=replace(kp4.samples, **columns))
    assert (count_missing_samples(lost.samples), replay_law(lost).absent) == (1, ())
    assert replay_law(lost).first_difference is None


def _list_columns(samples: SampleColumns) -> dict[str, Any]:
    values = {field.name: getattr(samples, field.name) for field in fields(samples)}
    return {name: column for name, column in values.items() if column is not None}


@pytest.mark.parametrize("late_ns", [5_000_000_000, -1, -16_000_000])
def test_commands_that_all_went_out_at_another_time_differ(kp4: Run, late_ns: int) -> None:
    times = kp4.commands.time_ns + late_ns
    run = replace(kp4, commands=replace(kp4.commands, time_ns=times))
    first = replay_law(run).first_difference
    assert first is not None
    assert (first.signal, first.recorded, first.replayed) == ("pause", late_ns / TICK_NS, 0)


class Stand:
    def step(self, time_ns: int, pose: Pose) -> tuple[float, float]:
        return 0.0, 0.25


def stand(time_ns: int, pose: Pose, goal: object) -> tuple[float, float]:
    return 0.0, 0.25


@pytest.mark.parametrize("law", [Stand, stand, Stand()], ids=["class", "function", "object"])
def test_a_law_may_be_given_in_any_form_that_a_simulation_takes(law: Any, kp4: Run) -> None:
    found = replay_law(kp4, law=law)
    assert found.samples == 681
    assert set(found.answers.turn_rate_rad_s) == {0.25}


def test_a_law_may_be_given_by_its_name(kp4: Run) -> None:
    assert replay_law(kp4, law="sequential-p").first_difference is None
    assert replay_law(kp4, law=LAWS["sequential-p"]).first_difference is None
    assert replay_law(kp4, law="posture").first_difference is not None


def test_what_is_no_law_is_refused_by_its_argument(kp4: Run) -> None:
    with pytest.raises(LawError, match="law: expected a class, a function of"):
        replay_law(kp4, law=3)
