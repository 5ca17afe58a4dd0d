"""Bags that others left, in every command that reads them."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.cli.conftest import Call
from tests.log.ros1_bags import write_ros1
from tests.log.ros2.bags import make_command, make_poses, write_mcap, write_metadata, write_sqlite

MakeBag = Callable[..., Path]
COMMANDS = [["info"], ["metrics"], ["replay", "--plant"], ["convert", "-o", "out"]]
commands = pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command[0])


@pytest.fixture
def make_bag(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> MakeBag:
    """Return a bag whose description names some files."""
    monkeypatch.chdir(tmp_path)

    def make(*files: str, storage: str = "mcap", mode: str = '""') -> Path:
        for folder in (Path("bag"), Path("other")):
            folder.mkdir()
            write_mcap(folder / "a.mcap", [*make_poses(), make_command()])
        return write_metadata(Path("bag"), files, storage=storage, mode=mode)

    return make


def refuse(call: Call, command: list[str], bag: Path) -> str:
    """Return the one line that a command says of a bag."""
    answer = call(command[0], bag, *command[1:])
    assert (answer.code, answer.out, answer.err.count("\n")) == (2, "", 1)
    assert not Path("out").exists()
    return answer.err.removeprefix("turtlelog: error: ").rstrip("\n")


@commands
@pytest.mark.parametrize("name", ["a.mcap", "bag/a.mcap", "old_name/a.mcap", "bag\\\\a.mcap"])
def test_a_file_is_found_in_the_folder(
    call: Call, make_bag: MakeBag, command: list[str], name: str
) -> None:
    assert call(command[0], make_bag(name), *command[1:]).code == 0


def test_a_file_may_lie_in_a_folder_of_the_bag(call: Call, make_bag: MakeBag) -> None:
    bag = make_bag("more/a.mcap")
    (bag / "more").mkdir()
    write_mcap(bag / "more" / "a.mcap", make_poses(7))
    (answer,) = call("info", bag, "--json").json
    assert [topic["count"] for topic in answer["topics"]] == [7]


@commands
@pytest.mark.parametrize(
    "name", ["../other/a.mcap", "/nosuch/a.mcap", "C:\\\\a.mcap", "x/../a.mcap"]
)
def test_a_file_elsewhere_is_not_read(
    call: Call, make_bag: MakeBag, command: list[str], name: str
) -> None:
    bag = make_bag(name)
    assert call(command[0], bag, *command[1:]).code == 0
    (bag / "a.mcap").unlink()
    shutil.rmtree("out", ignore_errors=True)
    line = refuse(call, command, bag)
    assert line.endswith(f"relative_file_paths: expected the file {name}, found none")


@commands
def test_a_file_named_twice_is_not_counted_twice(
    call: Call, make_bag: MakeBag, command: list[str]
) -> None:
    line = refuse(call, command, make_bag("a.mcap", "bag/a.mcap"))
    assert line.endswith("relative_file_paths: expected each file once, found a.mcap twice")


@commands
@pytest.mark.parametrize("mode", ["FILE", "MESSAGE", "file"])
def test_what_is_in_a_file_tells_whether_it_is_compressed(
    call: Call, make_bag: MakeBag, command: list[str], mode: str
) -> None:
    assert call(command[0], make_bag("a.mcap", mode=mode), *command[1:]).code == 0


@commands
def test_a_bag_in_sqlite_is_read_by_every_command(
    call: Call, make_bag: MakeBag, command: list[str]
) -> None:
    bag = make_bag("a.db3", storage="sqlite3")
    (bag / "a.mcap").unlink()
    write_sqlite(bag / "a.db3", [*make_poses(), make_command()])
    for path in (bag, bag / "a.db3"):
        shutil.rmtree("out", ignore_errors=True)
        assert call(command[0], path, *command[1:]).code == 0


def test_a_bag_in_one_file_is_a_recording_where_a_scenario_is_asked_for(
    call: Call, make_bag: MakeBag
) -> None:
    bag = make_bag("a.db3", storage="sqlite3")
    write_sqlite(bag / "a.db3", [*make_poses(), make_command()])
    assert "no loop is declared" in call("theory", bag / "a.db3").out
    assert "has no whole scenario to simulate" in call("run", write_ros1(bag / "old.bag")).err


@commands
def test_a_bag_of_ros_1_is_read_by_every_command(
    call: Call, make_bag: MakeBag, command: list[str]
) -> None:
    file = write_ros1(make_bag("a.mcap") / "old.bag")
    answer = call(command[0], file, *command[1:])
    # A robot that is not turtlesim has no plant to replay.
    is_refused = "velocities, which turtlesim publishes" in answer.err
    assert answer.code == (2 if command[0] == "replay" else 0)
    assert is_refused == (command[0] == "replay")


def test_info_says_that_a_bag_is_of_ros_1(call: Call, make_bag: MakeBag) -> None:
    file = write_ros1(make_bag("a.mcap") / "old.bag")
    assert call("info", file).out.startswith("old.bag: ROS 1 bag of a robot (not turtlesim), ")


@commands
def test_a_bag_of_ros_1_that_is_cut_is_told_with_what_repairs_it(
    call: Call, make_bag: MakeBag, command: list[str]
) -> None:
    file = make_bag("a.mcap") / "old.bag"
    file.write_bytes(b"#ROSBAG V2.0\n" + bytes(99))
    assert "expected a field op of 1 bytes" in refuse(call, command, file)


def test_a_bag_is_recovered_into_a_folder(call: Call, make_bag: MakeBag) -> None:
    bag = make_bag("a.mcap")
    answer = call("convert", "--recover", bag, "-o", "whole", "--json")
    assert (answer.json["recovered"], answer.json["output"]) == (
        {"/turtle1/cmd_vel": 1, "/turtle1/pose": 3},
        "whole",
    )
    assert call("metrics", "whole").code == 0
    answer = call("convert", "--recover", bag, "-o", "whole")
    assert (answer.code, answer.err.count("\n")) == (2, 1)
    assert "whole: this folder has files; name a new one" in answer.err


def test_a_description_that_is_no_text_is_noted(call: Call, make_bag: MakeBag) -> None:
    bag = make_bag("a.mcap")
    (bag / "metadata.yaml").write_bytes(b"rosbag2_bagfile_information:\n  \xff")
    (answer,) = call("info", bag, "--json").json
    line = "metadata.yaml: expected text in UTF-8, found byte 0xff at 31; in order of name: a.mcap"
    assert answer["notes"]["bag_files"].endswith(line)


def test_a_byte_order_mark_is_no_part_of_the_text(call: Call, make_bag: MakeBag) -> None:
    place = make_bag("a.mcap") / "metadata.yaml"
    place.write_bytes(b"\xef\xbb\xbf" + place.read_bytes())
    assert call("info", "bag").code == 0


@pytest.mark.parametrize("command", COMMANDS[1:], ids=lambda command: command[0])
def test_an_empty_bag_holds_no_run_but_is_described(
    call: Call, make_bag: MakeBag, command: list[str]
) -> None:
    bag = make_bag("a.mcap")
    write_mcap(bag / "a.mcap", [])
    assert "no poses; it contains" in refuse(call, command, bag)
    assert call("info", bag, "--json").json[0]["topics"] == []


TOLERANCES = 'format = 1\nreference = "good"\n[signals.x]\nabs = 0.01\nreason = "a centimetre"\n'


@pytest.fixture
def two_robots(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A bag of two turtles, of which the second is elsewhere; and tolerances."""
    monkeypatch.chdir(tmp_path)
    Path("tol.toml").write_text(TOLERANCES, encoding="utf-8")
    turtles = [*make_poses(), *make_poses(topic="/turtle2/pose", x=7.0)]
    return write_mcap(tmp_path / "two.mcap", turtles)


