"""The notebooks are run cell by cell, and what each cell ends with shows itself."""

from pathlib import Path
from typing import Any, Final

import pytest

from tests.docs.notebook_pages import FOLDER, PAGES, read_cells, run_notebook

EVERYDAY: Final = "why_kp10_misses"


def is_shown(value: Any) -> bool:
    """Return whether a notebook shows more of a value than where it is in memory."""
    shows = (getattr(value, name, None) for name in ("_repr_html_", "_repr_png_"))
    return any(show is not None and show() for show in shows) or " at 0x" not in repr(value)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(path.stem, marks=[] if path.stem == EVERYDAY else pytest.mark.thorough)
        for path in sorted(FOLDER.glob("*.ipynb"))
    ],
)
def test_notebook_runs_and_shows_the_values_of_its_page(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Simulates, explains and draws what a reader would: 5 to 20 s."""
    monkeypatch.chdir(tmp_path)
    page = run_notebook(FOLDER / f"{name}.ipynb")
    assert all(map(is_shown, page.values))
    assert len(page.values) >= 4
    # The coordinates in pictures are rounded otherwise on other platforms, and fonts differ.
    assert page.text == (PAGES / f"{name}.md").read_text("utf-8"), "make notebooks"
    assert {*page.pictures} == {path.name for path in PAGES.glob(f"{name}-*")}


@pytest.mark.parametrize("path", sorted(PAGES.glob("*-*")), ids=lambda path: path.name)
def test_the_pictures_of_pages_are_small_and_whole(path: Path) -> None:
    data = path.read_bytes()
    assert len(data) < 100_000
    assert data.startswith(b"<svg" if path.suffix == ".svg" else b"\x89PNG")
    assert data.endswith(b"</svg>" if path.suffix == ".svg" else b"IEND\xaeB`\x82")
    assert f"]({path.name})" in (PAGES / f"{path.stem.rpartition('-')[0]}.md").read_text("utf-8")


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.ipynb")), ids=lambda path: path.stem)
def test_notebook_holds_no_outputs_and_begins_with_what_it_is_about(path: Path) -> None:
    cells = read_cells(path)
    assert cells[0]["source"][0].startswith("# ")
    for cell in cells:
        if cell["cell_type"] == "code":
            assert (cell["outputs"], cell["execution_count"]) == ([], None)


def test_there_are_three_notebooks_and_a_page_of_each() -> None:
    names = {path.stem for path in FOLDER.glob("*.ipynb")}
    assert len(names) == 3
    assert {path.stem for path in PAGES.glob("*.md")} == names
