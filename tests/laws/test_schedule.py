import math
from typing import Any

import numpy as np
import pytest

import turtlelog as tl
from tests.laws.sequential_runs import build_run
from turtlelog.compare.run_summary import summarise_run
from turtlelog.errors import LawError, ScenarioError
from turtlelog.explain import attribute_run, identify_run
from turtlelog.laws import (
    GainSchedule,
    Goal,
    PIDGainSchedule,
    Pose,
    SequentialP,
    SequentialPParameters,
)
from turtlelog.laws.sequential import MOST_ENTRIES
from turtlelog.scenario import flatten_scenario, format_scenario, override_scenario, parse_scenario

BOTH = pytest.mark.parametrize("kind", ["sequential-p", "sequential-pid"])
TABLE: dict[str, Any] = {
    "schedule__over": "distance",
    "schedule__at": [0.0, 0.5, 2.0],
    "schedule__kp_linear": [4.0, 2.0, 1.0],
}


def build_scheduled(kind: str = "sequential-p", **changes: Any) -> tl.Scenario:
    values = {f"law.{key.replace('__', '.')}": value for key, value in (TABLE | changes).items()}
    return override_scenario(build_run(kind=kind), values)


def compute(place: float) -> float:
    """Return the gain with which the law turns at a heading error, towards a goal due east."""
    at, gains = (0.25, 0.5, 2.0), (4.0, 2.0, 1.0)
    schedule = GainSchedule(over="heading_error", at=at, kp_angular=gains)
    law = SequentialP(SequentialPParameters(schedule=schedule, wrap_error=False))
    law.reset(Pose(1.0, 5.0, 0.0), Goal(9.0, 5.0), None)
    law.step(0, Pose(1.0, 5.0, 0.0))
    return law.step(0, Pose(1.0, 5.0, -place)).turn_rate_rad_s / place


@pytest.mark.parametrize(("place", "gain"), [(0.25, 4.0), (0.5, 2.0), (2.0, 1.0)])
def test_gain_at_an_entry_is_its_value(place: float, gain: float) -> None:
    assert compute(place) == gain
    assert compute(-place) == gain


@pytest.mark.parametrize(("place", "gain"), [(0.375, 3.0), (1.25, 1.5), (1.7, 1.2)])
def test_gain_between_entries_is_linear(place: float, gain: float) -> None:
    assert compute(place) == pytest.approx(gain, rel=1e-15)


@pytest.mark.parametrize(("place", "gain"), [(0.01, 4.0), (0.2, 4.0), (2.1, 1.0), (1e9, 1.0)])
def test_gain_is_held_outside(place: float, gain: float) -> None:
    assert compute(place) == gain


def test_gain_just_beside_an_entry_is_next_to_its_value() -> None:
    assert compute(math.nextafter(0.5, 0.0)) == pytest.approx(2.0, abs=1e-14)
    assert compute(math.nextafter(0.5, 1.0)) == pytest.approx(2.0, abs=1e-14)


@BOTH
def test_speed_follows_the_gain_of_the_distance(kind: str) -> None:
    run = tl.simulate_run(build_scheduled(kind))
    samples = run.samples
    assert samples.error_xy_m is not None
    assert samples.world_velocity_m_s is not None
    assert samples.distance_m is not None
    rows = np.flatnonzero(np.array(run.phase_names)[samples.phase] == "translate")[:-1]
    gains = np.interp(samples.distance_m[rows], TABLE["schedule__at"], [4.0, 2.0, 1.0])
    expected = gains[:, None] * samples.error_xy_m[rows]
    np.testing.assert_allclose(samples.world_velocity_m_s[rows], expected, rtol=1e-13)
    assert gains.max() > 3.9
    assert gains.min() == 1.0


@BOTH
@pytest.mark.parametrize("wrap", [True, False])
def test_turn_rate_follows_the_gain_of_the_heading_error(
    kind: str,
    wrap: bool,  # noqa: FBT001
) -> None:
    table: dict[str, Any] = {
        "schedule__over": "heading_error",
        "schedule__at": [0.0, 1.0, 4.0, 5.0],
    }
    table |= {"schedule__kp_linear": [1.0] * 4, "schedule__kp_angular": [3.0, 1.0, 2.0, 2.5]}
    scenario = build_scheduled(kind, **table, wrap_error=wrap)
    run = tl.simulate_run(override_scenario(scenario, {"start.heading_rad": -2.5}))
    samples = run.samples
    assert samples.heading_error_rad is not None
    assert samples.wanted_turn_rate_rad_s is not None
    rows = np.flatnonzero(np.array(run.phase_names)[samples.phase] == "rotate")[1:-1]
    error_rad = samples.heading_error_rad[rows]
    gains = np.interp(np.abs(error_rad), [0.0, 1.0, 4.0, 5.0], [3.0, 1.0, 2.0, 2.5])
    assert (np.abs(error_rad).max() > math.pi) is np.bool_(not wrap)
    wanted = samples.wanted_turn_rate_rad_s[rows]
    np.testing.assert_allclose(wanted, gains * error_rad, rtol=1e-13)


