from pathlib import Path

import pytest
from mcap.writer import Writer
from rerun.chunk import RrdReader

import turtlelog as tl
from tests.cli.conftest import Call

SHARED = Path(__file__).parents[2].parent / "shared"


def test_info_says_what_a_recording_holds(call: Call, kp4: Path) -> None:
    answer = call("info", kp4)
    assert answer.code == 0
    assert "robot       turtlesim, simulated" in answer.out
    assert "ended       standstill" in answer.out
    assert "controller  sequential-p, Kp = 4 1/s" in answer.out


def test_info_answers_in_json(call: Call, kp4: Path, kp10: Path) -> None:
    first, second = call("info", kp4, kp10, "--json").json
    assert (first["file"], first["name"]) == (str(kp4), "paper-kp4")
    assert (first["format_version"], first["source"], first["complete"]) == (2, "simulation", True)
    assert (first["duration_s"], second["duration_s"]) == (11.264, 12.672)
    assert first["scenario"]["law"]["kp_linear"] == 4.0
    assert first["absent"] == []
    counts = {topic["topic"]: topic["count"] for topic in first["topics"]}
    assert counts["/turtle1/control"] == counts["/turtle1/cmd_vel"] == 681


def test_info_writes_a_limit_of_inf_as_null(call: Call, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    assert call("run", "textbook", "--set", "limits.speed_m_s=inf", "-o", path).code == 0
    assert call("info", path, "--json").json[0]["scenario"]["limits"]["speed_m_s"] is None


def test_info_lists_other_peoples_recordings(call: Call) -> None:
    paths = sorted((SHARED / "ros2").glob("*.mcap"))
    if not paths:
        pytest.skip(f"no recordings by others at {SHARED}")
    answers = call("info", *paths, "--json").json
    assert [answer["source"] for answer in answers] == ["mcap"] * len(paths)
    assert all(answer["topics"] and answer["scenario"] is None for answer in answers)


@pytest.mark.parametrize("words", [[], ["--json"]], ids=["text", "json"])
def test_info_goes_on_after_a_bad_file(call: Call, kp4: Path, words: list[str]) -> None:
    answer = call("info", "missing.mcap", kp4, "also-missing", *words)
    assert answer.code == 2
    assert answer.out == call("info", kp4, *words).out
    first, second = answer.err.splitlines()
    assert first.startswith("turtlelog: error: missing.mcap: no such file")
    assert second.startswith("turtlelog: error: also-missing: ")


@pytest.mark.parametrize(
    ("words", "advised"),
    [
        ("info KP4", "Next: turtlelog metrics KP4 --partial turtlelog explain KP4 --partial"),
        ("metrics KP10", "Why? turtlelog explain KP10 --partial"),
        ("compare KP4 KP10", "Why is paper-kp10 worse? turtlelog explain KP10 --partial"),
        ("compare KP4 --reference KP10", "turtlelog check --init KP10 --partial"),
        (
            "compare KP4 --reference KP10 --rpe 1m --align sim2",
            "turtlelog compare KP4 --reference KP10 --ate --rpe=1m --partial --align=sim2 --plot",
        ),
        (
            "check KP10 --expect final.position_error<0.01",
            "turtlelog explain KP10 --partial",
        ),
    ],
)
def test_advised_commands_repeat_the_given_options(
    words: str, advised: str, call: Call, kp4: Path, kp10: Path
) -> None:
    words, advised = (
        text.replace("KP4", str(kp4)).replace("KP10", str(kp10)) for text in (words, advised)
    )
    assert advised in call(*words.split(), "--partial").flat


def test_metrics_puts_runs_side_by_side(call: Call, kp4: Path, kp10: Path) -> None:
    answer = call("metrics", kp4, kp10, "--metric", "rotate.*")
    assert answer.code == 0
    rows = [line.split() for line in answer.out.splitlines()]
    assert ["metric", "unit", "paper-kp4", "paper-kp10"] in rows
    assert ["rotate.overshoot", "%", "0.066729", "1.0076"] in rows


def test_metrics_answers_in_json_with_null_where_there_is_no_value(
    call: Call, tmp_path: Path
) -> None:
    path = tmp_path / "cut.mcap"
    call("run", "paper-kp1", "--set", "max_duration_s=2.0", "-o", path)
    (answer,) = call("metrics", path, "--json").json
    metrics = {metric["id"]: metric for metric in answer["metrics"]}
    assert metrics["rotate.settling_time"]["value"] is None
    assert metrics["rotate.settling_time"]["status"] == "not_reached"
    assert metrics["run.duration"] == {
        "id": "run.duration",
        "value": 1.92,
        "unit": "s",
        "status": "ok",
        "reason": None,
        "at_s": None,
    }


def test_view_saves_one_run_and_several(call: Call, kp4: Path, kp10: Path, tmp_path: Path) -> None:
    assert call("view", kp4, "--save", tmp_path / "one.rrd").code == 0
    assert call("view", kp4, kp10, "--save", tmp_path / "two.rrd").code == 0
    one, two = (
        {chunk.entity_path for chunk in RrdReader(tmp_path / f"{name}.rrd").stream()}
        for name in ("one", "two")
    )
    assert "/plane/turtle" in one
    assert {f"/runs/paper-{name}/plane/turtle" for name in ("kp4", "kp10")} < two


def test_convert_and_metrics_take_the_papers_logs(call: Call, tmp_path: Path) -> None:
    log, path = SHARED / "paper" / "kp1_210.json", tmp_path / "kp1.mcap"
    if not log.exists():
        pytest.skip(f"the paper's logs are not at {SHARED}")
    answer = call("convert", log, "-o", path, "--json").json
    assert [*answer] == ["file", "name", "written", "absent", "notes"]
    assert (answer["file"], answer["written"]) == (str(log), [str(path)])
    assert len(tl.read_recording(path).samples) == 1265
    assert "samples.wanted_speed_m_s" in answer["absent"]
    (from_log,), (from_recording,) = (call("metrics", file, "--json").json for file in (log, path))
    assert from_log["metrics"] == from_recording["metrics"]


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["info", "missing.mcap"], "missing.mcap: no such file"),
        (["info", "zeros.mcap"], "zeros.mcap: only zero bytes; copy the file again"),
        (["info", "empty.mcap"], "empty.mcap: byte 0: not an MCAP file: it is empty"),
        (["metrics", "cut.mcap"], "no end of an MCAP file"),
        (["metrics", "folder"], "folder: no recordings in this folder"),
        (["metrics", "wrong.json"], "wrong.json: "),
        (["metrics"], "turtlelog metrics needs FILE. Usage: turtlelog metrics"),
        (["compare", "good.mcap"], "compare needs at least two runs, but 1 was given; add another"),
        (["compare", "missing.mcap"], "missing.mcap: no such file"),
        (["compare", "good.mcap", "zeros.mcap"], "zeros.mcap: only zero bytes"),
        (["convert", "good.mcap", "-o", "b.mcap", "--sort"], "good.mcap: expected a log in JSON"),
        (
            ["view", "good.mcap", "--at", "3"],
            "--at: needs --snapshot NAME.png",
        ),
        (["view", "a.rrd", "good.mcap"], "a.rrd: is a view already; name recordings, or"),
        (["view", "good.mcap", "--snapshot", "a.png", "--at", "nan"], "--at nan: must be seconds"),
        (["view", "good.mcap", "--save", "good.mcap"], "the name must end in .rrd"),
        (
            ["compare", "good.mcap", "good.mcap", "--rrd", "x.png"],
            "png: the name must end in .rrd",
        ),
        (
            ["convert", "wrong.json", "-o", "wrong.json"],
            "wrong.json: convert writes .mcap, .csv, .parquet and .tum files, or a folder",
        ),
        (
            ["convert", "json.mcap", "-o", "a.mcap"],
            "json.mcap: byte 0: not an MCAP file: it is text",
        ),
        (
            ["view", "good.mcap", "--save", "no/such/a.rrd"],
            "no/such/a.rrd: there is no such folder to write to",
        ),
        (["frobnicate"], 'turtlelog has no command "frobnicate"; all commands: turtlelog --help'),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_bad_input_is_one_line(
    call: Call,
    kp4: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    words: list[str],
    line: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("good.mcap").write_bytes(kp4.read_bytes())
    Path("cut.mcap").write_bytes(kp4.read_bytes()[:20_000])
    Path("zeros.mcap").write_bytes(bytes(1000))
    Path("empty.mcap").touch()
    Path("a.rrd").touch()
    Path("wrong.json").write_text("{")
    Path("json.mcap").write_text("{")
    Path("folder").mkdir()
    answer = call(*words)
    assert (answer.code, answer.out) == (2, "")
    assert line in answer.err
    assert answer.err.count("\n") == 1


@pytest.mark.parametrize("columns", [80, 100])
@pytest.mark.parametrize("command", ["metrics", "compare", "info"])
def test_tables_fit_the_terminal(
    call: Call,
    kp4: Path,
    kp10: Path,
    monkeypatch: pytest.MonkeyPatch,
    command: str,
    columns: int,
) -> None:
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", str(columns))
    answer = call(command, kp4, kp10, kp4, kp10)
    tables = [line for line in answer.out.splitlines() if not line.lstrip().startswith("/")]
    assert max(map(len, tables)) <= columns
    assert "kp4" in answer.out


def test_info_names_what_it_does_not_understand(call: Call, tmp_path: Path) -> None:
    path = tmp_path / "odd.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        schema = writer.register_schema("pkg/msg/Wide", "ros2msg", b"wstring text\n")
        writer.add_message(writer.register_channel("/wide", "cdr", schema), 0, b"\0\1\0\0", 0)
        writer.finish()  # type: ignore[no-untyped-call]
    reason = "/wide: schema pkg/Wide: wstring: ROS's middlewares do not agree on its bytes"
    assert f"not readable\n  {reason}\n" in call("info", path, "--topics").out
    (told,) = call("info", path, "--json").json
    assert told["not_understood"] == [reason]
