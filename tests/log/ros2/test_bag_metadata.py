import re
from contextlib import suppress
from io import StringIO
from typing import Any

import pytest
from hypothesis import given, settings, strategies as st
from mcap.records import Channel, Schema
from ruamel.yaml import YAML

from tests.log.runs import find_shared
from turtlelog.errors import LogError
from turtlelog.log.engine.channels import Catalogue
from turtlelog.log.engine.limits import Allowance
from turtlelog.log.file_info import Survey, format_bag_metadata
from turtlelog.log.ros2.bag_files import parse_bag_metadata

NAMES = st.text(
    st.characters(min_codepoint=32, max_codepoint=0x2FFF, exclude_categories=("C", "Zl", "Zp")),
    min_size=1,
)


def load(text: str) -> Any:
    return YAML(typ="safe").load(StringIO(text))["rosbag2_bagfile_information"]


def format_one(file: str) -> str:
    survey = Survey(catalogue=Catalogue(Allowance(0)), is_finished=True, span_ns=(5, 12))
    survey.counts[1] = 3
    metadata = {"topic_type_hash": "RIHS01_0"}
    schema = Schema(id=1, name="std_msgs/msg/String", encoding="ros2msg", data=b"")
    channel = Channel(id=1, topic="/a", message_encoding="cdr", schema_id=1, metadata=metadata)
    survey.catalogue.add([schema, channel], 0)
    return format_bag_metadata([(file, survey)])


@settings(deadline=None)  # the library takes as long as it takes
@given(name=NAMES)
def test_any_file_name_comes_back_and_a_yaml_library_agrees(name: str) -> None:
    text = format_one(name)
    assert parse_bag_metadata(text).files == (name,)
    assert load(text)["relative_file_paths"] == [name]
    assert load(text)["files"][0]["path"] == name


def test_the_entries_have_the_types_that_rosbag2_expects() -> None:
    found = load(format_one("a.mcap"))
    assert (found["version"], found["storage_identifier"], found["message_count"]) == (8, "mcap", 3)
    assert found["starting_time"] == {"nanoseconds_since_epoch": 5}
    assert found["duration"] == {"nanoseconds": 7}
    assert found["compression_mode"] == found["ros_distro"] == ""
    [topic] = found["topics_with_message_count"]
    assert topic["topic_metadata"]["offered_qos_profiles"] == ""
    assert topic["topic_metadata"]["type_description_hash"] == "RIHS01_0"


def test_what_rosbag2_wrote_is_read() -> None:
    path = find_shared("ros2", "turtlesim_jazzy", "metadata.yaml")
    found = parse_bag_metadata(path.read_text())
    expected = load(path.read_text())
    assert list(found.files) == expected["relative_file_paths"]
    assert (found.storage, found.compression) == ("mcap", "")
    assert found.duration_ns == expected["duration"]["nanoseconds"]


@pytest.mark.parametrize("indent", ["", "  ", "    "])
def test_a_list_may_be_indented_or_not(indent: str) -> None:
    lines = ["rosbag2_bagfile_information:", "  relative_file_paths:"]
    lines += [f"  {indent}- 'it''s.mcap'", f"  {indent}-  b.mcap  ", "", "  # end"]
    text = "\n".join([*lines, "  storage_identifier: mcap", "other:", "  - c"])
    assert parse_bag_metadata(text).files == ("it's.mcap", "b.mcap")


@given(lines=st.lists(st.text("rosbag2_ \t-:'\"[]{}~\\\n", max_size=40)))
def test_any_text_is_read_or_refused(lines: list[str]) -> None:
    text = "\n  ".join(["rosbag2_bagfile_information:", "storage_identifier: mcap", *lines])
    with suppress(LogError):
        found = parse_bag_metadata(f"{text}\n  relative_file_paths:\n  - a.mcap\n")
        assert found.files[-1] == "a.mcap"


PLAIN = """\
rosbag2_bagfile_information:
  version: 5
  storage_identifier: mcap
  duration:
    nanoseconds: 32000000
  relative_file_paths:
    - a.mcap
  compression_mode: ""
"""


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("mcap\n", "mcap  # a comment\n"),
        ("rosbag2_bagfile_information:", "# first\nrosbag2_bagfile_information: # why"),
        ("32000000", "32000000 # ns"),
        ("- a.mcap", '- "a.mcap"  # the only one'),
        ("- a.mcap", "- 'a.mcap'"),
        ("version: 5", "version: 9\n  custom_data: {}\n  topics_with_message_count: []"),
        ("version: 5", "version: 5\n  custom_data:\n    relative_file_paths:\n      - b.mcap"),
        ("\n", "\r\n"),
    ],
)
def test_what_yaml_allows_is_read_as_a_library_reads_it(old: str, new: str) -> None:
    text = PLAIN.replace(old, new)
    found = parse_bag_metadata(text)
    assert found == parse_bag_metadata(PLAIN)
    assert list(found.files) == load(text)["relative_file_paths"]
    assert found.duration_ns == load(text)["duration"]["nanoseconds"]


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ("- a.mcap", "- &x a.mcap", "line 7: relative_file_paths: expected plain text, found '&x"),
        ("- a.mcap", "- ''", "relative_file_paths: expected the name of a file, found \"''\""),
        ("- a.mcap", "- ~", "relative_file_paths: expected the name of a file, found '~'"),
        ("- a.mcap", "- path: a.mcap", "expected the name of a file, found 'path: a.mcap'"),
        ("- a.mcap", "- 'a", 'relative_file_paths: expected text in quotes, found "\'a"'),
        ("    - a.mcap\n", "", "relative_file_paths: expected a list of files, found no file"),
        ("\n    - a.mcap", " a.mcap", "expected a list of files, found a.mcap"),
        ("\n    - a.mcap", " []", "relative_file_paths: expected a list of files, found no file"),
        ("mcap\n", "\n    - mcap\n", "storage_identifier: expected text, found 'mcap'"),
        (
            "  storage_identifier: mcap\n",
            "",
            "storage_identifier: missing",
        ),
        ('""', "\n    a: b", "compression_mode: expected text, found 'a: b'"),
        ("32000000", "9" * 5000, "duration: expected whole nanoseconds below 2^63, found 999"),
        ("32000000", str(2**63), "duration: expected whole nanoseconds below 2^63, found 922"),
        ("32000000", "-5", "duration: expected whole nanoseconds below 2^63, found -5"),
        ("32000000", ".nan", "duration: expected whole nanoseconds below 2^63, found .nan"),
        ("nanoseconds: 32000000", "- 5", "duration: expected nanoseconds, found '5'"),
        ("version: 5", "storage_identifier: a", "storage_identifier: expected once, found again"),
    ],
)
def test_what_is_wrong_is_named_with_its_key(old: str, new: str, line: str) -> None:
    with pytest.raises(LogError, match=re.escape(line)) as caught:
        parse_bag_metadata(PLAIN.replace(old, new))
    assert len(str(caught.value)) < 160


@pytest.mark.thorough
@pytest.mark.parametrize("more", [0, 1])
def test_a_description_has_up_to_a_million_lines(more: int) -> None:
    """A million lines take 2 s."""
    text = "rosbag2_bagfile_information:\n  storage_identifier: mcap\n  relative_file_paths: [a]\n"
    text += "---\n" * (10**6 - 3 + more)
    if not more:
        assert parse_bag_metadata(text).files == ("a",)
        return
    with pytest.raises(LogError, match="expected up to 1,000,000 lines, found more"):
        parse_bag_metadata(text)
