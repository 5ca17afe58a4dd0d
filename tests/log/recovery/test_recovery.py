import json
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import NonSeekingReader, make_reader
from mcap.writer import CompressionType, IndexType, Writer

from tests.log.runs import find_shared
from tests.torture.recordings import list_messages, list_records, make_recording, pack_again
from turtlelog.errors import LogError
from turtlelog.log import read_info, read_recording, read_run
from turtlelog.log.recording.head import RECOVERY
from turtlelog.log.recovery import RecoveryReport, recover_recording

CHUNK, DATA_END, HEAD = 6, 15, 9


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return make_recording(tmp_path_factory.mktemp("recordings"), "zstd")


def recover(data: bytes, folder: Path) -> tuple[RecoveryReport, bytes]:
    (folder / "in.mcap").write_bytes(data)
    report = recover_recording(folder / "in.mcap", folder / "out.mcap")
    return report, (folder / "out.mcap").read_bytes()


def find_chunk(data: bytes, number: int) -> tuple[int, int]:
    return list_places(data)[number]


def list_places(data: bytes) -> list[tuple[int, int]]:
    return [(at, at + HEAD + size) for kind, at, size in list_records(data) if kind == CHUNK]


def damage(data: bytes, *places: int) -> bytes:
    changed = bytearray(data)
    for place in places:
        changed[place] ^= 0xA5
    return bytes(changed)


def test_a_whole_file_stays_as_it_is(sound: bytes, tmp_path: Path) -> None:
    report, recovered = recover(sound, tmp_path)
    assert (report.complete, report.lost, report.missing, report.unchecked) == (True, (), {}, {})
    assert list_messages(recovered) == list_messages(sound)
    assert sum(report.recovered.values()) == 51
    assert read_info(tmp_path / "out.mcap").topics == read_info(tmp_path / "in.mcap").topics
    assert recover(recovered, tmp_path)[1] == recovered


def test_a_recovered_recording_opens_as_a_run(sound: bytes, tmp_path: Path) -> None:
    report, _ = recover(sound[: find_chunk(sound, 3)[0] + 20], tmp_path)
    run = read_recording(tmp_path / "out.mcap")
    assert (run.name, len(run.poses)) == ("paper", report.recovered["/turtle1/pose"])
    assert run.end_ns / 1e9 == report.to_s
    assert not report.complete


def test_an_unfinished_file_gives_all_its_whole_chunks(sound: bytes, tmp_path: Path) -> None:
    place, end = find_chunk(sound, 3)
    report, recovered = recover(sound[: end - 1], tmp_path)
    messages = list_messages(recovered)
    assert messages == list_messages(sound)[: len(messages)]
    assert report.missing is None
    assert [(loss.start, loss.end) for loss in report.lost] == [(place, end - 1)]


def test_a_damaged_chunk_is_missed_by_the_message(sound: bytes, tmp_path: Path) -> None:
    place, end = find_chunk(sound, 2)
    report, recovered = recover(damage(sound, end - 9), tmp_path)
    whole, found = list_messages(sound), list_messages(recovered)
    assert report.missing is not None
    assert 0 < sum(report.missing.values()) == len(whole) - len(found)
    assert set(found) < set(whole)
    assert [(loss.start, loss.end) for loss in report.lost] == [(place, end)]


@pytest.mark.parametrize(("second", "losses"), [(3, [(2, 3)]), (4, [(2, 2), (4, 4)])])
def test_chunks_lost_one_right_after_the_other_are_one_loss(
    second: int, losses: list[tuple[int, int]], tmp_path: Path
) -> None:
    output = BytesIO()
    writer = Writer(output, chunk_size=1, index_types=IndexType.NONE)
    writer.start()
    channel = writer.register_channel("/a", "json", 0)
    for time_ns in range(8):
        writer.add_message(channel, time_ns, b"{}", time_ns)
    writer.finish()  # type: ignore[no-untyped-call]
    chunks = list_places(output.getvalue())
    damaged = damage(output.getvalue(), *(chunks[number][1] - 9 for number in (2, second)))
    assert [(loss.start, loss.end) for loss in recover(damaged, tmp_path)[0].lost] == [
        (chunks[first][0], chunks[last][1]) for first, last in losses
    ]


