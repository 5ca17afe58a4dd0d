import re
from dataclasses import replace
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tests.cli.conftest import Call
from tests.sweep.swept_tables import write_table
from tests.sweep.test_gain_borders import GRID, is_stable
from turtlelog.sweep import Sampling, build_plan, read_result_table, write_result_table

SIGNATURES = {
    ".png": b"\x89PNG",
    ".pdf": b"%PDF",
    ".svg": b"<?xml",
    ".html": b"<!DOCTYPE html>",
}


@pytest.fixture(name="table")
def _table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return write_table(
        tmp_path / "t.parquet",
        GRID,
        {
            "translate.stable": is_stable,
            "translate.overshoot": lambda delay, kp: delay * kp if kp < 20 else "too_short",
        },
        units={"translate.overshoot": "%"},
    )


def test_map_says_the_best_rows_and_the_border_beside_theory(
    call: Call, table: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("UV_RUN_RECURSION_DEPTH", "1")
    done = call("plot", table.name)
    assert (done.code, done.err) == (0, "")
    assert done.out.startswith("t.parquet: translate.stable: the border lies within one cell of")
    told = (
        "lies within one cell of theory's line in 3 of 3 columns; 2 columns have no border: they"
        " are stable at every measured gain, as in theory",
        "60 rows; loop.transport_delay_ticks by law.kp_linear",
        "translate.overshoot: 0 % to 216 %, best in row 0 and 8 more (",
        "; no value: 15 rows too short best translate.overshoot: "
        "uv run turtlelog run --from t.parquet --row 0",
    )
    assert [text for text in told if text not in done.flat] == []
    assert max(map(len, done.out.splitlines())) <= 80


@pytest.mark.parametrize(("least", "is_told"), [(-0.1, True), (0.0, False)])
def test_a_best_overshoot_below_0_is_no_arrival(
    call: Call, tmp_path: Path, least: float, *, is_told: bool
) -> None:
    path = tmp_path / "t.parquet"
    values = {"translate.overshoot": lambda delay, kp: least + delay * kp}
    write_table(path, GRID, values, units={"translate.overshoot": "%"})
    assert ("below 0, the reference is never reached" in call("plot", path).flat) is is_told


def test_json_has_what_is_drawn(call: Call, table: Path) -> None:
    told = call("plot", table.name, "--json").json
    assert (told["rows"], told["shown"], told["output"]) == (60, 60, None)
    assert [axis["keys"] for axis in told["axes"]] == [
        ["loop.transport_delay_ticks"],
        ["law.kp_linear"],
    ]
    stable, overshoot = told["metrics"]
    assert stable["best"] is None
    assert [one["within_one_cell"] for one in stable["borders"]] == [None, None, True, True, True]
    assert stable["borders"][2]["at"] == [6]
    assert (stable["borders"][2]["last_stable"], stable["borders"][2]["first_unstable"]) == (14, 16)
    assert stable["borders"][2]["theory"] == pytest.approx(15.07, abs=0.01)
    assert overshoot["borders"] is None
    assert overshoot["best"] == {
        "row": 0,
        "value": 0.0,
        "as_good": 9,
        "within_chance": None,
        "others": None,
        "keys": {"loop.transport_delay_ticks": 0, "law.kp_linear": 2.0},
    }
    assert overshoot["no_value"] == {"too short": 15}
    limits = told["theory"][0]["columns"][2]["limits"]
    assert limits["stable"] == [[0.0, stable["borders"][2]["theory"]]]


@pytest.mark.everyday(".png")
@pytest.mark.parametrize("suffix", SIGNATURES)
def test_outputs_are_files_of_their_kind(suffix: str, call: Call, table: Path) -> None:
    done = call("plot", table.name, "-o", f"m{suffix}")
    assert done.code == 0, done.err
    assert done.out.splitlines()[-1] == f"wrote m{suffix}"
    assert Path(f"m{suffix}").read_bytes().startswith(SIGNATURES[suffix])


def test_a_report_stands_alone_and_says_how_it_was_made(call: Call, table: Path) -> None:
    words = ("plot", table.name, "--metric", "*.overshoot", "-o", "m.html")
    assert call(*words).code == 0
    text = Path("m.html").read_text("utf-8")
    assert text.count("data:image/svg+xml;base64,") == 3
    assert not re.search(r"https?:", text)
    policy, _, rest = text.partition("Content-Security-Policy")[2].partition(">")
    assert "default-src 'none'" in policy
    assert "script-src" not in policy
    assert "<title>" in rest  # before all that it is about
    assert "turtlelog plot t.parquet --metric &#x27;*.overshoot&#x27; -o m.html" in text


def test_the_tornado_tells_what_it_left_out(call: Call, table: Path) -> None:
    done = call("plot", table.name, "--kind", "tornado", "--metric", "*.overshoot")
    assert done.code == 0
    assert done.flat.partition("too short ")[2] == " ".join(
        [
            "translate.overshoot: loop.transport_delay_ticks moves it by 144 %, from 0 % at 0 to"
            " 144 % at 12; over all values of the other keys by 24 % to 216 %",
            "translate.overshoot: law.kp_linear makes no difference",
            "translate.overshoot: 3 of 12 values of law.kp_linear have no value and are left out",
        ]
    )


def test_a_key_that_never_counts_is_told_in_one_sentence(call: Call, table: Path) -> None:
    write_table(
        table, GRID, {"run.duration": lambda delay, _: float(delay)}, units={"run.duration": "s"}
    )
    done = call("plot", table.name, "--kind", "tornado")
    assert done.flat.partition("kp_linear = 2) ")[2] == " ".join(
        [
            "run.duration: loop.transport_delay_ticks moves it by 12 s, from 0 s at 0 to 12 s at"
            " 12; over all values of the other keys by 12 s to 12 s",
            "run.duration: law.kp_linear makes no difference, whatever the other keys are",
        ]
    )


@pytest.mark.thorough
def test_a_report_of_a_sample_has_its_curves(call: Call, table: Path) -> None:
    plan = build_plan(["law.kp_linear=1.0:9.0", "goal.x_m=1.0:9.0"], (), Sampling(count=12))
    write_table(table, plan, {"run.duration": lambda kp, _: kp})
    assert call("plot", table.name, "-o", "m.html").code == 0
    text = Path("m.html").read_text("utf-8")
    assert [text.count(title) for title in ("<h2>Against one key", "<h2>How far each")] == [1, 1]


def test_a_table_of_failures_is_one_line(call: Call, table: Path) -> None:
    write_table(table, ["law.kp_linear=1:2"], {"run.duration": lambda _: "absent"})
    stored = read_result_table(table, kind="sweep")
    columns = tuple(
        replace(one, cells=["why", "why"]) if one.name == "failed" else one
        for one in stored.columns
    )
    write_result_table(replace(stored, columns=columns), table)
    done = call("plot", table.name)
    assert (done.code, done.out) == (2, "")
    assert "t.parquet: all rows failed" in done.err


def test_a_tornado_needs_a_key_that_varies(call: Call, table: Path) -> None:
    write_table(table, ["law.kp_linear=3"], {"run.duration": lambda _: 2.0})
    done = call("plot", table.name, "--kind", "tornado", "-o", "t.png")
    assert (done.code, done.out) == (2, "")
    assert "--kind tornado: no key varies in t.parquet" in done.err
    assert call("plot", table.name).code == 0


def test_a_value_is_held_where_at_says(call: Call, table: Path) -> None:
    told = call("plot", table.name, "--at", "loop.transport_delay_ticks=6", "--json").json
    assert (told["held"], told["shown"]) == ({"loop.transport_delay_ticks": 6}, 12)
    assert told["metrics"][1]["most"] == 6 * 18
    assert told["theory"][0]["columns"][0]["limits"]["stability"] == pytest.approx(15.07, abs=0.01)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--at", "seed=3"], "--at: expected a key that varies"),
        (["--at", "law.kp_linear"], "--at: expected key=value"),
        (["--metric", ","], "--metric ,: must be names separated by commas"),
        (
            ["--metric", "rotate.*"],
            't.parquet: no metric "rotate.*"; there are translate.stable',
        ),
        (["-o", "m.gif"], "--output m.gif: must be a name that ends in .pdf, .png, .svg"),
        (["-o", "none/m.png"], "none/m.png: there is no such folder"),
        (["--dpi", "100"], "--for, --text-width and --dpi need a figure to write: -o NAME.png"),
        (["-o", "m.rrd"], "--output m.rrd: a table becomes a figure or a report (.html); view"),
        (["-o", "m.html", "--for", "slide"], "--for, --text-width and --dpi need a figure"),
        (["-o", "m.svg", "--dpi", "100"], "--dpi: is for png files, not svg"),
        (["-o", "m.html", "--kind", "tornado"], "--kind tornado: m.html is no figure"),
    ],
)
def test_what_cannot_be_drawn_is_one_line(
    words: list[str], expected: str, call: Call, table: Path
) -> None:
    done = call("plot", table.name, *words)
    assert (done.code, done.out) == (2, "")
    (line,) = done.err.splitlines()
    assert line.startswith(f"turtlelog: error: {expected}")
    assert [path.name for path in table.parent.iterdir()] == ["t.parquet"]


