"""A curve and a plot added to a copy of the package as one entry each: every picture has them."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import turtlelog

MARGIN = """                CurveEntry(
                    kind="beside",
                    name="margin",
                    label="to the wall",
                    read=lambda run: [
                        Curve(
                            start_ns=run.start_ns,
                            time_ns=run.poses.time_ns,
                            values=run.poses.xy_m.min(axis=1),
                        )
                    ],
                ),
"""

SPREAD = """        "spread": TimePlot(
            title="spread",
            unit="m",
            curves=(
                CurveEntry(
                    kind="run",
                    label="spread",
                    read=lambda run: [
                        Curve(
                            start_ns=run.start_ns,
                            time_ns=run.poses.time_ns,
                            values=run.poses.xy_m.max(axis=1),
                        )
                    ],
                ),
            ),
            figure="spread",
            place=("moving", 1),
            report="always",
        ),
"""

DRAW = """
import turtlelog as tl
from turtlelog.draw.report_drawing import Drawn
from turtlelog.draw.report_plots import draw_plots
from turtlelog.draw.rerun.run_scene import build_single

run = tl.simulate_run(tl.load_scenario("paper-kp4"))
figure = tl.draw.draw_figure("error-log", [run])
assert "to the wall" in [line.get_label() for axes in figure.axes for line in axes.get_lines()]
assert [axes.get_ylabel() for axes in tl.draw.draw_figure("spread", [run]).axes] == ["spread [m]"]
single = build_single(run)
entities = {series.entity: series.labels for series in single.series}
assert {"spread", "distance/margin"} <= {*entities}, entities
assert "to the wall" in entities["distance/margin"][0]
tl.write_run_rrd(run, "run.rrd")
page = draw_plots([Drawn(run=run, name="run", color=(0, 114, 178))], [tl.measure_run(run)], [])
assert "plot-spread" in page.roots
names = page.roots["plot-distance"].renderers[0].data_source.data["name"]
assert "to the wall" in names
tl.draw.write_movie([run], "run.gif", length_s=1.0)
"""


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("curve")
    room = Path(turtlelog.__file__).parent
    shutil.copytree(room, folder / "turtlelog", ignore=shutil.ignore_patterns("__pycache__"))
    file = folder / "turtlelog" / "charts" / "time_plots.py"
    text = file.read_text("utf-8")
    before, at, after = text.partition('        "distance": TimePlot(\n')
    head, curves, tail = after.partition("            curves=(\n")
    text = before + SPREAD + at + head + curves + MARGIN + tail
    assert text.count("margin") == 1
    file.write_text(text, "utf-8")
    return folder


@pytest.mark.thorough
def test_a_new_curve_and_a_new_plot_are_in_every_picture(copy: Path) -> None:
    """A process draws a figure, a view, a report and a movie."""
    done = subprocess.run(
        [sys.executable, "-P", "-c", DRAW],
        cwd=copy,
        env={**os.environ, "PYTHONPATH": str(copy)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
