"""`turtlelog replay`: a recording driven again."""

from dataclasses import asdict
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

import turtlelog as tl
from turtlelog.cli.options import Json, TopicOptions, read_runs
from turtlelog.cli.output import format_table, print_json, print_text
from turtlelog.errors import UsageError

if TYPE_CHECKING:
    from turtlelog import PlantReplay, Run
    from turtlelog.replay import Jump, PoseError


def replay(
    file: Annotated[Path, Parameter(name="FILE")],
    /,
    *,
    plant: Annotated[bool, Parameter(negative="")] = False,
    topics: TopicOptions | None = None,
    json: Json = False,
) -> None:
    """Drive a recording again and say how far the result is from what was recorded.

    With --plant the recorded commands go through turtlelog's turtlesim, each in the tick in which
    the poses show it. A jump of the pose (teleport, reset) or a gap in the recording begins a new
    stretch, from the recorded pose. Times count from the first sample, or else the first pose.

    Example: turtlelog replay turtlesim-bag --plant

    Args:
        file: A recording (.mcap) or a ROS 2 bag of turtlesim.
        plant: Replay the commands through the plant.
        json: Print one JSON object instead of tables.
    """
    if not plant:
        raise UsageError(
            "replay: expected what to drive the recording through, --plant, found none"
        )
    (run,) = read_runs([file], topics)
    found = tl.replay_plant(run)
    if json:
        print_json(_describe(file, run, found))
    else:
        print_text(_format(run, found))


def _describe(file: Path, run: "Run", found: "PlantReplay") -> dict[str, Any]:
    def tell_time(time_ns: int) -> float:
        return (time_ns - run.start_ns) / 1e9

    first = found.first_difference
    return {
        "file": str(file),
        "name": found.name,
        "mode": "plant",
        "samples": found.samples,
        "max_abs_error": _describe_error(found.max_abs_error),
        "first_difference": None
        if first is None
        else {
            "signal": first.signal,
            "time_s": tell_time(first.time_ns),
            "recorded": first.recorded,
            "replayed": first.replayed,
        },
        "stretches": [
            {
                "start_s": tell_time(stretch.start_ns),
                "end_s": tell_time(stretch.end_ns),
                "ticks": stretch.ticks,
                "max_abs_error": _describe_error(stretch.max_abs_error),
                "rounding": {"position": stretch.rounding_m, "heading": stretch.rounding_rad},
            }
            for stretch in found.stretches
        ],
        "jumps": [
            {
                "at_s": tell_time(jump.at_ns),
                "kind": jump.kind,
                "from": dict(zip(("x", "y", "heading"), jump.from_pose, strict=True)),
                "to": dict(zip(("x", "y", "heading"), jump.to_pose, strict=True)),
            }
            for jump in found.jumps
        ],
        "gaps": [
            {
                "start_s": tell_time(gap.start_ns),
                "end_s": tell_time(gap.end_ns),
                "missing_ticks": gap.missing_ticks,
            }
            for gap in found.gaps
        ],
        "commands": asdict(found.commands),
    }


def _describe_error(error: "PoseError") -> dict[str, float]:
    return {"x": error.x_m, "y": error.y_m, "heading": error.heading_rad}


def _format(run: "Run", found: "PlantReplay") -> str:
    use = found.commands
    notes = [
        f"Commands: {use.taken} taken, {use.unseen} that no pose shows;"
        f" the plant stopped by itself {use.stops} times.",
        "Rounding: what 32 bits of a stretch's first pose may grow to, along the way driven.",
    ]
    if use.unexplained_ticks:
        notes.append(
            f"No recorded command explains {use.unexplained_ticks} ticks: the recorded velocity"
            " was used there."
        )
    heads = (
        *(("from", "s"), ("to", "s"), ("ticks", ""), ("x", "m"), ("y", "m")),
        *(("heading", "deg"), ("rounding", "m"), ("rounding", "deg")),
    )
    stretches = tl.Table(
        title=f"Largest differences between the plant and {run.name}",
        columns=tuple(
            tl.Column(title=title, unit=unit, digits=3 if unit == "s" else None)
            for title, unit in heads
        ),
        rows=tuple(
            (
                (stretch.start_ns - run.start_ns) / 1e9,
                (stretch.end_ns - run.start_ns) / 1e9,
                stretch.ticks,
                stretch.max_abs_error.x_m,
                stretch.max_abs_error.y_m,
                degrees(stretch.max_abs_error.heading_rad),
                stretch.rounding_m,
                degrees(stretch.rounding_rad),
            )
            for stretch in found.stretches
        ),
        notes=tuple(notes),
    )
    return "\n".join([format_table(stretches), *_list_breaks(run, found)])


def _list_breaks(run: "Run", found: "PlantReplay") -> list[str]:
    """Return a line for each jump and gap, in order of time."""
    lines = [(jump.at_ns, _format_jump(jump)) for jump in found.jumps]
    lines += [
        (
            gap.start_ns,
            f"gap of {(gap.end_ns - gap.start_ns) / 1e9:.3f} s: {gap.missing_ticks} ticks",
        )
        for gap in found.gaps
    ]
    return [f"{(at_ns - run.start_ns) / 1e9:.3f} s: {text}" for at_ns, text in sorted(lines)]


def _format_jump(jump: "Jump") -> str:
    to_x_m, to_y_m, to_rad = jump.to_pose
    place = f"x = {to_x_m:.3f} m, y = {to_y_m:.3f} m, heading {degrees(to_rad):.1f} deg"
    return f"jump ({jump.kind}) to {place}"
