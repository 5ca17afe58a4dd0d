"""How a replay through the plant is answered."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Any

import turtlelog as tl
from turtlelog.cli.output import fill_lines, fit_table
from turtlelog.cli.replay_answer import (
    GapAnswer,
    JumpAnswer,
    PoseAnswer,
    ReplayAnswer,
    RoundingAnswer,
    SegmentAnswer,
    build_difference,
    build_pose_error,
    tell_time,
)
from turtlelog.escapes import escape_controls

if TYPE_CHECKING:
    from turtlelog import Run
    from turtlelog.replay import Jump, PlantReplay


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantReplayAnswer(ReplayAnswer):
    """The recorded commands driven through the plant."""

    within_rounding: bool
    heading_bits: int | None
    commands: Mapping[str, Any]


def build_plant(file: Path, run: "Run", found: "PlantReplay") -> PlantReplayAnswer:
    """Return the answer."""
    return PlantReplayAnswer(
        file=str(file),
        name=found.name,
        mode="plant",
        samples=found.samples,
        max_abs_error=build_pose_error(found.max_abs_error),
        first_difference=build_difference(run, found.first_difference),
        within_rounding=found.within_rounding,
        heading_bits=found.heading_bits,
        stretches=tuple(
            SegmentAnswer(
                start_s=tell_time(run, segment.start_ns),
                end_s=tell_time(run, segment.end_ns),
                ticks=segment.ticks,
                max_abs_error=build_pose_error(segment.max_abs_error),
                rounding=RoundingAnswer(position=segment.rounding_m, heading=segment.rounding_rad),
                within_rounding=segment.within_rounding,
            )
            for segment in found.stretches
        ),
        jumps=tuple(
            JumpAnswer(
                at_s=tell_time(run, jump.at_ns),
                kind=jump.kind,
                from_pose=_build_pose(jump.from_pose),
                to_pose=_build_pose(jump.to_pose),
            )
            for jump in found.jumps
        ),
        gaps=tuple(
            GapAnswer(
                start_s=tell_time(run, gap.start_ns),
                end_s=tell_time(run, gap.end_ns),
                missing_ticks=gap.missing_ticks,
            )
            for gap in found.gaps
        ),
        commands=asdict(found.commands),
    )


def _build_pose(pose: "Sequence[float]") -> PoseAnswer:
    x, y, heading = pose
    return PoseAnswer(x=x, y=y, heading=heading)


def format_plant(file: Path, run: "Run", found: "PlantReplay") -> str:
    """Return whether the plant reproduces the poses, its segments, and what is between them."""
    use = found.commands
    and_of_velocities = ", and of velocities used as recorded," if use.unexplained_ticks else ""
    stops = f"; the plant stopped by itself {use.stops} times" if use.stops else ""
    first, *judged = judge_rounding(found)
    sentences = [
        f"{escape_controls(file.name)}: {first[0].lower()}{first[1:]}",
        *judged,
        f"Commands: {use.taken} taken, {use.unseen} that no pose shows{stops}.",
        "Rounding: one step of the 32 bits of a pose, for other platforms."
        if tl.plants.find_plant(run).name == tl.plants.LAGGED
        else f"Rounding: the largest error that the 32 bits of a segment's first pose"
        f"{and_of_velocities} can cause.",
    ]
    if use.never_arrived:
        sentences.append(
            f"The transport lost {use.never_arrived} commands, as the events show: one that equals"
            " the command before it counts as taken."
        )
    if use.disturbed_ticks:
        sentences.append(
            f"In {use.disturbed_ticks} ticks a disturbance acts on the plant: its velocity shows no"
            " command there, and was used as recorded."
        )
    if unexplained := use.unexplained_ticks - use.disturbed_ticks:
        sentences.append(
            f"No recorded command explains {unexplained} ticks: the recorded velocity was used"
            " there."
        )
    heads = (
        *(("from", "s"), ("to", "s"), ("ticks", ""), ("x", "m"), ("y", "m")),
        *(("heading", "deg"), ("rounding", "m"), ("rounding", "deg")),
    )
    segments = tl.compare.Table(
        title=f"Largest differences between the plant and {run.name}",
        columns=tuple(
            tl.compare.Column(title=title, unit=unit, digits=3 if unit == "s" else None)
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
    )
    breaks = list_breaks(run, found)
    parts = [fill_lines(sentences), "", fit_table(segments)]
    return "\n".join([*parts, *breaks]).rstrip()


def judge_rounding(found: "PlantReplay") -> list[str]:
    """Return whether rounding explains what differs, and whose arithmetic it is."""
    beyond = sum(not stretch.within_rounding for stretch in found.stretches)
    if found.of_rounding == 0.0:
        sentences = ["The plant reproduces every pose."]
    elif not beyond:
        sentences = ["The largest difference is within what 32-bit poses can tell."]
    else:
        count = len(found.stretches)
        of_all = f", in {beyond} of {count} segments" if count > 1 else ""
        times = f"{found.of_rounding:.3g} times what 32-bit poses can tell"
        sentences = [f"The largest difference is {times}{of_all}."]
    if found.heading_bits == 32:
        sentences.append("This turtlesim kept its heading in 32 bits: it is older than Humble.")
    return sentences


def list_breaks(run: "Run", found: "PlantReplay") -> list[str]:
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
