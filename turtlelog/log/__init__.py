"""Run <-> files: topics and schemas, writers, readers, columns of any file, importers, recovery."""

from turtlelog.log.any_file import read_as_chosen, read_file_info, read_run
from turtlelog.log.complete_files import replace_when_complete
from turtlelog.log.container import write_columns
from turtlelog.log.engine import TopicColumns, iter_columns, read_columns
from turtlelog.log.engine.walk import Loss
from turtlelog.log.exporters import export_csv, export_parquet, export_rosbag2, export_tum
from turtlelog.log.importers import import_log, import_plain_table
from turtlelog.log.info import RecordingInfo, TopicInfo, read_info
from turtlelog.log.read_choice import CHOSEN, ReadChoice, ReadOptions, split_topic
from turtlelog.log.recording.contents import PartialRecordingWarning
from turtlelog.log.recording.reader import RecordingTail, read_recording
from turtlelog.log.recording.recorder import Recorder
from turtlelog.log.recording.run_writer import write_recording
from turtlelog.log.recovery import RecoveryReport, recover_recording
from turtlelog.log.ros2 import read_bag, read_bag_info

__all__ = [
    "CHOSEN",
    "Loss",
    "PartialRecordingWarning",
    "ReadChoice",
    "ReadOptions",
    "Recorder",
    "RecordingInfo",
    "RecordingTail",
    "RecoveryReport",
    "TopicColumns",
    "TopicInfo",
    "export_csv",
    "export_parquet",
    "export_rosbag2",
    "export_tum",
    "import_log",
    "import_plain_table",
    "iter_columns",
    "read_as_chosen",
    "read_bag",
    "read_bag_info",
    "read_columns",
    "read_file_info",
    "read_info",
    "read_recording",
    "read_run",
    "recover_recording",
    "replace_when_complete",
    "split_topic",
    "write_columns",
    "write_recording",
]
