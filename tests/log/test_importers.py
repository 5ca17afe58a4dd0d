import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.log.runs import assert_same, find_shared, simulate_preset
from turtlelog.errors import LogError
from turtlelog.laws.sequential_p import DECLARATION
from turtlelog.log import import_log, read_recording, write_recording

ROWS = 4
Log = dict[str, Any]


def make_log() -> Log:
    """Return a log of the paper's layout with made-up values."""
    ramp = [0.25 * row for row in range(ROWS)]
    names = ["pos_theta", "target_angle_rad", "error_angle", "error_distance", "vel_linear_x"]
    names += ["vel_angular_z", "vel_x_global", "vel_y_global"]
    return {
        "metadata": {
            "experiment_name": "made",
            "timestamp": "2026-01-22T12:20:06.020038",
            "target_position": {"x": 2.0, "y": 10.0},
            "controller_gains": {"Kp_angular": 3.0, "Kp_linear": 4},
        },
        "data": {
            "time": [0.5 + value for value in ramp],
            "pos_x": ramp,
            "pos_y": ramp,
            **dict.fromkeys(names, ramp),
            "error_x": [2.0 - value for value in ramp],
            "error_y": [10.0 - value for value in ramp],
            "state": ["ROTACIONAR", "TRANSLADAR", "TRANSLADAR", "FINALIZADO"],
        },
    }


def write_json(log: Any, folder: Path) -> Path:
    path = folder / "log.json"
    path.write_text(json.dumps(log), encoding="utf-8")
    return path


def write_csv(log: Log, folder: Path) -> Path:
    names = [name if name != "error_angle" else "error_angle_rad" for name in log["data"]]
    with (folder / "log.csv").open("w", newline="", encoding="utf-8") as stream:
        csv.writer(stream).writerows([names, *zip(*log["data"].values(), strict=True)])
    return folder / "log.csv"


def reorder(log: Log, rows: list[int]) -> Log:
    data = {name: [values[row] for row in rows] for name, values in log["data"].items()}
    return log | {"data": data}


def test_json_becomes_a_run(tmp_path: Path) -> None:
    run = import_log(write_json(make_log(), tmp_path))
    assert (run.name, run.source, run.stop_reason) == ("made", "paper-json: log.json", "finished")
    assert run.poses.time_ns.tolist() == [0, 250_000_000, 500_000_000, 750_000_000]
    phases = [run.phase_names[number] for number in run.samples.phase]
    assert phases == ["rotate", "rotate", "translate", "translate"]
    assert run.declaration == DECLARATION
    assert run.samples.pose_sequence.tolist() == [0, 1, 2, 3]
    assert run.goal_xy_m == (2.0, 10.0)
    assert run.parameters["law.kp_linear"] == 4.0
    assert run.notes["original_timestamp"] == "2026-01-22T12:20:06.020038"
    assert run.is_complete
    assert not run.scenario_is_complete


def test_what_json_lacks_is_listed(tmp_path: Path) -> None:
    run = import_log(write_json(make_log(), tmp_path))
    assert run.poses.speed_m_s is run.samples.wanted_speed_m_s is None
    assert {"poses.speed_m_s", "samples.wanted_turn_rate_rad_s"} <= set(run.absent)
    assert "parameters.limits.speed_m_s" in run.absent
    assert "parameters.law.kp_linear" not in run.absent


def test_csv_becomes_the_same_columns(tmp_path: Path) -> None:
    log = make_log()
    of_json, of_csv = import_log(write_json(log, tmp_path)), import_log(write_csv(log, tmp_path))
    assert (of_csv.name, of_csv.source) == ("log", "paper-csv: log.csv")
    for table in ("poses", "commands", "samples"):
        assert_same(getattr(of_csv, table), getattr(of_json, table))
    assert (of_csv.goal_xy_m, dict(of_csv.parameters)) == ((2.0, 10.0), {})
    assert "parameters" in of_csv.absent


def test_a_goal_that_rows_disagree_on_is_absent(tmp_path: Path) -> None:
    log = make_log()
    log["data"]["error_x"][2] = 1.7
    run = import_log(write_csv(log, tmp_path))
    assert run.goal_xy_m is None
    assert "goal_xy_m" in run.absent


def test_a_log_that_does_not_finish_has_no_stop_reason(tmp_path: Path) -> None:
    run = import_log(write_json(reorder(make_log(), [0, 1, 2]), tmp_path))
    assert run.stop_reason is None
    assert not run.is_complete


