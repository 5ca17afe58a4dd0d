"""Options that several commands share: files to read, how to read them, and files to write."""

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Final, Literal

from cyclopts import Group, Parameter, Token

import turtlelog as tl
from turtlelog.cli.console import print_run_notes
from turtlelog.cli.usage import parse_option
from turtlelog.cli.work import show_progress, watch_files
from turtlelog.errors import LogError, RemoteError, TurtlelogError, UsageError
from turtlelog.files.text_files import describe_missing
from turtlelog.files.urls import RemotePath, make_path, parse_size, set_max_download
from turtlelog.libraries import load_library
from turtlelog.log.read_choice import parse_wheelbase, parse_wheels


def _read_place(_: Any, tokens: Sequence[Token]) -> Path:
    return make_path(tokens[0].value)


Place = Annotated[Path, Parameter(converter=_read_place)]
"""A file or a URL, because a plain Path would change a URL."""

File = Annotated[Place, Parameter(name="FILE")]
Files = Annotated[list[Place], Parameter(name="FILE")]
Output = Annotated[Place | None, Parameter(name=("--output", "-o"))]
Partial = Annotated[bool, Parameter(name="--partial")]
Connect = Annotated[str | None, Parameter(name="--connect", metavar="URL")]
Json = Annotated[bool, Parameter(name="--json")]


def _read_budget(_: Any, tokens: Sequence[Token]) -> float:
    text = tokens[0].value
    with suppress(ValueError):
        if 0.0 < float(text) < math.inf:
            return float(text)
    raise UsageError(f"--step-budget-ms {text[:60]}: must be a time above 0 in milliseconds")


StepBudgetMs = Annotated[
    float | None, Parameter(name="--step-budget-ms", metavar="MS", converter=_read_budget)
]


def choose_step_budget(given_ms: float | None) -> float:
    """Return the time limit of a law for one answer, as given or the default [s]."""
    from turtlelog.simulate.step_budget import STEP_BUDGET_S

    return STEP_BUDGET_S if given_ms is None else given_ms / 1e3


def _read_size(_: Any, tokens: Sequence[Token]) -> int:
    """Return a size, and use this limit for every URL of the command."""
    most = parse_size(tokens[0].value)
    if most is None:
        text = tokens[0].value[:60]
        raise UsageError(f"{tokens[0].keyword} {text}: must be a size, as in 500MB or 4GiB")
    set_max_download(most)
    return most


MaxDownload = Annotated[
    int | None, Parameter(name="--max-download", metavar="SIZE", converter=_read_size)
]
"""Option of every command that takes URLs. `limit_downloads` is active during the command."""


_READING: Final = Group("Third-party files", sort_key=2)


