"""Metrics of whole runs: against closed forms, under changes that must not matter, of bad runs."""

import dataclasses
import math
import re
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import turtlelog as tl
from tests.known import known
from tests.measure.runs import (
    EXPONENTIAL,
    GOAL_M,
    TIME_S,
    make_foreign_run,
    make_straight_run,
    read,
    shift_time,
    take_rows,
)
from tests.sequential import ROTATE

KP10 = tl.simulate_run(tl.load_scenario("paper-kp10"))
OF_LAW = tl.measure.list_metrics(KP10.declaration)


def test_a_response_of_the_ideal_loop_has_its_figures() -> None:
    # Every T of a sampled exponential costs T^2 / 8 and less at a crossing.
    expected = {"rise_time": math.log(9.0), "settling_time": math.log(50.0)}
    for name, value in {**expected, "delay_time": math.log(2.0)}.items():
        assert read(EXPONENTIAL, f"translate.{name}") == pytest.approx(value, abs=0.016**2 / 4.0)
    assert read(EXPONENTIAL, "translate.iae") == pytest.approx(GOAL_M, rel=1e-4)
    assert read(EXPONENTIAL, "translate.ise") == pytest.approx(GOAL_M**2 / 2.0, rel=1e-4)
    assert read(EXPONENTIAL, "translate.itae") == pytest.approx(GOAL_M, rel=1e-4)
    assert read(EXPONENTIAL, "translate.ideal_deviation_max") < 1e-12
    assert read(EXPONENTIAL, "translate.sampled_deviation_max") == pytest.approx(
        # Largest where k (1 - T)^k and k exp(-k T) are furthest apart: about T / (2 e) of the step.
        GOAL_M * 0.016 / (2.0 * math.e),
        rel=0.02,
    )


def test_a_sampled_loop_with_dead_time_is_told_from_the_others() -> None:
    along = [0.0]
    for row in range(600):
        read_at = along[max(row - 6, 0)] if row >= 6 else GOAL_M
        along.append(along[row] + 4.0 * 0.016 * (GOAL_M - read_at))
    along_m = np.array(along)
    run = make_straight_run(along_m, 4.0 * (GOAL_M - along_m), parameters={"law.kp_linear": 4.0})
    found = tl.measure_run(run, only=["translate.*"])
    assert found["translate.dead_time"].value == pytest.approx(0.096)
    deviations = [
        found[f"translate.{theory}_deviation_max"].value or 0.0
        for theory in ("ideal", "sampled", "delayed")
    ]
    assert deviations[2] < 1e-12
    assert min(deviations[:2]) > 0.1
    asked = tl.MeasureSettings(dead_time_ticks=0)
    assert read(run, "translate.delayed_deviation_max", asked) == deviations[1]


def test_a_dead_time_is_found_in_the_papers_loop() -> None:
    assert read(KP10, "rotate.dead_time") == pytest.approx(0.064)
    assert read(KP10, "translate.dead_time") == pytest.approx(0.096)


def test_the_largest_wanted_speeds_are_those_of_the_papers_figure_14() -> None:
    names = [f"paper-kp{kp}" for kp in (1, 2, 4, 10)]
    runs = [tl.simulate_run(tl.load_scenario(name)) for name in names]
    wanted = [read(run, "translate.largest_wanted") for run in runs]
    assert wanted == pytest.approx([5.69, 11.39, 22.77, 56.93], abs=0.005)


def test_effort_counts_the_command_that_the_pause_held() -> None:
    rotate = KP10.samples.phase == ROTATE
    sent_s = KP10.commands.time_ns[rotate] / 1e9
    held_s = np.diff(sent_s, append=sent_s[-1])
    expected = float(np.sum(held_s * KP10.samples.turn_rate_rad_s[rotate] ** 2))
    assert read(KP10, "rotate.effort") == pytest.approx(expected)


def test_the_largest_gap_is_the_pause_and_the_burst_follows_it() -> None:
    found = tl.measure_run(KP10, only=["run.largest_gap", "run.burst_samples"])
    assert found["run.largest_gap"].value == pytest.approx(33 * 0.016)
    assert found["run.largest_gap"].at_s == pytest.approx(2.464)
    # Four of the start backlog, nine of the ten poses that waited.
    assert found["run.burst_samples"].value == 13.0


def test_dropped_samples_are_counted_by_their_numbers() -> None:
    sequence = KP10.samples.sequence + np.where(np.arange(len(KP10.samples)) > 99, 3, 0)
    samples = dataclasses.replace(KP10.samples, sequence=sequence)
    assert read(dataclasses.replace(KP10, samples=samples), "run.dropped_samples") == 3.0


