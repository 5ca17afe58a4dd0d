"""Figures of sweeps: what stands in the cells, which lines lie over them, what the legend says."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from tests.draw.words import list_clipped
from tests.sweep.swept_tables import Compute, write_table
from tests.sweep.test_gain_borders import GRID, is_stable, view_table
from turtlelog.draw.figures.map_figure import (
    build_scale,
    draw_map_panel,
    find_edges,
    group_reasons,
    is_logarithmic,
)
from turtlelog.draw.figures.page import Page, use_looks
from turtlelog.draw.figures.sweep_figures import MapKind, draw_curves, lay_out, write_map_figure
from turtlelog.errors import ShowError
from turtlelog.sweep import (
    Sampling,
    SweptView,
    build_plan,
    choose_view,
    find_loop_limits,
    read_swept_results,
)

KP = "law.kp_linear"


def draw(view: SweptView) -> tuple[Axes, dict[str, object]]:
    axes = Figure().subplots()
    metrics = view.results.metrics
    limits = find_loop_limits(view)
    return axes, draw_map_panel(axes, view, metrics[0], limits, group_reasons(metrics))


def view_metric(path: Path, name: str, compute: Compute) -> SweptView:
    return view_table(write_table(path / "t.parquet", GRID, {name: compute}))


def test_theorys_line_stands_at_each_columns_limit(tmp_path: Path) -> None:
    axes, named = draw(view_metric(tmp_path, "translate.stable", is_stable))
    assert [*named] == [
        "stable",
        "not stable",
        "instability (theory)",
        "overshoot begins (theory)",
    ]
    (line,) = [one for one in axes.lines if one.get_color() == "#b3261e"]
    x, y = (np.asarray(part, dtype=float) for part in line.get_data())
    # Columns of 0, 3, 6, 9 and 12 ticks begin and end halfway between.
    assert x.tolist() == [-1.5, 1.5, 1.5, 4.5, 4.5, 7.5, 7.5, 10.5, 10.5, 13.5]
    assert y[4] == y[5] == pytest.approx(15.07, abs=0.01)


def test_a_line_that_lies_outside_is_not_named(tmp_path: Path) -> None:
    plan = ["loop.transport_delay_ticks=0:2", f"{KP}=1:2:0.5"]
    path = write_table(tmp_path / "t.parquet", plan, {"translate.stable": lambda *_: 1.0})
    axes, named = draw(view_table(path))
    assert [*named] == ["stable"]
    assert axes.lines[:] == []


def test_cells_without_a_value_are_hatched_by_their_reason(tmp_path: Path) -> None:
    def compute(delay: int, kp: float) -> float | str:
        return "too_short" if kp > 20 else "no_phase" if delay == 12 else kp

    axes, named = draw(view_metric(tmp_path, "translate.overshoot", compute))
    reasons = [name for name in named if name.startswith("no value")]
    assert reasons == ["no value: too short", "no value: no phase"]
    shapes = [len(one.get_paths()) for one in axes.collections[:2]]
    # Of each column two cells above 20 are one shape; below them 10 of the last column.
    assert shapes == [5, 1]


@pytest.mark.parametrize(("most", "is_log"), [(99.0, False), (101.0, True)])
def test_colours_are_logarithmic_from_two_decades(*, most: float, is_log: bool) -> None:
    assert isinstance(build_scale(np.linspace(1.0, most, 50)).norm, LogNorm) is is_log


def test_colours_are_linear_where_values_are_not_positive() -> None:
    assert not isinstance(build_scale(np.linspace(0.0, 1e6, 50)).norm, LogNorm)


@pytest.mark.parametrize(("most", "extend"), [(0.95 + 8.9, "neither"), (0.95 + 9.1, "max")])
def test_few_values_far_beyond_share_the_last_colour(most: float, extend: str) -> None:
    """The central nine tenths span 0.9."""
    values = np.r_[np.linspace(-0.01, 1.0, 1000), most]
    assert build_scale(values).extend == extend


@pytest.mark.parametrize("values", [[], [np.nan], [0.0], [-3.0, -3.0], [1e150, -1e150]])
def test_any_values_have_a_scale(values: list[float]) -> None:
    scale = build_scale(np.array(values))
    assert scale.norm.vmin is not None
    assert scale.norm.vmax is not None
    assert scale.norm.vmin < scale.norm.vmax


@pytest.mark.parametrize(
    ("values", "is_log"), [("1,2,4,8", True), ("1:4", False), ("1,10,100", True), ("-1,2,4", False)]
)
def test_an_axis_is_logarithmic_where_its_ratios_are_alike(
    *, values: str, is_log: bool, tmp_path: Path
) -> None:
    plan = [f"goal.x_m={values}"]
    path = write_table(tmp_path / "t.parquet", plan, {"run.duration": lambda *_: 1.0})
    (axis,) = read_swept_results(path).axes
    assert is_logarithmic(axis) is is_log
    edges = find_edges(axis)
    assert (np.diff(edges) > 0.0).all()
    assert ((edges[:-1] < axis.numbers) & (axis.numbers < edges[1:])).all()


def test_curves_have_a_line_for_each_value_and_its_limits(tmp_path: Path) -> None:
    view = view_metric(tmp_path, "translate.overshoot", lambda delay, kp: kp + delay)
    axes = Figure().subplots()
    named = draw_curves(axes, view, view.results.metrics[0], find_loop_limits(view))
    assert [name for name in named if name.startswith("loop.")] == [
        f"loop.transport_delay_ticks = {delay}" for delay in (0, 3, 6, 9, 12)
    ]
    upright = [line for line in axes.lines if len(set(np.asarray(line.get_xdata()))) == 1]
    found = sorted(float(np.asarray(line.get_xdata())[0]) for line in upright)
    # Of 0 ticks both limits lie beyond the largest gain.
    assert any(one == pytest.approx(15.07, abs=0.01) for one in found)
    assert all(2.0 <= one <= 24.0 for one in found)


def draw_series(path: Path, count: int, compute: Compute) -> tuple[Axes, list[str]]:
    """Draw curves over one gain for some values of the other."""
    plan = [f"{KP}=1:4", f"law.kp_angular=1:{count}"]
    view = view_table(write_table(path / "t.parquet", plan, {"run.duration": compute}))
    axes = Figure().subplots()
    return axes, [*draw_curves(axes, view, view.results.metrics[0], [])]


@pytest.mark.parametrize(
    ("count", "left_out"),
    [(12, ""), (13, "left out: 7"), (40, "left out: 28 of 40 values, in between")],
)
def test_values_of_a_second_key_have_a_ramp_and_those_without_a_line_are_said(
    tmp_path: Path, count: int, left_out: str
) -> None:
    axes, named = draw_series(tmp_path, count, lambda kp, angular: angular * kp)
    greys = [0.3 * r + 0.6 * g + 0.1 * b for r, g, b in (line.get_color() for line in axes.lines)]
    assert greys == sorted(greys)
    assert len({*greys}) == 12
    assert named[12:] == ([left_out] if left_out else [])


@pytest.mark.parametrize(
    ("apart", "said"), [(0.0, "12 curves coincide in 1 line"), (1.0, "")], ids=["one", "apart"]
)
def test_curves_that_coincide_are_counted(tmp_path: Path, apart: float, said: str) -> None:
    axes, _ = draw_series(tmp_path, 12, lambda kp, angular: kp + apart * angular)
    assert axes.get_title(loc="right") == said


def test_a_gain_has_the_unit_that_its_law_declares(tmp_path: Path) -> None:
    axes, _ = draw(view_metric(tmp_path, "translate.overshoot", lambda delay, kp: kp + delay))
    assert axes.get_ylabel() == f"{KP} [1/s]"


@pytest.mark.everyday("page0-map", "page1-curves", "page2-tornado")
@pytest.mark.parametrize("kind", ["map", "curves", "tornado"])
@pytest.mark.parametrize("page", [Page(), Page(kind="page"), Page(text_width_mm=120.0)])
def test_all_words_lie_within_the_page(tmp_path: Path, kind: MapKind, page: Page) -> None:
    path = write_table(tmp_path / "t.parquet", GRID, {"translate.overshoot": lambda d, kp: d * kp})
    view = view_table(path)
    with use_looks():
        figure = lay_out(view, find_loop_limits(view), kind, page)
        figure.draw_without_rendering()
        assert list_clipped(figure) == []


def test_curves_of_a_sample_have_a_dot_for_each_row(tmp_path: Path) -> None:
    """Rows that were drawn share no value of another key: no line, and nothing is missing."""
    plan = build_plan([f"{KP}=1.0:3.0", "law.kp_angular=1.0:3.0"], (), Sampling(count=9))
    metric = {"run.duration": lambda kp, _: kp if kp < 2.5 else "not_reached"}
    view = view_table(write_table(tmp_path / "t.parquet", plan, metric))
    axes, (found,) = Figure().subplots(), view.results.metrics
    named = draw_curves(axes, view, found, find_loop_limits(view))
    dots, crosses = axes.lines
    drawn = [len(np.asarray(line.get_xdata())) for line in (dots, crosses)]
    assert drawn == [np.isfinite(found.values).sum(), np.isnan(found.values).sum()]
    assert list(named) == ["no value"]


def test_curves_mark_no_value_only_where_there_is_a_row(tmp_path: Path) -> None:
    view = view_metric(tmp_path, "translate.overshoot", lambda delay, kp: kp + delay)
    few = replace(view, rows=view.rows[:-3])
    named = draw_curves(Figure().subplots(), few, few.results.metrics[0], [])
    assert "no value" not in named


@pytest.mark.parametrize(("count", "fits"), [(4, True), (5, False)])
def test_a_slide_is_refused_more_maps_than_fit(tmp_path: Path, *, count: int, fits: bool) -> None:
    names = ["overshoot", "duration", "rise_time", "settling_time", "iae"][:count]
    metrics = {f"translate.{name}": lambda delay, kp: kp + delay for name in names}
    path = write_table(tmp_path / "t.parquet", GRID, metrics)
    view = choose_view(read_swept_results(path, ["*"]))
    if fits:
        write_map_figure(view, [], tmp_path / "m.svg", page=Page(kind="slide"))
        return
    with pytest.raises(ShowError, match="expected at most 4 on a slide, found 5"):
        write_map_figure(view, [], tmp_path / "m.svg", page=Page(kind="slide"))


@pytest.mark.parametrize(("count", "has_edges"), [(1_000, True), (1_001, False)])
def test_dots_of_many_rows_have_no_edges(tmp_path: Path, *, count: int, has_edges: bool) -> None:
    plan = build_plan([f"{KP}=1.0:3.0", "law.kp_angular=1.0:3.0"], (), Sampling(count=count))
    view = view_table(write_table(tmp_path / "t.parquet", plan, {"run.duration": lambda kp, _: kp}))
    axes, _ = draw(view)
    (dots,) = axes.collections
    assert (np.asarray(dots.get_linewidth()).item() > 0.0) is has_edges


@pytest.mark.parametrize(("count", "size"), [(500, 2.6), (501, 1.2)])
def test_dots_of_curves_are_small_where_there_are_many(
    tmp_path: Path, count: int, size: float
) -> None:
    plan = build_plan([f"{KP}=1.0:3.0", "law.kp_angular=1.0:3.0"], (), Sampling(count=count))
    view = view_table(write_table(tmp_path / "t.parquet", plan, {"run.duration": lambda kp, _: kp}))
    axes = Figure().subplots()
    draw_curves(axes, view, view.results.metrics[0], [])
    (dots,) = axes.lines
    assert dots.get_markersize() == size


@pytest.mark.parametrize(("share", "told"), [(0.009, [" 0 to 0.009"]), (0.011, []), (0.0, [" 0"])])
def test_a_bar_too_thin_to_see_has_its_ends_in_words(
    tmp_path: Path, share: float, told: list[str]
) -> None:
    view = view_metric(
        tmp_path, "translate.overshoot", lambda delay, kp: (delay > 0) + share * (kp > 10)
    )
    figure = lay_out(view, find_loop_limits(view), "tornado", Page())
    assert [text.get_text() for text in figure.axes[0].texts] == told


def test_a_limit_for_the_least_dead_time_says_so_and_the_only_loop_has_no_name(
    tmp_path: Path,
) -> None:
    def name_limits(preset: str, **changes: float) -> set[str]:
        metrics = {"translate.overshoot": lambda kp: kp, "final.position_error": lambda kp: kp}
        plan = [f"{KP}=1:9"]
        path = write_table(tmp_path / "t", plan, metrics, preset=preset, changes=changes)
        view = choose_view(read_swept_results(path, ["*"]))
        (legend,) = lay_out(view, find_loop_limits(view), "curves", Page(kind="page")).legends
        return {text.get_text() for text in legend.get_texts() if "begins" in text.get_text()}

    assert name_limits("paper-kp4") == {"overshoot begins (theory, least dead time)"}
    assert name_limits("textbook", **{"loop.transport_delay_ticks": 6}) == {
        "overshoot begins (theory)"
    }


@pytest.mark.parametrize(("value", "is_one"), [(0.0085214, True), (0.00853, False), (-1.0, True)])
def test_a_metric_that_prints_as_one_value_is_a_level_line(
    tmp_path: Path, *, value: float, is_one: bool
) -> None:
    least = 0.00852 if value > 0.0 else value - 1e-6
    metric = {"final.position_error": lambda kp: value if kp > 4 else least}
    view = view_table(write_table(tmp_path / "t.parquet", [f"{KP}=1:9"], metric))
    axes = Figure().subplots()
    draw_curves(axes, view, view.results.metrics[0], [])
    low, high = axes.get_ylim()
    assert low < min(least, value) < max(least, value) < high
    assert bool(abs(value - least) < 0.01 * (high - low)) is is_one
