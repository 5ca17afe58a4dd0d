from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.records import ChunkIndex
from mcap.writer import IndexType, Writer

from tests.log.runs import assert_same, simulate_preset
from turtlelog.errors import LogError
from turtlelog.log import PartialRecordingWarning, read_info, read_recording, write_recording
from turtlelog.run import Run

CHUNK_SIZE = 4000  # bytes


@pytest.fixture(scope="module")
def run() -> Run:
    return simulate_preset("paper-kp4", loop__pose_precision="float64")


@pytest.fixture(scope="module")
def sound(run: Run, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return the recording in many small chunks, as the mcap library writes it."""
    path = tmp_path_factory.mktemp("recordings") / "run.mcap"
    write_recording(run, path)
    small = path.with_name("small.mcap")
    with path.open("rb") as source, small.open("wb") as target:
        reader = make_reader(source)
        writer = Writer(target, CHUNK_SIZE, index_types=IndexType.CHUNK | IndexType.MESSAGE)
        writer.start(profile="ros2")
        for metadata in reader.iter_metadata():
            writer.add_metadata(metadata.name, dict(metadata.metadata))
        for found in reader.iter_attachments():
            writer.add_attachment(0, 0, found.name, found.media_type, found.data)
        channels: dict[int, int] = {}
        for schema, channel, message in reader.iter_messages():
            assert schema is not None
            if channel.id not in channels:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(channel.topic, "cdr", number)
            writer.add_message(
                channels[channel.id],
                message.log_time,
                message.data,
                message.publish_time,
                message.sequence,
            )
        writer.finish()  # type: ignore[no-untyped-call]
    return small.read_bytes()


def list_chunks(data: bytes, folder: Path) -> list[ChunkIndex]:
    (folder / "sound.mcap").write_bytes(data)
    with (folder / "sound.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    return summary.chunk_indexes


def read_partial(path: Path, data: bytes, lost: str = r"\d+ bytes are lost in") -> Run:
    path.write_bytes(data)
    with pytest.warns(PartialRecordingWarning, match=rf"run\.mcap: {lost}") as caught:
        run = read_recording(path, allow_partial=True)
    assert len(caught) == 1
    assert str(caught[0].message) == f"{path}: {run.notes['partial']}"
    assert Path(caught[0].filename) == Path(__file__)
    return run


def break_chunk(data: bytes, chunk: ChunkIndex) -> bytes:
    damaged = bytearray(data)
    damaged[chunk.chunk_start_offset + chunk.chunk_length // 2] ^= 1
    return bytes(damaged)


def test_a_sound_recording_is_read_without_a_warning(
    sound: bytes, run: Run, tmp_path: Path
) -> None:
    (tmp_path / "run.mcap").write_bytes(sound)
    assert_same(read_recording(tmp_path / "run.mcap", allow_partial=True), run)


@pytest.mark.parametrize("share", [0.3, 0.5, 0.7])
def test_an_unfinished_recording_is_read_up_to_its_end(
    share: float, sound: bytes, run: Run, tmp_path: Path
) -> None:
    path = tmp_path / "run.mcap"
    found = read_partial(path, sound[: int(len(sound) * share)])
    rows, samples = len(found.poses), len(found.samples)
    assert 0 < rows < len(run.poses)
    assert found.poses.xy_m.tobytes() == run.poses.xy_m[:rows].tobytes()
    assert found.samples.error_xy_m is not None
    assert run.samples.error_xy_m is not None
    assert found.samples.error_xy_m.tobytes() == run.samples.error_xy_m[:samples].tobytes()
    assert "byte" in found.notes["partial"]
    with pytest.raises(LogError, match=" -o OUT rewrites what can be read"):
        read_recording(path)


def test_samples_keep_their_poses_where_a_chunk_is_lost(
    sound: bytes, run: Run, tmp_path: Path
) -> None:
    chunks = list_chunks(sound, tmp_path)
    for chunk in (chunks[3], chunks[len(chunks) // 2]):
        found = read_partial(tmp_path / "run.mcap", break_chunk(sound, chunk))
        assert len(found.poses) < len(run.poses)
        rows = np.searchsorted(run.poses.time_ns, found.poses.time_ns)
        assert (found.poses.time_ns == run.poses.time_ns[rows]).all()
        assert (found.poses.xy_m == run.poses.xy_m[rows]).all()
        assert (found.poses.speed_m_s == run.poses.speed_m_s[rows]).all()  # type: ignore[index]
        samples = np.searchsorted(run.samples.sequence, found.samples.sequence)
        read = run.samples.pose_sequence[samples]
        assert (rows[found.samples.pose_sequence] == read).all()
        assert run.samples.distance_m is not None
        assert np.array_equal(found.samples.distance_m, run.samples.distance_m[samples])  # type: ignore[arg-type]


def test_a_lost_summary_costs_no_row(sound: bytes, run: Run, tmp_path: Path) -> None:
    found = read_partial(tmp_path / "run.mcap", sound[:-40], "no loss is found, only the summary")
    assert_same(found.samples, run.samples)
    assert_same(found.poses, run.poses)
    assert found.parameters == run.parameters


def test_what_is_no_recording_is_not_read_in_part(tmp_path: Path) -> None:
    (tmp_path / "run.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(100))
    with pytest.raises(LogError, match="not a recording of turtlelog"):
        read_recording(tmp_path / "run.mcap", allow_partial=True)


def test_info_of_an_unfinished_recording_lists_what_it_holds(
    sound: bytes, run: Run, tmp_path: Path
) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(sound[: len(sound) // 2])
    info = read_info(path)
    assert (info.complete, info.name, info.parameters) == (False, run.name, run.parameters)
    counts = {topic.topic: topic.count for topic in info.topics}
    assert counts["/turtle1/pose"] == len(read_partial(path, path.read_bytes()).poses)
    assert 0 < info.duration_s < (run.end_ns - run.poses.time_ns[0]) / 1e9  # type: ignore[operator]


def test_info_says_what_a_damaged_file_still_holds(sound: bytes, tmp_path: Path) -> None:
    path = tmp_path / "damaged.mcap"
    (tmp_path / "sound.mcap").write_bytes(sound)
    path.write_bytes(sound[:-60] + b"\xa5" + sound[-59:])
    with pytest.raises(LogError, match="expected a summary of checksum"):
        read_info(path)
    found, whole = read_info(path, allow_partial=True), read_info(tmp_path / "sound.mcap")
    assert (found.complete, found.topics, found.stop_reason) == (
        False,
        whole.topics,
        whole.stop_reason,
    )
    assert found.notes["partial"] == "no loss is found, only the summary is damaged"