@pytest.mark.parametrize("write", [write_json, write_csv])
def test_sorting_restores_the_run_and_counts(
    write: Callable[[Log, Path], Path], tmp_path: Path
) -> None:
    expected = import_log(write(make_log(), tmp_path))
    path = write(reorder(make_log(), [0, 2, 1, 2, 3, 0]), tmp_path)
    with pytest.raises(LogError, match=r"time\[2\]: expected more than 1\.0, found 0\.75.*--sort"):
        import_log(path)
    run = import_log(path, sort=True)
    assert_same(run.samples, expected.samples)
    assert_same(run.poses, expected.poses)
    assert (run.notes["sorted_rows"], run.notes["dropped_duplicates"]) == ("1", "2")


def test_rows_of_one_time_that_differ_are_refused_even_sorted(tmp_path: Path) -> None:
    log = make_log()
    log["data"]["time"][2] = log["data"]["time"][1]
    with pytest.raises(LogError, match=r"time\[2\].*two rows of one time differ"):
        import_log(write_json(log, tmp_path), sort=True)


@pytest.mark.parametrize(
    ("name", "index", "value", "message"),
    [
        ("pos_x", 1, float("nan"), r"data\.pos_x\[1\]: expected a finite number, found nan"),
        ("pos_y", 2, float("-inf"), r"data\.pos_y\[2\]: expected a finite number, found -inf"),
        ("time", 3, "1.0", r"data\.time\[3\]: expected a number, found '1\.0'"),
        ("error_x", 0, None, r"data\.error_x\[0\]: expected a number, found None"),
        ("error_x", 0, True, r"data\.error_x\[0\]: expected a number, found True"),
        ("error_y", 0, 10**400, r"data\.error_y\[0\]: expected a finite number, found 1000"),
        ("vel_linear_x", 0, [1], r"data\.vel_linear_x\[0\]: expected a number, found \[1\]"),
        ("state", 2, "PARADO", r"data\.state\[2\]: expected one of ROTACIONAR.*found 'PARADO'"),
        ("state", 2, 1, r"data\.state\[2\]: expected one of ROTACIONAR.*found 1"),
        (
            "time",
            0,
            0.75,
            r"time\[1\]: expected more than 0\.75, found 0\.75: importing with --sort",
        ),
    ],
)
def test_a_wrong_value_is_named(
    name: str, index: int, value: Any, message: str, tmp_path: Path
) -> None:
    log = make_log()
    log["data"][name] = [*log["data"][name]]
    log["data"][name][index] = value
    with pytest.raises(LogError, match=rf"log\.json: {message}"):
        import_log(write_json(log, tmp_path))


def test_a_missing_list_is_named(tmp_path: Path) -> None:
    log = make_log()
    del log["data"]["pos_theta"]
    with pytest.raises(LogError, match=r"data\.pos_theta: expected a list, found no value"):
        import_log(write_json(log, tmp_path))


def test_ragged_lists_are_named(tmp_path: Path) -> None:
    log = make_log()
    log["data"]["state"].pop()
    with pytest.raises(LogError, match=r"data\.state: expected 4 values as in .*, found 3"):
        import_log(write_json(log, tmp_path))


def test_a_log_without_rows_is_refused(tmp_path: Path) -> None:
    for path in (
        write_json(reorder(make_log(), []), tmp_path),
        write_csv(reorder(make_log(), []), tmp_path),
    ):
        with pytest.raises(LogError, match="time: no rows"):
            import_log(path)


