import re
import tomllib
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as Xml

import pytest

import turtlelog as tl
from tests.check.artifact_files import read_mark
from tests.cli.conftest import Call
from tests.sequential import METRICS
from turtlelog.check.reference import format_metrics

TOLERANCES = """format = 1
[signals.x]
abs = 0.001
time_s = 0.032
reason = "two ticks"
[metrics."final.position_error"]
abs = 0.5
reason = "close by"
"""


@pytest.fixture
def tolerances(tmp_path: Path) -> Path:
    path = tmp_path / "tolerances.toml"
    path.write_text(TOLERANCES, encoding="utf-8")
    return path


def test_what_passes_exits_with_0(call: Call, spec: Path, kp4: Path) -> None:
    answer = call("check", spec, kp4)
    assert answer.code == 0
    assert answer.out.splitlines()[0] == f"PASS: {kp4}: all 2 checks pass"


def test_what_fails_exits_with_1_and_says_where(call: Call, spec: Path, kp10: Path) -> None:
    answer = call("check", spec, kp10)
    assert answer.code == 1
    lines = answer.out.splitlines()
    (line,) = [line for line in lines if line.startswith("FAIL") and " 1.0076 " in line]
    assert " ".join(line.split()) == "FAIL overshoot % 1.0076 0.5 -0.50756 2.288"
    assert lines[0] == f"FAIL: {kp10}: 1 of 2 checks fails (overshoot, value 1.01 %), 1 is skipped"
    words = " ".join(answer.out.split())
    assert f"FAIL {kp10}: overshoot: expected rotate.overshoot <= 0.5 (half a" in words
    assert f"SKIPPED {kp10}: gains: only when law.kp_linear < 5; here" in words
    assert lines[-2:] == [
        f"Why? turtlelog explain {kp10}",
        "All checks with their margins: --all",
    ]


def test_a_failure_without_a_number_tells_its_time(call: Call, kp4: Path) -> None:
    until = "phase == 'rotate' until phase == 'translate'"
    answer = call("check", kp4, "--expect", until)
    assert answer.flat.startswith(f"FAIL: {kp4}: {until} fails, first violated at ")
    assert "its left side ends when its right side begins" in answer.flat
    words = ("--expect", until, "--expect", "rotate.decay_ratio < 9", "--expect", "law.kind == 'a'")
    assert " and 2 more), 1 of them without a value" in call("check", kp4, *words).flat


def test_a_pass_of_one_moment_says_so(call: Call, kp4: Path) -> None:
    told = "speed <= 0.5: judged at 0.000 s alone; always(...) asks of every time."
    words = ("check", kp4, "--expect", "run.duration > 0", "--expect")
    assert call(*words, "speed <= 0.5").flat.count(told) == 1
    assert call(*words, "speed <= 0.5", "--all").flat.count(told) == 1
    assert "judged" not in call(*words, "always(speed <= 1)").flat


def test_json_has_every_field(call: Call, spec: Path, kp4: Path, kp10: Path) -> None:
    answer = call("check", spec, kp4, kp10, "--json")
    assert answer.code == 1
    assert answer.json["verdict"] == "FAIL"
    assert [result["verdict"] for result in answer.json["results"]] == [
        *("PASS", "PASS"),
        *("FAIL", "SKIPPED"),
    ]
    failed = answer.json["results"][2]
    assert failed["file"] == str(kp10)
    assert failed["margin"] == failed["limit"] - failed["value"] < 0
    assert (failed["unit"], failed["first_violation_s"], failed["reason"]) == ("%", 2.288, None)


def test_a_run_within_its_tolerances_passes(call: Call, kp4: Path, tolerances: Path) -> None:
    answer = call("check", tolerances, kp4, "--reference", kp4, "--all")
    assert answer.code == 0
    assert answer.out.startswith(f"PASS: {kp4}: all 2 checks pass\nNearest to its limit: ")
    assert "\n\n      check " in answer.out
    assert "PASS  metrics.final.position_error" in answer.out


