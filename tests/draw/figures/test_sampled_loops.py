"""Figures of sampled loops: what is drawn is what theory says of them."""

import dataclasses
import functools
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes

import turtlelog as tl
from turtlelog.draw.figures.figure_curves import choose_lines
from turtlelog.draw.figures.figure_kinds import list_usual_figures
from turtlelog.errors import ShowError
from turtlelog.theory import PidGains, Process, analyse_pid_loop, compute_pid_poles

EXTRA = ("bode", "nyquist", "step")
KP10 = tl.simulate_run(tl.load_scenario("paper-kp10"))
KP2 = tl.simulate_run(tl.load_scenario("paper-kp2"))
LOOPS = {
    "rotate": analyse_pid_loop(PidGains(kp=10.0), period_s=0.016, dead_time_ticks=4),
    "translate": analyse_pid_loop(PidGains(kp=10.0), period_s=0.016, dead_time_ticks=6),
}


@functools.cache
def draw(name: str, *runs: tl.Run) -> Any:
    """Draw a figure once for all tests that look at it."""
    return tl.draw.draw_figure(name, runs)


def find_line(axes: Axes, begins: str) -> np.ndarray[Any, Any]:
    (line,) = [one for one in axes.get_lines() if str(one.get_label()).startswith(begins)]
    return np.array(line.get_data())


def list_marks(axes: Axes, marker: str) -> list[tuple[float, ...]]:
    """Return where an axes has single marks of a kind."""
    lines = [one for one in axes.get_lines() if one.get_marker() == marker]
    data = [np.asarray(one.get_data(), dtype=np.float64).ravel() for one in lines]
    return [tuple(place.tolist()) for place in data if len(place) == 2]


def list_legend(figure: Any) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]


def simulate(**changes: Any) -> tl.Run:
    values = {key.replace("__", "."): value for key, value in changes.items()}
    return tl.simulate_run(tl.override_scenario(tl.load_scenario("textbook"), values))


def test_the_legend_tells_margins_that_are_those_of_theory() -> None:
    for name in ("bode", "nyquist"):
        names = list_legend(draw(name, KP10))
        assert {"rotate: GM 6.7 dB, PM 48.7°", "translate: GM 3.6 dB, PM 30.3°"} <= {*names}
    for loop, (gain_db, phase_deg) in {"rotate": (6.7, 48.7), "translate": (3.6, 30.3)}.items():
        margins = LOOPS[loop].margins
        assert margins is not None
        assert margins.gain_margin is not None
        assert margins.phase_margin_rad is not None
        assert 20.0 * math.log10(margins.gain_margin) == pytest.approx(gain_db, abs=0.05)
        assert math.degrees(margins.phase_margin_rad) == pytest.approx(phase_deg, abs=0.05)


def test_bode_ends_at_the_highest_frequency_and_marks_the_crossover() -> None:
    size, phase = draw("bode", KP10).axes
    frequencies, gain_db = find_line(size, "rotate")
    assert frequencies[-1] == pytest.approx(math.pi / 0.016)
    # |L| = Kp T / (2 sin(w T / 2)), and the phase is -90 deg - 4.5 w T.
    expected = 20.0 * np.log10(10.0 * 0.016 / (2.0 * np.sin(0.008 * frequencies)))
    np.testing.assert_allclose(gain_db, expected, atol=1e-6)
    _, turned = find_line(phase, "_child1")
    np.testing.assert_allclose(turned, -90.0 - np.degrees(4.5 * 0.016 * frequencies), atol=1e-6)
    margins = LOOPS["rotate"].margins
    assert margins is not None
    assert pytest.approx((margins.crossover_rad_s, 0.0)) in list_marks(size, "o")


def test_nyquist_marks_where_the_loops_cross_circle_and_axis() -> None:
    (axes,) = draw("nyquist", KP10).axes
    found = LOOPS["translate"].margins
    assert found is not None
    assert found.gain_margin is not None
    assert pytest.approx((-1.0 / found.gain_margin, 0.0)) in list_marks(axes, "s")
    assert "-1" in [str(one.get_label()) for one in axes.get_lines()]


