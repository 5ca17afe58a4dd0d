import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

import turtlelog as tl
from tests.measure.runs import GOAL_M, make_straight_run, set_times
from tests.sequential import ROTATE
from turtlelog.errors import MeasureError
from turtlelog.measure import METRICS, choose_metrics, find_metric_kind
from turtlelog.measure.metrics.goal_and_path import PAPER_WINDOW_S
from turtlelog.run.loops import ControlLoop, Declaration

PAPER = Path(__file__).parents[2].parent / "shared" / "paper"

# Kp: heading error [deg], position error [m], both at 15 s; length [s]; samples. From the paper's
# logs; at Kp = 1, which still moves at 15 s, a clock of exact ticks reads 0.082518 m.
TABLE1 = {
    "kp1": ("0.0253", "0.082518", "20.53", 1265),
    "kp2": ("0.0076", "0.001011", "12.67", 773),
    "kp4": ("0.0857", "0.008520", "11.18", 681),
    "kp10": ("1.0739", "0.106728", "12.61", 770),
}


def measure(name: str, **changes: float | str | bool) -> dict[str, tl.Metric]:
    values = {key.replace("__", "."): value for key, value in changes.items()}
    scenario = tl.override_scenario(tl.load_scenario(name), values)
    return dict(tl.measure_run(tl.simulate_run(scenario)))


def read_value(metric: tl.Metric) -> float:
    assert metric.value is not None, metric.reason
    return metric.value


@pytest.mark.parametrize("name", TABLE1)
def test_simulated_runs_have_the_errors_of_table_1(name: str) -> None:
    run = tl.simulate_run(tl.load_scenario(f"paper-{name}"))
    metrics = tl.measure_run(run)
    assert (
        f"{read_value(metrics['final.heading_error_at_15s']):.4f}",
        f"{read_value(metrics['final.position_error_at_15s']):.6f}",
        f"{read_value(metrics['run.duration']):.2f}",
        len(run.samples),
    ) == TABLE1[name]


@pytest.mark.parametrize(
    ("name", "expected"),
    [("kp1", ("0.0253", "0.081545", "20.52")), ("kp4", ("0.0857", "0.008520", "11.17"))],
)
def test_imported_logs_have_the_errors_of_table_1(
    name: str, expected: tuple[str, str, str]
) -> None:
    path = PAPER / f"{name}_210.json"
    if not path.exists():
        pytest.skip(f"the paper's logs are not at {PAPER}")
    metrics = tl.measure_run(tl.log.import_log(path))
    assert (
        f"{read_value(metrics['final.heading_error_at_15s']):.4f}",
        f"{read_value(metrics['final.position_error_at_15s']):.6f}",
        f"{read_value(metrics['run.duration']):.2f}",
    ) == expected


def test_the_run_of_kp_1_ends_far_nearer_than_its_window_says() -> None:
    metrics = measure("paper-kp1")
    assert round(read_value(metrics["final.position_error"]), 4) == 0.0025
    assert round(read_value(metrics["final.position_error_at_15s"]), 4) == 0.0825


def test_the_signed_overshoot_of_kp_10_is_what_the_absolute_error_hides() -> None:
    assert round(read_value(measure("paper-kp10")["rotate.overshoot"]), 2) == 1.01
    assert read_value(measure("paper-kp1")["rotate.overshoot"]) < 0.0


def test_settling_times_are_measured_not_four_time_constants() -> None:
    settled = [measure(f"paper-{kp}")["rotate.settling_time"].value for kp in TABLE1]
    assert [round(found or 0.0, 2) for found in settled] == [4.08, 2.78, 2.28, 2.21]


def test_phases_cover_the_run() -> None:
    metrics = measure("paper-kp4")
    phases = sum(read_value(metrics[f"{phase}.duration"]) for phase in ("rotate", "translate"))
    assert phases == pytest.approx(read_value(metrics["run.duration"]))


def test_the_final_error_of_the_rotation_counts_the_pause() -> None:
    metrics = measure("paper-kp10")
    assert read_value(metrics["rotate.final_error"]) == pytest.approx(
        read_value(metrics["final.heading_error"])
    )


@pytest.mark.parametrize("start_rad", [3.0, 2.5, -2.0])
def test_a_rotation_across_the_seam_is_measured_along_the_way_it_took(start_rad: float) -> None:
    metrics = measure("textbook", start__heading_rad=start_rad, goal__y_m=5.0)
    assert abs(read_value(metrics["rotate.overshoot"])) < 1.0
    assert read_value(metrics["rotate.final_error"]) < 0.06


