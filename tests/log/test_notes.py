"""The table of notes: which notes exist, and where answers show them."""

from pathlib import Path

import pytest

import turtlelog as tl
from tests.log.runs import find_shared
from turtlelog.log import NOTES, list_notes_after
from turtlelog.log.any_file import read_as_chosen
from turtlelog.log.read_choice import ReadChoice

TABLE = "t,x,y,yaw,v\n" + "".join(f"{row / 10},{row / 100},0,0,0.1\n" for row in range(30))


@pytest.mark.parametrize(
    "name", ["tb3", "sim_time", "turtlesim_sqlite", "tf_only", "neato_wall", "amcl_pose"]
)
def test_every_note_of_a_bag_is_in_the_table(name: str) -> None:
    assert {*tl.read_run(find_shared("robots", name)).notes} <= {*NOTES}


def test_every_note_of_a_table_and_a_preset_is_in_the_table(tmp_path: Path) -> None:
    file = tmp_path / "drive.csv"
    file.write_text(TABLE + TABLE.partition("\n")[2] + "3.0,1\n")
    table = read_as_chosen(file, ReadChoice(allow_partial=True, robot="ben"))
    assert {"restarts", "partial", "unused", "columns"} <= {*table.notes} <= {*NOTES}
    assert (table.origin.table_run, table.origin.lost) == ((1, 2), "rows")
    preset = read_as_chosen("paper-kp4", ReadChoice())
    assert {"preset"} == {*preset.notes} <= {*NOTES}


def test_notes_on_a_source_follow_only_its_own_run(tmp_path: Path) -> None:
    notes = {"partial": "cut", "unused": "--wheels", "wheels": "two", "goal": "as given", "": "?"}
    assert [*list_notes_after(notes)] == ["--wheels", "partial: cut"]
    assert [*list_notes_after({**notes, "chosen": "poses from /odom"})] == [
        "poses from /odom",
        "wheels: two",
        "--wheels",
        "partial: cut",
    ]
    run = tl.read_run(find_shared("robots", "tb3"), wheelbase=0.2)
    tl.write_recording(run, tmp_path / "tb3.mcap")
    found = tl.read_run(tmp_path / "tb3.mcap")
    assert {*run.notes} - {*found.notes} == {"chosen", "unused"}
    assert not [*list_notes_after(found.notes)]


def test_rows_of_a_table_without_a_pose_are_told_after_an_answer(tmp_path: Path) -> None:
    file = tmp_path / "drive.csv"
    file.write_text(f"{TABLE}3.0,,,,\n")
    assert "rows without pose: 1 of 31" in [*list_notes_after(tl.read_run(file).notes)]
    file.write_text(TABLE)
    assert not any("rows" in note for note in list_notes_after(tl.read_run(file).notes))
