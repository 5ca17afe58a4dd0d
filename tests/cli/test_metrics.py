import csv
import importlib
import io
import pickle
import re
import shutil
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import turtlelog as tl
from tests.cli.conftest import Call
from tests.sequential import ESSENTIAL_METRICS, METRICS
from turtlelog import processes


def write_textbook(file: Path, changes: dict[str, Any]) -> None:
    scenario = tl.override_scenario(tl.load_scenario("textbook"), changes)
    tl.write_recording(tl.simulate_run(scenario), file)


def test_a_newcomer_sees_the_end_first_and_then_the_loops_side_by_side(
    call: Call, kp10: Path
) -> None:
    lines = call("metrics", kp10).out.splitlines()
    assert lines[:3] == [
        "kp10.mcap: missed the goal by 0.107 m (allowed: 0.00669 m) after 12.6 s.",
        "The end is 0.107 m right of the line from start to goal.",
        "Final heading error: 1.07 deg.",
    ]
    assert lines[3:5] == ["Why? turtlelog explain \\", f"  {kp10}"]  # so that it can be pasted
    assert lines[6].split() == ["rotate", "translate"]
    rows = {line[:18].strip(): line[18:].split("  ") for line in lines[8:16]}
    assert [cell.strip() for cell in rows["saturated samples"] if cell] == ["87 %", "59 %"]
    assert "longest silence of the controller 0.528 s." in " ".join(" ".join(lines).split())
    assert [cell.strip() for cell in rows["settling time"] if cell] == ["2.21 s", "5.58 s"]
    assert [cell.strip() for cell in rows["overshoot"] if cell] == ["1.01 %", "0.945 %"]
    assert [cell.strip() for cell in rows["dead time"] if cell] == ["0.064 s", "0.096 s"]
    assert lines[-1] == f"All {len(METRICS)} metrics with their ids: turtlelog metrics {kp10} --all"
    assert len(lines) <= 40
    assert max(map(len, [line for line in lines if str(kp10) not in line])) <= 80


def test_a_loop_that_never_settles_is_said_before_the_table(call: Call, tmp_path: Path) -> None:
    file = tmp_path / "swinging.mcap"
    changes = {
        "law.kp_angular": 60.0,
        "law.kp_linear": 60.0,
        "loop.transport_delay_ticks": 6,
        "max_duration_s": 5.0,
    }
    write_textbook(file, changes)
    head, *table = call("metrics", file).out.split("\n\n")
    assert head.startswith("swinging.mcap: missed the goal by 5.69 m (allowed: 0.00669 m) after ")
    words = head.splitlines()
    assert "The oscillation does not die out: rotate." in words
    assert "rotate does not settle: the phase ends outside the 2 % band." in words
    assert "translate has no values: the run has no phase translate." in words
    assert table[0].split()[:1] == ["rotate"]


def test_swings_that_outliers_cause_are_no_oscillation(call: Call, tmp_path: Path) -> None:
    file = tmp_path / "outliers.mcap"
    kicks = {"outlier_probability": 0.05, "outlier_m": 2.0, "outlier_rad": 3.0}
    gains = {"law.kp_angular": 2.0, "law.kp_linear": 2.0}
    write_textbook(file, {**gains, **{f"sensing.{key}": one for key, one in kicks.items()}})
    answer = call("metrics", file)
    told = "Irregular swings, which hide whether the loop is stable: rotate and translate."
    assert told in answer.flat
    words = answer.out.splitlines()
    assert not any("die out" in line for line in words)


@pytest.mark.parametrize(
    ("law", "first"),
    [
        ("posture", "reached the goal within 1.27 mm after 12.4 s. Final heading error: 0.00429"),
        ("open-loop", "the path is 0 m long and takes 2.4 s."),
    ],
)
def test_the_first_line_holds_for_other_laws(
    call: Call, tmp_path: Path, law: str, first: str
) -> None:
    file = tmp_path / "other.mcap"
    write_textbook(file, {"law.kind": law})
    lines = call("metrics", file).out.splitlines()
    assert " ".join(lines).startswith(f"other.mcap: {first} ")
    assert len(lines) <= 40
    assert max(map(len, [line for line in lines if str(file) not in line])) <= 80


def test_all_shows_every_metric_and_why_values_are_missing(call: Call, kp4: Path) -> None:
    out = call("metrics", kp4, "--all").out
    assert out.startswith("kp4.mcap: missed the goal by 8.52 mm (allowed: 6.69 mm) after")
    assert all(re.search(rf"^{re.escape(name)} ", out, re.M) for name in METRICS)
    assert "not reached: the response does not overshoot twice." in out
    assert "--all" not in out
    assert max(map(len, out.splitlines())) <= 80


