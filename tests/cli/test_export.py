import csv
import sys
from pathlib import Path

import pytest

import turtlelog as tl
from tests.cli.conftest import Call


def test_export_writes_a_bag_that_metrics_reads_back(call: Call, kp4: Path, tmp_path: Path) -> None:
    answer = call("export", kp4, "--rosbag2", tmp_path / "bag")
    assert (answer.code, answer.err) == (0, "")
    assert answer.out.splitlines() == [
        f"wrote {tmp_path / 'bag' / name}" for name in ("bag_0.mcap", "metadata.yaml")
    ]
    (of_bag,), (of_file,) = (
        call("metrics", path, "--json").json for path in (tmp_path / "bag", kp4)
    )
    assert of_bag["metrics"] == of_file["metrics"]


def test_export_writes_several_kinds_and_answers_in_json(
    call: Call, kp4: Path, tmp_path: Path
) -> None:
    one, many = tmp_path / "events.csv", tmp_path / "tables"
    words = ("--csv", one, "--parquet", many, "--table", "events", "--json")
    answer = call("export", kp4, *words).json
    assert (answer["file"], answer["name"]) == (str(kp4), "paper-kp4")
    assert answer["written"] == [str(one), str(many / "events.parquet")]
    assert all(Path(path).exists() for path in answer["written"])


def test_export_writes_every_table_into_a_folder(call: Call, kp4: Path, tmp_path: Path) -> None:
    assert call("export", kp4, "--csv", tmp_path / "out").code == 0
    with (tmp_path / "out" / "samples.csv").open() as stream:
        assert len([*csv.reader(stream)]) == 1 + len(tl.read_recording(kp4).samples)


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["run.mcap"], "expected --rosbag2, --csv or --parquet, found none"),
        (["run.mcap", "--rosbag2", "a", "--table", "poses"], "--table: expected together with"),
        (["run.mcap", "--csv", "run.mcap"], "expected the name of a new folder, found a name that"),
        (["in.csv", "--csv", "in.csv"], "expected another file to write to, found the input"),
        (["run.mcap", "--rosbag2", "full"], "full: expected the name of a new folder, found a"),
        (["run.mcap", "--csv", "no/such/a.csv"], "expected a place that can be written"),
        (["run.mcap", "--csv", "a.csv", "--table", "pose"], "pose"),
        (["none.mcap", "--csv", "a.csv"], "none.mcap: expected a recording"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_bad_exports_are_one_line(
    call: Call,
    kp4: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    words: list[str],
    line: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("run.mcap").write_bytes(kp4.read_bytes())
    Path("in.csv").touch()
    Path("full").mkdir()
    Path("full", "mine").touch()
    answer = call("export", *words)
    assert (answer.code, answer.out) == (2, "")
    assert line in answer.err
    assert answer.err.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["full", "in.csv", "run.mcap"]


@pytest.mark.skipif(sys.platform == "win32", reason="links need a privilege there")
def test_a_link_that_leads_in_a_circle_is_no_new_folder(
    call: Call, kp4: Path, tmp_path: Path
) -> None:
    circle = tmp_path / "circle"
    circle.symlink_to(circle)
    answer = call("export", kp4, "--rosbag2", circle)
    assert (answer.code, answer.out) == (2, "")
    assert answer.err.endswith(": expected the name of a new folder, found a file\n")
