from .any_file import (
    read_as_chosen as read_as_chosen,
    read_file_info as read_file_info,
    read_run as read_run,
    read_trajectory as read_trajectory,
)
from .engine.topic_columns import (
    TopicColumns as TopicColumns,
    iter_columns as iter_columns,
    read_columns as read_columns,
)
from .exported_tables import (
    export_csv as export_csv,
    export_parquet as export_parquet,
    holds_tables as holds_tables,
    import_tables as import_tables,
)
from .file_access import Loss as Loss, replace_when_complete as replace_when_complete
from .file_info import (
    RecordingInfo as RecordingInfo,
    TopicInfo as TopicInfo,
    read_info as read_info,
)
from .mcap_writer import (
    write_columns as write_columns,
)
from .paper_log import (
    import_log as import_log,
    is_papers as is_papers,
)
from .plain_tables import (
    Cells as Cells,
    import_plain_table as import_plain_table,
)
from .planar_poses import (
    ACKERMANN_TYPES as ACKERMANN_TYPES,
    COMMAND_TYPES as COMMAND_TYPES,
    JOINTS as JOINTS,
    POSE_TYPES as POSE_TYPES,
)
from .read_choice import (
    CHOSEN as CHOSEN,
    CLOCK_SET as CLOCK_SET,
    NEEDS_WHEELBASE as NEEDS_WHEELBASE,
    NEEDS_WHEELS as NEEDS_WHEELS,
    NOTES as NOTES,
    UNREAD_COMMANDS as UNREAD_COMMANDS,
    UNUSED as UNUSED,
    ReadChoice as ReadChoice,
    ReadOptions as ReadOptions,
    label_note as label_note,
    list_notes_after as list_notes_after,
    split_topic as split_topic,
)
from .recording.head import PartialRecordingWarning as PartialRecordingWarning
from .recording.reader import RecordingTail as RecordingTail, read_recording as read_recording
from .recording.recorder import Recorder as Recorder
from .recording.run_writer import (
    export_rosbag2 as export_rosbag2,
    write_recording as write_recording,
)
from .recovery import (
    RecoveryReport as RecoveryReport,
    recover_recording as recover_recording,
)
from .ros2 import (
    Surroundings as Surroundings,
    read_bag as read_bag,
    read_surroundings as read_surroundings,
)
from .table_columns import (
    assign_columns as assign_columns,
    find_table_robots as find_table_robots,
)
from .table_files import (
    KITTI_COLUMNS as KITTI_COLUMNS,
    PlainTable as PlainTable,
    export_tum as export_tum,
    read_plain_table as read_plain_table,
)
from .units import (
    read_time as read_time,
)
