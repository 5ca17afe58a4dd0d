import os
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from turtlelog.errors import LogError, RunError
from turtlelog.log import (
    RecordingTail,
    import_log,
    read_columns,
    read_info,
    read_recording,
    read_run,
    recover_recording,
)
from turtlelog.log.file_access import name_file

READERS: list[Callable[[Path], Any]] = [
    read_columns,
    read_info,
    read_recording,
    read_run,
    import_log,
    RecordingTail,
    lambda path: recover_recording(path, path.with_name("out.mcap")),
]


@pytest.mark.parametrize("error", [struct.error, KeyError, MemoryError, OverflowError, RunError])
def test_what_foreign_bytes_cause_names_the_file(error: type[Exception]) -> None:
    with pytest.raises(LogError, match=r"^a\.mcap: "), name_file("a.mcap", expected="a recording"):
        raise error("odd")


@pytest.mark.parametrize("error", [AttributeError, NameError, AssertionError, ImportError])
def test_a_defect_of_our_own_is_not_blamed_on_the_file(error: type[Exception]) -> None:
    with pytest.raises(error), name_file("a.mcap", expected="a recording"):
        raise error("defect")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="has no pipes with a name")
@pytest.mark.parametrize("read", READERS)
def test_a_pipe_is_refused_and_not_waited_for(read: Callable[[Path], Any], tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.mcap")
    with pytest.raises(LogError, match=r"a\.mcap: expected a file, found a pipe$"):
        read(tmp_path / "a.mcap")


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="has no such device")
@pytest.mark.parametrize("read", READERS)
def test_a_device_without_an_end_is_refused(read: Callable[[Path], Any], tmp_path: Path) -> None:
    (tmp_path / "a.mcap").symlink_to("/dev/zero")
    with pytest.raises(LogError, match=r"a\.mcap: expected a file, found a device$"):
        read(tmp_path / "a.mcap")
