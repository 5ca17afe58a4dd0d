"""Options for reading and working that several commands share."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, TypeVar

from cyclopts import Group, Parameter, Token

import turtlelog as tl
from turtlelog.cli.output import print_run_notes
from turtlelog.cli.progress import show_progress
from turtlelog.errors import LogError, TurtlelogError, UsageError
from turtlelog.files.text_files import describe_missing
from turtlelog.files.urls import RemotePath, make_path, parse_size, set_max_download
from turtlelog.log.read_choice import parse_wheelbase, parse_wheels
from turtlelog.processes import FILE_S, choose_jobs

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from turtlelog import Run
    from turtlelog.compare import RunSummary
    from turtlelog.log import ReadChoice
    from turtlelog.sweep import FoundRecording

_Found = TypeVar("_Found")


def _read_whole(_: Any, tokens: Sequence[Token]) -> int:
    text = tokens[0].value
    try:
        return int(text)
    except ValueError as err:
        option = tokens[0].keyword
        unit = " of ticks" if option == "--dead-time" else ""
        raise UsageError(f"{option} {text[:60]}: must be a whole number{unit}") from err


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
Whole = Annotated[int, Parameter(converter=_read_whole)]
"""A whole number, because a plain int would truncate 1.5 to 1."""


def _read_budget(_: Any, tokens: Sequence[Token]) -> float:
    text = tokens[0].value
    with suppress(ValueError):
        if 0.0 < float(text) < math.inf:
            return float(text)
    expected = "a time above 0 in milliseconds"
    raise UsageError(f"--step-budget-ms {text[:60]}: must be {expected}")


StepBudgetMs = Annotated[
    float | None, Parameter(name="--step-budget-ms", metavar="MS", converter=_read_budget)
]


def choose_step_budget(given_ms: float | None) -> float:
    """Return the time limit of a law for one answer, as given or the default [s]."""
    from turtlelog.simulate.step_budget import STEP_BUDGET_S

    return STEP_BUDGET_S if given_ms is None else given_ms / 1e3


Jobs = Annotated[Whole | None, Parameter(name="--jobs", metavar="COUNT")]


def _read_size(_: Any, tokens: Sequence[Token]) -> int:
    """Return a size, and use this limit for every URL of the command."""
    most = parse_size(tokens[0].value)
    if most is None:
        place = f"{tokens[0].keyword} {tokens[0].value[:60]}"
        raise UsageError(f"{place}: must be a size, as in 500MB or 4GiB")
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
        robot: Name of one of several robots in a bag (/robot1/odom, /robot2/odom: robot1, robot2).
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
        partial: Read what an unfinished or damaged recording still contains.
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

    def build_choice(self) -> "ReadChoice":
        """Return the options as a choice.

        Raises:
            UsageError: If a value is invalid.
        """
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

    def build_choice(self) -> "ReadChoice":
        """Return the options as a choice.

        Raises:
            UsageError: If a value is invalid.
        """
        choice = super(ReadingOptions, self).build_choice()
        return choice if self.goal is None else replace(choice, goal=_parse_aim(self.goal))


def list_reading_words(options: ReadingOptions) -> list[str]:
    """Return the words of a command that repeat these options, without defaults."""
    words: list[str] = []
    for one in fields(options):
        value, name = getattr(options, one.name), f"--{one.name.replace('_', '-')}"
        if value is True:
            words.append(name)
        elif value and value != one.default:
            # With "=", because a goal may begin with a minus sign.
            words += [f"{name}={text}" for text in (value if isinstance(value, list) else [value])]
    return words


def _parse_wheels(text: str) -> tuple[float, ...]:
    try:
        values = tuple(float(part) for part in text.split(","))
        return parse_wheels(values)
    except (ValueError, LogError) as err:
        expected = "RADIUS,TRACK above 0 in metres, as in 0.033,0.16"
        raise UsageError(f"--wheels {text[:60]}: must be {expected}") from err


def _parse_length(text: str) -> float:
    try:
        return parse_wheelbase(float(text))
    except (ValueError, LogError) as err:
        raise UsageError(f"--wheelbase {text[:60]}: must be a length above 0 in metres") from err


def _split_column(text: str) -> tuple[str, str]:
    name, sign, column = text.partition("=")
    if not (sign and name.strip() and column.strip()):
        raise UsageError(f"--column {text[:60]}: must be NAME=COLUMN, as in x=pos_x")
    return name.strip(), column.strip()


def _parse_aim(text: str) -> tuple[float, ...]:
    try:
        values = [float(part) for part in text.split(",")]
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


def find_files(paths: Sequence[Path], without: Path | None) -> "list[FoundRecording]":
    """Return the given recordings and those below folders, except a table to be written."""
    with show_progress("looking for recordings"):
        left_out = [] if without is None else [without]
        return tl.sweep.find_recordings(paths, without=left_out)


def read_runs(
    paths: Sequence[Path], topics: TopicOptions | None = None, *, allow_no_poses: bool = False
) -> "list[Run]":
    """Return the runs of recordings, bags, other recorders' files and the paper's logs.

    With `allow_no_poses`, bags with commands alone are accepted.
    """
    return list(iterate_runs(paths, topics, allow_no_poses=allow_no_poses))


def iterate_runs(
    paths: Sequence[Path], topics: TopicOptions | None = None, *, allow_no_poses: bool = False
) -> "Iterator[Run]":
    """Yield runs as `read_runs` returns them, one by one, without keeping them."""
    require_files(paths)
    topics = topics or TopicOptions()
    for path in watch_files(paths, len(paths)):
        yield read_chosen_run(path, topics, allow_no_poses=allow_no_poses)


def read_chosen_run(path: Path, topics: TopicOptions, *, allow_no_poses: bool = False) -> "Run":
    """Return the run in a file, and print the notes on its reading."""
    choice = replace(topics.build_choice(), allow_no_poses=allow_no_poses)
    run = tl.log.read_as_chosen(path, choice)
    print_run_notes(path, run.notes)
    return run


@contextmanager
def name_as_typed(file: Path, run: "Run") -> "Iterator[None]":
    """Replace the name of a run in errors by the file as typed."""
    try:
        yield
    except TurtlelogError as err:
        head, text = f"{run.name}: ", str(err)
        if not text.startswith(head):
            raise
        raise type(err)(f"{file}: {text.removeprefix(head)}") from err


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class WorkOptions:
    """Options for the processes that do the work.

    Attributes:
        jobs: Number of processes. Default: one per core if that is faster.
        scheduler: Use the Dask cluster of this scheduler. The workers must find the files at the
            same paths. Example: tcp://host:8786.
    """

    jobs: Jobs = None
    scheduler: Annotated[str | None, Parameter(metavar="URL")] = None

    @contextmanager
    def find_place(
        self, files: Sequence[Path], *, file_s: float = FILE_S
    ) -> "Iterator[int | Executor]":
        """Yield a number of processes, or the cluster.

        Raises:
            UsageError: If both options are given, or the number is invalid.
            ProcessError: If the cluster cannot be used.
        """
        if self.scheduler is None:
            yield count_jobs(self.jobs, files, file_s=file_s)
            return
        if self.jobs is not None:
            raise UsageError("--jobs: the cluster of --scheduler has its own; leave --jobs out")
        from turtlelog.sweep.cluster import connect_cluster

        with connect_cluster(self.scheduler) as executor:
            yield executor

    @contextmanager
    def find_any_place(self) -> "Iterator[int | Executor | None]":
        """Yield a number of processes, the cluster, or None without both options.

        For None, the work chooses the number of processes.
        """
        if self.scheduler is None and self.jobs is None:
            yield None
            return
        with self.find_place(()) as place:
            yield place

    def name_files(self, files: Sequence[Path]) -> list[Path]:
        """Return files with paths for workers, which run in other folders."""
        return [*files] if self.scheduler is None else [path.absolute() for path in files]


def watch_summaries(
    found: "Iterator[RunSummary | TurtlelogError]", count: int, errors: list[TurtlelogError]
) -> "Iterator[RunSummary]":
    """Yield run summaries, collect the errors, and show the number of finished files."""
    for summary in watch_files(found, count):
        if isinstance(summary, TurtlelogError):
            errors.append(summary)
        else:
            print_run_notes(summary.file, summary.notes)
            yield summary


def count_jobs(
    asked: int | None,
    files: Sequence[Path],
    *,
    file_s: float = FILE_S,
    count_read: "Callable[[Path], int] | None" = None,
) -> int:
    """Return the number of processes for files: the given number, or else from `choose_jobs`."""
    jobs = require_jobs(asked)
    return choose_jobs(files, file_s=file_s, count_read=count_read) if jobs is None else jobs


def require_jobs(asked: int | None) -> int | None:
    """Return the given number of processes, or refuse a number below 1."""
    if asked is not None and asked < 1:
        raise UsageError(f"--jobs {asked}: must be at least 1")
    return asked


def watch_files(found: "Iterable[_Found]", count: int) -> "Iterator[_Found]":
    """Yield the result of each file, and show the number of finished ones."""
    # A single file has no share to show.
    with show_progress("reading", count if count > 1 else None, "files") as progress:
        for number, one in enumerate(found, start=1):
            yield one
            progress.done = number


def split_names(text: str, option: str) -> list[str]:
    """Return the names in an option, separated by commas."""
    names = [name.strip() for name in text.split(",")]
    if not all(names):
        raise UsageError(f"{option} {text[:60]}: must be names separated by commas")
    return names


class MetricsAsked:
    """Base of options with `--metric`, which each command describes itself."""

    __slots__ = ()
    metric: str | None

    def list_patterns(self) -> list[str] | None:
        """Return the requested ids and patterns; None without a request."""
        return None if self.metric is None else split_names(self.metric, "--metric")


def require_there(paths: Sequence[Path]) -> None:
    """Refuse missing files before drawing libraries are loaded.

    Raises:
        UsageError: If a word is neither a file nor a preset.
    """
    for path in paths:
        file, _ = tl.log.split_topic(path)
        is_known = isinstance(file, RemotePath) or file.exists() or str(path) in tl.PRESETS
        if not is_known:
            raise UsageError(f"{path}: {describe_missing(path, tl.PRESETS)}")


def require_files(paths: Sequence[Path]) -> None:
    """Refuse a command without files."""
    if not paths:
        raise UsageError("no recording is given: add FILE...")
