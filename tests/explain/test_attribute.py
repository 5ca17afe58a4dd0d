import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from tests.explain.logs import simulate
from tests.log.runs import find_shared
from turtlelog.errors import ExplainError
from turtlelog.explain import (
    MECHANISMS,
    Attribution,
    attribute_run,
    attribute_scenario,
    write_sentences,
)
from turtlelog.explain.finer import FINER, simulate_finer
from turtlelog.log import import_log
from turtlelog.measure import DeadTime, find_dead_time, measure_run
from turtlelog.run import Phase
from turtlelog.scenario import get_preset, override_scenario


def attribute(name: str, *mechanisms: str, **options: Any) -> Attribution:
    return attribute_scenario(
        get_preset(name), mechanisms=mechanisms or ("queue", "pause"), **options
    )


def read_shares(found: Attribution) -> dict[str, float]:
    return {share.mechanism: share.share or 0.0 for share in found.shares}


def read_alone(found: Attribution) -> dict[str, float | None]:
    return {share.mechanism: share.alone for share in (*found.shares, *found.others)}


def test_without_queue_and_pause_the_gain_of_ten_ends_within_six_millimetres() -> None:
    found = attribute("paper-kp10")
    assert (round(found.as_built, 4), round(found.without_all, 4)) == (0.1067, 0.0051)
    assert found.without_all < 0.006
    assert read_shares(found) == pytest.approx({"queue": 0.05108, "pause": 0.05057}, abs=1e-5)
    assert found.interaction == pytest.approx(0.0576, abs=1e-4)


def test_a_recorded_run_needs_no_scenario() -> None:
    found = attribute_run(import_log(find_shared("paper", "kp4_210.json")))
    assert found == attribute("paper-kp4")


def test_the_figure_with_one_mechanism_out_is_that_of_a_simulation_without_it() -> None:
    found = read_alone(attribute("paper-kp10"))
    without = simulate("paper-kp10", law__pause_ticks=0)
    assert found["pause"] == measure_run(without)["final.position_error"].value
    unlimited = simulate("paper-kp10", limits__speed_m_s=math.inf, limits__turn_rate_rad_s=math.inf)
    assert found["saturation"] == measure_run(unlimited)["final.position_error"].value
    assert {*found} == {*MECHANISMS}


@settings(max_examples=12, deadline=None, derandomize=True)
@given(
    st.sampled_from(["paper-kp1", "paper-kp2", "paper-kp4", "paper-kp10", "textbook"]),
    st.lists(
        st.sampled_from(["queue", "pause", "saturation", "float32", "tolerance"]),
        min_size=1,
        max_size=3,
        unique=True,
    ),
    st.sampled_from(["final.position_error", "final.heading_error", "run.duration"]),
)
def test_shares_add_up_to_the_last_bit(name: str, mechanisms: list[str], metric: str) -> None:
    found = attribute(name, *mechanisms, metric=metric)
    assert math.fsum(read_shares(found).values()) == found.as_built - found.without_all


def test_the_order_of_the_players_changes_no_share() -> None:
    forth = attribute("paper-kp10", "queue", "pause", "saturation")
    back = attribute("paper-kp10", "saturation", "pause", "queue")
    assert read_shares(forth) == pytest.approx(read_shares(back), rel=1e-12)


def test_a_mechanism_that_is_not_there_has_no_share() -> None:
    found = attribute("textbook")
    assert read_shares(found) == {"queue": 0.0, "pause": 0.0}
    assert write_sentences(found)[0] == (
        "final.position_error is 0.005692 m, with or without queue and pause."
    )


def test_a_negative_share_is_said_to_help() -> None:
    found = attribute("paper-kp1")
    assert read_shares(found)["pause"] < 0.0
    assert "pause helps and takes 0.002909 m away" in write_sentences(found)[0]


def test_saturation_helps_where_commands_queue() -> None:
    alone = read_alone(attribute("paper-kp10"))["saturation"]
    assert alone is not None
    assert alone > 0.8
    assert any("Saturation helps" in text for text in write_sentences(attribute("paper-kp10")))


