"""The committed recordings are what today's code makes."""

import platform
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

import turtlelog as tl

ROOT = Path(__file__).parents[1]
RUNS = ("kp1", "kp2", "kp4", "kp10")
PINNED = ("mcap", "zstandard", "numpy")


def find_path(name: str) -> Path:
    return ROOT / "recordings" / "paper" / f"{name}.mcap"


def is_where_they_were_made() -> bool:
    pins = (ROOT / "constraints.txt").read_text().splitlines()
    return (platform.system(), platform.machine()) == ("Linux", "x86_64") and all(
        f"{name}=={version(name)}" in pins for name in PINNED
    )


@pytest.mark.parametrize("name", RUNS)
def test_recordings_regenerate_byte_for_byte(name: str, tmp_path: Path) -> None:
    if not is_where_they_were_made():
        pytest.skip("bytes are promised on Linux x86_64 with the pinned versions")
    today = tl.simulate_run(tl.load_scenario(f"paper-{name}"))
    made_by = tl.read_recording(find_path(name)).simulated_by  # with any Python and C library
    tl.write_recording(replace(today, simulated_by=made_by), tmp_path / "a.mcap")
    assert (tmp_path / "a.mcap").read_bytes() == find_path(name).read_bytes()


@pytest.mark.parametrize("name", RUNS)
def test_recordings_regenerate_in_value_everywhere(name: str) -> None:
    recorded = tl.read_recording(find_path(name))
    today = tl.simulate_run(tl.load_scenario(f"paper-{name}"))
    assert np.array_equal(recorded.samples.time_ns, today.samples.time_ns)
    assert np.array_equal(recorded.samples.phase, today.samples.phase)
    assert np.allclose(recorded.poses.xy_m, today.poses.xy_m, rtol=0.0, atol=1e-6)
    assert np.allclose(recorded.commands.speed_m_s, today.commands.speed_m_s, rtol=0.0, atol=1e-9)
    assert recorded.parameters == today.parameters


@pytest.mark.parametrize("name", RUNS)
def test_recordings_open_in_other_readers(name: str) -> None:
    run = tl.read_recording(find_path(name))
    with find_path(name).open("rb") as stream:
        messages = make_reader(stream, validate_crcs=True).iter_messages(["/turtle1/control"])
        assert sum(1 for _ in messages) == len(run.samples)
    with AnyReader([find_path(name)]) as bag:
        counts = {connection.topic: connection.msgcount for connection in bag.connections}
        assert counts["/turtle1/pose"] == len(run.poses)
        assert sum(1 for _ in bag.messages()) == sum(counts.values())