def test_a_run_outside_fails_with_value_limit_and_time(
    call: Call, kp4: Path, kp10: Path, tolerances: Path
) -> None:
    answer = call("check", tolerances, kp4, kp10, "--reference", kp4)
    assert answer.code == 1
    words = " ".join(answer.out.split())
    assert re.search(r"signals\.x: \S+ m where the reference has \S+ m at \S+ s", words)
    assert "s (two ticks) " in words
    first = "FAIL: 2 recordings: 1 of 4 checks fails (signals.x, value 0.165 m)"
    assert answer.out.startswith(f"{first}\n")
    assert f"Recordings in which checks fail, and how many: {kp10} (1)" in words


def test_verdicts_against_a_reference_stand_in_json(
    call: Call, kp4: Path, kp10: Path, tolerances: Path
) -> None:
    text = tolerances.read_text("utf-8").replace("= 1\n", '= 1\nalignment = "phase:translate"\n', 1)
    tolerances.write_text(text, encoding="utf-8")
    answer = call("check", tolerances, kp4, kp10, "--reference", kp4, "--json")
    assert (answer.code, answer.json["verdict"]) == (1, "FAIL")
    results = answer.json["results"]
    assert [result["verdict"] for result in results] == ["PASS", "PASS", "FAIL", "PASS"]
    assert [result["file"] for result in results] == [str(kp4)] * 2 + [str(kp10)] * 2
    x, error = results[2:]
    assert (x["check"], x["limit"]) == ("signals.x", 0.001)
    assert x["expected"] == "within 0.001 m of the reference within 0.032 s"
    assert x["first_violation_s"] <= x["value_s"]
    assert x["margin"] == pytest.approx(x["limit"] - x["value"])
    assert (error["decided"], error["limit"]) == (True, 0.5)


def test_junit_has_cases_and_every_metric(
    call: Call, spec: Path, kp4: Path, kp10: Path, tmp_path: Path
) -> None:
    target = tmp_path / "report.xml"
    assert call("check", spec, kp4, kp10, "--junit", target).code == 1
    root = Xml.parse(target).getroot()
    assert (root.get("tests"), root.get("failures"), root.get("skipped")) == ("4", "1", "1")
    suites = root.findall("testsuite")
    assert [len(suite.findall("properties/property")) for suite in suites] == [len(METRICS)] * 2
    failure = suites[1].find("testcase/failure")
    assert failure is not None
    assert failure.text is not None
    assert "first violated  2.288 s (simulated time, from the first sample)" in failure.text
    assert "law.kp_angular = 10.0, law.kp_linear = 10.0" in failure.text


def test_junit_holds_any_name_and_reason(call: Call, kp4: Path, tmp_path: Path) -> None:
    spec, target = tmp_path / "spec.toml", tmp_path / "report.xml"
    name = r"a <b> & \"c\" ü \u0001"
    text = f'format = 1\n[checks."{name}"]\nexpect = "run.duration < 1"\nreason = "]]> \\u0002"'
    spec.write_text(text, encoding="utf-8")
    run = tmp_path / "i & 'j'.mcap"
    run.write_bytes(kp4.read_bytes())
    assert call("check", spec, run, "--junit", target).code == 1
    case = Xml.parse(target).getroot().find("testsuite/testcase")
    assert case is not None
    assert (case.get("name"), case.get("classname")) == ('a <b> & "c" ü \\x01', str(run))


def test_artifacts_are_written_of_what_fails(
    call: Call, spec: Path, kp4: Path, kp10: Path, tmp_path: Path, monkeypatch: Any
) -> None:
    for variable in ("VK_DRIVER_FILES", "VK_ICD_FILENAMES"):
        monkeypatch.setenv(variable, "/none")  # no viewer, no pictures
    folder = tmp_path / "failed"
    answer = call("check", spec, kp4, kp10, "--artifacts", folder)
    assert sorted(path.suffix for path in folder.iterdir()) == [".mcap", ".rrd"]
    assert ".png: no picture: viewer: expected a graphics adapter" in answer.err
    (rrd,) = folder.glob("kp10-overshoot-*.rrd")
    assert read_mark(rrd).cursor_s == (2.288, 2.288)
    (cut,) = folder.glob("kp10-overshoot-*.mcap")
    times_s = (tl.read_recording(cut).poses.time_ns - tl.read_recording(kp10).start_ns) / 1e9
    assert 1.28 <= times_s.min() <= times_s.max() <= 3.29