def test_only_takes_ids_and_patterns(call: Call, kp4: Path) -> None:
    (answer,) = call("metrics", kp4, "--json", "--metric", "final.*, rotate.overshoot").json
    ids = [metric["id"] for metric in answer["metrics"]]
    assert ids[0] == "rotate.overshoot"
    assert ids[1:] == [name for name in METRICS if name.startswith("final.")]


def test_json_holds_every_metric_and_when_it_was_taken(call: Call, kp10: Path) -> None:
    (answer,) = call("metrics", kp10, "--json").json
    metrics = {metric["id"]: metric for metric in answer["metrics"]}
    assert list(metrics) == list(METRICS)
    assert metrics["rotate.overshoot"]["at_s"] == pytest.approx(2.336)
    assert metrics["rotate.decay_ratio"]["value"] is None
    assert metrics["rotate.decay_ratio"]["status"] == "not_reached"


def test_csv_has_a_row_per_file_with_full_precision(call: Call, kp4: Path, kp10: Path) -> None:
    rows = list(csv.DictReader(io.StringIO(call("metrics", kp4, kp10, "--csv").out)))
    assert [row["file"] for row in rows] == [str(kp4), str(kp10)]
    expected = tl.measure_run(tl.read_recording(kp10))["rotate.overshoot"].value
    assert float(rows[1]["rotate.overshoot [%]"]) == expected
    assert rows[1]["rotate.decay_ratio [1]"] == "not_reached"
    assert len(rows[0]) == 2 + len(METRICS)


@pytest.mark.thorough
def test_csv_of_many_files_keeps_their_values_alone(call: Call, kp4: Path, tmp_path: Path) -> None:
    """Memory is traced while 80 recordings are measured, which takes long.

    Of a run its summary would be 17 kB; its row of text is 2.6 kB.
    """
    files = [Path(shutil.copy(kp4, tmp_path / f"{number}.mcap")) for number in range(60)]
    call("metrics", *files[:2], "--csv", "--jobs", "1")
    peaks = []
    for count in (20, 60):
        tracemalloc.start()
        done = call("metrics", *files[:count], "--csv", "--jobs", "1")
        peaks.append(tracemalloc.get_traced_memory()[1] - len(done.out))
        tracemalloc.stop()
        assert done.out.count("\n") == 1 + count
    assert peaks[1] - peaks[0] < 40 * 12_000


@pytest.mark.parametrize(
    ("option", "line"),
    [
        ("--markdown", "| run.duration | s | 11.184 |"),
        ("--latex", r"run.duration & s & 11.184 \\"),
    ],
)
def test_tables_for_texts_hold_the_same(call: Call, kp4: Path, option: str, line: str) -> None:
    assert line in call("metrics", kp4, option).out


def test_more_than_six_runs_have_a_row_each(call: Call, kp4: Path, tmp_path: Path) -> None:
    files = [Path(shutil.copy(kp4, tmp_path / f"{number}.mcap")) for number in range(7)]
    out = call("metrics", *files, "--metric", "run.duration").out
    assert out.startswith("7 runs: run.duration 11.2 s (all).\n")
    rows = [line.split() for line in out.splitlines() if ".mcap" in line]
    assert len(rows) == 7
    assert all(row[-1] == "11.184" for row in rows)


def test_seven_runs_show_the_same_metrics_as_six(call: Call, kp4: Path, tmp_path: Path) -> None:
    files = [Path(shutil.copy(kp4, tmp_path / f"{number}.mcap")) for number in range(7)]
    rows = [line.split(" | ") for line in call("metrics", *files, "--markdown").out.splitlines()]
    (titles,) = [row for row in rows if row[0] == "| run"]
    shown = [title.split(" ")[0] for title in titles[2:]]
    assert shown == [name for name in METRICS if name in ESSENTIAL_METRICS]


def test_runs_have_a_row_each_in_order_of_their_gains(call: Call, kp4: Path, kp10: Path) -> None:
    lines = call("metrics", kp10, kp4).out.splitlines()
    first = (
        "2 runs: none reaches the goal; the ends are 0.00852 m (paper-kp4) to 0.107 m (paper-kp10) "
    )
    assert " ".join(lines).startswith(first)
    assert "after 11.2 s (paper-kp4) to 12.6 s (paper-kp10)." in " ".join(lines[:2])
    rows = [line.split() for line in lines if line.startswith("paper-")]
    assert [row[0] for row in rows] == ["paper-kp4", "paper-kp10"]
    assert rows[1][1:] == ["10", "1.01", "2.21", "0.945", "5.58", "0.107", "12.6"]
    assert max(map(len, lines)) <= 80
    listed = call("metrics", kp10, kp4, "--json").json
    assert [found["name"] for found in listed] == ["paper-kp10", "paper-kp4"]


