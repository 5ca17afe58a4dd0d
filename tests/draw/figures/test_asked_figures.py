"""Figures that are drawn only where they are asked for: what they show is what was measured."""

import re
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

import turtlelog as tl
from tests.draw.rerun.rrds import make_foreign_run
from tests.identify.robots import Log, make_run
from turtlelog.charts.curves import Curve
from turtlelog.charts.plotted_curves import find_command_changes
from turtlelog.check import Verdict
from turtlelog.check.violation import find_judged_signal
from turtlelog.draw.figures.explanation_figures import (
    Explained,
    draw_attribution,
    explain_for_figure,
)
from turtlelog.draw.figures.figure_kinds import list_usual_figures
from turtlelog.draw.figures.gain_figure import draw_gains, find_loop_gains
from turtlelog.draw.figures.robot_figures import draw_rates
from turtlelog.draw.figures.strip_figure import (
    MetricValues,
    complete_name,
    draw_strips,
    group_runs,
    measure_for_figure,
    set_ticks_at,
    set_value_scale,
)
from turtlelog.draw.figures.time_panels import draw_violation
from turtlelog.errors import ShowError
from turtlelog.identify import identify_robot
from turtlelog.scenario import get_preset, override_scenario
from turtlelog.theory import compute_overshoot_gain, compute_stability_gain

PAPER = Path(__file__).parents[3] / "recordings" / "paper"


@cache
def read(kp: int) -> tl.Run:
    return tl.read_run(PAPER / f"kp{kp}.mcap")


RUNS = [read(kp) for kp in (1, 2, 4, 10)]


def list_texts(axes: Axes) -> list[str]:
    return [text.get_text() for text in axes.texts]


def list_bars(axes: Axes) -> list[Rectangle]:
    return [patch for patch in axes.patches if isinstance(patch, Rectangle)]


def list_points(axes: Axes) -> np.ndarray:
    """Return the single points that runs are."""
    found = [line for line in axes.get_lines() if line.get_marker() == "o"]
    return np.concatenate([np.asarray(line.get_xydata()) for line in found])


def find_lines(axes: Axes, label: str) -> list[float]:
    found = [line for line in axes.get_lines() if line.get_label() == label]
    return [float(np.asarray(line.get_xdata())[0]) for line in found]


def make_figure(width: float = 7.0) -> Figure:
    return Figure(figsize=(width, 4.0), layout="constrained")


@pytest.fixture(scope="module")
def explained() -> Explained:
    return explain_for_figure([read(10)])


@pytest.fixture(scope="module")
def attribution(explained: Explained) -> Figure:
    figure = make_figure()
    draw_attribution(figure, [read(10)], explained=explained)
    return figure


def test_the_waterfall_has_the_values_of_the_attribution(
    attribution: Figure, explained: Explained
) -> None:
    found = explained.found
    shares = {
        share.cause: share.contribution for share in found.contributions if share.contribution
    }
    _, bars = attribution.axes
    sizes = [bar.get_width() for bar in list_bars(bars)]
    assert found.as_logged is not None
    assert found.without_all is not None
    expected = [found.as_logged, -shares["queue"], -shares["pause"], found.without_all]
    assert sizes == pytest.approx([1e3 * value for value in expected])
    names = [text.get_text() for text in bars.get_yticklabels()]
    assert names == ["as recorded", "queue", "pause", "left"]
    texts = [text.strip() for text in list_texts(bars)]
    assert texts[0] == "106.7 mm"
    assert texts[1:3] == ["+51.1 mm (48 %)", "+50.6 mm (47 %)"]
    assert texts[3] == "5.1 mm (5 %), no more than the tolerances leave"
    averages = "bars: averages over the orders of removal;\nno run ends between them"
    assert bars.get_xlabel() == f"final position error [mm]\n{averages}"


def test_each_bar_begins_where_the_one_above_ends(attribution: Figure) -> None:
    *above, left = list_bars(attribution.axes[1])
    ends = [bar.get_x() + bar.get_width() for bar in above]
    assert [bar.get_x() for bar in above[1:]] == pytest.approx(ends[:-1])
    assert left.get_width() == pytest.approx(ends[-1])


