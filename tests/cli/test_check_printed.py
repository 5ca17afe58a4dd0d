"""How `check` prints its verdicts."""

import csv
import io
import re
import tracemalloc
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from tests.cli.conftest import Call
from turtlelog.check import CheckResult, Verdict
from turtlelog.cli.check_answers import CountedResults, count_checks, format_results

RATES = """format = 1
[checks.rate]
holds = "always(abs(turn_rate) < 0.5)"
[checks.heading]
holds = "always(heading < 1)"
[signals.heading]
abs = 0.001
reason = "a try"
"""


def test_angles_are_printed_in_degrees_and_turn_rates_in_radians(
    call: Call, kp4: Path, kp10: Path, tmp_path: Path
) -> None:
    path = tmp_path / "rates.toml"
    path.write_text(RATES, encoding="utf-8")
    words = ("check", path, kp10, "--reference", kp4)
    rows = [" ".join(line.split()) for line in call(*words).out.splitlines()]
    assert "FAIL rate rad/s 1 0.5 -0.5 0.000" in rows
    assert "FAIL heading deg 129.8 57.296 -72.502 1.024" in rows
    assert "FAIL signals.heading deg 3.1403 0.057296 -3.083 2.128" in rows
    assert "129.57 deg where the reference has 126.43 deg" in " ".join(rows)
    results = {result["check"]: result for result in call(*words, "--json").json["results"]}
    assert (results["heading"]["limit"], results["heading"]["unit"]) == (1.0, "rad")