def test_a_root_locus_holds_the_poles_and_where_they_leave_the_unit_circle() -> None:
    _, axes, _ = draw("root-locus", KP10).axes
    drawn = find_line(axes, "Kp = 10")
    np.testing.assert_allclose(drawn[0] + 1j * drawn[1], LOOPS["rotate"].poles)
    limit = find_line(axes, "limit of Kp")
    assert np.hypot(*limit) == pytest.approx(1.0)
    ((_, most),) = LOOPS["rotate"].stable_gains
    poles = compute_pid_poles(PidGains(kp=most), period_s=0.016, dead_time_ticks=4)
    assert limit[0] == pytest.approx(poles[:2].real, abs=1e-6)
    assert axes.get_title() == "rotate\ndead time 64 ms"


def test_a_root_locus_shows_the_ideal_loop_only_where_there_is_one() -> None:
    robot = tl.simulate_run(tl.load_scenario("lagged"))
    for runs, panels in (((), ["s"]), ((robot,), ["z", "z"]), ((KP10,), ["s", "z", "z"])):
        axes = draw("root-locus", *runs).axes
        planes = ["z" if "of z" in one.get_xlabel() else "s" for one in axes]
        assert planes == panels


def test_loops_that_differ_in_kp_alone_share_a_root_locus() -> None:
    runs = [KP10, KP2]  # 4 and 6 ticks late, both
    figure = tl.draw.draw_figure("root-locus", runs)
    assert len(figure.axes) == 3  # the ideal one and two dead times
    assert [name for name in list_legend(figure) if "Kp" in name][1:3] == [
        "paper-kp2: Kp = 2",
        "paper-kp10: Kp = 10",
    ]


def test_a_step_response_is_theorys_and_an_unstable_one_is_said_to_be_so_and_cut() -> None:
    (axes,) = draw("step", KP10).axes
    _, values = find_line(axes, "translate: overshoot 54.2 %, settles in 1.34 s")
    assert values.max() == pytest.approx(1.5424, abs=5e-5)
    wild = simulate(law__kp_angular=150.0, law__kp_linear=1.0, max_duration_s=3.0)
    (axes,) = tl.draw.draw_figure("step", [wild]).axes
    _, values = find_line(axes, "rotate: unstable")
    beyond = np.abs(values - 1.0) > 2.5
    assert beyond.sum() == 1
    assert np.isnan(values[beyond.argmax() + 1 :]).all()
    assert "rotate: unstable" in list_legend(tl.draw.draw_figure("bode", [wild]))
    locus = list_legend(tl.draw.draw_figure("root-locus", [wild]))
    assert "rotate Kp = 150 (unstable), translate Kp = 1" in locus


@pytest.mark.parametrize("name", EXTRA)
def test_a_run_has_its_colour_and_a_loop_its_dashes_of_which_the_broader_lie_below(
    name: str,
) -> None:
    figure = tl.draw.draw_figure(name, [KP2, KP10])
    labelled = {str(one.get_label()): one for one in figure.axes[0].get_lines()}
    seen = {label.partition(":")[0]: one for label, one in labelled.items()}
    for run, looks in zip(("paper-kp2", "paper-kp10"), choose_lines(2), strict=True):
        upper, lower = seen[f"{run} rotate"], seen[f"{run} translate"]
        assert upper.get_color() == lower.get_color() == looks["color"]
        assert (upper.get_linestyle(), lower.get_linestyle()) == ("-", "--")
        assert lower.get_linewidth() >= 2.0 * upper.get_linewidth()
        assert lower.get_zorder() < upper.get_zorder()