def test_run_and_ghost_end_where_they_are_said_to(attribution: Figure) -> None:
    texts = list_texts(attribution.axes[0])
    assert texts == [
        "recorded\n106.7 mm off",
        "ghost: without\nqueue and pause\n5.1 mm off",
        "50 mm",
        "100 mm",
    ]
    recorded, ghost = list_points(attribution.axes[0])
    misses = [float(np.hypot(*(end - (2.0, 10.0)))) for end in (recorded, ghost)]
    assert misses == pytest.approx([0.10673, 0.0051], abs=5e-5)


def test_of_a_loop_s_metric_the_signal_is_seen_where_it_arrives(explained: Explained) -> None:
    figure = make_figure()
    found = replace(explained.found, metric="rotate.overshoot")
    draw_attribution(figure, [read(10)], explained=replace(explained, found=found))
    seen, _ = figure.axes
    assert [line.get_label() for line in seen.get_lines()][1:] == [
        "recorded",
        "ghost: without queue and pause",
    ]
    low, high = seen.get_ylim()
    assert 110.0 < low < 128.5 < high < 135.0


def test_in_a_narrow_column_the_panels_stand_over_each_other(explained: Explained) -> None:
    for width, is_narrow in ((4.9, True), (5.0, False)):
        figure = make_figure(width)
        draw_attribution(figure, [read(10)], explained=explained)
        figure.draw_without_rendering()
        seen, bars = (axes.get_position() for axes in figure.axes)
        assert bool(bars.y1 < seen.y0) is is_narrow


