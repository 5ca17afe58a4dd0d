"""A run names the versions, the platform and the code that simulated it."""

import platform
from pathlib import Path

import numpy as np
import pytest

import turtlelog as tl
from turtlelog.run import SoftwareChange, describe_changes, list_software_changes
from turtlelog.scenario import Scenario, get_preset, override_scenario

LAW = """def steer(time_ns, pose, goal):
    return 0.5, RATE
"""
SHORT = override_scenario(get_preset("paper-kp4"), {"max_duration_s": 0.5}, source="here")


def name_law(scenario: Scenario, kind: str) -> Scenario:
    return override_scenario(scenario, {"law.kind": kind}, source="here")


def test_a_run_names_versions_and_platform_and_no_built_in_law() -> None:
    found = tl.simulate_run(SHORT).simulated_by
    assert {**found, "platform": ""} == {
        "turtlelog": tl.__version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "platform": "",
    }
    assert found["platform"].startswith(f"{platform.system()} {platform.machine()}")
    assert platform.node() not in " ".join(found.values())


def test_runs_of_compiled_loops_name_the_same() -> None:
    run = tl.simulate_run(SHORT)
    for found in tl.simulate.simulate_many([SHORT] * 2):
        assert isinstance(found, tl.Run)
        assert found.simulated_by == run.simulated_by


def test_an_edited_law_has_another_digest_and_an_equal_one_the_same(tmp_path: Path) -> None:
    digests = []
    for number, rate in enumerate(("0.25", "0.26", "0.25")):
        file = tmp_path / f"law_{number}.py"
        file.write_text(LAW.replace("RATE", rate))
        digests.append(tl.simulate_run(name_law(SHORT, f"{file}:steer")).simulated_by["law"])
    assert digests[0] == digests[2] != digests[1]
    file.write_text(LAW.replace("RATE", "0.26"))  # the same file, edited
    assert tl.simulate_run(name_law(SHORT, f"{file}:steer")).simulated_by["law"] == digests[1]


def test_a_law_given_in_python_has_the_digest_of_its_text() -> None:
    def steer(time_ns: int, pose: object, goal: object) -> tuple[float, float]:
        return 0.5, 0.25

    run = tl.simulate_run(SHORT, law=steer)
    assert run.simulated_by["law"].startswith("sha256 ")


@pytest.mark.parametrize("name", ["poses.parquet", "run.mcap"])
def test_files_keep_what_simulated_a_run(name: str, tmp_path: Path) -> None:
    run = tl.simulate_run(SHORT)
    if name == "run.mcap":
        tl.write_recording(run, tmp_path / name)
    else:
        tl.log.export_parquet(run, tmp_path, table="poses")
    assert tl.read_run(
        next(tmp_path.glob("*poses*" if "poses" in name else name))
    ).simulated_by == (run.simulated_by)


def test_a_live_recording_names_what_simulates_from_its_first_byte(tmp_path: Path) -> None:
    file = tmp_path / "live.mcap"
    recorder = tl.Recorder(file, SHORT)
    try:
        begun = tl.log.read_info(file, allow_partial=True).simulated_by
    finally:
        recorder.close()
    assert begun == tl.simulate_run(SHORT).simulated_by
    assert tl.log.read_info(file).simulated_by == begun


def test_changes_are_told_with_both_values_and_nothing_is_told_of_a_silent_run() -> None:
    first = {"turtlelog": "0.1.0", "numpy": "2.1.0", "platform": "Linux x86_64"}
    second = {**first, "numpy": "2.2.0", "platform": "Linux aarch64", "law": "sha256 1"}
    changes = list_software_changes(first, second)
    assert changes[0] == SoftwareChange(name="numpy", first="2.1.0", second="2.2.0")
    assert describe_changes(changes) == (
        "NumPy 2.1.0, then 2.2.0; Linux x86_64, then Linux aarch64; the code of the law"
    )
    assert list_software_changes(first, first) == ()
    assert list_software_changes({}, second) == list_software_changes(first, {}) == ()
    assert describe_changes([SoftwareChange(name="python", first=None, second="3.13.0")]) == (
        "Python unknown, then 3.13.0"
    )
