"""`turtlelog info`: what a recording holds."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli.info_answer import InfoAnswer, build_answer, format_answer
from turtlelog.cli.info_summary import count_read, summarise
from turtlelog.cli.options import (
    Files,
    Jobs,
    Json,
    TopicOptions,
    count_jobs,
    require_files,
    watch_files,
)
from turtlelog.cli.output import (
    EXIT_BAD_INPUT,
    EXIT_FINE,
    print_error,
    print_json,
    print_text,
)
from turtlelog.errors import TurtlelogError
from turtlelog.processes import map_in_processes

if TYPE_CHECKING:
    from turtlelog.log import ReadChoice

_FILE_S: Final = 2e-3
"""To open a file and describe what it holds [s], besides the bytes that are read."""


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class InfoOptions:
    """What else is read and printed.

    Attributes:
        topics: List the topics.
        parameters: List what is known of the scenario, and the versions that simulated it.
        clock: Read the poses of large bags, too.
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

    The poses and commands of bags of up to 64 MiB are read: the answer names the clock that times
    them, jumps, gaps and rates that stand out. It lists what a file lacks, and how to add it. Files
    that cannot be read are reported on stderr. The others are described, and the exit code is 2.

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
        shown = partial(
            format_answer,
            topics=options.topics,
            parameters=options.parameters,
            is_alone=len(found) == 1,
        )
        print_text("\n\n".join(map(shown, found)))
    return EXIT_BAD_INPUT if errors else EXIT_FINE


def _read(path: Path, *, choice: "ReadChoice", is_asked: bool) -> "InfoAnswer | TurtlelogError":
    """Return what is in a file, or what is wrong with it."""
    try:
        recording = tl.log.read_file_info(path, choice)
        return build_answer(path, recording, summarise(path, recording, choice, is_asked=is_asked))
    except TurtlelogError as err:
        return err