@pytest.mark.thorough
def test_artifacts_are_the_same_of_files_judged_in_several_processes(
    call: Call, spec: Path, kp4: Path, kp10: Path, tmp_path: Path, monkeypatch: Any
) -> None:
    """Processes start, as for many files."""
    for variable in ("VK_DRIVER_FILES", "VK_ICD_FILENAMES"):
        monkeypatch.setenv(variable, "/none")
    answers, written = [], []
    for jobs in ("1", "2"):
        folder = tmp_path / f"failed{jobs}"
        words = ("check", spec, kp4, "none.mcap", kp10, "--artifacts", folder, "--jobs", jobs)
        answers.append(call(*words))
        (cut,) = folder.glob("*.mcap")  # the view holds when it was written
        written.append((sorted(path.name for path in folder.iterdir()), cut.read_bytes()))
    assert answers[0].out == answers[1].out
    assert answers[0].err.replace("failed1", "failed2") == answers[1].err
    assert written[0] == written[1]
    assert len(written[0][0]) == 2


def test_a_first_spec_is_passed_by_the_run_that_it_was_read_off(
    call: Call, kp4: Path, kp10: Path, tmp_path: Path
) -> None:
    target = tmp_path / "first.toml"
    first = call("check", "--init", kp4, "-o", target)
    assert first.code == 0
    assert first.out.startswith(
        f"first.toml: 13 checks read off {kp4.name}, each bound with its reason."
    )
    assert f"Then: turtlelog check {target} FILE..." in first.flat
    tables = tomllib.loads(target.read_text("utf-8"))
    assert all(check["observed"] for check in tables["checks"].values())
    assert (target.parent / tables["reference"]).resolve() == kp4.resolve()
    answer = call("check", target, kp4)
    assert answer.code == 0
    assert "bounds were read off a run: look at observed = true in" in answer.out
    assert call("check", target, kp10).code == 1


def test_a_first_spec_is_printed_without_a_target(call: Call, kp4: Path) -> None:
    answer = call("check", "--init", kp4)
    assert answer.code == 0
    assert tomllib.loads(answer.out)["format"] == 1


def test_a_first_spec_of_a_run_that_missed_its_goal_asks_whether_it_was_good(
    call: Call, kp10: Path, tmp_path: Path
) -> None:
    tl.write_recording(tl.simulate_run(tl.load_scenario("paper-kp2")), tmp_path / "kp2.mcap")
    assert "good run?" not in call("check", "--init", tmp_path / "kp2.mcap").err
    doubt = "Was kp10.mcap a good run? It missed the goal by 0.107 m"
    assert doubt in call("check", "--init", kp10).err
    assert doubt in call("check", "--init", kp10, "-o", tmp_path / "first.toml").flat


def test_a_truncated_recording_fails_unless_partial_is_asked_for(
    call: Call, spec: Path, kp4: Path, tmp_path: Path
) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(kp4.read_bytes()[:-2000])
    answer = call("check", spec, cut)
    assert answer.code == 1
    assert "recording: the recording is not complete:" in answer.out
    assert " recording " not in call("check", spec, cut, "--partial").out


def test_the_advised_check_of_a_truncated_recording_reads_what_is_left(
    call: Call, kp4: Path, tmp_path: Path
) -> None:
    cut, spec = tmp_path / "cut.mcap", tmp_path / "spec.toml"
    cut.write_bytes(kp4.read_bytes()[:-2000])
    advised = call("check", "--init", cut, "--partial", "-o", spec).flat
    assert advised.endswith(f"turtlelog check {spec} FILE... --partial")
    assert "turtlelog check SPEC RUN... --partial" in spec.read_text("utf-8").splitlines()[0]
    assert call("check", spec, cut, "--partial").code == 0
    answer = call("check", spec, cut)  # the reference, which is cut, only explains
    assert (answer.code, answer.err) == (1, "")
    more = f"compare {cut} {cut} --why final.position_error --partial"
    assert more.replace(str(cut), "cut.mcap") in answer.flat.replace(str(cut), "cut.mcap")
    assert call(*more.split()).code == 0


