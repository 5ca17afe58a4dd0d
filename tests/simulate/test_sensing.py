"""What the controller reads of the plant's poses, against poses changed by hand."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.effects_cases import build_case
from turtlelog.arithmetic import round_to_step
from turtlelog.errors import SimulationError
from turtlelog.run import Run
from turtlelog.simulate import simulate_run

Values = NDArray[np.float64]


def simulate(*effects: str, **changes: Any) -> Run:
    return simulate_run(build_case(*effects, **changes))


def list_poses(run: Run) -> Values:
    return np.column_stack([run.poses.xy_m, run.poses.heading_rad])


def list_sensed(run: Run) -> Values:
    poses = run.poses
    assert poses.sensed_xy_m is not None
    assert poses.sensed_heading_rad is not None
    return np.column_stack([poses.sensed_xy_m, poses.sensed_heading_rad])


def as_float32(values: Values) -> Values:
    return values.astype(np.float32).astype(np.float64)


def test_noise_has_its_standard_deviation_and_no_mean() -> None:
    run = simulate("noise", sensing__noise_heading_rad=0.002, max_duration_s=30.0)
    left = list_sensed(run) - list_poses(run)
    count = len(left)
    assert count > 1000
    for noise, size in zip(left.T, (0.01, 0.01, 0.002), strict=True):
        # Four standard errors: a right noise fails once in 16,000 seeds, and the seed is fixed.
        assert abs(noise.mean()) < 4.0 * size / math.sqrt(count)
        assert abs(noise.std() / size - 1.0) < 4.0 / math.sqrt(2.0 * count)
    assert abs(np.corrcoef(left[:, 0], left[:, 1])[0, 1]) < 4.0 / math.sqrt(count)


def test_noise_is_that_of_the_seed_and_the_number_of_the_pose() -> None:
    run = simulate("noise", seed=7, max_duration_s=2.0)
    stream = np.random.Generator(np.random.PCG64(np.random.SeedSequence(7, spawn_key=(0,))))
    noise = stream.standard_normal((256, 3))[: len(run.poses)]
    assert np.array_equal(list_sensed(run), as_float32(list_poses(run) + 0.01 * noise))


def test_poses_in_double_precision_are_sensed_in_double_precision() -> None:
    run = simulate("bias", loop__pose_precision="float64", max_duration_s=2.0)
    expected = list_poses(run) + np.array([0.05, 0.05, 0.02])
    assert np.array_equal(list_sensed(run), expected)
    assert not np.array_equal(expected, as_float32(expected))


def test_law_reads_what_is_sensed() -> None:
    run = simulate("noise", "bias", max_duration_s=2.0)
    read = run.samples.pose_sequence
    assert run.samples.error_xy_m is not None
    assert np.array_equal(run.samples.error_xy_m, [2.0, 10.0] - list_sensed(run)[read, :2])


def test_biased_heading_is_wrapped() -> None:
    run = simulate("bias", start__heading_rad=math.pi - 0.01, max_duration_s=0.2)
    assert list_poses(run)[0, 2] > 3.13
    assert list_sensed(run)[0, 2] == pytest.approx(0.01 - math.pi, abs=1e-6)


def test_heading_that_nothing_changes_stays_as_turtlesim_has_it() -> None:
    # turtlesim's pi has eight decimals: as a 32-bit float it lies beyond pi.
    start: dict[str, Any] = {"start__heading_rad": -3.14159264, "start__precision": "float64"}
    run = simulate(**start, sensing__bias_position_m=0.1, max_duration_s=0.2)
    assert list_poses(run)[0, 2] < -math.pi
    assert list_sensed(run)[0, 2] == list_poses(run)[0, 2]


def test_quantum_rounds_to_the_nearest_multiple() -> None:
    run = simulate("quantum", sensing__quantum_position_m=0.25, max_duration_s=5.0)
    poses, sensed = list_poses(run), list_sensed(run)
    assert np.array_equal(sensed[:, :2], 0.25 * np.round(poses[:, :2] / 0.25))
    assert np.abs(sensed[:, 2] - poses[:, 2]).max() <= 0.00025 + 1e-6


def test_outliers_have_their_share_and_their_size() -> None:
    run = simulate("outlier", max_duration_s=20.0)
    left = list_sensed(run) - list_poses(run)
    is_outlier = np.abs(left).max(axis=1) > 0.0
    share, count = is_outlier.mean(), len(left)
    assert abs(share - 0.05) < 4.0 * math.sqrt(0.05 * 0.95 / count)
    assert np.hypot(*left[is_outlier, :2].T) == pytest.approx(0.5, abs=1e-5)
    assert np.abs(np.abs(left[is_outlier, 2]) - 0.3).max() < 1e-5
    assert {*np.sign(left[is_outlier, 2])} == {-1.0, 1.0}
    assert {*np.sign(left[is_outlier, 0])} == {-1.0, 1.0}


def test_poses_that_drop_out_are_not_answered_and_have_no_sensed_pose() -> None:
    run = simulate("dropout", max_duration_s=20.0)
    lost = np.isnan(list_sensed(run)[:, 0])
    assert abs(lost.mean() - 0.2) < 4.0 * math.sqrt(0.2 * 0.8 / len(lost))
    assert np.array_equal(np.flatnonzero(~lost), run.samples.pose_sequence)
    assert np.array_equal(list_sensed(run)[~lost], list_poses(run)[~lost])


def test_each_stretch_of_lost_poses_is_one_event() -> None:
    run = simulate("dropout", max_duration_s=5.0)
    lost = np.isnan(list_sensed(run)[:, 0]).astype(int)
    begins = np.flatnonzero(np.diff(lost, prepend=0) == 1)
    events = [event for event in run.events if event.kind == "poses_lost"]
    assert len(events) == len(begins) > 10
    counts = [int(event.text.split()[2]) for event in events]
    assert sum(counts) == lost.sum()
    assert {"Sensing lost 1 pose at", "Sensing lost 2 poses from"} <= {
        " ".join(event.text.split()[:5]) for event in events
    }
    first_s = run.poses.time_ns[begins[0]] / 1e9
    assert f" {first_s:.3f} s" in events[0].text


def test_run_whose_poses_all_drop_out_names_the_key() -> None:
    with pytest.raises(SimulationError, match=r"sensing\.dropout_probability = 1"):
        simulate(sensing__dropout_probability=1.0, max_duration_s=1.0)


@pytest.mark.parametrize(
    ("delay_s", "expected_ns"), [(0.0, 0), (0.016, 16_000_000), (0.0205, 20_500_000)]
)
def test_delayed_poses_are_answered_when_they_arrive(delay_s: float, expected_ns: int) -> None:
    run = simulate(sensing__delay_s=delay_s, max_duration_s=1.0)
    late_ns = run.samples.time_ns - run.poses.time_ns[run.samples.pose_sequence]
    assert set(late_ns.tolist()) == {expected_ns}
    assert np.array_equal(run.commands.time_ns, run.samples.time_ns)
    assert run.poses.sensed_xy_m is None


@pytest.mark.parametrize(("delay_s", "ticks"), [(0.0319, 1), (0.032, 2), (0.0321, 2), (0.048, 3)])
def test_delay_of_a_pose_is_dead_time_in_whole_ticks(delay_s: float, ticks: int) -> None:
    run = simulate(sensing__delay_s=delay_s, max_duration_s=1.0)
    assert run.poses.turn_rate_rad_s is not None
    first = int(np.flatnonzero(run.poses.turn_rate_rad_s)[0])
    read = int(np.flatnonzero(run.samples.turn_rate_rad_s)[0])
    assert first == read + ticks + 1


def test_jittered_poses_arrive_within_the_jitter_and_never_overtake() -> None:
    run = simulate(sensing__jitter_s=0.05, max_duration_s=10.0)
    late_ns = run.samples.time_ns - run.poses.time_ns[run.samples.pose_sequence]
    assert late_ns.min() >= 0
    assert late_ns.max() <= 50_000_000
    assert np.array_equal(run.samples.pose_sequence, np.arange(len(run.samples)))
    stream = np.random.Generator(np.random.PCG64(np.random.SeedSequence(0, spawn_key=(3,))))
    own_ns = np.round(0.05e9 * stream.random((768, 1))[: len(late_ns), 0])
    arrivals_ns = run.poses.time_ns[: len(late_ns)] + own_ns
    assert np.array_equal(run.samples.time_ns, np.maximum.accumulate(arrivals_ns))


def test_a_step_that_no_double_can_count_rounds_nothing() -> None:
    run = simulate("quantum", sensing__quantum_position_m=1e-320, max_duration_s=0.5)
    assert np.array_equal(list_sensed(run)[:, :2], list_poses(run)[:, :2])
    assert round_to_step(0.25, 0.1) == 0.2
    assert round_to_step(-5.0, 5e-324) == -5.0
