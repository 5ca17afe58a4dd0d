"""Coordinates far from 0 in the plane."""

import dataclasses

import numpy as np
import pytest

import turtlelog as tl
from tests.draw.words import list_overlapping
from turtlelog.charts.plane_scene import find_origin, label_coordinate, tell_still
from turtlelog.draw.figures.page import use_looks
from turtlelog.run import SampleColumns

KP4 = tl.simulate_run(tl.load_scenario("paper-kp4"))


def move(x_m: float, y_m: float, size: float = 1.0) -> tl.Run:
    """Return a run without a goal whose poses lie elsewhere, shrunk to some size."""
    xy_m = np.array([x_m, y_m]) + (KP4.poses.xy_m - KP4.poses.xy_m[0]) * size
    poses = dataclasses.replace(KP4.poses, xy_m=xy_m)
    samples = SampleColumns.build_empty()
    return tl.Run(name="far", source="mcap", poses=poses, commands=KP4.commands, samples=samples)


FAR = move(448_262.3, 4_500_000.7)


@pytest.mark.parametrize(
    ("x_m", "origin_m"), [(9_999.9, 0.0), (10_000.2, 10_000.0), (-448_262.3, -448_262.0)]
)
def test_far_coordinates_are_counted_from_the_start(x_m: float, origin_m: float) -> None:
    assert find_origin([move(x_m, 5.0)]) == (origin_m, 0.0)


def test_the_offset_is_named_once_and_ticks_are_short_and_apart() -> None:
    with use_looks():
        figure = tl.draw.draw_figure("plane", [FAR])
        figure.draw_without_rendering()
        axes = figure.axes[0]
        assert axes.get_xlabel() == "x from 448,262 m"
        assert axes.get_ylabel() == label_coordinate("y", 4_500_001.0)
        low, high = axes.get_xlim()
        ticks = [tick for tick in axes.get_xticks() if low <= tick <= high]
        told = [axes.xaxis.get_major_formatter()(tick) for tick in ticks]
        assert [float(text) for text in told] == pytest.approx(np.array(ticks) - 448_262.0)
        assert max(map(len, told)) <= 4
        assert list_overlapping(figure) == []


def test_a_plane_shows_half_a_metre_at_least() -> None:
    """Of a robot that moved by a centimetre."""
    for size, side_m in ((0.002, 0.5), (0.2, 0.89)):
        axes = tl.draw.draw_figure("plane", [move(0.0, 0.0, size)]).axes[0]
        shown_m = float(np.ptp(axes.get_xlim())) / 1.16
        assert shown_m == pytest.approx(side_m, abs=0.01)


def test_a_robot_that_did_not_move_is_said_to_be_so() -> None:
    still = move(1.0, 2.0, 1e-4)
    assert tell_still([FAR]) == ""
    assert tell_still([FAR, still]) == "1 of 2 runs stayed at their start"
    assert tl.draw.draw_figure("plane", [still]).axes[0].get_title() == "turned on the spot"
    poses = dataclasses.replace(still.poses, heading_rad=0.0 * still.poses.heading_rad)
    assert tell_still([dataclasses.replace(still, poses=poses)]) == "did not move"
