"""`turtlelog info`: what a recording holds."""

import shutil
import sys
import textwrap
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import turtlelog as tl
from turtlelog.cli.info_summary import Summary, count_read, summarise
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
    format_table,
    print_error,
    print_json,
    print_text,
)
from turtlelog.errors import TurtlelogError
from turtlelog.escapes import escape_controls
from turtlelog.processes import map_in_processes

if TYPE_CHECKING:
    from turtlelog.compare import Table
    from turtlelog.log import ReadChoice, RecordingInfo

_FILE_S: Final = 2e-3
"""To open a file and describe what it holds [s], besides the bytes that are read."""

_NARROWEST: Final = 20
"""Columns that a text has at least, however narrow the terminal."""

_MOST_ENTRIES: Final = 8
"""Of a list that is printed: a sequence of commands has thousands. As JSON they are all there."""


def info(
    files: Files,
    /,
    *,
    topics: TopicOptions | None = None,
    clock: bool = False,
    jobs: Jobs = None,
    json: Json = False,
) -> int:
    """Say what recordings are and hold: a robot or turtlesim, source, length, topics, scenario.

    Of a bag of up to 64 MiB the poses and commands are read: info says which clock times them,
    where poses jump or are missing, and which rates stand out. It lists what a file lacks, and how
    to add that. Files that cannot be read are reported on stderr; the others are described, and the
    exit code is 2.

    Example: turtlelog info kp1.mcap

    Example: turtlelog info my_bag

    Args:
        files: Recordings (.mcap), ROS 2 bags (folders, .mcap, .db3), tables (.csv, .parquet, .tum),
            or the paper's logs (.json, .csv).
        topics: What is looked at, where a bag does not tell or something else is meant.
        clock: Read the poses of large bags, too.
        jobs: Processes to read in; as many as cores where that is quicker.
        json: Print one JSON list instead of text.
    """
    require_files(files)
    describe = partial(_read, choice=(topics or TopicOptions()).build_choice(), is_asked=clock)
    count = count_jobs(jobs, files, file_s=_FILE_S, count_read=partial(count_read, is_asked=clock))
    read = list(watch_files(map_in_processes(describe, files, count), len(files)))
    errors = [one for one in read if isinstance(one, TurtlelogError)]
    found = [one for one in read if not isinstance(one, TurtlelogError)]
    for err in errors:
        print_error(str(err))
    if json:
        print_json([_describe(*of_file) for of_file in found])
    elif found:
        print_text("\n\n".join(_format(*of_file) for of_file in found))
    return EXIT_BAD_INPUT if errors else EXIT_FINE


def _read(
    path: Path, *, choice: "ReadChoice", is_asked: bool
) -> "tuple[Path, RecordingInfo, Summary] | TurtlelogError":
    """Return what is found, or what is wrong."""
    try:
        recording = tl.log.read_file_info(path, choice)
        return path, recording, summarise(path, recording, choice, is_asked=is_asked)
    except TurtlelogError as err:
        return err


def _describe(path: Path, recording: "RecordingInfo", summary: Summary) -> dict[str, Any]:
    return {
        "file": str(path),
        "summary": summary.text,
        "format_version": recording.format_version,
        "source": recording.source,
        "name": recording.name,
        "complete": recording.complete,
        "stop_reason": recording.stop_reason,
        "duration_s": recording.duration_s,
        "run_duration_s": None if summary.run is None else summary.run.duration_s,
        "scenario": recording.scenario,
        "parameters": dict(recording.parameters),
        "topics": [
            {"topic": topic.topic, "type": topic.type, "count": topic.count}
            for topic in recording.topics
        ],
        "absent": list(_list_absent(recording, summary)),
        "missing": list(summary.missing),
        "clock": summary.clock,
        "not_understood": list(recording.not_understood),
        "notes": {**recording.notes, **summary.notes},
    }


