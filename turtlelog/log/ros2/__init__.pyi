from .bag_commands import (
    choose_command_topic as choose_command_topic,
)
from .bag_files import (
    list_bag_files as list_bag_files,
    read_bag_info as read_bag_info,
)
from .bag_poses import (
    read_bag_trajectory as read_bag_trajectory,
)
from .bag_reader import (
    read_bag as read_bag,
)
from .bag_rows import (
    open_bag as open_bag,
)
from .bag_surroundings import (
    OccupancyMap as OccupancyMap,
    Surroundings as Surroundings,
    read_surroundings as read_surroundings,
)
from .bag_topics import (
    BagRobot as BagRobot,
    NoPosesError as NoPosesError,
    choose_pose_topic as choose_pose_topic,
    describe_other_places as describe_other_places,
    find_robots as find_robots,
    select_robot as select_robot,
)
