"""Commands to the side, and what is said of the motion there."""

from dataclasses import replace

import numpy as np
import pytest

import turtlelog as tl
from tests.measure.driven_robots import AT_20_HZ, drive
from turtlelog.measure import describe_sideways
from turtlelog.measure.pose_quality import describe_poses


def strafe(command_m_s: float, aside_m_s: float) -> tl.Run:
    """Return a robot that drives ahead and back, and to its left."""
    run = drive()
    lateral = np.full(len(run.commands), command_m_s)
    xy_m = run.poses.xy_m + np.outer(aside_m_s * AT_20_HZ, [0.0, 1.0])
    return replace(
        run,
        commands=replace(run.commands, lateral_speed_m_s=lateral),
        poses=replace(run.poses, xy_m=xy_m),
    )


@pytest.mark.parametrize(
    ("command_m_s", "aside_m_s", "told"),
    [
        (
            0.3,
            0.3,
            "commanded sideways, up to 0.3 m/s; it moves 5.99 m sideways, 2.97 m",
        ),
        (
            0.3,
            0.0,
            "commanded sideways, up to 0.3 m/s; it moves 0 m sideways, 2.97 m",
        ),
        (-0.011, 0.0, "commanded sideways, up to 0.011 m/s"),
        (0.009, 0.3, ""),
    ],
)
def test_commands_to_the_side_are_told(command_m_s: float, aside_m_s: float, told: str) -> None:
    run = strafe(command_m_s, aside_m_s)
    found = describe_sideways(run)
    assert found.startswith(told)
    assert bool(found) is bool(told)
    metrics = tl.measure_run(run, only=["run.path_length"])
    assert describe_poses(run, metrics).get("sideways", "") == found
    notes = tl.identify_robot(run).notes
    assert any("Only the motion ahead or back is identified." in one for one in notes) is bool(told)
