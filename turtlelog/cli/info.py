"""`turtlelog info`: contents of a recording."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from operator import itemgetter
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli import console
from turtlelog.cli.info_summary import (
    NOTHING_LEFT,
    ReadRun,
    Summary,
    holds_nothing,
    list_absent,
    name_bag,
    name_kind,
    summarise,
)
from turtlelog.cli.options import (
    Files,
    Json,
    TopicOptions,
    list_files,
    list_option_words,
    require_files,
)
from turtlelog.cli.work import Jobs, count_jobs, count_read, watch_files
from turtlelog.display import describe_count, join_words
from turtlelog.errors import TurtlelogError, release_frames
from turtlelog.escapes import escape_controls
from turtlelog.processes import map_in_processes

_FILE_S: Final = 2e-3
"""Time to open a file and describe its contents, in addition to the time for its bytes [s]."""

_MOST_ENTRIES: Final = 8
"""Largest number of printed entries of a list, because a sequence of commands has thousands. JSON
contains all entries."""

_ROWS: Final = {
    "pose": "/turtle1/pose",
    "controller sample": "/turtle1/control",
    "command": "/turtle1/cmd_vel",
}
"""Topics of a turtlelog recording by contents. Other recordings have the same types."""

_OF_COMMANDS: Final = ("metrics", "check", "plot", "replay")
"""Commands that need only the recorded commands."""

_AXES: Final = (("law.kp_angular", "turning"), ("law.kp_linear", "driving"))
"""Gains of the sequential laws, with the motions that they control."""

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


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotTopics:
    """One of several robots in a bag: its name, and its topics of poses and commands."""

    name: str
    poses: str | None
    commands: str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class InfoAnswer:
    """Contents of a file.

    Attributes:
        file: Name of the file as given.
        summary: Description of the file, in one sentence.
        ending: How the run ended at its goal, as text; None if unknown.
        verdict: Whether the run `reached` or `missed` its goal, or `ended` elsewhere within the
            tolerances (`allowed`) or without any; None if unknown.
        format_version: Format version of the recording; None if turtlelog did not write it.
        source: Origin of the data.
        name: Name of the run.
        complete: Whether the file was finished.
        stop_reason: Reason why the run ended; None if it is not recorded.
        duration_s: Time from first to last message of any topic [s].
        run_duration_s: The metric `run.duration` [s]; None if the poses were not read.
        scenario: Tables of the complete scenario; None if unknown.
        parameters: Known values of the scenario, by dotted key.
        topics: Topics with their types and numbers of messages.
        simulated_by: Versions, platform and digest of the law that simulated the run, by name;
            empty if unknown.
        absent: Columns that the file does not have.
        missing: Missing data, each with its use.
        clock: Clock that times the poses; None if there is only one clock, or the poses were not
            read.
        not_understood: Topics whose messages cannot become columns, each with the reason.
        notes: Remarks by name.
        run: Poses and commands of the file; None if they were not read.
        robots: Robots of a bag with several robots; --robot NAME chooses one.
    """

    file: str
    summary: str
    ending: str | None
    verdict: str | None
    format_version: int | None
    source: str
    name: str
    complete: bool
    stop_reason: str | None
    duration_s: float | None
    run_duration_s: float | None
    scenario: Mapping[str, Any] | None
    parameters: Mapping[str, Any]
    topics: "tuple[tl.log.TopicInfo, ...]"
    simulated_by: Mapping[str, str]
    absent: tuple[str, ...]
    missing: tuple[str, ...]
    clock: "tl.run.Clock | None"
    not_understood: tuple[str, ...]
    notes: Mapping[str, str]
    run: ReadRun | None
    robots: tuple[RobotTopics, ...] = ()
    # Not in JSON:
    described: Summary = field(repr=False)  # description from which the texts are made
    was_clock_set: bool = field(repr=False)  # whether the recorder's clock was set meanwhile


def info(
    files: Files,
    /,
    *,
    asked: InfoOptions = InfoOptions(),
    reading: TopicOptions = TopicOptions(),
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
    require_files(files)
    files = list_files(files)
    describe = partial(_read, choice=reading.build_choice(), is_asked=asked.clock)
    count = count_jobs(
        jobs, files, file_s=_FILE_S, count_read=partial(count_read, is_asked=asked.clock)
    )
    read = list(watch_files(map_in_processes(describe, files, count), len(files)))
    errors = [one for one in read if isinstance(one, TurtlelogError)]
    found = [one for one in read if not isinstance(one, TurtlelogError)]
    code = console.print_errors(errors)
    if json:
        console.print_json(found)
    elif len(found) > _MOST_IN_FULL and not (asked.topics or asked.parameters):
        console.print_text(_format_answers(found))
    elif found:
        is_alone = len(found) == 1
        words = list_option_words(reading)
        texts = (_format_answer(one, asked, words, is_alone=is_alone) for one in found)
        console.print_text("\n\n".join(texts))
    return code


def _read(
    path: Path, *, choice: "tl.log.ReadChoice", is_asked: bool
) -> "InfoAnswer | TurtlelogError":
    try:
        recording = tl.log.read_file_info(path, choice)
        summary = summarise(path, recording, choice, is_asked=is_asked)
        is_own = recording.format_version is not None
        robots = () if is_own else tl.log.ros2.find_robots(recording.topics)
    except TurtlelogError as err:
        return release_frames(err)
    return console.copy_fields(
        InfoAnswer,
        recording,
        file=str(path),
        summary=summary.text,
        ending=None if summary.end is None else summary.end.describe(),
        verdict=None if summary.end is None else summary.end.verdict,
        run_duration_s=None if summary.run is None else summary.run.duration_s,
        absent=list_absent(recording, summary),
        missing=(*(f"no {one}" for one in summary.missing), *summary.needs),
        clock=summary.clock,
        notes={**recording.notes, **summary.notes},
        run=summary.run,
        robots=tuple(
            RobotTopics(
                name=robot.name,
                poses=None if robot.poses is None else robot.poses.topic,
                commands=None if robot.commands is None else robot.commands.topic,
            )
            for robot in robots
        ),
        described=summary,
        was_clock_set=recording.was_clock_set or summary.was_clock_set,
    )


def _format_answer(
    answer: InfoAnswer, asked: InfoOptions, reading: Sequence[str], *, is_alone: bool
) -> str:
    """Return the kind of a file, its contents, missing data, and, for one file, next commands."""
    topics, parameters = asked.topics, asked.parameters
    name, notes = _name_file(answer), []
    for key, text in answer.notes.items():
        count = len(text.splitlines())  # a law's source has several
        told = text if count <= 1 else f"{count} lines: --json has them"
        notes.append((tl.log.label_note(key), told))
    rows = [*_list_rows(answer), *(note for note in notes if note[0] != "clock")]
    rows += [*_list_lacks(answer, topics=topics), *(note for note in notes if note[0] == "clock")]
    rows += _describe_durations(answer)
    width = max((len(key) for key, _ in rows), default=0)
    lines = [_fill(f"{name}: ", _write_head(answer))]
    if is_alone and answer.complete and answer.format_version is None and answer.run is not None:
        can = ["metrics", "check", "compare", "view", "plot"]
        can[1:1] = ["identify"] if answer.run.commands else []
        can[1:1] = ["explain"] if answer.run.samples else []
        lines.append(f"You can: {', '.join(can if answer.run.poses else _OF_COMMANDS)}")
    lines += [_fill(f"  {key:<{width}}  ", text) for key, text in rows]
    if topics and answer.topics:
        rows_of_topics = ((topic.topic, topic.type, topic.count) for topic in answer.topics)
        table = console.build_table("topics", ("topic", "type", "messages"), rows_of_topics)
        lines += ["", console.fit_table(table)]
    if topics and answer.not_understood:
        texts = (escape_controls(f"  {text}") for text in answer.not_understood)
        lines += ["", "not readable", *texts]
    if parameters and answer.parameters:
        lines += ["", "scenario" if answer.scenario else "known of the scenario"]
        pairs = answer.parameters.items()
        lines += [escape_controls(f"  {key} = {_shorten(value)}") for key, value in pairs]
    if parameters and answer.simulated_by:
        software = tl.run.describe_software(answer.simulated_by)
        lines += ["", console.fill_lines([f"simulated by {escape_controls(software)}"])]
    if is_alone:
        lines += [*_list_next(answer, reading, topics=topics, parameters=parameters)]
    return "\n".join(lines)


def _format_answers(answers: Sequence[InfoAnswer]) -> str:
    """Return one line per file, below a line that counts the files of each kind."""
    kinds = Counter(name_kind(answer) for answer in answers)
    counts = [
        f"{describe_count(count, kind.noun)}{kind.rest}" for kind, count in kinds.most_common()
    ]
    broken = sum(not answer.complete for answer in answers)
    judged = [one.verdict for one in answers if one.verdict in {"reached", "missed", "allowed"}]
    reached = f"{judged.count('reached')} of {len(judged)}" if len(judged) > 1 else ""
    state = f"; {broken} not complete" if broken else ""
    state += f"; {reached} reached their goal" if reached else ""
    rows = (
        (_name_file(one), "".join(name_kind(one)), one.duration_s, _tell_state(one))
        for one in answers
    )
    table = console.build_table("Files", ("file", "kind", "duration [s]", "ended"), rows)
    head = f"{len(answers)} files: {join_words(counts)}{state}."
    more = "Each in full: turtlelog info FILE, or all of them with --json."
    return "\n\n".join((console.fill_lines([head]), console.fit_table(table).strip("\n"), more))


def _name_file(answer: InfoAnswer) -> str:
    return escape_controls(tl.log.split_topic(Path(answer.file))[0].name or answer.file)


def _tell_state(answer: InfoAnswer) -> str:
    if not answer.complete:
        return "truncated: nothing left" if holds_nothing(answer) else "not complete"
    end = answer.described.end
    return _tell_reason(answer) if end is None else end.describe_distance()


def _tell_reason(answer: InfoAnswer) -> str:
    return (answer.stop_reason or "").replace("_", " ")


def _fill(head: str, text: str) -> str:
    return console.fill_lines([f"{head}{text}"], indent=len(head) if head.startswith(" ") else 0)


def _write_head(answer: InfoAnswer) -> str:
    length = "" if answer.duration_s is None else f", {answer.duration_s:.1f} s"
    if answer.run is not None and answer.was_clock_set:
        length = f", {answer.run.duration_s:.1f} s"  # without the steps of the clock
    if answer.format_version is not None:
        state = "complete" if answer.complete else "not complete"
        state = NOTHING_LEFT if holds_nothing(answer) else state
        return f"turtlelog recording, {state}{length}"
    if answer.run is None:
        return answer.summary
    what = answer.run.kind
    if not answer.topics:
        return f"{what}{length}"
    what += " (not turtlesim)" if answer.run.is_robot else ""
    return f"{name_bag(answer)} of {what}{length}"


def _list_rows(answer: InfoAnswer) -> Iterator[tuple[str, str]]:
    run = answer.run
    if answer.format_version is not None:
        yield from _list_own(answer)
    if run is not None:
        rows = {"poses": run.poses, "commands": run.commands, "samples": str(run.samples or "")}
        yield from filter(itemgetter(1), rows.items())
    sizes = {topic.topic: topic.count for topic in answer.topics}
    for robot in answer.robots[:_MOST_ENTRIES]:
        parts = [
            f"{what} {topic}, {describe_count(sizes[topic], 'message')}"
            for what, topic in {"poses": robot.poses, "commands": robot.commands}.items()
            if topic is not None
        ]
        yield f"robot {robot.name}", "; ".join(parts)
    end = answer.described.end
    how = "" if end is None else f"{end.describe_distance()} {end.describe_duration()}"
    told = ": ".join(filter(None, [_tell_reason(answer), how]))
    if told and not holds_nothing(answer):
        yield "ended", told


def _describe_durations(answer: InfoAnswer) -> Iterator[tuple[str, str]]:
    """Yield the duration of a file and, if its poses were read, the duration of its run."""
    if answer.duration_s is None:
        return
    what = "message of any topic" if answer.topics else "row"
    how = ", by the clock that was set" if answer.was_clock_set else ""
    yield "duration", f"{answer.duration_s:.3f} s, from the first to the last {what}{how}"
    if answer.run is None:
        return
    first = answer.run.first_row
    last = {"sample": "row", "pose": "pose or command", "command": "one"}[first]
    length = f"{answer.run.duration_s:.3f} s, from the first {first} to the last {last}"
    yield "run.duration", length


_WORDS: Final = MappingProxyType({"goal_xy_m": "goal", "goal_heading_rad": "heading at the goal"})
"""Words for absent fields; JSON contains the names of the fields."""


def _list_lacks(answer: InfoAnswer, *, topics: bool) -> Iterator[tuple[str, str]]:
    """Yield the missing data of a file with their use, and unreadable data."""
    for text in (*answer.described.missing, *answer.described.needs):
        yield "missing", text
    if answer.absent and (topics or not answer.missing):
        yield "absent", ", ".join(_WORDS.get(name, name) for name in answer.absent)
    if answer.not_understood:
        yield "not readable", describe_count(len(answer.not_understood), "topic")


def _list_own(answer: InfoAnswer) -> Iterator[tuple[str, str]]:
    known = answer.parameters
    if answer.name != Path(answer.file).stem:
        yield "run", answer.name
    if answer.scenario is not None:
        is_simulated = tl.run.find_source_kind(answer.source) is tl.run.SourceKind.SIMULATION
        source = "simulated" if is_simulated else f"from {answer.source}"
        yield "robot", f"{known.get('plant.kind', 'turtlesim')}, {source}"
    elif answer.source:
        yield "source", answer.source
    if "law.kind" in known:
        over = known.get("law.schedule.over")
        schedule = (
            "" if over is None else f", with gains scheduled over the {over.replace('_', ' ')}"
        )
        yield "controller", f"{known['law.kind']}{_write_gains(known)}{schedule}"
    has_goal = "goal.x_m" in known and "goal_xy_m" not in answer.absent
    if has_goal and "path.kind" not in known:
        yield "goal", f"({known['goal.x_m']:g}, {known['goal.y_m']:g}) m"
    counts = {
        noun: sum(found.count for found in answer.topics if found.topic == topic)
        for noun, topic in _ROWS.items()
    }
    if any(counts.values()):
        yield "data", ", ".join(describe_count(count, noun) for noun, count in counts.items())


def _write_gains(known: Mapping[str, Any]) -> str:
    gains = [(known[key], axis) for key, axis in _AXES if key in known]
    if len(gains) == len(_AXES) and gains[0][0] == gains[1][0]:
        return f", Kp = {gains[0][0]:g} 1/s (turning and driving)"
    return "".join(f", Kp = {gain:g} 1/s {axis}" for gain, axis in gains)


def _list_next(
    answer: InfoAnswer, reading: Sequence[str], *, topics: bool, parameters: bool
) -> Iterator[str]:
    """Yield the commands that can use a file, and the options that show more of it."""
    if not answer.complete:
        has_rows = any(topic.count for topic in answer.topics)
        recover = f"turtlelog convert --recover {console.quote_file(answer.file)} -o OUT"
        yield f"Fix: {recover if has_rows else 'copy the file again from its source'}"
    elif answer.format_version is not None:
        yield f"Next: turtlelog metrics {console.quote_file(answer.file, *reading)}"
        law = answer.parameters.get("law.kind")
        if "samples" not in answer.absent:  # only a controller's run is explained
            yield f"      {console.name_explain(answer.file, law, reading)}"
    more = [] if topics or not answer.topics else ["Topics: --topics"]
    more += [] if parameters or not answer.parameters else ["Scenario: --parameters"]
    if more:
        yield "    ".join(more)


def _shorten(value: object) -> object:
    """Return a value for display; of a long list, its first entries and its length."""
    if not isinstance(value, list | tuple) or len(value) <= _MOST_ENTRIES:
        return value
    first = ", ".join(map(str, value[:_MOST_ENTRIES]))
    return f"[{first}, ...]: {len(value):,} values"
