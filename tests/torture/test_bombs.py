"""Small files that ask for much: bounded memory and time, one line where something is refused."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.torture.bombs import (
    BOMBS,
    MIB,
    attachment,
    chunk,
    cut,
    describe,
    message,
    pose_messages,
    schema,
    whole,
)
from tests.torture.kills import ROOT
from turtlelog.errors import LogError
from turtlelog.log import read_columns, read_info, read_run, recover_recording

IS_FULL = os.environ.get("TORTURE") == "full"
MOST_BYTES = 10**7
MOST_MEMORY_MB = 256
MOST_CPU_S = 30.0
"""The slowest take 5 s on a quiet machine, 7 s on a slow one; what this is to find took 139 s."""

FIFTHS = {"a fifth of the channels", "a fifth of the metadata"}
START_MB = 50
"""What a process takes that reads nothing; a fifth may take a fifth of the rest."""
MOST_CPU_OF_FIFTH_S = 5.0
"""They take 2.3 s on a slow machine; a fifth of what took 139 s takes 5.6 s even by its square."""

QUICK = (
    "zstd 900 MB",
    "lz4 60 MB x 6",  # together more than a process may take
    "tiny messages 64 MB",
    "schema 1e7 fields",
    "a fifth of the channels",
    "channels by turns",
    "a fifth of the metadata",
    "scenario",
)

# Prints exit code, peak memory [MB] and time on the processor [s]; what comes goes to stderr.
CHILD = """
import pathlib, re, resource, sys
from turtlelog.cli.app import main
sys.stdout = sys.stderr
try:
    main(sys.argv[1:])
except SystemExit as end:
    status = pathlib.Path("/proc/self/status").read_text()
    peak = int(re.search(r"VmHWM:\\s+(\\d+)", status)[1]) / 1024
    used = resource.getrusage(resource.RUSAGE_SELF)
    print(end.code, peak, used.ru_utime + used.ru_stime, file=sys.__stdout__)
