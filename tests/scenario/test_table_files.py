"""Files of commands that a scenario file names, and commands that are taken out of a run."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import turtlelog as tl
from turtlelog.errors import ScenarioError
from turtlelog.laws.open_loop import MOST_ROWS
from turtlelog.run.paths import MOST_POINTS
from turtlelog.scenario import PAPER_RUNS, load_scenario, parse_scenario, replay_commands

LAW = '[law]\nkind = "open-loop"\nfile = "commands.csv"\n'
ROWS = "time_s,speed_m_s,turn_rate_rad_s\n0,0.5,0\n0.5,0.5,-0.25\n2,0,0\n"


def write(folder: Path, rows: str | bytes = ROWS, law: str = LAW) -> Path:
    path = folder / "drive.toml"
    path.write_text(law, encoding="utf-8")
    data = rows if isinstance(rows, bytes) else rows.encode()
    (folder / "commands.csv").write_bytes(data)
    return path


def fail(path: Path) -> str:
    with pytest.raises(ScenarioError) as caught:
        load_scenario(path)
    line = str(caught.value)
    assert "\n" not in line
    return line.replace(str(path.parent / "commands.csv"), "FILE").replace(str(path), "SCENARIO")


def test_commands_of_a_file_become_part_of_the_scenario(tmp_path: Path) -> None:
    scenario = load_scenario(write(tmp_path))
    law = scenario.law.parameters
    assert law.signal == "sequence"
    assert law.time_s == (0.0, 0.5, 2.0)
    assert law.speed_m_s == (0.5, 0.5, 0.0)
    assert law.turn_rate_rad_s == (0.0, -0.25, 0.0)
    text = tl.format_scenario(scenario)
    assert "commands.csv" not in text
    assert parse_scenario(text) == scenario


def test_recording_holds_the_commands_and_opens_no_file(tmp_path: Path) -> None:
    scenario = load_scenario(write(tmp_path))
    tl.write_recording(tl.simulate_run(scenario), tmp_path / "run.mcap")
    (tmp_path / "commands.csv").unlink()
    assert tl.scenario.restore_scenario(tl.read_recording(tmp_path / "run.mcap")) == scenario


def test_text_without_a_folder_names_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ScenarioError, match=r"law\.file: unknown key; .*\Z"):
        parse_scenario(LAW)
    with pytest.raises(ScenarioError, match=r"law\.file: unknown key; .*\Z"):
        tl.scenario.build_scenario({"law": {"kind": "open-loop", "file": "commands.csv"}})


def test_file_of_another_law_is_its_own_key(tmp_path: Path) -> None:
    law = '[law]\nkind = "mine.py:Law"\nfile = "commands.csv"\n'
    assert load_scenario(write(tmp_path, law=law)).law.parameters.values["file"] == "commands.csv"


def test_columns_may_stand_in_any_order_and_one_may_be_left_out(tmp_path: Path) -> None:
    rows = "﻿ turn_rate_rad_s , time_s\r\n1,0\r\n0, 1e0\r\n\r\n"
    law = load_scenario(write(tmp_path, rows)).law.parameters
    assert (law.time_s, law.turn_rate_rad_s, law.speed_m_s) == ((0.0, 1.0), (1.0, 0.0), None)


@pytest.mark.parametrize(
    ("rows", "line"),
    [
        ("", "FILE: line 1: expected the columns time_s and speed_m_s or turn_rate_rad_s, found"),
        ("time_s\n1\n", "FILE: line 1: expected the columns time_s and speed_m_s or turn_rate_rad"),
        ("t,v\n0,1\n", "FILE: line 1: expected the columns time_s and speed_m_s or turn_rate_rad"),
        ("0,1,2\n", "FILE: line 1: expected the columns time_s and speed_m_s or turn_rate_rad_s"),
        ("time_s,speed_m_s,speed_m_s\n", "FILE: line 1: expected the columns time_s and speed_m"),
        (ROWS.partition("\n")[0], "FILE: line 2: no row of numbers"),
        (ROWS[:-5], "FILE: line 4: expected 3 numbers, found 1"),
        (ROWS + "3,0\n", "FILE: line 5: expected 3 numbers, found 2"),
        (ROWS + "3,0,0,0\n", "FILE: line 5: expected 3 numbers, found 4"),
        (ROWS.replace("-0.25", "left"), "FILE: line 3: turn_rate_rad_s: expected a finite number,"),
        (ROWS.replace("-0.25", "nan"), "FILE: line 3: turn_rate_rad_s: expected a finite number,"),
        (ROWS.replace("-0.25", ""), "FILE: line 3: turn_rate_rad_s: expected a finite number, fou"),
        (ROWS.replace("-0.25", "1_0"), "FILE: line 3: turn_rate_rad_s: expected a finite number,"),
        (
            ROWS + "2,0,0\n",
            "FILE: line 5: time_s: expected more than 2.0 of the line before, found",
        ),
        (ROWS.replace("\n2,", "\n\n2,"), "FILE: line 4: expected 3 numbers, found 0"),
        (ROWS.replace("0,0.5", "-1,0.5"), "SCENARIO: law.time_s: value 1: expected 0 or later, fo"),
        (ROWS.replace("0.5,0\n", "1e7,0\n"), "SCENARIO: law.speed_m_s: value 1: expected a number"),
        (b"\x89MCAP0\r\n\xff\x00", "FILE: expected CSV, found bytes that are no text"),
        (b"\x00\x00\x00", "FILE: line 1: expected "),
        ("x" * 2**21, "FILE: expected a CSV file, found: more than 1,048,576 bytes"),
        (
            'time_s,"speed_m_s' + "x" * 200_000,
            "FILE: line 1: expected CSV, found a cell of more than 131,072 characters; look",
        ),
    ],
)
def test_wrong_file_is_one_line_with_its_place(
    tmp_path: Path, rows: str | bytes, line: str
) -> None:
    assert fail(write(tmp_path, rows)).startswith(line)


@pytest.mark.parametrize(("count", "is_fine"), [(MOST_ROWS, True), (MOST_ROWS + 1, False)])
def test_file_has_no_more_rows_than_a_recording_holds(
    tmp_path: Path, count: int, *, is_fine: bool
) -> None:
    rows = "time_s,speed_m_s\n" + "".join(f"{row},0\n" for row in range(count))
    path = write(tmp_path, rows)
    if is_fine:
        assert len(load_scenario(path).law.parameters.time_s) == MOST_ROWS
    else:
        assert fail(path) == "FILE: line 2502: expected up to 2,500 rows, found more"


@pytest.mark.parametrize(
    ("more", "line"),
    [
        ("time_s = [0.0]", "law.time_s: expected it in commands.csv alone, found it here, too"),
        ('signal = "step"', "law.signal: expected sequence beside file, found 'step'"),
        ("amplitude = 1.0", "law.amplitude: expected a key of the signal sequence (time_s, "),
    ],
)
def test_file_stands_alone(tmp_path: Path, more: str, line: str) -> None:
    assert fail(write(tmp_path, law=f"{LAW}{more}\n")).startswith(f"SCENARIO: {line}")


@pytest.mark.parametrize("value", ["3", '""', '["commands.csv"]'])
def test_file_is_named_in_words(tmp_path: Path, value: str) -> None:
    law = LAW.replace('"commands.csv"', value)
    line = "SCENARIO: law.file: expected the name of a CSV file, found "
    assert fail(write(tmp_path, law=law)).startswith(line)


@pytest.mark.parametrize("name", ["nowhere.csv", "."])
def test_missing_file_is_named(tmp_path: Path, name: str) -> None:
    line = fail(write(tmp_path, law=LAW.replace("commands.csv", name)))
    assert line.startswith(f"{tmp_path / name}: expected a CSV file, found: ")


@pytest.mark.parametrize("preset", PAPER_RUNS)
def test_published_commands_are_sent_again_at_their_times(preset: str) -> None:
    run = tl.simulate_run(load_scenario(preset))
    again = tl.simulate_run(replay_commands(load_scenario("textbook"), run))
    # At every time that which the recorded controller published last.
    sent_ns = again.commands.time_ns - again.start_ns
    held = np.searchsorted(run.commands.time_ns - run.start_ns, sent_ns, side="right") - 1
    assert (again.commands.speed_m_s == run.commands.speed_m_s[held]).all()
    assert (again.commands.turn_rate_rad_s == run.commands.turn_rate_rad_s[held]).all()
    assert again.end_ns - again.start_ns == run.commands.time_ns[-1] - run.start_ns


def test_replayed_commands_act_earlier_than_the_recorded_ones_by_the_dead_time() -> None:
    # The paper's loop: 5 ticks while rotating, 6 while translating, and after the pause the turtle
    # takes one by one what came in one burst, of which the replay sends the last.
    run = tl.simulate_run(load_scenario("paper-kp4"))
    again = tl.simulate_run(replay_commands(load_scenario("textbook"), run))
    applied = run.poses.turn_rate_rad_s, run.poses.speed_m_s
    assert applied[0] is not None
    assert applied[1] is not None
    first = int(np.searchsorted(run.poses.time_ns, run.start_ns))
    turns, ways = applied[0][first:], applied[1][first:]
    assert again.poses.turn_rate_rad_s is not None
    assert again.poses.speed_m_s is not None
    rotating, driving = slice(1, 200), slice(215, 690)
    assert (turns[6:205] == again.poses.turn_rate_rad_s[rotating]).all()
    assert (ways[221:696] == again.poses.speed_m_s[driving]).all()
    # So it does not end where the recorded turtle ended.
    assert abs(again.poses.heading_rad[-1] - run.poses.heading_rad[-1]) > 0.05


def test_commands_keep_what_surrounds_the_law() -> None:
    run = tl.simulate_run(load_scenario("paper-kp4"))
    base = load_scenario("paper-kp10")
    taken = replay_commands(base, run)
    assert replace(taken, law=base.law) == base
    assert taken.law.kind == "open-loop"


def test_commands_before_the_first_sample_count_from_the_first_of_them() -> None:
    run = tl.simulate_run(load_scenario("textbook"))
    late = replace(
        run,
        samples=replace(run.samples, time_ns=run.samples.time_ns + 1_000_000_000),
    )
    taken = replay_commands(load_scenario("textbook"), late)
    assert taken.law.parameters.time_s[0] == 0.0


def test_run_without_commands_is_refused() -> None:
    run = tl.simulate_run(load_scenario("textbook"))
    none = np.empty(0)
    commands = replace(
        run.commands,
        time_ns=np.empty(0, np.int64),
        speed_m_s=none,
        lateral_speed_m_s=none,
        turn_rate_rad_s=none,
    )
    with pytest.raises(ScenarioError, match=r"\Atextbook: the run has no"):
        replay_commands(load_scenario("textbook"), replace(run, commands=commands))


def test_commands_to_the_side_are_refused() -> None:
    run = tl.simulate_run(load_scenario("textbook"))
    sideways = np.zeros(len(run.commands))
    sideways[7] = 0.1
    run = replace(run, commands=replace(run.commands, lateral_speed_m_s=sideways))
    with pytest.raises(ScenarioError, match=r"\Atextbook: expected commands along the heading, .*"):
        replay_commands(load_scenario("textbook"), run)


TRACK = '[law]\nkind = "kanayama"\n[path]\nkind = "waypoints"\nfile = "commands.csv"\n'
POINTS = [(1.0, 1.0), (2.0, 1.5), (2.0, 4.0)]


@pytest.mark.parametrize(
    "rows",
    ["1,1\n2,1.5\n2,4\n", "x_m,y_m\n1,1\n2,1.5\n2,4\n\n", "y_m, x_m\n1,1\n1.5,2\n4,2\n"],
    ids=["no names", "names", "the other way round"],
)
def test_waypoints_of_a_file_become_part_of_the_scenario_and_the_recording(
    rows: str, tmp_path: Path
) -> None:
    scenario = load_scenario(write(tmp_path, rows, TRACK))
    assert scenario.path is not None
    assert scenario.path.points == tuple(POINTS)
    tl.write_recording(tl.simulate_run(scenario), tmp_path / "track.mcap")
    (tmp_path / "commands.csv").unlink()
    found = tl.read_run(tmp_path / "track.mcap")
    assert found.path == scenario.path


@pytest.mark.parametrize(
    ("rows", "line"),
    [
        ("x_m,y_m\n1,1\n5,\n", "FILE: line 3: y_m: expected a finite number, found ''"),
        ("1,1\nnan,2\n", "FILE: line 2: x_m: expected a finite number, found 'nan'"),
        ("1,1\n2\n", "FILE: line 2: expected 2 numbers, found 1"),
        ("x_m,z\n1,1\n", "FILE: line 1: expected the columns x_m and y_m, found 'x_m,z'"),
        ("x_m,y_m\n", "FILE: line 2: no row of numbers"),
        ("1,1\n", "SCENARIO: path.points: expected 2 to 3000 points, found 1"),
        ("1,1\n\n2,2\n", "FILE: line 2: expected 2 numbers, found 0"),
        ("1,1\n" * 3001, "FILE: line 3001: expected up to 3,000 rows, found more"),
    ],
)
def test_waypoints_that_cannot_be_are_refused_by_line(rows: str, line: str, tmp_path: Path) -> None:
    assert fail(write(tmp_path, rows, TRACK)) == line


def test_longest_path_fits_into_a_recording(tmp_path: Path) -> None:
    # The longest numbers within the world: 23 letters as 1.2345678901234567e-100.
    long = (1.2345678901234567e-100 * (1.0 + np.arange(MOST_POINTS) * 1e-12)).tolist()
    points = ((1.0, 1.0), *((x_m, x_m) for x_m in long[:0:-1]))
    scenario = parse_scenario('max_duration_s = 1.0\n[law]\nkind = "kanayama"')
    short = tl.format_scenario(scenario)
    scenario = replace(scenario, path=tl.run.paths.Path(kind="waypoints", points=points))
    added = len(tl.format_scenario(scenario)) - len(short)
    assert added < 56 * MOST_POINTS < 2**18
    run = tl.simulate_run(scenario)
    tl.write_recording(run, tmp_path / "long.mcap")
    assert tl.read_run(tmp_path / "long.mcap").path == run.path


def test_path_says_points_or_a_file(tmp_path: Path) -> None:
    law = f"{TRACK}points = [[1.0, 1.0], [2.0, 2.0]]\n"
    line = "SCENARIO: path.points: expected it in commands.csv alone, found it here, too"
    assert fail(write(tmp_path, "1,1\n2,2\n", law)) == line