def test_integral_does_not_jump_where_its_gain_does() -> None:
    table: dict[str, Any] = {
        "schedule__at": [0.0, 1.0, 1.001, 9.0],
        "schedule__kp_linear": [1.0] * 4,
    }
    table |= {"schedule__ki_linear": [2.0, 2.0, 0.05, 0.05]}
    scenario = override_scenario(
        build_scheduled("sequential-pid", **table), {"limits.speed_m_s": 9}
    )
    run = tl.simulate_run(scenario)
    assert run.samples.states is not None
    assert run.samples.distance_m is not None
    integral, distance_m = run.samples.states[:, 2], run.samples.distance_m
    crossing = int(np.flatnonzero(distance_m < 1.0)[0])
    before = integral[crossing] - integral[crossing - 1]
    # Errors of 1 m times 2 /s^2 times 16 ms; scaled with its gain it would be 40 times as large.
    assert abs(before) < 0.033
    assert integral[crossing] > 0.1


def test_schedule_of_equal_values_is_the_constant_gain() -> None:
    table: dict[str, Any] = {"schedule__kp_linear": [1.5] * 3, "schedule__kp_angular": [1.5] * 3}
    run = tl.simulate_run(build_scheduled(**table))
    constant = tl.simulate_run(build_run(kind="sequential-p", kp_linear=1.5, kp_angular=1.5))
    assert run.poses.xy_m.tobytes() == constant.poses.xy_m.tobytes()


@BOTH
def test_schedule_round_trips_through_texts_and_recordings(kind: str, tmp_path: Any) -> None:
    scenario = build_scheduled(kind)
    assert parse_scenario(format_scenario(scenario)) == scenario
    run = tl.simulate_run(scenario)
    tl.write_recording(run, tmp_path / "run.mcap")
    again = tl.read_run(tmp_path / "run.mcap")
    assert again.parameters == run.parameters == flatten_scenario(scenario)
    assert run.parameters["law.schedule.kp_linear"] == [4.0, 2.0, 1.0]
    assert "law.schedule.kp_angular" not in run.parameters
    assert tl.scenario.restore_scenario(again) == scenario


def test_summary_holds_no_schedule_where_there_is_none_or_another_key_for_it() -> None:
    for scenario in (build_scheduled(), build_run(kind="sequential-p")):
        summary = summarise_run(tl.simulate_run(scenario))
        assert "law.schedule" not in summary.parameters
        assert None not in summary.parameters.values()
        assert summary.parameters["law.reorient"] is False


def test_schedule_and_reorient_are_absent_by_default() -> None:
    text = format_scenario(tl.load_scenario("textbook"))
    assert "schedule" not in text
    assert "reorient" not in text


def test_scheduled_loop_declares_no_gain_and_the_other_keeps_its_own() -> None:
    declared = tl.simulate.declare_scenario(build_scheduled())
    assert [loop.gain for loop in declared.loops] == ["law.kp_angular", None]
    assert [loop.is_proportional for loop in declared.loops] == [True, False]
    assert declared.list_gains() == ("law.kp_angular",)
    pid = tl.simulate.declare_scenario(build_scheduled("sequential-pid"))
    assert pid.loops[1].integral_gain is None
    assert pid.loops[0].integral_gain == "law.ki_angular"


