import pytest

from turtlelog.show.rerun.palette import choose_run_colors


@pytest.mark.parametrize("count", [1, 2, 7, 8, 20, 50])
def test_every_run_has_a_colour_of_its_own(count: int) -> None:
    assert len(set(choose_run_colors(count))) == count


@pytest.mark.parametrize("count", [7, 20])
def test_colours_are_legible_on_dark_ground(count: int) -> None:
    for red, green, blue in choose_run_colors(count):
        assert 0.2126 * red + 0.7152 * green + 0.0722 * blue > 85


def test_colours_of_many_runs_rise_in_lightness() -> None:
    lightness = [0.3 * r + 0.6 * g + 0.1 * b for r, g, b in choose_run_colors(20)]
    assert lightness == sorted(lightness)
