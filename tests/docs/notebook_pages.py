"""Run the notebooks and write a page of each: its cells, and what a notebook shows below them.

python -m tests.docs.notebook_pages
"""

import ast
import json
import os
import re
import warnings
from collections.abc import Iterator
from contextlib import chdir
from dataclasses import dataclass
from html.parser import HTMLParser
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

ROOT: Final = Path(__file__).parents[2]
FOLDER: Final = ROOT / "examples" / "notebooks"
PAGES: Final = ROOT / "docs" / "notebooks"

_SVG: Final = re.compile(r"<svg.*?</svg>", re.DOTALL)
_UNSHOWN: Final = re.compile(r"<(details|style)\b.*?</\1>", re.DOTALL)
"""Parts that stay folded, and styles."""


@dataclass(slots=True, kw_only=True)
class Page:
    """A notebook with its outputs.

    Attributes:
        text: The page in Markdown.
        values: What the code cells end with, without None.
        pictures: Pictures by the names of their files beside the page.
    """

    text: str
    values: list[Any]
    pictures: dict[str, bytes]


def read_cells(path: Path) -> list[dict[str, Any]]:
    """Return the cells of a notebook."""
    cells: list[dict[str, Any]] = json.loads(path.read_text("utf-8"))["cells"]
    return cells


def run_notebook(path: Path) -> Page:
    """Run a notebook in the present folder, and return its page."""
    names: dict[str, Any] = {"__name__": "__main__"}
    page = Page(text="", values=[], pictures={})
    link = os.path.relpath(path, PAGES).replace(os.sep, "/")
    parts = [f"<!-- Written by `make notebooks` from {path.name}. -->"]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of libraries in a first import
        for cell in read_cells(path):
            text = "".join(cell["source"])
            if cell["cell_type"] != "code":
                parts.append(text.strip())
                continue
            parts.append(f"```python\n{text.strip()}\n```")
            value = _run_cell(text, names)
            if value is not None:
                page.values.append(value)
                parts += _show(value, path.stem, page.pictures)
    parts.append(f"[The notebook]({link}) to run it yourself.")
    page.text = "\n\n".join(parts) + "\n"
    return page


def _run_cell(text: str, names: dict[str, Any]) -> Any:
    """Return the value of the last line, as a notebook shows it."""
    body = ast.parse(text).body
    last = body.pop() if isinstance(body[-1], ast.Expr) else None
    exec(compile(ast.Module(body, type_ignores=[]), "<cell>", "exec"), names)
    if not isinstance(last, ast.Expr):
        return None
    return eval(compile(ast.Expression(last.value), "<cell>", "eval"), names)


def _show(value: Any, name: str, pictures: dict[str, bytes]) -> Iterator[str]:
    """Yield what a notebook shows of a value, in Markdown; pictures are added to the others."""

    def add(data: bytes, suffix: str) -> str:
        file = f"{name}-{len(pictures) + 1}.{suffix}"
        pictures[file] = data
        return f"![picture {len(pictures)}]({file})"

    html = getattr(value, "_repr_html_", lambda: None)()
    png = getattr(value, "_repr_png_", lambda: None)()
    if html:
        shown = _UNSHOWN.sub("", html)
        reader = _Reader()
        reader.feed(_SVG.sub(lambda svg: f'<img alt="{add(svg[0].encode(), "svg")}">', shown))
        yield from reader.parts
    elif png:
        yield add(png[0] if isinstance(png, tuple) else png, "png")
    else:
        yield f"```text\n{value!r}\n```"


class _Reader(HTMLParser):
    """Reads paragraphs, pictures and tables of HTML as parts of Markdown."""

    def __init__(self) -> None:
        super().__init__()
        self.parts: list[str] = []
        self._rows: list[list[str]] = []
        self._text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag in {"p", "td", "th", "caption"}:
            self._text = ""
        elif tag == "img":
            self.parts.append(str(dict(attrs)["alt"]))
        elif tag == "table":
            self._rows = []
        elif tag == "tr":
            self._rows.append([])
        elif tag == "tbody" and not self._rows:
            self._rows.append([])  # Markdown has no table without heads

    def handle_data(self, data: str) -> None:
        self._text += data

    def handle_endtag(self, tag: str) -> None:
        text = " ".join(self._text.split())
        if tag in {"p", "caption"} and text:
            self.parts.append(text if self.parts else f"**{text}**")
        elif tag in {"td", "th"}:
            self._rows[-1].append(text.replace("|", "\\|"))
        elif tag == "table":
            head, *rows = self._rows
            head += [""] * (max(map(len, self._rows)) - len(head))
            lines = [head, ["---"] * len(head), *rows]
            self.parts.append("\n".join(f"| {' | '.join(line)} |" for line in lines))


def write_pages() -> None:
    """Run each notebook in a folder of its own, and write its page and pictures."""
    PAGES.mkdir(exist_ok=True)
    for old in PAGES.iterdir():
        old.unlink()
    for path in sorted(FOLDER.glob("*.ipynb")):
        with TemporaryDirectory() as folder, chdir(folder):
            page = run_notebook(path)
        (PAGES / f"{path.stem}.md").write_text(page.text, "utf-8")
        for name, data in page.pictures.items():
            (PAGES / name).write_bytes(data)


if __name__ == "__main__":
    write_pages()
