"""`metrics`, `check` and `compare` on folders, with and without a table."""

import os
import shutil
from pathlib import Path

import pytest

import turtlelog as tl
from tests.cli.conftest import Call
from turtlelog.sweep import read_result_table

SPEC = 'format = 1\n[checks.short]\nexpect = "run.duration < 1"\n'


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two that are short, one that is not, and one that is cut."""
    place = tmp_path / "runs"
    (place / "deep").mkdir(parents=True)
    for name, duration_s in (("a", 0.4), ("b", 0.5), ("deep/c", 1.5)):
        changes = {"max_duration_s": duration_s}
        scenario = tl.override_scenario(tl.load_scenario("textbook"), changes)
        tl.write_recording(tl.simulate_run(scenario), place / f"{name}.mcap")
    (place / "cut.mcap").write_bytes((place / "a.mcap").read_bytes()[:300])
    (place / "notes.txt").write_text("none of them")
    (tmp_path / "spec.toml").write_text(SPEC)
    monkeypatch.chdir(tmp_path)
    return place


def test_metrics_takes_the_recordings_below_a_folder(call: Call, folder: Path) -> None:
    answer = call("metrics", "runs", "--json", "--metric", "run.duration")
    assert answer.code == 2
    assert [Path(one["file"]).name for one in answer.json] == ["a.mcap", "b.mcap", "c.mcap"]
    assert "cut.mcap: " in answer.err
    assert "notes.txt" not in answer.err


def test_numbered_recordings_are_no_parts_of_one_bag(call: Call, folder: Path) -> None:
    for number, name in ((1, "a"), (2, "b"), (10, "a")):
        shutil.copy(folder / f"{name}.mcap", folder / "deep" / f"kp_{number}.mcap")
    (folder / "deep" / "c.mcap").unlink()
    answer = call("metrics", "runs/deep", "--json", "--metric", "run.duration")
    names = [Path(one["file"]).name for one in answer.json]
    assert (answer.code, names) == (0, ["kp_1.mcap", "kp_2.mcap", "kp_10.mcap"])


def test_compare_takes_the_recordings_below_a_folder(call: Call, folder: Path) -> None:
    answer = call("compare", "runs", "--json", "--metric", "run.duration")
    assert answer.code == 2
    assert [Path(one["file"]).name for one in answer.json["runs"]] == ["a.mcap", "b.mcap", "c.mcap"]
    assert "cut.mcap: " in answer.err


def test_a_reference_below_the_folder_is_not_compared_with_itself(call: Call, folder: Path) -> None:
    (folder / "cut.mcap").unlink()
    words = ("compare", "runs", "--reference", "runs/b.mcap", "--json")
    runs = call(*words).json["runs"]
    assert [Path(one["file"]).name for one in runs] == ["a.mcap", "c.mcap"]


def test_info_and_plot_take_the_recordings_below_a_folder(call: Call, folder: Path) -> None:
    (folder / "cut.mcap").unlink()
    assert [Path(one["file"]).name for one in call("info", "runs", "--json").json] == [
        *("a.mcap", "b.mcap", "c.mcap")
    ]
    answer = call("plot", "runs", "-o", "plane.svg", "--only", "plane", "--json")
    assert [Path(one).name for one in answer.json["files"]] == ["a.mcap", "b.mcap", "c.mcap"]


def test_info_of_more_than_four_files_has_a_line_for_each(call: Call, folder: Path) -> None:
    files = ["a.mcap", "b.mcap"] * 2 + ["a.mcap"]
    answer = call("info", *(f"runs/{name}" for name in files))
    assert answer.out.startswith("5 files: 5 recordings; 0 of 5 reached their goal.\n")
    rows = answer.out.partition("---\n")[2].splitlines()[:5]
    assert [row.split()[:2] for row in rows] == [[name, "recording"] for name in files]
    in_full = call("info", *(f"runs/{name}" for name in files[:4])).out
    assert in_full.count("turtlelog recording, complete") == 4
    topics = call("info", "--topics", *(f"runs/{name}" for name in files)).out
    assert topics.count("/turtle1/pose") == 5


@pytest.mark.parametrize(
    "words",
    [
        *(["metrics", "none"], ["metrics", "none", "-o", "t.parquet"], ["compare", "none"]),
        *(["check", "spec.toml", "none"], ["check", "spec.toml", "none", "-o", "t.parquet"]),
    ],
    ids=" ".join,
)
def test_an_empty_folder_is_one_line(call: Call, folder: Path, words: list[str]) -> None:
    Path("none").mkdir()
    answer = call(*words)
    assert (answer.code, answer.out) == (2, "")
    assert answer.err.startswith("turtlelog: error: none: no recordings in this folder")
    assert answer.err.count("\n") == 1


def test_a_table_of_metrics_grows_by_what_is_new(call: Call, folder: Path) -> None:
    words = ("metrics", "runs", "-o", "runs/t.parquet")
    answer = call(*words)
    assert answer.code == 2
    assert answer.out == "wrote runs/t.parquet: 4 files, 4 read, 0 unchanged, 1 cannot be read\n"
    assert "error: cut.mcap: " in answer.err
    shutil.copy(folder / "a.mcap", folder / "cut.mcap")
    answer = call(*words, "--json")
    assert (answer.code, answer.err) == (0, "")
    assert answer.json == {
        "output": "runs/t.parquet", "files": 4, "read": 1, "unchanged": 3, "failed": 0
    }  # fmt: skip
    files = read_result_table(folder / "t.parquet", kind="metrics", columns=["file"]).columns[0]
    assert files.cells == ["a.mcap", "b.mcap", "cut.mcap", "deep/c.mcap"]


def test_of_many_damaged_files_ten_are_named(call: Call, folder: Path) -> None:
    for number in range(11):
        (folder / f"empty{number}.mcap").touch()
    answer = call("metrics", "runs", "-o", "t.parquet")
    assert len(answer.err.splitlines()) == 11
    assert answer.err.endswith("2 more cannot be read: see the column error of t.parquet\n")


def test_other_settings_are_said_and_measured_anew(call: Call, folder: Path) -> None:
    words = ("metrics", "runs/a.mcap", "-o", "t.parquet")
    call(*words)
    answer = call(*words, "--band", "0.05")
    assert "1 read, 0 unchanged" in answer.out
    expected = "it was made with another choice of settings"
    assert answer.err == f"t.parquet: every file is read, because {expected}\n"


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (("-o", "t.csv"), "t.csv: the name must end in .parquet"),
        (("-o", "t.parquet", "--csv"), "--output: takes --json, no other format"),
        (("-o", "no/t.parquet"), "there is no such folder to write to"),
        (("-o", "spec.toml"), "the name must end in .parquet"),
        (("-o", "mine.parquet"), "mine.parquet: expected a complete Parquet file, found"),
    ],
)
def test_a_table_that_cannot_be_is_one_line(
    call: Call, folder: Path, more: tuple[str, ...], message: str
) -> None:
    Path("mine.parquet").write_text("my thesis")
    answer = call("metrics", "runs", *more)
    assert (answer.code, answer.out) == (2, "")
    assert message in answer.err
    assert answer.err.count("\n") == 1
    assert Path("mine.parquet").read_text() == "my thesis"


def test_check_judges_a_folder_and_a_damaged_file_fails(call: Call, folder: Path) -> None:
    answer = call("check", "spec.toml", "runs", "--json")
    found = {Path(one["file"]).name: one["verdict"] for one in answer.json["results"]}
    assert answer.code == 1
    assert found == {"a.mcap": "PASS", "b.mcap": "PASS", "cut.mcap": "FAIL", "c.mcap": "FAIL"}


@pytest.mark.parametrize("kind", [(), ("--json",), ("--csv",), ("--markdown",)])
def test_a_table_of_verdicts_answers_as_the_files_do(
    call: Call, folder: Path, kind: tuple[str, ...]
) -> None:
    words = ("check", "spec.toml", "runs")
    anew = call(*words, *kind)
    first, second = (call(*words, *kind, "-o", "v.parquet") for _ in range(2))
    assert first.out == second.out == anew.out
    assert first.code == second.code == anew.code == 1
    assert "4 read, 0 unchanged" in first.err
    assert "0 read, 4 unchanged" in second.err


def test_another_specification_judges_anew(call: Call, folder: Path) -> None:
    words = ("check", "spec.toml", "runs/a.mcap", "-o", "v.parquet")
    assert call(*words).code == 0
    Path("spec.toml").write_text(SPEC.replace("< 1", "< 0.1"))
    answer = call(*words)
    assert answer.code == 1
    assert "another choice of specification" in answer.err


def test_another_reference_judges_anew(call: Call, folder: Path) -> None:
    spec = 'format = 1\nreference = "good.mcap"\n[signals.heading]\n'
    spec += 'abs = 1e-9\nreason = "the same motion"\n'
    Path("spec.toml").write_text(spec)
    shutil.copy("runs/a.mcap", "good.mcap")
    words = ("check", "spec.toml", "runs/a.mcap", "-o", "v.parquet")
    assert call(*words).code == 0
    slow = tl.override_scenario(tl.load_scenario("textbook"), {"law.kp_angular": 0.1})
    tl.write_recording(tl.simulate_run(slow), "good.mcap")
    answer = call(*words)
    assert answer.code == 1
    assert "another choice of reference" in answer.err


@pytest.mark.parametrize("option", ["--junit", "--report", "--artifacts"])
def test_what_needs_the_runs_stands_without_a_table(call: Call, folder: Path, option: str) -> None:
    target = {"--junit": "x.xml", "--report": "x.html", "--artifacts": "x"}[option]
    answer = call("check", "spec.toml", "runs", "-o", "v.parquet", option, target)
    assert answer.code == 2
    assert f"{option}: leave out --output" in answer.err


@pytest.mark.parametrize("count", [20, 21])
def test_of_more_than_twenty_recordings_checks_are_counted(
    call: Call, folder: Path, count: int
) -> None:
    for number in range(count - 4):
        os.link(folder / "a.mcap", folder / f"more{number}.mcap")
    out = call("check", "spec.toml", "runs").out
    assert "PASS  FAIL  unit" in out
    assert ("more0.mcap" in call("check", "spec.toml", "runs", "--all").out) == (count <= 20)
    assert "runs/cut.mcap: recording: " in out
    first = f"FAIL: {count} recordings: 2 of {count} checks fail"
    assert out.splitlines()[0] == f"{first}, 1 of them without a value"


@pytest.mark.parametrize(("failing", "more"), [(40, 0), (41, 1)])
def test_of_many_failures_a_screen_is_shown(
    call: Call, folder: Path, failing: int, more: int
) -> None:
    for number in range(failing - 2):
        os.link(folder / "deep" / "c.mcap", folder / f"long{number:02}.mcap")
    out = call("check", "spec.toml", "runs").out
    assert out.count("FAIL runs/") == 40
    assert ("1 more failures are not shown: --csv and --json show" in out) == bool(more)


def test_without_pyarrow_folders_are_checked_and_a_table_is_refused_in_one_line(
    call: Call, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("pyarrow", "pyarrow.parquet"):
        monkeypatch.setitem(__import__("sys").modules, name, None)
    assert call("check", "spec.toml", "runs").code == 1
    answer = call("metrics", "runs", "-o", "t.parquet")
    assert (answer.code, answer.out) == (2, "")
    assert "pyarrow" in answer.err
    assert answer.err.count("\n") == 1
