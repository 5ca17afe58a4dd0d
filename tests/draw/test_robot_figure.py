"""The figure of how a robot follows its commands."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import turtlelog as tl
from tests.identify.robots import Log, make_run
from turtlelog.identify import trace_axis

QUIET = Log(duration_s=12.0, noise_m=0.0, noise_rad=0.0, jitter_s=0.0)


@pytest.fixture(scope="module")
def run() -> tl.Run:
    return make_run(QUIET, 1)


@pytest.fixture(scope="module")
def model(run: tl.Run) -> tl.RobotModel:
    return tl.identify_robot(run)


@pytest.mark.thorough
def test_the_same_robot_gives_the_same_bytes(
    run: tl.Run, model: tl.RobotModel, tmp_path: Path
) -> None:
    """Figures are drawn twice."""
    one, two = (tl.draw.write_robot_figure(model, run, tmp_path / f"{n}.svg") for n in "ab")
    assert one.read_bytes() == two.read_bytes()


def test_what_is_drawn_is_what_was_driven(run: tl.Run, model: tl.RobotModel) -> None:
    found = trace_axis(model.turn_rate, run)
    assert np.abs(found.residual).max() < 1e-2
    assert np.abs(found.measured - found.modelled).max() < 1e-2
    assert found.time_s[0] < 0.2
    assert found.time_s[-1] > 11.8
    late = np.corrcoef(found.commanded[:-2], found.measured[2:])[0, 1]
    assert late > np.corrcoef(found.commanded, found.measured)[0, 1] + 0.1


@pytest.mark.thorough
def test_only_known_axes_are_drawn(run: tl.Run, tmp_path: Path) -> None:
    still = replace(run.commands, speed_m_s=0.0 * run.commands.speed_m_s)
    turning = replace(run, commands=still)
    one = tl.draw.write_robot_figure(tl.identify_robot(turning), turning, tmp_path / "one.png")
    assert one.read_bytes().startswith(b"\x89PNG")
    silent = replace(turning, commands=replace(still, turn_rate_rad_s=still.speed_m_s))
    with pytest.raises(tl.errors.ShowError, match="rates needs commands that are not always 0"):
        tl.draw.write_robot_figure(tl.identify_robot(silent), silent, tmp_path / "none.png")
    with pytest.raises(tl.errors.ShowError, match=r"the name must end in \.pdf, \.png or \.svg"):
        tl.draw.write_robot_figure(tl.identify_robot(run), run, tmp_path / "robot.txt")
