"""`turtlelog compare --why`."""

import csv
import io
import math
import shutil
from pathlib import Path

import pytest

from tests.cli.conftest import Call

LAW = """from turtlelog.laws import Decision


class Law:
    def step(self, time_ns, pose):
        return Decision(speed_m_s=SPEED if time_ns < 2_000_000_000 else 0.0, turn_rate_rad_s=0.0)
"""


@pytest.fixture
def night(call: Call, tmp_path: Path) -> Path:
    """A folder of three nights; in the second the gain rose, and a pause came with it."""
    folder = tmp_path / "nightly"
    folder.mkdir()
    for name, kp in (("2026-05-01", 2), ("2026-05-02", 10), ("2026-05-03", 10)):
        call("run", f"paper-kp{kp}", "-o", folder / f"{name}.mcap")
    return folder


def test_the_first_line_is_the_answer_and_each_change_has_a_line(
    call: Call, kp4: Path, kp10: Path
) -> None:
    """Takes some 3 s: both runs are explained, too, and simulated from 17 starts."""
    answer = call("compare", kp4, kp10, "--why")
    assert answer.code == 0
    assert answer.flat.startswith(
        "final.position_error rose from 0.0085 m to 0.1067 m: the gains add 0.1499 m, the"
    )
    lines = answer.out.splitlines()
    gains = next(line for line in lines if line.startswith("  gains"))
    assert gains.split()[1:] == [
        *("+0.1499", "m", "law.kp_angular,", "law.kp_linear", "4", "->", "10", "without:"),
        *("0.0078", "m"),
    ]
    assert "depends on single samples" in answer.flat
    assert "By effect instead of by setting (turtlelog explain), the second run has " in answer.flat
    assert f"turtlelog compare --reference {kp4} {kp10}" in answer.flat
    assert max(len(line) for line in lines if str(kp4.parent.parent) not in line) <= 80


@pytest.mark.parametrize("place", ["before", "after", "equals", "reference"])
def test_the_metric_may_be_left_out_wherever_the_word_is(call: Call, kp4: Path, place: str) -> None:
    words = {
        "before": ["--why", kp4, kp4],
        "after": [kp4, kp4, "--why"],
        "equals": [kp4, kp4, "--why=final.position_error"],
        "reference": [kp4, "--reference", kp4, "--why"],
    }
    assert call("compare", *words[place]).flat.startswith(
        "final.position_error is 0.008520 m in both runs. The runs are equal: no setting differs"
    )


def test_a_missing_file_after_why_is_no_metric(call: Call, kp4: Path) -> None:
    answer = call("compare", "--why", "missing.mcap", kp4)
    assert (answer.code, "missing.mcap: no such file" in answer.err) == (2, True)


def test_contributions_as_json_add_up(call: Call, kp4: Path, kp10: Path) -> None:
    found = call("compare", kp4, kp10, "--why", "run.duration", "--json").json
    assert (found["first"], found["second"], found["condition"]) == (str(kp4), str(kp10), None)
    why = found["explanation"]
    sizes = [one["contribution"] for one in why["contributions"]]
    assert math.fsum(sizes) == pytest.approx(why["difference"], abs=1e-9)
    assert ["law.kp_angular", "law.kp_linear"] in [one["keys"] for one in why["contributions"]]


@pytest.mark.thorough
def test_contributions_as_csv(call: Call, kp4: Path, kp10: Path) -> None:
    text = call("compare", kp4, kp10, "--why", "run.duration", "--csv").out
    rows = list(csv.DictReader(io.StringIO(text)))
    assert {row["change"] for row in rows} == {"gains", "queue", "pause"}
    assert math.fsum(float(row["contribution [s]"]) for row in rows) == pytest.approx(1.424)


def test_the_first_bad_recording_of_a_folder_is_explained(call: Call, night: Path) -> None:
    """Takes some 3 s: three recordings are made, and two are explained."""
    answer = call("compare", night, "--first", "final.position_error > 0.01", "--why")
    assert answer.flat.startswith("final.position_error rose from 0.0010 m to 0.1067 m: the gains")
    assert (
        "2026-05-02.mcap is the first that meets final.position_error > 0.01, after"
        " 2026-05-01.mcap." in answer.flat
    )


@pytest.mark.parametrize(
    ("condition", "told"),
    [
        ("final.position_error > 1", "None of 2 recordings meets final.position_error > 1."),
        ("run.duration > 1", "kp4.mcap meets run.duration > 1, and no recording comes before it."),
    ],
)
def test_a_series_without_such_a_pair_says_so(
    call: Call, kp4: Path, condition: str, told: str
) -> None:
    answer = call("compare", kp4, kp4, "--first", condition, "--why")
    assert (answer.code, answer.out.strip()) == (0, told)
    found = call("compare", kp4, kp4, "--first", condition, "--why", "--json").json
    assert (found["explanation"], found["condition"]) == (None, condition)


