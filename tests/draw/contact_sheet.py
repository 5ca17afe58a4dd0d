"""Odd runs in every view and figure, on one sheet to be looked at.

python tests/draw/contact_sheet.py SHEET.png [BAG]

Rows are runs, columns are Rerun's view, figures for print, the last picture of a movie, and a
report where Chromium is. What refuses to be drawn says why in its place.
"""

import argparse
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

from PIL import Image, ImageDraw

import turtlelog as tl
from turtlelog import Run
from turtlelog.charts.time_plots import plan_film
from turtlelog.draw.figures.page import save_figure
from turtlelog.draw.movie import draw_pictures
from turtlelog.draw.rerun.viewer import open_camera
from turtlelog.errors import TurtlelogError

_CELL: Final = (700, 640)
_FIGURES: Final = ("panel", "plane", "heading")
_HEAD: Final = 24
_CHROMIUM: Final = Path("/usr/bin/chromium")

Draw = Callable[[Sequence[Run], Path], None]


@dataclass(frozen=True)
class Row:
    """Runs that are drawn together."""

    title: str
    runs: tuple[Run, ...]


def main() -> None:
    """Draw the sheet."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("sheet", type=Path)
    parser.add_argument("bag", type=Path, nargs="?")
    asked = parser.parse_args()
    rows = list_rows(asked.bag)
    with tempfile.TemporaryDirectory() as name, open_camera(size=(1200, 750)) as camera:
        folder = Path(name)

        def view(runs: Sequence[Run], png: Path) -> None:
            rrd = folder / "view.rrd"
            if len(runs) == 1:
                tl.write_run_rrd(runs[0], rrd)
            else:
                tl.write_comparison_rrd(runs, rrd)
            camera.take(rrd, png)

        columns: dict[str, Draw] = {"view": view}
        columns |= {figure: _figure(figure) for figure in _FIGURES}
        columns |= {"movie": draw_movie}
        if _CHROMIUM.is_file():
            columns["report"] = draw_report
        _paste(rows, columns, folder).save(asked.sheet)
    print(f"wrote {asked.sheet}")  # noqa: T201


def list_rows(bag: Path | None) -> list[Row]:
    """Return the odd runs: short, unstable, long, many, alike, of long names, and a robot's."""
    many = [_run(kp=kp, name=f"kp{kp:g}") for kp in np.linspace(1.0, 12.0, 100).round(2).tolist()]
    rows = [
        Row("6 samples", (_run(max_duration_s=0.1),)),
        Row("unstable, Kp = 70", (_run(kp=70.0),)),
        Row("goal behind", (_run(goal__x_m=2.0, goal__y_m=5.6, kp=4.0),)),
        Row("600 s", (_run("textbook", kp=0.01, max_duration_s=600.0, law__timeout_s=600.0),)),
        Row("four gains", tuple(_run(kp=kp, name=f"kp{kp:g}") for kp in (1.0, 2.0, 4.0, 10.0))),
        Row("100 runs", tuple(many)),
        Row(
            "long names",
            tuple(
                _run(kp=kp, name=f"a-controller-with-a-long-name-{kp:g}-tuned") for kp in (1.0, 2.0)
            ),
        ),
        Row("a robot", (tl.simulate_run(_change(tl.load_scenario("lagged"), {})),)),
    ]
    return rows if bag is None else [*rows, Row("a bag", (tl.read_run(bag),))]


def _run(preset: str = "paper", *, kp: float = 1.0, **changes: Any) -> Run:
    keys = {name.replace("__", "."): value for name, value in changes.items()}
    gains = {"law.kp_angular": kp, "law.kp_linear": kp}
    return tl.simulate_run(_change(tl.load_scenario(preset), gains | keys))


def _change(scenario: tl.Scenario, changes: dict[str, Any]) -> tl.Scenario:
    return tl.override_scenario(scenario, changes, source="the contact sheet")


def _figure(name: str) -> Draw:
    def draw(runs: Sequence[Run], png: Path) -> None:
        import io

        data = io.BytesIO()
        save_figure(tl.draw.draw_figure(name, runs), data, "png")
        png.write_bytes(data.getvalue())

    return draw


def draw_movie(runs: Sequence[Run], png: Path) -> None:
    """Draw the last picture of a movie."""
    film = plan_film(runs, timeline="sim_time", length_s=1.0, pictures_per_s=4.0)
    *_, last = draw_pictures(runs, film, size=(1280, 720))
    Image.fromarray(last).save(png)


def draw_report(runs: Sequence[Run], png: Path) -> None:
    """Draw the first screen of a report."""
    from playwright.sync_api import sync_playwright

    html = png.with_suffix(".html")
    tl.draw.write_report(runs, html)
    with sync_playwright() as found:
        browser = found.chromium.launch(executable_path=_CHROMIUM, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        page.goto(html.as_uri())
        page.wait_for_timeout(4000)
        page.screenshot(path=png)
        browser.close()


def _paste(rows: Sequence[Row], columns: dict[str, Draw], folder: Path) -> Image.Image:
    width, height = _CELL[0], _CELL[1] + _HEAD
    sheet = Image.new("RGB", (width * len(columns), height * len(rows)), "white")
    for line, row in enumerate(rows):
        for place, (title, draw) in enumerate(columns.items()):
            corner = (place * width, line * height)
            pen = ImageDraw.Draw(sheet)
            pen.text((corner[0] + 6, corner[1] + 6), f"{row.title}: {title}", fill="black")
            png = folder / "cell.png"
            try:
                draw(row.runs, png)
            except TurtlelogError as err:
                pen.text((corner[0] + 6, corner[1] + 60), str(err)[:100], fill="red")
                continue
            with Image.open(png) as cell:
                small = cell.convert("RGB")
                small.thumbnail(_CELL)
                sheet.paste(small, (corner[0], corner[1] + _HEAD))
    return sheet


if __name__ == "__main__":
    main()
