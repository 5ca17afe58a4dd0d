from itertools import combinations, product
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
)
from turtlelog.draw.figures.page import choose_lines
from turtlelog.scenario import PAPER_RUNS

LEAST_CONTRAST = 2.2
"""What the palette of Okabe and Ito gives its orange on white."""

LEAST_BAR_CONTRAST = 1.9
"""Of a broad bar, whose words stand beside it."""

LEAST_DIFFERENCE = 25.0
"""In CIELAB: ten times what the eye just tells from one patch to the next."""


@pytest.mark.parametrize("count", [1, 2, 7, 8, 20, 50])
def test_every_run_has_a_colour_of_its_own(count: int) -> None:
    assert len(set(choose_run_colors(count))) == count


@pytest.mark.parametrize("count", [7, 20])
def test_colours_are_legible_on_dark_ground(count: int) -> None:
    for red, green, blue in choose_run_colors(count):
        assert 0.2126 * red + 0.7152 * green + 0.0722 * blue > 85


@pytest.mark.parametrize("ground", [GROUND, (255, 255, 255)], ids=["screen", "paper"])
def test_colours_of_a_few_runs_stand_out_on_both_grounds(ground: Color) -> None:
    for color in choose_run_colors(7):
        bright, dark = sorted((measure_luminance(color), measure_luminance(ground)), reverse=True)
        assert (bright + 0.05) / (dark + 0.05) > LEAST_CONTRAST, color


def measure_luminance(color: Color) -> float:
    """Return the relative luminance of sRGB, as WCAG defines it."""
    parts = np.array(color) / 255.0
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def test_colours_of_many_runs_rise_in_lightness() -> None:
    lightness = [0.3 * r + 0.6 * g + 0.1 * b for r, g, b in choose_run_colors(20)]
    assert lightness == sorted(lightness)


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
            bright, dark = sorted(
                (measure_luminance(color), measure_luminance(ground)), reverse=True
            )
            assert (bright + 0.05) / (dark + 0.05) > LEAST_BAR_CONTRAST, color


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
