"""Logs of which parts are missing, absurd or too long: what is identified of the rest."""

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from tests.explain.logs import as_log, forget, read_values, simulate
from turtlelog.errors import SimulationError
from turtlelog.explain import identify_run
from turtlelog.explain.scenario_from_log import identify_scenario
from turtlelog.run import Run, SampleColumns


def take_rows(run: Run, rows: Any) -> Run:
    """Return a log with some of its rows."""
    tables: dict[str, Any] = {"poses": run.poses, "commands": run.commands}
    columns: dict[str, Any] = {
        name: replace(
            table,
            **{
                found.name: getattr(table, found.name)[rows].copy()
                for found in fields(table)
                if getattr(table, found.name) is not None
            },
        )
        for name, table in tables.items()
    }
    samples = {
        found.name: getattr(run.samples, found.name)[rows].copy()
        for found in fields(run.samples)
        if getattr(run.samples, found.name) is not None
    }
    samples["pose_sequence"] = np.arange(len(samples["time_ns"]))
    return replace(run, samples=SampleColumns(**samples), **columns)


def test_a_gap_is_named_and_what_is_left_identified() -> None:
    log = as_log(simulate("paper-kp4"))
    found = identify_run(take_rows(log, np.r_[0:300, 340 : len(log.samples)]))
    assert found.notes[0] == "40 samples are missing after 5.088 s, for 0.656 s"
    keys = ("dead_time.rotate", "dead_time.translate", "law.kp_angular", "law.kp_linear")
    assert read_values(found, *keys) == (5, 6, 4.0, 4.0)


def lose_samples(run: Run, lost: range) -> Run:
    """Return a recording without some samples; as when a chunk is lost, their numbers tell."""
    kept = np.delete(np.arange(len(run.samples)), lost)
    samples = {
        found.name: getattr(run.samples, found.name)[kept].copy()
        for found in fields(run.samples)
        if getattr(run.samples, found.name) is not None
    }
    return replace(run, samples=SampleColumns(**samples))


def test_a_recording_with_a_hole_is_explained_from_what_is_left() -> None:
    found = identify_run(lose_samples(forget(simulate("paper-kp10")), range(40, 90)))
    assert found.notes == ("50 samples are missing after 0.560 s, for 0.816 s",)
    assert read_values(found, "loop.start_backlog", "law.pause_ticks") == (5, 33)
    assert found.findings["loop.start_backlog"].evidence == "reproduces all 720 samples"
    assert found.resimulation is not None
    assert (found.resimulation.samples, found.resimulation.is_exact) == (720, True)


@pytest.mark.parametrize("rows", [1, 2, 7])
def test_a_log_in_which_nothing_moves_tells_no_queues(rows: int) -> None:
    found = identify_run(take_rows(as_log(simulate("paper-kp4")), np.arange(rows)))
    assert found.findings["loop.start_backlog"].evidence == "the robot never moves in this log"
    assert found.findings["law.kp_angular"].value is None


def test_a_log_of_a_translation_alone_says_so() -> None:
    log = as_log(simulate("paper-kp4"))
    found = identify_run(take_rows(log, np.arange(340, len(log.samples))))
    assert found.notes == ("its phases are not one rotation and one translation: translate",)
    assert found.findings["dead_time.translate"].value == 6
    assert found.findings["law.kp_linear"].value is not None


@pytest.mark.parametrize(
    ("scale", "reason"), [(-1.0, "not proportional"), (1e300, "not proportional")]
)
def test_absurd_commands_make_no_scenario(scale: float, reason: str) -> None:
    run = simulate("paper-kp4")
    samples = replace(run.samples, speed_m_s=run.samples.speed_m_s * scale)
    found = identify_run(replace(run, samples=samples))
    assert reason in found.notes[0]
    assert found.findings["dead_time.rotate"].value == 5


def test_a_clock_of_days_is_refused_in_words() -> None:
    log = as_log(simulate("paper-kp4"))
    time_ns = log.samples.time_ns * 100_000
    samples, poses = replace(log.samples, time_ns=time_ns), replace(log.poses, time_ns=time_ns)
    found = identify_run(replace(log, samples=samples, poses=poses))
    assert found.notes[0].startswith("it lasts 1118400 s, and up to 3600 s are simulated again")
    assert found.scenario is None


@pytest.mark.parametrize(("slower", "told"), [(240, "searched for"), (260, "every 4.16 s")])
def test_a_loop_of_many_seconds_is_refused_in_words(
    slower: int, told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(identify_scenario, "search_loop", stop_here)
    log = as_log(simulate("paper-kp4"))
    samples = replace(log.samples, time_ns=log.samples.time_ns * slower)
    poses = replace(log.poses, time_ns=log.poses.time_ns * slower)
    found = identify_run(replace(log, samples=samples, poses=poses))
    assert told in " ".join(found.notes)


def stop_here(*_: object) -> None:
    raise SimulationError("nothing is searched for here")


@pytest.mark.parametrize("spare_s", [-0.01, 0.01])
def test_of_a_run_that_is_too_long_the_beginning_is_looked_at(
    spare_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = as_log(simulate("paper-kp4"))
    length_s = float(log.end_ns - log.poses.time_ns[0]) / 1e9
    monkeypatch.setattr(identify_scenario, "LONGEST_S", length_s + spare_s)
    monkeypatch.setattr(identify_scenario, "_BEGINNING_S", 8.0)
    found = identify_run(log)
    assert found.findings["law.kp_angular"].value == 4.0
    is_whole = spare_s > 0.0
    assert (found.scenario is not None) == is_whole
    assert any("of its first 8 s" in note for note in found.notes) != is_whole
    assert (found.findings["stop_reason"].value is not None) == is_whole
