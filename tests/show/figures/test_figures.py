"""What figures show, read from their structure."""

from collections.abc import Sequence
from dataclasses import fields, replace
from functools import cache
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest
from matplotlib.figure import Figure

import turtlelog as tl
from turtlelog.errors import ShowError
from turtlelog.run import CommandColumns, SampleColumns
from turtlelog.scenario import get_preset
from turtlelog.show.figures.page import choose_lines

Columns = TypeVar("Columns", SampleColumns, CommandColumns)

GAINS = (1, 2, 4, 10)
THEORY = ["plant", "step-responses", "root-locus"]


@cache
def simulate(kp: int) -> tl.Run:
    return tl.simulate_run(get_preset(f"paper-kp{kp}"))


def list_runs() -> list[tl.Run]:
    return [simulate(kp) for kp in GAINS]


def find_line(figure: Figure, label: str, axes: int = 0) -> tuple[np.ndarray, np.ndarray]:
    (line,) = [line for line in figure.axes[axes].get_lines() if line.get_label() == label]
    return np.asarray(line.get_xdata()), np.asarray(line.get_ydata())


def list_labels(figure: Figure, axes: int = 0) -> list[str]:
    labels = [str(line.get_label()) for line in figure.axes[axes].get_lines()]
    return [label for label in labels if not label.startswith("_")]


def test_the_heading_is_the_recorded_one_in_degrees() -> None:
    run = simulate(10)
    time_s, values = find_line(tl.draw_figure("heading", [run]), "paper-kp10")
    assert np.array_equal(time_s, (run.poses.time_ns - run.start_ns) / 1e9)
    assert np.array_equal(values, np.degrees(np.unwrap(run.poses.heading_rad)))


def test_the_goal_bearing_and_the_ideal_response_stand_beside_the_heading() -> None:
    run = simulate(1)
    figure = tl.draw_figure("heading", [run])
    _, bearing = find_line(figure, "goal bearing")
    time_s, ideal = find_line(figure, "ideal")
    expected = float(np.degrees(run.samples.bearing_rad[0]))
    assert bearing[0] == expected
    assert ideal == pytest.approx(expected * (1.0 - np.exp(-time_s)), abs=1e-9)


@pytest.mark.parametrize("kp", GAINS)
def test_the_plant_s_responses_and_the_closed_loop_s_are_the_textbook_s(kp: int) -> None:
    time_s, values = find_line(tl.draw_figure("step-responses", [simulate(kp)]), f"Kp = {kp}")
    assert values == pytest.approx(1.0 - np.exp(-kp * time_s), abs=1e-12)
    place, _ = find_line(tl.draw_figure("root-locus", [simulate(kp)]), f"Kp = {kp}")
    assert place.tolist() == [-kp]


def test_the_plant_answers_a_ramp_with_a_parabola() -> None:
    figure = tl.draw_figure("plant")
    curves = [axes.get_lines()[0].get_xydata() for axes in figure.axes]
    assert all(np.asarray(curve).shape == (201, 2) for curve in curves)
    impulse, step, ramp = (np.asarray(curve) for curve in curves)
    assert (impulse[:, 1] == 1.0).all()
    assert (step[:, 1] == step[:, 0]).all()
    assert ramp[:, 1] == pytest.approx(ramp[:, 0] ** 2 / 2.0)


def test_commands_of_one_run_stand_wanted_commanded_applied() -> None:
    run = simulate(10)
    figure = tl.draw_figure("speed", [run])
    assert list_labels(figure) == ["limit", "wanted", "commanded", "applied"]
    _, commanded = find_line(figure, "commanded")
    assert np.array_equal(commanded, run.samples.speed_m_s)
    low, high = figure.axes[0].get_ylim()
    assert low < run.samples.speed_m_s.min()
    assert 1.0 < high < 2.0


def test_commands_hold_until_the_next() -> None:
    (line,) = [
        line
        for line in tl.draw_figure("turn-rate", [simulate(4)]).axes[0].get_lines()
        if line.get_label() == "commanded"
    ]
    assert line.get_drawstyle() == "steps-post"


def test_what_the_law_wanted_reaches_57_metres_a_second() -> None:
    figure = tl.draw_figure("wanted-speed", list_runs())
    largest = [float(find_line(figure, f"paper-kp{kp}")[1].max()) for kp in GAINS]
    assert largest == pytest.approx([5.69, 11.39, 22.77, 56.94], abs=0.02)


def test_errors_stand_on_a_logarithmic_scale_where_exponentials_are_straight() -> None:
    figure = tl.draw_figure("error-log", [simulate(1)])
    assert [axes.get_yscale() for axes in figure.axes] == ["log", "log"]
    time_s, sizes = find_line(figure, "paper-kp1")
    free = (time_s > 3.0) & (time_s < 6.0)
    slope = np.polyfit(time_s[free], np.log(sizes[free]), 1)[0]
    # Six ticks of dead time let it decay a little faster than exp(-t).
    assert slope == pytest.approx(-1.1, abs=0.02)


def test_the_plane_keeps_its_proportions_and_shows_how_runs_end() -> None:
    figure = tl.draw_figure("plane", list_runs())
    whole, close = figure.axes
    assert (whole.get_aspect(), close.get_aspect()) == (1.0, 1.0)
    low, high = close.get_xlim()
    assert high - low < 0.5
    assert low < 2.0 < high


