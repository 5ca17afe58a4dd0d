"""Metrics at their places on curves."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

import turtlelog as tl
from tests.draw.laws import simulate_tracker
from tests.draw.rerun.rrds import make_foreign_run
from turtlelog.charts.curve_marks import Characteristic, list_characteristics, read_marked_curve
from turtlelog.measure import MeasureSettings, measure_run
from turtlelog.scenario import get_preset

RUN = tl.simulate_run(get_preset("paper-kp10"))
METRICS = measure_run(RUN)
MARKS = {mark.metric: mark for mark in list_characteristics(RUN, METRICS)}


def list_of(run: tl.Run) -> dict[str, Characteristic]:
    return {mark.metric: mark for mark in list_characteristics(run, measure_run(run))}


@pytest.mark.parametrize("name", [name for name in MARKS if name != "run.pause"])
def test_a_characteristic_has_the_value_of_its_metric_at_a_place_on_its_curve(name: str) -> None:
    mark, metric = MARKS[name], METRICS[name]
    assert (mark.value, mark.unit) == (metric.value, metric.unit)
    curve = read_marked_curve(RUN, mark.signal)
    assert curve is not None
    assert mark.level is not None
    if metric.at_s is not None:
        assert mark.at_s == metric.at_s
    if not curve.holds:
        near = np.abs(curve.time_s - mark.at_s) < 0.02
        assert curve.values[near].min() - 1e-9 <= mark.level <= curve.values[near].max() + 1e-9


def test_a_rise_spans_10_to_90_percent_of_the_step() -> None:
    rise = MARKS["translate.rise_time"]
    curve = read_marked_curve(RUN, "along_track")
    assert curve is not None
    assert rise.span_s is not None
    assert rise.levels is not None
    assert np.interp(rise.span_s, curve.time_s, curve.values) == pytest.approx(rise.levels)
    assert rise.levels == pytest.approx((0.5693422653904812, 5.1240803885143), rel=1e-4)


def test_a_heading_stays_in_its_band_from_the_settling_time_on() -> None:
    settled = MARKS["rotate.settling_time"]
    curve = read_marked_curve(RUN, "heading")
    assert curve is not None
    assert settled.span_s is not None
    assert settled.levels is not None
    start_s, end_s = settled.span_s
    inside = (curve.time_s > start_s) & (curve.time_s <= end_s)
    low, high = settled.levels
    assert ((curve.values[inside] >= low) & (curve.values[inside] <= high)).all()
    before = curve.values[curve.time_s < start_s][-1]
    assert not low <= before <= high
    assert high - low == pytest.approx(0.04 * 128.50264418385171)


def test_a_settling_band_is_that_of_the_settings() -> None:
    settings = MeasureSettings(band=0.05)
    metrics = measure_run(RUN, settings)
    (mark,) = [
        found
        for found in list_characteristics(RUN, metrics, settings)
        if found.metric == "rotate.settling_time"
    ]
    assert mark.levels is not None
    assert mark.levels[1] - mark.levels[0] == pytest.approx(0.1 * 128.50264418385171)


def test_an_overshoot_goes_from_the_reference_to_the_peak() -> None:
    overshoot, peak = MARKS["rotate.overshoot"], MARKS["rotate.peak"]
    assert overshoot.levels == peak.levels
    assert peak.levels == pytest.approx((128.50264418385171, peak.value))
    assert overshoot.level == pytest.approx(peak.value)


@pytest.mark.parametrize(
    ("percent", "text"),
    [(-0.01, "no overshoot"), (0.0, "overshoot 0 %"), (1.5, "overshoot 1.5 %")],
)
def test_a_step_that_ends_below_its_reference_has_no_overshoot(percent: float, text: str) -> None:
    assert replace(MARKS["rotate.overshoot"], value=percent).text == text


def test_pause_dead_time_and_saturation_last_as_long_as_they_say() -> None:
    for name in ("run.pause", "rotate.dead_time", "translate.longest_saturation"):
        mark = MARKS[name]
        assert mark.span_s is not None
        assert mark.span_s[1] - mark.span_s[0] == pytest.approx(mark.value)
        assert mark.span_s[0] == mark.at_s
    pause = MARKS["run.pause"]
    assert (pause.signal, pause.level) == ("", None)
    assert pause.value == pytest.approx(0.528)


def test_the_robot_follows_a_command_when_its_dead_time_is_over() -> None:
    mark, poses = MARKS["rotate.dead_time"], RUN.poses
    assert mark.span_s is not None
    assert poses.turn_rate_rad_s is not None
    answered, follows = (
        int(np.argmin(np.abs((poses.time_ns - RUN.start_ns) / 1e9 - at_s))) for at_s in mark.span_s
    )
    (row,) = np.flatnonzero(RUN.samples.pose_sequence == answered)
    commanded, before = RUN.samples.turn_rate_rad_s[[row, row - 1]]
    assert poses.turn_rate_rad_s[follows] == pytest.approx(before, abs=1e-6)
    assert poses.turn_rate_rad_s[follows + 1] == pytest.approx(commanded, abs=1e-6)
    assert abs(commanded - before) > 0.1


def test_a_metric_without_a_value_is_nowhere() -> None:
    metrics = dict(METRICS)
    metrics["rotate.rise_time"] = replace(metrics["rotate.rise_time"], value=None)
    assert "rotate.rise_time" not in {mark.metric for mark in list_characteristics(RUN, metrics)}


def test_a_law_whose_reference_moves_is_furthest_off_on_its_error() -> None:
    run = simulate_tracker("kanayama")
    marks = list_of(run)
    moving = [mark for mark in marks.values() if mark.kind == "largest_error"]
    assert moving
    assert not [mark for mark in marks.values() if mark.kind in {"rise_time", "overshoot"}]


def test_a_bag_without_a_controller_has_what_its_poses_tell() -> None:
    assert all(not mark.loop for mark in list_of(make_foreign_run(60)).values())


def test_characteristics_need_neither_rerun_nor_matplotlib() -> None:
    loaded = "print({'rerun', 'matplotlib'} & {*sys.modules})"
    code = f"import sys, turtlelog.charts.curve_marks; {loaded}"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout == "set()\n"
