from collections.abc import Callable
from itertools import combinations, pairwise, product
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_rgb

import turtlelog as tl
from tests.draw.rerun.rrds import read_static, simulate_preset
from turtlelog.charts.palette import (
    GHOST,
    GROUND,
    MAIN,
    Color,
    choose_cause_colors,
    choose_run_colors,
    choose_shades,
)
from turtlelog.draw.figures.figure_curves import choose_lines
from turtlelog.scenario import PAPER_RUNS

LEAST_CONTRAST = 3.0
"""What WCAG 2.2 asks of graphics (1.4.11)."""

LEAST_STEP = 2.3
"""In CIELAB: what the eye just tells from one patch to the next (Mahy and others, 1994)."""

LEAST_STEP_OF_FEW = 12.0

EYES = {
    "usual": np.eye(3),
    "protanopia": np.array(
        [
            [0.152286, 1.052583, -0.204868],
            [0.114503, 0.786281, 0.099216],
            [-0.003882, -0.048116, 1.051998],
        ]
    ),
    "deuteranopia": np.array(
        [
            [0.367322, 0.860646, -0.227968],
            [0.280085, 0.672501, 0.047413],
            [-0.011820, 0.042940, 0.968881],
        ]
    ),
}
"""Of linear sRGB: Machado, Oliveira and Fernandes, "A physiologically-based model for simulation of
color vision deficiency", IEEE TVCG 15 (2009), severity 1."""

LEAST_BAR_CONTRAST = 1.9
"""Of a broad bar, whose words stand beside it."""

LEAST_DIFFERENCE = 25.0
"""In CIELAB: ten times what the eye just tells from one patch to the next."""


@pytest.mark.parametrize("count", [1, 2, 7, 8, 20, 50])
def test_every_run_has_a_colour_of_its_own(count: int) -> None:
    assert len(set(choose_run_colors(count))) == count


@pytest.mark.parametrize("ground", [GROUND, (255, 255, 255)], ids=["screen", "paper"])
@pytest.mark.parametrize("count", [7, 8, 20, 200])
def test_colours_of_runs_stand_out_on_both_grounds(count: int, ground: Color) -> None:
    for color in choose_run_colors(count):
        assert measure_contrast(color, ground) >= LEAST_CONTRAST, color


def test_the_range_between_the_grounds_is_used_up() -> None:
    first, *_, last = choose_run_colors(20)
    assert measure_contrast(first, GROUND) < 1.1 * LEAST_CONTRAST
    assert measure_contrast(last, (255, 255, 255)) < 1.1 * LEAST_CONTRAST


@pytest.mark.parametrize("eye", EYES)
def test_neighbours_on_the_ramp_are_told_apart_by_any_eye(eye: str) -> None:
    steps = [
        measure_difference(see(one, eye), see(other, eye))
        for one, other in pairwise(choose_run_colors(20))
    ]
    assert min(steps) > 2.0 * LEAST_STEP


@pytest.mark.parametrize("eye", EYES)
def test_hues_of_a_few_runs_are_told_apart_by_any_eye(eye: str) -> None:
    few = [see(color, eye) for color in choose_run_colors(7)]
    assert min(measure_difference(*pair) for pair in combinations(few, 2)) > LEAST_STEP_OF_FEW


def measure_contrast(one: Color, other: Color) -> float:
    """Return the contrast ratio of two colours, as WCAG defines it."""
    bright, dark = sorted((measure_luminance(one), measure_luminance(other)), reverse=True)
    return (bright + 0.05) / (dark + 0.05)


def see(color: Color, eye: str) -> Color:
    """Return a colour as an eye of `EYES` sees it."""
    parts = np.array(color) / 255.0
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    seen = np.clip(EYES[eye] @ linear, 0.0, 1.0)
    red, green, blue = 255.0 * np.where(
        seen <= 0.0031308, 12.92 * seen, 1.055 * seen ** (1 / 2.4) - 0.055
    )
    return red, green, blue


def see_grey(color: Color) -> float:
    """Return the grey that a printer makes of a colour, 1 for white."""
    return float(1.055 * measure_luminance(color) ** (1 / 2.4) - 0.055)


def measure_luminance(color: Color) -> float:
    """Return the relative luminance of sRGB, as WCAG defines it."""
    parts = np.array(color) / 255.0
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


@pytest.mark.parametrize("choose", [choose_run_colors, choose_shades])
def test_ramps_rise_in_grey(choose: Callable[[int], tuple[Color, ...]]) -> None:
    greys = [see_grey(color) for color in choose(20)]
    assert min(after - before for before, after in pairwise(greys)) > 0.004


@pytest.mark.parametrize("count", [1, 4, 7, 30])
def test_lines_on_paper_have_the_colours_of_the_screen(count: int) -> None:
    printed = [tuple(np.rint(np.multiply(line["color"], 255))) for line in choose_lines(count)]
    assert printed == list(choose_run_colors(count))


def test_a_run_has_one_colour_on_screen_and_on_paper(tmp_path: Path) -> None:
    runs = [simulate_preset(name) for name in PAPER_RUNS]
    tl.write_comparison_rrd(runs[::-1], tmp_path / "runs.rrd")
    lines = {
        line.get_label(): line for line in tl.draw.draw_figure("heading", runs).axes[0].get_lines()
    }
    for run in runs:
        entity = f"/runs/{run.name}/heading_deg"
        (shown,) = read_static(tmp_path / "runs.rrd", entity, "SeriesLines:colors")
        printed = np.rint(np.multiply(to_rgb(lines[run.name].get_color()), 255))
        assert [shown >> 24, shown >> 16 & 255, shown >> 8 & 255] == printed.tolist()


def test_a_run_alone_has_one_colour_on_screen_and_on_paper(tmp_path: Path) -> None:
    run = simulate_preset("paper-kp4")
    tl.write_run_rrd(run, tmp_path / "run.rrd")
    (shown,) = read_static(tmp_path / "run.rrd", "/heading_deg", "SeriesLines:colors")
    lines = {
        line.get_label(): line for line in tl.draw.draw_figure("heading", [run]).axes[0].get_lines()
    }
    printed = np.rint(np.multiply(to_rgb(lines[run.name].get_color()), 255))
    assert [shown >> 24, shown >> 16 & 255, shown >> 8 & 255] == printed.tolist()


def test_a_cause_has_no_colour_of_a_run_or_a_ghost() -> None:
    colors = [*choose_cause_colors("abcdef").values()]
    others = [*choose_run_colors(7), MAIN, GHOST]
    pairs = [*product(colors, others), *combinations(colors, 2)]
    assert min(measure_difference(*pair) for pair in pairs) > LEAST_DIFFERENCE


def test_bars_of_causes_stand_out_on_both_grounds() -> None:
    for color in choose_cause_colors("abcdef").values():
        for ground in (GROUND, (255, 255, 255)):
            assert measure_contrast(color, ground) > LEAST_BAR_CONTRAST, color


def test_more_than_six_causes_begin_again() -> None:
    found = choose_cause_colors("abcdefg")
    assert found["g"] == found["a"]


def measure_difference(one: Color, other: Color) -> float:
    """Return how far two colours are apart in CIELAB (1976)."""
    return float(np.linalg.norm(find_lab(one) - find_lab(other)))


def find_lab(color: Color) -> np.ndarray:
    """Return L*, a* and b* of sRGB under its white, D65."""
    parts = np.array(color) / 255.0
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    to_xyz = [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    x, y, z = np.cbrt(np.array(to_xyz) @ linear / [0.9505, 1.0, 1.089])
    return np.array([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)])