def test_poles_have_the_colours_of_their_runs_in_every_plane_and_equal_ones_are_rings() -> None:
    figure = tl.draw.draw_figure("root-locus", [KP10, dataclasses.replace(KP10, name="again")])
    runs = choose_lines(2)
    for axes in figure.axes:
        lower, upper = [
            one
            for looks in runs
            for one in axes.get_lines()
            if (one.get_color(), one.get_marker()) == (looks["color"], looks["marker"])
        ]
        assert lower.get_markersize() >= 1.4 * upper.get_markersize()


def test_bode_says_which_runs_have_one_phase() -> None:
    _, phase = tl.draw.draw_figure("bode", [KP2, KP10]).axes
    (said,) = [text.get_text() for text in phase.texts]
    assert said.splitlines() == [
        "2 runs have one phase of rotate (64 ms)",
        "2 runs have one phase of translate (96 ms)",
    ]


def test_many_runs_are_named_by_a_bar_and_their_loops_by_dashes() -> None:
    runs = [dataclasses.replace(KP10, name=f"run {number}") for number in range(8)]
    figure = tl.draw.draw_figure("step", runs)
    assert list_legend(figure) == ["rotate", "translate", "2 % band"]
    assert figure.axes[-1].get_xlabel() == "8 runs, from run 0 to run 7"
    locus = tl.draw.draw_figure("root-locus", runs)
    assert list_legend(locus) == ["s = -Kp", "pole of 1/s", "unit circle", "limit of Kp"]
    assert locus.axes[-1].get_xlabel() == "8 runs, from run 0 to run 7"


@pytest.mark.parametrize(("kp", "times"), [(0.75, 5.0), (0.85, 4.7)])
def test_one_slow_loop_makes_an_axis_at_most_five_times_as_long(kp: float, times: float) -> None:
    fast = simulate(law__kp_linear=4.0, law__kp_angular=4.0)
    slow = simulate(law__kp_linear=kp, law__kp_angular=kp)
    usual_s = tl.draw.draw_figure("step", [fast]).axes[0].get_xlim()[1]
    last_s = tl.draw.draw_figure("step", [fast, fast, slow]).axes[0].get_xlim()[1]
    assert last_s / usual_s == pytest.approx(times, rel=0.05)


def test_figures_of_sampled_loops_come_only_where_they_are_asked_for(tmp_path: Path) -> None:
    assert not {*list_usual_figures()} & {*EXTRA}
    assert {*EXTRA} < {*tl.draw.FIGURES}
    written = tl.write_figures([KP10], tmp_path, only=["nyquist"], formats=["svg"])
    assert [path.name for path in written] == ["nyquist.svg"]


def test_what_theory_does_not_know_is_refused_with_the_reason() -> None:
    posture = tl.simulate_run(tl.load_scenario("posture"))
    reason = "the law declares that its command is more than gain times error, but not its terms"
    with pytest.raises(ShowError, match=f"needs a loop that theory knows \\({reason}\\)"):
        tl.draw.draw_figure("bode", [posture])
    with pytest.raises(ShowError, match="figure bode needs a recording"):
        tl.draw.draw_figure("bode", [])
    step = tl.simulate_run(tl.load_scenario("plant-step"))
    with pytest.raises(ShowError, match="needs a law that declares a loop"):
        tl.draw.draw_figure("nyquist", [step])


def test_a_law_with_an_integral_is_drawn_with_its_own_open_loop() -> None:
    run = simulate(
        law__kind="sequential-pid",
        law__kp_linear=2.0,
        law__ki_linear=1.0,
        loop__period_ticks=4,
        loop__transport_delay_ticks=3,
    )
    figure = tl.draw.draw_figure("bode", [run])
    found = analyse_pid_loop(
        PidGains(kp=2.0, ki=1.0), period_s=0.064, process=Process(dead_time_s=0.048)
    )
    assert found.margins is not None
    assert found.margins.phase_margin_rad is not None
    said = f"PM {math.degrees(found.margins.phase_margin_rad):.1f}°"
    assert any(name.startswith("translate") and said in name for name in list_legend(figure))
