"""Definitions of our own against those that rosbags carries."""

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from turtlelog.log.engine.channels import KNOWN_TYPES, find_definition
from turtlelog.log.engine.message_types import read_type

# Of packages that rosbags does not carry: nothing to compare with.
OTHERS = {
    "turtlesim/msg/Pose",
    "turtlesim_msgs/msg/Pose",
    "ackermann_msgs/msg/AckermannDrive",
    "ackermann_msgs/msg/AckermannDriveStamped",
}


@pytest.fixture(scope="module")
def store() -> Typestore:
    return get_typestore(Stores.ROS2_JAZZY)


@pytest.mark.parametrize("kind", sorted({*KNOWN_TYPES} - OTHERS))
def test_known_fields_are_those_of_rosbags(kind: str, store: Typestore) -> None:
    text = find_definition(kind)
    assert text is not None
    found = get_types_from_msg(text, kind)
    expected = {name: store.fielddefs[name][1] for name in found}
    if kind == "std_msgs/msg/Empty":  # rosbags writes out the byte that ROS gives such a type
        assert [name for name, _ in expected.pop(kind)] == ["structure_needs_at_least_one_member"]
        assert found.pop(kind)[1] == []
    assert {name: fields for name, (_, fields) in found.items()} == expected


@pytest.mark.parametrize("kind", KNOWN_TYPES)
def test_every_known_type_is_read(kind: str, store: Typestore) -> None:
    text = find_definition(kind)
    assert text is not None
    found = read_type(kind, text).fields
    expected = text.split("=" * 80)[0].splitlines()
    assert [field.name for field in found] == [
        line.split()[1] for line in expected if "=" not in line
    ]
    if kind not in {*OTHERS, "std_msgs/msg/Empty"}:
        assert read_type(kind, store.generate_msgdef(kind, ros_version=2)[0]).fields == found


def test_short_name_means_the_same_type() -> None:
    assert find_definition("geometry_msgs/Twist") == find_definition("geometry_msgs/msg/Twist")
    assert find_definition("turtlesim/msg/Pose") == find_definition("turtlesim_msgs/msg/Pose")


@pytest.mark.parametrize("kind", ["", "Pose", "other_msgs/msg/Pose", "geometry_msgs/msg/Wrench"])
def test_other_types_are_not_known(kind: str) -> None:
    assert find_definition(kind) is None