def test_runs_differ_in_colour_and_in_dashes() -> None:
    figure = tl.draw_figure("heading-error", list_runs())
    lines = [line for line in figure.axes[0].get_lines() if "paper" in str(line.get_label())]
    assert len({line.get_color() for line in lines}) == 4
    assert len({str(looks["linestyle"]) for looks in choose_lines(4)}) == 4


@pytest.mark.parametrize(("columns", "width_mm"), [(1, 87.5), (2, 181.0)])
def test_figures_are_as_wide_as_the_page_has_room(columns: int, width_mm: float) -> None:
    figure = tl.draw_figure("heading", [simulate(1)], page=tl.Page(columns=columns))  # type: ignore[arg-type]
    assert figure.get_size_inches()[0] * 25.4 == pytest.approx(width_mm)


@pytest.mark.parametrize("text_width_mm", [0.0, 39.0, 1001.0, float("nan"), float("inf")])
def test_a_page_of_no_sensible_width_is_refused(text_width_mm: float) -> None:
    with pytest.raises(ShowError, match="text width: expected 40 to 1000 mm"):
        tl.Page(text_width_mm=text_width_mm)


def test_figures_are_written_in_every_format(tmp_path: Path) -> None:
    names = ["plant", "heading", "plane"]
    written = tl.write_figures([simulate(4)], tmp_path, only=names)
    assert [path.name for path in written] == [
        f"{name}.{form}" for name in names for form in ("pdf", "png", "svg")
    ]
    starts = {path: path.read_bytes()[:5] for path in written}
    known = {".pdf": b"%PDF-", ".png": b"\x89PNG\r", ".svg": b"<?xml"}
    assert all(start == known[path.suffix] for path, start in starts.items())


@pytest.mark.parametrize("name", tl.FIGURES)
def test_every_figure_is_drawn_for_one_run_and_for_several(name: str) -> None:
    alone, several = (tl.draw_figure(name, runs) for runs in ([simulate(10)], list_runs()))
    assert alone.axes
    assert len(alone.axes) == len(several.axes)
    assert all(axes.get_xlabel() or axes.get_ylabel() for axes in several.axes)


def test_fonts_stand_in_the_pdf(tmp_path: Path) -> None:
    (path,) = tl.write_figures([], tmp_path, only=["plant"], formats=["pdf"])
    assert b"/FontFile2" in path.read_bytes()


def test_the_same_runs_give_the_same_files(tmp_path: Path) -> None:
    names = ["heading"]
    first = tl.write_figures([simulate(4)], tmp_path / "a", only=names)
    again = tl.write_figures([simulate(4)], tmp_path / "b", only=names)
    assert [path.read_bytes() for path in first] == [path.read_bytes() for path in again]


def test_without_runs_there_is_theory(tmp_path: Path) -> None:
    written = tl.write_figures([], tmp_path, formats=["svg"])
    assert [path.stem for path in written] == THEORY


def keep_poses(run: tl.Run) -> tl.Run:
    samples, commands = empty(run.samples), empty(run.commands)
    return replace(run, samples=samples, commands=commands, goal_xy_m=None, parameters={})


def empty(columns: Columns) -> Columns:
    tables = {field.name: getattr(columns, field.name) for field in fields(columns)}
    return replace(columns, **{name: table[:0] for name, table in tables.items()})


def test_poses_alone_give_position_and_plane(tmp_path: Path) -> None:
    written = tl.write_figures([keep_poses(simulate(4))], tmp_path, formats=["png"])
    assert [path.stem for path in written] == [*THEORY, "position", "plane"]


@pytest.mark.parametrize(
    ("only", "runs", "match"),
    [
        (["headng"], [], "'headng': expected one of heading"),
        (["heading"], [], "figure heading: expected a recording, found none"),
        (["speed"], [keep_poses(simulate(4))], "expected the controller's samples, found none"),
    ],
    ids=["unknown", "no run", "no samples"],
)
def test_figures_that_cannot_be_are_refused_before_any_is_written(
    only: Sequence[str], runs: Sequence[tl.Run], match: str, tmp_path: Path
) -> None:
    with pytest.raises(ShowError, match=match):
        tl.write_figures(runs, tmp_path / "new", only=["plant", *only])
    assert not (tmp_path / "new").exists()


def test_an_unknown_format_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ShowError, match="expected some of pdf, png, svg, found 'gif'"):
        tl.write_figures([], tmp_path, formats=["gif"])


def test_a_folder_that_is_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ShowError, match="file: expected a folder to write to"):
        tl.write_figures([], tmp_path / "file")


def test_tables_are_written_as_latex(tmp_path: Path) -> None:
    written = tl.write_tables(list_runs(), tmp_path)
    texts = [path.read_text("utf-8") for path in written]
    assert [path.name for path in written] == ["table1.tex", "whole-runs.tex", "metrics.tex"]
    assert all(r"\toprule" in text and r"\bottomrule" in text for text in texts)


def test_a_long_run_is_thinned_and_says_so() -> None:
    poses = tl.simulate_run(get_preset("textbook")).poses
    rows = np.arange(30_000)
    long = replace(
        poses,
        time_ns=rows * 16_000_000,
        xy_m=np.column_stack([np.sin(rows / 100.0), np.cos(rows / 100.0)]),
        heading_rad=np.zeros(30_000),
        speed_m_s=None,
        turn_rate_rad_s=None,
    )
    figure = tl.draw_figure("position", [replace(keep_poses(simulate(4)), poses=long)])
    (note,) = figure.axes[0].texts
    assert note.get_text().endswith("of 30,000 points drawn, extremes kept")
