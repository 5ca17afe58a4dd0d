"""The notebooks are run cell by cell, and what each cell ends with shows itself."""

import ast
import json
import warnings
from pathlib import Path
from typing import Any, Final

import pytest

FOLDER: Final = Path(__file__).parents[2] / "examples" / "notebooks"
EVERYDAY: Final = "why_kp10_misses"


def read_cells(path: Path) -> list[dict[str, Any]]:
    cells: list[dict[str, Any]] = json.loads(path.read_text("utf-8"))["cells"]
    return cells


def run_cell(text: str, names: dict[str, Any]) -> Any:
    """Return the value of the last line, as a notebook shows it."""
    body = ast.parse(text).body
    last = body.pop() if isinstance(body[-1], ast.Expr) else None
    exec(compile(ast.Module(body, type_ignores=[]), "<cell>", "exec"), names)
    if not isinstance(last, ast.Expr):
        return None
    return eval(compile(ast.Expression(last.value), "<cell>", "eval"), names)


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
def test_notebook_runs_and_shows_its_values(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Simulates, explains and draws what a reader would: 5 to 20 s."""
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"__name__": "__main__"}
    values = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of libraries in a first import
        for cell in read_cells(FOLDER / f"{name}.ipynb"):
            if cell["cell_type"] == "code":
                values.append(run_cell("".join(cell["source"]), names))
    assert all(is_shown(value) for value in values if value is not None)
    assert sum(value is not None for value in values) >= 4


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.ipynb")), ids=lambda path: path.stem)
def test_notebook_holds_no_outputs_and_begins_with_what_it_is_about(path: Path) -> None:
    cells = read_cells(path)
    assert cells[0]["source"][0].startswith("# ")
    for cell in cells:
        if cell["cell_type"] == "code":
            assert (cell["outputs"], cell["execution_count"]) == ([], None)


def test_there_are_three_notebooks() -> None:
    assert len([*FOLDER.glob("*.ipynb")]) == 3
