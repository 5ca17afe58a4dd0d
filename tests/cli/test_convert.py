import csv
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import turtlelog as tl
from tests.cli.conftest import Call
from tests.log.test_importers import make_log, reorder, write_json
from turtlelog.run import TABLES, tabulate_run


@pytest.mark.parametrize("target", ["out.mcap", "bag"])
def test_poses_stand_once_more_for_other_programs_unless_that_is_declined(
    call: Call, kp4: Path, tmp_path: Path, target: str
) -> None:
    shared = {"/odom", "/tf", "/path"}
    for words, expected in (((), shared), (("--own-topics",), set())):
        assert call("convert", kp4, "-o", tmp_path / target, *words).code == 0
        (found,) = call("info", tmp_path / target, "--json").json
        assert {topic["topic"] for topic in found["topics"]} & shared == expected
        (tmp_path / target).rename(tmp_path / f"{target}{len(words)}")


def test_a_name_without_a_suffix_is_a_bag_that_metrics_reads(
    call: Call, kp4: Path, tmp_path: Path
) -> None:
    answer = call("convert", kp4, "-o", tmp_path / "bag")
    assert (answer.code, answer.err) == (0, "")
    head, *written = answer.out.splitlines()
    assert head.startswith("bag: 705 poses, 681 commands, 681 samples and 3 events of kp4.mcap")
    assert written[1:] == [
        f"wrote {tmp_path / 'bag' / name}" for name in ("bag_0.mcap", "metadata.yaml")
    ]
    (of_bag,), (of_file,) = (
        call("metrics", path, "--json").json for path in (tmp_path / "bag", kp4)
    )
    assert of_bag["metrics"] == of_file["metrics"]


def test_several_kinds_are_written_at_once_and_answered_in_json(
    call: Call, kp4: Path, tmp_path: Path
) -> None:
    one, many = tmp_path / "events.csv", tmp_path / "tables"
    words = ("-o", one, "-o", many, "--format", "parquet", "--table", "events", "--json")
    answer = call("convert", kp4, *words).json
    assert answer == {
        "file": str(kp4),
        "name": "paper-kp4",
        "written": [str(one), str(many / "events.parquet")],
        "absent": [],
        "notes": [],
    }
    assert all(Path(path).exists() for path in answer["written"])


def test_a_folder_of_tables_holds_every_table(call: Call, kp4: Path, tmp_path: Path) -> None:
    assert call("convert", kp4, "-o", tmp_path / "out", "--format", "csv").code == 0
    with (tmp_path / "out" / "samples.csv").open() as stream:
        assert len([*csv.reader(stream)]) == 1 + len(tl.read_recording(kp4).samples)


def test_csv_tables_without_facts_become_a_recording_with_the_same_rows(
    call: Call, kp4: Path, tmp_path: Path
) -> None:
    tables, again = tmp_path / "run7", tmp_path / "again.mcap"
    call("convert", kp4, "-o", tables, "--format", "csv")
    (tables / "run.json").unlink()
    answer = call("convert", tables, "-o", again, "--json").json
    assert answer["name"] == "run7"
    assert answer["absent"] == [
        *("declaration", "goal_xy_m", "goal_heading_rad", "parameters", "stop_reason")
    ]
    first, second = (tl.read_recording(path) for path in (kp4, again))
    for table in TABLES:
        expected, found = (tabulate_run(run, table) for run in (first, second))
        assert [*expected] == [*found]
        for name, values in expected.items():
            assert np.array_equal(values, found[name], equal_nan=values.dtype.kind == "f")


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_tables_become_the_recording_that_they_were(
    call: Call, kp4: Path, tmp_path: Path, kind: str
) -> None:
    tables, again = tmp_path / "run7", tmp_path / "again.mcap"
    call("convert", kp4, "-o", tables, "--format", kind)
    words = ("--own-topics", "--json")
    assert call("convert", tables, "-o", again, *words).json["absent"] == []
    assert again.read_bytes() == kp4.read_bytes()


