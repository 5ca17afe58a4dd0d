"""Names that could steer a terminal, through every command."""

import csv
import io
import json
import sys
import unicodedata
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as Xml

import pytest

import turtlelog as tl
from tests.cli.conftest import Call
from turtlelog.run import Event

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="has no such names of files")

STEER = "\nFAKE\x1b[31m\u202e\u2066\t\x85|`<b>b< b>\x9b\u2028_*"
RUN = "=cmd()|`<b>*_#"
"""What a run may be called: printable."""


def make_run(kp: int) -> tl.Run:
    run = tl.simulate_run(tl.load_scenario(f"paper-kp{kp}"))
    said = Event(time_ns=0, kind="wall", text=f"said{STEER}")
    return replace(
        run,
        name=f"{RUN}{kp}",
        source=f"source{STEER}",
        stop_reason=f"why{STEER}",
        notes={f"note{STEER}": f"value{STEER}"},
        events=(said, *run.events),
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("names")
    for kp in (4, 10):
        tl.write_recording(make_run(kp), folder / f"{kp}{STEER}.mcap")
    data = (folder / f"4{STEER}.mcap").read_bytes()
    (folder / f"cut{STEER}.mcap").write_bytes(data[: len(data) // 2])
    (folder / f"junk{STEER}.mcap").write_bytes(b"junk")
    checks = (
        f"[checks.{json.dumps('name' + STEER)}]\nexpect = 'run.duration <= 1'\n"
        f"reason = {json.dumps('reason' + STEER)}\n"
        "[checks.track]\nholds = 'always(abs(cross_track) <= 0.0001)'\n"
    )
    (folder / f"spec{STEER}.toml").write_text(f"format = 1\n{checks}", encoding="utf-8")
    return folder


COMMANDS = [
    *("info 4 10", "info cut --partial", "info junk", "info none", "metrics 4", "metrics 4 10"),
    *("metrics 4 10 --markdown", "metrics 4 10 --latex", "metrics cut", "metrics cut --partial"),
    *("metrics 4 4 4 4 4 4 10", "metrics 4 --metric OUT", "metrics 4 --reference-path junk"),
    *("compare 4 10", "compare 4 10 --markdown", "compare --reference 4 10"),
    "compare 4 10 --sort OUT",
    *("check spec 4 10 --junit OUT.xml", "check spec junk", "check junk 4", "check --init 4"),
    *("replay 4", "replay 4 --law", "replay 4 --plant", "replay 4 --set law.kp_linear=3"),
    *("replay 4 -o OUT.mcap", "explain 4 --causes queue", "export 4 --csv OUT"),
    "view 4 --save OUT.rrd",
    *(
        "convert --recover cut -o OUT.mcap",
        "convert --recover junk -o OUT.mcap",
        "import junk -o OUT.mcap",
        "run junk",
    ),
    *("plot 4 --only heading --format svg -o OUT", "run OUT", "scenario --set OUT=1"),
    *("OUT", "run --OUT"),
    "export 4 --csv no/OUT.csv",
]


def list_hidden(text: str) -> list[str]:
    categories = {"Cc", "Cf", "Cs", "Zl", "Zp"}
    return [c for c in text if c != "\n" and unicodedata.category(c) in categories]


@pytest.mark.parametrize("words", COMMANDS)
def test_no_name_steers_the_terminal_or_begins_a_line(
    words: str, call: Call, folder: Path, tmp_path: Path
) -> None:
    places = {
        name: folder / f"{name}{STEER}.{'toml' if name == 'spec' else 'mcap'}"
        for name in ("4", "10", "cut", "junk", "none", "spec")
    }
    command = [
        str(places.get(word, word.replace("OUT", f"{tmp_path}/out{STEER}")))
        for word in words.split()
    ]
    answer = call(*command)
    assert answer.code in {0, 1, 2}
    for text in (answer.out, answer.err):
        assert list_hidden(text) == []
        assert [line for line in text.split("\n") if line.startswith("FAKE")] == []
    if answer.code == 2:
        assert [line.count("turtlelog: error: ") for line in answer.err.split("\n")][-2:] == [1, 0]


def test_csv_gives_every_name_back(call: Call, folder: Path) -> None:
    path = folder / f"4{STEER}.mcap"
    head, row = csv.reader(io.StringIO(call("metrics", path, "--csv").out, newline=""))
    assert head[:2] == ["file", "run"]
    assert row[:2] == [str(path), f"'{RUN}4"]  # no formula of a spreadsheet
    assert min(float(cell) for cell in row[2:] if cell[:1] in set("-0123456789")) < 0.0
    across = call("compare", path, path.with_name(f"10{STEER}.mcap"), "--csv").out
    assert [row[0] for row in csv.reader(io.StringIO(across, newline=""))] == [
        "run",
        f"'{RUN}4",
        f"'{RUN}10",
    ]


def test_exported_events_give_their_text_back(call: Call, folder: Path, tmp_path: Path) -> None:
    target = tmp_path / "events.csv"
    call("convert", folder / f"4{STEER}.mcap", "-o", target, "--table", "events")
    with target.open(encoding="utf-8", newline="") as stream:
        assert any(f"said{STEER}" in row for row in csv.reader(stream))


def test_junit_holds_names_as_text(call: Call, folder: Path, tmp_path: Path) -> None:
    spec, path = folder / f"spec{STEER}.toml", folder / f"4{STEER}.mcap"
    call("check", spec, path, "--junit", tmp_path / "report.xml")
    text = (tmp_path / "report.xml").read_text(encoding="utf-8")
    assert list_hidden(text) == []
    case = Xml.fromstring(text).find("testsuite/testcase")
    assert case is not None
    assert "|`<b>b< b>" in (case.get("name") or "")
