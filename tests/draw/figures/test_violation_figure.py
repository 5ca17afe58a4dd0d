"""The figure of a violation: short ones are seen, and a metric is asked for at its moment alone."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import turtlelog as tl
from tests.draw.figures.paper_runs import RUNS, list_texts, make_figure, read
from turtlelog.charts.curve_marks import ViolatedSignal, ViolationMoment
from turtlelog.charts.curves import Curve
from turtlelog.check import Verdict
from turtlelog.check.spec import build_spec
from turtlelog.check.violation import find_judged_signal
from turtlelog.draw.figures.time_panels import draw_violation
from turtlelog.errors import ShowError

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


def judge(run: tl.Run, formula: str) -> tuple[Figure, Verdict]:
    spec = tl.parse_spec({"checks": {"asked": {"holds": formula}}})
    (result,) = tl.check_runs(spec, [("run", run)])
    signal = find_judged_signal(run, result).signal
    assert signal is not None
    figure = make_figure()
    draw_violation(figure, [run], violated=signal)
    return figure, result.verdict


def test_what_is_outside_is_red_and_first_and_worst_are_named() -> None:
    figure, verdict = judge(read(10), "always(abs(cross_track) <= 0.05)")
    (axes,) = figure.axes
    assert verdict is Verdict.FAIL
    (red,) = [line for line in axes.get_lines() if str(line.get_label()).startswith("outside")]
    values = np.asarray(red.get_ydata())
    assert (np.abs(values[np.isfinite(values)]) > 0.05).all()
    assert np.isfinite(values).sum() > 400
    assert list_texts(axes) == [
        "limit -0.05 m",
        "limit 0.05 m",
        "worst -0.10774 m\nat 8.784 s\n0.0577 m outside",
        "first -0.05008 m\nat 5.664 s",
    ]
    assert axes.get_title() == "always(abs(cross_track) <= 0.05): violated"


def test_a_check_that_holds_shows_how_near_the_limit_it_comes() -> None:
    figure, verdict = judge(read(10), "always(abs(cross_track) <= 0.11)")
    (axes,) = figure.axes
    assert verdict is Verdict.PASS
    assert axes.get_title().endswith(": holds")
    assert list_texts(axes)[2:] == ["nearest to the limit: -0.10774 m\nat 8.784 s"]
    assert not [line for line in axes.get_lines() if str(line.get_label()).startswith("outside")]


def test_a_band_that_is_small_beside_its_signal_is_shown_close_up() -> None:
    low, high = judge(read(10), "always(distance >= 0.2)")[0].axes[0].get_ylim()
    assert high - low < 1.0
    low, high = judge(read(10), "always(distance >= 3)")[0].axes[0].get_ylim()
    assert high - low > 5.0


def test_nothing_is_violated_without_a_formula() -> None:
    with pytest.raises(ShowError, match="violation needs a formula to check"):
        tl.draw.draw_figure("violation", [read(4)])
    with pytest.raises(ShowError, match="violation: expected one recording, found 4"):
        tl.draw.draw_figure("violation", RUNS)


def test_violated_words_stay_on_the_narrowest_page() -> None:
    figure = make_figure(120.0 / 25.4)
    spec = tl.parse_spec({"checks": {"asked": {"holds": "always(abs(cross_track) <= 0.05)"}}})
    (result,) = tl.check_runs(spec, [("run", read(10))])
    draw_violation(figure, [read(10)], violated=find_judged_signal(read(10), result).signal)
    figure.draw_without_rendering()
    left, _, right, _ = figure.get_tightbbox().extents
    assert left > -0.01
    assert right < figure.get_figwidth() + 0.01