def test_samples_of_an_unknown_controller_give_no_error_at_the_end(
    call: Call, tmp_path: Path
) -> None:
    """The recorded error is that of the rotation, 0.02 deg; the robot drives 15.5 deg beside it."""
    run, tables, again = tmp_path / "wrap.mcap", tmp_path / "wrap", tmp_path / "again.mcap"
    keys = ("start.heading_rad=2.6", "limits.turn_rate_rad_s=inf", "loop.transport_delay_ticks=8")
    changes = [word for key in keys for word in ("--set", key)]
    call("run", "textbook", "--kp", "8", "--goal", "2,4.5", *changes, "-o", run)
    ids = ["final.heading_error", "final.cross_track", "final.position_error"]

    def read_values(path: Path) -> list[float | None]:
        found = tl.measure_run(tl.read_run(path), only=ids)
        return [found[name].value for name in ids]

    call("convert", run, "-o", tables, "--format", "csv")
    assert read_values(tables) == read_values(run)
    assert read_values(run)[0] == pytest.approx(15.527, abs=0.001)
    (tables / "run.json").unlink()
    assert read_values(tables) == [None, None, None]
    assert call("convert", tables, "--goal", "2,4.5", "-o", again).code == 0
    assert read_values(again) == [None, *read_values(run)[1:]]


def test_poses_alone_become_a_recording_of_poses(call: Call, kp4: Path, tmp_path: Path) -> None:
    poses, again = tmp_path / "poses.csv", tmp_path / "again.mcap"
    answer = call("convert", kp4, "-o", poses)
    assert f"{poses} holds the poses alone: --table chooses another" in answer.flat
    answer = call("convert", poses, "-o", again)
    assert f"absent in {poses}: commands, samples, events, declaration, goal_xy_m" in answer.flat
    assert len(tl.read_recording(again).poses) == 705
    alone = tmp_path / "alone.csv"
    alone.write_text("".join(poses.read_text().splitlines(keepends=True)[:2]))
    answer = call("convert", alone, "-o", tmp_path / "alone.mcap")
    assert answer.flat.startswith("alone.mcap: 1 pose of alone.csv")
    info, of_recording = call("info", poses, again, "--json").json
    assert info["duration_s"] == of_recording["duration_s"] == 11.264


def test_states_and_guarded_texts_come_back(call: Call, kp4: Path, tmp_path: Path) -> None:
    run = tl.read_recording(kp4)
    event = replace(run.events[0], text="=1+1, said\nsomebody")
    states = np.arange(2.0 * len(run.samples)).reshape(-1, 2)
    run = replace(
        run,
        events=(event,),
        declaration=replace(run.declaration, states=("integral", "time_ns")),
        samples=replace(run.samples, states=states),
    )
    tl.log.export_csv(run, tmp_path / "odd")
    found = tl.read_run(tmp_path / "odd")
    assert found.events == (event,)
    assert found.declaration.states == ("integral", "time_ns")
    assert np.array_equal(found.samples.states, states)  # type: ignore[arg-type]


def test_a_log_out_of_order_is_sorted_where_that_is_asked(call: Call, tmp_path: Path) -> None:
    log = make_log()
    log = reorder(log, [0, 2, 1, 3])
    path = write_json(log, tmp_path)
    assert call("convert", path, "-o", tmp_path / "a.mcap").code == 2
    answer = call("convert", path, "-o", tmp_path / "a.mcap", "--sort")
    assert answer.code == 0
    assert "sorted rows: 1" in answer.flat
    assert "dropped duplicates" not in answer.flat  # 0 changes nothing


