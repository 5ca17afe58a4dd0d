"""How many dots files of figures have."""

import io
import re
import zlib
from pathlib import Path

import pytest
from fontTools.ttLib import TTFont

import turtlelog as tl
from turtlelog.errors import ShowError


def test_a_png_has_the_dots_per_inch_of_its_page(tmp_path: Path) -> None:
    page = tl.draw.Page(kind="page", dpi=100)
    (path,) = tl.write_figures([], tmp_path, only=["plant"], formats=["png"], page=page)
    assert int.from_bytes(path.read_bytes()[16:20]) == pytest.approx(181.0 / 25.4 * 100.0, abs=1.0)


@pytest.mark.parametrize("dpi", [49, 601, -1])
def test_dots_that_nobody_can_use_are_refused(dpi: int) -> None:
    with pytest.raises(ShowError, match=f"dpi: expected 50 to 600, found {dpi}"):
        tl.draw.Page(dpi=dpi)


@pytest.mark.parametrize("dpi", [50, 600])
def test_the_borders_of_dots_are_taken(dpi: int) -> None:
    assert tl.draw.Page(dpi=dpi).dpi == dpi


def test_a_pdf_has_of_its_font_what_draws_letters(tmp_path: Path) -> None:
    (path,) = tl.write_figures([], tmp_path, only=["plant"], formats=["pdf"])
    found = re.findall(rb"stream\r?\n(.*?)\r?\nendstream", path.read_bytes(), flags=re.DOTALL)
    packed = [data for data in found if data.startswith(b"x")]
    streams = [zlib.decompressobj().decompress(data) for data in packed]
    fonts = [TTFont(io.BytesIO(data)) for data in streams if data.startswith(b"\0\1\0\0")]
    assert fonts
    for font in fonts:
        assert {"glyf", "head", "hmtx"} <= {*font.keys()}
        assert not {"GSUB", "GPOS", "GDEF", "MATH", "kern"} & {*font.keys()}
