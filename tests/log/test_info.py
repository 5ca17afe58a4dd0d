from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import IndexType, Writer

from tests.log.runs import find_shared, make_bare_run, simulate_preset
from turtlelog.errors import LogError
from turtlelog.log import TopicInfo, read_info, read_recording, write_recording


def test_info_says_what_a_recording_holds(tmp_path: Path) -> None:
    run = simulate_preset("paper-kp4")
    write_recording(run, tmp_path / "run.mcap")
    info = read_info(tmp_path / "run.mcap")
    assert (info.file, info.format_version) == (str(tmp_path / "run.mcap"), 2)
    assert (info.source, info.name, info.complete) == ("simulation", "paper-kp4", True)
    assert info.duration_s == (run.end_ns - run.poses.time_ns[0]) / 1e9
    assert info.scenario is not None
    assert info.scenario["law"]["kp_linear"] == 4.0
    assert info.parameters == run.parameters
    assert TopicInfo(topic="/turtle1/pose", type="turtlesim/msg/Pose", count=len(run.poses)) in (
        info.topics
    )


def test_info_has_no_scenario_where_only_parameters_are_known(tmp_path: Path) -> None:
    run = make_bare_run()
    write_recording(run, tmp_path / "run.mcap")
    info = read_info(tmp_path / "run.mcap")
    assert (info.scenario, info.complete, info.stop_reason) == (None, True, None)
    assert (info.parameters, info.absent, info.notes) == (run.parameters, run.absent, run.notes)


def test_a_run_cut_off_says_so(tmp_path: Path) -> None:
    write_recording(simulate_preset("paper", max_duration_s=1.0), tmp_path / "run.mcap")
    info = read_info(tmp_path / "run.mcap")
    assert (info.complete, info.stop_reason) == (True, "max_duration")


@pytest.mark.parametrize("chunked", [True, False])
def test_info_counts_messages_where_there_is_no_summary(chunked: bool, tmp_path: Path) -> None:  # noqa: FBT001
    with (tmp_path / "plain.mcap").open("wb") as stream:
        writer = Writer(
            stream,
            index_types=IndexType.NONE,
            repeat_channels=False,
            repeat_schemas=False,
            use_chunking=chunked,
            use_statistics=False,
            use_summary_offsets=False,
        )
        writer.start()
        channel = writer.register_channel("/a", "json", 0)
        for time_ns in (0, 3_000_000_000, 1_000_000_000):
            writer.add_message(channel, time_ns, b"{}", time_ns)
        writer.finish()  # type: ignore[no-untyped-call]
    info = read_info(tmp_path / "plain.mcap")
    assert (info.source, info.name, info.complete) == ("mcap", "plain", True)
    assert info.duration_s == 3.0
    assert [(topic.topic, topic.type, topic.count) for topic in info.topics] == [("/a", "", 3)]


@pytest.mark.parametrize(("count", "is_absent"), [(0, True), (1, False)])
def test_a_goal_that_was_published_once_is_in_a_file(
    count: int, tmp_path: Path, *, is_absent: bool
) -> None:
    with (tmp_path / "plain.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        for topic, messages in (("/turtle1/pose", 2), ("/turtle1/goal", count)):
            channel = writer.register_channel(topic, "json", 0)
            for time_ns in range(messages):
                writer.add_message(channel, time_ns, b"{}", time_ns)
        writer.finish()  # type: ignore[no-untyped-call]
    assert ("goal_xy_m" in read_info(tmp_path / "plain.mcap").absent) == is_absent


@pytest.mark.parametrize(
    ("name", "topic", "count"),
    [
        ("eprosima_ros2_talker.mcap", "/chatter", 10),
        ("lichtblick_example_logs.mcap", "mouse", 111),
        ("rosbag2_talker.mcap", "/topic", 10),
        ("rosbag2_wbag_0.mcap", "AAA", 174),
        ("service_events.mcap", "/add_two_ints/_service_event", 82),
        ("turtlesim_jazzy/subset_0.mcap", "/turtle1/pose", 2501),
    ],
)
def test_info_lists_other_peoples_recordings(name: str, topic: str, count: int) -> None:
    info = read_info(find_shared("ros2", *name.split("/")))
    assert (info.source, info.format_version, info.scenario) == ("mcap", None, None)
    assert {found.topic: found.count for found in info.topics}[topic] == count
    assert info.duration_s is not None


def test_info_agrees_with_the_messages(tmp_path: Path) -> None:
    write_recording(simulate_preset("textbook"), tmp_path / "run.mcap")
    with (tmp_path / "run.mcap").open("rb") as stream:
        times = [message.log_time for _, _, message in make_reader(stream).iter_messages()]
    info = read_info(tmp_path / "run.mcap")
    assert sum(topic.count for topic in info.topics) == len(times)
    assert info.duration_s == np.ptp(times) / 1e9
    assert read_recording(tmp_path / "run.mcap").parameters == info.parameters


@pytest.mark.parametrize(
    ("start", "found"),
    [
        (b"", "it is empty"),
        (
            b"\xef\xbb\xbftime,x",
            "it is text; names of logs and tables end in .csv, .json, .tsv, .tum or .txt",
        ),
        (b"RRF2", "it is a Rerun recording, which turtlelog view shows"),
        (
            b"rosbag2_bagfile_information:\n  version: 5\n",
            "it is the metadata.yaml of a bag: name the folder that it is in",
        ),
        (b"\x89PNG", "it is a picture"),
        (b"\x89PNH", "it begins with 0x89504e48"),
    ],
)
def test_what_is_no_mcap_is_told_with_what_helps(start: bytes, found: str, tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(start)
    with pytest.raises(LogError, match=rf"a: byte 0: not an MCAP file: {found}$"):
        read_info(tmp_path / "a")
