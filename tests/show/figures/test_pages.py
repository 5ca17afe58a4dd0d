"""How many dots files of figures have."""

from pathlib import Path

import pytest

import turtlelog as tl
from turtlelog.errors import ShowError


def test_a_png_has_the_dots_per_inch_of_its_page(tmp_path: Path) -> None:
    page = tl.show.Page(kind="page", dpi=100)
    (path,) = tl.write_figures([], tmp_path, only=["plant"], formats=["png"], page=page)
    assert int.from_bytes(path.read_bytes()[16:20]) == pytest.approx(181.0 / 25.4 * 100.0, abs=1.0)


@pytest.mark.parametrize("dpi", [49, 601, -1])
def test_dots_that_nobody_can_use_are_refused(dpi: int) -> None:
    with pytest.raises(ShowError, match=f"dpi: expected 50 to 600, found {dpi}"):
        tl.show.Page(dpi=dpi)


@pytest.mark.parametrize("dpi", [50, 600])
def test_the_borders_of_dots_are_taken(dpi: int) -> None:
    assert tl.show.Page(dpi=dpi).dpi == dpi