def test_channels_of_a_lost_first_chunk_come_from_the_summary(sound: bytes, tmp_path: Path) -> None:
    _, end = find_chunk(sound, 0)
    report, recovered = recover(damage(sound, end - 9), tmp_path)
    assert set(list_messages(recovered)) < set(list_messages(sound))
    assert report.recovered["/turtle1/pose"] > 5
    with BytesIO(recovered) as stream:
        found = make_reader(stream).iter_messages()
        schemas = {schema.name: schema.data for schema, _, _ in found if schema}
    assert schemas["turtlesim/msg/Pose"].startswith(b"float32 x\n")


def test_messages_of_an_undescribed_channel_are_counted_as_lost(tmp_path: Path) -> None:
    def write(*, first: bool) -> bytes:
        output = BytesIO()
        writer = Writer(output, chunk_size=1, compression=CompressionType.NONE)
        writer.start()
        for topic in ("/a", "/b"):
            channel = writer.register_channel(topic, "json", 0)
            for time_ns in range(3):
                writer.add_message(channel, time_ns, b"{}", time_ns)
        if first:
            writer.finish()  # type: ignore[no-untyped-call]
        return output.getvalue()

    data = write(first=False)
    place, _ = find_chunk(write(first=True), 0)
    report, recovered = recover(damage(data, place + 60), tmp_path)
    assert report.recovered == {"/b": 3}
    assert any(
        "expected a description of channel 1, found only its messages: 2" in loss.reason
        for loss in report.lost
    )
    assert [message[0] for message in list_messages(recovered)] == ["/b"] * 3


def test_a_channel_that_changes_its_meaning_keeps_both(tmp_path: Path) -> None:
    def write(topic: str) -> bytes:
        output = BytesIO()
        writer = Writer(output, compression=CompressionType.LZ4)
        writer.start()
        writer.add_message(writer.register_channel(topic, "json", 0), 5, topic.encode(), 5)
        writer.finish()  # type: ignore[no-untyped-call]
        return output.getvalue()

    first, second = write("/a"), write("/b")
    place, end = find_chunk(second, 0)
    joined = first[: find_chunk(first, 0)[1]] + second[place:end]
    _, recovered = recover(joined, tmp_path)
    found = [(message[0], message[5]) for message in list_messages(recovered)]
    assert found == [("/a", b"/a"), ("/b", b"/b")]


