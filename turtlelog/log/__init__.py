"""Run <-> files: topics and schemas, writer, reader, importers."""

from turtlelog.log.atomic import replace_when_complete
from turtlelog.log.importers import import_log
from turtlelog.log.info import RecordingInfo, TopicInfo, read_info
from turtlelog.log.reader import read_recording
from turtlelog.log.writer import write_recording

__all__ = [
    "RecordingInfo",
    "TopicInfo",
    "import_log",
    "read_info",
    "read_recording",
    "replace_when_complete",
    "write_recording",
]
