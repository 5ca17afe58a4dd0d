"""A metric is a number where it has a value, and raises where it has none."""

import copy
import math
import pickle
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

import turtlelog as tl

RUN = tl.read_recording("recordings/paper/kp10.mcap")
METRICS = tl.measure_run(RUN)
NUMBER = METRICS["run.duration"]
MISSING = METRICS["final.goal_heading_error"]


def test_a_metric_is_a_number() -> None:
    assert float(NUMBER) == NUMBER == 12.608
    assert 12 < NUMBER < 13
    assert (int(NUMBER), f"{NUMBER:.1f}", round(NUMBER, 1)) == (12, "12.6", 12.6)
    assert NUMBER + 1 == 1 + NUMBER == pytest.approx(13.608)
    assert math.sqrt(NUMBER) == np.sqrt(NUMBER)
    assert max(NUMBER, METRICS["rotate.duration"]) is NUMBER


def test_numpy_computes_with_metrics() -> None:
    assert np.array([NUMBER, NUMBER]).tolist() == [12.608, 12.608]
    assert np.mean([NUMBER, NUMBER]) == 12.608
    assert (np.array([1.0, 20.0]) > NUMBER).tolist() == [False, True]
    assert (np.array([1.0, 20.0]) > NUMBER).tolist() == [False, True]
    assert np.float64(13) > NUMBER
    assert np.isclose(NUMBER, 12.608)


USES: dict[str, Callable[[Any], Any]] = {
    "float": float,
    "order": lambda m: m > 1,
    "unequal": lambda m: m != 1,
    "equal": lambda m: m == 1,
    "sum": lambda m: m + 1,
    "magnitude": abs,
    "root": math.sqrt,
    "array": lambda m: np.array([m, m]),
    "order of numpy": lambda m: np.float64(1) < m,
    "sorted": lambda m: sorted([m, METRICS["final.heading_error"]]),
}


@pytest.mark.parametrize("use", USES.values(), ids=USES)
def test_a_metric_without_a_value_is_no_number(use: Callable[[Any], Any]) -> None:
    with pytest.raises(tl.errors.MissingValueError, match="the goal asks for no heading"):
        use(MISSING)


def test_equality_and_hash_are_those_of_value_and_unit() -> None:
    assert hash(NUMBER) == hash(12.608)
    assert {NUMBER: 1}[12.608] == 1  # type: ignore[index]
    again = tl.measure_run(RUN)
    assert again["run.duration"] == NUMBER
    assert again["final.goal_heading_error"] == MISSING != NUMBER
    assert len({MISSING, again["final.goal_heading_error"], NUMBER}) == 2
    for other in (None, "12.608", METRICS["rotate.overshoot"]):
        assert not other == NUMBER  # noqa: SIM201
        assert other != NUMBER


def test_order_of_two_units_and_truth_are_refused() -> None:
    with pytest.raises(tl.errors.MeasureError, match="two metrics of one unit, found % and s"):
        assert METRICS["rotate.overshoot"] > NUMBER
    with pytest.raises(tl.errors.CheckError, match=r"run\.duration: compare it with a limit"):
        assert NUMBER


def test_a_metric_that_no_recording_has_is_not_measured_otherwise() -> None:
    with pytest.raises(tl.errors.MeasureError, match="MeasureSettings"):
        METRICS["rotate.settling_time"](band=0.05)


def test_metrics_are_a_mapping_that_compares_all() -> None:
    later = tl.measure_run(RUN)
    assert later == METRICS
    assert dict(METRICS) == METRICS
    assert (METRICS.get("none"), "run.duration" in METRICS, next(iter(METRICS))) == (
        None,
        True,
        "rotate.duration",
    )
    assert tl.measure_run(RUN, only=["run.*"]) != METRICS


def dump_and_load(value: Any) -> Any:
    return pickle.loads(pickle.dumps(value))


@pytest.mark.parametrize("repeat", [copy.copy, copy.deepcopy, dump_and_load])
def test_copies_are_equal(repeat: Callable[[Any], Any]) -> None:
    assert repeat(NUMBER) == NUMBER
    assert repeat(METRICS) == METRICS
    assert repeat(METRICS).first == METRICS.first
    run = repeat(RUN)
    assert run.equals(RUN)
    assert (run == RUN) is (run is RUN)
    assert not run.poses.xy_m.flags.writeable
    signal = repeat(tl.read_signal(RUN, "x"))
    np.testing.assert_array_equal(signal, RUN.poses.xy_m[:, 0])
    topics = repeat(tl.read_columns("recordings/paper/kp10.mcap", ["/turtle1/pose"]))
    assert len(topics["/turtle1/pose"]) == 793


def test_runs_are_equal_where_all_that_they_hold_is() -> None:
    """Simulates three runs: 1 to 2 s."""
    scenario = tl.load_scenario("paper-kp10")
    run = tl.simulate_run(scenario)
    assert run.equals(tl.simulate_run(scenario))
    other = tl.simulate_run(tl.override_scenario(scenario, {"law.kp_linear": 4.0}))
    assert [run.equals(one) for one in (other, run.slice(0, 2), None, "run")] == [False] * 4


def test_threads_measure_the_same() -> None:
    with ThreadPoolExecutor(4) as pool:
        assert all(one == METRICS for one in pool.map(tl.measure_run, [RUN] * 4))