def test_what_remains_is_named() -> None:
    sentences = write_sentences(attribute("paper-kp10"))
    assert sentences[0] == (
        "final.position_error is 0.1067 m: queue adds 0.05108 m and pause adds 0.05057 m (their"
        " acting together, which is in these shares, adds 0.05761 m); without queue and pause it"
        " would be 0.005077 m."
    )
    assert sentences[1] == (
        "What remains without them the heading tolerance explains: up to 0.005693 m."
    )


def test_without_tolerance_nearly_nothing_remains() -> None:
    found = attribute("paper-kp10", "queue", "pause", "tolerance")
    assert found.without_all < 5e-4


@pytest.mark.parametrize(
    ("options", "line"),
    [
        ({"metric": "final.speed"}, "metric 'final.speed': expected "),
        ({"mechanisms": ["puase"]}, "mechanism: expected pause, found 'puase'"),
        ({"mechanisms": ["luck"]}, "mechanism: expected queue, pause, .*, found 'luck'"),
        ({"mechanisms": []}, "mechanisms: expected 1 to 6 different ones, found"),
        ({"mechanisms": ["queue", "queue"]}, "expected 1 to 6 different ones, found queue, queue"),
    ],
    ids=str,
)
def test_what_is_not_known_is_refused(options: dict[str, Any], line: str) -> None:
    with pytest.raises(ExplainError, match=line):
        attribute_scenario(get_preset("textbook"), **options)


def test_a_figure_that_does_not_exist_is_said() -> None:
    scenario = override_scenario(get_preset("paper-kp4"), {"max_duration_s": 2.0})
    with pytest.raises(ExplainError, match=r"translate.duration: expected a value.*no phase"):
        attribute_scenario(scenario, metric="translate.duration")


def test_another_law_is_refused() -> None:
    kind = {"law.kind": "examples/turn_and_drive.py:TurnAndDrive"}
    scenario = override_scenario(get_preset("textbook"), kind)
    with pytest.raises(ExplainError, match="expected a run of the law sequential-p"):
        attribute_scenario(scenario)


@pytest.mark.parametrize("name", ["paper-kp1", "paper-kp4"])
def test_a_finer_clock_leaves_the_dead_times(name: str) -> None:
    coarse, fine = simulate(name), simulate_finer(get_preset(name))
    assert np.diff(fine.poses.time_ns).max() * FINER == np.diff(coarse.poses.time_ns).max()
    for phase in (Phase.ROTATE, Phase.TRANSLATE):
        before = find_dead_time(coarse, phase)
        assert isinstance(before, DeadTime)
        sent = fine.samples.turn_rate_rad_s if phase is Phase.ROTATE else fine.samples.speed_m_s
        applied = fine.poses.turn_rate_rad_s if phase is Phase.ROTATE else fine.poses.speed_m_s
        assert applied is not None
        rows = np.flatnonzero(fine.samples.phase == phase)[:-1][40:]
        at = fine.samples.pose_sequence[rows] + before.ticks * FINER + 1
        rows, at = rows[at < len(applied)], at[at < len(applied)]
        assert np.array_equal(applied[at], np.abs(np.float32(sent[rows] / FINER)) * FINER)


def test_a_finer_clock_comes_nearer_to_the_ideal_loop() -> None:
    values = {"limits.turn_rate_rad_s": math.inf, "law.kp_angular": 10.0}
    scenario = override_scenario(get_preset("textbook"), values)
    errors = []
    for run in (simulate("textbook", **{key.replace(".", "__"): v for key, v in values.items()}),
                simulate_finer(scenario)):  # fmt: skip
        rotating = run.samples.phase == Phase.ROTATE
        time_s = run.samples.time_ns[rotating] / 1e9
        heading = run.poses.heading_rad[run.samples.pose_sequence[rotating]]
        ideal = run.samples.bearing_rad[0] * (1.0 - np.exp(-10.0 * time_s))
        errors.append(float(np.abs(heading - ideal).max()))
    assert errors[1] < 0.2 * errors[0]