@Parameter(name="*", group=_READING)
@dataclass(frozen=True, slots=True, kw_only=True)
class TopicOptions:
    """Options for reading third-party bags and tables, and damaged recordings.

    Attributes:
        pose_topic: Topic of the poses, or FILE:TOPIC to set it for one file. Default: chosen by
            type and name, and named on stderr.
        robot: Name of one of several robots in a bag (/robot1/odom: robot1) or in a table
            (robot1_x: robot1).
        command_topic: Topic of the commands: Twist, TwistStamped, or Ackermann (needs --wheelbase).
        path_topic: Topic of the path to follow: nav_msgs/Path.
        pose_frame: Frame of the robot, if poses come from transforms (/tf).
        world_frame: The frame in which poses from transforms are given.
        time: Source of the times of poses: the recorder's clock (log), stamps mapped to the
            recorder's clock (stamp), or stamps if they are usable (auto).
        wheel_joints: Compute poses from these two joints of sensor_msgs/JointState, the wheels of a
            differential drive. Example: wheel_left_joint,wheel_right_joint.
        wheels: Radius of these wheels and distance between them [m]. Example: 0.033,0.16.
        wheelbase: Distance between the axles [m], needed to convert Ackermann commands to turn
            rates.
        column: Column of a table that contains the quantity NAME: t, x, y, heading or another one.
            Example: "heading=yaw [deg]". Can be repeated.
        partial: Read what an unfinished or damaged recording or table still contains.
        max_download: Largest file to download whole from a URL whose server does not support range
            requests. Example: 500MB. Default: 4GiB.
    """

    pose_topic: Annotated[str | None, Parameter(metavar="TOPIC")] = None
    robot: Annotated[str | None, Parameter(metavar="NAME")] = None
    command_topic: Annotated[str | None, Parameter(metavar="TOPIC")] = None
    path_topic: Annotated[str | None, Parameter(metavar="TOPIC")] = None
    pose_frame: Annotated[str | None, Parameter(metavar="FRAME")] = None
    world_frame: Annotated[str | None, Parameter(metavar="FRAME")] = None
    time: Literal["auto", "log", "stamp"] = "auto"
    wheel_joints: Annotated[str | None, Parameter(metavar="LEFT,RIGHT")] = None
    wheels: Annotated[str | None, Parameter(metavar="RADIUS,TRACK")] = None
    wheelbase: Annotated[str | None, Parameter(metavar="L")] = None
    column: Annotated[list[str] | None, Parameter(metavar="NAME=COLUMN")] = None
    partial: Partial = False
    max_download: MaxDownload = None

    def build_choice(self) -> "tl.log.ReadChoice":
        """Return the options as a choice."""
        names = {one.name for one in fields(TopicOptions)} & {*tl.log.ReadOptions.__annotations__}
        values: dict[str, Any] = {name: getattr(self, name) for name in names}
        values |= {
            "wheels": None if self.wheels is None else _parse_wheels(self.wheels),
            "wheelbase": None if self.wheelbase is None else _parse_length(self.wheelbase),
            "columns": dict(map(_split_column, self.column or ())),
            "allow_partial": self.partial,
        }
        return tl.log.ReadChoice(**values)


@Parameter(name="*", group=_READING)
@dataclass(frozen=True, slots=True, kw_only=True)
class ReadingOptions(TopicOptions):
    """Options for reading, including the goal of a robot whose file has no goal.

    Attributes:
        goal: The robot's goal [m], and the heading there [deg]. Examples: 2,10 and 2,10,90. This
            goal replaces the goal in the bag.
    """

    goal: Annotated[str | None, Parameter(metavar="X,Y[,DEG]", allow_leading_hyphen=True)] = None

    def build_choice(self) -> "tl.log.ReadChoice":
        """Return the options as a choice."""
        choice = super(ReadingOptions, self).build_choice()
        return choice if self.goal is None else replace(choice, goal=_parse_aim(self.goal))


def list_option_words(*groups: Any) -> list[str]:
    """Return the words of a command that repeat these groups of options, without defaults."""
    words: list[str] = []
    for group, one in [(given, one) for given in groups for one in fields(given)]:
        parameters: Any = getattr(one.type, "__metadata__", ())
        usual = f"--{one.name.replace('_', '-')}"
        name = next((part.name[0] for part in parameters if part.name), usual)
        value = getattr(group, one.name)
        if value is True:
            words.append(name)
        elif value is not None and value != one.default:
            # With "=", because a goal may begin with a minus sign.
            words += [f"{name}={text}" for text in (value if isinstance(value, list) else [value])]
    return words


def _parse_wheels(text: str) -> tuple[float, ...]:
    def parse(text: str) -> tuple[float, ...]:
        return parse_wheels(tuple(map(float, text.split(","))))

    expected = "RADIUS,TRACK above 0 in metres, as in 0.033,0.16"
    return parse_option("--wheels", text, parse, expected)


def _parse_length(text: str) -> float:
    expected = "a length above 0 in metres"
    return parse_option("--wheelbase", text, lambda text: parse_wheelbase(float(text)), expected)


def _split_column(text: str) -> tuple[str, str]:
    name, sign, column = text.partition("=")
    if not (sign and name.strip() and column.strip()):
        raise UsageError(f"--column {text[:60]}: must be NAME=COLUMN, as in x=pos_x")
    return name.strip(), column.strip()


