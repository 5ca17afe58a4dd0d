"""What is said of files that turtlelog did not write: what they hold, and what they lack."""

import shutil
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from tests.cli.conftest import Call
from tests.log.ros2.bags import make_command, make_poses, write_mcap, write_metadata
from tests.log.ros2.test_unread_encodings import FLAT, write_encoded
from tests.log.test_importers import make_log, write_csv, write_json

NEVER = ["samples", "goal_xy_m", "goal_heading_rad", "parameters", "stop_reason", "events"]


@pytest.fixture
def plain(kp10: Path, tmp_path: Path) -> Path:
    """A recording's messages in a file without turtlelog's metadata record."""
    path = tmp_path / "plain.mcap"
    with kp10.open("rb") as source, path.open("wb") as target:
        writer, numbers = Writer(target), {}
        writer.start(profile="ros2")
        for schema, channel, message in make_reader(source).iter_messages():
            assert schema is not None
            if channel.topic not in numbers:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                numbers[channel.topic] = writer.register_channel(channel.topic, "cdr", number)
            writer.add_message(
                numbers[channel.topic], message.log_time, message.data, message.publish_time
            )
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def test_info_lists_what_a_strangers_file_lacks(call: Call, tmp_path: Path) -> None:
    write_mcap(tmp_path / "a.mcap", [*make_poses(), make_command()])
    bag = write_metadata(tmp_path, ["a.mcap"])
    alone, folder = call("info", tmp_path / "a.mcap", bag, "--json").json
    assert alone["absent"] == folder["absent"] == NEVER
    words = ", ".join(NEVER).replace("goal_xy_m, goal_heading_rad", "goal, heading at the goal")
    assert f"absent {words}" in " ".join(call("info", bag, "--topics").out.split())


def test_what_a_file_holds_is_not_called_absent(call: Call, plain: Path) -> None:
    (answer,) = call("info", plain, "--json").json
    assert answer["absent"] == ["parameters", "stop_reason"]
    counts = {topic["topic"]: topic["count"] for topic in answer["topics"]}
    assert (counts["/turtle1/control"], counts["/turtle1/goal"]) == (770, 1)


def test_samples_of_a_file_that_does_not_say_whose_they_are_are_read(
    call: Call, plain: Path
) -> None:
    refused = call("replay", plain, "--law")
    assert (refused.code, refused.out) == (2, "")
    assert "expected a run with its whole scenario" in refused.err
    (measured,) = call("metrics", plain, "--metric", "rotate.overshoot", "--json").json
    # Which law it was, and so which loops it had, nothing tells.
    (overshoot,) = measured["metrics"]
    assert (overshoot["value"], overshoot["status"]) == (None, "no_phase")


def test_samples_that_are_not_there_are_called_missing(call: Call, tmp_path: Path) -> None:
    write_mcap(tmp_path / "a.mcap", [*make_poses(), make_command()])
    answer = call("replay", tmp_path / "a.mcap", "--law")
    assert "(topic /turtle1/control): what the law read" in answer.err


@pytest.mark.parametrize("write", [write_json, write_csv])
def test_info_describes_a_log_of_the_papers(call: Call, tmp_path: Path, write: object) -> None:
    path = write(make_log(), tmp_path)  # type: ignore[operator]
    (answer,) = call("info", path, "--json").json
    (measured,) = call("metrics", path, "--metric", "run.duration", "--json").json
    assert answer["file"] == str(path)
    assert answer["name"] == measured["name"]
    assert (answer["format_version"], answer["complete"], answer["topics"]) == (None, True, [])
    assert (answer["duration_s"], answer["stop_reason"]) == (0.75, "finished")
    assert "samples.wanted_speed_m_s" in answer["absent"]
    text = call("info", path).out
    assert "4 poses, 4 commands, 4 samples" in text
    assert "topics" not in text


def test_info_says_what_is_wrong_with_a_log(call: Call, tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text("{}")
    answer = call("info", tmp_path / "a.json", tmp_path / "none.csv")
    assert (answer.code, answer.err.count("\n")) == (2, 2)
    assert f"{tmp_path / 'a.json'}: " in answer.err
    assert f"{tmp_path / 'none.csv'}: no such file" in answer.err


@pytest.mark.parametrize("size", [60, 400, 3000, 20000, 60000, 90000])
def test_recover_is_advised_where_it_recovers(
    call: Call, kp10: Path, tmp_path: Path, size: int
) -> None:
    cut = tmp_path / "cut.mcap"
    data = kp10.read_bytes()
    assert size < len(data)
    cut.write_bytes(data[:size])
    is_advised = f"Fix: turtlelog convert --recover {cut} -o OUT" in call("info", cut).out
    refused = call("metrics", cut)
    assert refused.code == 2
    assert (f"turtlelog convert --recover {cut} -o OUT rewrites" in refused.err) == is_advised
    answer = call("convert", "--recover", cut, "-o", tmp_path / "whole.mcap")
    assert is_advised == (answer.code == 0)
    if not is_advised:
        assert "Fix: copy the file again from its source" in call("info", cut).out


def test_recover_takes_a_bag_that_was_never_closed(call: Call, kp4: Path, tmp_path: Path) -> None:
    bag, whole = tmp_path / "bag", tmp_path / "whole.mcap"
    bag.mkdir()
    (bag / "bag_0.mcap").write_bytes(kp4.read_bytes()[:-3000])
    answer = call("convert", "--recover", bag, "-o", whole)
    assert (answer.code, answer.err) == (0, "")
    assert "from bag_0.mcap; no message is lost" in answer.flat
    again = call("convert", "--recover", bag, "-o", bag / "bag_0.mcap")
    assert (again.code, again.err.count("\n")) == (2, 1)
    shutil.copy(kp4, bag / "bag_1.mcap")
    refused = call("convert", "--recover", bag, "-o", whole)
    assert "expected a folder with one file to make one .mcap file of it" in refused.err
    (tmp_path / "empty").mkdir()
    nothing = call("convert", "--recover", tmp_path / "empty", "-o", whole)
    assert "no recordings in this folder (no metadata.yaml, .mcap or .db3" in nothing.err


@pytest.mark.parametrize(
    "words",
    [
        *(["metrics"], ["explain"], ["identify"], ["replay"], ["view"]),
        *(["plot", "-o", "out.pdf"], ["report", "-o", "out.html"], ["convert", "-o", "out.csv"]),
        ["compare", "--reference", "other.mcap"],
    ],
    ids=" ".join,
)
def test_every_command_names_an_encoding_that_is_not_read(
    words: list[str], call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("a.mcap", "other.mcap"):
        write_encoded(tmp_path / name, "flatbuffer", "flatbuffer", "nav_msgs/Odometry")
    answer = call(*words, "a.mcap")
    assert (answer.code, answer.out) == (2, "")
    assert f"a.mcap: topic /odom: not understood: {FLAT}" in answer.err.replace("other", "a")


def test_info_names_the_encoding_of_poses_that_are_not_read(call: Call, tmp_path: Path) -> None:
    path = write_encoded(tmp_path / "a.mcap", "flatbuffer", "flatbuffer", "nav_msgs/Odometry")
    (answer,) = call("info", path, "--json").json
    told = f"no poses that can be read: topic /odom: not understood: {FLAT}"
    assert answer["summary"].startswith(told)
    assert answer["missing"] == []
