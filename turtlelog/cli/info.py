"""`turtlelog info`: what a recording holds."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import turtlelog as tl
from turtlelog.cli.options import Files, Json, iterate_files, require_files
from turtlelog.cli.output import print_error, print_json, print_text
from turtlelog.errors import TurtlelogError

if TYPE_CHECKING:
    from turtlelog import RecordingInfo

EXIT_FINE: Final = 0
EXIT_BAD_INPUT: Final = 2


def info(files: Files, /, *, json: Json = False) -> int:
    """Say what recordings hold: source, length, topics, scenario, and what is absent.

    A file that cannot be read is told on stderr; the others are described, and the exit code is 2.

    Example: turtlelog info kp1.mcap

    Args:
        files: MCAP recordings, turtlelog's or other people's.
        json: Print one JSON list instead of text.
    """
    require_files(files)
    found, errors = _read(files)
    for err in errors:
        print_error(str(err))
    if json:
        print_json([_describe(path, recording) for path, recording in found])
    elif found:
        print_text("\n\n".join(_format(path, recording) for path, recording in found))
    return EXIT_BAD_INPUT if errors else EXIT_FINE


def _read(files: Sequence[Path]) -> "tuple[list[tuple[Path, RecordingInfo]], list[TurtlelogError]]":
    """Return what is found and what is wrong."""
    found: list[tuple[Path, RecordingInfo]] = []
    errors: list[TurtlelogError] = []
    for path in iterate_files(files):
        try:
            read = tl.read_bag_info if path.is_dir() else tl.read_info
            found.append((path, read(path)))
        except TurtlelogError as err:
            errors.append(err)
    return found, errors


def _describe(path: Path, recording: "RecordingInfo") -> dict[str, Any]:
    return {
        "file": str(path),
        "format_version": recording.format_version,
        "source": recording.source,
        "name": recording.name,
        "complete": recording.complete,
        "stop_reason": recording.stop_reason,
        "duration_s": recording.duration_s,
        "scenario": recording.scenario,
        "parameters": dict(recording.parameters),
        "topics": [
            {"topic": topic.topic, "type": topic.type, "count": topic.count}
            for topic in recording.topics
        ],
        "absent": list(recording.absent),
        "notes": dict(recording.notes),
    }


def _format(path: Path, recording: "RecordingInfo") -> str:
    facts = {
        "name": recording.name,
        "source": recording.source,
        "format": f"version {recording.format_version}" if recording.format_version else "not ours",
        "complete": "yes"
        if recording.complete
        else "no: turtlelog recover FILE -o OUT makes it so",
        "ended": (recording.stop_reason or "not recorded").replace("_", " "),
        "duration": "-" if recording.duration_s is None else f"{recording.duration_s:.3f} s",
        "absent": ", ".join(recording.absent) or ("nothing" if recording.format_version else "-"),
        **recording.notes,
    }
    width = max(map(len, facts))
    lines = [str(path), *(f"  {key:<{width}}  {value}" for key, value in facts.items())]
    topics = tl.Table(
        title="topics",
        columns=tuple(tl.Column(title=title) for title in ("topic", "type", "messages")),
        rows=tuple((topic.topic, topic.type, topic.count) for topic in recording.topics),
    )
    lines += ["", _indent(tl.format_table(topics))]
    if recording.parameters:
        known = "scenario" if recording.scenario else "known of the scenario"
        lines += ["", f"  {known}"]
        lines += [f"    {key} = {value}" for key, value in recording.parameters.items()]
    return "\n".join(lines)


def _indent(text: str) -> str:
    return "\n".join(f"  {line}".rstrip() for line in text.splitlines())