def test_duplicates_and_disorder_are_what_the_importer_counted() -> None:
    run = dataclasses.replace(KP10, origin=tl.run.Origin(dropped_duplicates=2, sorted_rows=7))
    assert (read(run, "run.duplicates"), read(run, "run.disorder")) == (2.0, 7.0)
    assert (read(KP10, "run.duplicates"), read(KP10, "run.disorder")) == (0.0, 0.0)


def test_percentiles_of_a_run_are_periods_that_it_has() -> None:
    periods_ns = np.arange(1, 51) * 1_000_000
    run = take_rows(EXPONENTIAL, 51)
    samples = dataclasses.replace(run.samples, time_ns=np.append(0, np.cumsum(periods_ns)))
    run = dataclasses.replace(run, samples=samples)
    found = [read(run, f"run.sample_period_p{percent}") for percent in (50, 95, 99)]
    assert found == pytest.approx([0.0255, 0.048, 0.050])


def test_the_cross_track_error_of_a_run_starts_at_its_first_sample() -> None:
    """Five poses wait when the controller starts: what happened before is not of the run."""
    beside = tl.MeasureSettings(reference_path_xy_m=np.array([[0.0, 6.0], [9.0, 6.0]]))
    first = int(np.searchsorted(KP10.poses.time_ns, KP10.start_ns))
    assert first == 4
    xy_m = KP10.poses.xy_m.copy()
    xy_m[:first] += 30.0
    moved = dataclasses.replace(KP10, poses=dataclasses.replace(KP10.poses, xy_m=xy_m))
    for name in ("run.cross_track_rms", "run.cross_track_max"):
        assert read(moved, name, beside) == read(KP10, name, beside)
    signal = tl.read_signal(KP10, "cross_track")
    assert signal is not None
    values, step_s = signal.values[first:], np.diff(KP10.poses.time_ns[first:]) / 1e9
    square = (values[:-1] ** 2 + values[:-1] * values[1:] + values[1:] ** 2) / 3.0
    expected = math.sqrt(float(np.sum(step_s * square) / np.sum(step_s)))
    assert read(KP10, "run.cross_track_rms") == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(("share", "has_rise_time"), [(0.099, True), (0.101, False)])
def test_a_step_that_begins_beyond_a_tenth_has_no_rise_time(
    share: float,
    has_rise_time: bool,  # noqa: FBT001
) -> None:
    initial = -GOAL_M * share / (1.0 - share)
    asked = tl.MeasureSettings(initial={"translate": initial})
    metric = tl.measure_run(EXPONENTIAL, asked, only=["translate.rise_time"])
    found = metric["translate.rise_time"]
    assert (found.status is tl.measure.Status.OK) == has_rise_time
    if not has_rise_time:
        assert found.status is tl.measure.Status.NOT_REACHED
        assert found.reason == "the response begins beyond 10 % of the step"


@pytest.mark.parametrize("theory", ["sampled", "delayed"])
@pytest.mark.parametrize(("rows", "has_value"), [(30, True), (31, False)])
def test_an_unstable_theory_has_a_deviation_only_where_it_is_not_stopped(
    theory: str,
    rows: int,
    has_value: bool,  # noqa: FBT001
) -> None:
    """At Kp T = 3 the sampled loop is at (-2)^k steps: 2^29 are less than 1e9, 2^30 are more."""
    parameters = {"law.kp_linear": 3.0 / 0.016}
    run = make_straight_run(np.linspace(0.0, GOAL_M, rows), parameters=parameters)
    names = [f"translate.{theory}_deviation_{figure}" for figure in ("max", "rms")]
    asked = tl.MeasureSettings(dead_time_ticks=0)
    for metric in tl.measure_run(run, asked, only=names).values():
        if has_value:
            assert metric.status is tl.measure.Status.OK
            continue
        assert (metric.value, metric.status) == (None, tl.measure.Status.TOO_LARGE)
        assert metric.reason == (
            "theory's loop is unstable: beyond 1e+09 steps before the phase ends"
        )
    if has_value:
        found = read(run, names[0], asked)
        assert found == pytest.approx(GOAL_M * 2.0**29, rel=1e-6)


def test_moments_are_told_from_the_first_sample() -> None:
    found = tl.measure_run(KP10)
    start_s = found["rotate.duration"].value or 0.0
    peak, settled = found["translate.peak_time"], found["translate.settling_time"]
    assert peak.at_s == pytest.approx((peak.value or 0.0) + start_s)
    assert settled.at_s == pytest.approx((settled.value or 0.0) + start_s)
    assert found["translate.iae"].at_s is None