@pytest.mark.parametrize(
    ("unread", "case"),
    [
        ("n0", ("run.duration > 1", "and no recording that can be read comes before it.")),
        ("n0", ("run.duration < 1", "None of 2 recordings that can be read meets run.duration <")),
        ("n1", ("run.duration < 1", "n2.mcap does not meet run.duration < 1.")),
        (
            "n15",
            (
                "final.position_error > 0.1",
                "n2.mcap is the first that meets final.position_error > 0.1, after n1.mcap. 1"
                " earlier recording cannot be read and may meet it, too: n15.mcap.",
            ),
        ),
        ("n3", ("final.position_error > 0.1", "after n1.mcap. gains")),
        ("n1 n2", ("run.duration < 1", "")),
    ],
)
def test_what_cannot_be_read_of_a_series_leaves_the_answer_open(
    call: Call, kp4: Path, kp10: Path, tmp_path: Path, unread: str, case: tuple[str, str]
) -> None:
    """Takes some 3 s: two recordings are explained."""
    condition, told = case
    shutil.copy(kp4, tmp_path / "n1.mcap")
    shutil.copy(kp10, tmp_path / "n2.mcap")
    for name in unread.split():
        (tmp_path / f"{name}.mcap").write_bytes(kp4.read_bytes()[:3000])
    answer = call("compare", tmp_path, "--first", condition, "--why", "--jobs", 1)
    assert answer.code == 2
    assert len(answer.err.splitlines()) == len(unread.split())
    assert told in answer.flat
    assert "cannot be read" in told or "cannot be read" not in answer.flat


def test_a_series_in_an_empty_folder_or_of_one_recording(
    call: Call, kp4: Path, tmp_path: Path
) -> None:
    words = ["--first", "run.duration < 1", "--why"]
    empty = call("compare", tmp_path, *words)
    assert (empty.code, empty.out, empty.err.count("\n")) == (2, "", 1)
    assert "no recordings in this folder" in empty.err
    answer = call("compare", kp4, *words)
    assert (answer.code, answer.out) == (0, "kp4.mcap does not meet run.duration < 1.\n")


@pytest.mark.thorough
def test_a_file_of_a_series_that_cannot_be_read_is_reported(call: Call, night: Path) -> None:
    """Takes some 3 s: three recordings are made, read in two processes, and two are explained."""
    (night / "2026-05-04.mcap").write_bytes(b"no recording")
    words = ["--first", "final.position_error > 0.01", "--why", "--jobs", 2]
    answer = call("compare", night, *words)
    assert answer.code == 2
    assert "2026-05-04.mcap" in answer.err
    assert "the gains" in answer.out


def test_another_law_is_exchanged_as_a_whole_where_both_may_run(
    call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Takes some 2 s: laws of one's own are loaded, and run plain."""
    monkeypatch.chdir(tmp_path)
    for name, speed in (("old", "0.5"), ("new", "0.7")):
        Path(f"{name}.py").write_text(LAW.replace("SPEED", speed), encoding="utf-8")
        call("run", "--law", f"{name}.py:Law", "-o", f"{name}.mcap")
    words = ["compare", "old.mcap", "new.mcap", "--why", "run.path_length"]
    unknown = call(*words)
    assert unknown.code == 0
    assert (
        "old.py:Law and new.py:Law run only if their code is trusted (--trust-law)" in unknown.flat
    )
    assert "The runs differ in the law itself. Signal by signal" in unknown.flat
    answer = call(*words, "--trust-law")
    assert "the law itself adds 0.400 m" in answer.flat
    assert "law.kind old.py:Law -> new.py:Law" in answer.flat


def test_an_edited_law_is_named_before_where_the_runs_depart(
    call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Takes some 2 s: a law of one's own runs plain."""
    monkeypatch.chdir(tmp_path)
    for name, speed in (("old", "0.5"), ("new", "0.7")):
        Path("law.py").write_text(LAW.replace("SPEED", speed), encoding="utf-8")
        call("run", "--law", "law.py:Law", "-o", f"{name}.mcap")
    words = ["compare", "old.mcap", "new.mcap", "--why"]
    untrusted, trusted = call(*words).flat, call(*words, "--trust-law").flat
    for text in (untrusted, trusted):
        assert (
            "No setting differs, but the code of the law does. The runs depart at 0.000 s, after 0"
            " equal samples, in wanted speed: 0.5 m/s then 0.7 m/s." in text
        )
        assert "the cause lies in the controller, whose code differs." in text
    assert "law.py:Law runs only if its code is trusted (--trust-law)" in untrusted
    assert "Simulated again, that scenario reproduces new.mcap alone." in trusted
    sides = call(*words, "--json").json["explanation"]
    digests = {sides[name]["simulated_by"]["law"] for name in ("first", "second")}
    assert len(digests) == 2


def test_the_contributions_are_drawn(call: Call, kp4: Path, kp10: Path, tmp_path: Path) -> None:
    """Takes some 2 s: matplotlib is loaded."""
    plot = tmp_path / "why.svg"
    answer = call("compare", kp4, kp10, "--why", "run.duration", "--plot", plot)
    assert f"wrote {plot}" in answer.err
    assert plot.read_text("utf-8").startswith("<?xml")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--why", "rotate.oversoot"], "did you mean rotate.overshoot"),
        (["--first", "run.duration > 1"], "--first: needs --why"),
        (["--trust-law"], "--trust-law: needs --why"),
        (["KP4", "--why"], "--why compares two runs, but 3 were given"),
        (["--why", "--metric", "run.duration"], "--metric: --why run.duration names the metric"),
        (["--why", "--sort", "name"], "--sort: leave out --why"),
        (["--why", "--plot", "why.gif"], "--plot why.gif: the name must end in"),
        (["--why", "--plot", "why.svg"], "there are no contributions to draw"),
        (["--first", "run.duratio > 1", "--why"], "did you mean run.duration"),
    ],
)
def test_what_does_not_go_together_is_refused(
    call: Call,
    kp4: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    words: list[str],
    told: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    files = [kp4, kp4]
    answer = call("compare", *files, *(kp4 if word == "KP4" else word for word in words))
    assert answer.code == 2
    assert told in " ".join(answer.err.split())