@pytest.mark.parametrize("topic", ["/turtle1/pose", "/turtle2/pose"])
def test_a_reference_is_read_with_the_topics_that_the_runs_are(
    call: Call, two_robots: Path, topic: str
) -> None:
    words = ("tol.toml", two_robots, "--pose-topic", topic, "--reference")
    answer = call("check", *words, two_robots)
    line = f"{two_robots}: poses from {topic} (turtlesim/msg/Pose), no commands\n"
    assert (answer.code, answer.err) == (0, line)
    other = write_mcap(two_robots.with_name("one.mcap"), make_poses(x=7.0))
    assert call("check", *words, other).code == (1 if topic == "/turtle1/pose" else 0)


def test_a_reference_that_is_read_wrongly_is_bad_input(call: Call, two_robots: Path) -> None:
    poses = [row for side in ("left", "right") for row in make_poses(topic=f"/{side}/pose")]
    unclear = write_mcap(two_robots.with_name("unclear.mcap"), poses)
    answer = call("check", "tol.toml", two_robots, "--reference", unclear)
    assert (answer.code, answer.out) == (2, "")
    assert "unclear.mcap: pose_topic: expected one topic" in answer.err
    answer = call("check", "tol.toml", two_robots, "--reference", "tol.toml")
    assert (answer.code, answer.out) == (2, "")


def test_a_cut_bag_says_that_it_is_cut_whatever_topic_is_asked_for(
    call: Call, two_robots: Path
) -> None:
    cut = two_robots.with_name("cut.mcap")
    cut.write_bytes(two_robots.read_bytes()[:400])
    for words in ([], ["--pose-topic", "/odom"]):
        answer = call("metrics", cut, *words)
        assert answer.code == 2
        assert ": truncated or unfinished (no end of an MCAP file" in answer.err
        assert answer.err.rstrip().endswith("; turtlelog convert --recover reads what is left")
