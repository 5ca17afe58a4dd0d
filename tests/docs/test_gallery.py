"""The gallery has each kind of picture, from a command, and is small."""

from pathlib import Path

import pytest

from tests.docs.test_pages import list_console
from turtlelog.draw import FIGURES

DOCS = Path(__file__).parents[2] / "docs"


@pytest.mark.parametrize("kind", [*FIGURES, "map", "curves", "tornado", "drive"])
def test_each_kind_has_a_picture_that_a_command_draws(kind: str) -> None:
    (picture,) = (DOCS / "gallery").glob(f"{kind}.*")
    page = (DOCS / "gallery.md").read_text("utf-8")
    assert f"](gallery/{picture.name})" in page
    commands = " ".join(command for command, _ in list_console(DOCS / "gallery.md"))
    assert kind in commands.replace(",", " ").split() or picture.name in commands


def test_the_gallery_is_small() -> None:
    sizes = [picture.stat().st_size for picture in (DOCS / "gallery").iterdir()]
    assert sum(sizes) <= 3 * 2**20
    assert max(sizes) < 2**20
