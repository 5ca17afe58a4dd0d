from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from tests.log.runs import assert_same, make_bare_run, make_run, simulate_preset, simulate_short_run
from turtlelog.errors import LogError
from turtlelog.log import read_recording, write_recording
from turtlelog.run import Event, Run
from turtlelog.scenario import PRESETS, get_preset, override_scenario
from turtlelog.simulate import simulate_run

LAW = """
from turtlelog.laws import SequentialP
class Mine(SequentialP):
    pass
"""


def write_and_read(run: Run, folder: Path) -> Run:
    write_recording(run, folder / "run.mcap")
    return read_recording(folder / "run.mcap")


@pytest.mark.parametrize("preset", PRESETS)
def test_a_preset_comes_back_to_the_last_bit(preset: str, tmp_path: Path) -> None:
    run = simulate_preset(preset)
    assert_same(write_and_read(run, tmp_path), run)


def test_poses_in_double_precision_come_back(tmp_path: Path) -> None:
    run = simulate_preset("textbook", loop__pose_precision="float64")
    assert not (run.poses.xy_m == run.poses.xy_m.astype(np.float32)).all()
    assert_same(write_and_read(run, tmp_path), run)


def test_a_run_at_the_wall_without_limits_comes_back(tmp_path: Path) -> None:
    run = simulate_preset("paper", limits__speed_m_s=float("inf"), law__kp_linear=200.0)
    assert {"wall_hit", "stop"} <= {event.kind for event in run.events}
    assert_same(write_and_read(run, tmp_path), run)


def test_a_run_cut_off_during_the_pause_comes_back(tmp_path: Path) -> None:
    run = simulate_preset("paper-kp10", max_duration_s=3.0)
    assert len(run.commands) < len(run.samples)
    assert_same(write_and_read(run, tmp_path), run)


def test_a_run_of_a_users_law_is_read_without_the_law(tmp_path: Path) -> None:
    law = tmp_path / "law.py"
    law.write_text(LAW, encoding="utf-8")
    values = {"law.kind": f"{law}:Mine", "max_duration_s": 0.5}
    run = simulate_run(override_scenario(get_preset("textbook"), values))
    write_recording(run, tmp_path / "run.mcap")
    law.unlink()
    assert_same(read_recording(tmp_path / "run.mcap"), run)


def test_a_run_that_lacks_much_comes_back(tmp_path: Path) -> None:
    run = make_bare_run()
    assert_same(write_and_read(run, tmp_path), run)


def test_a_run_of_poses_only_comes_back(tmp_path: Path) -> None:
    run = make_run(np.zeros(0), poses=make_run(np.ones(2)).poses)
    assert not len(run.samples)
    assert_same(write_and_read(run, tmp_path), run)


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(values=st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1, max_size=5))
def test_any_numbers_come_back(values: list[float], tmp_path: Path) -> None:
    run = make_run(np.array(values))
    assert_same(write_and_read(run, tmp_path), run)


def test_the_same_run_gives_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a.mcap", "b.mcap"):
        write_recording(simulate_short_run(), tmp_path / name)
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


def test_writing_replaces_a_file_and_leaves_no_other(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(b"old")
    write_recording(simulate_short_run(), path)
    assert [file.name for file in tmp_path.iterdir()] == ["run.mcap"]
    assert read_recording(path).name == "paper"


def test_a_folder_that_is_missing_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"^\S+run\.mcap: cannot be written"):
        write_recording(simulate_short_run(), tmp_path / "missing" / "run.mcap")


def test_a_folder_is_not_overwritten(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="expected the name of a file to write, found a folder"):
        write_recording(simulate_short_run(), tmp_path)


def test_a_time_before_zero_is_not_written(tmp_path: Path) -> None:
    run = make_run(np.ones(1), events=(Event(time_ns=-1, kind="stop", text=""),))
    with pytest.raises(LogError, match=r"events\.time_ns: expected values from 0 .* found -1"):
        write_recording(run, tmp_path / "run.mcap")
    assert not list(tmp_path.iterdir())


def test_parameters_that_make_no_tables_are_not_written(tmp_path: Path) -> None:
    run = make_run(np.ones(1), parameters={"law": 1, "law.kp_linear": 2.0})
    with pytest.raises(LogError, match="parameters: law: expected a value, found a key below it"):
        write_recording(run, tmp_path / "run.mcap")
