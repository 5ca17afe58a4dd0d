from pathlib import Path

import pytest

import turtlelog as tl
from tests.check.recordings import simulate
from turtlelog.log import ReadChoice

CHECK = '[checks.near]\nexpect = "final.position_error < 0.02"\n'


def write(folder: Path, text: str) -> Path:
    path = folder / "spec.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_spec_holds_checks_and_tolerances(tmp_path: Path) -> None:
    tolerance = '[signals.x]\nabs = 0.1\nreason = "enough"\n'
    text = f'format = 1\nreference = "good.mcap"\nalignment = "phase:translate"\n{CHECK}'
    spec = tl.load_spec(write(tmp_path, text + tolerance))
    assert [check.name for check in spec.checks] == ["near"]
    assert spec.tolerances.signals["x"].abs == 0.1
    assert spec.reference == tmp_path / "good.mcap"
    assert spec.alignment == "phase:translate"


def test_compare_reads_the_tolerances_of_a_spec(tmp_path: Path) -> None:
    tolerance = '[signals.x]\nabs = 0.1\nreason = "enough"\n'
    path = write(tmp_path, f'format = 1\nreference = "good.mcap"\n{CHECK}{tolerance}')
    assert list(tl.check.load_tolerances(path).signals) == ["x"]


def test_a_check_holds_all_that_can_be_said(tmp_path: Path) -> None:
    text = """format = 1
[checks.track]
holds = "always(abs(cross_track) <= 0.05)"
phase = "translate"
when = "law.kp_linear >= 2"
reason = "a turtle's width"
observed = true
"""
    (check,) = tl.load_spec(write(tmp_path, text)).checks
    assert (check.kind, check.phase, check.is_observed) == ("holds", "translate", True)
    assert check.when is not None
    assert (check.formula.names, check.when.names) == (("cross_track",), ("law.kp_linear",))


BAD = {
    "no format": (CHECK, r"spec.toml: the first line of a specification is missing: format = 1"),
    "older": (f"format = 0\n{CHECK}", r"spec.toml: format: expected 1, found 0"),
    "newer": (f"format = 2\n{CHECK}", r"format: expected at most 1, found 2, of a newer turtlelog"),
    "nothing": ("format = 1\n", r"has no table \[checks.NAME\]"),
    "table": ("format = 1\n[check.near]\n", r"spec.toml: check: unknown key; did you mean checks"),
    "no table": ("format = 1\nchecks = 3\n", r"checks: expected tables, found 3"),
    "flat": ("format = 1\n[checks]\nnear = 3\n", r"checks.near: expected a table, found 3"),
    "key": (f"format = 1\n{CHECK}fase = 1", r"checks.near.fase: unknown key; did you mean phase"),
    "neither": (
        'format = 1\n[checks.a]\nreason = "b"',
        r"a: needs expect or holds$",
    ),
    "both": (f'format = 1\n{CHECK}holds = "x > 0"', r"needs expect or holds, not both"),
    "empty": ('format = 1\n[checks.a]\nexpect = " "', r"checks.a.expect: expected text, found ' '"),
    "number": ("format = 1\n[checks.a]\nexpect = 3", r"checks.a.expect: expected text, found 3"),
    "phase": (
        'format = 1\n[checks.a]\nholds = "x > 0"\nphase = "done"',
        r"checks.a.phase: expected one of the run's law or pause, found 'done'",
    ),
    "phase of metrics": (f'format = 1\n{CHECK}phase = "rotate"', r"near.phase: expected holds"),
    "observed": (f"format = 1\n{CHECK}observed = 1", r"observed: expected true or false, found 1"),
    "formula": (
        'format = 1\n[checks.a]\nexpect = "final.position_error < )"',
        r"spec.toml: checks.a.expect: column 24: expected",
    ),
    "metric": (
        'format = 1\n[checks.a]\nexpect = "rotate.overshot < 2"',
        r"checks.a.expect: column 1: unknown name \"rotate.overshot\"; .* rotate.overshoot",
    ),
    "signal": (
        'format = 1\n[checks.a]\nholds = "always(cros_track_ < 1)"',
        r"checks.a.holds: column 8: unknown name \"cros_track_\"; .* cross_track",
    ),
    "signal as metric": (
        'format = 1\n[checks.a]\nexpect = "cross_track < 2"',
        r"checks.a.expect: column 1: expected a metric, found the signal cross_track",
    ),
    "over time": (
        'format = 1\n[checks.a]\nexpect = "always(rotate.overshoot < 2)"',
        r"checks.a.expect: column 1: expected metrics, found always",
    ),
    "parameter": (
        f'format = 1\n{CHECK}when = "loop.period_tick > 1"',
        r"near.when: column 1: unknown name \"loop.period_tick\"; .* loop.period_ticks",
    ),
    "no reference": (
        'format = 1\n[signals.x]\nabs = 1\nreason = "a"',
        r"spec.toml: tolerances need a recording to compare with",
    ),
    "reference": (f"format = 1\nreference = 3\n{CHECK}", r"spec.toml: reference: expected text"),
    "alignment": (
        f'format = 1\nalignment = "phase:1"\n{CHECK}',
        r"spec.toml: alignment: unknown name \"phase:1\"; did you mean phase:NAME",
    ),
    "no TOML": ("format = ", r"spec.toml: not TOML: "),
    "nothing at all": ("", r"spec.toml: the first line of a specification is missing: format = 1"),
    "binary": ("\0\1\2", r"spec.toml: not TOML: "),
    "format as text": (f'format = "1"\n{CHECK}', r"spec.toml: format: expected 1, found '1'"),
    "array": ("format = 1\n[[checks]]\nexpect = 'a'", r"checks: expected tables, found"),
    "no number": ("format = 1\n[checks.a]\nexpect = nan", r"expect: expected text, found nan"),
    "nan": (
        'format = 1\n[checks.a]\nexpect = "run.duration < nan"',
        r"checks.a.expect: column 16: unknown name \"nan\"",
    ),
    "too large": (
        'format = 1\n[checks.a]\nexpect = "run.duration < 1e400"',
        r"checks.a.expect: column 16: expected a number below 1.8e308, or inf, found '1e400'",
    ),
    "window": (
        'format = 1\n[checks.a]\nholds = "always[5, 2](x < 3)"',
        r"checks.a.holds: column 11: expected a second bound of at least 5 s, found '2'",
    ),
    "deep": (
        f'format = 1\n[checks.a]\nexpect = "{"(" * 500}run.duration{")" * 500} > 1"',
        r"checks.a.expect: column 101: expected at most 100 levels of nesting",
    ),
    "long": (
        f'format = 1\n[checks.a]\nexpect = "{"run.duration > 0 and " * 2000}true"',
        r"checks.a.expect: column 1: expected at most 20,000 characters, found",
    ),
}


