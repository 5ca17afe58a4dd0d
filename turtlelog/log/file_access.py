"""Access to files: what to read of them, errors of one line, files that appear when complete."""

import math
import os
import stat
import sys
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from io import UnsupportedOperation
from pathlib import Path
from typing import BinaryIO, Final, Literal, TypedDict

from turtlelog.display import join_words
from turtlelog.errors import LogError, TurtlelogError, describe_error
from turtlelog.files.text_files import LFS_POINTER, describe_missing
from turtlelog.files.urls import RemotePath, make_path

_DEFECTS = (AssertionError, AttributeError, ImportError, NameError)

_POINTER_BYTES: Final = 1024
"""Size from which a file is not a pointer, by the specification of Git LFS [bytes]."""


class DamageError(LogError):
    """A damaged or incomplete file."""


class LimitError(DamageError):
    """A file that exceeds the limits for its size, so that the rest would be refused as well."""


class UnfinishedError(DamageError):
    """An unfinished or truncated file."""


@contextmanager
def name_file(path: str | Path, *, expected: str) -> Iterator[None]:
    """Convert errors during reading into a one-line LogError with the file's name.

    For damaged files, libraries raise many kinds of errors. Errors that no file content can cause
    are defects of turtlelog and are not converted.
    """
    try:
        yield
    except _DEFECTS:
        raise
    except FileNotFoundError as err:
        from turtlelog.scenario import PRESETS  # only errors need them

        raise LogError(f"{path}: {describe_missing(path, PRESETS)}") from err
    except OSError as err:
        raise LogError(f"{path}: expected {expected}, found: {err.strerror or err}") from err
    except TurtlelogError as err:
        raise LogError(f"{path}: {err}") from err
    except Exception as err:
        raise LogError(f"{path}: expected {expected}, found {describe_error(err)}") from err


@contextmanager
def name_place(place: str) -> Iterator[None]:
    """Put a place within a file before the text of a LogError."""
    try:
        yield
    except LogError as err:
        raise LogError(f"{place}: {err}") from err


def open_file(path: str | Path) -> BinaryIO:
    """Open a file for reading. Pipes, which may block, and devices, which may not end, are refused.

    Raises:
        LogError: If the path is a pipe, a device or a Git LFS pointer.
        OSError: If the file cannot be read.
    """
    path = make_path(path)
    found = path.stat()
    if not (stat.S_ISREG(found.st_mode) or stat.S_ISDIR(found.st_mode)):
        kind = "pipe" if stat.S_ISFIFO(found.st_mode) else "device"
        raise LogError(f"expected a file, found a {kind}")
    stream = path.file.open() if isinstance(path, RemotePath) else path.open("rb")
    if found.st_size < _POINTER_BYTES:
        if stream.read(len(LFS_POINTER)) == LFS_POINTER:
            stream.close()
            raise LogError("this is a Git LFS pointer, not the file: git lfs pull")
        stream.seek(0)
    return stream


def name_write_error(path: str | Path, err: Exception) -> LogError:
    """Return a write error with the file's name."""
    if isinstance(err, UnicodeEncodeError):
        return LogError(f"{path}: expected text, found characters that UTF-8 lacks: {err}")
    # An error of an unwritable file names the file already.
    text = str(err)
    return LogError(text if text.startswith(f"{path}: ") else f"{path}: {text}")


@contextmanager
def replace_when_complete(
    path: str | Path, *, raising: type[TurtlelogError] = LogError
) -> Iterator[Path]:
    """Yield a temporary file name next to `path`; the file is renamed when the block succeeds.

    If the block fails, the temporary file is removed and an existing file stays. A replaced file
    keeps its permissions and, if the system allows it, its owner. If `path` is a symbolic link, the
    link stays, and its target is replaced or created. The temporary name ends in `.part`, so it
    does not match `*.mcap`. Writers that guess the format from the name need the format explicitly.

    Args:
        path: File to write.
        raising: Class of the errors.

    Raises:
        LogError: If the path cannot be written, or contains a recording in progress; one line.
    """
    try:
        with _replace(make_path(path)) as temporary:
            yield temporary
    except LogError as err:
        if isinstance(err, raising):
            raise
        raise raising(str(err)) from err