"""


def run(*words: str) -> tuple[int, float, float, str]:
    done = subprocess.run(
        [sys.executable, "-c", CHILD, *words],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    code, memory_mb, cpu_s = done.stdout.split()
    return int(code), float(memory_mb), float(cpu_s), done.stderr


@pytest.mark.everyday("zstd 900 MB")
@pytest.mark.torture
@pytest.mark.skipif(sys.platform != "linux", reason="reads the peak memory from /proc")
@pytest.mark.parametrize("name", BOMBS if IS_FULL else QUICK)
def test_a_small_file_takes_little_whatever_it_claims(name: str, tmp_path: Path) -> None:
    """Three commands read a file that is meant to take long."""
    path, output = tmp_path / "bomb.mcap", tmp_path / "out.mcap"
    path.write_bytes(BOMBS[name]())
    most_memory_mb, most_cpu_s = MOST_MEMORY_MB, MOST_CPU_S
    if name in FIFTHS:
        most_memory_mb = START_MB + (MOST_MEMORY_MB - START_MB) // 5
        most_cpu_s = MOST_CPU_OF_FIFTH_S
    assert path.stat().st_size < MOST_BYTES
    for words in (["info", str(path)], ["convert", "--recover", str(path), "-o", str(output)]):
        code, memory_mb, cpu_s, said = run(*words)
        assert code in {0, 2}, said[-500:]
        assert memory_mb < most_memory_mb, words
        assert cpu_s < most_cpu_s, words
        if code == 2:
            assert said.startswith(f"turtlelog: error: {path}: ")
            assert said.count("\n") == 1
    _, memory_mb, _, said = run("metrics", str(path))
    assert memory_mb < most_memory_mb, said[-500:]


def fill_chunk(size: int) -> bytes:
    """Return a chunk of just this size: two topics, poses and one large message."""
    front = describe("/turtle1/pose", "/fill") + pose_messages(1, 1000)
    return chunk([front, message(2, bytes(size - len(front) - len(message(2))))])


@pytest.mark.everyday("67109864")
@pytest.mark.parametrize("size", [64 * MIB + 1000, 80 * MIB])
def test_a_real_chunk_of_64_mib_is_read_and_recovered(size: int, tmp_path: Path) -> None:
    path = tmp_path / "large.mcap"
    path.write_bytes(whole(fill_chunk(size)))
    assert len(read_columns(path, topics=["/turtle1/pose"])["/turtle1/pose"]) == 1000
    report = recover_recording(path, tmp_path / "out.mcap")
    assert (report.complete, report.recovered["/turtle1/pose"]) == (True, 1000)


def test_a_chunk_that_is_larger_is_refused_and_the_rest_recovered(tmp_path: Path) -> None:
    path, front = tmp_path / "large.mcap", fill_chunk(10_000_000 // 100)
    path.write_bytes(whole(front + fill_chunk(80 * MIB + 1) + front))
    with pytest.raises(LogError, match="expected a chunk of up to 83886080 bytes, found 83886081"):
        read_info(path)
    report = recover_recording(path, tmp_path / "out.mcap")
    assert report.recovered["/turtle1/pose"] == 2000
    assert ["up to 83886080 bytes" in loss.reason for loss in report.lost] == [True]


def test_a_large_file_may_have_larger_chunks(tmp_path: Path) -> None:
    path = tmp_path / "large.mcap"
    noise = message(2, np.random.default_rng(0).bytes(12 * 10**6))
    path.write_bytes(
        whole(chunk([describe("/turtle1/pose", "/fill"), noise]) + fill_chunk(90 * MIB))
    )
    assert read_info(path).complete


def test_messages_behind_a_bomb_are_recovered(tmp_path: Path) -> None:
    path = tmp_path / "bomb.mcap"
    poses = chunk([describe("/turtle1/pose"), pose_messages(1, 100)])
    path.write_bytes(BOMBS["zstd 900 MB"]() + poses)
    report = recover_recording(path, tmp_path / "out.mcap")
    assert report.recovered == {"/turtle1/pose": 200}


def test_a_type_with_too_many_fields_says_so_and_leaves_the_others(tmp_path: Path) -> None:
    path = tmp_path / "fields.mcap"
    lines = "int8 a\n" * 100_000
    path.write_bytes(
        whole(chunk([describe("/a", kind="a/B", definition=lines), pose_messages(1, 1)]))
    )
    expected = "/a: schema a/B: expected up to 10000 fields, found 10001 or more"
    assert read_info(path).not_understood == (expected,)


@pytest.mark.thorough
def test_messages_beyond_what_a_file_may_hold_are_told(tmp_path: Path) -> None:
    path = tmp_path / "tiny.mcap"
    poses, tiny = chunk([describe("/a"), pose_messages(1, 100)]), chunk([message(1) * 30_000] * 80)
    path.write_bytes(cut(poses + tiny + tiny))
    report = recover_recording(path, tmp_path / "out.mcap")
    most = (
        2**22 + path.stat().st_size // 2
    )  # records: the messages, a header, a schema and a channel
    assert report.recovered == {"/a": most - 3}
    assert f"expected up to {most - 2_400_103} records more" in report.lost[0].reason


@pytest.mark.thorough
def test_a_small_file_may_have_a_chunk_a_second_for_an_hour(tmp_path: Path) -> None:
    """Thousands of chunks are walked four times, and written once."""
    path, one = tmp_path / "chunks.mcap", chunk([pose_messages(1, 1)])
    front, most = chunk([describe("/a"), pose_messages(1, 1)]), 4096
    path.write_bytes(whole(front + one * (most - 1)))
    assert read_info(path).topics[0].count == most
    more = path.stat().st_size // 1000 + 60
    path.write_bytes(whole(front + one * (most + more)))
    allowed = most + path.stat().st_size // 1000
    with pytest.raises(LogError, match=rf"expected up to {allowed} chunks in a file of"):
        read_info(path)
    report = recover_recording(path, tmp_path / "out.mcap")
    assert report.recovered == {"/a": allowed}
    advice = "found more; mcap filter FILE -o NEW.mcap writes larger ones"
    assert [loss.reason.endswith(advice) for loss in report.lost] == [True]
    assert read_info(tmp_path / "out.mcap").topics[0].count == allowed


def test_what_a_file_asks_for_beyond_its_size_ends_what_is_read_of_it(tmp_path: Path) -> None:
    """Else each of the chunks that follow would be unpacked, and be refused as well."""
    path = tmp_path / "cut.mcap"
    long = [chunk([schema(number, "a" * 9_000_000, "")]) for number in range(2, 6)]
    path.write_bytes(cut(chunk([describe("/a"), pose_messages(1, 1)]) + b"".join(long)))
    partial = read_info(path).notes["partial"]
    assert partial.startswith(f"{sum(map(len, long[1:]))} bytes are lost in 1 place")
    assert "bytes of schemas" in partial


@pytest.mark.parametrize(
    ("count", "end"), [(100, "robot98, robot99: "), (101, "robot98, robot99 and 1 more: ")]
)
def test_a_note_lists_a_hundred_robots_at_most(count: int, end: str, tmp_path: Path) -> None:
    path, pose = tmp_path / "topics.mcap", b"\0\1\0\0" + bytes(20)
    topics = [f"/robot{number:02}/pose" for number in range(count)]
    said = b"".join(message(number, pose, number) for number in range(1, count + 1))
    path.write_bytes(whole(chunk([describe(*topics), said])))
    assert read_run(path).notes["robots"].endswith(f"{end}--robot NAME chooses")


def test_a_small_file_may_have_some_thousand_attachments(tmp_path: Path) -> None:
    path, one = tmp_path / "notes.mcap", attachment("", b"")
    poses = chunk([describe("/turtle1/pose"), pose_messages(1, 100)])
    path.write_bytes(whole(poses + one * 4096))
    assert read_info(path).topics[0].count == 100
    path.write_bytes(whole(poses + one * 5000))
    allowed = 4096 + path.stat().st_size // 1000
    with pytest.raises(LogError, match=f"expected up to {allowed} metadata records and attach"):
        read_info(path)
    assert recover_recording(path, tmp_path / "out.mcap").recovered == {"/turtle1/pose": 100}
    assert read_info(tmp_path / "out.mcap").topics[0].count == 100