def write_unreadable(folder: Path, whole: bytes) -> dict[Path, str]:
    """Write files that are no recordings, and return what is said of each."""
    ended = "truncated or unfinished (no end of an MCAP file"
    contents = {
        "empty.mcap": (b"", "byte 0: not an MCAP file: it is empty"),
        "head.mcap": (whole[:100], f"{ended}): "),
        "first.mcap": (
            whole[:5000],
            f"{ended} at byte 5000); in what it still holds: topic /turtle1",
        ),
        "text.mcap": (b"hello", "byte 0: not an MCAP file: it is text"),
        "other.json": (b"{}", "data: expected a JSON object"),
    }
    for name, (content, _) in contents.items():
        (folder / name).write_bytes(content)
    (folder / "folder").mkdir()
    return {
        **{folder / name: reason for name, (_, reason) in contents.items()},
        folder / "none.mcap": "no such file",
        folder / "folder": "no recordings in this folder",
    }


def test_the_first_line_says_why_the_only_recording_cannot_be_read(call: Call, spec: Path) -> None:
    answer = call("check", spec, "none.mcap")
    assert (answer.code, answer.out.splitlines()[0]) == (1, "FAIL: none.mcap: no such file")


@pytest.mark.parametrize("partial", [[], ["--partial"]], ids=["whole", "partial"])
def test_a_recording_that_cannot_be_read_fails_and_the_others_are_judged(
    call: Call, spec: Path, kp4: Path, tmp_path: Path, partial: list[str]
) -> None:
    bad, target = write_unreadable(tmp_path, kp4.read_bytes()), tmp_path / "report.xml"
    words = ("check", spec, kp4, *bad, kp4, "--junit", target, *partial)
    answer = call(*words, "--artifacts", tmp_path / "failed")
    assert answer.code == 1
    assert (
        answer.out.splitlines()[0]
        == "FAIL: 9 recordings: 7 of 11 checks fail (recording), 7 of them without a value"
    )
    words_of_answer = " ".join(answer.out.split())
    for path, reason in bad.items():
        assert f"FAIL {path}: recording: {reason}" in words_of_answer
    assert not (tmp_path / "failed").exists()
    root = Xml.parse(target).getroot()
    assert (root.get("tests"), root.get("failures")) == ("11", "7")
    cases = root.findall("testsuite/testcase[@name='recording']")
    assert [case.get("classname") for case in cases] == [*map(str, bad)]
    for case, reason in zip(cases, bad.values(), strict=True):
        failure = case.find("failure")
        assert failure is not None
        assert reason in (failure.get("message") or "")
    results = call(*words[:-3], "--json").json["results"]
    found = {result["file"]: result for result in results if result["check"] == "recording"}
    assert {Path(file): result["verdict"] for file, result in found.items()} == dict.fromkeys(
        bad, "FAIL"
    )
    assert not any(result["decided"] for result in found.values())


BAD = {
    "nothing": ([], "check needs a specification and recordings: turtlelog check SPEC FILE"),
    "no runs": (["spec.toml"], "which recordings? turtlelog check spec.toml FILE"),
    "no spec": (
        ["none.toml", "kp4"],
        "none.toml: no such file",
    ),
    "output": (["spec.toml", "kp4", "-o", "x.toml"], "--output x.toml: needs --init"),
    "init": (["--init", "kp4", "spec.toml"], "--init: takes one good run and no other file"),
    "junit": (["spec.toml", "kp4", "--junit", "r.txt"], "r.txt: the name must end in .xml"),
}


@pytest.mark.parametrize(("words", "message"), BAD.values(), ids=BAD)
def test_bad_usage_exits_with_2_and_one_line(
    words: list[str], message: str, call: Call, spec: Path, kp4: Path, monkeypatch: Any
) -> None:
    monkeypatch.chdir(spec.parent)
    answer = call("check", *(str(kp4) if word == "kp4" else word for word in words))
    assert (answer.code, answer.out) == (2, "")
    assert message in answer.err
    assert answer.err.count("\n") == 1


