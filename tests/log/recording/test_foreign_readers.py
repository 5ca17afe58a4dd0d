from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.records import Attachment, SummaryOffset
from mcap.stream_reader import StreamReader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from tests.log.runs import make_run, simulate_preset
from turtlelog.log import write_recording
from turtlelog.run import Run
from turtlelog.scenario import get_preset, parse_scenario


@pytest.fixture(scope="module")
def run() -> Run:
    return simulate_preset("paper-kp4", loop__pose_precision="float64", goal__heading_rad=1.0)


@pytest.fixture(scope="module")
def path(run: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recordings") / "run.mcap"
    write_recording(run, path)
    return path


def read_with_mcap(path: Path) -> dict[str, list[tuple[int, Any]]]:
    topics: dict[str, list[tuple[int, Any]]] = {}
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for found in reader.iter_decoded_messages(log_time_order=False):
            of_topic = topics.setdefault(found.channel.topic, [])
            of_topic.append((found.message.log_time, found.decoded_message))
    return topics


def read_with_rosbags(path: Path) -> dict[str, list[tuple[int, Any]]]:
    topics: dict[str, list[tuple[int, Any]]] = {}
    with AnyReader([path]) as reader:
        for connection, time_ns, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            topics.setdefault(connection.topic, []).append((time_ns, message))
    return topics


@pytest.fixture(scope="module", params=[read_with_mcap, read_with_rosbags], ids=["mcap", "rosbags"])
def topics(request: pytest.FixtureRequest, path: Path) -> Any:
    return request.param(path)


def test_others_read_the_poses(topics: Any, run: Run) -> None:
    found = [
        (time_ns, pose.x, pose.y, pose.theta, pose.linear_velocity, pose.angular_velocity)
        for time_ns, pose in topics["/turtle1/pose"]
    ]
    poses = run.poses
    assert poses.speed_m_s is not None
    assert poses.turn_rate_rad_s is not None
    columns = [poses.xy_m[:, 0], poses.xy_m[:, 1], poses.heading_rad]
    columns += [poses.speed_m_s, poses.turn_rate_rad_s]
    rounded = [column.astype(np.float32).astype(float).tolist() for column in columns]
    assert found == list(zip(poses.time_ns.tolist(), *rounded, strict=True))


def test_others_read_the_exact_poses(topics: Any, run: Run) -> None:
    found = [(pose.x, pose.y, pose.theta) for _, pose in topics["/turtle1/pose64"]]
    assert found == [
        (*xy_m, heading_rad)
        for xy_m, heading_rad in zip(
            run.poses.xy_m.tolist(), run.poses.heading_rad.tolist(), strict=True
        )
    ]


def test_others_read_the_commands(topics: Any, run: Run) -> None:
    found = [
        (time_ns, command.linear.x, command.linear.y, command.angular.z)
        for time_ns, command in topics["/turtle1/cmd_vel"]
    ]
    commands = run.commands
    assert found == list(
        zip(
            commands.time_ns.tolist(),
            commands.speed_m_s.tolist(),
            commands.lateral_speed_m_s.tolist(),
            commands.turn_rate_rad_s.tolist(),
            strict=True,
        )
    )


def test_others_read_the_samples(topics: Any, run: Run) -> None:
    samples, messages = run.samples, topics["/turtle1/control"]
    assert samples.error_xy_m is not None
    assert samples.world_velocity_m_s is not None
    columns = {
        "sequence": samples.sequence,
        "pose_sequence": samples.pose_sequence,
        "phase": samples.phase,
        "bearing": samples.bearing_rad,
        "heading_error": samples.heading_error_rad,
        "error_x": samples.error_xy_m[:, 0],
        "error_y": samples.error_xy_m[:, 1],
        "distance": samples.distance_m,
        "wanted_speed": samples.wanted_speed_m_s,
        "wanted_turn_rate": samples.wanted_turn_rate_rad_s,
        "speed": samples.speed_m_s,
        "turn_rate": samples.turn_rate_rad_s,
        "world_v_x": samples.world_velocity_m_s[:, 0],
        "world_v_y": samples.world_velocity_m_s[:, 1],
    }
    assert [time_ns for time_ns, _ in messages] == samples.time_ns.tolist()
    for name, column in columns.items():
        assert column is not None
        assert [getattr(message, name) for _, message in messages] == column.tolist()


def test_others_read_goal_phases_and_events(topics: Any, run: Run) -> None:
    [(time_ns, goal)] = topics["/turtle1/goal"]
    assert (time_ns, goal.header.frame_id) == (0, "world")
    assert (goal.pose.position.x, goal.pose.position.y) == run.goal_xy_m
    assert 2 * np.arctan2(goal.pose.orientation.z, goal.pose.orientation.w) == pytest.approx(1.0)
    phases = [phase.data for _, phase in topics["/turtle1/phase"]]
    assert phases == ["rotate", "pause", "translate", "done"]
    found = [(time_ns, log.function, log.msg, log.name) for time_ns, log in topics["/rosout"]]
    assert found == [(event.time_ns, event.kind, event.text, "controller") for event in run.events]


def test_messages_stand_in_order_of_time(path: Path) -> None:
    with path.open("rb") as stream:
        messages = make_reader(stream).iter_messages(log_time_order=False)
        times = [(message.log_time, message.publish_time) for _, _, message in messages]
    assert times == sorted(times)
    assert all(log_time == publish_time for log_time, publish_time in times)


def test_a_command_carries_the_number_of_its_sample(path: Path, run: Run) -> None:
    with path.open("rb") as stream:
        messages = make_reader(stream).iter_messages(topics=["/turtle1/cmd_vel"])
        assert [message.sequence for _, _, message in messages] == run.samples.sequence.tolist()


def test_the_file_says_what_it_is(path: Path, run: Run) -> None:
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        [metadata], [attachment] = [*reader.iter_metadata()], [*reader.iter_attachments()]
        header, summary = reader.get_header(), reader.get_summary()
    assert (header.profile, metadata.name, attachment.name) == (
        "ros2",
        "turtlelog",
        "scenario.toml",
    )
    assert metadata.metadata["format_version"] == "2"
    assert summary is not None
    assert {chunk.compression for chunk in summary.chunk_indexes} == {"zstd"}
    assert {schema.encoding for schema in summary.schemas.values()} == {"ros2msg"}


def test_the_attached_scenario_simulates_the_run_again(tmp_path: Path) -> None:
    write_recording(simulate_preset("paper-kp1"), tmp_path / "run.mcap")
    with (tmp_path / "run.mcap").open("rb") as stream:
        [attachment] = make_reader(stream).iter_attachments()
    assert parse_scenario(attachment.data.decode()) == get_preset("paper-kp1")


def test_no_index_is_empty(tmp_path: Path) -> None:
    write_recording(make_run(np.ones(2)), tmp_path / "run.mcap")
    with (tmp_path / "run.mcap").open("rb") as stream:
        records = [*StreamReader(stream, validate_crcs=True).records]
    groups = [record for record in records if isinstance(record, SummaryOffset)]
    assert all(group.group_length for group in groups)
    assert not any(isinstance(record, Attachment) for record in records)


def test_velocities_that_need_it_are_there_in_double_precision(tmp_path: Path) -> None:
    write_recording(make_run(np.array([0.1])), tmp_path / "run.mcap")
    [(_, velocity)] = read_with_rosbags(tmp_path / "run.mcap")["/turtle1/velocity64"]
    assert (velocity.linear.x, velocity.angular.z) == (0.1, 0.1)


def test_what_is_absent_is_nan_for_others(tmp_path: Path) -> None:
    run = make_run(np.ones(1))
    poses = replace(run.poses, speed_m_s=None, turn_rate_rad_s=None)
    write_recording(replace(run, poses=poses), tmp_path / "run.mcap")
    [(_, pose)] = read_with_mcap(tmp_path / "run.mcap")["/turtle1/pose"]
    assert np.isnan([pose.linear_velocity, pose.angular_velocity]).all()