def test_what_cannot_be_explained_is_refused_with_the_reason(
    explained: Explained, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(ShowError, match="attribution: expected one recording, found 2"):
        tl.draw.draw_figure("attribution", RUNS[:2])
    with pytest.raises(ShowError, match="attribution needs the controller's samples"):
        tl.draw.draw_figure("attribution", [make_foreign_run(50)])
    withheld = replace(explained.found, withheld="nothing reproduces it")
    monkeypatch.setattr("turtlelog.explain.attribute_run", lambda *_, **__: withheld)
    match = r"needs contributions to final\.position_error: nothing reproduces it"
    with pytest.raises(ShowError, match=match):
        explain_for_figure([read(4)])


def test_points_stand_at_gain_and_metric() -> None:
    figure = tl.draw.draw_figure("gains", RUNS)
    assert len(figure.axes) == 6
    for axes, name in zip(figure.axes, ("rotate.overshoot", "translate.overshoot"), strict=False):
        values = [tl.measure_run(run, only=[name])[name].value for run in RUNS]
        assert list_points(axes)[:, 0].tolist() == [1.0, 2.0, 4.0, 10.0]
        assert list_points(axes)[:, 1] == pytest.approx(values)
    assert {"kp1", "kp2", "kp4", "kp10"} <= {*list_texts(figure.axes[0])}
    last = list_points(figure.axes[4])[:, 1]
    errors = [tl.measure_run(run)["final.position_error"].value for run in RUNS]
    assert last == pytest.approx([1e3 * (value or 0.0) for value in errors])


@pytest.mark.parametrize("scale", ["linear", "log"])
def test_of_many_gains_only_those_are_named_whose_names_do_not_touch(scale: str) -> None:
    figure = Figure(figsize=(1.2, 1.2))
    axes = figure.subplots()
    axes.set_xscale(scale)
    gains = [round(float(gain), 3) for gain in np.geomspace(0.5, 40.0, 100)]
    axes.set_xlim(0.4, 50.0)
    set_ticks_at(axes, gains)
    figure.canvas.draw()
    names = [name for name in axes.get_xticklabels() if name.get_text()]
    extents = [name.get_window_extent() for name in names]
    assert (names[0].get_text(), names[-1].get_text()) == ("0.5", "40")
    assert all(one.x1 < other.x0 for one, other in pairwise(extents))
    set_ticks_at(axes, gains[::99])
    assert axes.get_xticks().tolist() == [0.5, 40.0]


def test_limits_are_theory_s_for_the_dead_times_that_the_runs_show() -> None:
    rotate, translate = tl.draw.draw_figure("gains", RUNS).axes[:2]
    begins, ends = "overshoot begins (theory)", "instability (theory)"
    assert find_lines(rotate, begins) == pytest.approx(
        [compute_overshoot_gain(0.016, ticks) for ticks in (5, 4)]
    )
    assert find_lines(translate, begins) == pytest.approx([compute_overshoot_gain(0.016, 6)])
    assert find_lines(translate, ends) == pytest.approx([compute_stability_gain(0.016, 6)])
    assert rotate.get_title() == "rotate\ndead time 64, 80 ms"
    assert {"3.54", "15.1"} <= {*list_texts(translate)}


def test_more_dead_times_than_lines_are_a_band(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("turtlelog.draw.figures.gain_figure._MOST_LINES", 1)
    rotate = tl.draw.draw_figure("gains", RUNS).axes[0]
    assert find_lines(rotate, "overshoot begins (theory)") == []
    labels = [patch.get_label() for patch in rotate.patches]
    assert labels.count("overshoot begins (theory)") == 1
    assert rotate.get_title() == "rotate\ndead time 64 to 80 ms"


def test_a_run_without_a_value_is_a_cross() -> None:
    wild = override_scenario(
        get_preset("paper"), {"law.kp_angular": 50.0, "law.kp_linear": 50.0, "max_duration_s": 8.0}
    )
    figure = make_figure()
    draw_gains(figure, [*RUNS, tl.simulate_run(wild)], metrics=["rotate.settling_time"])
    crosses = [line for line in figure.axes[0].get_lines() if line.get_label() == "no value"]
    assert [line.get_xdata()[0] for line in crosses] == [50.0]  # type: ignore[index]


def test_metrics_stand_over_the_gain_that_differs() -> None:
    def set_gains(rotate: float, translate: float) -> tl.Run:
        gains = {"law.kp_angular": rotate, "law.kp_linear": translate}
        return replace(read(4), parameters={**read(4).parameters, **gains})

    def list_titles(*runs: tl.Run, metrics: Sequence[str] | None = None) -> set[str]:
        figure = make_figure()
        draw_gains(figure, runs, metrics=metrics)
        return {axes.get_xlabel() for axes in figure.axes} - {""}

    one = set_gains(4.0, 1.0), set_gains(4.0, 2.0)
    assert list_titles(*one) == {"Kp of translate [1/s]"}
    figure = make_figure()
    draw_gains(figure, one)
    assert figure.get_supxlabel() == "Kp of rotate is always 4 1/s"
    assert any("final position error" in axes.get_ylabel() for axes in figure.axes)
    both = {"Kp of rotate [1/s]", "Kp of translate [1/s]"}
    assert list_titles(*one, metrics=["overshoot"]) == both
    assert list_titles(*one, set_gains(4.1, 2.0)) == both
    assert list_titles(one[0]) == both


def test_without_a_gain_there_is_nothing_to_draw_it_against() -> None:
    unknown = replace(read(4), parameters={})
    assert not find_loop_gains([unknown])
    with pytest.raises(ShowError, match="figure gains needs the law's gain"):
        tl.draw.draw_figure("gains", [unknown])
    left = tl.draw.list_left_out([read(2), unknown], ["gains"])
    assert left == ("left paper-kp4 out of gains: needs the law's gain",)


def test_names_of_metrics_stand_for_those_of_any_loop() -> None:
    assert complete_name("overshoot") == "*.overshoot"
    assert complete_name("final.position_error") == "final.position_error"
    assert [one.id for one in measure_for_figure("gains", RUNS, ["overshoot"])] == [
        "rotate.overshoot",
        "translate.overshoot",
    ]
    with pytest.raises(ShowError, match=r"gains needs a value of run\.time_to_goal"):
        measure_for_figure("gains", [replace(read(4), goal_xy_m=None)], ["run.time_to_goal"])


def repeat(count: int, *changes: tuple[str, float | str]) -> list[tl.Run]:
    """Return one run under several seeds."""
    parameters = {**read(4).parameters, **dict(changes)}
    found = [replace(read(4), parameters={**parameters, "seed": seed}) for seed in range(count)]
    return [replace(run, name=f"{run.name}-{seed}") for seed, run in enumerate(found)]


def test_runs_stand_together_by_gain_whatever_their_seed() -> None:
    gains = ("law.kp_angular", 9.0), ("law.kp_linear", 9.0)
    groups = group_runs([*repeat(3), *repeat(2, *gains)])
    assert (groups.label, groups.names) == ("Kp [1/s]", ("4", "9"))
    assert groups.rows == ((0, 1, 2), (3, 4))
    other = group_runs([*repeat(1), *repeat(2, ("loop.queue_policy", "newest"))])
    assert (other.label, other.names) == ("queue_policy", ("newest", "one-per-tick"))


@pytest.mark.parametrize(("count", "has_box"), [(9, False), (10, True)])
def test_of_many_runs_a_box_stands_beside_the_points(count: int, has_box: bool) -> None:  # noqa: FBT001
    figure = make_figure()
    draw_strips(figure, repeat(count), metrics=["final.position_error"])
    (axes,) = figure.axes
    assert len(list_points(axes)) == count
    assert bool(axes.patches) is has_box
    assert axes.get_xticklabels()[0].get_text() == f"n = {count}"


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_values_that_are_nearly_equal_stand_clear_of_the_edge(sign: float) -> None:
    axes = make_figure().subplots()
    values = sign * np.array([5.77, 5.7701, 5.7702])
    found = MetricValues(id="settling_time", label="settling time [s]", values=values)
    set_value_scale(axes, found)
    low, high = axes.get_ylim()
    assert min(high - values.max(), values.min() - low) > 0.1 * (high - low)


def test_too_many_groups_are_refused() -> None:
    runs = [run for kp in range(13) for run in repeat(1, ("law.kp_linear", float(kp)))]
    assert len(group_runs(runs[:12]).names) == 12
    with pytest.raises(
        ShowError, match="strips: expected at most 12 groups, found 13 by kp_linear"
    ):
        group_runs(runs)


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


@pytest.fixture(scope="module")
def robot() -> tl.Run:
    return make_run(Log(duration_s=12.0, noise_m=0.0, noise_rad=0.0, jitter_s=0.0), 1)


def test_rates_name_what_identification_found(robot: tl.Run) -> None:
    figure, model = make_figure(), identify_robot([robot])
    draw_rates(figure, [robot])
    titles = [axes.get_title(loc="right") for axes in figure.axes]
    titles = [title for title in titles if "dead time" in title]
    told = [[float(number) for number in re.findall(r"(\d[\d.]*) ms", title)] for title in titles]
    for (dead_ms, lag_ms), axis in zip(told, model.axes, strict=True):
        assert axis.dead_time_s is not None
        assert axis.lag_s is not None
        assert dead_ms == pytest.approx(1e3 * axis.dead_time_s.value, abs=1.0)
        assert lag_ms == pytest.approx(1e3 * axis.lag_s.value, abs=1.0)


def test_a_step_that_does_not_count_is_marked_where_it_is_off(robot: tl.Run) -> None:
    xy_m = robot.poses.xy_m.copy()
    xy_m[100:] += 0.5
    jumping = replace(robot, poses=replace(robot.poses, xy_m=xy_m))
    model, figure = identify_robot([jumping]), make_figure()
    draw_rates(figure, [jumping], model=model)
    marks = [
        (axes, line)
        for axes in figure.axes
        for line in axes.get_lines()
        if line.get_label() == "left out of the fit"
    ]
    assert len(marks) == sum(axis.outliers > 0 for axis in model.axes) > 0
    axes, line = marks[0]
    assert axes.get_ylabel() == "residual\n[m/s]"
    residual = np.concatenate([np.asarray(one.get_ydata()) for one in axes.get_lines()[1:2]])
    assert np.abs(np.asarray(line.get_ydata())).max() == np.abs(residual).max() > 0.5
    time_s, largest = max(np.asarray(line.get_xydata()).tolist(), key=lambda at: abs(at[1]))
    told = f"left out: {largest:+.3g} m/s at {time_s:.2f} s"
    assert axes.texts[0].get_text().startswith(told)


def test_an_axis_that_is_not_identified_is_drawn_with_the_reason(robot: tl.Run) -> None:
    short = replace(
        robot, commands=replace(robot.commands, speed_m_s=0.3 + 0.0 * robot.commands.speed_m_s)
    )
    figure = make_figure()
    draw_rates(figure, [short])
    assert "not identified: " in figure.axes[0].get_title()


def test_the_motion_is_drawn_beside_commands_that_no_model_explains(robot: tl.Run) -> None:
    held = replace(robot.commands, speed_m_s=0.3 + 0.0 * robot.commands.speed_m_s)
    short = replace(robot, commands=held)
    figure = tl.draw.draw_figure("rates", [short])
    motions = {line.get_label(): line for line in figure.axes[0].get_lines()}
    motion = np.asarray(motions["motion, means of 0.1 s"].get_ydata())
    driven_m = np.linalg.norm(np.diff(robot.poses.xy_m, axis=0), axis=1).sum()
    assert np.abs(motion).mean() * robot.duration_s == pytest.approx(driven_m, rel=0.02)
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert {"command", "motion, means of 0.1 s"} <= {*labels}


def test_no_line_breaks_between_a_number_and_its_unit(robot: tl.Run) -> None:
    model = identify_robot([robot])
    reason = "the interval of the total delay, 0 to 1.98 s, is wider than its value of 0.69 s"
    refused = replace(model, speed=replace(model.speed, status="not_identifiable", reason=reason))
    for letters in range(3):
        figure = make_figure()
        long = replace(refused, speed=replace(refused.speed, reason=letters * "x" + reason))
        draw_rates(figure, [robot], model=long)
        title = figure.axes[0].get_title()
        assert "\n" in title
        assert not re.search(r"\d\s*\ns", title)


@pytest.mark.parametrize(
    ("times_s", "values", "expected"),
    [
        ([0, 1, 2, 6], [0.0, 1.0, 0.0, 1.0], [(1, 0, 1), (2, 1, 0), (6, 0, 1)]),
        ([0, 1.0, 1.1, 1.2, 5], [0.0, 0.3, 0.6, 0.9, 0.9], [(1.1, 0, 0.9)]),
        ([0, 1, 3, 9], [0.0, 1.0, 0.81, 0.81], [(1, 0, 1)]),
        ([0, 1, 3, 9], [0.0, 1.0, 0.79, 0.79], [(1, 0, 1), (3, 1, 0.79)]),
        ([0, 1, 2], [0.5, 0.7, 0.9], [(0, 0, 0.5), (1, 0.5, 0.7), (2, 0.7, 0.9)]),
        ([0, 1], [0.0, 0.0], []),
    ],
    ids=["steps", "ramp", "small", "large-enough", "held", "none"],
)
def test_changes_of_a_command_are_those_in_one_direction(
    times_s: list[float], values: list[float], expected: list[tuple[float, float, float]]
) -> None:
    time_ns = np.array(np.array(times_s) * 1e9, dtype=np.int64)
    command = Curve(start_ns=0, time_ns=time_ns, values=np.array(values), holds=True)
    found = [(one.half_s, one.before, one.after) for one in find_command_changes(command)]
    assert found == [pytest.approx(one) for one in expected]


def test_the_motion_after_every_change_lies_under_its_model_and_shows_the_spread() -> None:
    """The queue of paper-kp10 lets the first command through at once, the others late."""
    figure = make_figure()
    draw_rates(figure, [read(10)])
    (axes,) = [one for one in figure.axes if "speed: 4 changes" in one.get_title("right")]
    motions = [one for one in axes.get_lines() if one.get_color() == "0.6"]
    models = [one for one in axes.get_lines() if one.get_zorder() == 2.4]
    assert len(motions) == len(models) == 4
    halves_s = [
        float(np.asarray(one.get_xdata())[np.argmax(np.asarray(one.get_ydata()) >= 0.5)])
        for one in motions
    ]
    assert halves_s[0] < 0.02
    assert min(halves_s[1:]) > 0.07


def test_responses_end_at_the_gain_and_commands_where_the_next_change_begins() -> None:
    """The turn rate changes between -0.5 and 0.5 rad/s, and back 0.1 s before the robot arrives."""
    log = Log(duration_s=24.0, noise_m=0.0, noise_rad=0.0, jitter_s=0.0)
    log = replace(log, turn_rate=replace(log.turn_rate, gain=0.9))
    time_s = np.arange(0.5, 23.5, 0.1)
    values = np.where(np.floor(time_s / 3.0) % 2.0, -0.5, 0.5)
    run, figure = make_run(log, 1, turn=(time_s, values), speed=(time_s, values)), make_figure()
    draw_rates(figure, [run])
    (axes,) = [one for one in figure.axes if "turn rate: " in one.get_title("right")]
    lines = {
        color: [one.get_xydata() for one in axes.get_lines() if one.get_color() == color]
        for color in ("0.3", "0.6")
    }
    models = [one.get_xydata() for one in axes.get_lines() if one.get_zorder() == 2.4]
    ends = [float(np.asarray(line)[-1, 1]) for line in (*models[1:], *lines["0.6"][1:])]
    assert ends == pytest.approx([0.9] * len(ends), abs=5e-3)
    assert len(ends) == 2 * (len(models) - 1) > 8
    commands = np.concatenate([np.asarray(line) for line in lines["0.3"]])
    assert commands[commands[:, 0] >= 0.0, 1] == pytest.approx(1.0)


def test_rates_over_the_whole_run_are_drawn_as_the_means_that_they_are() -> None:
    """Lines between the middles of means would begin a tenth of a second before the command."""
    figure = make_figure()
    draw_rates(figure, [read(10)])
    means = [
        line
        for axes in figure.axes
        for line in axes.get_lines()
        if line.get_drawstyle() == "steps-mid"
    ]
    assert len(means) == 6
    assert {*map(str, (line.get_label() for line in means[:2]))} == {
        "motion, means of 0.1 s",
        "model, means of 0.1 s",
    }


def test_without_commands_there_are_no_rates(robot: tl.Run) -> None:
    still = {name: 0.0 * getattr(robot.commands, name) for name in ("speed_m_s", "turn_rate_rad_s")}
    silent = replace(robot, commands=replace(robot.commands, **still))
    with pytest.raises(ShowError, match="figure rates needs commands"):
        tl.draw.draw_figure("rates", [silent])


def test_they_come_only_where_they_are_asked_for() -> None:
    asked = {"attribution", "gains", "luck", "rates", "strips", "violation"}
    assert asked <= {*tl.draw.FIGURES}
    assert not asked & {*list_usual_figures()}


def test_violated_words_stay_on_the_narrowest_page() -> None:
    figure = make_figure(120.0 / 25.4)
    spec = tl.parse_spec({"checks": {"asked": {"holds": "always(abs(cross_track) <= 0.05)"}}})
    (result,) = tl.check_runs(spec, [("run", read(10))])
    draw_violation(figure, [read(10)], violated=find_judged_signal(read(10), result).signal)
    figure.draw_without_rendering()
    left, _, right, _ = figure.get_tightbbox().extents
    assert left > -0.01
    assert right < figure.get_figwidth() + 0.01


def test_gains_show_a_metric_of_the_whole_run_once() -> None:
    labels = [axes.get_ylabel() for axes in tl.draw.draw_figure("gains", RUNS).axes if axes.axison]
    assert labels.count("final position error [mm]") == 1
    assert labels.count("overshoot [%]") == 2


@pytest.fixture(scope="module")
def still() -> tl.Run:
    """A run that starts at its goal."""
    textbook = tl.scenario.get_preset("textbook")
    start = textbook.start
    return tl.simulate_run(
        replace(textbook, goal=replace(textbook.goal, x_m=start.x_m, y_m=start.y_m))
    )


def test_a_logarithmic_panel_says_that_an_error_is_always_0(still: tl.Run) -> None:
    figure = tl.draw.draw_figure("error-log", [still])
    figure.draw_without_rendering()  # warnings are errors
    assert [text.get_text() for axes in figure.axes for text in axes.texts] == ["always 0"] * 2
    assert figure.axes[1].get_xlim()[1] == pytest.approx(still.duration_s, rel=0.1)


@pytest.mark.parametrize("name", ["speed", "panel"])
def test_a_legend_lists_only_what_its_panels_show(still: tl.Run, name: str) -> None:
    figure = tl.draw.draw_figure(name, [still])
    listed = {text.get_text() for one in figure.legends for text in one.get_texts()}
    assert not [label for label in listed if "applied" in label or "limit" in label]
    moving = tl.draw.draw_figure(name, [read(10)])
    labels = ", ".join(text.get_text() for text in moving.legends[0].get_texts())
    assert "applied" in labels
    assert "limit" in labels


def test_a_value_of_0_that_no_effect_changes_has_no_attribution(still: tl.Run) -> None:
    with pytest.raises(ShowError, match=r"final\.position_error is 0 m: no effect changes it"):
        tl.draw.draw_figure("attribution", [still])