def test_thirty_runs_with_long_names_fit_a_page(call: Call, tmp_path: Path) -> None:
    first = tmp_path / "a_recording_with_a_long_name_00.mcap"
    write_textbook(first, {"max_duration_s": 1.0})
    others = [first.with_name(f"{first.stem[:-2]}{number:02}.mcap") for number in range(1, 30)]
    files = [first, *(Path(shutil.copy(first, other)) for other in others)]
    lines = call("metrics", *files).out.splitlines()
    rows = [line.split()[0] for line in lines if line.startswith("a_record")]
    assert rows == [f"a_record..._name_{number:02}.mcap" for number in range(30)]
    assert len(lines) <= 50
    assert max(map(len, lines)) <= 80


@pytest.mark.parametrize("command", ["metrics", "compare"])
def test_runs_of_one_name_are_called_by_their_files(
    call: Call, kp4: Path, tmp_path: Path, command: str
) -> None:
    (tmp_path / "other").mkdir()
    near, far = (shutil.copy(kp4, tmp_path / name) for name in ("a.mcap", "other/a.mcap"))
    out = call(command, kp4, near, "--csv" if command == "compare" else "--markdown").out
    assert "kp4.mcap" in out
    assert "a.mcap" in out
    assert "paper-kp4" not in out
    # Files of one name are told apart by their paths.
    out = call(command, near, far, "--csv" if command == "compare" else "--markdown").out
    assert str(near) in out
    assert str(far) in out


@pytest.mark.thorough
def test_files_are_measured_in_several_processes_in_their_order(
    call: Call, kp4: Path, kp10: Path
) -> None:
    files = [kp10, "none.mcap", kp4, "other.mcap", kp10]
    alone, together = (call("metrics", *files, "--json", "--jobs", jobs) for jobs in ("1", "2"))
    assert together == alone
    assert [one["file"] for one in alone.json] == [str(kp10), str(kp4), str(kp10)]


def test_long_work_is_shared_by_as_many_processes_as_cores(
    call: Call, kp4: Path, kp10: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    spec = tmp_path / "spec.toml"
    spec.write_text('format = 1\n[checks.a]\nexpect = "run.duration < 12"\n')
    words = [("compare",), ("check", spec), ("info", "--json")]
    alone = [call(*one, kp10, "none.mcap", kp4) for one in words]
    started: list[str] = []
    monkeypatch.setattr(processes, "LONG_S", 0.0)
    monkeypatch.setattr(processes, "count_cores", lambda: 2)
    for name in ("compare.run_summary", "cli.check", "cli.info"):
        module = importlib.import_module(f"turtlelog.{name}")
        monkeypatch.setattr(module, "map_in_processes", pickle_both_ways(module.__name__, started))
    together = [call(*one, kp10, "none.mcap", kp4) for one in words]
    assert together == alone
    assert [name.rpartition(".")[2] for name in started] == [
        "run_summary",
        "check",
        "info",
    ]


def pickle_both_ways(name: str, started: list[str]) -> Callable[..., Any]:
    """Stand for processes, which take a second to start: what goes to and fro is pickled."""

    def work(do: Any, items: Any, jobs: int) -> Any:
        assert jobs == 2
        started.append(name)
        do = pickle.loads(pickle.dumps(do))
        for item in items:
            yield pickle.loads(pickle.dumps(do(item)))

    return work


def test_a_file_that_cannot_be_read_does_not_stop_the_others(call: Call, kp4: Path) -> None:
    for options in ([], ["--json"], ["--jobs", "2"]):
        answer = call("metrics", "none.mcap", kp4, "--metric", "run.duration", *options)
        assert answer.code == 2
        assert "none.mcap: no such file" in answer.err
        assert "11.184" in answer.out
    assert call("metrics", "none.mcap", "--json").json == []


def test_band_initial_and_final_change_the_step(call: Call, kp4: Path) -> None:
    def read(name: str, *options: str) -> float:
        (answer,) = call("metrics", kp4, "--json", "--metric", name, *options).json
        return float(answer["metrics"][0]["value"])

    assert read("rotate.settling_time", "--band", "0.05") < read("rotate.settling_time")
    assert read("translate.overshoot", "--final", "translate=5") > 13.0
    assert read("rotate.steady_state_error", "--final", "last") == 0.0
    assert read("translate.rise_time", "--initial", "translate=-0.5") > read("translate.rise_time")


def test_a_reference_path_and_a_dead_time_can_be_given(
    call: Call, kp4: Path, tmp_path: Path
) -> None:
    path = tmp_path / "path.csv"
    path.write_text("x,y\n0,0\n12,0\n")
    (answer,) = call(
        "metrics", kp4, "--metric", "run.cross_track_max", "--reference-path", path, "--json"
    ).json
    assert answer["metrics"][0]["value"] == pytest.approx(10.0, abs=0.01)
    words = ("--metric", "rotate.*_deviation_rms", "--dead-time", "0", "--json")
    _, sampled, delayed = call("metrics", kp4, *words).json[0]["metrics"]
    assert sampled["value"] == delayed["value"]


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["--metric", "rotate.overshot"], 'no metric "rotate.overshot"; did you mean rotate.over'),
        (["--metric", "nonsense.*"], 'no metric "nonsense.*"; list: turtlelog list metrics'),
        (["--metric", "a,,b"], "--metric a,,b: must be names separated by commas"),
        (["--metric", ""], "--metric : must be names separated by commas"),
        (
            ["--band", "0"],
            "--band: must be a fraction of the step from 0 to 1, as 0.02 for 2 %, not 0.0",
        ),
        (
            ["--band", "2"],
            "--band: must be a fraction of the step from 0 to 1, as 0.02 for 2 %, not 2.0",
        ),
        (
            ["--band", "nan"],
            "--band: must be a fraction of the step from 0 to 1, as 0.02 for 2 %, not nan",
        ),
        (["--band", "wide"], "--band wide: must be a number"),
        (["--final", "end"], "--final end: must be reference, last, a number or LOOP=VALUE"),
        (["--final", "pause=1"], "--final: expected a loop rotate or translate, found 'pause'"),
        (["--initial", "a=1"], "error: --initial: expected a loop rotate or translate, found 'a'"),
        (["--final", "inf"], "--final: expected 'reference', 'last' or a number, found inf"),
        (["--initial", "last"], "--initial last: must be a number or LOOP=VALUE"),
        (["--initial", "rotate="], "--initial : must be a number or LOOP=VALUE"),
        (
            ["--dead-time", "-1"],
            "--dead-time: expected a whole number from 0 to 1000, found -1",
        ),
        (["--dead-time", "1001"], "expected a whole number from 0 to 1000, found 1001"),
        (["--reference-path", "none.csv"], "none.csv: expected a file of points, found: No such"),
        (["--jobs", "0"], "--jobs 0: must be at least 1"),
        (["--jobs", "1.5"], "--jobs 1.5: must be a whole number"),
        (["--dead-time", "1.5"], "--dead-time 1.5: must be a whole number of ticks"),
        (["--csv", "--json"], "--csv and --json: choose one format"),
        (["--markdown", "--latex"], "--markdown and --latex: choose one format"),
    ],
)
def test_bad_usage_is_one_line(call: Call, kp4: Path, words: list[str], line: str) -> None:
    answer = call("metrics", kp4, *words)
    assert (answer.code, answer.out) == (2, "")
    assert answer.err.count("\n") == 1
    assert line in answer.err