@contextmanager
def _replace(path: Path) -> Iterator[Path]:
    if isinstance(path, RemotePath):
        with _put_when_complete(path) as temporary:
            yield temporary
        return
    # Renaming a file to the name of a device would replace the device.
    if path.exists() and not path.is_file():
        kind = "folder" if path.is_dir() else "device"
        raise LogError(f"{path}: expected the name of a file to write, found a {kind}")
    _refuse_live(path)
    target = Path(os.path.realpath(path))
    if target.is_symlink():
        raise LogError(f"{path}: expected the name of a file to write, found a link to itself")
    temporary = _name_beside(target)
    try:
        # Created at once: if the place is not writable, the error comes before any work is done.
        temporary.touch(exist_ok=False)
        # A file that only its owner may read stays private while it is written.
        _copy_rights(target, temporary, extra=stat.S_IRUSR | stat.S_IWUSR)
        yield temporary
        _refuse_live(path)  # a recording may have begun meanwhile
        _copy_rights(target, temporary)
        temporary.replace(target)
    except OSError as err:
        raise LogError(f"{path}: cannot be written: {err.strerror or err}") from err
    finally:
        temporary.unlink(missing_ok=True)


def _name_beside(target: Path) -> Path:
    return target.with_name(f".turtlelog-{os.urandom(6).hex()}.part")


def remove_leftovers(folder: Path) -> None:
    """Remove temporary files of killed processes from a folder to which no other process writes."""
    for leftover in folder.glob(".turtlelog-" + "[0-9a-f]" * 12 + ".part"):
        with suppress(OSError):  # a folder, or a file that is being renamed
            leftover.unlink()


@contextmanager
def _put_when_complete(path: RemotePath) -> Iterator[Path]:
    """Yield a local temporary name; at the end the file is uploaded to the URL."""
    import tempfile  # only writing needs these

    with name_file(path, expected="a place that can be written"):
        from turtlelog.files.requests import require_writable

        require_writable(path.url)
    try:
        with tempfile.TemporaryDirectory(prefix="turtlelog-") as folder:
            temporary = Path(folder) / f"{path.name}.part"
            temporary.touch()
            yield temporary
            with name_file(path, expected="a place that can be written"):
                path.put(temporary)
    except OSError as err:
        raise LogError(
            f"{path}: expected room for it in {tempfile.gettempdir()}, found: {err.strerror or err}"
        ) from err


def _copy_rights(source: Path, target: Path, *, extra: int = 0) -> None:
    try:
        found = source.stat()
    except FileNotFoundError:
        return
    if hasattr(os, "chown"):
        with suppress(PermissionError):
            os.chown(target, found.st_uid, found.st_gid)
    with suppress(PermissionError):  # a disk without permissions
        target.chmod(stat.S_IMODE(found.st_mode) | extra)


def _refuse_live(path: Path) -> None:
    if is_live(path):
        raise LogError(
            f"{path}: expected a file that may be replaced, found a live recording of it"
        )


@contextmanager
def create_folder(path: str | Path) -> Iterator[Path]:
    """Yield a temporary folder next to `path` for writing; it is renamed when the block succeeds.

    An existing folder is refused, as by `ros2 bag`, because it may contain other files. An empty
    folder is accepted.

    Raises:
        LogError: If the folder is not empty or cannot be written; one line.
    """
    path = make_path(path)
    is_empty = path.is_dir() and not any(path.iterdir())
    if (path.exists() or path.is_symlink()) and not is_empty:
        kind = "a folder with files" if path.is_dir() else "a file"
        raise LogError(f"{path}: expected the name of a new folder, found {kind}")
    import shutil

    # "." and "run/.." get a name only as absolute paths.
    target = path.resolve()
    temporary = _name_beside(target)
    try:
        temporary.mkdir()
        yield temporary
        if is_empty:
            target.rmdir()
        temporary.rename(target)
    except OSError as err:
        raise LogError(f"{path}: cannot be written: {err.strerror or err}") from err
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