@pytest.mark.parametrize(("text", "message"), BAD.values(), ids=BAD)
def test_a_wrong_spec_is_refused_with_file_and_key(text: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(tl.TurtlelogError, match=message) as error:
        tl.load_spec(write(tmp_path, text))
    assert "\n" not in str(error.value)


def test_a_spec_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(tl.TurtlelogError, match=r"nothing.toml: no such file"):
        tl.load_spec(tmp_path / "nothing.toml")


def test_a_spec_of_a_thousand_checks_is_read_and_checked(tmp_path: Path) -> None:
    text = "".join(f'[checks.a{i}]\nexpect = "run.duration < {i}"\n' for i in range(1000))
    spec = tl.load_spec(write(tmp_path, f"format = 1\n{text}"))
    run = simulate()
    passed = [result.verdict == "PASS" for result in tl.check_runs(spec, [("a", run)])]
    duration_s = (run.end_ns - run.start_ns) / 1e9
    assert passed == [duration_s < limit_s for limit_s in range(1000)]


def test_specification_may_be_text() -> None:
    text = 'format = 1\n[checks.end]\nexpect = "run.duration < 20"\n'
    assert tl.parse_spec(text) == tl.parse_spec(
        {"checks": {"end": {"expect": "run.duration < 20"}}}
    )
    for wrong, message in [
        ("format = ", "specification: not TOML"),
        ("format = 2\n[checks.end]\n", "specification: format: expected at most 1, found 2"),
        (
            "format = 1\n[check.end]\n",
            "specification: check: unknown key; did you mean checks",
        ),
    ]:
        with pytest.raises(tl.TurtlelogError, match=message):
            tl.parse_spec(wrong)


def test_a_spec_says_what_is_read_of_other_peoples_files(tmp_path: Path) -> None:
    read = """[read]
pose_topic = "/odom_kf"
goal = [7, 0, 0.5]
time = "log"
columns = { x = "pos_x" }
"""
    spec = tl.load_spec(write(tmp_path, f"format = 1\n{CHECK}{read}"))
    expected = ReadChoice(
        pose_topic="/odom_kf", goal=(7.0, 0.0, 0.5), time="log", columns={"x": "pos_x"}
    )
    assert spec.read == expected
    asked = spec.read.override(ReadChoice(pose_topic="/odom", columns={"y": "b"}))
    assert (asked.pose_topic, asked.goal) == ("/odom", expected.goal)
    assert asked.columns == {"x": "pos_x", "y": "b"}


@pytest.mark.parametrize(
    ("read", "line"),
    [
        ('read = "x"', "read: expected a table, found 'x'"),
        ('[read]\nposes = "/odom"', r"read\.poses: unknown key; there are pose_topic"),
        ("[read]\npose_topic = 3", r"read\.pose_topic: expected text, found 3"),
        ("[read]\ngoal = [1]", r"read\.goal: expected \[x, y\] in m, or .* found \[1\]"),
        ('[read]\ntime = "now"', r"read\.time: expected auto or log or stamp, found 'now'"),
        ("[read]\ncolumns = 3", r"read\.columns: expected a table, found 3"),
    ],
)
def test_what_is_read_is_held_to_what_there_is(read: str, line: str, tmp_path: Path) -> None:
    text = f"format = 1\n{read}\n{CHECK}"
    with pytest.raises(tl.errors.CheckError, match=line):
        tl.load_spec(write(tmp_path, text))


@pytest.mark.parametrize(("count", "is_read"), [(5000, True), (5001, False)])
def test_more_formulas_than_can_be_judged_in_seconds_are_refused(
    tmp_path: Path, count: int, *, is_read: bool
) -> None:
    """Four parts each: always, speed, < and the number."""
    checks = [f'[checks.c{number}]\nholds = "always(speed < 1)"\n' for number in range(count)]
    path = write(tmp_path, "format = 1\n" + "".join(checks))
    if is_read:
        assert len(tl.load_spec(path).checks) == count
        return
    with pytest.raises(
        tl.errors.CheckError, match=r"5,001 checks have more than 20,000 .* Split the"
    ):
        tl.load_spec(path)