@pytest.mark.parametrize("target", ["again.mcap", "bag", "poses.csv", "poses.parquet"])
def test_what_reads_back_differently_is_refused(
    call: Call, kp4: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, target: str
) -> None:
    def bend(run: tl.Run) -> tl.Run:
        xy_m = run.poses.xy_m.copy()
        xy_m[-1, 0] += 1e-6
        return replace(run, poses=replace(run.poses, xy_m=xy_m))

    writers = [(tl, "write_recording")]
    writers += [(tl.log, name) for name in ("export_rosbag2", "export_csv", "export_parquet")]
    for room, name in writers:
        right = getattr(room, name)

        def write(run: tl.Run, path: Path, right: Any = right, **options: Any) -> Any:
            return right(bend(run), path, **options)

        monkeypatch.setattr(room, name, write)
    answer = call("convert", kp4, "-o", tmp_path / target)
    assert (answer.code, answer.out) == (2, "")
    line = "expected to read back what was written, found other values in x_m of poses"
    assert line in answer.err


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["run.mcap"], "--output"),
        (["run.mcap", "-o", "a", "--table", "poses"], "--table: a is no table"),
        (["run.mcap", "-o", "a.cvs"], "a.cvs: convert writes .mcap, .csv, .parquet and .tum files"),
        (
            ["run.mcap", "-o", "a.csv", "--format", "csv"],
            "--to: leave it out, the name a.csv says it",
        ),
        (["in.csv", "-o", "in.csv"], "this is the input; name another file"),
        (["run.mcap", "-o", "full"], "full: this folder has files; name a new"),
        (["run.mcap", "-o", "no/such/a.csv"], "there is no such folder to write to"),
        (["run.mcap", "-o", "a.csv", "--table", "pose"], "pose"),
        (["none.mcap", "-o", "a.csv"], "none.mcap: no such file"),
        (["events.csv", "-o", "a.mcap"], "expected the poses of a run, found its events alone"),
        (["ragged.csv", "-o", "a.mcap"], "ragged.csv: row 2: expected 4 cells, found 3"),
        (["words.csv", "-o", "a.mcap"], "words.csv: x_m[0]: expected a number, found 'here'"),
        (["back.csv", "-o", "a.mcap"], "back.csv: pose.time_ns: expected strictly increasing"),
        (
            ["wrong.parquet", "-o", "a.mcap"],
            "wrong.parquet: expected a complete Parquet file, found",
        ),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_bad_conversions_are_one_line(
    call: Call,
    kp4: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    words: list[str],
    line: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("run.mcap").write_bytes(kp4.read_bytes())
    Path("in.csv").touch()
    Path("full").mkdir()
    Path("full", "mine").touch()
    head = "time_ns,x_m,y_m,heading_rad\n"
    Path("events.csv").write_text("time_ns,kind,text\n0,stop,over\n")
    Path("ragged.csv").write_text(f"{head}0,1,2,0\n1,1,2\n")
    Path("words.csv").write_text(f"{head}0,here,2,0\n")
    Path("back.csv").write_text(f"{head}5,1,2,0\n1,1,2,0\n")
    Path("wrong.parquet").write_text("PAR")
    before = sorted(path.name for path in tmp_path.iterdir())
    answer = call("convert", *words)
    assert (answer.code, answer.out) == (2, "")
    assert line in answer.err
    assert answer.err.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == before


@pytest.mark.skipif(sys.platform == "win32", reason="links need a privilege there")
def test_a_link_that_leads_in_a_circle_is_no_new_folder(
    call: Call, kp4: Path, tmp_path: Path
) -> None:
    circle = tmp_path / "circle"
    circle.symlink_to(circle)
    answer = call("convert", kp4, "-o", circle)
    assert (answer.code, answer.out) == (2, "")
    assert answer.err.endswith(": this is a file; name a new folder\n")


def test_a_trajectory_is_written_and_read_back(call: Call, kp4: Path, tmp_path: Path) -> None:
    text, other = tmp_path / "kp4.txt", tmp_path / "kp4.tum"
    answer = call("convert", kp4, "-o", text, "-o", other, "--to", "tum")
    assert (answer.code, answer.err) == (0, "")
    assert answer.out.startswith("kp4.txt: 705 poses of kp4.mcap, read back and equal.\n")
    assert answer.flat.endswith(
        f"{other} holds the poses alone, without commands, goal and scenario"
    )
    assert text.read_bytes() == other.read_bytes()
    again = tmp_path / "again.mcap"
    assert call("convert", other, "-o", again).code == 0
    expected, found = (tl.read_recording(path).poses for path in (kp4, again))
    assert np.array_equal(expected.xy_m, found.xy_m)
    assert np.array_equal(expected.time_ns, found.time_ns)
    for name in ("kp4", "kp4.csv"):
        answer = call("convert", kp4, "-o", tmp_path / name, "--to", "tum")
        assert answer.code == 2
        assert "must be a name that ends in .tum or .txt" in answer.err


def test_measured_rates_are_not_called_absent(call: Call, tmp_path: Path) -> None:
    table = tmp_path / "drive.csv"
    table.write_text("t,x,y,yaw,v\n0,0,0,0,1\n1,1,0,0,1\n")
    answer = call("convert", table, "-o", tmp_path / "poses.csv")
    told = "poses.speed_m_s (applied, not measured), poses.turn_rate_rad_s, samples"
    assert told in answer.flat
