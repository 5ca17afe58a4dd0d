import os
from pathlib import Path

import pytest

from tests.cli.conftest import Call


@pytest.fixture
def folder(kp4: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder that commands run in, with an input and things in the way."""
    monkeypatch.chdir(tmp_path)
    Path("run.mcap").write_bytes(kp4.read_bytes())
    for suffix in ("mcap", "rrd", "png", "csv"):
        Path(f"folder.{suffix}").mkdir()
    Path("full").mkdir()
    Path("full", "mine").touch()
    return tmp_path


LONG = "n" * 300
RUN = ("run", "paper", "--realtime")  # would take 20 s before it failed
TARGETS = [
    ([*RUN, "--rrd", "a.mcap"], "a.mcap: expected a name that ends in .rrd"),
    ([*RUN, "--rrd", "no/a.rrd"], "found no such folder"),
    ([*RUN, "--rrd", "folder.rrd"], "folder.rrd: expected the name of a file to write, found a"),
    ([*RUN, "--rrd", f"{LONG}.rrd"], "expected a place that can be written, found: "),
    ([*RUN, "-o", "folder.mcap"], "folder.mcap: expected the name of a file to write, found a"),
    (["import", "run.mcap"], "expected another file to write to, found the input itself"),
    (["import", "."], "expected the name of a log, found a folder"),
    (["recover", "run.mcap", "-o", "folder.mcap"], "found a folder"),
    (["recover", "run.mcap", "-o", "run.mcap"], "found the input itself"),
    (["recover", "run.mcap", "-o", "full/../run.mcap"], "found the input itself"),
    (["compare", "run.mcap", "run.mcap", "--rrd", "folder.rrd"], "found a folder"),
    (["view", "run.mcap", "--snapshot", "folder.png"], "found a folder"),
    (["view", "run.mcap", "--save", f"{LONG}.rrd"], "expected a place that can be written"),
    (["export", "run.mcap", "--csv", "folder.csv"], "found a folder"),
    (["export", "run.mcap", "--csv", "a.parquet"], "found a name that ends in .parquet"),
    (["export", "run.mcap", "--parquet", "a.csv"], "found a name that ends in .csv"),
    (["export", "run.mcap", "--rosbag2", "b.mcap"], "found a name that ends in .mcap"),
    (["export", "run.mcap", "--rosbag2", "a", "--csv", "full"], "found a folder with files"),
    (["export", "run.mcap", "--rosbag2", "a", "--csv", "no/a.csv"], "found no such folder"),
    (["export", "run.mcap", "--rosbag2", "a", "--parquet", "full/mine"], "found a file"),
    (["export", "run.mcap", "--csv", "a", "--parquet", "full/../a"], "that of another output"),
    (["export", "run.mcap", "--csv", "a", "--rosbag2", LONG], "can be written, found: "),
]


def fail(*words: object, **options: object) -> None:
    pytest.fail("work began")


@pytest.mark.parametrize(
    ("words", "line"),
    TARGETS,
    ids=lambda value: " ".join(value)[:60] if isinstance(value, list) else "",
)
def test_a_bad_target_is_refused_before_anything_is_done(
    call: Call, folder: Path, words: list[str], line: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = sorted(map(str, folder.rglob("*")))
    monkeypatch.setattr("turtlelog.log.any_file.read_run", fail)
    monkeypatch.setattr("turtlelog.run_live", fail)
    answer = call(*words)
    assert (answer.code, answer.out) == (2, "")
    assert line in answer.err
    assert answer.err.count("\n") == 1
    assert sorted(map(str, folder.rglob("*"))) == before


@pytest.mark.parametrize("mode", ["folder", "file"])
def test_what_is_write_protected_stays(call: Call, folder: Path, mode: str) -> None:
    target = folder / "full" / "mine.mcap"
    target.write_bytes(b"mine")
    protected = target if mode == "file" else target.parent
    protected.chmod(0o555)
    if os.access(protected, os.W_OK):
        pytest.skip("who may do all is refused nothing")
    answer = call("recover", "run.mcap", "-o", target)
    target.parent.chmod(0o755)
    assert answer.code == 2
    assert f"{target}: expected a" in answer.err
    assert target.read_bytes() == b"mine"


def test_an_input_may_be_named_through_a_link(call: Call, folder: Path) -> None:
    Path("link.mcap").hardlink_to("run.mcap")
    answer = call("recover", "run.mcap", "-o", "link.mcap")
    assert (answer.code, answer.out) == (2, "")
    assert "found the input itself" in answer.err


def test_an_empty_folder_and_a_dotted_one_are_taken(call: Call, folder: Path) -> None:
    Path("empty").mkdir()
    answer = call("export", "run.mcap", "--rosbag2", "empty", "--csv", "kp4.5")
    assert answer.code == 0
    assert Path("kp4.5", "poses.csv").is_file()
