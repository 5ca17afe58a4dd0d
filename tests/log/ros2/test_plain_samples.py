"""Samples in files that hold turtlelog's topics, and not its metadata record."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import turtlelog as tl
from tests.log.runs import assert_same, simulate_short_run
from turtlelog.errors import ReplayError
from turtlelog.log import TopicColumns, read_bag, read_columns, read_run, write_columns
from turtlelog.log.recording.run_writer import write_recording

CONTROL, POSE, PHASE = "/turtle1/control", "/turtle1/pose", "/turtle1/phase"
Change = Callable[[TopicColumns], TopicColumns | None]


def write_plain(path: Path, **changes: Change) -> Path:
    """Write a short run without the metadata record, its topics changed."""
    write_recording(simulate_short_run(), path / "own.mcap")
    columns = dict(read_columns(path / "own.mcap"))
    for name, change in changes.items():
        columns[f"/turtle1/{name}"] = change(columns[f"/turtle1/{name}"])  # type: ignore[assignment]
    kept = [found for found in columns.values() if found is not None]
    write_columns(kept, path / "plain.mcap")
    return path / "plain.mcap"


def set_field(name: str, change: Callable[[Any], Any]) -> Change:
    return lambda columns: replace(
        columns, fields={**columns.fields, name: change(columns.fields[name])}
    )


def test_samples_are_read_and_what_is_not_known_is_said(tmp_path: Path) -> None:
    own, run = simulate_short_run(), read_run(write_plain(tmp_path))
    assert_same(run.samples, own.samples)
    assert_same(run.commands, own.commands)
    assert run.goal_xy_m == own.goal_xy_m
    assert run.phase_names == ("rotate", "pause", "translate", "done")
    assert run.declaration.loops == ()
    assert "samples" not in run.absent
    assert "declaration" in run.absent
    assert "not_read" not in run.notes
    assert run.notes["samples"] == (
        "from /turtle1/control; phases are named by /turtle1/phase; the law, its loops and its"
        " parameters are not known"
    )


def test_phases_without_names_are_called_as_those_of_the_usual_law(tmp_path: Path) -> None:
    run = read_run(write_plain(tmp_path, phase=lambda _: None))
    assert run.phase_names == ("rotate", "pause", "translate", "done")
    assert "named as those of sequential-p, as nothing else names them" in run.notes["samples"]
    far = set_field("phase", lambda phase: np.where(phase == 0, 5, phase))
    run = read_run(write_plain(tmp_path, phase=lambda _: None, control=far))
    assert run.phase_names[4:] == ("phase_4", "phase_5")


def test_phases_of_another_law_keep_their_names(tmp_path: Path) -> None:
    turn = set_field("data", lambda names: np.where(names == "rotate", "turn", names))
    run = read_run(write_plain(tmp_path, phase=turn))
    assert {span.phase for span in run.find_phase_spans()} <= {"turn", "translate", "pause"}
    assert run.find_phase_spans()[0].phase == "turn"


def test_columns_that_were_not_recorded_are_absent(tmp_path: Path) -> None:
    unknown = set_field("bearing", lambda bearing: np.full(len(bearing), np.nan))
    assert read_run(write_plain(tmp_path, control=unknown)).samples.bearing_rad is None


@pytest.mark.parametrize(
    ("topic", "change", "reason"),
    [
        ("pose", lambda found: found.select(np.arange(5)), "which a sample read, found 5 poses"),
        (
            "pose",
            lambda found: found.select(np.arange(20, len(found))),
            "which a sample read, found",
        ),
        (
            "control",
            set_field("pose_sequence", lambda rows: np.minimum(rows + 3, rows.max())),
            "before the sample that",
        ),
        ("control", set_field("sequence", lambda rows: rows // 2), "numbers and times that rise"),
        ("control", set_field("speed", lambda speed: speed * np.nan), "commands that are numbers"),
        ("pose", lambda found: found.select(np.arange(len(found)) // 2 * 2), "poses as they are n"),
    ],
)
def test_samples_that_do_not_fit_the_poses_are_left_out(
    topic: str, change: Change, reason: str, tmp_path: Path
) -> None:
    run = read_run(write_plain(tmp_path, **{topic: change}))
    assert len(run.samples) == 0
    assert run.notes["samples"].startswith("not read: expected ")
    assert reason in run.notes["samples"]
    assert CONTROL in run.notes["not_read"]
    assert "samples" in run.absent
    for notes in (run.notes, {}):  # of a recording, anybody may have removed the notes
        with pytest.raises(ReplayError, match=rf"{CONTROL}.* are not read as samples"):
            tl.replay_law(replace(run, notes=notes))


def test_what_a_robot_measured_is_no_command(tmp_path: Path) -> None:
    robot = simulate_short_run()
    rows = np.ones(len(robot.poses))
    poses = replace(robot.poses, measured_speed_m_s=rows, measured_turn_rate_rad_s=rows)
    nothing = replace(
        robot.commands,
        time_ns=robot.commands.time_ns[:0],
        speed_m_s=rows[:0],
        lateral_speed_m_s=rows[:0],
        turn_rate_rad_s=rows[:0],
    )
    write_recording(replace(robot, poses=poses, commands=nothing), tmp_path / "robot.mcap")
    run = read_bag(tmp_path / "robot.mcap")
    assert len(run.commands) == 0
    assert "command_topic" not in run.notes
