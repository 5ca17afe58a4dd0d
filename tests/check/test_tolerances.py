import math
from pathlib import Path

import pytest

import turtlelog as tl
from turtlelog.check.spec_file import parse_tolerances, read_tables
from turtlelog.errors import CompareError

ROOT = Path(__file__).parents[2]
GOOD = 'format = 1\n[signals.x]\nabs = 0.1\nreason = "why"\n'


def write(folder: Path, text: str) -> Path:
    path = folder / "t.toml"
    path.write_text(text, "utf-8")
    return path


def test_a_file_gives_the_tolerances_that_it_holds() -> None:
    tolerances = tl.check.load_tolerances(ROOT / "examples" / "tolerances.toml")
    assert tolerances.signals["x"] == tl.Tolerance(
        abs=0.001, time_s=0.032, reason="a float32 step, and two ticks of scheduling"
    )
    assert tolerances.metrics["final.position_error"].rel == 0.1
    assert list(tolerances.metrics) == ["rotate.settling_time", "final.position_error"]


def test_tables_of_checks_are_no_tolerances(tmp_path: Path) -> None:
    path = write(tmp_path, GOOD + '[checks.near]\nholds = "always(x < 9)"\n')
    assert list(tl.check.load_tolerances(path).signals) == ["x"]
    assert list(read_tables(path)) == ["signals", "checks"]
    with pytest.raises(CompareError, match=r"t.toml: cheks: unknown key; did you mean checks"):
        read_tables(write(tmp_path, GOOD + "[cheks.near]"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the first line of a specification is missing: format = 1"),
        ("format = 2", "format: expected at most 1, found 2, of a newer turtlelog"),
        ("format = true", "format: expected 1, found true"),
        ("format = 0", "format: expected 1, found 0"),
        ("format = 1", r"has no table \[signals.NAME\] or \[metrics.ID\]"),
        ("format = 1\n[signal.x]", "signal: unknown key; did you mean signals"),
        ("format = 1\nsignals = 3", "signals: expected a table, found 3"),
        ("format = 1\n[signals]\nx = 3", "signals.x: expected a table, found 3"),
        ("format = 1\n[signals.Heading]", "signals.Heading: unknown key; did you mean heading"),
        (
            "format = 1\n[signals.Heading]\nabs = 1",
            "signals.Heading: unknown key; did you mean heading",
        ),
        (
            "format = 1\n[metrics.'run.durations']\nabs = 1",
            "metrics.run.durations: unknown key; did you mean run.dur",
        ),
        ("format = 1\n[signals.'']", "signals.: unknown key; there are x, y"),
        (
            "format = 1\n[metrics.'run.durations']",
            "metrics.run.durations: unknown key; did you mean",
        ),
        (
            "format = 1\n[metrics.rotate.overshoot]",
            'metrics.rotate: needs quotes around the id: metrics."rotate.overshoot"',
        ),
        ("format = 1\n[signals.x]\nabs = 1", "signals.x.reason: expected a reason, found no value"),
        ("format = 1\n[signals.x]\nreason = ' '", "signals.x.reason: expected a reason, found ' '"),
        ("format = 1\n[signals.x]\nreason = 3", "signals.x.reason: expected a reason, found 3"),
        ("format = 1\n[signals.x]\nreason = 'a'", "signals.x: needs abs or rel or time_s"),
        ("format = 1\n[signals.x]\nasb = 1", "signals.x.asb: unknown key; did you mean abs"),
        (
            "format = 1\n[metrics.'run.duration']\ntime_s = 1",
            'metrics."run.duration".time_s: unknown key; .*',
        ),
        (
            "format = 1\n[signals.phase]\nabs = 1\nreason = 'a'",
            "signals.phase.abs: expected none for a label, found 1.0",
        ),
        ("[signals.x", "not TOML: Expected"),
        ("a = " + "[" * 9999, "not TOML: tables or arrays more than 32 deep"),
    ],
)
def test_a_wrong_file_is_told_where_and_why(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(CompareError, match=f"t.toml: {message}"):
        tl.check.load_tolerances(write(tmp_path, text))


@pytest.mark.parametrize("key", ["abs", "rel", "time_s"])
@pytest.mark.parametrize("value", ["nan", "inf", "-0.1", "true", "'1'", "[1]", "1979-05-27"])
def test_figures_are_finite_and_not_negative(tmp_path: Path, key: str, value: str) -> None:
    text = GOOD.replace("abs = 0.1", f"{key} = {value}")
    with pytest.raises(CompareError, match=rf"signals.x.{key}: expected a .*number .*found"):
        tl.check.load_tolerances(write(tmp_path, text))


def test_a_share_above_one_is_most_likely_meant_in_per_cent() -> None:
    with pytest.raises(CompareError, match="rel: expected a number from 0 to 1, found 5"):
        tl.Tolerance(rel=5)


def test_what_is_no_text_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "t.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(CompareError, match="not TOML, not even text"):
        tl.check.load_tolerances(tmp_path / "t.toml")
    with pytest.raises(CompareError, match=r"none\.toml: no such file"):
        tl.check.load_tolerances(tmp_path / "none.toml")
    with pytest.raises(
        CompareError, match="expected a specification or tolerance file, found: Is a directory"
    ):
        tl.check.load_tolerances(tmp_path)


def test_tolerances_built_in_python_are_judged_as_well() -> None:
    with pytest.raises(CompareError, match=r"signals\.Heading: unknown key; did you mean heading"):
        tl.Tolerances(signals={"Heading": tl.Tolerance(abs=1.0)})
    with pytest.raises(CompareError, match=r"time_s: expected none for a metric"):
        tl.Tolerances(metrics={"run.duration": tl.Tolerance(time_s=1.0)})
    with pytest.raises(CompareError, match="abs: expected a finite number >= 0, found nan"):
        tl.Tolerance(abs=math.nan)


def test_tables_that_are_parsed_already_may_be_handed_over() -> None:
    tables = {"metrics": {"run.duration": {"abs": 1, "reason": "a second"}}}
    tolerance = parse_tolerances(tables).metrics["run.duration"]
    assert (tolerance.abs, tolerance.reason) == (1.0, "a second")
    assert not parse_tolerances({})
