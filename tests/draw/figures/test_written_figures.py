"""Figures and tables as files: formats, sizes, order, and what is refused."""

import re
from collections.abc import Sequence
from pathlib import Path

import pytest

import turtlelog as tl
from tests.draw.figures.paper_runs import keep_poses, simulate
from tests.draw.rerun.rrds import make_foreign_run
from turtlelog.errors import ShowError

GAINS = (1, 2, 4, 10)
RUNS = [simulate(kp) for kp in GAINS]


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Write a figure twice in every format."""
    folders = [tmp_path_factory.mktemp(name) for name in ("once", "again")]
    return [path for folder in folders for path in tl.write_figures(RUNS, folder, only=["heading"])]


@pytest.mark.thorough
def test_figures_are_written_in_every_format(written: list[Path]) -> None:
    assert [path.name for path in written[:3]] == ["heading.pdf", "heading.png", "heading.svg"]
    starts = [path.read_bytes()[:5] for path in written[:3]]
    assert starts == [b"%PDF-", b"\x89PNG\r", b"<?xml"]


def test_fonts_stand_in_the_pdf_as_truetype(written: list[Path]) -> None:
    pdf = written[0].read_bytes()
    assert b"/FontFile2" in pdf
    assert b"/Type3" not in pdf


def test_files_have_the_size_of_the_page(written: list[Path]) -> None:
    points = re.search(rb"/MediaBox \[ 0 0 ([0-9.]+)", written[0].read_bytes())
    assert points is not None
    assert float(points[1]) / 72.0 * 25.4 == pytest.approx(87.5, abs=0.01)
    pixels = int.from_bytes(written[1].read_bytes()[16:20])
    assert pixels / 300.0 * 25.4 == pytest.approx(87.5, abs=0.1)


def test_the_same_runs_give_the_same_files(written: list[Path]) -> None:
    assert [path.read_bytes() for path in written[:3]] == [
        path.read_bytes() for path in written[3:]
    ]


@pytest.mark.parametrize(
    ("only", "runs", "match"),
    [
        (["headng"], [], 'no figure "headng"; did you mean heading\\?'),
        (["heading"], [], "figure heading needs a recording"),
        (["wanted-speed"], [keep_poses(simulate(4))], "needs what the law wanted before clip"),
        (["plant"], [keep_poses(simulate(4))], "figure plant needs the law's gain"),
    ],
    ids=["unknown", "no run", "no samples", "no gain"],
)
def test_figures_that_cannot_be_are_refused_before_any_is_written(
    only: Sequence[str], runs: Sequence[tl.Run], match: str, tmp_path: Path
) -> None:
    with pytest.raises(ShowError, match=match):
        tl.write_figures(runs, tmp_path / "new", only=["plane" if runs else "plant", *only])
    assert not (tmp_path / "new").exists()


def test_an_unknown_format_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ShowError, match="expected some of pdf, png, svg, found 'gif'"):
        tl.write_figures([], tmp_path, formats=["gif"])


def test_a_folder_that_is_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ShowError, match="file: expected a folder to write to"):
        tl.write_figures([], tmp_path / "file")


def test_a_table_without_a_value_is_left_out(tmp_path: Path) -> None:
    written = tl.draw.write_tables([make_foreign_run(50)], tmp_path)
    assert [path.name for path in written] == ["whole-runs.tex", "metrics.tex"]


def test_tables_are_written_as_latex_in_the_order_of_gains(tmp_path: Path) -> None:
    written = tl.draw.write_tables([simulate(10), simulate(2)], tmp_path)
    assert [path.name for path in written] == ["whole-runs.tex", "table1.tex", "metrics.tex"]
    for path in written:
        text = path.read_text("utf-8")
        assert rf"\label{{tab:{path.stem}}}" in text
        assert r"\toprule" in text
        assert r"\bottomrule" in text
        assert text.index("paper-kp2") < text.index("paper-kp10")
    assert r"\caption{Errors 15 s after the first sample}" in written[1].read_text("utf-8")


def test_metrics_of_many_runs_stand_in_rows(tmp_path: Path) -> None:
    metrics = tl.draw.write_tables([*RUNS, simulate(1)], tmp_path)[2].read_text("utf-8")
    assert metrics.count("paper-kp") == 5
    assert r"    paper-kp10 & 10 & " in metrics
