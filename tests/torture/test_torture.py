"""Every cut, every flipped bit, lying lengths, killed recorders.

The ordinary suite takes a sample; `TORTURE=full` takes all, on two cores (`make torture`).
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.log.padding import pad_file
from tests.log.recording.strange import make_strange
from tests.torture.kills import (
    PRESETS,
    ROOT,
    find_difference,
    find_fault,
    kill_command,
    kill_recorders,
    simulate_messages,
)
from tests.torture.outcomes import count_outcomes, format_table, list_harms, sample_harms
from tests.torture.recordings import COMPRESSIONS, list_messages, make_recording, record_scenario
from turtlelog.log.recovery import recover_recording

IS_FULL = os.environ.get("TORTURE") == "full"
SEED = int(os.environ.get("TORTURE_SEED", "0"))

pytestmark = pytest.mark.torture


def make_twin(name: str, folder: Path) -> bytes:
    """Return a recording to damage; `states` has those of a law, and references that move."""
    if name == "states":
        return record_scenario(make_strange(folder, max_duration_s=0.25), folder, "zstd")
    return make_recording(folder, "none" if name == "padded" else name)


def test_damage_is_one_line_or_harmless(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Five recordings are damaged in 50 ways each, and read."""
    counts, failures = {}, []
    for name in (*COMPRESSIONS, "padded", "states"):
        # The mcap library, which lists what is there, does not step over the padding in chunks.
        twin = make_twin(name, tmp_path)
        sound = pad_file(twin, b"\1\2\3") if name == "padded" else twin
        harms = list_harms(sound) if IS_FULL else sample_harms(sound, 50, SEED)
        with capsys.disabled():
            counts[name], bad = count_outcomes(
                sound,
                harms,
                processes=2 if IS_FULL else 1,
                label=name if IS_FULL else "",
                twin=twin,
            )
        failures += bad
    table = format_table(counts)
    if IS_FULL:
        with capsys.disabled():
            sys.stdout.write(f"\n{table}\n")
    assert failures == [], table


@pytest.mark.realtime
def test_killed_recorders_keep_all_but_the_last_second(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Ten recorders run by the clock until they are killed."""
    whole = {preset: simulate_messages(preset, tmp_path) for preset in PRESETS}
    # The pauses of two presets lie at 2.5 to 3.4 s.
    count, latest_s = (100, 6.0) if IS_FULL else (10, 4.5)
    killed = kill_recorders(tmp_path, count, at_once=10, latest_s=latest_s, seed=SEED)
    faults = [
        fault
        for found in killed
        if (fault := find_fault(found, whole[found.preset], tmp_path / "recovered.mcap"))
    ]
    if IS_FULL:
        with capsys.disabled():
            sys.stdout.write(f"\n{len(killed)} recorders killed, {len(faults)} lost too much\n")
    assert faults == []


@pytest.mark.realtime
def test_a_killed_command_leaves_a_recording(tmp_path: Path) -> None:
    """A recorder runs by the clock for three seconds."""
    killed = kill_command(tmp_path, after_s=3.0)
    report = recover_recording(killed.path, tmp_path / "recovered.mcap")
    messages = list_messages((tmp_path / "recovered.mcap").read_bytes())
    assert find_difference(messages, simulate_messages(killed.preset, tmp_path), -1) is None
    # How far it was, only a journal would tell; a busy machine takes a while to start.
    assert report.to_s >= 1.0
    assert not report.complete


@pytest.mark.thorough
@pytest.mark.skipif(sys.platform != "linux", reason="limits the address space as Linux does")
def test_a_lying_length_takes_no_memory(tmp_path: Path) -> None:
    """Hundreds of files are read in a process whose memory is bounded."""
    paths = [tmp_path / f"{compression}.mcap" for compression in COMPRESSIONS]
    for path in paths:
        path.write_bytes(make_recording(tmp_path, path.stem))
    done = subprocess.run(
        [
            *(sys.executable, "-m", "tests.torture.memory", str(SEED)),
            *(str(3000 if IS_FULL else 60), *map(str, paths)),
        ],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=2700,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    *greedy, count = map(json.loads, done.stdout.splitlines())
    assert greedy == []
    assert count >= 300
