import os
import sys
from pathlib import Path

import pytest

from turtlelog.errors import LogError
from turtlelog.sweep import find_recordings


def touch(*paths: Path) -> None:
    for path in paths:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()


def list_labels(*paths: Path) -> list[str]:
    return [one.label for one in find_recordings(paths)]


def test_folders_are_walked_in_order_of_names(tmp_path: Path) -> None:
    touch(tmp_path / "b.mcap", tmp_path / "a" / "z.db3", tmp_path / "a" / "b" / "c.tum")
    touch(tmp_path / "a.mcap")
    assert list_labels(tmp_path) == ["a/b/c.tum", "a/z.db3", "a.mcap", "b.mcap"]


@pytest.mark.parametrize("name", ["notes.txt", "plot.png", ".x.mcap", "x.mcap.partial", "mcap"])
def test_other_files_are_no_recordings(tmp_path: Path, name: str) -> None:
    touch(tmp_path / name, tmp_path / "run.mcap")
    assert list_labels(tmp_path) == ["run.mcap"]


@pytest.mark.parametrize("name", ["run.MCAP", "a.mcap.zstd", "b.db3", "log.csv", "log.json"])
def test_endings_that_readers_know_count(tmp_path: Path, name: str) -> None:
    touch(tmp_path / name)
    assert list_labels(tmp_path) == [name]


@pytest.mark.parametrize(
    ("head", "counts"),
    [
        ("run,Kp [1/s],tau [s]", False),
        ("file,run,rotate.duration [s]", False),
        ("verdict,file,check,unit", False),
        ("run,time_s,x_m,y_m,heading_rad", True),
    ],
)
def test_tables_of_runs_are_no_recordings(tmp_path: Path, head: str, *, counts: bool) -> None:
    (tmp_path / "table.csv").write_text(f"{head}\n")
    touch(tmp_path / "run.mcap")
    assert ("table.csv" in list_labels(tmp_path)) == counts


@pytest.mark.parametrize("folder", [".git", "__pycache__"])
def test_hidden_folders_are_left_out(tmp_path: Path, folder: str) -> None:
    touch(tmp_path / folder / "x.mcap", tmp_path / "run.mcap")
    assert list_labels(tmp_path) == ["run.mcap"]


def test_a_bag_is_one_recording_and_a_folder_named_like_a_file_is_walked(tmp_path: Path) -> None:
    touch(tmp_path / "bag" / "bag_0.mcap", tmp_path / "x.mcap" / "y.mcap")
    (tmp_path / "bag" / "metadata.yaml").write_text("rosbag2_bagfile_information:\n")
    assert list_labels(tmp_path) == ["bag", "x.mcap/y.mcap"]


def test_a_description_of_something_else_makes_no_bag(tmp_path: Path) -> None:
    touch(tmp_path / "set" / "deep" / "y.mcap")
    (tmp_path / "set" / "metadata.yaml").write_text("licence: MIT\n")
    assert list_labels(tmp_path) == ["set/deep/y.mcap"]


def test_tables_of_one_run_are_one_recording(tmp_path: Path) -> None:
    touch(tmp_path / "run" / "poses.csv", tmp_path / "run" / "samples.csv")
    assert list_labels(tmp_path) == ["run"]


def test_links_that_lead_in_circles_end(tmp_path: Path) -> None:
    touch(tmp_path / "a" / "run.mcap")
    (tmp_path / "a" / "up").symlink_to(tmp_path, target_is_directory=True)
    (tmp_path / "a" / "self").symlink_to(tmp_path / "a" / "self")
    (tmp_path / "0").symlink_to(tmp_path / "a", target_is_directory=True)
    assert list_labels(tmp_path) == ["a/run.mcap"]


def test_a_link_out_of_the_folder_is_followed_once(tmp_path: Path) -> None:
    touch(tmp_path / "data" / "run.mcap", tmp_path / "given" / "own.mcap")
    for name in ("first", "second"):
        (tmp_path / "given" / name).symlink_to(tmp_path / "data", target_is_directory=True)
    assert list_labels(tmp_path / "given") == ["first/run.mcap", "own.mcap"]


def test_what_is_given_twice_counts_once(tmp_path: Path) -> None:
    touch(tmp_path / "a" / "x.mcap", tmp_path / "y.mcap")
    found = find_recordings([tmp_path, tmp_path / "a", tmp_path / "y.mcap", tmp_path])
    assert [Path(one.path) for one in found] == [tmp_path / "a" / "x.mcap", tmp_path / "y.mcap"]


def test_of_two_folders_labels_say_which(tmp_path: Path) -> None:
    touch(tmp_path / "a" / "x.mcap", tmp_path / "b" / "x.mcap")
    folders = tmp_path / "a", tmp_path / "b"
    assert list_labels(*folders) == [(folder / "x.mcap").as_posix() for folder in folders]


def test_a_folder_without_recordings_is_refused(tmp_path: Path) -> None:
    touch(tmp_path / "full" / "x.mcap", tmp_path / "empty" / "notes.txt")
    with pytest.raises(LogError, match=r"empty: no recordings in this folder"):
        find_recordings([tmp_path / "full", tmp_path / "empty"])


@pytest.mark.skipif(sys.platform != "linux", reason="names of any bytes")
def test_names_of_any_bytes_have_labels_of_their_own(tmp_path: Path) -> None:
    for name in (b"\xff.mcap", b"\\udcff.mcap", b"a\nb.mcap"):
        (tmp_path / os.fsdecode(name)).touch()
    labels = list_labels(tmp_path)
    assert set(labels) == {"\\udcff.mcap", "\\udcff.mcap (2)", "a\nb.mcap"}
