from dataclasses import replace
from pathlib import Path

import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from tests.log.runs import assert_same, simulate_preset, simulate_short_run
from turtlelog.errors import LogError
from turtlelog.log import read_recording
from turtlelog.log.recording.run_writer import export_rosbag2
from turtlelog.log.recording.topics import TYPE_HASHES
from turtlelog.run import Event, Run


@pytest.fixture(scope="module")
def run() -> Run:
    return simulate_preset("paper-kp4", loop__pose_precision="float64")


@pytest.fixture(scope="module")
def bag(run: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bags") / "kp4"
    export_rosbag2(run, path)
    return path


def test_a_bag_is_a_recording_and_its_description(bag: Path, run: Run) -> None:
    assert sorted(file.name for file in bag.iterdir()) == ["kp4_0.mcap", "metadata.yaml"]
    assert_same(read_recording(bag / "kp4_0.mcap"), run)


def test_rosbags_reads_every_message(bag: Path) -> None:
    with (bag / "kp4_0.mcap").open("rb") as stream:
        expected = [
            (channel.topic, message.log_time, message.data)
            for _, channel, message in make_reader(stream).iter_messages()
        ]
    with AnyReader([bag]) as reader:
        found = [(of.topic, time_ns, bytes(data)) for of, time_ns, data in reader.messages()]
        assert reader.message_count == len(expected)
        assert (reader.start_time, reader.end_time) == (expected[0][1], expected[-1][1] + 1)
    assert sorted(found) == sorted(expected)


def test_rosbags_understands_every_message(bag: Path, run: Run) -> None:
    poses = []
    with AnyReader([bag]) as reader:
        for connection, _, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            if connection.topic == "/turtle1/pose64":
                poses.append([message.x, message.y])  # type: ignore[attr-defined]
    assert poses == run.poses.xy_m.tolist()


def test_channels_and_description_name_the_same_hashes(bag: Path) -> None:
    with (bag / "kp4_0.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    types = {number: schema.name for number, schema in summary.schemas.items()}
    for channel in summary.channels.values():
        expected = TYPE_HASHES[types[channel.schema_id]]
        assert channel.metadata == {"offered_qos_profiles": "", "topic_type_hash": expected}
    with AnyReader([bag]) as reader:
        digests = {(connection.msgtype, connection.digest) for connection in reader.connections}
    assert digests == {(name, TYPE_HASHES[name]) for name in types.values()}


def test_a_name_that_yaml_could_mistake_is_no_trouble(tmp_path: Path) -> None:
    path = tmp_path / "it's: #1"
    export_rosbag2(simulate_short_run(), path)
    with AnyReader([path]) as reader:
        assert reader.message_count == len([*reader.messages()]) > 0


def test_a_folder_with_files_is_refused_and_left_alone(tmp_path: Path) -> None:
    (tmp_path / "mine").touch()
    with pytest.raises(LogError, match="expected the name of a new folder, found a folder with"):
        export_rosbag2(simulate_short_run(), tmp_path)
    assert [file.name for file in tmp_path.iterdir()] == ["mine"]


def test_an_empty_folder_is_taken(tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    export_rosbag2(simulate_short_run(), tmp_path / "bag")
    assert [path.name for path in tmp_path.iterdir()] == ["bag"]
    assert (tmp_path / "bag" / "metadata.yaml").exists()


def test_a_run_that_cannot_be_written_leaves_nothing(tmp_path: Path) -> None:
    event = Event(time_ns=-1, kind="stop", text="")
    with pytest.raises(LogError, match=rf"^{tmp_path}/bag: events\.time_ns: expected"):
        export_rosbag2(replace(simulate_short_run(), events=(event,)), tmp_path / "bag")
    assert not list(tmp_path.iterdir())