if sys.platform == "win32":
    # On this system nobody can replace an open file.
    def mark_live(stream: BinaryIO) -> None:
        """Do nothing."""

    def is_live(path: Path) -> bool:  # noqa: ARG001
        """Return False, because the system itself refuses to replace an open file."""
        return False

else:
    import fcntl

    def mark_live(stream: BinaryIO) -> None:
        """Lock a file while it is open, if the system can, so that `is_live` detects it."""
        try:
            fcntl.flock(stream.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
        except (UnsupportedOperation, OSError):
            return  # no file, or a file system without locks

    def is_live(path: Path) -> bool:
        """Return whether a process is recording to the file with this name; False without one."""
        try:
            with path.open("rb") as stream:
                fcntl.flock(stream.fileno(), fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        except OSError:
            return False
        return False


TimeSource = Literal["auto", "log", "stamp"]
"""Source of pose times: the recorder's clock, stamps mapped to it, or chosen from the bag
(`auto`)."""


class ReadOptions(TypedDict, total=False):
    """The fields of a `ReadChoice`, as arguments by name."""

    pose_topic: str | None
    command_topic: str | None
    path_topic: str | None
    pose_frame: str | None
    world_frame: str | None
    goal: tuple[float, ...] | None
    time: TimeSource
    robot: str | None
    wheel_joints: str | None
    wheels: tuple[float, ...] | None
    wheelbase: float | None
    columns: Mapping[str, str]
    allow_partial: bool
    allow_no_poses: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadChoice:
    """Topics, frames and times to read from third-party files; options for incomplete files.

    Attributes:
        pose_topic: Topic of the poses. Default of all topics: chosen by types and names.
        command_topic: Topic of the commands.
        path_topic: Topic of the path to follow.
        pose_frame: The robot's frame, for poses from transforms.
        world_frame: Reference frame, for poses from transforms.
        goal: Goal x, y [m] and optionally heading [rad]. Default: the goal in the file.
        time: Clock that times the poses.
        robot: Name of one of several robots, as in the topic `/robot2/odom` or column `robot2_x`.
        wheel_joints: Names of the left and the right wheel in sensor_msgs/JointState, as in
            `wheel_left_joint,wheel_right_joint`: poses are the odometry of these wheels.
        wheels: Radius of the wheels and track between them [m].
        wheelbase: Distance between the axles [m], for converting Ackermann commands to turn rates.
        columns: Columns of a plain table, by quantity (`t`, `x`, `y`, `heading` ...). Each value is
            the column name, with a unit in brackets if the name has no unit (`yaw [deg]`).
        allow_partial: Whether to read the intact part of an unfinished or damaged recording.
        allow_no_poses: Whether to read a bag that contains only commands as a run without poses.
    """

    pose_topic: str | None = None
    command_topic: str | None = None
    path_topic: str | None = None
    pose_frame: str | None = None
    world_frame: str | None = None
    goal: tuple[float, ...] | None = None
    time: TimeSource = "auto"
    robot: str | None = None
    wheel_joints: str | None = None
    wheels: tuple[float, ...] | None = None
    wheelbase: float | None = None
    columns: Mapping[str, str] = field(default_factory=dict)
    allow_partial: bool = False
    allow_no_poses: bool = False

    def override(self, other: "ReadChoice") -> "ReadChoice":
        """Return this choice with the settings of another choice added; columns are merged."""
        asked = {name: getattr(other, name) for name in other.list_given()}
        return replace(self, **asked | {"columns": {**self.columns, **other.columns}})

    def list_given(self) -> list[str]:
        """Return the names of the options that differ from their defaults."""
        return [name for name, usual in _USUAL.items() if getattr(self, name) != usual]


CHOSEN: Final = "chosen"
"""Name of a one-line note on the chosen topics. The note is shown on request and never recorded."""

ROBOT: Final = "robot"
"""Name of a note on the robot whose columns were read, of several in a table."""

RESTARTS: Final = "restarts"
"""Name of the note on times that start again, as of two runs one below the other."""

CLOCK_SET: Final = "clock_set"
"""Name of the note on steps of the recorder's clock."""

UNUSED: Final = "unused"
"""Name of a one-line note on options that a file does not use. The note is never recorded."""

FileKind = Literal["table", "recording", "bag"]

_USUAL: Final = {name: getattr(ReadChoice(), name) for name in ReadOptions.__annotations__}

_OF_TABLES: Final = ("columns",)
_OF_EVERY_FILE: Final = ("goal", "allow_partial", "allow_no_poses")
_OF_BAGS: Final = tuple(name for name in _USUAL if name not in {*_OF_TABLES, *_OF_EVERY_FILE})


def describe_unused(choice: ReadChoice, kind: FileKind, commands: str = "") -> str:
    """Return one line on the options that a file does not use, and why; empty without such options.

    Recordings have one clock and turn rates as commands; `commands` are topic and type in a bag.
    """
    given = choice.list_given()
    of_recording = (*_OF_TABLES, "time", "wheelbase")
    never = {"table": _OF_BAGS, "recording": of_recording, "bag": _OF_TABLES}[kind]
    reasons = {"table": "this is a table", "recording": "this is a turtlelog recording"}
    parts = []
    if names := [name for name in given if name in never]:
        texts = [
            f"--column {', '.join(choice.columns)}"
            if name == "columns"
            else f"--{name.replace('_', '-')}"
            for name in names
        ]
        verb = "is" if len(texts) == 1 else "are"
        reason = reasons.get(kind, "this is no table")
        parts.append(f"{join_words(texts)} {verb} not used: {reason}")
    if kind == "bag" and "wheelbase" in given and "ackermann_msgs" not in commands:
        found = f"the commands on {commands} are turn rates"
        parts.append(f"--wheelbase is not used: {found if commands else 'no commands were read'}")
    return "; ".join(parts)


def split_topic(path: str | Path) -> tuple[Path, str | None]:
    """Return the file and the topic of its poses in FILE:TOPIC, as in `bag:/odom_kf`.

    An existing file with the whole name has priority. The slash of the topic is optional.
    """
    path = make_path(path)
    if isinstance(path, RemotePath):
        return path.split_topic()
    text = path.as_posix()
    head, colon, _ = text.rpartition(":")
    while colon and not path.exists():
        topic = text[len(head) + 1 :]
        if head and topic and Path(head).exists():
            return Path(head), topic
        head, colon, _ = head.rpartition(":")
    return path, None


def match_topic(asked: str, names: Collection[str]) -> str:
    """Return the topic with a name, with or without leading slash; or else the name itself."""
    other = asked.removeprefix("/") if asked.startswith("/") else f"/{asked}"
    return other if asked not in names and other in names else asked


def parse_goal_option(goal: tuple[float, ...]) -> tuple[tuple[float, float], float | None]:
    """Return position [m] and heading [rad] of a requested goal; None for a missing heading."""
    if len(goal) not in {2, 3} or not all(map(math.isfinite, goal)):
        raise LogError(f"goal: expected x, y [m] and perhaps a heading [rad], found {goal!r:.60}")
    x_m, y_m, *heading_rad = map(float, goal)
    return (x_m, y_m), heading_rad[0] if heading_rad else None


def parse_joints(text: str) -> tuple[str, str]:
    """Return the names of the left and the right wheel."""
    names = [name.strip() for name in text.split(",")]
    if len(names) != 2 or not all(names) or names[0] == names[1]:
        raise LogError(f"wheel_joints: expected LEFT,RIGHT, two joints, found {text[:60]}")
    return names[0], names[1]


def parse_wheels(values: tuple[float, ...]) -> tuple[float, float]:
    """Return the radius of wheels and the distance between them [m]."""
    if len(values) != 2 or not all(0.0 < value < math.inf for value in values):
        raise LogError(
            f"wheels: expected radius and track above 0 in m, as in (0.033, 0.16), found"
            f" {values!r:.60}"
        )
    return float(values[0]), float(values[1])


def parse_wheelbase(value: float) -> float:
    """Return the distance between the axles [m]."""
    if not 0.0 < value < math.inf:
        raise LogError(f"wheelbase: expected a length above 0 in m, found {value!r:.60}")
    return float(value)
