"""The settling times of the paper's runs, explained from the ideal loop up."""

from pathlib import Path

import pytest

import turtlelog as tl
from tests.known import known

RECORDINGS = Path(__file__).parents[2] / "recordings" / "paper"


@pytest.mark.parametrize("kp", [1, 2, 4, 10])
def test_clipping_explains_the_measured_settling_times_to_a_third_of_a_second(kp: int) -> None:
    run = tl.read_recording(RECORDINGS / f"kp{kp}.mcap")
    metrics = tl.measure_run(run)
    steps = {
        "translate": known(run.samples.distance_m)[0],
        "rotate": known(run.samples.bearing_rad)[0],
    }
    for phase, step in steps.items():
        clipped_s = tl.theory.compute_saturated_settling_time(kp, step=float(step), limit=1.0)
        assert metrics[f"{phase}.settling_time"].value == pytest.approx(clipped_s, abs=0.3)


@pytest.mark.parametrize("kp", [1, 2, 4, 10])
def test_no_gain_translates_faster_than_the_limit_allows(kp: int) -> None:
    run = tl.read_recording(RECORDINGS / f"kp{kp}.mcap")
    settling_time_s = tl.measure_run(run)["translate.settling_time"].value
    assert settling_time_s is not None
    assert (
        settling_time_s
        > 0.98 * known(run.samples.distance_m)[0]
        > tl.theory.compute_settling_time(kp)
    )
