from .head import PartialRecordingWarning as PartialRecordingWarning
from .reader import (
    RecordingTail as RecordingTail,
    read_if_own as read_if_own,
    read_recording as read_recording,
)
from .recorder import Recorder as Recorder
from .run_writer import write_recording as write_recording