def test_a_reference_path_takes_the_place_of_the_line_to_the_goal() -> None:
    beside = tl.MeasureSettings(reference_path_xy_m=np.array([[0.0, 6.0], [9.0, 6.0]]))
    assert read(EXPONENTIAL, "run.cross_track_max", beside) == pytest.approx(1.0)
    assert read(EXPONENTIAL, "translate.cross_track_rms", beside) == pytest.approx(1.0)
    assert read(EXPONENTIAL, "run.cross_track_max") == 0.0
    assert read(make_foreign_run(), "run.cross_track_max", beside) == pytest.approx(6.0)


@pytest.mark.parametrize(
    ("choice", "overshoot"),
    [
        ({}, 20.0),
        ({"final": "last"}, 100.0 * (6.0 - 4.0) / 4.0),
        ({"final": 8.0}, -25.0),
        ({"final": {"translate": 4.0}, "initial": {"translate": 2.0}}, 100.0),
        ({"final": {"rotate": 1.0}, "initial": {"rotate": 2.0}}, 20.0),
    ],
)
def test_the_step_leads_from_and_to_what_is_asked(
    choice: dict[str, object], overshoot: float
) -> None:
    run = make_straight_run(np.array([0.0, 3.0, 6.0, 4.0]))
    asked = tl.MeasureSettings(**choice)  # type: ignore[arg-type]
    assert read(run, "translate.overshoot", asked) == pytest.approx(overshoot)


def test_a_heading_that_is_asked_for_is_taken_at_the_turn_where_the_rotation_ended() -> None:
    scenario = tl.override_scenario(tl.load_scenario("textbook"), {"start.heading_rad": 3.0})
    run = tl.simulate_run(tl.override_scenario(scenario, {"goal.x_m": 5.0, "goal.y_m": 1.0}))
    bearing_rad = float(known(run.samples.bearing_rad)[0])
    for turns in (-1, 0, 1):
        asked = tl.MeasureSettings(final=bearing_rad + turns * math.tau)
        expected = read(run, "rotate.overshoot")
        assert read(run, "rotate.overshoot", asked) == pytest.approx(expected)


def test_a_wider_band_settles_sooner_and_says_its_width() -> None:
    usual = read(EXPONENTIAL, "translate.settling_time")
    wide = tl.MeasureSettings(band=0.05)
    assert read(EXPONENTIAL, "translate.settling_time", wide) == pytest.approx(
        math.log(20.0), abs=1e-3
    )
    assert usual > math.log(20.0)
    short = tl.measure_run(take_rows(EXPONENTIAL, 100), wide)["translate.settling_time"]
    assert short.reason == "the phase ends outside the 5 % band"


@settings(deadline=None, max_examples=10)
@given(shift_ns=st.integers(-(2**61), 2**61))
def test_time_of_day_does_not_matter(shift_ns: int) -> None:
    assert tl.measure_run(shift_time(KP10, shift_ns)) == tl.measure_run(KP10)


@settings(deadline=None, max_examples=20)
@given(exponent=st.integers(-6, 6))
def test_another_unit_of_length_scales_lengths_and_nothing_else(exponent: int) -> None:
    scale = 2.0**exponent
    samples, poses = EXPONENTIAL.samples, EXPONENTIAL.poses
    scaled = dataclasses.replace(
        EXPONENTIAL,
        poses=dataclasses.replace(poses, xy_m=poses.xy_m * scale),
        samples=dataclasses.replace(
            samples,
            error_xy_m=known(samples.error_xy_m) * scale,
            distance_m=known(samples.distance_m) * scale,
            speed_m_s=samples.speed_m_s * scale,
        ),
        commands=dataclasses.replace(
            EXPONENTIAL.commands, speed_m_s=EXPONENTIAL.commands.speed_m_s * scale
        ),
        goal_xy_m=(6.0 * scale, 5.0 * scale),
        parameters={"law.kp_linear": 1.0, "limits.speed_m_s": scale},
    )
    power = {"m": 1, "m s": 1, "m s^2": 1, "m/s": 1, "m/s^2": 1, "m^2 s": 2, "m^2/s": 2}
    # Dead time is found by the plant's own walls and rounding, rest by a speed: they do not scale.
    others = ("dead_time", "delayed", "run.rest", "spectral")
    only = [name for name in OF_LAW if not any(word in name for word in others)]
    before, after = (tl.measure_run(run, only=only) for run in (EXPONENTIAL, scaled))
    for name, metric in before.items():
        assert after[name].status is metric.status, name
        if metric.value is not None:
            expected = metric.value * scale ** power.get(metric.unit, 0)
            assert after[name].value == pytest.approx(expected, rel=1e-9, abs=1e-12), name