@pytest.mark.parametrize(
    ("change", "line"),
    [
        ({"over": "speed"}, "schedule.over: expected distance or heading_error, found 'speed'"),
        ({"at": [0.0, 0.5, 0.5]}, "schedule.at: expected rising numbers, found 0.5 after 0.5"),
        ({"at": [0.0, 2.0, 1.0]}, "schedule.at: expected rising numbers, found 1 after 2"),
        ({"at": [0.0, math.nan, 1.0]}, "schedule.at: expected finite numbers >= 0, found nan"),
        ({"at": [0.0, 1.0, math.inf]}, "schedule.at: expected finite numbers >= 0, found inf"),
        ({"at": [-1.0, 1.0, 2.0]}, "schedule.at: expected finite numbers >= 0, found -1.0"),
        ({"at": [1.0]}, "schedule.at: expected 2 to 1000 entries, found 1"),
        ({"at": []}, "schedule.at: expected 2 to 1000 entries, found 0"),
        ({"at": 1.0}, "schedule.at: expected a list, found 1.0"),
        ({"at": [0.0, "a"]}, "schedule.at[1]: expected float, found str"),
        (
            {"kp_linear": [1, 2]},
            "schedule.kp_linear: expected 3 entries, one for each of at, found 2",
        ),
        ({"kp_linear": [1, 0, 2]}, "schedule.kp_linear: expected finite numbers > 0, found 0.0"),
        ({"kp_linear": [1, -1, 2]}, "schedule.kp_linear: expected finite numbers > 0, found -1.0"),
        (
            {"kp_angular": [1, math.nan, 2]},
            "schedule.kp_angular: expected finite numbers > 0, found nan",
        ),
        ({"ki_linear": [1, 2, 3]}, "schedule.ki_linear: unknown key; did you mean kp_linear?"),
        ({"kp": 1}, "schedule.kp: unknown key; did you mean kp_angular or kp_linear?"),
    ],
)
def test_wrong_schedule_is_told_in_one_line_that_names_the_key(
    change: dict[str, Any], line: str
) -> None:
    values = {f"law.schedule.{key}": value for key, value in change.items()}
    with pytest.raises(ScenarioError) as found:
        override_scenario(build_scheduled(), values)
    assert str(found.value) == f"changes: law.{line}"


@pytest.mark.parametrize("name", ["ki_linear", "kd_angular"])
def test_gains_of_pid_may_be_0_in_a_schedule_and_not_below(name: str) -> None:
    build_scheduled("sequential-pid", **{f"schedule__{name}": [0.0, 0.0, 1.0]})
    line = rf"\Achanges: law\.schedule\.{name}: expected finite numbers >= 0, found -0\.1\Z"
    with pytest.raises(ScenarioError, match=line):
        build_scheduled("sequential-pid", **{f"schedule__{name}": [0.0, -0.1, 1.0]})


@pytest.mark.parametrize("lacking", ["over", "at"])
def test_schedule_that_lacks_a_part_is_named(lacking: str) -> None:
    table = {key: value for key, value in TABLE.items() if key != f"schedule__{lacking}"}
    line = rf"\Achanges: law\.schedule\.{lacking}: expected [^\n]+, found no value\Z"
    with pytest.raises(ScenarioError, match=line):
        build_run(kind="sequential-p", **{f"law__{key}": table[key] for key in table})


def test_schedule_without_a_gain_is_refused() -> None:
    with pytest.raises(
        LawError, match=r"\Aover: expected kp_angular or kp_linear beside it, found"
    ):
        GainSchedule(over="distance", at=(0.0, 1.0))
    assert PIDGainSchedule(over="distance", at=(0, 1), kd_linear=(0, 1)).gains == ("kd_linear",)


@pytest.mark.parametrize("entries", [2, MOST_ENTRIES])
def test_longest_and_shortest_schedule(entries: int) -> None:
    at = tuple(0.01 * number for number in range(entries))
    GainSchedule(over="distance", at=at, kp_linear=(1.0,) * entries)


def test_longer_schedule_is_refused() -> None:
    at = tuple(map(float, range(1, MOST_ENTRIES + 2)))
    with pytest.raises(LawError, match=r"\Aat: expected 2 to 1000 entries, found 1001"):
        GainSchedule(over="distance", at=at, kp_linear=at)


@pytest.mark.thorough
@BOTH
def test_nothing_is_identified_of_a_scheduled_law_and_its_scenario_still_explains(
    kind: str,
) -> None:
    run = tl.simulate_run(build_scheduled(kind))
    found = identify_run(run)
    told = [key for key, finding in found.findings.items() if finding.value is not None]
    assert not [key for key in told if key.startswith("law.")]
    assert found.is_recorded
    if kind == "sequential-p":
        assert found.notes[0].startswith("its gains are scheduled: ")
    attribution = attribute_run(run, metric="final.position_error", identified=found)
    assert attribution.resimulated == attribution.as_logged is not None
