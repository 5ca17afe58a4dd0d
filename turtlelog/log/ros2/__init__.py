"""Bags that ROS 2 or another recorder wrote -> Run, and what makes a folder a bag."""

from turtlelog.log.ros2.bag_folder import (
    METADATA_FILE,
    BagMetadata,
    BagTopic,
    format_bag_metadata,
    list_bag_files,
    parse_bag_metadata,
    read_bag_info,
)
from turtlelog.log.ros2.bag_reader import read_bag

__all__ = [
    "METADATA_FILE",
    "BagMetadata",
    "BagTopic",
    "format_bag_metadata",
    "list_bag_files",
    "parse_bag_metadata",
    "read_bag",
    "read_bag_info",
]