@settings(deadline=None, max_examples=20)
@given(count=st.integers(1, 300))
def test_standing_at_the_goal_for_longer_changes_no_figure_of_the_response(count: int) -> None:
    along_m = np.append(-GOAL_M * np.expm1(-TIME_S), GOAL_M)
    longer = make_straight_run(np.append(along_m, np.full(count, GOAL_M)))
    names = ("delay_time", "rise_time", "settling_time", "overshoot", "undershoot", "peak")
    for name in (*names, "steady_state_error", "crossings", "iae", "ise", "itae"):
        expected = read(make_straight_run(along_m), f"translate.{name}")
        assert read(longer, f"translate.{name}") == pytest.approx(expected, rel=1e-9, abs=1e-12)


def test_only_what_is_asked_for_is_computed() -> None:
    asked = tl.measure_run(KP10, only=["final.*", "rotate.overshoot"])
    assert list(asked) == [
        name for name in OF_LAW if name.startswith("final.") or name == "rotate.overshoot"
    ]
    everything = tl.measure_run(KP10)
    assert asked == {name: everything[name] for name in asked}


@pytest.mark.parametrize(
    ("name", "near"),
    [
        ("rotate.overshot", "did you mean rotate.overshoot?"),
        ("position_eror", "did you mean final.position_error or"),
        ("turn.*xyz", "list: turtlelog list metrics"),
        ("", "list: turtlelog list metrics"),
    ],
)
def test_an_unknown_metric_is_refused_with_the_nearest(name: str, near: str) -> None:
    with pytest.raises(tl.TurtlelogError, match=re.escape(f'no metric "{name}"; {near}')):
        tl.measure_run(KP10, only=[name])


@pytest.mark.parametrize(
    ("choice", "line"),
    [
        (
            {"band": 0.0},
            "band: must be a fraction of the step from 0 to 1, as 0.02 for 2 %, not 0.0",
        ),
        (
            {"band": 1.0},
            "band: must be a fraction of the step from 0 to 1, as 0.02 for 2 %, not 1.0",
        ),
        (
            {"band": math.nan},
            "band: must be a fraction of the step from 0 to 1, as 0.02 for 2 %, not nan",
        ),
        ({"initial": math.inf}, "initial: expected a number, found inf"),
        ({"final": "end"}, "final: expected 'reference', 'last' or a number, found 'end'"),
        ({"final": {"rotate": "end"}}, "final: expected 'reference', 'last' or a number"),
        ({"dead_time_ticks": -1}, "dead_time_ticks: expected a whole number from 0 to 1000"),
        ({"dead_time_ticks": 1.5}, "dead_time_ticks: expected a whole number from 0 to 1000"),
        ({"reference_path_xy_m": np.zeros((1, 2))}, r"two points or more, .* found \(1, 2\)"),
        ({"reference_path_xy_m": np.full((2, 2), np.nan)}, r"path_xy_m\[0\]: expected finite"),
        ({"reference_path_xy_m": "way"}, "reference_path_xy_m: expected points"),
    ],
)
def test_settings_that_make_no_sense_are_refused(choice: dict[str, object], line: str) -> None:
    with pytest.raises(tl.TurtlelogError, match=line):
        tl.MeasureSettings(**choice)  # type: ignore[arg-type]


def test_settings_of_a_loop_that_the_law_does_not_have_are_refused() -> None:
    line = "initial: expected a loop rotate or translate, found 'pause'"
    with pytest.raises(tl.TurtlelogError, match=line):
        tl.measure_run(KP10, tl.MeasureSettings(initial={"pause": 1.0}))


def test_negative_overshoots_are_equally_good() -> None:
    kind = tl.METRICS["<loop>.overshoot"]
    assert kind.compute_loss(-2.0, -1.0) == kind.compute_loss(-1.0, -2.0) == 0.0
    assert kind.compute_loss(1.0, -2.0) == 1.0
    assert kind.compute_loss(-2.0, 1.5) == -1.5
    assert tl.METRICS["<loop>.peak"].compute_loss(1.0, 3.0) == 2.0


def test_every_metric_says_what_it_is() -> None:
    kinds = [*tl.METRICS.values(), *OF_LAW.values()]
    assert all(kind.meaning.endswith(".") and "{" not in kind.meaning for kind in kinds)
    assert all(kind.unit and "{" not in kind.unit for kind in kinds)
    assert set(tl.measure.list_essential_metrics(KP10.declaration)) <= set(OF_LAW)
    assert all(kind.better in {"lower", "higher", None} for kind in kinds)


def test_measuring_loads_neither_scipy_nor_control_nor_matplotlib() -> None:
    code = (
        "import sys, turtlelog as tl\n"
        "tl.measure_run(tl.simulate_run(tl.load_scenario('paper-kp4')))\n"
        "print(sorted({'scipy', 'control', 'matplotlib'} & sys.modules.keys()))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == ("[]\n", "")
