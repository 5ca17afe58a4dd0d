from pathlib import Path

import pytest

import turtlelog as tl
from turtlelog.errors import LogError
from turtlelog.log import Recorder, RecordingTail
from turtlelog.simulate import Tick, iterate_ticks

SCENARIO = tl.override_scenario(tl.load_scenario("paper-kp4"), {"max_duration_s": 1.0})
TICKS: list[Tick] = list(iterate_ticks(SCENARIO))


def record(recorder: Recorder, ticks: list[Tick]) -> None:
    for tick in ticks:
        recorder.receive(tick)
    recorder.flush()


def test_a_tail_returns_what_came_each_time_and_ends_as_the_file(tmp_path: Path) -> None:
    path, lengths = tmp_path / "a.mcap", []
    with Recorder(path, SCENARIO) as recorder, RecordingTail(path) as tail:
        for first in range(0, len(TICKS), 20):
            record(recorder, TICKS[first : first + 20])
            run = tail.read_run()
            assert run is not None
            lengths.append(len(run.poses))
            assert (tail.read_run(), tail.is_finished) == (None, False)
        recorder.close()
        last, whole = tail.read_last_run(), tl.read_recording(path)
        assert tail.is_finished
    assert lengths == [20, 40, 60, len(TICKS)]
    assert last.poses.xy_m.tolist() == whole.poses.xy_m.tolist()
    assert last.samples.speed_m_s.tolist() == whole.samples.speed_m_s.tolist()
    assert (last.stop_reason, last.events) == (whole.stop_reason, whole.events)


def test_a_chunk_that_is_half_there_is_read_when_it_is_whole(tmp_path: Path) -> None:
    path, growing = tmp_path / "a.mcap", tmp_path / "b.mcap"
    with Recorder(path, SCENARIO) as recorder:
        record(recorder, TICKS)
    data, found = path.read_bytes(), 0
    growing.write_bytes(data[:8])
    with RecordingTail(growing) as tail, growing.open("ab", buffering=0) as stream:
        for first in range(8, len(data), 501):
            stream.write(data[first : first + 501])
            found += tail.read_run() is not None
        assert tail.is_finished
        assert len(tail.read_last_run().poses) == len(TICKS)
    assert found < len(data) // 501


def test_a_tail_knows_whether_the_recorder_is_there(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with Recorder(path, SCENARIO) as recorder, RecordingTail(path) as tail:
        if not tail.is_live:
            pytest.skip("this system has no locks that tell")
        recorder.close()
        assert not tail.is_live


def test_what_is_no_recording_is_refused_in_a_line(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"no recording at all")
    with pytest.raises(LogError, match=r"a\.mcap: "):
        RecordingTail(tmp_path / "a.mcap")


def test_a_recording_that_ends_without_a_pose_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with Recorder(path, SCENARIO), RecordingTail(path) as tail:
        assert tail.read_run() is None
        with pytest.raises(LogError, match="no messages"):
            tail.read_last_run()
