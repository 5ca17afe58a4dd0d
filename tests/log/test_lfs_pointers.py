"""Files without content, a pointer of Git LFS or zeros, are called that, whoever reads them."""

from pathlib import Path

import pytest

import turtlelog as tl
from tests.cli.conftest import Call, call as call
from tests.files.range_server import RangeServer
from tests.log.ros2.bags import write_metadata
from turtlelog.errors import LogError

POINTER = (
    b"version https://git-lfs.github.com/spec/v1\n"
    b"oid sha256:4d7a214614ab2935c943f9e0ff69d22eadbb8f32b1258daaa5e2ca24d17e2393\nsize 12345\n"
)
TOLD = "this is a Git LFS pointer, not the file: git lfs pull"


@pytest.mark.parametrize(
    "name",
    [
        *("a.mcap", "a.db3", "a.mcap.zstd", "a.db3.zstd", "a.bag", "a.log"),
        *("a.csv", "a.parquet", "a.json", "a.tum", "a.tsv", "a.txt"),
    ],
)
def test_every_reader_names_a_pointer(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(POINTER)
    for read in (tl.read_run, tl.log.read_file_info, tl.read_recording, tl.read_columns):
        with pytest.raises(LogError) as error:
            read(path)
        assert str(error.value) == f"{path}: {TOLD}"


@pytest.mark.parametrize("name", ["a.mcap", "a.db3"])
def test_the_pointer_in_a_folder_is_named(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(POINTER)
    bag = write_metadata(tmp_path, [name])
    for read in (tl.read_run, tl.log.read_file_info):
        with pytest.raises(LogError, match=f"{name}: {TOLD}$"):
            read(bag)


def test_a_pointer_behind_a_url_is_named() -> None:
    with RangeServer(files={"a.mcap": POINTER}) as server, pytest.raises(LogError) as error:
        tl.read_run(server.url("a.mcap"))
    assert str(error.value) == f"{server.url('a.mcap')}: {TOLD}"


@pytest.mark.parametrize(("size", "is_pointer"), [(1023, True), (1024, False)])
def test_what_is_larger_than_a_pointer_may_be_is_none(
    size: int, tmp_path: Path, *, is_pointer: bool
) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(POINTER.ljust(size, b" "))
    with pytest.raises(LogError) as error:
        tl.read_run(path)
    assert (TOLD in str(error.value)) == is_pointer


@pytest.mark.parametrize(
    "words",
    [
        *(["info"], ["metrics"], ["explain"], ["identify"], ["replay"], ["view"]),
        *(["plot", "-o", "out.pdf"], ["report", "-o", "out.html"], ["convert", "-o", "out.csv"]),
        *(["convert", "--recover", "-o", "out.mcap"], ["compare", "--reference", "other.mcap"]),
    ],
    ids=" ".join,
)
def test_every_command_names_a_pointer(
    words: list[str], call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("a.mcap", "a.parquet", "other.mcap"):
        Path(name).write_bytes(POINTER)
    for name in ("a.mcap", "a.parquet") if words[0] == "plot" else ("a.mcap",):
        answer = call(*words, name)
        assert (answer.code, answer.out) == (2, "")
        assert TOLD in answer.err


@pytest.mark.parametrize("words", [["run"], ["scenario"]], ids=" ".join)
def test_a_file_of_settings_that_is_a_pointer_is_called_that(
    words: list[str], call: Call, tmp_path: Path
) -> None:
    path = tmp_path / "a.toml"
    path.write_bytes(POINTER)
    answer = call(*words, path)
    assert (answer.code, answer.out) == (2, "")
    assert "found: a Git LFS pointer, not the file: git lfs pull" in answer.err


def test_a_folder_of_recordings_names_its_pointers(call: Call, tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    bag.mkdir()
    for name in ("metadata.yaml", "bag_0.db3"):
        (bag / name).write_bytes(POINTER)
    (tmp_path / "a.mcap").write_bytes(POINTER)
    answer = call("metrics", tmp_path, "-o", tmp_path / "table.parquet")
    assert answer.code == 2
    assert answer.err.count(TOLD) == 2


@pytest.mark.parametrize("name", ["a.mcap", "a.db3", "a.bag", "a.csv", "a.json", "a.parquet", "a"])
@pytest.mark.parametrize("size", [1, 2**20 + 17])
def test_a_file_of_zeros_is_told_plainly(tmp_path: Path, name: str, size: int) -> None:
    path = tmp_path / name
    path.write_bytes(bytes(size))
    with pytest.raises(LogError) as caught:
        tl.read_run(path)
    assert str(caught.value) == f"{path}: only zero bytes; copy the file again from its source"


def test_a_file_that_begins_with_zeros_is_told_without_their_digits(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(bytes(2**20) + b"1")
    with pytest.raises(LogError, match=r"not an MCAP file: it begins with zero bytes$"):
        tl.read_run(path)
