"""`turtlelog info`: contents of a recording."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli.info_answer import InfoAnswer, RobotTopics, format_answers, format_info_answer
from turtlelog.cli.info_summary import Summary, count_read, summarise
from turtlelog.cli.options import (
    Files,
    Jobs,
    Json,
    TopicOptions,
    count_jobs,
    list_files,
    require_files,
    watch_files,
)
from turtlelog.cli.output import (
    EXIT_BAD_INPUT,
    EXIT_FINE,
    copy_fields,
    print_error,
    print_json,
    print_text,
)
from turtlelog.errors import TurtlelogError
from turtlelog.processes import map_in_processes

if TYPE_CHECKING:
    from turtlelog.log import ReadChoice, RecordingInfo


_FILE_S: Final = 2e-3
"""Time to open a file and describe its contents, in addition to the time for its bytes [s]."""


_MOST_IN_FULL: Final = 4
"""Largest number of files that are described one below another; about nine lines each fill a
screen."""


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class InfoOptions:
    """Additional data to read and print.

    Attributes:
        topics: List the topics.
        parameters: List the known values of the scenario, and the versions that simulated it.
        clock: Read also the poses of large bags.
    """

    topics: bool = False
    parameters: bool = False
    clock: bool = False


def info(
    files: Files,
    /,
    *,
    options: InfoOptions | None = None,
    reading: TopicOptions | None = None,
    jobs: Jobs = None,
    json: Json = False,
) -> int:
    """Describe files: a recording, a robot's bag or a table, its data, and what is missing.

    The poses and commands of bags of up to 64 MiB are read: the answer shows the clock of their
    times, jumps, gaps and unusual rates. The answer lists what a file lacks and how to add it.
    Files that cannot be read are reported on stderr. The others are described, and the exit code is
    2.

    Example: turtlelog info kp1.mcap

    Example: turtlelog info my_bag

    Args:
        files: Recordings (.mcap), ROS 2 bags (folders, .mcap, .db3), tables (.csv, .parquet, .tum),
            or the paper's logs (.json, .csv).
        jobs: Number of processes. Default: one per core if that is faster.
        json: Print one JSON list instead of text.
    """
    options = options or InfoOptions()
    require_files(files)
    files = list_files(files)
    describe = partial(
        _read,
        choice=(reading or TopicOptions()).build_choice(),
        is_asked=options.clock,
    )
    count = count_jobs(
        jobs, files, file_s=_FILE_S, count_read=partial(count_read, is_asked=options.clock)
    )
    read = list(watch_files(map_in_processes(describe, files, count), len(files)))
    errors = [one for one in read if isinstance(one, TurtlelogError)]
    found = [one for one in read if not isinstance(one, TurtlelogError)]
    for err in errors:
        print_error(str(err))
    if json:
        print_json(found)
    elif found:
        print_text(_format(found, options))
    return EXIT_BAD_INPUT if errors else EXIT_FINE


def _format(found: "list[InfoAnswer]", options: InfoOptions) -> str:
    if len(found) > _MOST_IN_FULL and not (options.topics or options.parameters):
        return format_answers(found)
    shown = partial(
        format_info_answer,
        topics=options.topics,
        parameters=options.parameters,
        is_alone=len(found) == 1,
    )
    return "\n\n".join(map(shown, found))


def _read(path: Path, *, choice: "ReadChoice", is_asked: bool) -> "InfoAnswer | TurtlelogError":
    """Return the contents of a file, or its error."""
    try:
        recording = tl.log.read_file_info(path, choice)
        return _build_answer(path, recording, summarise(path, recording, choice, is_asked=is_asked))
    except TurtlelogError as err:
        return err


def _build_answer(path: Path, recording: "RecordingInfo", summary: Summary) -> InfoAnswer:
    """Return the answer as data."""
    return copy_fields(
        InfoAnswer,
        recording,
        file=str(path),
        summary=summary.text,
        ending=summary.ending,
        run_duration_s=None if summary.run is None else summary.run.duration_s,
        absent=_list_absent(recording, summary),
        missing=summary.missing,
        clock=summary.clock,
        notes={**recording.notes, **summary.notes},
        run=summary.run,
        robots=() if recording.format_version is not None else _list_robots(recording),
    )


def _list_robots(recording: "RecordingInfo") -> tuple[RobotTopics, ...]:
    return tuple(
        RobotTopics(
            name=robot.name,
            poses=None if robot.poses is None else robot.poses.topic,
            commands=None if robot.commands is None else robot.commands.topic,
        )
        for robot in tl.log.ros2.find_robots(recording.topics)
    )


def _list_absent(recording: "RecordingInfo", summary: Summary) -> tuple[str, ...]:
    """Return the absent fields. Topics of commands are known only if the run was read."""
    run = summary.run
    more = [] if run is None or run.has_poses else ["poses"]
    more += [] if run is None or run.has_commands else ["commands"]
    if summary.run is None and recording.format_version is None:
        more += _list_missing_types(recording)
    return tuple(dict.fromkeys([*more, *recording.absent]))


def _list_missing_types(recording: "RecordingInfo") -> list[str]:
    """Return whether no message has a type of poses, and whether none has one of commands."""
    held = {topic.type for topic in recording.topics if topic.count}
    kinds = {"poses": tl.log.ros2.POSE_TYPES, "commands": tl.log.ros2.COMMAND_TYPES}
    return [name for name, types in kinds.items() if not held.intersection(types)]