def test_a_cut_run_has_no_error_at_15_s() -> None:
    metric = measure("paper-kp1", max_duration_s=10.0)["final.position_error_at_15s"]
    assert (metric.value, metric.status) == (None, tl.measure.Status.TOO_SHORT)
    assert "cut at 9.9" in metric.reason


@pytest.mark.parametrize(("end_ns", "error_m"), [(15 * 10**9 - 1, None), (15 * 10**9, GOAL_M)])
def test_a_run_cut_at_15_s_has_its_error_there(end_ns: int, error_m: float | None) -> None:
    cut = set_times(make_straight_run(np.zeros(2), stop_reason=None), [0, end_ns])
    assert tl.measure_run(cut)["final.position_error_at_15s"].value == error_m


def test_a_run_that_ended_holds_its_last_error() -> None:
    metrics = measure("paper-kp4")
    assert read_value(metrics["run.duration"]) < PAPER_WINDOW_S
    at_15s = metrics["final.position_error_at_15s"]
    assert at_15s.value == metrics["final.position_error"].value


def test_a_phase_that_never_came_has_no_metrics() -> None:
    metrics = measure("paper-kp1", max_duration_s=5.0)
    statuses = {metrics[name].status for name in metrics if name.startswith("translate.")}
    assert statuses == {tl.measure.Status.NO_PHASE}


@pytest.mark.parametrize(
    ("poses", "length_s", "reason"), [(2, 0.016, ""), (1, None, "1 pose in translate")]
)
def test_a_phase_of_two_poses_is_measured(poses: int, length_s: float | None, reason: str) -> None:
    found = tl.measure_run(make_straight_run(np.zeros(poses)))["translate.duration"]
    assert (found.value, found.reason) == (length_s, reason)


def test_a_rotation_cut_outside_the_band_does_not_settle() -> None:
    metric = measure("paper-kp1", max_duration_s=2.0)["rotate.settling_time"]
    assert (metric.value, metric.status) == (None, tl.measure.Status.NOT_REACHED)


def test_a_translation_that_was_cut_has_no_largest_cross_track() -> None:
    names = ("translate.cross_track_max", "translate.cross_track_rms")
    cut, whole = measure("paper-kp1", max_duration_s=10.0), measure("paper-kp1")
    assert {cut[name].reason for name in names} == {"the run was cut in this phase"}
    assert None not in {whole[name].value for name in names}
    assert cut["run.cross_track_max"].value is not None  # of what the recording holds


def test_a_phase_that_was_cut_has_no_length_and_no_final_error() -> None:
    metrics = measure("paper-kp1", max_duration_s=2.0)
    names = ("rotate.duration", "rotate.overshoot", "rotate.final_error")
    assert {metrics[name].status for name in names} == {tl.measure.Status.TOO_SHORT}
    assert metrics["rotate.duration"].reason == "the run was cut in this phase"


def test_a_phase_cut_inside_the_band_has_settled_as_far_as_is_recorded() -> None:
    cut, whole = measure("paper-kp4", max_duration_s=10.0), measure("paper-kp4")
    assert cut["translate.overshoot"].status == tl.measure.Status.TOO_SHORT
    assert cut["translate.settling_time"] == whole["translate.settling_time"]


def test_a_return_to_a_phase_does_not_lengthen_it() -> None:
    run = tl.simulate_run(tl.load_scenario("paper-kp4"))
    phase = run.samples.phase.copy()
    phase[-50:] = ROTATE
    again = dataclasses.replace(run, samples=dataclasses.replace(run.samples, phase=phase))
    before, after = (tl.measure_run(found)["rotate.duration"].value for found in (run, again))
    assert before == after


def test_a_start_at_the_bearing_has_no_step() -> None:
    metric = measure("textbook", goal__x_m=9.0, goal__y_m=5.544444561004639)["rotate.overshoot"]
    assert (metric.value, metric.status) == (None, tl.measure.Status.NO_STEP)


def test_without_limits_nothing_is_saturated() -> None:
    metrics = measure("textbook", limits__speed_m_s=np.inf, limits__turn_rate_rad_s=np.inf)
    assert metrics["rotate.saturated_share"].value == 0.0
    assert metrics["translate.saturated_share"].value == 0.0