def test_the_first_line_says_what_a_table_contradicts(call: Call, tmp_path: Path) -> None:
    file = tmp_path / "drive.csv"
    once = [f"{step},{step},0,0" for step in range(20)]
    for rows, told in (
        (once, "drive.csv: the path is 19 m long and takes 19 s."),
        ([*once, *once], "drive.csv: the path is 19 m long and takes 19 s, in run 1 of 2 in the"),
        ([f"{6 * step},{step},0,0" for step in range(20)], "takes 114 s, in units that are unlik"),
        ([f"1,{step},0,0" for step in range(20)], ", but the times of most poses are wrong."),
    ):
        file.write_text("\n".join(["t,x,y,yaw", *rows]))
        assert told in call("metrics", file).flat.partition(" metric ")[0]


@pytest.mark.parametrize(
    ("speed", "told"),
    [(1.0, "the robot reports; "), (3.6, "reports, and the poses contradict them; ")],
)
def test_reported_rates_that_the_poses_contradict_are_no_facts(
    call: Call, tmp_path: Path, speed: float, told: str
) -> None:
    file = tmp_path / "drive.csv"
    rows = [f"{step},{step},0,0,{speed}" for step in range(20)]
    file.write_text("\n".join(["t,x,y,yaw,v", *rows]))
    assert f"{told}the turn rate is a difference of poses." in call("metrics", file).flat


def test_a_heading_loop_whose_reference_moves_is_told_apart_from_the_final_heading(
    call: Call, tmp_path: Path
) -> None:
    """The posture law keeps turning until it stops: the bearing of a near goal moves fast."""
    words = ("run", "posture", "--goal", "5.544,3", "--kp", "2", "-o", tmp_path / "posture.mcap")
    told = " ".join(call(*words).out.split())
    assert "Final heading error: 0.0539 deg." in told
    follows = "align follows a bearing that moves with the robot: its final loop error is not the"
    assert f"{follows} final heading error." in told
    assert "follows a bearing" not in call("run", "textbook").out