def test_rows_stand_in_the_order_of_files_with_a_heading_for_each(
    call: Call, spec: Path, kp4: Path, kp10: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # a long path takes several lines of a table
    for file in (kp4, kp10):
        Path(file.name).write_bytes(file.read_bytes())
    verdicts = {"kp4.mcap": ["PASS", "PASS"], "kp10.mcap": ["FAIL", "SKIPPED"]}
    for files in ([*verdicts], [*verdicts][::-1]):
        lines = call("check", spec, *files, "--all").out.splitlines()
        headings = [line for line in lines if line in verdicts]
        assert headings == files
        matrix = lines[lines.index("2 recordings, 2 checks") :]
        rows = [line.split() for line in matrix if line.startswith("kp")]
        assert rows == [[file, *verdicts[file]] for file in files]
    assert "recordings, 2 checks" not in call("check", spec, kp4, "--all").out


def test_value_limit_and_margin_share_a_line_at_80_columns(
    call: Call, kp4: Path, kp10: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    call("check", "--init", kp4, "-o", tmp_path / "first.toml")
    monkeypatch.chdir(kp10.parent)
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    monkeypatch.setenv("NO_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "80")
    lines = call("check", tmp_path / "first.toml", "kp10.mcap", "--all").out.splitlines()
    start = lines.index("") + 1
    first, head, *rows = lines[start : start + 17]
    assert first.split() == ["first"]
    assert head.split() == ["check", "unit", "value", "limit", "margin", "violation"]
    assert max(map(len, rows)) <= 80
    assert sum(line.startswith(("PASS", "FAIL")) for line in rows) == 13


CSV_HEADS = [
    *(
        "verdict",
        "file",
        "check",
        "unit",
        "value",
        "limit",
        "margin",
        "first violation [s]",
        "reason",
    )
]


@pytest.mark.parametrize("formula", ["run.duration < 60", "always(abs(speed) <= 0.1)"])
def test_check_csv_has_the_same_columns_whatever_was_found(
    formula: str, call: Call, kp4: Path, tmp_path: Path
) -> None:
    (tmp_path / "cut.mcap").write_bytes(kp4.read_bytes()[:300])
    answer = call("check", kp4, tmp_path / "cut.mcap", "--expect", formula, "--csv")
    head, *rows = csv.reader(io.StringIO(answer.out))
    assert head == CSV_HEADS
    assert {len(row) for row in rows} == {len(head)}


def test_check_csv_gives_the_reason_of_each_result(
    call: Call, spec: Path, kp4: Path, kp10: Path, tmp_path: Path
) -> None:
    (tmp_path / "cut.mcap").write_bytes(kp4.read_bytes()[:300])
    answer = call("check", spec, kp4, kp10, tmp_path / "cut.mcap", "--csv")
    reasons = [row["reason"] for row in csv.DictReader(io.StringIO(answer.out))]
    assert reasons[:2] == ["", ""]
    assert reasons[2].startswith("expected rotate.overshoot <= 0.5 (half a percent is seen)")
    assert reasons[3] == "only when law.kp_linear < 5; here law.kp_linear = 10.0"
    assert "byte 44" in reasons[4]


def test_check_answers_in_csv_and_markdown(call: Call, spec: Path, kp4: Path, kp10: Path) -> None:
    answer = call("check", spec, kp4, kp10, "--csv")
    assert answer.code == 1
    head, *rows = csv.reader(io.StringIO(answer.out))
    assert head == CSV_HEADS
    assert [row[:3] for row in rows] == [
        ["PASS", str(kp4), "overshoot"],
        ["PASS", str(kp4), "gains"],
        ["FAIL", str(kp10), "overshoot"],
        ["SKIPPED", str(kp10), "gains"],
    ]
    assert float(rows[2][4]) == call("check", spec, kp10, "--json").json["results"][0]["value"]
    text = call("check", spec, kp4, kp10, "--markdown").out
    assert "| FAIL | overshoot | % | 1.0076 | 0.5 | -0.50756 | 2.288 |" in text
    assert "FAIL: 2 recordings: 1 of 4 checks fails (overshoot, value 1.01 %), 1 is skipped" in text
    assert call("check", spec, kp4, "--csv", "--json").code == 2


@pytest.mark.parametrize(
    ("is_terminal", "variables", "is_coloured"),
    [
        (True, {}, True),
        (False, {}, False),
        (True, {"NO_COLOR": "1"}, False),
        (True, {"NO_COLOR": ""}, True),
        (False, {"FORCE_COLOR": "1"}, True),
        (False, {"FORCE_COLOR": ""}, False),
        (True, {"NO_COLOR": "1", "FORCE_COLOR": "1"}, False),
        (True, {"TERM": "dumb"}, False),
    ],
)
def test_verdicts_are_coloured_where_that_is_shown(
    call: Call,
    spec: Path,
    kp4: Path,
    kp10: Path,
    monkeypatch: pytest.MonkeyPatch,
    *,
    is_terminal: bool,
    variables: dict[str, str],
    is_coloured: bool,
) -> None:
    for name in ("NO_COLOR", "FORCE_COLOR"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "80")
    plain = call("check", spec, kp4, kp10).out
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr("sys.stdout.isatty", lambda: is_terminal)
    coloured = call("check", spec, kp4, kp10).out
    assert ("\x1b[31mFAIL\x1b[0m" in coloured) == is_coloured
    assert ("\x1b[32mPASS\x1b[0m" in coloured) == is_coloured
    assert re.sub("\x1b\\[\\d+m", "", coloured) == plain


def test_a_name_that_steers_the_terminal_stays_text_beside_colours(
    call: Call, spec: Path, kp4: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    odd = tmp_path / "FAIL \x1b[2J.mcap"
    odd.write_bytes(kp4.read_bytes())
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.delenv("NO_COLOR", raising=False)
    assert "\x1b[2J" not in call("check", spec, odd).out


def test_results_of_many_files_are_counted_and_few_of_them_kept() -> None:
    def make(count: int) -> Iterator[CheckResult]:
        for number in range(count):
            yield CheckResult(
                file=f"run-{number}.mcap",
                check="drift",
                verdict=Verdict.FAIL if number % 7 == 0 else Verdict.PASS,
                expected="drift < 1",
                value=number / count,
                limit=1.0,
                margin=1.0 - number / count,
            )

    def measure(count: int) -> int:
        tracemalloc.start()
        counted = CountedResults(make(count))
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert counted.verdict == "FAIL"
        assert counted.verdicts["FAIL"] == -(-count // 7)  # type: ignore[index]
        assert counted.nearest["drift"].file == f"run-{(count - 1) // 7 * 7}.mcap"  # that fails
        assert [one.file for one in counted.failures[:2]] == ["run-0.mcap", "run-7.mcap"]
        assert len(counted.failures) == 40
        assert (len(counted.failing), counted.failing_files) == (8, -(-count // 7))
        return peak

    few, many = measure(1_000), measure(20_000)
    assert many < 1.2 * few


@pytest.mark.parametrize("is_known", [True, False])
def test_a_table_of_failed_checks_names_a_file_that_fails(*, is_known: bool) -> None:
    passed = CheckResult(
        file="good.mcap", check="a", verdict=Verdict.PASS, expected="a < 1", value=0.9, margin=0.1
    )
    failed = replace(passed, file="bad.mcap", verdict=Verdict.FAIL, value=None, margin=None)
    if is_known:
        failed = replace(failed, value=1.2, margin=-0.2)
    for results in ((passed, failed), (failed, passed)):
        (row,) = count_checks(CountedResults(results), shows_all=False).rows
        assert row == ("a", 1, 1, row[3], -0.2 if is_known else None, "bad.mcap")
    (row,) = count_checks(CountedResults([passed]), shows_all=True).rows
    assert row[-2:] == (0.1, "good.mcap")


def test_the_verdict_comes_first_and_all_fits_a_screen(
    call: Call, kp4: Path, kp10: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for path in (kp4, kp10):
        Path(path.name).write_bytes(path.read_bytes())
    call("check", "--init", kp4.name, "-o", "first.toml")
    expected = {
        (kp4.name,): "PASS: kp4.mcap: all 13 checks pass",
        (kp10.name,): "FAIL: kp10.mcap: 7 of 13 checks fail",
        (
            kp4.name,
            kp10.name,
        ): "FAIL: 2 recordings: 7 of 26 checks fail",
    }
    for files, first in expected.items():
        lines = call("check", "first.toml", *files).out.splitlines()
        assert lines[0] == first
        assert len(lines) <= 40
        assert max(map(len, lines)) <= 80


@pytest.mark.parametrize(
    ("verdicts", "first"),
    [
        (["PASS"], "PASS: a.mcap: the check passes"),
        (["PASS", "SKIPPED"], "PASS: a.mcap: 1 of 2 checks passes, 1 is skipped"),
        (["SKIPPED"], "SKIPPED: no check was judged in a.mcap: 1 is skipped"),
        (["FAIL"], "FAIL: a.mcap: c0 fails, it has no value"),
        (
            ["FAIL", "FAIL", "SKIPPED"],
            "FAIL: a.mcap: 2 of 3 checks fail (c0 and 1 more), 2 of them without a value,"
            " 1 is skipped",
        ),
    ],
)
def test_the_first_line_counts_what_was_judged(verdicts: list[str], first: str) -> None:
    results = [
        CheckResult(
            file="a.mcap",
            check=f"c{number}",
            verdict=Verdict(verdict),
            reason="because",
            is_decided=verdict != "FAIL",
        )
        for number, verdict in enumerate(verdicts)
    ]
    assert format_results(results, files=1).splitlines()[0] == first


def test_marks_are_a_line_for_each_recording(call: Call, kp4: Path, kp10: Path) -> None:
    answer = call("check", kp4, kp10, "--expect", "rotate.overshoot <= 0.5", "--marks")
    assert (answer.code, answer.err) == (1, "")
    assert answer.out.splitlines() == [
        f"PASS  {kp4}: 1 of 1 check passed",
        f"FAIL  {kp10}: 0 of 1 check passed",
    ]


def test_a_limit_of_zero_takes_part_in_what_is_furthest(call: Call, kp10: Path) -> None:
    expected = ("--expect", "rotate.overshoot <= 0", "--expect", "run.duration <= 12.6")
    lines = call("check", *expected, kp10).out.splitlines()
    assert lines[1].startswith("Furthest beyond its limit, in proportion: rotate.overshoot <= 0,")


def test_the_next_command_explains_the_metric_that_failed(
    call: Call, kp10: Path, tmp_path: Path
) -> None:
    spec = tmp_path / "spec.toml"
    spec.write_text('format = 1\n[checks."rotate.overshoot"]\nexpect = "rotate.overshoot <= 0.5"\n')
    answer = call("check", spec, kp10)
    assert f"Why? turtlelog explain {kp10} --metric rotate.overshoot" in answer.out
