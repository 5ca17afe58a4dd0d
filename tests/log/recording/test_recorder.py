import io
import time
from pathlib import Path

import pytest
from mcap.reader import NonSeekingReader, make_reader
from mcap.writer import MCAP0_MAGIC
from rosbags.highlevel import AnyReader

from tests.log.live import read_messages
from tests.log.recording.ticks import POSE, assert_same_columns, make_scenario, record
from tests.log.runs import assert_same
from tests.log.strict import check_strictly
from turtlelog.errors import LogError
from turtlelog.log import read_recording, write_recording
from turtlelog.log.recording.recorder import Recorder
from turtlelog.scenario import Scenario
from turtlelog.simulate import iterate_ticks, simulate_run


@pytest.mark.parametrize(
    "scenario",
    [
        *map(make_scenario, ["paper-kp1", "paper-kp10", "textbook"]),
        make_scenario("textbook", loop__pose_precision="float64", goal__heading_rad=1.0),
        make_scenario("paper-kp10", max_duration_s=3.0),
        make_scenario("paper", limits__speed_m_s=float("inf"), law__kp_linear=200.0),
    ],
    ids=["kp1", "kp10", "textbook", "float64", "cut off in the pause", "at the wall"],
)
def test_a_live_recording_equals_one_written_at_once(scenario: Scenario, tmp_path: Path) -> None:
    live, once = tmp_path / "live.mcap", tmp_path / "once.mcap"
    record(live, scenario)
    run = simulate_run(scenario)
    write_recording(run, once)
    check_strictly(live)
    assert_same(read_recording(live), run)
    assert_same_columns(live, once)


def test_rosbags_reads_a_live_recording(tmp_path: Path) -> None:
    scenario = make_scenario("paper-kp4")
    record(tmp_path / "a.mcap", scenario)
    run = simulate_run(scenario)
    with AnyReader([tmp_path / "a.mcap"]) as bag:
        found = [(connection.topic, time_ns) for connection, time_ns, _ in bag.messages()]
    for topic, columns in (("pose", run.poses), ("control", run.samples)):
        times = [time_ns for name, time_ns in found if name == f"/turtle1/{topic}"]
        assert times == columns.time_ns.tolist()


def test_chunks_hold_64_kib_where_the_clock_does_not_cut_them(tmp_path: Path) -> None:
    record(tmp_path / "a.mcap", make_scenario("paper-kp1"))
    sizes = [chunk.uncompressed_size for chunk in check_strictly(tmp_path / "a.mcap").chunk_indexes]
    assert len(sizes) > 3
    assert all(2**16 <= size < 2**16 + 4096 for size in sizes[:-1])


def test_every_chunk_can_be_read_alone(tmp_path: Path) -> None:
    record(tmp_path / "a.mcap", make_scenario("paper-kp1"))
    data, summary = (tmp_path / "a.mcap").read_bytes(), check_strictly(tmp_path / "a.mcap")
    header_end = 8 + 9 + int.from_bytes(data[9:17], "little")
    for chunk in summary.chunk_indexes[1:]:
        start = chunk.chunk_start_offset
        alone = data[:header_end] + data[start : start + chunk.chunk_length]
        footer = b"\x02" + (20).to_bytes(8, "little") + bytes(20)
        stream = io.BytesIO(alone + footer + MCAP0_MAGIC)
        messages = NonSeekingReader(stream, validate_crcs=True).iter_messages()
        topics = {channel.topic for _, channel, _ in messages}
        assert topics >= {"/turtle1/pose", "/turtle1/control", "/turtle1/cmd_vel"}


def test_every_tick_is_safe_at_once_where_asked(tmp_path: Path) -> None:
    scenario, path = make_scenario(), tmp_path / "a.mcap"
    recorder = Recorder(path, scenario, flush_s=0.0)
    for number, tick in zip(range(1, 21), iterate_ticks(scenario), strict=False):
        recorder.receive(tick)
        assert sum(message.channel_id == POSE for message in read_messages(path)) == number
    recorder.close()


def test_nothing_is_kept_longer_than_asked(tmp_path: Path) -> None:
    scenario, path = make_scenario(), tmp_path / "a.mcap"
    ticks = iterate_ticks(scenario)
    with Recorder(path, scenario, flush_s=0.05) as recorder:
        recorder.receive(next(ticks))
        assert read_messages(path) == []
        time.sleep(0.06)
        recorder.receive(next(ticks))
        assert [m.log_time for m in read_messages(path) if m.channel_id == POSE] == [0, 16_000_000]


def test_an_unfinished_file_says_from_the_start_what_it_is(tmp_path: Path) -> None:
    scenario, path = make_scenario("paper-kp4"), tmp_path / "a.mcap"
    with Recorder(path, scenario):
        data = path.read_bytes()
    assert data.index(b"scenario.toml") < len(data)
    assert b"format_version" in data
    assert b'name = "paper-kp4"' in data


def test_the_last_head_of_a_file_holds_the_stop_reason(tmp_path: Path) -> None:
    record(tmp_path / "a.mcap", make_scenario("paper-kp10"))
    with (tmp_path / "a.mcap").open("rb") as stream:
        heads = [head.metadata for head in make_reader(stream).iter_metadata()]
    assert [head.get("stop_reason") for head in heads] == [None, "standstill"]
    assert all(head["name"] == "paper-kp10" for head in heads)


def test_an_existing_file_is_refused_and_kept(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(b"mine")
    with pytest.raises(LogError, match=r"^\S+a\.mcap: expected a new file, found one"):
        Recorder(path, make_scenario())
    assert path.read_bytes() == b"mine"


def test_a_second_recorder_on_the_same_file_is_refused(tmp_path: Path) -> None:
    path, scenario = tmp_path / "a.mcap", make_scenario(max_duration_s=0.5)
    with Recorder(path, scenario) as recorder:
        with pytest.raises(LogError, match="expected a new file, found one"):
            Recorder(path, scenario)
        for tick in iterate_ticks(scenario):
            recorder.receive(tick)
    assert_same(read_recording(path), simulate_run(scenario))


def test_a_place_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"^\S+a\.mcap: cannot be written"):
        Recorder(tmp_path / "missing" / "a.mcap", make_scenario())


def test_a_closed_recorder_takes_nothing_more(tmp_path: Path) -> None:
    scenario = make_scenario()
    recorder = Recorder(tmp_path / "a.mcap", scenario)
    recorder.close()
    recorder.close()
    with pytest.raises(LogError, match="expected a recording in progress, found a closed one"):
        recorder.receive(next(iterate_ticks(scenario)))
    check_strictly(tmp_path / "a.mcap")