def test_messages_alone_are_vouched_for_by_the_data_checksum_only(
    sound: bytes, tmp_path: Path
) -> None:
    lone = pack_again(sound, "none", use_chunking=False)
    report, recovered = recover(lone, tmp_path)
    assert (report.complete, report.unchecked) == (True, {})
    assert list_messages(recovered) == list_messages(sound)
    report, _ = recover(lone[: len(lone) // 2], tmp_path)
    assert not report.complete
    assert report.unchecked == report.recovered


def test_a_recovered_file_says_what_it_lost(sound: bytes, tmp_path: Path) -> None:
    report, recovered = recover(damage(sound, find_chunk(sound, 1)[1] - 9), tmp_path)
    (note,) = (
        found.metadata
        for found in NonSeekingReader(BytesIO(recovered)).iter_metadata()
        if found.name == RECOVERY
    )
    assert json.loads(note["missing"]) == report.missing
    assert json.loads(note["lost"])[0]["start"] == report.lost[0].start
    text = read_info(tmp_path / "out.mcap").notes["recovered"]
    assert read_recording(tmp_path / "out.mcap").notes["recovered"].startswith(text)
    assert text.startswith("from a damaged or unfinished file: lost ")
    assert f"of /turtle1/pose (byte {report.lost[0].start}: expected " in text


def test_samples_whose_pose_is_lost_leave_a_recovered_run(tmp_path: Path) -> None:
    sound = make_recording(tmp_path, "zstd", seconds=3.0)
    whole = read_recording(tmp_path / "whole.mcap")
    recover(damage(sound, *(find_chunk(sound, number)[1] - 9 for number in (0, 9))), tmp_path)
    run = read_recording(tmp_path / "out.mcap")
    assert 0 < len(whole.samples) - len(run.samples) < 30
    read = (
        run.poses.xy_m[run.samples.pose_sequence],
        run.poses.heading_rad[run.samples.pose_sequence],
    )
    rows = whole.samples.pose_sequence[np.isin(whole.samples.sequence, run.samples.sequence)]
    np.testing.assert_array_equal(read[0], whole.poses.xy_m[rows])
    np.testing.assert_array_equal(read[1], whole.poses.heading_rad[rows])


def test_a_file_recovered_twice_says_it_once(sound: bytes, tmp_path: Path) -> None:
    _, recovered = recover(damage(sound, find_chunk(sound, 1)[1] - 9), tmp_path)
    note = read_info(tmp_path / "out.mcap").notes
    report, again = recover(recovered, tmp_path)
    assert (report.complete, again) == (True, recovered)
    assert read_info(tmp_path / "out.mcap").notes == note


def test_a_file_that_was_whole_says_nothing(sound: bytes, tmp_path: Path) -> None:
    recover(sound, tmp_path)
    assert "recovered" not in read_info(tmp_path / "out.mcap").notes
    assert "recovered" not in read_recording(tmp_path / "out.mcap").notes


def test_a_changed_note_is_told_by_its_checksum(sound: bytes, tmp_path: Path) -> None:
    _, recovered = recover(damage(sound, find_chunk(sound, 1)[1] - 9), tmp_path)
    path = tmp_path / "changed.mcap"
    path.write_bytes(recovered.replace(b'"start":', b'"stArt":', 1))
    with pytest.raises(LogError, match="metadata turtlelog_recovery: damaged"):
        read_info(path)


def test_a_recovered_bag_by_others_says_so(tmp_path: Path) -> None:
    data = find_shared("ros2", "turtlesim_jazzy", "subset_0.mcap").read_bytes()
    recover(data[:-200], tmp_path)
    info, run = read_info(tmp_path / "out.mcap"), read_run(tmp_path / "out.mcap")
    assert info.notes["recovered"] == run.notes["recovered"]
    assert "the summary is damaged or missing" in run.notes["recovered"]


def test_a_damaged_summary_alone_loses_no_message(sound: bytes, tmp_path: Path) -> None:
    report, recovered = recover(damage(sound, len(sound) - 100), tmp_path)
    assert list_messages(recovered) == list_messages(sound)
    assert (report.complete, report.missing) == (False, {})
    (loss,) = report.lost
    assert loss.reason == "the summary is damaged or missing: no message is missing"


def test_a_wrong_checksum_of_the_data_alone_loses_no_message(sound: bytes, tmp_path: Path) -> None:
    ((place, _),) = [(at, size) for kind, at, size in list_records(sound) if kind == DATA_END]
    report, recovered = recover(damage(sound, place + HEAD), tmp_path)
    assert list_messages(recovered) == list_messages(sound)
    assert (report.complete, report.missing) == (False, {})
    (loss,) = report.lost
    assert (loss.start, loss.end) == (place, place)
    assert loss.reason.startswith("expected data with the checksum 0x")
    assert loss.reason.endswith(": no message is missing")


def test_a_hidden_chunk_is_missed_though_all_others_are_sound(sound: bytes, tmp_path: Path) -> None:
    place, _ = find_chunk(sound, 1)
    hidden = bytearray(sound)
    hidden[place] = 0x86  # a record of somebody's own, which every reader steps over
    report, recovered = recover(bytes(hidden), tmp_path)
    assert len(list_messages(recovered)) < len(list_messages(sound))
    assert report.missing
    assert "no message is missing" not in str(report.lost)


def test_without_a_sound_checksum_nobody_says_that_nothing_is_missing(
    sound: bytes, tmp_path: Path
) -> None:
    ((place, _),) = [(at, size) for kind, at, size in list_records(sound) if kind == DATA_END]
    report, _ = recover(damage(sound, place + HEAD, len(sound) - 100), tmp_path)
    assert (report.complete, report.missing) == (False, None)
    assert "no message is missing" not in str(report.lost)


def test_a_channel_described_behind_its_messages_is_found(tmp_path: Path) -> None:
    """Of a file whose summary is lost, and whose first chunk alone described a channel."""

    def write(times: range) -> bytes:
        output = BytesIO()
        writer = Writer(output, chunk_size=1)
        writer.start()
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
        channel = writer.register_channel("/a", "cdr", schema)
        for time_ns in times:
            writer.add_message(channel, time_ns, b"\0\1\0\0\1\0\0\0\0", time_ns)
        writer.finish()  # type: ignore[no-untyped-call]
        return output.getvalue()

    first, second = write(range(3)), write(range(3, 4))
    lost, place = find_chunk(first, 0)[0], find_chunk(first, 1)[0]
    later, end = find_chunk(second, 0)
    joined = first[:lost] + first[place : find_chunk(first, 2)[1]] + second[later:end]
    report, recovered = recover(joined, tmp_path)
    assert report.recovered == {"/a": 3}
    assert [message[:3] for message in list_messages(recovered)] == [
        ("/a", "std_msgs/msg/String", time_ns) for time_ns in (1, 2, 3)
    ]


def test_channels_without_messages_are_kept(tmp_path: Path) -> None:
    output = BytesIO()
    writer = Writer(output)
    writer.start()
    schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
    writer.register_channel("/silent", "cdr", schema)
    writer.add_message(writer.register_channel("/heard", "json", 0), 7, b"{}", 7)
    writer.finish()  # type: ignore[no-untyped-call]
    recover(output.getvalue(), tmp_path)
    topics = [
        (topic.topic, topic.type, topic.count) for topic in read_info(tmp_path / "out.mcap").topics
    ]
    assert topics == [("/heard", "", 1), ("/silent", "std_msgs/msg/String", 0)]


@pytest.mark.parametrize("folder", ["conformance", "ros2"])
def test_whole_files_by_others_lose_nothing(folder: str, tmp_path: Path) -> None:
    """All files of MCAP's conformance suite are recovered."""
    for path in sorted(find_shared(folder).rglob("*.mcap")):
        data = path.read_bytes()
        if messages := list_messages(data):
            report, recovered = recover(data, tmp_path)
            assert report.complete, path
            assert list_messages(recovered) == messages, path


@pytest.mark.parametrize("name", ["rosbag2_talker.mcap", "rosbag2_wbag_0.mcap"])
def test_cut_files_by_others_keep_a_prefix(name: str, tmp_path: Path) -> None:
    data = find_shared("ros2", *name.split("/")).read_bytes()
    report, recovered = recover(data[: len(data) * 3 // 4], tmp_path)
    messages = list_messages(recovered)
    assert messages == list_messages(data)[: len(messages)]
    assert (bool(messages), report.complete) == (True, False)


@pytest.mark.parametrize("data", [b"", b"\x89MCAP0\r\n", bytes(3000), b"time,x\n" * 900])
def test_what_holds_no_message_is_one_line(data: bytes, tmp_path: Path) -> None:
    with pytest.raises(
        LogError,
        match=r"\A\S+in\.mcap: (no message can be recovered: [^\n]+|only zero bytes; [^\n]+)\Z",
    ):
        recover(data, tmp_path)
    assert not (tmp_path / "out.mcap").exists()


def test_a_file_is_not_recovered_onto_itself(sound: bytes, tmp_path: Path) -> None:
    path = tmp_path / "in.mcap"
    path.write_bytes(sound)
    with pytest.raises(LogError, match="expected another file to write to, found the same"):
        recover_recording(path, tmp_path / "." / "in.mcap")
    assert path.read_bytes() == sound


def test_a_missing_file_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"none\.mcap: no such file\Z"):
        recover_recording(tmp_path / "none.mcap", tmp_path / "out.mcap")


def test_small_chunks_of_many_channels_become_one(tmp_path: Path) -> None:
    stream = BytesIO()
    writer = Writer(stream, chunk_size=1)
    writer.start()
    schema = writer.register_schema("a/B", "ros2msg", b"uint8 a\n")
    channels = [writer.register_channel(f"/{name}", "cdr", schema) for name in "abc"]
    for number in range(300):
        writer.add_message(channels[number % 3], number, bytes([number % 256]) * 500, number)
    writer.finish()  # type: ignore[no-untyped-call]
    report, recovered = recover(stream.getvalue(), tmp_path)
    assert report.complete
    assert list_messages(recovered) == list_messages(stream.getvalue())
    assert len(list_places(stream.getvalue())) == 300
    assert len(list_places(recovered)) == 3
    assert {topic.topic: topic.count for topic in read_info(tmp_path / "out.mcap").topics} == {
        "/a": 100,
        "/b": 100,
        "/c": 100,
    }
