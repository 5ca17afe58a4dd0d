"""Recordings that the code before format 2 wrote, and the values that it read from them."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.log.runs import assert_same, simulate_preset
from turtlelog.laws.sequential_p import DECLARATION
from turtlelog.log import PartialRecordingWarning, read_info, read_recording, write_recording
from turtlelog.run import Run

FILES = Path(__file__).parent / "format1"
TABLES = ("poses", "commands", "samples")
META: dict[str, dict[str, Any]] = json.loads((FILES / "values.json").read_text())


def read(name: str) -> Run:
    path = FILES / f"{name}.mcap"
    if name != "unfinished":
        return read_recording(path)
    with pytest.warns(PartialRecordingWarning):
        return read_recording(path, allow_partial=True)


def list_columns(run: Run) -> dict[str, Any]:
    tables = {name: getattr(run, name) for name in TABLES}
    return {
        f"{table}.{name}": getattr(columns, name)
        for table, columns in tables.items()
        for name in columns.__dataclass_fields__
    }


def is_newer(name: str) -> bool:
    words = ("states", "reference", "sensed", "shaped", "measured", "height", "tilt")
    return name.partition(".")[2].startswith(words)


@pytest.mark.parametrize("name", META)
def test_every_column_is_as_it_was(name: str) -> None:
    run, meta = read(name), META[name]
    with np.load(FILES / "values.npz") as values:
        kept = {key: values[key] for key in values.files if key.startswith(f"{name}/")}
    columns = {key: found for key, found in list_columns(run).items() if not is_newer(key)}
    assert {key for key, found in columns.items() if found is None} == set(meta.get("none", []))
    found = {f"{name}/{key}": values for key, values in columns.items() if values is not None}
    assert found.keys() == kept.keys()
    for key, expected in kept.items():
        assert_same(found[key], expected, key)


@pytest.mark.parametrize("name", META)
def test_everything_else_is_as_it_was(name: str) -> None:
    run, meta = read(name), META[name]
    for key in ("name", "source", "goal_heading_rad", "scenario_is_complete", "stop_reason"):
        assert getattr(run, key) == meta[key], key
    assert dict(run.parameters) == meta["parameters"]
    assert list(run.absent) == meta["absent"]
    assert dict(run.notes) == meta["notes"]
    assert (None if run.goal_xy_m is None else list(run.goal_xy_m)) == meta["goal_xy_m"]
    assert [[event.time_ns, event.kind, event.text] for event in run.events] == meta["events"]
    spans = [[span.phase, span.start_ns, span.end_ns] for span in run.find_phase_spans()]
    assert spans == meta["spans"]
    assert read_info(FILES / f"{name}.mcap", allow_partial=True).format_version == 1


@pytest.mark.parametrize("name", [name for name in META if name != "other_law"])
def test_the_law_of_the_paper_is_known(name: str) -> None:
    assert read(name).declaration == DECLARATION


def test_of_another_law_the_phases_are_known() -> None:
    run = read("other_law")
    assert run.phase_names == ("rotate", "pause", "translate", "done")
    assert set(run.samples.phase.tolist()) == {2}
    assert not run.declaration.loops
    assert not run.declaration.states


def test_a_recording_of_format_1_is_the_run_that_is_simulated_today() -> None:
    goal = {"goal__x_m": 6.1, "goal__y_m": 5.9}
    today = simulate_preset("paper-kp4", **goal)
    assert_same(read("simulated"), replace(today, simulated_by={}))


@pytest.mark.parametrize("name", [name for name in META if name != "other_law"])
def test_what_is_written_again_in_format_2_is_the_same_run(name: str, tmp_path: Path) -> None:
    run = read(name)
    write_recording(run, tmp_path / "a.mcap")
    assert_same(read_recording(tmp_path / "a.mcap"), run)
    assert read_info(tmp_path / "a.mcap").format_version == 2


def test_the_files_are_small() -> None:
    assert max(path.stat().st_size for path in FILES.iterdir()) < 100_000
