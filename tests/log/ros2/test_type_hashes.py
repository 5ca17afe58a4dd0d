import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from tests.log.runs import find_shared
from turtlelog.log.recording.topics import SCHEMAS, TYPE_HASHES


@pytest.mark.parametrize("name", SCHEMAS)
def test_a_hash_is_that_of_the_text_in_recordings(name: str) -> None:
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(SCHEMAS[name], name))
    assert TYPE_HASHES[name] == store.hash_rihs01(name)


@pytest.mark.parametrize("distribution", [Stores.ROS2_HUMBLE, Stores.ROS2_JAZZY])
def test_hashes_are_those_of_the_types_in_ros(distribution: Stores) -> None:
    store = get_typestore(distribution)
    known = TYPE_HASHES.keys() & store.fielddefs.keys()
    assert len(known) == 8
    assert {name: TYPE_HASHES[name] for name in known} == {
        name: store.hash_rihs01(name) for name in known
    }


def test_the_hash_of_a_pose_is_that_of_a_real_turtlesim() -> None:
    text = find_shared("ros2", "turtlesim_jazzy", "metadata.yaml").read_text()
    for name in ("turtlesim/msg/Pose", "geometry_msgs/msg/Twist"):
        assert f"type_description_hash: {TYPE_HASHES[name]}\n" in text


def test_there_is_a_hash_for_every_type() -> None:
    assert TYPE_HASHES.keys() == SCHEMAS.keys()
