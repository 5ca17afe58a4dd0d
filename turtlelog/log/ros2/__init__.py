"""Bags that ROS 2 or another recorder wrote -> Run, and what makes a folder a bag.

In the order in which a bag is read: `bag_folder` and `bag_metadata` find its files, `bag` opens
them, `bag_topics` chooses topics, `bag_poses` and `bag_transforms` find the poses, `bag_columns`
makes columns of messages, `reported_rates` judges what odometry reports, `stamps` and `bag_clock`
time them, `bag_references` adds goal and path, `bag_samples` a controller's samples,
and `bag_reader` builds the run.
"""

from turtlelog.log.ros2.bag_folder import list_bag_files, read_bag_info
from turtlelog.log.ros2.bag_metadata import (
    METADATA_FILE,
    BagMetadata,
    BagPart,
    BagTopic,
    format_bag_metadata,
    parse_bag_metadata,
)
from turtlelog.log.ros2.bag_reader import read_bag
from turtlelog.log.ros2.bag_topics import COMMAND_TYPES, POSE_TYPES, choose_pose_topic

__all__ = [
    "COMMAND_TYPES",
    "METADATA_FILE",
    "POSE_TYPES",
    "BagMetadata",
    "BagPart",
    "BagTopic",
    "choose_pose_topic",
    "format_bag_metadata",
    "list_bag_files",
    "parse_bag_metadata",
    "read_bag",
    "read_bag_info",
]
