import os
import subprocess
import sys
from collections.abc import Iterator
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
FOLDER = "this is a folder; name a file to write"
FILES = "convert writes .mcap, .csv, .parquet and .tum files, or a folder, not"
INPUT = "this is the input; name another file to write"
RUN = ("run", "paper", "--realtime")  # would take 20 s before it failed
TARGETS = [
    ([*RUN, "--rrd", "a.mcap"], "a.mcap: the name must end in .rrd"),
    ([*RUN, "--rrd", "no/a.rrd"], "no/a.rrd: there is no such folder to write to; create it first"),
    ([*RUN, "--rrd", "folder.rrd"], f"folder.rrd: {FOLDER}"),
    ([*RUN, "--rrd", f"{LONG}.rrd"], f"{LONG}.rrd: cannot be written: "),
    ([*RUN, "-o", "folder.mcap"], f"folder.mcap: {FOLDER}"),
    (["convert", "run.mcap", "-o", "run.mcap"], f"run.mcap: {INPUT}"),
    (["convert", ".", "-o", "folder.mcap"], f"folder.mcap: {FOLDER}"),
    (["convert", "--recover", "run.mcap", "-o", "folder.mcap"], f"folder.mcap: {FOLDER}"),
    (["convert", "--recover", "run.mcap", "-o", "run.mcap"], f"run.mcap: {INPUT}"),
    (["convert", "--recover", "run.mcap", "-o", "full/../run.mcap"], f"full/../run.mcap: {INPUT}"),
    (["compare", "run.mcap", "run.mcap", "--rrd", "folder.rrd"], f"folder.rrd: {FOLDER}"),
    (["view", "run.mcap", "--snapshot", "folder.png"], f"folder.png: {FOLDER}"),
    (["view", "run.mcap", "--save", f"{LONG}.rrd"], f"{LONG}.rrd: cannot be written: "),
    (["convert", "run.mcap", "-o", "folder.csv"], f"folder.csv: {FOLDER}"),
    (
        ["convert", "run.mcap", "-o", "bag.db3"],
        f"bag.db3: {FILES} .db3",
    ),
    (
        ["convert", "run.mcap", "-o", "view.rrd"],
        f"view.rrd: {FILES} .rrd",
    ),
    (
        ["convert", "run.mcap", "-o", "run.xyz"],
        f"run.xyz: {FILES} .xyz",
    ),
    (
        ["convert", "run.mcap", "-o", "run.txt"],
        f"run.txt: {FILES} .txt",
    ),
    (
        ["convert", "run.mcap", "-o", "run.mcap.gz"],
        f"run.mcap.gz: {FILES} .gz",
    ),
    (
        ["plot", "run.mcap", "-o", "run.bmp"],
        "run.bmp: figures are written as .pdf, .png or .svg, or to a folder, not as .bmp",
    ),
    (
        ["convert", "run.mcap", "-o", "a", "-o", "full"],
        "full: this folder has files; name a new one",
    ),
    (
        ["convert", "run.mcap", "-o", "a", "-o", "no/a.csv"],
        "no/a.csv: there is no such folder to write to",
    ),
    (
        ["convert", "run.mcap", "-o", "a", "-o", "full/mine"],
        "full/mine: this is a file; name a new folder",
    ),
    (
        ["convert", "run.mcap", "-o", "a.csv", "-o", "full/../a.csv"],
        "full/../a.csv: another output is written there; name another place",
    ),
    (["convert", "run.mcap", "-o", "a.csv", "-o", LONG], f"{LONG}: cannot be written: "),
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
    monkeypatch.setattr("turtlelog.simulate.collect.run_live", fail)
    answer = call(*words)
    assert (answer.code, answer.out) == (2, "")
    assert line in answer.err
    assert answer.err.count("\n") == 1
    assert sorted(map(str, folder.rglob("*"))) == before


@pytest.mark.parametrize(
    ("mode", "reason"),
    [("folder", "cannot be written: Permission denied"), ("file", "this file is write-protected")],
)
def test_what_is_write_protected_stays(call: Call, folder: Path, mode: str, reason: str) -> None:
    target = folder / "full" / "mine.mcap"
    target.write_bytes(b"mine")
    protected = target if mode == "file" else target.parent
    protected.chmod(0o555)
    if os.access(protected, os.W_OK):
        pytest.skip("who may do all is refused nothing")
    answer = call("convert", "--recover", "run.mcap", "-o", target)
    target.parent.chmod(0o755)
    assert answer.code == 2
    assert f"{target}: {reason}" in answer.err
    assert target.read_bytes() == b"mine"


def test_an_input_may_be_named_through_a_link(call: Call, folder: Path) -> None:
    Path("link.mcap").hardlink_to("run.mcap")
    answer = call("convert", "--recover", "run.mcap", "-o", "link.mcap")
    assert (answer.code, answer.out) == (2, "")
    assert f"link.mcap: {INPUT}" in answer.err


def test_an_empty_folder_and_a_dotted_one_are_taken(call: Call, folder: Path) -> None:
    Path("empty").mkdir()
    answer = call("convert", "run.mcap", "--format", "csv", "-o", "empty", "-o", "kp4.5")
    assert answer.code == 0
    assert Path("kp4.5", "poses.csv").is_file()


@pytest.fixture
def little_room() -> Iterator[None]:
    """A system on which no file takes more than 4,000 bytes."""
    resource = pytest.importorskip("resource")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4_000, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


def list_files(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


@pytest.mark.parametrize("form", ["pdf", "png", "svg"])
@pytest.mark.usefixtures("little_room")
def test_a_figure_that_does_not_fit_is_one_line_and_nothing_is_left(
    form: str, call: Call, tmp_path: Path
) -> None:
    target = tmp_path / "new" / "figures"
    answer = call("plot", "-o", target, "--only", "plant", "--format", form)
    found = "cannot be written: File too large"
    assert (answer.code, answer.out) == (2, "")
    assert answer.err == f"turtlelog: error: {target / 'plant'}.{form}: {found}\n"
    assert list_files(tmp_path) == []


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 160 kB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=160k", "tmpfs", str(folder)]
    try:
        subprocess.run(command, check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError) as err:
        pytest.skip(f"no file system can be mounted here: {err}")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


@pytest.mark.thorough
def test_of_several_figures_none_stands_where_the_disk_is_full(
    call: Call, kp4: Path, small_disk: Path
) -> None:
    """Three figures are drawn in three formats until the disk is full."""
    folder = small_disk / "figures"
    folder.mkdir()
    (folder / "heading.pdf").write_text("the old one")
    words = ("--only", "heading,plane,panel", "--format", "pdf,png,svg")
    answer = call("plot", kp4, "-o", folder, *words)
    assert (answer.code, answer.out, answer.err.count("\n")) == (2, "", 1)
    assert "cannot be written: No space left on device" in answer.err
    assert list_files(small_disk) == ["figures", "figures/heading.pdf"]
    assert (folder / "heading.pdf").read_text() == "the old one"


def test_a_full_disk_tells_what_stands_of_several_outputs(
    call: Call, kp4: Path, small_disk: Path
) -> None:
    bag, csv = small_disk / "bag", small_disk / "samples.csv"
    answer = call("convert", kp4, "-o", bag, "-o", csv, "--table", "samples")
    stands, error = answer.err.splitlines()[:2], answer.err.splitlines()[2:]
    assert stands == [f"wrote {bag / 'bag_0.mcap'}", f"wrote {bag / 'metadata.yaml'}"]
    assert [line.partition(": cannot be")[0] for line in error] == [f"turtlelog: error: {csv}"]
    assert list_files(small_disk) == ["bag", "bag/bag_0.mcap", "bag/metadata.yaml"]


@pytest.mark.skipif(sys.platform == "win32", reason="links need a privilege there")
def test_an_output_through_a_link_is_written_where_it_leads(
    call: Call, kp4: Path, tmp_path: Path
) -> None:
    (tmp_path / "elsewhere").mkdir()
    for number, words in enumerate(
        [["convert", "--recover", kp4, "-o"], ["convert", kp4, "-o"], ["view", kp4, "--save"]]
    ):
        name = "a" + (".mcap", ".csv", ".rrd")[number]
        (tmp_path / name).symlink_to(Path("elsewhere", name))
        for _ in range(2):  # where nothing is yet, then over a file
            assert call(*words, tmp_path / name).code == 0
            assert (tmp_path / name).is_symlink()
        (tmp_path / "elsewhere" / name).chmod(0o600)
        call(*words, tmp_path / name)
        assert (tmp_path / "elsewhere" / name).stat().st_mode & 0o777 == 0o600