def _parse_aim(text: str) -> tuple[float, ...]:
    try:
        values = [*map(float, text.split(","))]
    except ValueError:
        values = []
    if len(values) not in {2, 3} or not all(map(math.isfinite, values)):
        raise UsageError(f"--goal {text[:60]}: must be X,Y in metres, or X,Y,DEG with a heading")
    return (*values[:2], *map(math.radians, values[2:]))


def list_files(paths: Sequence[Path], *, without: Path | None = None) -> list[Path]:
    """Return the given files.

    Folders that are not bags are replaced by the recordings below them.
    """
    files: list[Path] = []
    for path in paths:
        # Files alone, the usual case, need no package that walks folders.
        if not path.is_dir() or tl.sweep.is_one_recording(path):
            files.append(path)
            continue
        try:
            files += [Path(one.path) for one in find_files([path], without)]
        except LogError:
            if len(paths) == 1:
                raise
            files.append(path)  # the reader of the folder reports that it is empty
    return files


def find_files(paths: Sequence[Path], without: Path | None) -> "list[tl.sweep.FoundRecording]":
    """Return the given recordings and those below folders, except a table to be written."""
    with show_progress("looking for recordings"):
        left_out = [] if without is None else [without]
        return tl.sweep.find_recordings(paths, without=left_out)


def read_runs(
    paths: Sequence[Path], topics: TopicOptions = TopicOptions(), *, allow_no_poses: bool = False
) -> "list[tl.Run]":
    """Return the runs of recordings, bags, other recorders' files and the paper's logs.

    With `allow_no_poses`, bags with commands alone are accepted.
    """
    return list(iterate_runs(paths, topics, allow_no_poses=allow_no_poses))


def iterate_runs(
    paths: Sequence[Path], topics: TopicOptions = TopicOptions(), *, allow_no_poses: bool = False
) -> "Iterator[tl.Run]":
    """Yield runs as `read_runs` returns them, one by one, without keeping them."""
    require_files(paths)
    for path in watch_files(paths, len(paths)):
        yield read_chosen_run(path, topics, allow_no_poses=allow_no_poses)


def read_chosen_run(path: Path, topics: TopicOptions, *, allow_no_poses: bool = False) -> "tl.Run":
    """Return the run in a file, and print the notes on its reading."""
    choice = replace(topics.build_choice(), allow_no_poses=allow_no_poses)
    run = tl.log.read_as_chosen(path, choice)
    print_run_notes(path, run.notes)
    return run


@contextmanager
def name_as_typed(file: Path, run: "tl.Run") -> "Iterator[None]":
    """Replace the name of a run in errors by the file as typed."""
    try:
        yield
    except TurtlelogError as err:
        head, text = f"{run.name}: ", str(err)
        if not text.startswith(head):
            raise
        raise type(err)(f"{file}: {text.removeprefix(head)}") from err


def split_names(text: str | None, option: str) -> list[str] | None:
    """Return the names in an option, separated by commas; None if the option is not given."""
    if text is None:
        return None
    names = [name.strip() for name in text.split(",")]
    if not all(names):
        raise UsageError(f"{option} {text[:60]}: must be names separated by commas")
    return names


def require_there(paths: Sequence[Path]) -> None:
    """Refuse words that are neither files nor presets, before drawing libraries are loaded."""
    for path in paths:
        file, _ = tl.log.split_topic(path)
        if not (isinstance(file, RemotePath) or file.exists() or str(path) in tl.PRESETS):
            raise UsageError(f"{path}: {describe_missing(path, tl.PRESETS)}")


def refuse_given(given: Mapping[str, object], advice: str) -> None:
    """Refuse the first of some options that is given, that is neither None nor False."""
    for name, value in given.items():
        if value is not None and value is not False:
            raise UsageError(f"{name}: {advice}")


def require_files(paths: Sequence[Path]) -> None:
    """Refuse a command without files."""
    if not paths:
        raise UsageError("no recording is given: add FILE...")


_LIBRARIES: Final = MappingProxyType({".html": "bokeh", ".parquet": "pyarrow", ".rrd": "rerun"})
"""Libraries that write files of a suffix, and that a slim installation does not have."""