def test_a_limit_that_is_not_recorded_leaves_the_share_absent() -> None:
    path = PAPER / "kp1_210_main.csv"
    if not path.exists():
        pytest.skip(f"the paper's logs are not at {PAPER}")
    metric = tl.measure_run(tl.log.import_log(path))["rotate.saturated_share"]
    assert (metric.value, metric.status) == (None, tl.measure.Status.ABSENT)


def test_every_metric_has_a_value_or_a_reason() -> None:
    for metric in measure("paper-kp1", max_duration_s=2.0).values():
        assert (metric.value is None) == (metric.status is not tl.measure.Status.OK)
        assert bool(metric.reason) == (metric.value is None)


@pytest.mark.parametrize(("words", "nature"), [("Number of", "count"), ("Share of", "share")])
def test_what_a_metric_counts_or_shares_is_declared(words: str, nature: str) -> None:
    kinds = {name: kind for name, kind in METRICS.items() if kind.unit == "1"}
    named = {name for name, kind in kinds.items() if kind.meaning.startswith(words)}
    assert {name for name, kind in METRICS.items() if kind.nature == nature} == named


def test_shares_counts_and_verdicts_have_values_of_their_kind() -> None:
    for name, metric in measure("paper-kp10").items():
        kind, value = find_metric_kind(name), metric.value
        nature = None if kind is None else kind.nature
        if value is not None and nature in {"share", "count", "verdict"}:
            assert 0.0 <= value <= (math.inf if nature == "count" else 1.0)
            assert nature == "share" or value.is_integer()


@pytest.mark.parametrize("axis", ["speed", "turn rate"])
def test_a_metric_of_one_rate_declares_its_axis(axis: str) -> None:
    rates = ("published {}", "measured {} over", "the {} that the robot reports")
    words = [rate.format(axis) for rate in rates]
    kinds = {name: kind for name, kind in METRICS.items() if name.startswith("run.")}
    named = {name for name, kind in kinds.items() if any(word in kind.meaning for word in words)}
    declared = {name for name, kind in kinds.items() if kind.axis == axis.replace(" ", "_")}
    assert named
    assert named <= declared


@pytest.mark.parametrize("loop", ["a", "a-b", "a" * 60])
def test_metric_of_a_loop_that_some_law_may_have_is_one(loop: str) -> None:
    assert choose_metrics([f"{loop}.overshoot"], Declaration()) == (f"{loop}.overshoot",)


@pytest.mark.parametrize("loop", ["é", "_a", "a" * 61, "final"])
def test_metric_of_a_loop_that_no_law_may_have_is_none(loop: str) -> None:
    with pytest.raises(MeasureError, match=r'\Ano metric "\S+"; ') as caught:
        choose_metrics([f"{loop}.overshoot"], Declaration())
    assert f"mean {loop}.overshoot" not in str(caught.value)


@pytest.mark.parametrize("pattern", ["*dead_time", "rot*dead_time"])
def test_star_may_stand_for_a_loop_and_its_dot(pattern: str) -> None:
    loop = ControlLoop(
        name="rotate", signal="heading", command="turn_rate", reference="goal_bearing"
    )
    declaration = Declaration(loops=(loop,), phases={"rotate": ("rotate",)})
    assert choose_metrics([pattern], declaration) == ("rotate.dead_time",)
    assert choose_metrics([pattern], Declaration()) == ()  # of another law
    with pytest.raises(MeasureError, match=r"no metric"):
        choose_metrics([pattern.removesuffix("e")], Declaration())


def test_pattern_that_only_a_loop_called_run_could_match_is_refused() -> None:
    with pytest.raises(MeasureError, match=r'no metric "run\.oversh\*"; did you mean run\.'):
        choose_metrics(["run.oversh*"], Declaration())


def test_a_heading_that_the_law_does_not_use_is_no_reference_of_its_error() -> None:
    changes = {"goal.heading_rad": 1.0}
    run = tl.simulate_run(tl.override_scenario(tl.load_scenario("paper-kp4"), changes))
    found = tl.measure_run(run, only=["final.*"])
    plain = tl.measure_run(tl.simulate_run(tl.load_scenario("paper-kp4")), only=["final.*"])
    for name in ("final.heading_error", "final.heading_error_at_15s"):
        assert found[name].value == plain[name].value
    assert read_value(found["final.goal_heading_error"]) > 70.0