def _format(path: Path, recording: "RecordingInfo", summary: Summary) -> str:
    facts = {
        "name": recording.name,
        "source": recording.source,
        "format": f"version {recording.format_version}" if recording.format_version else "not ours",
        "complete": _describe_completeness(recording),
        "ended": (recording.stop_reason or "not recorded").replace("_", " "),
        **_describe_durations(recording, summary),
        "absent": ", ".join(_list_absent(recording, summary)) or "nothing",
        **{name.replace("_", " "): text for name, text in summary.notes.items()},
        **recording.notes,
    }
    width = max(map(len, facts))
    lines = [
        escape_controls(str(path)),
        *(line for text in (summary.text, *summary.missing) for line in _wrap("  ", text)),
        "",
        *(line for key, value in facts.items() for line in _wrap(f"  {key:<{width}}  ", value)),
    ]
    if recording.topics:
        lines += ["", _indent(format_table(_tabulate(recording), indent=2))]
    if recording.not_understood:
        texts = (escape_controls(f"    {text}") for text in recording.not_understood)
        lines += ["", "  not understood", *texts]
    if recording.parameters:
        known = "scenario" if recording.scenario else "known of the scenario"
        lines += ["", f"  {known}"]
        pairs = recording.parameters.items()
        lines += [escape_controls(f"    {key} = {_shorten(value)}") for key, value in pairs]
    return "\n".join(lines)


def _wrap(head: str, text: str) -> list[str]:
    """Return a text in lines that fit the terminal; in one where a file or program reads."""
    line = escape_controls(f"{head}{text}")
    if not sys.stdout.isatty():
        return [line]
    room = max(shutil.get_terminal_size().columns, len(head) + _NARROWEST)
    indent = " " * len(head)
    return textwrap.wrap(
        line, room, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )


def _shorten(value: object) -> object:
    """Return a value as it is shown: of a long list its first entries and how many there are."""
    if not isinstance(value, list | tuple) or len(value) <= _MOST_ENTRIES:
        return value
    first = ", ".join(map(str, value[:_MOST_ENTRIES]))
    return f"[{first}, ...]: {len(value):,} values"


def _describe_completeness(recording: "RecordingInfo") -> str:
    if recording.complete:
        return "yes"
    if any(topic.count for topic in recording.topics):
        return "no: turtlelog recover FILE -o OUT makes it so"
    return "no: copy the file again from its source"


def _describe_durations(recording: "RecordingInfo", summary: Summary) -> dict[str, str]:
    """Return how long a file lasts and, where its poses were read, how long its run does."""
    if recording.duration_s is None:
        return {"duration": "-"}
    what = "message of any topic" if recording.topics else "row"
    told = {"duration": f"{recording.duration_s:.3f} s, from the first to the last {what}"}
    if summary.run is None:
        return told
    first = "sample" if summary.run.has_samples else "pose"
    last = "row" if summary.run.has_samples else "pose or command"
    length = f"{summary.run.duration_s:.3f} s, from the first {first} to the last {last}"
    return told | {"run.duration": length}


def _list_absent(recording: "RecordingInfo", summary: Summary) -> tuple[str, ...]:
    """Return what is absent: which topics are commands is known where the run was read."""
    has_commands = summary.run is None or summary.run.has_commands
    more = [] if has_commands else ["commands"]
    if summary.run is None and recording.format_version is None:
        more += _list_missing_types(recording)
    return tuple(dict.fromkeys([*more, *recording.absent]))


def _list_missing_types(recording: "RecordingInfo") -> list[str]:
    """Return whether no message has a type of poses, and whether it has none of commands."""
    held = {topic.type for topic in recording.topics if topic.count}
    kinds = {"poses": tl.log.ros2.POSE_TYPES, "commands": tl.log.ros2.COMMAND_TYPES}
    return [name for name, types in kinds.items() if not held.intersection(types)]


def _tabulate(recording: "RecordingInfo") -> "Table":
    return tl.compare.Table(
        title="topics",
        columns=tuple(tl.compare.Column(title=title) for title in ("topic", "type", "messages")),
        rows=tuple((topic.topic, topic.type, topic.count) for topic in recording.topics),
    )


def _indent(text: str) -> str:
    return "\n".join(f"  {line}".rstrip() for line in text.splitlines())
