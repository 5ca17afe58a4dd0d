"""The figure of a violation: short ones are seen, and a metric is asked for at its moment alone."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import turtlelog as tl
from turtlelog.charts.curve_marks import ViolatedSignal, ViolationMoment
from turtlelog.charts.curves import Curve
from turtlelog.check.spec import build_spec
from turtlelog.check.violation import find_judged_signal
from turtlelog.draw.figures.time_panels import draw_violation

RUN = tl.read_run(Path(__file__).parents[3] / "recordings" / "paper" / "kp10.mcap")
SPEED = np.sort(RUN.samples.speed_m_s)
END_S = (RUN.end_ns - RUN.start_ns) / 1e9


def draw(formula: str) -> Axes:
    (result,) = tl.check_runs(build_spec([formula]), [(RUN.name, RUN)])
    figure = Figure(figsize=(7.0, 4.0), layout="constrained")
    draw_violation(figure, [RUN], violated=find_judged_signal(RUN, result).signal)
    return figure.axes[0]


def list_stripes(axes: Axes) -> list[float]:
    """Return the times of lines over the whole height that are red."""
    lines = [line for line in axes.get_lines() if line.get_alpha() == 0.3]
    return [float(np.asarray(line.get_xdata())[0]) for line in lines]


def test_a_violation_of_one_row_has_a_stripe_and_tells_how_long_it_lasts() -> None:
    axes = draw(f"always(speed >= {(SPEED[0] + SPEED[1]) / 2.0:.6f})")
    row = int(RUN.samples.speed_m_s.argmin())
    times_s = (RUN.samples.time_ns[row : row + 2] - RUN.start_ns) / 1e9
    assert list_stripes(axes) == pytest.approx([times_s.mean()])
    assert "outside: one row, 0.016 s" in axes.get_legend_handles_labels()[1]


@pytest.mark.parametrize(("rows", "stripes"), [(9, 1), (11, 0)])
def test_what_lasts_for_a_hundredth_of_the_axis_has_no_stripe(rows: int, stripes: int) -> None:
    outside = (np.arange(1001) >= 500) & (np.arange(1001) < 500 + rows)
    curve = Curve(
        start_ns=0, time_ns=np.arange(1001) * 10_000_000, values=outside.astype(np.float64)
    )
    moment = ViolationMoment(time_s=5.0, value=1.0)
    violated = ViolatedSignal(
        name="speed",
        unit="m/s",
        curve=curve,
        low=None,
        high=np.full(1001, 0.5),
        outside=outside,
        first=moment,
        worst=moment,
    )
    figure = Figure(figsize=(7.0, 4.0), layout="constrained")
    draw_violation(figure, [RUN], violated=violated)
    assert len(list_stripes(figure.axes[0])) == stripes


def test_a_metric_has_its_limit_and_no_band_over_time() -> None:
    axes = draw("final.position_error <= 0.05")
    assert "asked for" not in axes.get_legend_handles_labels()[1]
    assert not axes.collections
    assert list_stripes(axes) == pytest.approx([END_S], abs=0.02)
    assert any("final.position_error 0.10673 m" in text.get_text() for text in axes.texts)


def test_a_metric_that_holds_over_time_keeps_its_band() -> None:
    axes = draw("final.position_error <= 0.5")
    assert not list_stripes(axes)
    assert "asked for" in draw("run.cross_track_max <= 0.05").get_legend_handles_labels()[1]
