from .contents import PartialRecordingWarning as PartialRecordingWarning
from .live_run import Recorder as Recorder
from .reader import (
    RecordingTail as RecordingTail,
    read_if_own as read_if_own,
    read_recording as read_recording,
)
from .run_writer import write_recording as write_recording
