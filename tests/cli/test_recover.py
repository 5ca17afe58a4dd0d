from pathlib import Path

import pytest

from tests.cli.conftest import Call
from tests.log.ros2.bags import make_poses, write_mcap


@pytest.fixture
def cut(kp4: Path, tmp_path: Path) -> Path:
    path = tmp_path / "cut.mcap"
    path.write_bytes(kp4.read_bytes()[:-3000])
    return path


@pytest.fixture
def headless(kp4: Path, tmp_path: Path) -> Path:
    """A recording that lacks its end: nothing says how many messages there were."""
    data = kp4.read_bytes()
    path = tmp_path / "headless.mcap"
    path.write_bytes(data[: data.rindex(b"\x0f\x04" + bytes(7))])
    return path


def test_recover_says_how_much_and_what_was_lost(call: Call, cut: Path, tmp_path: Path) -> None:
    answer = call("convert", "--recover", cut, "-o", tmp_path / "whole.mcap")
    assert (answer.code, answer.err) == (0, "")
    assert answer.out.startswith("whole.mcap: 2075 messages from 0.000 s to 11.264 s, from ")
    assert "messages from 0.000 s to 11.264 s" in answer.flat
    assert "no message is lost" in answer.flat
    assert "lost: bytes " in answer.flat
    assert "the summary is damaged or missing: no message is missing" in answer.flat


def test_recover_says_where_nobody_knows_what_was_lost(
    call: Call, headless: Path, tmp_path: Path
) -> None:
    answer = call("convert", "--recover", headless, "-o", tmp_path / "whole.mcap")
    assert (answer.code, answer.err) == (0, "")
    assert "messages lost: not known" in answer.flat
    assert "cut short, or not finished" in answer.flat


def test_recover_of_a_bag_without_checksums_agrees_with_info(call: Call, tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "bag.mcap", make_poses(20))
    path.write_bytes(path.read_bytes()[:-100])
    line = "no loss is found, only the summary is damaged"
    assert line in call("convert", "--recover", path, "-o", tmp_path / "whole.mcap").flat
    answer = call("info", path, "--partial")
    assert line in answer.flat
    assert "20 messages" in answer.flat
    assert call("metrics", path, "--partial").code == 0


def test_recover_answers_in_json(call: Call, cut: Path, tmp_path: Path) -> None:
    report = call("convert", "--recover", cut, "-o", tmp_path / "whole.mcap", "--json").json
    assert (report["file"], report["complete"]) == (str(cut), False)
    assert report["recovered"]["/turtle1/cmd_vel"] == 681
    assert (report["from_s"], report["to_s"], report["missing"]) == (0.0, 11.264, {})
    assert {"start", "end", "reason"} == set(report["lost"][0])
    assert call("metrics", tmp_path / "whole.mcap").code == 0


def test_recover_says_where_nothing_was_lost(call: Call, kp4: Path, tmp_path: Path) -> None:
    answer = call("convert", "--recover", kp4, "-o", tmp_path / "whole.mcap")
    assert answer.code == 0
    assert "nothing was lost: the file is complete and undamaged" in answer.flat


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["none.mcap", "-o", "out.mcap"], "none.mcap: no such file"),
        (
            ["zeros.mcap", "-o", "out.mcap"],
            "zeros.mcap: only zero bytes; copy the file again from its source",
        ),
        (
            ["cut.mcap", "-o", "cut.mcap"],
            "cut.mcap: this is the input; name another file to write",
        ),
        (["cut.mcap", "-o", "no/out.mcap"], "no/out.mcap: there is no such folder to write to"),
        (["cut.mcap"], "--output"),
    ],
)
def test_what_cannot_be_recovered_is_one_line(
    call: Call,
    cut: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    words: list[str],
    line: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("zeros.mcap").write_bytes(bytes(1000))
    answer = call("convert", "--recover", *words)
    assert (answer.code, answer.out) == (2, "")
    assert line in answer.err
    assert answer.err.count("\n") == 1


def test_a_name_that_is_no_recording_is_not_overwritten(call: Call, tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("precious")
    (tmp_path / "a.mcap").write_bytes(b"")
    answer = call("convert", "--recover", tmp_path / "a.mcap", "-o", tmp_path / "thesis.txt")
    assert answer.code == 2
    assert "thesis.txt: the name must end in .mcap" in answer.err
    assert (tmp_path / "thesis.txt").read_text() == "precious"


def test_a_recovered_recording_is_told_by_info_and_metrics(
    call: Call, headless: Path, tmp_path: Path
) -> None:
    whole = tmp_path / "whole.mcap"
    assert call("convert", "--recover", headless, "-o", whole).code == 0
    line = "recovered: from a damaged or unfinished file: the number of lost messages is unknown"
    answer = call("metrics", whole)
    assert (answer.code, answer.err.count("\n")) == (0, 1)
    assert answer.err.startswith(f"{whole}: {line} (byte ")
    assert "recovered   from a damaged or unfinished file: " in call("info", whole).out
    (told,) = call("info", whole, "--json").json
    assert told["notes"]["recovered"].startswith("from a damaged or unfinished file: ")


@pytest.mark.parametrize(
    "words",
    [
        ["metrics", "FILE"],
        ["compare", "FILE", "FILE"],
        ["convert", "FILE", "-o", "poses.csv"],
        ["view", "FILE", "--save", "run.rrd"],
        ["info", "FILE"],
    ],
)
def test_partial_reads_what_is_refused_otherwise(
    call: Call, kp4: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    data = kp4.read_bytes()
    Path("FILE").with_suffix(".mcap").write_bytes(data[:-100] + b"\xa5" + data[-99:])
    named = ["FILE.mcap" if word == "FILE" else word for word in words]
    refused = call(*named)
    assert (refused.code, refused.out) == (2, "")
    answer = call(*named, "--partial")
    assert answer.code == 0
    assert "no loss is found, only the summary is damaged" in (
        answer.out if words[0] == "info" else answer.err
    )
    assert "Warning" not in answer.err
