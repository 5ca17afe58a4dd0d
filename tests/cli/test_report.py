import hashlib
import html
import json
import math
import re
import shlex
import sys
from dataclasses import replace
from pathlib import Path

import pytest

import turtlelog as tl
from tests.identify.robots import Log, make_run, write_bag
from turtlelog.charts.close_up import format_length
from turtlelog.cli.app import main
from turtlelog.draw.report_sections import conclude_checks, conclude_runs, write_table

RECORDINGS = Path(__file__).parents[2] / "recordings" / "paper"


def run(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as ended:
        main([str(word) for word in words])
    printed = capsys.readouterr()
    assert isinstance(ended.value.code, int)
    return ended.value.code, printed.out, printed.err


@pytest.mark.thorough
def test_a_report_of_four_runs_is_one_file_that_names_all_of_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A report with the plots of four runs; the first one loads Bokeh."""
    files = [RECORDINGS / f"kp{gain}.mcap" for gain in (1, 2, 4, 10)]
    path = tmp_path / "report.html"
    code, out, _ = run(capsys, "report", *files, "-o", path, "--json")
    answer, text = json.loads(out), path.read_text("utf-8")
    assert (code, answer["output"], answer["explained"]) == (0, str(path), None)
    assert answer["bytes"] == path.stat().st_size < 3_000_000
    assert "paper-kp2 ends nearest to its goal (1.01 mm), and paper-kp10 furthest" in text
    assert [hashlib.sha256(file.read_bytes()).hexdigest() in text for file in files] == [True] * 4
    assert re.search(r"<(script|link|img)[^>]+(src|href)=\"(?!data:)", text) is None
    assert [entry.name for entry in tmp_path.iterdir()] == ["report.html"]


def test_a_run_alone_is_explained_with_its_ghosts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A report with its explanation: Bokeh is loaded and all subsets of effects are simulated."""
    path = tmp_path / "report.html"
    assert run(capsys, "report", RECORDINGS / "kp10.mcap", "-o", path)[0] == 0
    text = path.read_text("utf-8")
    assert "queue +0.05108 m and pause +0.05057 m" in text
    for words in ("106.7 mm", "+51.1 mm (48 %)", "without both 0.005077 m"):
        assert words in text


def test_a_check_that_fails_is_told_on_top_and_by_the_exit_code(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Three reports are written, one with each command and verdict."""
    spec, path = tmp_path / "spec.toml", tmp_path / "report.html"
    spec.write_text('format = 1\n[checks.line]\nholds = "always(abs(cross_track) <= 0.05)"\n')
    words = [RECORDINGS / "kp10.mcap", "--spec", spec, "-o", path, "--explain", "none"]
    assert run(capsys, "report", *words)[0] == 1
    text = path.read_text("utf-8")
    assert "1 of 1 check fails: line in paper-kp10." in text
    assert "first -0.05008 m at 5.664 s; worst -0.10774 m at 8.784 s" in text
    path.unlink()
    words = [spec, RECORDINGS / "kp4.mcap", "--report", path]
    assert run(capsys, "check", *words)[0] == 0
    assert "The check passes." in path.read_text("utf-8")
    path.unlink()
    words = [spec, RECORDINGS / "kp10.mcap", "--report", path]
    assert run(capsys, "check", *words)[0] == 1
    assert 'id="violation-0"' in path.read_text("utf-8")


def test_the_command_in_a_report_names_the_folder_that_was_typed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A report is written."""
    folder, path = tmp_path / "runs", tmp_path / "report.html"
    folder.mkdir()
    for name in ("a", "b"):
        (folder / f"{name}.csv").write_text("t,x,y,heading\n0,0,0,0\n1,1,0,0\n2,2,0,0\n")
    assert run(capsys, "report", folder, "-o", path)[0] == 0
    told = re.search("<pre><code>turtlelog (.*?)</code>", path.read_text("utf-8"))
    assert told is not None
    assert shlex.split(html.unescape(told[1]))[:3] == ["report", str(folder), "-o"]


@pytest.mark.thorough
def test_the_command_that_writes_a_report_again_reads_as_it_was_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two reports are written."""
    table, spec, path = tmp_path / "way.csv", tmp_path / "spec.toml", tmp_path / "report.html"
    rows = "\n".join(f"{0.1 * n:.1f},{0.1 * n:.1f},0,0" for n in range(30))
    table.write_text(f"t,px,y,heading\n{rows}\n")
    spec.write_text('format = 1\n[checks.end]\nholds = "final.position_error <= 9"\n')
    words = ["--column=x=px", "--goal=-1,2"]
    assert run(capsys, "report", table, "-o", path, "--explain", "none", *words)[0] == 0
    told = re.search("<pre><code>turtlelog (.*?)</code>", path.read_text("utf-8"))
    assert told is not None
    again = shlex.split(html.unescape(told[1]))
    assert [word in again for word in words] == [True, True]
    assert "--time=auto" not in again
    first = path.read_bytes()
    assert run(capsys, *again)[0] == 0
    assert f"ended {format_length(math.hypot(3.9, 2.0))} from the goal" in path.read_text("utf-8")
    assert len(first) == path.stat().st_size
    assert run(capsys, "check", spec, table, "--report", path, *words)[0] == 0
    told = re.search("<pre><code>turtlelog (.*?)</code>", path.read_text("utf-8"))
    assert told is not None
    assert run(capsys, *shlex.split(html.unescape(told[1])))[0] == 0


@pytest.mark.parametrize(
    ("verdicts", "expected"),
    [
        ([], ""),
        (["PASS"], "The check passes."),
        (["PASS", "PASS"], "All 2 checks pass."),
        (["SKIPPED"], "1 check is skipped."),
        (["PASS", "SKIPPED", "SKIPPED"], "1 of 3 checks passes. 2 checks are skipped."),
        (["FAIL", "SKIPPED"], "1 of 2 checks fails: c0 in a. 1 check is skipped."),
    ],
)
def test_checks_that_judge_nothing_are_told_on_top(verdicts: list[str], expected: str) -> None:
    found = [("a", f"c{number}", verdict) for number, verdict in enumerate(verdicts)]
    assert conclude_checks(found) == expected


def test_without_bokeh_one_line_says_what_to_install(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in [name for name in sys.modules if name.partition(".")[0] == "bokeh"]:
        monkeypatch.delitem(sys.modules, name)

    class Finder:
        def find_spec(self, name: str, *_: object) -> None:
            if name == "bokeh":
                raise ModuleNotFoundError(name, name=name)

    monkeypatch.setattr(sys, "meta_path", [Finder(), *sys.meta_path])
    path = tmp_path / "report.html"
    code, _, err = run(capsys, "report", RECORDINGS / "kp4.mcap", "-o", path)
    assert (code, err.count("\n"), path.exists()) == (2, 1, False)
    assert "needed for reports, and not installed; `pip install bokeh`" in err


@pytest.mark.thorough
def test_of_a_bag_the_files_in_its_folder_are_hashed(tmp_path: Path) -> None:
    bag, path = tmp_path / "bag", tmp_path / "report.html"
    bag.mkdir()
    for name in ("metadata.yaml", "bag_0.mcap"):
        (bag / name).write_text(name)
    tl.draw.write_report([tl.read_run(RECORDINGS / "kp4.mcap")], path, sources=[bag])
    keys = [hashlib.sha256(name.encode()).hexdigest() for name in ("bag_0.mcap", "metadata.yaml")]
    expected = f"<code>bag_0.mcap {keys[0]}, metadata.yaml {keys[1]}</code>"
    assert expected in path.read_text("utf-8")


def test_a_report_has_the_notes_on_its_data_that_info_gives(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The robot is carried half a metre away."""
    driven = make_run(Log(duration_s=8.0, noise_m=0.0, noise_rad=0.0, jitter_s=0.0), 1)
    xy_m = driven.poses.xy_m.copy()
    xy_m[100:] += 0.5
    carried = replace(driven, poses=replace(driven.poses, xy_m=xy_m))
    path = write_bag(carried, tmp_path / "carried.mcap")
    notes = tl.measure.describe_source(tl.read_run(path))
    assert {"jumps", "clock"} <= notes.keys()
    assert run(capsys, "report", path, "-o", tmp_path / "report.html")[0] == 0
    text = html.unescape((tmp_path / "report.html").read_text("utf-8"))
    for name, note in notes.items():
        place = text.index(f"{name.replace('_', ' ')}: {note}")
        assert place < text.index('id="stage"')


@pytest.mark.parametrize(("rows", "is_told"), [(15, False), (16, True)])
def test_a_table_that_scrolls_in_its_box_says_how_many_rows_it_has(
    rows: int, *, is_told: bool
) -> None:
    columns = (tl.compare.Column(title="key"), tl.compare.Column(title="value"))
    table = tl.compare.Table(title="Values", columns=columns, rows=((("a", 1.0),) * rows))
    assert (f"Values, {rows} rows" in write_table(table)) is is_told


def test_runs_that_the_time_limit_ended_are_told_so() -> None:
    scenario = tl.scenario.get_preset("paper-kp4")
    ended = tl.simulate_run(replace(scenario, max_duration_s=2.0))
    told = conclude_runs([ended], ["short"], [tl.measure_run(ended)])
    assert "short reached the time limit." in told