def test_wrong_metadata_is_named(tmp_path: Path) -> None:
    log = make_log()
    log["metadata"]["controller_gains"]["Kp_linear"] = "4"
    with pytest.raises(LogError, match=r"metadata\.controller_gains\.Kp_linear: expected a number"):
        import_log(write_json(log, tmp_path))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"", "found an empty file"),
        (b" \n", "found an empty file"),
        (b"{", "expected JSON, found: "),
        (b"[1, 2]", "the file: expected a JSON object, as the paper's logs have it, found list"),
        (b"null", "the file: expected a JSON object"),
        (b"{}", "found no value; other data are read from CSV with a header"),
        (b'{"data": {}}', r"data\.time: expected a list, found no value"),
        (b'{"data": {}, "data": {}}', "data: expected one list of that name, found several"),
        (b"[" * 100_000, "nested too deeply"),
        (b'{"data": ' + b"9" * 5000 + b"}", "expected JSON, found: "),
        (b'{"data": "\xff"}', "byte 10: expected UTF-8 text, found 0xff"),
        (b"\x00\x00\x00", "only zero bytes; copy the file again from its source"),
        (b"\x89MCAP0\r\n", "expected a log in JSON or CSV, found MCAP, which is read as it is"),
    ],
)
def test_json_that_is_no_log_is_one_line(text: bytes, message: str, tmp_path: Path) -> None:
    path = tmp_path / "log.json"
    path.write_bytes(text)
    with pytest.raises(LogError, match=rf"\A\S+log\.json: [^\n]*{message}[^\n]*\Z"):
        import_log(path)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("pos_theta", "heading", "line 1: expected a column pos_theta, found 0 in"),
        ("pos_y", "pos_x", "line 1: expected a column pos_x, found 2 in"),
        ("0.75,", "", "row 1: expected 14 values, found 13"),
        ("0.75", "x", r"time\[1\]: expected a number, found 'x'"),
        ("0.75", "nan", r"time\[1\]: expected a finite number, found nan"),
        ("ROTACIONAR", "", r"state\[0\]: expected one of ROTACIONAR"),
        (
            "ROTACIONAR",
            '"ROT',
            r"expected CSV, found a cell that goes on to the end of the file; look for a quote",
        ),
        ("ROTACIONAR", "\0", r"log\.csv: "),
    ],
)
def test_csv_that_is_no_log_is_one_line(old: str, new: str, message: str, tmp_path: Path) -> None:
    path = write_csv(make_log(), tmp_path)
    path.write_text(path.read_text(encoding="utf-8").replace(old, new, 1), encoding="utf-8")
    with pytest.raises(LogError, match=rf"\A\S+log\.csv: [^\n]*{message}[^\n]*\Z|{message}"):
        import_log(path)


def test_a_log_of_any_name_is_told_by_its_content(tmp_path: Path) -> None:
    for path in (write_json(make_log(), tmp_path), write_csv(make_log(), tmp_path)):
        expected = import_log(path)
        other = path.rename(tmp_path / "log.txt")
        assert_same(import_log(other).samples, expected.samples)


def test_a_byte_order_mark_does_no_harm(tmp_path: Path) -> None:
    path = write_csv(make_log(), tmp_path)
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert len(import_log(path).samples) == ROWS


PAPER = ["kp1_210.json", "kp1_210_main.csv", "kp4_210.json", "kp4_210_main.csv"]


@pytest.mark.parametrize("name", PAPER)
def test_a_log_of_the_paper_survives_a_recording(name: str, tmp_path: Path) -> None:
    run = import_log(find_shared("paper", name))
    write_recording(run, tmp_path / "run.mcap")
    assert_same(read_recording(tmp_path / "run.mcap"), run)


@pytest.mark.parametrize("kp", [1, 4])
def test_the_papers_csv_holds_what_its_json_holds(kp: int) -> None:
    of_json = import_log(find_shared("paper", f"kp{kp}_210.json"))
    of_csv = import_log(find_shared("paper", f"kp{kp}_210_main.csv"))
    assert_same(of_csv.samples, of_json.samples)
    assert_same(of_csv.poses, of_json.poses)
    assert of_csv.goal_xy_m == of_json.goal_xy_m == (2.0, 10.0)


@pytest.mark.parametrize("kp", [1, 4])
def test_a_simulation_reproduces_the_papers_log_bit_for_bit(kp: int) -> None:
    logged = import_log(find_shared("paper", f"kp{kp}_210.json"))
    run = simulate_preset(f"paper-kp{kp}")
    read = run.samples.pose_sequence
    assert np.array_equal(run.poses.xy_m[read], logged.poses.xy_m)
    assert np.array_equal(run.poses.heading_rad[read], logged.poses.heading_rad)
    for name in ("sequence", "phase", "bearing_rad", "heading_error_rad", "error_xy_m"):
        assert np.array_equal(getattr(run.samples, name), getattr(logged.samples, name)), name
    for name in ("distance_m", "speed_m_s", "turn_rate_rad_s", "world_velocity_m_s"):
        assert np.array_equal(getattr(run.samples, name), getattr(logged.samples, name)), name
    assert np.array_equal(run.commands.speed_m_s, logged.commands.speed_m_s)
    assert np.array_equal(run.commands.turn_rate_rad_s, logged.commands.turn_rate_rad_s)
    assert {key: run.parameters[key] for key in logged.parameters} == logged.parameters