@pytest.mark.parametrize("kind", ["empty", "cut", "csv", "other", "folder", "missing", "no rows"])
def test_what_is_no_table_of_a_sweep_is_one_line(kind: str, call: Call, table: Path) -> None:
    other = table.with_name(f"{kind}.parquet")
    if kind == "folder":
        other.mkdir()
    elif kind == "other":
        pq.write_table(pa.table({"a": [1]}), other)
    elif kind == "no rows":
        whole = read_result_table(table, kind="sweep")
        columns = tuple(replace(column, cells=[]) for column in whole.columns)
        write_result_table(replace(whole, columns=columns), other)
    elif kind != "missing":
        data = {"empty": b"", "cut": table.read_bytes()[:900], "csv": b"a,b\n1,2\n"}
        other.write_bytes(data[kind])
    done = call("plot", other, "-o", "m.png")
    assert (done.code, done.out) == (2, "")
    (line,) = done.err.splitlines()
    said = {
        "missing": "no such file",
        "folder": "no recordings in this folder",
        "other": "no column for ",
        "no rows": "the table has no rows",
    }.get(kind, "expected ")
    assert line.startswith(f"turtlelog: error: {other}: {said}")
    assert not Path("m.png").exists()


def test_the_measured_border_of_stability_is_theorys(
    call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Gains in steps of 1 over dead times of 3 to 12 ticks; the metric knows nothing of theory."""
    monkeypatch.chdir(tmp_path)
    grid = ("--grid", "law.kp_linear=1:40:1", "--grid", "loop.transport_delay_ticks=3:12:3")
    metrics = ("--metric", "translate.stable,translate.overshoot", "-o", "border.parquet")
    assert call("sweep", "textbook", *grid, *metrics).code == 0
    done = call("plot", "border.parquet")
    assert done.code == 0
    expected = (
        "translate.stable: the border lies within one cell of theory's line in 4 of 4 columns"
    )
    assert expected in done.flat


@pytest.mark.parametrize(
    ("spread", "said"),
    [
        (0.1, "best mean with law.kp_linear = 1 (seeds from row 0 on) 6 rows"),
        (2.0, "no clear best: over 3 seeds, all differences of these means may be chance 6 rows"),
    ],
)
def test_a_best_mean_is_told_if_it_is_more_than_chance(
    spread: float, said: str, call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    path = write_table(
        tmp_path / "s.parquet",
        ["law.kp_linear=1:2", "seed=0:2"],
        {"run.duration": lambda kp, seed: 8.0 + kp + (spread * (seed - 1) if kp > 1 else 0.0)},
        units={"run.duration": "s"},
    )
    done = call("plot", path.name)
    assert said in done.flat
    assert (" run --from " in done.out) is (spread < 1.0)
    assert call("plot", path.name, "-o", "m.html").code == 0
    text = Path("m.html").read_text("utf-8")
    assert "seed = 0" not in text
    assert ("mean with law.kp_linear = 1" in text) is (spread < 1.0)
    assert ("no clear best" in text) is (spread > 1.0)