PICTURES: Final = frozenset({".pdf", ".png", ".svg"})
"""Suffixes of figures."""


def require_new_target(target: Path | None, inputs: Sequence[Path], *, suffix: str) -> None:
    """Refuse a file that could not be written, is an input, or has another suffix.

    An existing file is accepted, and is replaced when the new file is complete. A library that
    writes such files must be installed.
    """
    if target is None:
        return
    with _name_target(target):
        if target.suffix.lower() != suffix:
            raise UsageError(f"the name must end in {suffix}")
        _require_writable(target, inputs)
    if suffix in _LIBRARIES:
        load_library(_LIBRARIES[suffix])


def require_pictures(
    plot: Path | None, rrd: Path | None, inputs: Sequence[Path], *, drawn: Sequence[Path], of: str
) -> None:
    """Refuse pictures of a robot that could not be written, or pictures of several files."""
    for name, target in (("--plot", plot), ("--rrd", rrd)):
        if target is not None and len(drawn) > 1:
            raise UsageError(f"{name}: draws one {of}, not {len(drawn)}")
    if plot is not None and plot.suffix.lower() not in PICTURES:
        raise UsageError(f"--plot {plot}: the name must end in .pdf, .png or .svg")
    require_new_target(plot, inputs, suffix="" if plot is None else plot.suffix.lower())
    require_new_target(rrd, inputs, suffix=".rrd")


def require_new_folder(target: Path) -> None:
    """Refuse a folder that could not be created, or that contains files."""
    with _name_target(target):
        if isinstance(target, RemotePath):
            raise UsageError("a URL names a file here, not a folder")
        _require_place(_resolve(target))
        if target.is_dir():
            if any(target.iterdir()):
                raise UsageError("this folder has files; name a new one")
        elif target.exists() or target.is_symlink():
            raise UsageError("this is a file; name a new folder")


def require_apart(targets: Sequence[Path]) -> None:
    """Refuse outputs that are equal, or that would be inside each other."""
    places = [_resolve(target) for target in targets]
    for number, place in enumerate(places):
        for other in places[:number]:
            if place == other or place in other.parents or other in place.parents:
                raise UsageError(
                    f"{targets[number]}: another output is written there; name another place"
                )


def _resolve(target: Path) -> Path:
    """Return the target of a path. Links that form a circle stay unchanged."""
    return target if isinstance(target, RemotePath) else Path(os.path.realpath(target))


def _require_writable(target: Path, inputs: Sequence[Path]) -> None:
    if isinstance(target, RemotePath):
        from turtlelog.files.requests import require_writable

        require_writable(target.url)
        if any(tl.log.split_topic(path)[0] == target for path in inputs):
            raise UsageError("this is the input; name another file to write")
        return
    _require_place(_resolve(target))
    if not target.exists():
        return
    if not target.is_file():
        kind = "folder" if target.is_dir() else "device"
        raise UsageError(f"this is a {kind}; name a file to write")
    if not os.access(target, os.W_OK):
        raise UsageError("this file is write-protected; name another file to write")
    for path in inputs:
        with suppress(OSError):  # the reading of a missing input gives the error
            if target.samefile(tl.log.split_topic(path)[0]):
                raise UsageError("this is the input; name another file to write")


def _require_place(target: Path) -> None:
    """Refuse a path that cannot be written, by creating and removing a file there."""
    folder = target.absolute().parent
    if not folder.is_dir():
        raise UsageError("there is no such folder to write to; create it first")
    probe = folder / f".turtlelog-{os.urandom(6).hex()}.part"
    # Permissions are not sufficient: the disk may be read-only, or the name too long.
    probe.touch(exist_ok=False)
    probe.unlink()
    with suppress(FileNotFoundError):
        target.lstat()


@contextmanager
def _name_target(target: Path) -> Iterator[None]:
    try:
        yield
    except (UsageError, RemoteError) as err:
        raise UsageError(f"{target}: {err}") from err
    except OSError as err:
        raise UsageError(f"{target}: cannot be written: {err.strerror or err}") from err
