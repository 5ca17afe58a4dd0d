"""Any file -> Run: the kind is told by what is in it."""

import warnings
from pathlib import Path
from typing import Final, Unpack

from mcap.writer import MCAP0_MAGIC

from turtlelog.errors import LogError
from turtlelog.log.engine.opening import is_sqlite
from turtlelog.log.error_boundary import name_file, open_file
from turtlelog.log.importers import LOG_SUFFIXES, import_log
from turtlelog.log.importers.exported_tables import holds_tables, import_tables
from turtlelog.log.info import RecordingInfo, read_info
from turtlelog.log.read_choice import ReadChoice, ReadOptions
from turtlelog.log.recording.contents import PartialRecordingWarning
from turtlelog.log.recording.reader import read_if_own
from turtlelog.log.recording.topics import COMMAND, POSE
from turtlelog.log.ros2 import list_bag_files, read_bag, read_bag_info
from turtlelog.run import Run


def read_run(path: str | Path, **options: Unpack[ReadOptions]) -> Run:
    """Return the run in a recording, somebody's bag or .mcap, a paper's log, or exported tables.

    Args:
        path: A file, or a bag's folder; one that holds a recording of turtlelog's is read as that.
        options: Fields of a `ReadChoice`: which topics of somebody else's files to read, and
            whether an unfinished recording may be read, with a `PartialRecordingWarning`.

    Raises:
        LogError: One line with the file and the place.
    """
    path, choice = Path(path), ReadChoice(**options)
    with name_file(path, expected="a recording, a bag or a log"):
        is_folder = path.is_dir()
        has_tables = holds_tables(path)
    if has_tables:
        return import_tables(path)
    if path.suffix.lower() in LOG_SUFFIXES and not is_folder and not _is_mcap(path):
        return import_log(path)
    # A recording of ours holds more than its poses and commands: asking for these loses nothing.
    asked = choice.pose_topic, choice.command_topic
    is_usual = asked[0] in {None, POSE.name} and asked[1] in {None, COMMAND.name}
    # What should be a recording, and is no MCAP file, is told so.
    if is_usual or not (is_folder or _is_mcap(path)):
        own = _read_own(path, allow_partial=choice.allow_partial)
        if own is not None:
            return own
    return read_bag(path, **options)


def read_as_chosen(path: str | Path, choice: ReadChoice) -> Run:
    """Return the run in a file as `read_run` does; its notes alone tell what is lost."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PartialRecordingWarning)
        return read_run(path, **{name: getattr(choice, name) for name in _OPTIONS})


_OPTIONS: Final = tuple(ReadOptions.__annotations__)


def read_file_info(path: str | Path, *, allow_partial: bool = False) -> RecordingInfo:
    """Return what is in any file that `read_run` takes: a recording, a bag's folder, a paper's log.

    Args:
        path: A log is read as a whole; of the others `read_info` and `read_bag_info` tell.
        allow_partial: As in `read_info`.

    Raises:
        LogError: One line with the file and the place.
    """
    path = Path(path)
    with name_file(path, expected="a recording, a bag or a log"):
        is_folder = path.is_dir()
        has_tables = holds_tables(path)
    if is_folder and not has_tables:
        return read_bag_info(path)
    is_log = path.suffix.lower() in LOG_SUFFIXES
    if not has_tables and (not is_log or _is_mcap(path)):
        return read_info(path, allow_partial=allow_partial)
    run = import_tables(path) if has_tables else import_log(path)
    rows = f"{len(run.poses)} poses, {len(run.commands)} commands, {len(run.samples)} samples"
    return RecordingInfo(
        file=str(path),
        format_version=None,
        source=run.source,
        name=run.name,
        complete=True,
        stop_reason=run.stop_reason,
        duration_s=(run.end_ns - run.start_ns) / 1e9,
        parameters=run.parameters,
        topics=(),
        absent=run.absent,
        notes={"rows": rows, **run.notes},
    )


def _is_mcap(path: Path) -> bool:
    with name_file(path, expected="a recording, a bag or a log"), open_file(path) as stream:
        return stream.read(len(MCAP0_MAGIC)) == MCAP0_MAGIC


def _read_own(path: Path, *, allow_partial: bool) -> Run | None:
    """Return the run in a file or bag that turtlelog wrote, None in one that somebody else did.

    Raises:
        LogError: Also where the file is too damaged to say who did.
    """
    files = list_bag_files(path) if path.is_dir() else (path,)
    if len(files) != 1 or is_sqlite(files[0]):
        return None
    try:
        return read_if_own(files[0], allow_partial=allow_partial)
    except LogError:
        if _is_mcap(files[0]) and _is_foreign(files[0]):
            return None
        raise


def _is_foreign(path: Path) -> bool:
    """Return whether a file that cannot be read as a recording still says that it is none."""
    try:
        return read_info(path).format_version is None
    except LogError:
        return False