def test_junit_has_times_and_timestamps(call: Call, spec: Path, kp4: Path, tmp_path: Path) -> None:
    report, before = tmp_path / "report.xml", datetime.now(UTC).replace(microsecond=0)
    call("check", spec, kp4, tmp_path / "none.mcap", "--junit", report)
    root = Xml.parse(report).getroot()
    suites = root.findall("testsuite")
    assert len(suites) == 2
    for suite in suites:
        began = datetime.fromisoformat(suite.attrib["timestamp"])
        assert before <= began <= datetime.now(UTC)
        cases = [float(case.attrib["time"]) for case in suite.findall("testcase")]
        # Each of the times is rounded to a millisecond.
        assert sum(cases) <= float(suite.attrib["time"]) + 0.001 * len(cases)
    # Reading alone takes more than a millisecond.
    assert float(suites[0].attrib["time"]) > 0.0
    total = sum(float(suite.attrib["time"]) for suite in suites)
    assert abs(float(root.attrib["time"]) - total) <= 0.002


WHY = """format = 1
reference = "REFERENCE"
[checks.error]
expect = "final.position_error < 0.02"
[metrics]
"run.duration" = { abs = 0.1, reason = "a test" }
"""


@pytest.mark.parametrize("words", [(), ("--no-why",), ("--marks",)])
def test_a_failure_says_why_the_run_differs_from_the_reference(
    call: Call, kp4: Path, kp10: Path, tmp_path: Path, words: tuple[str, ...]
) -> None:
    spec, report = tmp_path / "spec.toml", tmp_path / "report.xml"
    spec.write_text(WHY.replace("REFERENCE", kp4.as_posix()), encoding="utf-8")
    answer = call("check", spec, kp10, "--junit", report, *words)
    assert answer.code == 1
    told = "final.position_error rose from 0.0085 m to 0.1067 m: the gains add 0.1499 m,"
    assert (f"WHY {kp10} against its reference: {told}" in answer.flat) is (not words)
    assert (told in report.read_text("utf-8")) is (not words)


def test_the_reason_of_a_failure_stands_in_json(
    call: Call, kp4: Path, kp10: Path, tmp_path: Path
) -> None:
    spec = tmp_path / "spec.toml"
    spec.write_text(WHY.replace("REFERENCE", kp4.as_posix()), encoding="utf-8")
    results = call("check", spec, kp4, kp10, kp10, kp10, kp10, "--json").json["results"]
    whys = [one["why"] for one in results if one["check"] == "error"]
    assert [len(why) for why in whys] == [0, 3, 3, 3, 0]
    assert whys[1][2] == f"More: turtlelog compare {kp4} {kp10} --why final.position_error"


def test_a_file_of_metrics_is_a_reference_of_metrics(
    call: Call, kp4: Path, kp10: Path, tmp_path: Path
) -> None:
    spec, golden = tmp_path / "spec.toml", tmp_path / "good.json"
    golden.write_text(call("metrics", kp4, "--json").out, encoding="utf-8")
    spec.write_text(WHY.replace("REFERENCE", "good.json"), encoding="utf-8")
    assert call("check", spec, kp4).code == 0
    answer = call("check", spec, kp10, "--json").json
    assert [one["verdict"] for one in answer["results"]] == ["FAIL", "FAIL"]
    (why,) = answer["results"][0]["why"]
    assert why.startswith("Not explained: good.json has no scenario.")
    assert f"turtlelog compare GOOD.mcap {kp10} --why final.position_error" in why
    golden.write_text(format_metrics(tl.read_run(kp4), "kp4.mcap"), encoding="utf-8")
    assert "final.position_error rose from 0.0085 m" in call("check", spec, kp10).flat
    assert "WHY" not in call("check", spec, kp10, "--no-why").flat


@pytest.mark.parametrize(
    ("table", "told"),
    [
        (
            '[signals.x]\nabs = 1\nreason = "wide"\n',
            "[signals.x] needs a recording as its reference",
        ),
        (
            '[metrics]\n"run.duration" = { abs = 1, reason = "wide" }\n',
            "good.json has no metric run.duration",
        ),
    ],
)
def test_what_a_file_of_metrics_lacks_is_named(
    call: Call, kp4: Path, tmp_path: Path, table: str, told: str
) -> None:
    spec, golden = tmp_path / "spec.toml", tmp_path / "good.json"
    golden.write_text(call("metrics", kp4, "--metric", "final.*", "--json").out, "utf-8")
    spec.write_text(f'format = 1\nreference = "good.json"\n{table}', encoding="utf-8")
    answer = call("check", spec, kp4)
    assert (answer.code, answer.err.count("\n")) == (2, 1)
    assert told in answer.err
