"""The identity of every message type in a recording, as ROS 2 computes it.

RIHS01 is the SHA-256 of a type's description (REP 2011): ROS 2 compares it with the hash of the
type it has installed. The texts of `SCHEMAS` and these hashes change together.
"""

import json
import re
from collections.abc import Mapping
from hashlib import sha256
from types import MappingProxyType
from typing import Final

from turtlelog.log.recording.schemas import SCHEMAS, define_states

TYPE_HASHES: Final[Mapping[str, str]] = MappingProxyType(
    {
        name: f"RIHS01_{digest}"
        for name, digest in {
            "geometry_msgs/msg/Pose2D": (
                "d68efa5b46e70f7b16ca23085474fdac5a44b638783ec42f661da64da4724ccc"
            ),
            "geometry_msgs/msg/PoseStamped": (
                "10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8"
            ),
            "geometry_msgs/msg/Twist": (
                "9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a"
            ),
            "rcl_interfaces/msg/Log": (
                "e28ce254ca8abc06abf92773b74602cdbf116ed34fbaf294fb9f81da9f318eac"
            ),
            "std_msgs/msg/String": (
                "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
            ),
            "turtlelog_msgs/msg/ControlSample": (
                "53260607615135d6bf11cc8adaf06aa06e43587b77f3f4c4e3b507e39c602cb9"
            ),
            "turtlesim/msg/Pose": (
                "739beba26bcba6920404ba722b7b8321348512f92ea5be235c47251940dd8aa9"
            ),
        }.items()
    }
)
"""Hash by message type, for every key of `SCHEMAS`."""

_FLOAT64: Final = MappingProxyType(
    {"type_id": 11, "capacity": 0, "string_capacity": 0, "nested_type_name": ""}
)
"""How a type's description names the type of a field (REP 2011)."""


def find_type_hash(kind: str, definition: str) -> str | None:
    """Return the hash of a type of ours, None of one that somebody else has defined."""
    if definition == SCHEMAS.get(kind):
        return TYPE_HASHES[kind]
    # What a law's states are called is known to its definition alone.
    states = re.findall(r"^float64 (\w+)$", definition, flags=re.MULTILINE)
    return _hash_states(kind, states) if definition == define_states(states) else None


def _hash_states(kind: str, names: list[str]) -> str:
    fields = [{"name": name, "type": dict(_FLOAT64)} for name in names]
    description = {
        "type_description": {"type_name": kind, "fields": fields},
        "referenced_type_descriptions": [],
    }
    return f"RIHS01_{sha256(json.dumps(description).encode()).hexdigest()}"
