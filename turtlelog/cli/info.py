"""`turtlelog info`: what a recording holds."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import turtlelog as tl
from turtlelog.cli.options import Files, Json, Partial, require_files
from turtlelog.cli.output import print_json, print_text

if TYPE_CHECKING:
    from turtlelog import RecordingInfo


def info(files: Files, /, *, partial: Partial = False, json: Json = False) -> None:
    """Say what recordings hold: source, length, topics, scenario, and what is absent.

    Example: turtlelog info kp1.mcap

    Args:
        files: MCAP recordings, turtlelog's or other people's.
        partial: Say what a damaged recording still holds.
        json: Print one JSON list instead of text.
    """
    require_files(files)
    found = [
        (
            path,
            tl.read_bag_info(path) if path.is_dir() else tl.read_info(path, allow_partial=partial),
        )
        for path in files
    ]
    if json:
        print_json([_describe(path, recording) for path, recording in found])
    else:
        print_text("\n\n".join(_format(path, recording) for path, recording in found))


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
        "not_understood": list(recording.not_understood),
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
    if recording.not_understood:
        lines += ["", "  not understood", *(f"    {text}" for text in recording.not_understood)]
    if recording.parameters:
        known = "scenario" if recording.scenario else "known of the scenario"
        lines += ["", f"  {known}"]
        lines += [f"    {key} = {value}" for key, value in recording.parameters.items()]
    return "\n".join(lines)


def _indent(text: str) -> str:
    return "\n".join(f"  {line}".rstrip() for line in text.splitlines())
